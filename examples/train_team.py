"""Train the UAVs of a team with TorchRL: MAPPO or IPPO with one actor for all UAVs.

    pip install -e '.[torchrl]'
    python examples/train_team.py --algorithm mappo --task scouts --out runs/team
    outrider run scouts --uav-policy npz:runs/team/mappo-scouts-0.npz

The critic of MAPPO has the true state, the critic of IPPO each UAV's own row. The roles follow the rules of the team:
the action flies a scout as it is, and a guard through the safety filter.
"""

import argparse
import csv
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor
from train_torchrl import RATE, Critic, Learner

from outrider_learning.networks import load_npz_policy, save_layers
from outrider_learning.recipe import observation_recipe
from outrider_learning.standardized import Standardized
from outrider_learning.suite.tasks import TEAM_SUITE, TEAMS, Task, suite
from outrider_learning.torchrl_env import OutriderTorchEnv
from sim.env.rewards import RewardWeights

GROUP = "uav"
REPEAT, WORLDS, ROLLOUT = 10, 16, 100  # ticks per decision; worlds; decisions per rollout and world
EPOCHS, MINIBATCH = 8, 320  # passes through a rollout; decisions per gradient step, of all UAVs
HIDDEN, LOG_STD = (64, 64), -0.7  # of the actor; of the exploration, over the largest acceleration
REWARDS = RewardWeights(seen=1.0, uncovered=0.0, team=True)  # newly covered ground, shared
REWARD_SCALE = 5.0  # raises the critic's targets
DISCOUNT = 0.95  # per decision
LAST_RATE = 0.1  # share of the learning rate that is left at the end
CLIP, EPSILON, NARROWEST = 10.0, 1e-8, 0.1  # see `standardize`
VALIDATION_SEEDS = (8000, 8001)  # neither trained on nor scored
CHECKPOINTS = 6
SETTINGS: dict[str, Any] = {"estimate": True, "gradient": True, "omit": ("time", "position")}


def make_env(task: Task, num_envs: int = WORLDS) -> OutriderTorchEnv:
    """Return the worlds, with one group of all UAVs and a shared reward."""
    scenario = task.scenario
    return OutriderTorchEnv(
        scenario,
        num_envs=num_envs,
        agents=[uav.name for uav in scenario.uav],
        group_map={GROUP: [uav.name for uav in scenario.uav]},
        repeat=REPEAT,
        rewards=REWARDS,
        threads=1,
        **SETTINGS,
    )


def standardize(env: OutriderTorchEnv) -> Standardized:
    """Return a scaling by the mean and the variance of random flights.

    The scale is at least `NARROWEST` of half the entry's range, because a trained UAV flies farther than a random one.
    """
    rows = env.rollout(ROLLOUT, break_when_any_done=False)[GROUP, "observation"].flatten(0, 2)
    bounds = env.observation_spec[GROUP, "observation"].space
    half_range = 0.5 * (bounds.high - bounds.low).double()[0, 0]
    scale = torch.maximum(rows.double().std(0), NARROWEST * half_range)
    mean, variance = rows.double().mean(0).tolist(), (scale**2).tolist()
    return Standardized(mean=mean, variance=variance, epsilon=EPSILON, clip=CLIP)


class Scaled(nn.Module):
    """The same scaling as a first layer."""

    def __init__(self, scaling: Standardized) -> None:
        super().__init__()
        given = scaling.settings()
        self.register_buffer("mean", torch.tensor(given["mean"]))
        self.register_buffer("scale", (torch.tensor(given["variance"]) + EPSILON).sqrt())

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return ((rows - self.mean) / self.scale).clamp(-CLIP, CLIP)


