"""The paper's driver: straight to one goal after the other (section II)."""

from agents.drivers.parameters import DriverParameters
from sim.kernels.compile import FloatArray, compiled
from sim.models.vehicles import clip_norm, goal_reached, norm, speed_to_stop_within

_INDEX = 0  # row of the state: which goal it drives to
WAYPOINT_STATE = 1


@compiled
def goal_control(
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    goal_x: float,
    goal_y: float,
    v_max: float,
    u_max: float,
    dt: float,
) -> tuple[float, float]:
    """The stabilizing controller f(p_g, goal) [m/s²]: straight, as fast as the bounds allow, braking in time.

    Args:
        p_x, p_y: Position [m].
        v_x, v_y: Velocity [m/s].
        goal_x, goal_y: The goal [m].
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    d_x, d_y = goal_x - p_x, goal_y - p_y
    distance = norm(d_x, d_y)
    w_x, w_y = 0.0, 0.0
    if distance > 0.0:
        e_x, e_y = d_x / distance, d_y / distance
        rest = distance - 0.5 * dt * max(
            v_x * e_x + v_y * e_y, 0.0
        )  # half of the coming tick goes at the old speed
        speed = min(v_max, speed_to_stop_within(rest, u_max, dt))
        w_x, w_y = e_x * speed, e_y * speed
    return clip_norm((w_x - v_x) / dt, (w_y - v_y) / dt, u_max)


@compiled
def waypoint_control(
    p: DriverParameters,
    goals: FloatArray,
    state: FloatArray,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
) -> tuple[float, float]:
    """The acceleration [m/s²] to one goal after the other; to the last one, and without any to where the UGV is.

    A goal is kept until it is nearer than the tolerance; then comes the next one, and the last one stays.

    Args:
        p: Of the driver; its bounds may be infinite.
        goals: [m], shape (goals, 2).
        state: Of the driver, changed in place; begins as zeros.
        p_x, p_y: Position [m].
        v_x, v_y: Velocity [m/s].
    """
    count = len(goals)
    if count == 0:
        return goal_control(p_x, p_y, v_x, v_y, p_x, p_y, p.v_max, p.u_max, p.dt)
    index = int(state[_INDEX])
    while index < count - 1 and goal_reached(
        p_x, p_y, goals[index, 0], goals[index, 1], p.tolerance
    ):
        index += 1
    state[_INDEX] = index
    return goal_control(
        p_x, p_y, v_x, v_y, goals[index, 0], goals[index, 1], p.v_max, p.u_max, p.dt
    )
