"""A driver without a plan: from one random goal to the next.

It drives to a random goal inside Q, and when it is nearer than the tolerance, to another one. A goal is drawn from
the UGV's key and the tick at which it is needed, evenly over Q without a margin along the border. Turning from one
goal to the next a UGV drifts outward by no more than v²/u, twice its stopping distance, so the margin is that and
two ticks' way. It is at most a quarter of Q's shorter side: a UGV that needs more drives slower than it could.
"""

from agents.drivers.parameters import DriverParameters
from agents.drivers.waypoints import goal_control
from sim.kernels.compile import compiled
from sim.kernels.records import RecordArray
from sim.models.randomness import FIRST, SECOND, WANDER, uniform
from sim.models.vehicles import Motion, goal_reached, speed_to_stop_within, stopping_distance


def wander_pace(
    width: float, height: float, v_max: float, u_max: float, dt: float
) -> tuple[float, float]:
    """The largest speed of a wanderer [m/s], and how near to the border its goals may be [m].

    Args:
        width, height: Of Q [m].
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    room = 0.25 * min(width, height)
    speed = min(v_max, speed_to_stop_within(0.5 * room, u_max, dt))
    return speed, 2.0 * (stopping_distance(speed, u_max) + speed * dt)


@compiled
def wander_control(
    parameters: DriverParameters, memory: RecordArray, tick: int, here: Motion
) -> tuple[float, float]:
    """The acceleration [m/s²] to a random goal, and when that is reached to another one.

    Args:
        parameters: Of the driver.
        memory: `DriverMemory`, changed in place. Shape (1,).
        tick: Now.
        here: Where the UGV is.
    """
    m = memory[0]
    if m.chosen == 0 or goal_reached(here.p_x, here.p_y, m.goal_x, m.goal_y, parameters.tolerance):
        key, margin = (parameters.key_0, parameters.key_1), parameters.margin
        m.goal_x = margin + (parameters.width - 2.0 * margin) * uniform(key, WANDER, tick, FIRST)
        m.goal_y = margin + (parameters.height - 2.0 * margin) * uniform(key, WANDER, tick, SECOND)
        m.chosen = 1
    return goal_control(here, m.goal_x, m.goal_y, parameters.speed, parameters.u_max, parameters.dt)
