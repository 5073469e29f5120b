"""Outrider: the parallel environment, and many worlds at once."""

from functools import partial
from importlib.metadata import version
from itertools import cycle

import numpy as np

import outrider
from runners.clock import Step, Variant, random_steps, run

SEED = 1
ACTIONS = 256


def parallel(**settings: object) -> Step:
    """Return `parallel_env.step` with random accelerations of all vehicles; finished episodes restart."""
    return random_steps(outrider.parallel_env("escort", **settings), ACTIONS, SEED)


def vector(worlds: int, **settings: object) -> Step:
    """Return `vector_env.step` with random accelerations of the UAVs; it restarts episodes itself."""
    env = outrider.vector_env("escort", num_envs=worlds, agent="uav_0", **settings)
    env.reset(seed=SEED)
    space = env.single_action_space
    rng = np.random.default_rng(SEED)
    shape = (min(ACTIONS, 64), worlds, *space.shape)
    actions = cycle(list(rng.uniform(space.low, space.high, shape).astype(space.dtype)))
    return lambda: env.step(next(actions))


if __name__ == "__main__":
    escort = partial(Variant, agents=2, field=True)
    many = [
        escort(name="vector_env", worlds=worlds, make=partial(vector, worlds))
        for worlds in (1, 32, 1024)
    ]
    one = escort(name="parallel_env", worlds=1, make=parallel)
    run("Outrider", version("outrider"), [one, *many])
