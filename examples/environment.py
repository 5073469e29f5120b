"""Run the PettingZoo environment with the paper's pilots."""

import outrider
from outrider.envs.env_pilots import pilots

env = outrider.parallel_env("escort")
policies = pilots(env)
observations, infos = env.reset(seed=1)
while env.agents:
    actions = {name: policies[name](observations[name]) for name in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
print(env.metrics()["uav_0"])
