r"""Search for a UGV out of sight: an Archimedean spiral around its newest measurement.

docs/explanation/proof.md, "Search", states when a search sees the UGV again. It begins where the safety filter has no
checked trajectory and the UGV may have left the radius R within which it is visible from its newest measured position.
The UAV flies to this position, then along the spiral $r = p\,\varphi/(2\pi)$ to the farthest point at which the UGV
can be, back inward, and so on. It knows the walls: parts of the spiral outside of the area are projected onto them, and
those farther than half a pitch outside are left out, as nothing in the area is nearest to them.

Positions in the world's frame [m], speeds [m/s], accelerations [m/s²], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.safety.discs import Disc, disc_in, drift, newest_disc
from agents.safety.memory import FilterMemory, SpiralSearch
from sim.compiling.compile import compiled
from sim.models.safety import SafetyBounds
from sim.models.vehicles import State, clip_norm, norm, within_walls

_OVERLAP = 0.15
"""Reserve of the pitch, as a share of R: `DRIFT`, the motion within a tick and half a step of the pursued point."""

DRIFT = 0.1
"""Distance by which the UGV may move without escaping the search, as a share of R."""

_LEAST_REACH = 0.1
"""Smallest distance from the UAV to the point that it pursues, as a share of R."""

_TURNING = 0.5
"""Share of the maximum acceleration for the curvature of the spiral; the rest corrects deviations."""

_MOST_STEPS = 64
"""Largest number of steps of the pursued point in a tick."""

_STEP = 0.125
"""Length of a step, as a share of the reach."""


class Spiral(NamedTuple):
    """Spiral that fits a UAV's sight and its maximum speed and acceleration."""

    pitch: float
    """p: distance between two turns [m]."""
    speed: float
    """Largest speed on it [m/s]."""
    reach: float
    r"""$\delta$: distance from the UAV to the point that it pursues, and the largest deviation of its path [m]."""


@compiled
def spiral_of(bounds: SafetyBounds) -> Spiral:
    r"""Return the spiral of a search.

    $$ v = \min\left(v_a, \sqrt{\tfrac43 u_a R}, \tfrac{R}{40\,dt}\right), \quad
    \delta = \max\left(\tfrac{R}{10}, \tfrac{v^2}{4 u_a}\right), \quad p = 2\,(0.85\,R - \delta) $$

    A faster UAV deviates more; the second speed gives the largest swept area per time.
    """
    radius = max(bounds.search_radius, 0.0)
    fastest = math.sqrt(4.0 / 3.0 * bounds.u_a * radius)
    least = _LEAST_REACH * radius
    speed = min(bounds.v_a, fastest, 0.25 * least / bounds.dt)
    reach = max(least, 0.25 * speed * speed / bounds.u_a)
    return Spiral(2.0 * ((1.0 - _OVERLAP) * radius - reach), speed, reach)


@compiled
def spiral_speed(spiral: Spiral, u_a: float, phase: float) -> float:
    """Return the speed at an angle of the spiral [m/s]: slower where it is strongly curved, at its centre."""
    b = spiral.pitch / (2.0 * math.pi)
    square = 1.0 + phase * phase
    curve = b * square * math.sqrt(square) / (1.0 + square)
    return min(spiral.speed, math.sqrt(_TURNING * u_a * curve))


def search_time(
    bounds: SafetyBounds, distance: float, start: tuple[float, float] | None = None
) -> float:
    r"""Return the time from the start of the spiral until all ground within a distance has been in sight [s].

    $$ T(D) = \frac{v}{u_a} + \int_0^{\Phi} \frac{\lvert s'(\varphi) \rvert}{v(\varphi)}\, d\varphi, \quad
    \Phi = 2 \pi \left( \frac{D}{p} + \frac12 \right) $$

    Args:
        bounds: Bounds of the filter.
        distance: D, measured from the centre of the spiral [m].
        start: Centre of the spiral; the path is then that in the area, with $2 v/u_a$ for each turn at a wall. None:
            the path in the open plane, which is never shorter.
    """
    spiral = spiral_of(bounds)
    if not spiral.pitch > 0.0:
        return math.inf
    b, end = spiral.pitch / (2.0 * math.pi), 2.0 * math.pi * (distance / spiral.pitch + 0.5)
    phases = np.linspace(0.0, end, 1 + math.ceil(200.0 * end))
    speeds = np.array([spiral_speed(spiral, bounds.u_a, phase) for phase in phases])
    points = b * phases[:, None] * np.stack((np.cos(phases), np.sin(phases)), axis=-1)
    turning = spiral.speed / bounds.u_a
    if start is not None:
        there = points + start
        points = np.clip(there, 0.0, (bounds.width, bounds.height))
        outside = np.linalg.norm(there - points, axis=-1)
        flown = outside <= 0.5 * spiral.pitch
        turning *= 1.0 + 2.0 * np.count_nonzero(np.diff(outside > 0.0))
        points, speeds = points[flown], speeds[flown]
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    return float(turning + (lengths / speeds[:-1]).sum())


