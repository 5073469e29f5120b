"""One world: its kernels alone, in C and in NumPy, the step that calls them, and the environment around it."""

from collections.abc import Callable

import numpy as np

from outrider.bench import reference
from outrider.bench.c_kernels import CKernels
from outrider.bench.timing import Pair, rate
from sim.kernels.compile import FloatArray, compiled
from sim.models.field import accumulate, coverage_error, coverage_gradient
from sim.scenario.loading import load_scenario
from sim.world import World

_PASSES = 20_000


@compiled
def passes(coverage: FloatArray, count: int) -> float:
    """The three kernels in a compiled loop: what is left when nothing else is done."""
    total = 0.0
    for k in range(count):
        x = 20.0 + 1e-4 * k
        accumulate(coverage, x, 20.0, 0, 1.0, 5.0, 0.25, 0.0)
        total += coverage_error(coverage, x, 21.0, 9.75, 2.0, 0.25)
        total += coverage_gradient(coverage, x, 20.0, x, 21.0, 9.75, 2.0, 0, 1.0, 5.0, 0.25)[0]
    return total


def ground() -> FloatArray:
    """A grid with coverage of all kinds, C* = 2."""
    return np.random.default_rng(0).uniform(0.0, 2.5, (160, 160))


def kernel_rate(coverage: FloatArray) -> float:
    """Passes of the three kernels a second."""
    passes(coverage, 10)
    return rate(lambda: passes(coverage, _PASSES), 1) * _PASSES


def kernel_vs_numpy() -> Pair:
    """Coverage, error and gradient once, compiled, beside the plain NumPy reference."""
    coverage = ground()

    def plain() -> None:
        reference.accumulate(coverage, 20.0, 20.0, 0, 1.0, 5.0, 0.25, 0.0)
        reference.coverage_error(coverage, 20.0, 21.0, 9.75, 2.0, 0.25)
        reference.coverage_gradient(coverage, 20.0, 20.0, 20.0, 21.0, 9.75, 2.0, 0, 1.0, 5.0, 0.25)

    return kernel_rate(coverage), rate(plain, 50)


def kernel_vs_c(*, lanes: bool) -> Pair:
    """The same three, beside C that is checked to compute the same: with one running sum, or with our eight lanes."""
    coverage = ground()
    ours = kernel_rate(coverage)
    with CKernels.build() as kernels:
        if kernels is None:
            return ours, None
        kernels.check()
        kernels.passes(coverage, 10, lanes=lanes)
        return ours, rate(lambda: kernels.passes(coverage, _PASSES, lanes=lanes), 1) * _PASSES


def world_stepper() -> Callable[[], None]:
    """Each call is a `World.step` with coverage, detections, error (4) and gradient (6)."""
    world = World(load_scenario("escort"), 1)
    world.coverage[:] = ground()
    commands = np.zeros((2, 2))
    w = world.parameters
    looks = (w.r_o, w.desired, w.sensor, w.peak, w.reach, w.cell)

    def step() -> None:
        world.step(commands)
        world.received(0)
        world.measure()
        (p_ax, p_ay), (p_gx, p_gy) = world.position.tolist()
        coverage_gradient(world.coverage, p_ax, p_ay, p_gx, p_gy, *looks)

    return step


def world_step() -> Pair:
    """The world's step beside the three kernels alone."""
    step = world_stepper()
    rate(step, 200)
    return rate(step, 20_000), kernel_rate(ground())


def env_step() -> Pair:
    """`parallel_env().step` with random actions, beside the world alone."""
    from sim.env.parallel import parallel_env  # noqa: PLC0415 - pettingzoo is loaded only where it is used

    env = parallel_env("escort")
    env.reset(seed=1)
    rng = np.random.default_rng(1)
    actions = [
        {name: rng.uniform(-0.05, 0.05, 2) for name in env.possible_agents} for _ in range(64)
    ]
    steps = 0

    def step() -> None:
        nonlocal steps
        if not env.agents:
            env.reset()
        env.step({name: actions[steps % 64][name] for name in env.agents})
        steps += 1

    rate(step, 200)
    return rate(step, 20_000), world_step()[0]
