"""JaxMARL on the CPU: MPE simple_spread, stepped from Python and as a compiled loop. Compiling is not timed."""

import os
from functools import partial
from importlib.metadata import version
from itertools import cycle
from typing import Any

from runners.clock import Step, Variant, run

os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import jaxmarl

SEED = 1
ACTIONS = 256
AGENTS = 2


def _spread() -> Any:  # noqa: ANN401 - the package names no type
    return jaxmarl.make("MPE_simple_spread_v3", num_agents=AGENTS, num_landmarks=AGENTS)


def stepped() -> Step:
    """Return `env.step` in a Python loop; each step waits for its observations, like a policy in Python."""
    env = _spread()
    keys = list(jax.random.split(jax.random.key(SEED), ACTIONS))
    drawn = {
        name: jax.random.randint(keys[i], (ACTIONS,), 0, 5) for i, name in enumerate(env.agents)
    }
    given = cycle(
        [(keys[k], {name: drawn[name][k] for name in env.agents}) for k in range(ACTIONS)]
    )
    _, state = env.reset(keys[0])

    def step() -> None:
        nonlocal state
        key, actions = next(given)
        observations, state, *_ = env.step(key, state, actions)
        jax.block_until_ready(observations)

    return step


def scanned(worlds: int, steps: int) -> Step:
    """Return steps of all worlds in one compiled `scan`, with the outputs that a learner needs."""
    env = _spread()
    first, *keys = jax.random.split(jax.random.key(SEED), 1 + AGENTS)
    drawn = {
        name: jax.random.randint(key, (steps, worlds), 0, 5)
        for name, key in zip(env.agents, keys, strict=True)
    }
    _, states = jax.vmap(env.reset)(jax.random.split(first, worlds))

    @jax.jit
    def rollout(key: Any, states: Any, drawn: Any) -> Any:  # noqa: ANN401 - trees of arrays
        def one(states: Any, given: Any) -> Any:  # noqa: ANN401
            key, actions = given
            observations, states, rewards, dones, _ = jax.vmap(env.step)(
                jax.random.split(key, worlds), states, actions
            )
            return states, (observations, rewards, dones)

        return jax.lax.scan(one, states, (jax.random.split(key, steps), drawn))

    chunks = cycle(list(jax.random.split(first, ACTIONS)))

    def step() -> None:
        nonlocal states
        states, _ = jax.block_until_ready(rollout(next(chunks), states, drawn))

    return step


if __name__ == "__main__":
    spread = partial(Variant, agents=AGENTS, field=False)
    run(
        "JaxMARL",
        f"{version('jaxmarl')}, jax {version('jax')}",
        [
            spread(name="simple_spread, step", worlds=1, make=stepped),
            spread(
                name="simple_spread, scan", worlds=1, make=partial(scanned, 1, 1000), steps=1000
            ),
            spread(
                name="simple_spread, scan", worlds=1024, make=partial(scanned, 1024, 100), steps=100
            ),
        ],
    )
