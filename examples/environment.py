"""The paper's pilots fly the PettingZoo environment."""

import outrider
from outrider.envs.env_pilots import pilots

env = outrider.parallel_env("escort")
policies = pilots(env)
observations, infos = env.reset(seed=1)
while env.agents:
    actions = {name: policies[name](observations[name]) for name in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
print(env.metrics()["uav_0"])
