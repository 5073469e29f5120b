"""MPE2: `simple_spread_v3`, PettingZoo's parallel API."""

import os
from functools import partial
from importlib.metadata import version

from runners.clock import Step, Variant, random_steps, run

os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"

from mpe2 import simple_spread_v3

SEED = 1
ACTIONS = 256


def spread(agents: int) -> Step:
    """Return a step with random actions of all agents; finished episodes restart."""
    return random_steps(simple_spread_v3.parallel_env(N=agents), ACTIONS, SEED)


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
