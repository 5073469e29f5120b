"""The paper's driver: straight to one goal after the other (section II)."""

from agents.drivers.parameters import DriverParameters
from sim.kernels.compile import FloatArray, borrowing, compiled
from sim.kernels.records import RecordArray
from sim.models.vehicles import Motion, clip_norm, goal_reached, norm, speed_to_stop_within


@compiled
def goal_control(
    here: Motion, goal_x: float, goal_y: float, v_max: float, u_max: float, dt: float
) -> tuple[float, float]:
    """The stabilizing controller f(p_g, goal) [m/s²]: straight, as fast as the bounds allow, braking in time.

    Args:
        here: Where the UGV is.
        goal_x, goal_y: The goal [m].
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    d_x, d_y = goal_x - here.p_x, goal_y - here.p_y
    distance = norm(d_x, d_y)
    w_x, w_y = 0.0, 0.0
    if distance > 0.0:
        e_x, e_y = d_x / distance, d_y / distance
        # half of the coming tick goes at the old speed
        rest = distance - 0.5 * dt * max(here.v_x * e_x + here.v_y * e_y, 0.0)
        speed = min(v_max, speed_to_stop_within(rest, u_max, dt))
        w_x, w_y = e_x * speed, e_y * speed
    return clip_norm((w_x - here.v_x) / dt, (w_y - here.v_y) / dt, u_max)


@borrowing
def waypoint_control(
    parameters: DriverParameters, goals: FloatArray, memory: RecordArray, here: Motion
) -> tuple[float, float]:
    """The acceleration [m/s²] to one goal after the other; to the last one, and without any to where the UGV is.

    A goal is kept until it is nearer than the tolerance; then comes the next one, and the last one stays.

    Args:
        parameters: Of the driver; its bounds may be infinite.
        goals: [m], shape (goals, 2).
        memory: `DriverMemory`, changed in place. Shape (1,).
        here: Where the UGV is.
    """
    count = len(goals)
    if count == 0:
        return goal_control(
            here, here.p_x, here.p_y, parameters.v_max, parameters.u_max, parameters.dt
        )
    index = memory[0].goal
    while index < count - 1 and goal_reached(
        here.p_x, here.p_y, goals[index, 0], goals[index, 1], parameters.tolerance
    ):
        index += 1
    memory[0].goal = index
    return goal_control(
        here, goals[index, 0], goals[index, 1], parameters.v_max, parameters.u_max, parameters.dt
    )
