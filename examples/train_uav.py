"""Train a UAV to cover more ground than the paper's laws.

PPO of Stable-Baselines3 in many worlds at once, on a CPU.

python -m pip install -e '.[sb3]'; python examples/train_uav.py --minutes 12
"""

import argparse
import platform
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from evaluation import CASES, VALIDATION_SEEDS, fly_policy
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

import outrider
from outrider_learning.learned import LearnedPolicy, make_view
from outrider_learning.mlp import Mlp, save_policy
from outrider_learning.repeat import ActionRepeat
from outrider_learning.sb3 import VecEnvAdapter
from outrider_learning.transformation import Transformed

CASE = CASES["wander"]
REWARDS = {"uncovered": 1.0, "sight_lost": 10.0, "out_of_sight": 2.0}
PPO_SETTINGS = {"n_steps": 200, "n_epochs": 6, "gamma": 0.98, "gae_lambda": 0.95}
MINIBATCHES = 10
LEARNING_RATE, LAST_SHARE = 5e-4, 0.05  # initial value, and the remaining share at the end
NETWORK, CRITIC, LOG_STD = (128, 128), (256, 256), -0.7
VALIDATE_EVERY = 8  # rollouts


def make_recipe(seed: int, num_envs: int) -> dict:
    """Return the settings of worlds, view and training."""
    scenario = outrider.load_scenario(CASE.scenario)
    return {
        "algorithm": "PPO",
        "scenario": CASE.scenario,
        "driver": CASE.driver,
        "seed": seed,
        "num_envs": num_envs,
        "first_world_seed": 100 * seed,
        "safety_filter": True,
        "dt": scenario.dt,
        "repeat": 10,
        "coverage_patch": [20, 1.5],
        "view": {
            "v_max": scenario.uav[0].max_speed,
            "rings": [1.0, 3.0, 5.0, 7.0, 9.0],
            "sectors": 16,
            "lag": 4,
        },
        "rewards": REWARDS,
        "ppo": PPO_SETTINGS
        | {
            "batch_size": PPO_SETTINGS["n_steps"] * num_envs // MINIBATCHES,
            "learning_rate": LEARNING_RATE,
        },
        "networks": {"policy": NETWORK, "critic": CRITIC, "log_std": LOG_STD},
        "versions": {"python": platform.python_version()}
        | {
            name: version(name)
            for name in ("outrider", "numpy", "gymnasium", "torch", "stable_baselines3")
        },
    }


def make_worlds(recipe: dict) -> VecEnvAdapter:
    """Return the training worlds, with the safety filter around the UAV."""
    env = outrider.vector_env(
        recipe["scenario"],
        num_envs=recipe["num_envs"],
        agent="uav_0",
        others={"ugv_0": recipe["driver"]},
        estimate=True,
        coverage_patch=tuple(recipe["coverage_patch"]),
        safety_filter=recipe["safety_filter"],
        rewards=outrider.RewardWeights(**recipe["rewards"]),
    )
    return VecEnvAdapter(Transformed(ActionRepeat(env, recipe["repeat"]), make_view(recipe)))


def network_of(model: PPO) -> Mlp:
    """Return the network of the policy's current mean."""
    layers = [
        layer
        for layer in model.policy.mlp_extractor.policy_net
        if isinstance(layer, torch.nn.Linear)
    ]
    layers.append(model.policy.action_net)
    weights = tuple(layer.weight.detach().numpy().astype(np.float64) for layer in layers)
    return Mlp(weights, tuple(layer.bias.detach().numpy().astype(np.float64) for layer in layers))


class Progress(BaseCallback):
    """Callback that ends the training in time and regularly validates the policy."""

    def __init__(self, recipe: dict, seconds: float) -> None:
        super().__init__()
        self._recipe = recipe
        self._seconds = seconds
        self._started = time.perf_counter()
        self._rollouts = 0
        self.curve = []

    @property
    def share(self) -> float:
        """Return the share of the training time used."""
        return min(1.0, (time.perf_counter() - self._started) / self._seconds)

    def _on_step(self) -> bool:
        return self.share < 1.0

    def _on_rollout_start(self) -> None:
        if self._rollouts % VALIDATE_EVERY == 0:
            self.validate()
        self._rollouts += 1

    def validate(self) -> None:
        """Record the performance of the policy without exploration."""
        policy = LearnedPolicy(network_of(self.model), self._recipe)
        flown = fly_policy(CASE, policy, VALIDATION_SEEDS, shielded=True)
        minutes = (time.perf_counter() - self._started) / 60.0
        error = float(flown["mean_error"].mean())
        self.curve.append([self.num_timesteps, round(minutes, 3), round(error, 2)])
        speed = self.num_timesteps / (60.0 * minutes)
        print(
            f"{minutes:6.2f} min  {self.num_timesteps:9d} decisions ({speed:5.0f} /s)  mean e(t) {error:6.1f} m²",
            flush=True,
        )


def main() -> None:
    """Train, and save the result."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=12.0, help="Training time [min].")
    parser.add_argument(
        "--seed", type=int, default=0, help="Seed of worlds and network, below 1000."
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("uav_ppo.npz"),
        help="File of the policy, with Stable-Baselines3's own beside it.",
    )
    parser.add_argument(
        "--num-envs",
        type=int,
        default=64,
        help="Number of worlds; a rollout has 200 decisions per world.",
    )
    given = parser.parse_args()
    if not (given.minutes > 0.0 and 0 <= given.seed < 1000 and given.num_envs >= 1):
        parser.error("--minutes must be positive, --seed from 0 to 999, --num-envs 1 or more")

    torch.set_num_threads(1)  # the networks are small, and the worlds use all cores
    recipe = make_recipe(given.seed, given.num_envs)
    env = make_worlds(recipe)
    progress = Progress(recipe, 60.0 * given.minutes)
    model = PPO(
        "MlpPolicy",
        env,
        policy_kwargs={
            "net_arch": {"pi": list(NETWORK), "vf": list(CRITIC)},
            "log_std_init": LOG_STD,
        },
        seed=recipe["first_world_seed"],  # also of the network; world k starts with seed + k
        device="cpu",
        **recipe["ppo"]
        | {"learning_rate": lambda _: LEARNING_RATE * max(LAST_SHARE, 1.0 - progress.share)},
    )
    started = time.perf_counter()
    try:
        model.learn(total_timesteps=2**53, callback=progress)
    except KeyboardInterrupt:
        print("stopped: saving the current policy")
    minutes = (time.perf_counter() - started) / 60.0
    progress.validate()
    env.close()

    ticks = model.num_timesteps * recipe["repeat"]
    recipe["trained"] = {
        "decisions": model.num_timesteps,
        "ticks": ticks,
        "minutes": round(minutes, 2),
    }
    save_policy(given.out, network_of(model), recipe | {"curve": progress.curve})
    # the current schedule would keep a reference to the clock
    model.learning_rate, model.lr_schedule = LEARNING_RATE, None
    model.save(given.out.with_suffix(".zip"))
    print(
        f"{given.out}: {model.num_timesteps} decisions in {minutes:.1f} min, {ticks / minutes / 60.0:.0f} world-steps/s"
    )


if __name__ == "__main__":
    main()
