"""Train both vehicles with RLlib's PPO: one policy for the UAVs, one for the UGVs.

pip install -e '.[rllib]'
python examples/train_rllib.py --iterations 2 --out runs/rllib
"""

import argparse
from pathlib import Path

import numpy as np
import ray
import supersuit
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

import outrider


def make_env(config):
    """Return the environment for RLlib; rows of UAV and UGV differ in length."""
    env = outrider.parallel_env("escort", duration=config.get("duration"), dtype=np.float32)
    return ParallelPettingZooEnv(supersuit.normalize_obs_v0(env, env_min=-1, env_max=1))


def policy_of(agent, *_, **__):
    """Return the policy's name: vehicles of a kind share a policy, `uav_0` uses `uav`."""
    return agent.rpartition("_")[0]


def fly_randomly(env, seed):
    """Run one episode of random actions; return its ticks and each vehicle's return."""
    env.action_space.seed(seed)
    env.reset(seed=seed)
    returns, ticks, over = dict.fromkeys(env.possible_agents, 0.0), 0, False
    while not over:
        _, rewards, terminated, truncated, _ = env.step(env.action_space.sample())
        returns = {name: returns[name] + reward for name, reward in rewards.items()}
        ticks, over = ticks + 1, terminated["__all__"] or truncated["__all__"]
    return ticks, returns


def main():
    parser = argparse.ArgumentParser(
        description="PPO for both vehicles of the escort scenario with RLlib."
    )
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--batch", type=int, default=4000, help="Environment steps per iteration.")
    parser.add_argument(
        "--runners", type=int, default=1, help="Number of rollout processes; 0: this process."
    )
    parser.add_argument("--duration", type=float, default=60.0, help="Duration of an episode [s].")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/rllib"))
    args = parser.parse_args()

    env = make_env({"duration": args.duration})
    ticks, returns = fly_randomly(env, args.seed)
    print(
        "random actions:",
        ticks,
        "ticks;",
        ", ".join(f"{name} {returns[name]:+.3f}" for name in sorted(returns)),
    )
    env.close()

    register_env("outrider", make_env)
    config = (
        PPOConfig()
        .environment("outrider", env_config={"duration": args.duration})
        .env_runners(num_env_runners=args.runners)
        .multi_agent(policies=["uav", "ugv"], policy_mapping_fn=policy_of)
        .training(
            train_batch_size_per_learner=args.batch,
            minibatch_size=min(250, args.batch),
            num_epochs=6,
            gamma=0.995,
        )
        # Each runner derives its own seed from this one.
        .debugging(seed=args.seed)
    )
    ray.init(num_cpus=args.runners + 1, include_dashboard=False)
    try:
        algorithm = config.build_algo()
        for iteration in range(1, args.iterations + 1):
            found = algorithm.train()["env_runners"]
            means = found.get(
                "module_episode_returns_mean", {}
            )  # empty until the first episode ends
            print(
                f"{iteration:>4}  {int(found['num_env_steps_sampled_lifetime']):>9} steps  mean return:",
                ", ".join(f"{name} {mean:+.3f}" for name, mean in sorted(means.items()))
                or "no episode has ended yet",
                flush=True,
            )
        print("saved:", algorithm.save_to_path(str(args.out.resolve() / "checkpoint")))
        algorithm.stop()
    finally:
        ray.shutdown()


if __name__ == "__main__":
    main()
