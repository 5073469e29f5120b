"""The vehicles: double integrators with bounds (1), and what every driver of one needs."""

import math
from typing import NamedTuple

from sim.compiling.compile import FloatArray, compiled


class Motion(NamedTuple):
    """A vehicle's position and velocity."""

    p_x: float
    p_y: float
    """Position [m]."""
    v_x: float
    v_y: float
    """Velocity [m/s]."""


@compiled
def norm(x: float, y: float) -> float:
    """Length of a vector. Not `hypot`, whose bits differ between Python and compiled code."""
    return math.sqrt(x * x + y * y)


@compiled
def clip_norm(x: float, y: float, limit: float) -> tuple[float, float]:
    """The vector, shortened to `limit` where it is longer; its direction stays. `limit` may be infinite."""
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
    r"""Move one vehicle over one tick, Klodt 2015, eq. (1).

    $$ \ddot p = u, \quad \|u\| \le u_{max}, \quad \|\dot p\| \le v_{max} $$

    With the command held over the tick the motion is exact: $u \leftarrow clip(u)$, $v^+ = clip(v + u\,dt)$,
    $p^+ = p + \tfrac12 (v + v^+)\,dt$. The bounds are on the norms, not per axis.

    Args:
        p_x, p_y: Position [m].
        v_x, v_y: Velocity [m/s].
        u_x, u_y: Acceleration command [m/s²].
        v_max: Largest speed [m/s], may be infinite.
        u_max: Largest acceleration [m/s²], may be infinite.
        dt: Length of the tick [s].

    Returns:
        Position, velocity and the acceleration that was applied after its bound, x before y.
    """
    u_x, u_y = clip_norm(u_x, u_y, u_max)
    w_x, w_y = clip_norm(v_x + u_x * dt, v_y + u_y * dt, v_max)
    return p_x + 0.5 * (v_x + w_x) * dt, p_y + 0.5 * (v_y + w_y) * dt, w_x, w_y, u_x, u_y


@compiled
def within_walls(p: float, v: float, size: float) -> tuple[float, float]:
    """Position [m] and velocity [m/s] on one axis of an area.

    A vehicle that runs into a wall, at 0 or `size` [m], stops there.

    An infinite size means that there are no walls on this axis, at 0 neither.
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
    """The acceleration [m/s²] that stops a vehicle as soon as its bound allows, without turning back."""
    return clip_norm(-v_x / dt, -v_y / dt, u_max)


@compiled
def raw_switching_radius(r_v: float, v_a: float, v_g: float, u_a: float) -> float:
    r"""The right side of (18) in one phase, $r_v - (v_a + v_g)^2 / (2 u_a)$ [m], whatever its sign."""
    return r_v - stopping_distance(v_a + v_g, u_a)


@compiled
def speed_to_stop_within(distance: float, u_max: float, dt: float) -> float:
    r"""The largest speed [m/s] from which a sampled vehicle still stops within `distance` [m].

    It may fly one more tick before it brakes: $v\,dt + v^2/(2u) = d$. A caller whose speed changes within the
    coming tick takes off what that tick still goes at the old one.
    """
    if math.isinf(u_max):
        return max(distance, 0.0) / dt
    reach = u_max * dt
    return math.sqrt(reach * reach + 2.0 * u_max * max(distance, 0.0)) - reach


@compiled
def goal_reached(p_x: float, p_y: float, goal_x: float, goal_y: float, tolerance: float) -> bool:
    r"""True if a goal counts as reached: $\|p_g - \bar p\| < \epsilon$ (section II of the paper)."""
    return norm(p_x - goal_x, p_y - goal_y) < tolerance


@compiled
def next_goal(
    goals: FloatArray, reached: int, tolerance: float, x: float, y: float
) -> tuple[int, float]:
    """The number of goals reached from (x, y) [m] on, and the way to the next one [m]; 0 where none is left."""
    while reached < goals.shape[0] and goal_reached(
        x, y, goals[reached, 0], goals[reached, 1], tolerance
    ):
        reached += 1
    if reached == goals.shape[0]:
        return reached, 0.0
    return reached, norm(x - goals[reached, 0], y - goals[reached, 1])


@compiled
def stopping_distance(speed: float, u_max: float) -> float:
    r"""Way to a stop [m] from `speed` [m/s] at the deceleration `u_max` [m/s²]: $v^2 / (2u)$.

    0 where it has no bound.
    """
    if math.isinf(u_max):
        return 0.0
    return speed * speed / (2.0 * u_max)
