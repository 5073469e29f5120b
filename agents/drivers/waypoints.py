"""The paper's driver: straight to one goal after the other (section II)."""

import math

from bus.messages import UgvBriefing, UgvObservation
from sim.compile import compiled
from sim.vehicles import clip_norm, goal_reached, norm, speed_to_stop_within


@compiled
def goal_control(
    p_x: float, p_y: float, v_x: float, v_y: float, goal_x: float, goal_y: float, v_max: float, u_max: float, dt: float
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
        rest = distance - 0.5 * dt * max(v_x * e_x + v_y * e_y, 0.0)  # half of the coming tick goes at the old speed
        speed = min(v_max, speed_to_stop_within(rest, u_max, dt))
        w_x, w_y = e_x * speed, e_y * speed
    return clip_norm((w_x - v_x) / dt, (w_y - v_y) / dt, u_max)


class WaypointDriver:
    """Keeps a goal until it is nearer than the tolerance, then takes the next; stays at the last."""

    def __init__(self, briefing: UgvBriefing) -> None:
        self._briefing = briefing
        self._goals = tuple((float(x), float(y)) for x, y in briefing.goals)
        self._index = 0
        self._v_max = briefing.limits.max_speed or math.inf
        self._u_max = briefing.limits.max_acceleration or math.inf

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        p_x, p_y = observation.position
        while self._index < len(self._goals) - 1 and goal_reached(
            p_x, p_y, *self._goals[self._index], self._briefing.goal_tolerance
        ):
            self._index += 1
        goal = self._goals[self._index] if self._goals else observation.position
        v_x, v_y = observation.velocity
        u_x, u_y = goal_control(p_x, p_y, v_x, v_y, goal[0], goal[1], self._v_max, self._u_max, self._briefing.dt)
        return u_x, u_y
