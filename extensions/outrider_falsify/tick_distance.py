"""Largest distance of two vehicles within a tick, between the recorded states."""

import math

from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.models.vehicles import norm


@compiled
def largest_in_tick(
    r_x: float, r_y: float, v_x: float, v_y: float, w_x: float, w_y: float, dt: float
) -> float:
    """Return the largest distance of two vehicles with constant accelerations within a tick [m].

    The derivative of half the squared distance is a cubic in time, with at most one root between stationary points.

    Args:
        r_x, r_y: Relative position at the tick's start [m].
        v_x, v_y: Relative velocity at the tick's start [m/s].
        w_x, w_y: Relative velocity at the tick's end [m/s].
        dt: Length of the tick [s].
    """
    a_x, a_y = (w_x - v_x) / dt, (w_y - v_y) / dt
    c_0, c_1 = r_x * v_x + r_y * v_y, v_x * v_x + v_y * v_y + r_x * a_x + r_y * a_y
    c_2, c_3 = 1.5 * (v_x * a_x + v_y * a_y), 0.5 * (a_x * a_x + a_y * a_y)
    first = second = dt  # stationary points of the derivative
    root = c_2 * c_2 - 3.0 * c_3 * c_1
    if c_3 > 0.0 and root > 0.0:
        first = min(max((-c_2 - math.sqrt(root)) / (3.0 * c_3), 0.0), dt)
        second = min(max((-c_2 + math.sqrt(root)) / (3.0 * c_3), 0.0), dt)
    elif c_3 == 0.0 and c_2 != 0.0:
        first = min(max(-0.5 * c_1 / c_2, 0.0), dt)
    most = max(norm(r_x, r_y), norm(r_x + 0.5 * (v_x + w_x) * dt, r_y + 0.5 * (v_y + w_y) * dt))
    for k in range(3):
        low = 0.0 if k == 0 else (first if k == 1 else second)
        high = first if k == 0 else (second if k == 1 else dt)
        if (
            ((c_3 * low + c_2) * low + c_1) * low + c_0
            > 0.0
            > ((c_3 * high + c_2) * high + c_1) * high + c_0
        ):
            for _ in range(50):
                middle = 0.5 * (low + high)
                if ((c_3 * middle + c_2) * middle + c_1) * middle + c_0 > 0.0:
                    low = middle
                else:
                    high = middle
            most = max(
                most, norm(r_x + (v_x + 0.5 * a_x * low) * low, r_y + (v_y + 0.5 * a_y * low) * low)
            )
    return most


@compiled
def _bounced(p: float, v: float, after: float, w: float, dt: float) -> bool:
    """Return true if the vehicle met a wall: constant acceleration does not connect its states on this axis."""
    return abs(after - p - 0.5 * (v + w) * dt) > 1e-12


@compiled
def largest_between(before: RecordArray, after: RecordArray, dt: float) -> float:
    """Return the largest distance of two vehicles within the last tick [m].

    If a vehicle met a wall, only the ends of the tick are compared.

    Args:
        before, after: `State` of both vehicles. Shape (2,).
        dt: Length of the tick [s].
    """
    a, g, b, h = before[0], before[1], after[0], after[1]
    r_x, r_y = a.p_x - g.p_x, a.p_y - g.p_y
    most = max(norm(r_x, r_y), norm(b.p_x - h.p_x, b.p_y - h.p_y))
    for k in range(2):
        one, then = before[k], after[k]
        if _bounced(one.p_x, one.v_x, then.p_x, then.v_x, dt):
            return most
        if _bounced(one.p_y, one.v_y, then.p_y, then.v_y, dt):
            return most
    v_x, v_y, w_x, w_y = a.v_x - g.v_x, a.v_y - g.v_y, b.v_x - h.v_x, b.v_y - h.v_y
    return max(most, largest_in_tick(r_x, r_y, v_x, v_y, w_x, w_y, dt))