@compiled
def may_be_lost(bounds: SafetyBounds, disc: Disc, tick: int) -> bool:
    """Return whether the UGV may be out of sight for a UAV above its newest measurement."""
    error = disc.radius if math.isfinite(disc.radius) else 0.0
    return bool(error + drift(bounds, tick - disc.tick) > bounds.search_radius)


@compiled
def _farthest_point(bounds: SafetyBounds, disc: Disc, tick: int) -> float:
    """Return the largest distance from the newest measurement at which the UGV can be [m]."""
    x, y = max(disc.x, bounds.width - disc.x), max(disc.y, bounds.height - disc.y)
    return min(norm(x, y), disc.radius + drift(bounds, tick - disc.tick))


@compiled
def _begin(bounds: SafetyBounds, search: SpiralSearch, disc: Disc, own: State) -> None:
    """Begin a search; its spiral first leads on in the direction in which the measurement is, or to the middle."""
    x, y = disc.x - own.p_x, disc.y - own.p_y
    if norm(x, y) <= search.reach and math.isfinite(bounds.width + bounds.height):
        x, y = 0.5 * bounds.width - disc.x, 0.5 * bounds.height - disc.y
    search.tick, search.heading = disc.tick, math.atan2(y, x)
    search.phase, search.direction = 0.0, 0.0


@compiled
def spiral_point(
    bounds: SafetyBounds, pitch: float, heading: float, phase: float, disc: Disc
) -> tuple[float, float, float]:
    """Return a point of the spiral, projected onto the area, and how far outside of the area it was [m]."""
    r = pitch / (2.0 * math.pi) * phase
    x, y = disc.x + r * math.cos(heading + phase), disc.y + r * math.sin(heading + phase)
    q_x, _ = within_walls(x, 0.0, bounds.width)
    q_y, _ = within_walls(y, 0.0, bounds.height)
    return q_x, q_y, norm(x - q_x, y - q_y)


@compiled
def _pursue(
    bounds: SafetyBounds, search: SpiralSearch, spiral: Spiral, disc: Disc, tick: int, own: State
) -> tuple[float, float]:
    """Advance the pursued point until it is the reach away, and return the acceleration towards it [m/s²]."""
    x, y = own.p_x + own.v_x * bounds.dt, own.p_y + own.v_y * bounds.dt
    b = spiral.pitch / (2.0 * math.pi)
    farthest = _farthest_point(bounds, disc, tick)
    d_x, d_y = 0.0, 0.0
    for _ in range(_MOST_STEPS):
        q_x, q_y, outside = spiral_point(bounds, spiral.pitch, search.heading, search.phase, disc)
        d_x, d_y = q_x - x, q_y - y
        if norm(d_x, d_y) > spiral.reach and outside <= 0.5 * spiral.pitch:
            break
        turned = _STEP * spiral.reach / (b * math.sqrt(1.0 + search.phase * search.phase))
        search.phase = max(0.0, search.phase + search.direction * turned)
        if search.phase == 0.0:
            search.direction = 1.0
        elif b * search.phase > farthest + 0.5 * spiral.pitch:
            search.direction = -1.0
    distance = norm(d_x, d_y)
    speed = spiral_speed(spiral, bounds.u_a, search.phase)
    share = speed / distance if distance > 0.0 else 0.0
    return clip_norm(
        (share * d_x - own.v_x) / bounds.dt, (share * d_y - own.v_y) / bounds.dt, bounds.u_a
    )


@compiled
def search_control(
    bounds: SafetyBounds, memory: FilterMemory, tick: int, own: State, u_x: float, u_y: float
) -> tuple[float, float]:
    """Return the acceleration of the search if the UGV may be out of sight, else the best effort [m/s²].

    Args:
        bounds: Bounds of the filter.
        memory: Memory of the filter; its search is changed in place.
        tick: Tick in which the command takes effect.
        own: State of the UAV at that tick.
        u_x, u_y: Best effort: the acceleration towards the newest measurement [m/s²].
    """
    new = newest_disc(memory.discs)
    if not bounds.search or new < 0:
        return u_x, u_y
    disc, search = disc_in(memory.discs, new), memory.search[0]
    if not may_be_lost(bounds, disc, tick):
        return u_x, u_y
    spiral = spiral_of(bounds)
    if not spiral.pitch > 0.0:
        return u_x, u_y
    if search.tick != disc.tick:
        search.pitch, search.speed, search.reach = spiral
        _begin(bounds, search, disc, own)
    spiral = Spiral(search.pitch, search.speed, search.reach)
    if search.direction == 0.0:
        if norm(disc.x - own.p_x, disc.y - own.p_y) > spiral.reach:
            return u_x, u_y
        search.direction = 1.0
    return _pursue(bounds, search, spiral, disc, tick, own)
