"""MPE2: `simple_spread_v3`, PettingZoo's parallel API."""

import os
from functools import partial
from importlib.metadata import version
from itertools import cycle

from runners.clock import Step, Variant, run

os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"

from mpe2 import simple_spread_v3

SEED = 1
ACTIONS = 256


def spread(agents: int) -> Step:
    """A step with random actions of all agents; a new episode where one has ended."""
    env = simple_spread_v3.parallel_env(N=agents)
    env.reset(seed=SEED)
    names = env.possible_agents
    for name in names:
        env.action_space(name).seed(SEED)
    actions = cycle(
        [{name: env.action_space(name).sample() for name in names} for _ in range(ACTIONS)]
    )

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step(next(actions))

    return step


if __name__ == "__main__":
    run(
        "MPE2",
        version("mpe2"),
        [
            Variant(
                name="simple_spread",
                worlds=1,
                agents=agents,
                field=False,
                make=partial(spread, agents),
            )
            for agents in (2, 3)
        ],
    )
