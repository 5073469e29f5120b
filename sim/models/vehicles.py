"""Vehicle model: double integrators with bounds (1), and functions shared by all controllers."""

import math
from typing import NamedTuple

from sim.compiling.compile import FloatArray, compiled


class State(NamedTuple):
    """Position and velocity of a vehicle."""

    p_x: float
    p_y: float
    """Position [m]."""
    v_x: float
    v_y: float
    """Velocity [m/s]."""


@compiled
def norm(x: float, y: float) -> float:
    """Return the length of a vector. Not `hypot`, whose bits differ between Python and compiled code."""
    return math.sqrt(x * x + y * y)


@compiled
def clip_norm(x: float, y: float, limit: float) -> tuple[float, float]:
    """Return the vector, shortened to `limit` if longer; its direction stays. `limit` may be infinite."""
    length = norm(x, y)
    if length > limit:
        scale = limit / length
        return x * scale, y * scale
    return x, y


@compiled
def step_vehicle(
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    u_x: float,
    u_y: float,
    v_max: float,
    u_max: float,
    dt: float,
) -> tuple[float, float, float, float, float, float]:
    r"""Move one vehicle by one tick, Klodt 2015, eq. (1).

    $$ \ddot p = u, \quad \|u\| \le u_{max}, \quad \|\dot p\| \le v_{max} $$

    With a constant command within the tick the motion is exact: $u \leftarrow clip(u)$, $v^+ = clip(v + u\,dt)$, $p^+ =
    p + \tfrac12 (v + v^+)\,dt$. The bounds apply to the norms, not per axis.

    Args:
        p_x, p_y: Position [m].
        v_x, v_y: Velocity [m/s].
        u_x, u_y: Acceleration command [m/s²].
        v_max: Maximum speed [m/s], may be infinite.
        u_max: Maximum acceleration [m/s²], may be infinite.
        dt: Duration of a tick [s].

    Returns:
        Position, velocity and applied acceleration after the bounds, x before y.
    """
    u_x, u_y = clip_norm(u_x, u_y, u_max)
    w_x, w_y = clip_norm(v_x + u_x * dt, v_y + u_y * dt, v_max)
    return p_x + 0.5 * (v_x + w_x) * dt, p_y + 0.5 * (v_y + w_y) * dt, w_x, w_y, u_x, u_y


@compiled
def within_walls(p: float, v: float, size: float) -> tuple[float, float]:
    """Return position [m] and velocity [m/s] on one axis after a check for walls.

    A vehicle that reaches a wall, at 0 or `size` [m], stops there.

    An infinite size means that there are no walls on this axis, not even at 0.
    """
    if math.isinf(size):
        return p, v
    if p < 0.0:
        return 0.0, max(v, 0.0)
    if p > size:
        return size, min(v, 0.0)
    return p, v


@compiled
def brake(v_x: float, v_y: float, u_max: float, dt: float) -> tuple[float, float]:
    """Return the acceleration [m/s²] that stops a vehicle as soon as possible, without reversing."""
    return clip_norm(-v_x / dt, -v_y / dt, u_max)


def raw_switching_radius(r_v: float, v_a: float, v_g: float, u_a: float) -> float:
    r"""Return the right side of (18), $r_v - (v_a + v_g)^2 / (2 u_a)$ [m], of either sign."""
    speed = v_a + v_g
    return r_v - (0.0 if math.isinf(u_a) else speed * speed / (2.0 * u_a))


@compiled
def speed_to_stop_within(distance: float, u_max: float, dt: float) -> float:
    r"""Return the largest speed [m/s] from which a sampled vehicle can stop within `distance` [m].

    The vehicle may move for one more tick before it brakes: $v\,dt + v^2/(2u) = d$. A caller whose speed changes within
    the next tick must subtract the distance driven at the old speed.
    """
    if math.isinf(u_max):
        return max(distance, 0.0) / dt
    step = u_max * dt
    return math.sqrt(step * step + 2.0 * u_max * max(distance, 0.0)) - step


@compiled
def goal_reached(p_x: float, p_y: float, goal_x: float, goal_y: float, tolerance: float) -> bool:
    r"""Return whether a goal is reached: $\|p_g - \bar p\| < \epsilon$ (section II of the paper)."""
    return norm(p_x - goal_x, p_y - goal_y) < tolerance


@compiled
def next_goal(
    goals: FloatArray, reached: int, tolerance: float, x: float, y: float
) -> tuple[int, float]:
    """Return the number of goals reached at (x, y) [m], and the distance to the next one [m]; 0 if none is left."""
    while reached < goals.shape[0] and goal_reached(
        x, y, goals[reached, 0], goals[reached, 1], tolerance
    ):
        reached += 1
    if reached == goals.shape[0]:
        return reached, 0.0
    return reached, norm(x - goals[reached, 0], y - goals[reached, 1])


@compiled
def stopping_distance(speed: float, u_max: float) -> float:
    r"""Return the stopping distance [m] from `speed` [m/s] at the deceleration `u_max` [m/s²]: $v^2 / (2u)$.

    It is 0 for an infinite deceleration.
    """
    if math.isinf(u_max):
        return 0.0
    return speed * speed / (2.0 * u_max)