class Team:
    """Learner of a team, with the shared actor's layers.

    Args:
        env: Environment of `make_env`.
        algorithm: `mappo` or `ippo`.
    """

    def __init__(self, env: OutriderTorchEnv, algorithm: str) -> None:
        self.scaling = standardize(env)
        entries = env.observation_spec[GROUP, "observation"].shape[-1]
        acted = env.full_action_spec[GROUP, "action"]
        axes, u_max = acted.shape[-1], float(acted.space.high.max())
        self.layers = MLP(entries, axes, num_cells=list(HIDDEN), activation_class=nn.Tanh)
        with torch.no_grad():  # small first actions, in m/s²
            self.layers[-1].weight *= 0.1
            self.layers[-1].bias.zero_()
        spread = AddStateIndependentNormalScale(axes, init_value=LOG_STD + float(np.log(u_max)))
        net = nn.Sequential(Scaled(self.scaling), self.layers, spread)
        parameters = [(GROUP, "loc"), (GROUP, "scale")]
        actor = ProbabilisticActor(
            TensorDictModule(net, [(GROUP, "observation")], parameters),
            in_keys=parameters,
            out_keys=[(GROUP, "action")],
            distribution_class=IndependentNormal,
            return_log_prob=True,
            log_prob_key=(GROUP, "log_prob"),
        )
        if algorithm == "mappo":
            value, key = Critic(env, GROUP), "state"
        else:
            cells = MLP(entries, 1, num_cells=[128, 128], activation_class=nn.Tanh)
            value, key = nn.Sequential(Scaled(self.scaling), cells), (GROUP, "observation")
        critic = TensorDictModule(value, [key], [(GROUP, "state_value")])
        self.learner = Learner(env, GROUP, actor=actor, critic=critic, discount=DISCOUNT)
        """Its actor, critic, loss and optimizer."""
        self._env, self._bounds = env, ([-u_max] * axes, [u_max] * axes)

    def save(self, file: Path, **about: Any) -> None:
        """Write the actor as a policy of one UAV."""
        recipe = observation_recipe(self._env, self._env.group_map[GROUP][0])
        scaled = {"kind": "standardized", **self.scaling.settings()}
        recipe = msgspec.structs.replace(recipe, layers=(*recipe.layers, scaled))
        save_layers(list(self.layers), recipe, self._bounds, file, **about)

    def update(self, frames: Any, rate: float) -> None:
        """Learn from a rollout."""
        for group in self.learner.optimizer.param_groups:
            group["lr"] = rate
        frames["next", GROUP, "reward"] *= REWARD_SCALE
        for _ in range(EPOCHS):
            with torch.no_grad():
                self.learner.advantages(frames)
            flat = frames.reshape(-1)
            for part in torch.randperm(len(flat)).split(MINIBATCH):
                self.learner.step(flat[part])


def train(
    team: Team, env: OutriderTorchEnv, *, seconds: float, steps: int
) -> Iterator[tuple[int, float]]:
    """Train until the seconds or the decisions are over; yield decisions and seconds after each rollout.

    The time that the caller uses in between does not count.
    """
    batch = WORLDS * ROLLOUT
    collector = Collector(
        env,
        team.learner.actor,
        frames_per_batch=batch,
        total_frames=-(-steps // batch) * batch,
        auto_register_policy_transforms=True,
    )
    done, spent, started = 0, 0.0, time.monotonic()
    for frames in collector:
        done += frames.numel()
        paid = frames["next", GROUP, "reward"].mean().item()
        team.update(frames, RATE * max(LAST_RATE, 1.0 - done / steps))
        spent += time.monotonic() - started
        print(f"{done:>8} decisions  {spent:5.0f} s  reward {paid:+.4f}", flush=True)
        yield done, spent
        if spent >= seconds:
            break
        started = time.monotonic()
    collector.shutdown(close_env=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--algorithm", choices=("mappo", "ippo"), default="mappo")
    names = [task.name for task in TEAMS]
    parser.add_argument("--task", choices=names, default=names[0], help="Task of `teams-v1`.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of worlds and networks.")
    parser.add_argument("--minutes", type=float, default=60.0, help="Stop after this time [min].")
    parser.add_argument(
        "--steps", type=int, default=48_000, help="Decisions of half a second in all worlds."
    )
    parser.add_argument("--out", type=Path, default=Path("runs/team"))
    given = parser.parse_args()
    torch.set_num_threads(1)  # the networks are too small to share
    torch.manual_seed(given.seed)
    task = suite(TEAM_SUITE)[given.task]
    env = make_env(task)
    env.set_seed(1000 * given.seed)
    team = Team(env, given.algorithm)
    file = given.out / f"{given.algorithm}-{given.task}-{given.seed}.npz"
    given.out.mkdir(parents=True, exist_ok=True)
    seconds, passed = 60.0 * given.minutes, 0
    with file.with_suffix(".csv").open("w", newline="") as written:
        curve = csv.writer(written)
        curve.writerow(["decisions", "minutes", "score", "mean_error"])

        def record(done: int, spent: float) -> None:
            """Save the policy, fly it without exploration, and add a point to the curve."""
            about = {"algorithm": given.algorithm, "task": task.name, "seed": given.seed}
            team.save(file, trained={**about, "decisions": done, "minutes": round(spent / 60.0, 2)})
            policy = load_npz_policy(str(file), "policy")
            flown = task.evaluate(policy, seeds=VALIDATION_SEEDS, secret="", threads=1)
            row = [done, round(spent / 60.0, 3), round(flown.score, 3), round(flown.mean_error, 3)]
            curve.writerow(row)
            written.flush()
            print(
                f"{file.stem}: score {flown.score:.1f}, mean e(t) {flown.mean_error:.1f} m²",
                flush=True,
            )

        record(0, 0.0)
        for done, spent in train(team, env, seconds=seconds, steps=given.steps):
            share = 1.0 if spent >= seconds else min(1.0, done / given.steps)
            if int(CHECKPOINTS * share) > passed:
                passed = int(CHECKPOINTS * share)
                record(done, spent)
    env.close()


if __name__ == "__main__":
    main()
