"""Train both vehicles at once: multi-agent PPO (MAPPO) with TorchRL on the parallel environment.

The policies have their own observations; the critics, used in training only, have the true state.

    pip install -e '.[torchrl]'
    python examples/train_torchrl.py --minutes 10 --out runs/torchrl
"""

import argparse
import json
import time
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from pettingzoo.utils import BaseParallelWrapper
from tensordict import TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import Bounded
from torchrl.envs import PettingZooWrapper
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import outrider
from outrider.envs.env_pilots import pilots

REPEAT = 10  # ticks (half a second): the effect of a single tick is too small for a critic
BATCH, MINIBATCH, EPOCHS = 2000, 250, 8
DISCOUNT, TRACE, RATE = 0.98, 0.95, 5e-4
REWARD_SCALE = (
    0.02  # the penalty for lost sight is large; this scales the critics' targets to about 1
)


class ActionRepeat(BaseParallelWrapper):
    """Wrapper that applies each action for `REPEAT` ticks, or to the end of the episode."""

    def step(self, actions):
        observations, paid, *ends, infos = super().step(actions)
        for _ in range(REPEAT - 1):
            if not self.agents:
                break
            observations, rewards, *ends, infos = super().step(actions)
            paid = {name: paid[name] + reward for name, reward in rewards.items()}
        return observations, paid, *ends, infos


def make_env(duration: float) -> PettingZooWrapper:
    """Return the environment for TorchRL, with a group for UAVs, one for UGVs, and the state."""
    with warnings.catch_warnings():
        # it names 1.24.3 for every installed version
        warnings.filterwarnings("ignore", "PettingZoo in TorchRL is tested using")
        return PettingZooWrapper(
            ActionRepeat(outrider.parallel_env("escort", duration=duration, dtype=np.float32)),
            return_state=True,
        )


class Rescale(nn.Module):
    """Scaling of bounded numbers to [-1, 1]: first layer of each network.

    Args:
        spec: Bounds of the numbers.
    """

    def __init__(self, spec: Bounded) -> None:
        super().__init__()
        space = spec.space
        low, high = (bound.reshape(-1, bound.shape[-1])[0] for bound in (space.low, space.high))
        self.register_buffer("middle", (low + high) / 2.0)
        self.register_buffer("half_range", ((high - low) / 2.0).clamp_min(1e-6))

    def forward(self, numbers: torch.Tensor) -> torch.Tensor:
        return (numbers - self.middle) / self.half_range


def make_actor(env: PettingZooWrapper, group: str) -> ProbabilisticActor:
    """Return a group's policy, from each vehicle's own observation to its acceleration."""
    spec = env.full_action_spec[group, "action"]
    observed = env.observation_spec[group, "observation"]
    net = nn.Sequential(
        Rescale(observed),
        MLP(
            observed.shape[-1],
            2 * spec.shape[-1],
            num_cells=[64, 64],
            activation_class=nn.Tanh,
        ),
        NormalParamExtractor(),
    )
    return ProbabilisticActor(
        TensorDictModule(net, [(group, "observation")], [(group, "loc"), (group, "scale")]),
        in_keys=[(group, "loc"), (group, "scale")],
        out_keys=[(group, "action")],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": spec.space.low[0].float(), "high": spec.space.high[0].float()},
        return_log_prob=True,
        log_prob_key=(group, "log_prob"),
    )


class Critic(nn.Module):
    """Value of the true state for each vehicle of a group."""

    def __init__(self, env: PettingZooWrapper, group: str) -> None:
        super().__init__()
        state = env.observation_spec["state"]
        vehicles = len(env.group_map[group])
        self.net = nn.Sequential(
            Rescale(state),
            MLP(state.shape[-1], vehicles, num_cells=[128, 128], activation_class=nn.Tanh),
        )

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return self.net(state).unsqueeze(-1)


