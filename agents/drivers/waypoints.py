"""The paper's driver: straight to one goal after the other (section II)."""

import math

import numpy as np

from bus.messages import UgvBriefing, UgvObservation
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
    goals: FloatArray,
    state: FloatArray,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    tolerance: float,
    v_max: float,
    u_max: float,
    dt: float,
) -> tuple[float, float]:
    """The acceleration [m/s²] to one goal after the other; to the last one, and without any to where the UGV is.

    Args:
        goals: [m], shape (goals, 2).
        state: Of the driver, changed in place; begins as zeros.
        p_x, p_y: Position [m].
        v_x, v_y: Velocity [m/s].
        tolerance: Nearer than this a goal is reached [m].
        v_max, u_max: Bounds [m/s], [m/s²]; may be infinite.
        dt: Length of a tick [s].
    """
    count = len(goals)
    if count == 0:
        return goal_control(p_x, p_y, v_x, v_y, p_x, p_y, v_max, u_max, dt)
    index = int(state[_INDEX])
    while index < count - 1 and goal_reached(p_x, p_y, goals[index, 0], goals[index, 1], tolerance):
        index += 1
    state[_INDEX] = index
    return goal_control(p_x, p_y, v_x, v_y, goals[index, 0], goals[index, 1], v_max, u_max, dt)


def driver_goals(briefing: UgvBriefing) -> FloatArray:
    """The waypoints of a briefing [m], in order; shape (goals, 2)."""
    return np.array(briefing.goals, dtype=np.float64).reshape(-1, 2)


class WaypointDriver:
    """Keeps a goal until it is nearer than the tolerance, then takes the next; stays at the last."""

    def __init__(self, briefing: UgvBriefing) -> None:
        self._goals = driver_goals(briefing)
        self._state = np.zeros(WAYPOINT_STATE)
        self._tolerance, self._dt = float(briefing.goal_tolerance), float(briefing.dt)
        self._v_max = briefing.limits.max_speed or math.inf
        self._u_max = briefing.limits.max_acceleration or math.inf

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        (p_x, p_y), (v_x, v_y) = observation.position, observation.velocity
        return waypoint_control(
            self._goals,
            self._state,
            p_x,
            p_y,
            v_x,
            v_y,
            self._tolerance,
            self._v_max,
            self._u_max,
            self._dt,
        )
