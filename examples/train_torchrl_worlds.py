"""Train both vehicles in many worlds at once: MAPPO with TorchRL on the batched environment.

    pip install -e '.[torchrl]'
    python examples/train_torchrl_worlds.py --minutes 10 --out runs/mappo

The UAV flies inside the safety filter; the critics have the true state. The score is the covered share of the ground,
as in the suite, on the suite's seeds, with the scenario's own driver.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.envs.utils import ExplorationType, set_exploration_type
from train_torchrl import EPOCHS, REPEAT, Learner

from outrider_learning.suite.tasks import suite
from outrider_learning.torchrl_env import OutriderTorchEnv

WORLDS, ROLLOUT, MINIBATCH = 16, 120, 320
SETTINGS: dict[str, Any] = {"gradient": True, "estimate": True, "omit": ("time", "position")}


def make_env(duration: float, num_envs: int = WORLDS) -> OutriderTorchEnv:
    """Return the worlds, with a group for UAVs and one for UGVs."""
    return OutriderTorchEnv(
        "escort",
        num_envs=num_envs,
        repeat=REPEAT,
        duration=duration,
        safety_filter=True,
        **SETTINGS,
    )


def train(env: OutriderTorchEnv, *, minutes: float, steps: int, seed: int) -> list[Learner]:
    """Train all groups until the steps or the minutes are over."""
    torch.manual_seed(seed)
    env.set_seed(seed)
    learners = [Learner(env, group) for group in env.group_map]
    policy = TensorDictSequential(*(learner.actor for learner in learners))
    batch = WORLDS * ROLLOUT
    collector = Collector(
        env,
        policy,
        frames_per_batch=batch,
        total_frames=-(-steps // batch) * batch,
        auto_register_policy_transforms=True,
    )
    started, done = time.monotonic(), 0
    for frames in collector:
        done += frames.numel()
        rewards = {group: frames["next", group, "reward"].mean().item() for group in env.group_map}
        for _ in range(EPOCHS):
            with torch.no_grad():
                for learner in learners:
                    learner.advantages(frames)
            flat = frames.reshape(-1)
            for part in torch.randperm(len(flat)).split(MINIBATCH):
                for learner in learners:
                    learner.step(flat[part])
        elapsed = time.monotonic() - started
        shown = ", ".join(f"{group} {reward:+.4f}" for group, reward in rewards.items())
        print(f"{done:>8} steps  {done / elapsed:5.0f} /s  reward per step: {shown}", flush=True)
        if elapsed > 60.0 * minutes:
            break
    collector.shutdown(close_env=False)
    return learners


class LearnedUav:
    """UAV's actor as a policy of the suite, held for `REPEAT` ticks."""

    def __init__(self, learner: Learner) -> None:
        self.setup = {**SETTINGS, "omit": (), "dtype": np.float32, "safety_filter": True}
        self._actor, self._actions = learner.actor, np.zeros((0, 2))

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        if np.rint(rows[0, 0] / 0.05) % REPEAT == 0:
            seen = {"uav": {"observation": torch.from_numpy(rows[:, None, 3:].copy())}}
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                frame = self._actor(TensorDict(seen, batch_size=[len(rows)]))
            self._actions = frame["uav", "action"][:, 0].double().numpy()
        return self._actions


def main() -> None:
    parser = argparse.ArgumentParser(description="MAPPO in many worlds of escort with TorchRL.")
    parser.add_argument("--minutes", type=float, default=10.0, help="Training time [min].")
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="Most training steps of half a second."
    )
    parser.add_argument("--duration", type=float, default=60.0, help="Duration of an episode [s].")
    parser.add_argument("--seeds", type=int, default=3, help="Number of scored flights, 1 to 20.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/mappo"))
    args = parser.parse_args()
    torch.set_num_threads(1)  # the networks are too small to share
    args.out.mkdir(parents=True, exist_ok=True)
    env = make_env(args.duration)
    learners = train(env, minutes=args.minutes, steps=args.steps, seed=args.seed)
    env.close()
    states = {learner.group: learner.actor.state_dict() for learner in learners}
    torch.save(states, args.out / "policies.pt")
    uav = next(learner for learner in learners if learner.group == "uav")
    result = suite()["paper"].evaluate(LearnedUav(uav), seeds=range(9000, 9000 + args.seeds))
    print(f"score {result.score:.1f}, sight lost in {result.lost} of {result.episodes} episodes")


if __name__ == "__main__":
    main()
