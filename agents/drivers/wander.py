"""A driver without a plan: from one random goal to the next."""

from agents.drivers.steering import Steering
from bus.messages import UgvBriefing, UgvObservation
from sim.randomness import WANDER, uniform
from sim.vehicles import goal_reached, speed_to_stop_within, stopping_distance


class WanderDriver:
    """Drives to a random goal inside Q, and when it is nearer than the tolerance, to another one.

    A goal is drawn from the UGV's key and the tick at which it is needed, evenly over Q without a margin along the border.
    Turning from one goal to the next a UGV drifts outward by no more than v²/u, twice its stopping distance, so the margin is
    that and two ticks' way. It is at most a quarter of Q's shorter side: a UGV that needs more drives slower than it could.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._briefing = briefing
        self._steering = Steering(briefing)
        wheel, width, height = self._steering, float(briefing.area.width), float(briefing.area.height)
        room = 0.25 * min(width, height)
        self.speed = min(wheel.v_max, speed_to_stop_within(0.5 * room, wheel.u_max, wheel.dt))
        """The largest speed that it drives at [m/s]."""
        self.margin = 2.0 * (stopping_distance(self.speed, wheel.u_max) + self.speed * wheel.dt)
        """Its goals are no nearer to the border than this [m]."""
        self.goal: tuple[float, float] | None = None
        """Where it drives to [m]; None before the first observation."""

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        p_x, p_y = observation.position
        if self.goal is None or goal_reached(p_x, p_y, *self.goal, self._briefing.goal_tolerance):
            self.goal = self._draw(observation.tick)
        return self._steering.to_goal(observation, self.goal, speed=self.speed)

    def _draw(self, tick: int) -> tuple[float, float]:
        area, margin, key = self._briefing.area, self.margin, self._briefing.key
        return (
            margin + (area.width - 2.0 * margin) * uniform(key, WANDER, 0, tick, 0),
            margin + (area.height - 2.0 * margin) * uniform(key, WANDER, 0, tick, 1),
        )