class Learner:
    """Actor, critic, loss and optimizer of one group.

    Args:
        env: Environment.
        group: Its group.
        actor: Policy of the group; default: `make_actor`.
        critic: Module that writes the group's `state_value`; default: `Critic` on the state.
        discount: Discount of the next step's value.
    """

    def __init__(
        self,
        env: PettingZooWrapper,
        group: str,
        *,
        actor: ProbabilisticActor | None = None,
        critic: TensorDictModule | None = None,
        discount: float = DISCOUNT,
    ) -> None:
        self.group = group
        self.actor = make_actor(env, group) if actor is None else actor
        if critic is None:
            critic = TensorDictModule(Critic(env, group), ["state"], [(group, "state_value")])
        keys = {
            "advantage": (group, "advantage"),
            "value_target": (group, "value_target"),
            "value": (group, "state_value"),
            "reward": (group, "reward"),
            "done": (group, "done"),
            "terminated": (group, "terminated"),
        }
        # Only `terminated` removes the value of the last state; a truncated episode or batch keeps it. The last state
        # is the episode's own, because Collector resets only after it.
        self.advantages = GAE(gamma=discount, lmbda=TRACE, value_network=critic)
        self.advantages.set_keys(**keys)
        self.loss = ClipPPOLoss(self.actor, critic, entropy_coeff=1e-3, normalize_advantage=True)
        self.loss.set_keys(**keys, action=(group, "action"), sample_log_prob=(group, "log_prob"))
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=RATE)

    def step(self, frames: TensorDictBase) -> None:
        losses = self.loss(frames)
        self.optimizer.zero_grad()
        (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
        # clip separately: a critic's gradient may be far larger
        for params in (
            self.loss.actor_network_params,
            self.loss.critic_network_params,
        ):
            nn.utils.clip_grad_norm_(params.values(True, True), 0.5)
        self.optimizer.step()


def train(
    env: PettingZooWrapper, *, steps: int, minutes: float, seed: int
) -> dict[str, ProbabilisticActor]:
    """Train all groups until the steps or the minutes are over."""
    torch.manual_seed(seed)
    env.set_seed(seed)
    learners = [Learner(env, group) for group in env.group_map]
    policy = TensorDictSequential(*(learner.actor for learner in learners))
    batch = min(BATCH, steps)
    collector = Collector(
        env,
        policy,
        frames_per_batch=batch,
        total_frames=-(-steps // batch) * batch,
        auto_register_policy_transforms=True,
    )
    started, done = time.monotonic(), 0
    period = REPEAT * env.unwrapped.scenario.dt
    for frames in collector:
        done += len(frames)
        paid = {
            group: frames["next", group, "reward"].mean().item() / period for group in env.group_map
        }
        for learner in learners:
            frames["next", learner.group, "reward"] *= REWARD_SCALE
        for _ in range(EPOCHS):
            with torch.no_grad():
                for learner in learners:
                    learner.advantages(frames)
            for part in torch.randperm(len(frames)).split(MINIBATCH):
                for learner in learners:
                    learner.step(frames[part])
        elapsed = time.monotonic() - started
        rewards = ", ".join(f"{group} {reward:+.3f}" for group, reward in paid.items())
        print(
            f"{done:>9} steps  {done / elapsed:5.0f} /s  reward per second: {rewards}", flush=True
        )
        if elapsed > 60.0 * minutes:
            break
    collector.shutdown(close_env=False)
    return {learner.group: learner.actor for learner in learners}


def fly_learned(
    env: PettingZooWrapper, actors: Mapping[str, ProbabilisticActor], seed: int
) -> dict[str, float]:
    """Return the returns of one episode of the learned policies, without exploration."""
    policy = TensorDictSequential(*actors.values())
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        flight = env.rollout(
            env.unwrapped.scenario.ticks, policy, auto_reset=False, tensordict=env.reset(seed=seed)
        )
    paid = {
        group: flight["next", group, "reward"].sum(0).flatten().tolist() for group in env.group_map
    }
    return {
        name: paid[group][k]
        for group, names in env.group_map.items()
        for k, name in enumerate(names)
    }


def fly_pilots(duration: float, seed: int) -> dict[str, float]:
    """Return the returns of one episode of the scenario's own pilots."""
    env = outrider.parallel_env("escort", duration=duration)
    policies = pilots(env)
    observations, _ = env.reset(seed=seed)
    returns = dict.fromkeys(env.agents, 0.0)
    while env.agents:
        observations, rewards, *_ = env.step(
            {name: policies[name](observations[name]) for name in env.agents}
        )
        returns = {name: returns[name] + reward for name, reward in rewards.items()}
    return returns


def main() -> None:
    parser = argparse.ArgumentParser(
        description="MAPPO for both vehicles of the escort scenario with TorchRL."
    )
    parser.add_argument(
        "--steps",
        type=int,
        default=1_000_000,
        help="Training steps of half a second; whole batches of 2000.",
    )
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="Stop training after this time [min]."
    )
    parser.add_argument("--duration", type=float, default=60.0, help="Duration of an episode [s].")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/torchrl"))
    args = parser.parse_args()
    torch.set_num_threads(1)  # the networks are too small to share
    args.out.mkdir(parents=True, exist_ok=True)
    env = make_env(args.duration)
    actors = train(env, steps=args.steps, minutes=args.minutes, seed=args.seed)
    torch.save(
        {group: actor.state_dict() for group, actor in actors.items()}, args.out / "policies.pt"
    )

    saved = torch.load(args.out / "policies.pt", weights_only=True)
    for group, actor in actors.items():
        actor.load_state_dict(saved[group])
    seeds = [args.seed + 1000 + k for k in range(3)]
    returns = {
        "learned": [fly_learned(env, actors, seed) for seed in seeds],
        "pilots": [fly_pilots(args.duration, seed) for seed in seeds],
    }
    table = {
        who: {name: float(np.mean([one[name] for one in flights])) for name in flights[0]}
        for who, flights in returns.items()
    }
    print(f"mean return of {len(seeds)} episodes of {args.duration:g} s")
    for who, means in table.items():
        print(f"{who:>9}", *(f"{name} {mean:+9.3f}" for name, mean in means.items()), sep="  ")
    (args.out / "evaluation.json").write_text(
        json.dumps({"seeds": seeds, "returns": table}, indent=2) + "\n"
    )
    env.close()


if __name__ == "__main__":
    main()
