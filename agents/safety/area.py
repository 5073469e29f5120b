"""Walls of the area: movement of a UAV at the walls, and the distance that plans keep from them.

Positions [m], speeds [m/s], accelerations [m/s²].
"""

import math

from sim.compiling.compile import compiled
from sim.models.safety import SafetyBounds
from sim.models.vehicles import State, norm, step_vehicle, within_walls

RESIDUE = 1e-10
"""Largest velocity component towards a wall that rounding leaves at the end of a plan [m/s]."""

_OFF_WALL = 1e-6
"""Distance that a plan keeps from the walls [m]. A plan that starts nearer leads along the wall or away from it."""

_CLEAR = 1e-9
"""Least distance from a wall at which a plan may approach it [m]; far above the effect of rounding."""


@compiled
def step_in_area(bounds: SafetyBounds, state: State, u_x: float, u_y: float) -> tuple[State, float]:
    """Return the state of the UAV after one tick, by (1) and the walls.

    Returns:
        The state, and the distance between it and the state by (1) alone [m].
    """
    q_x, q_y, w_x, w_y, _, _ = step_vehicle(
        state.p_x, state.p_y, state.v_x, state.v_y, u_x, u_y, bounds.v_a, bounds.u_a, bounds.dt
    )
    x, w_x = within_walls(q_x, w_x, bounds.width)
    y, w_y = within_walls(q_y, w_y, bounds.height)
    return State(x, y, w_x, w_y), norm(q_x - x, q_y - y)


@compiled
def is_in_area(bounds: SafetyBounds, x: float, y: float) -> bool:
    """Return whether a point is in the area, its walls included."""
    return (math.isinf(bounds.width) or 0.0 <= x <= bounds.width) and (
        math.isinf(bounds.height) or 0.0 <= y <= bounds.height
    )


@compiled
def off_walls(p: float, size: float) -> float:
    """Return the nearest coordinate to p at which a return may end: at least 2 `_OFF_WALL` from the walls [m]."""
    if math.isinf(size):
        return p
    return min(max(p, 2.0 * _OFF_WALL), size - 2.0 * _OFF_WALL)


@compiled
def _room(distance: float) -> float:
    """Return the least distance from a wall for a plan that starts at the given distance [m]."""
    return min(_OFF_WALL, distance, max(0.5 * distance, _CLEAR))


@compiled
def _is_off_wall(p: float, v: float, a: float, duration: float, size: float) -> bool:
    """Return whether p + v s + a s²/2 keeps its distance from the walls of one axis for the duration.

    A trajectory that starts within `_OFF_WALL` of a wall may lead along it or away from it. It may halve the distance
    while it brakes or turns. A residual velocity may touch the wall, which then cancels it.
    """
    if math.isinf(size):
        return True
    if not 0.0 <= p <= size:
        return False
    if abs(v) <= RESIDUE:
        v = 0.0
    if v == 0.0 and a == 0.0:
        return True
    end = p + (v + 0.5 * a * duration) * duration
    low = high = end
    if a != 0.0 and 0.0 < -v / a < duration:
        summit = p - 0.5 * v * v / a
        low, high = min(low, summit), max(high, summit)
    return low >= _room(p) and high <= size - _room(size - p)


@compiled
def stays_in_area(
    bounds: SafetyBounds, state: State, a_x: float, a_y: float, duration: float
) -> bool:
    """Return whether a trajectory with constant acceleration keeps its distance from the walls.

    Contact with a wall would make the UAV leave its plan.
    """
    return _is_off_wall(state.p_x, state.v_x, a_x, duration, bounds.width) and _is_off_wall(
        state.p_y, state.v_y, a_y, duration, bounds.height
    )
