"""The paper's driver: straight to one goal after the other (section II)."""

from agents.drivers.parameters import DriverParameters
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray
from sim.models.vehicles import Motion, clip_norm, next_goal, norm, speed_to_stop_within


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


@compiled
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
    goal_x, goal_y, own = here.p_x, here.p_y, memory[0]
    if len(goals) > 0:
        reached, _ = next_goal(goals, own.goal, parameters.tolerance, here.p_x, here.p_y)
        own.goal = min(reached, len(goals) - 1)
        goal_x, goal_y = goals[own.goal, 0], goals[own.goal, 1]
    return goal_control(here, goal_x, goal_y, parameters.v_max, parameters.u_max, parameters.dt)
