"""VMAS on the CPU: `sampling`, with a field to sample, and `simple_spread`, without."""

from functools import partial
from importlib.metadata import version
from itertools import cycle

import vmas

from runners.clock import Step, Variant, run

SEED = 1
ACTIONS = 64
AGENTS = 2


def scenario(name: str, worlds: int) -> Step:
    """Return a step with random actions; the package never restarts a world, so episodes do not end."""
    env = vmas.make_env(name, num_envs=worlds, device="cpu", seed=SEED, n_agents=AGENTS)
    env.reset()
    actions = cycle([env.get_random_actions() for _ in range(ACTIONS)])
    return lambda: env.step(next(actions))


if __name__ == "__main__":
    run(
        "VMAS",
        f"{version('vmas')}, torch {version('torch')}",
        [
            Variant(
                name=name,
                worlds=worlds,
                agents=AGENTS,
                field=name == "sampling",
                make=partial(scenario, name, worlds),
            )
            for name in ("sampling", "simple_spread")
            for worlds in (1, 32, 1024)
        ],
    )
