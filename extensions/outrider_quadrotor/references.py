"""Aggressive reference trajectories at a UAV's bounds, and wind that changes direction at once. SI units."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from sim.models.body import Influences
from sim.models.vehicles import step_vehicle

_PERIODS = (0.5, 8.0)
"""Shortest and longest mean time between two reversals [s]."""


class Bounds(NamedTuple):
    """Bounds of a UAV and of its disturbances."""

    speed: float
    """Maximum speed [m/s]."""
    acceleration: float
    """Maximum acceleration [m/s²]."""
    wind: float
    """Largest acceleration of the wind [m/s²]."""
    position_error: float
    """Largest error of the measured position [m]."""


class Planar(NamedTuple):
    """Position and velocity in the plane."""

    position: tuple[float, float]
    """Position [m]."""
    velocity: tuple[float, float]
    """Velocity [m/s]."""


Reference = Callable[[Bounds, float, int, np.random.Generator], Iterator[Planar]]
"""Function of bounds, dt [s], number of ticks and random numbers: the state at each tick, ticks + 1 of them."""


def _moved(
    start: Planar, commands: Iterator[tuple[float, float]], bounds: Bounds, dt: float
) -> Iterator[Planar]:
    """Yield the reference at each tick under these commands, (1)."""
    yield start
    (p_x, p_y), (v_x, v_y) = start
    for u_x, u_y in commands:
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(
            p_x, p_y, v_x, v_y, u_x, u_y, bounds.speed, bounds.acceleration, dt
        )
        yield Planar((p_x, p_y), (v_x, v_y))


_AT_REST = Planar((0.0, 0.0), (0.0, 0.0))


def _direction(rng: np.random.Generator) -> tuple[float, float]:
    angle = rng.uniform(-math.pi, math.pi)
    return math.cos(angle), math.sin(angle)


def _time(rng: np.random.Generator) -> float:
    """Return a random time [s]; its logarithm is uniform."""
    shortest, longest = _PERIODS
    return float(shortest * (longest / shortest) ** rng.uniform())


def full_reversals(
    bounds: Bounds, dt: float, ticks: int, rng: np.random.Generator
) -> Iterator[Planar]:
    """Fly to and fro on a line: full acceleration up to the maximum speed, then the opposite one."""
    x, y = _direction(rng)
    wait = max(1, math.ceil(bounds.speed / (bounds.acceleration * dt)))

    def commands() -> Iterator[tuple[float, float]]:
        sign = 1.0
        for tick in range(ticks):
            if tick % (2 * wait) == wait:
                sign = -sign
            yield sign * bounds.acceleration * x, sign * bounds.acceleration * y

    return _moved(_AT_REST, commands(), bounds, dt)


def periodic_reversals(
    bounds: Bounds, dt: float, ticks: int, rng: np.random.Generator
) -> Iterator[Planar]:
    """Reverse the full acceleration with a random period, which may be a resonance of the body."""
    x, y = _direction(rng)
    half = max(1, round(_time(rng) / (2.0 * dt)))

    def commands() -> Iterator[tuple[float, float]]:
        for tick in range(ticks):
            sign = 1.0 if ((2 * tick + half) // (2 * half)) % 2 == 0 else -1.0
            yield sign * bounds.acceleration * x, sign * bounds.acceleration * y

    return _moved(_AT_REST, commands(), bounds, dt)


def random_accelerations(
    bounds: Bounds, dt: float, ticks: int, rng: np.random.Generator
) -> Iterator[Planar]:
    """Apply the full acceleration in random directions, for random times."""
    mean = _time(rng)

    def commands() -> Iterator[tuple[float, float]]:
        x, y = _direction(rng)
        for _ in range(ticks):
            if rng.random() < dt / mean:
                x, y = _direction(rng)
            yield bounds.acceleration * x, bounds.acceleration * y

    return _moved(_AT_REST, commands(), bounds, dt)


def circles(bounds: Bounds, dt: float, ticks: int, rng: np.random.Generator) -> Iterator[Planar]:
    """Fly circles at the maximum speed and acceleration, after a straight start."""
    x, y = _direction(rng)
    turn = 1.0 if rng.random() < 0.5 else -1.0
    run_up = math.ceil(bounds.speed / (bounds.acceleration * dt))
    # half a tick ahead of the velocity, so that the speed stays at its maximum
    step = bounds.acceleration * dt / bounds.speed

    def commands() -> Iterator[tuple[float, float]]:
        heading = math.atan2(y, x)
        for tick in range(ticks):
            angle = heading
            if tick >= run_up:
                heading += turn * step
                angle = heading - 0.5 * turn * step + turn * 0.5 * math.pi
            yield bounds.acceleration * math.cos(angle), bounds.acceleration * math.sin(angle)

    return _moved(_AT_REST, commands(), bounds, dt)


def walls(bounds: Bounds, dt: float, ticks: int, rng: np.random.Generator) -> Iterator[Planar]:
    """Fly against a wall at full speed, where the reference stops at once; then back, against the next one."""
    x, y = _direction(rng)
    wait = 2 * max(1, math.ceil(bounds.speed / (bounds.acceleration * dt)))
    (p_x, p_y), (v_x, v_y) = _AT_REST
    sign = 1.0
    for tick in range(ticks + 1):
        yield Planar((p_x, p_y), (v_x, v_y))
        u_x, u_y = sign * bounds.acceleration * x, sign * bounds.acceleration * y
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(
            p_x, p_y, v_x, v_y, u_x, u_y, bounds.speed, bounds.acceleration, dt
        )
        if tick % wait == wait - 1:
            v_x, v_y, sign = 0.0, 0.0, -sign


REFERENCES: dict[str, Reference] = {
    "full reversals": full_reversals,
    "periodic reversals": periodic_reversals,
    "random accelerations": random_accelerations,
    "circles at the speed limit": circles,
    "stops at walls": walls,
}
"""References by name, in the order of the table."""


def influences(bounds: Bounds, dt: float, rng: np.random.Generator) -> Iterator[Influences]:
    """Yield wind and position error at their bounds, in directions that change at random times, without end."""

    def scaled(size: float) -> tuple[float, float]:
        x, y = _direction(rng)
        return size * x, size * y

    mean = _time(rng)
    now = Influences(scaled(bounds.wind), scaled(bounds.position_error))
    while True:
        if rng.random() < dt / mean:
            now = now._replace(wind=scaled(bounds.wind))
        if rng.random() < dt / mean:
            now = now._replace(position_error=scaled(bounds.position_error))
        yield now
