"""One policy for both vehicles with SuperSuit's conversions and Stable-Baselines3's PPO.

pip install -e '.[supersuit]'
python examples/supersuit_sb3.py --steps 2000 --out runs/supersuit
"""

import argparse
from pathlib import Path

import numpy as np
import supersuit
from pettingzoo.utils import BaseParallelWrapper
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

import outrider


class MarkTruncated(BaseParallelWrapper):
    """Wrapper that marks truncated episodes in the infos for Stable-Baselines3, which SuperSuit omits.

    Without the mark a truncated episode counts as terminated, as if nothing followed.
    """

    def step(self, actions):
        observations, rewards, terminations, truncations, infos = super().step(actions)
        for name, info in infos.items():
            info["TimeLimit.truncated"] = truncations[name] and not terminations[name]
        return observations, rewards, terminations, truncations, infos


def make_env(worlds, *, duration, seed):
    """Return a vector environment of 2 x `worlds` entries: UAVs at even, UGVs at odd indices."""
    env = MarkTruncated(outrider.parallel_env("escort", duration=duration, dtype=np.float32))
    env = supersuit.normalize_obs_v0(env, env_min=-1, env_max=1)
    # pad a UGV's row with a zero
    env = supersuit.pad_action_space_v0(supersuit.pad_observations_v0(env))
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    env = supersuit.concat_vec_envs_v1(env, worlds, num_cpus=1, base_class="stable_baselines3")
    # world k has seed + k; without it all episodes are identical
    env.venv.reset(seed=seed)
    return env


def main():
    parser = argparse.ArgumentParser(
        description="PPO for both vehicles with SuperSuit and Stable-Baselines3."
    )
    parser.add_argument("--steps", type=int, default=2000, help="Steps of all vehicles together.")
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--duration", type=float, default=60.0, help="Duration of an episode [s].")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/supersuit"))
    args = parser.parse_args()

    env = make_env(args.worlds, duration=args.duration, seed=args.seed)
    # PPO(seed=...) would call seed(), which SuperSuit's environment lacks
    set_random_seed(args.seed)
    model = PPO("MlpPolicy", env, n_steps=125, batch_size=250, gamma=0.995, device="cpu", verbose=1)
    model.learn(args.steps)
    model.save(args.out / "policy")
    print("saved:", args.out / "policy.zip")
    env.close()


if __name__ == "__main__":
    main()
