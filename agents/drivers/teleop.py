"""Teleoperation of a UGV by an operator, over a link that may fail."""

from agents.drivers.steering import Steering
from bus.messages.vehicle import Teleoperation, UgvBriefing, UgvObservation
from bus.ticks import ticks_within


class TeleopDriver:
    """Driver that executes the operator's last message: a velocity, a speed and a turn rate, a goal, or braking.

    The UGV always keeps its bounds: a velocity above v_max is shortened, and a goal is approached as by the paper's
    driver. A UGV that does not steer ignores speeds and turn rates. Of several inputs in a message, the first of this
    list wins; a speed comes before a velocity. A message is valid for `command_timeout` seconds; after that the
    UGV brakes and stands until the operator's next message.

    The driver ignores messages sent before it took over, so it starts by braking. It ignores obstacles: Q has walls.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._steering = Steering(briefing)
        self._timeout = ticks_within(briefing.command_timeout, briefing.dt)
        self._message: Teleoperation | None = None
        self._received = 0  # tick at which the message arrived

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """Return the acceleration [m/s²] for this observation."""
        if observation.operator:
            self._message, self._received = observation.operator[-1], observation.tick
        message = self._message
        if message is None or observation.tick - self._received > self._timeout:
            return self._steering.to_rest(observation)
        if message.speed is not None and self._steering.turns:
            return self._steering.to_twist(observation, message.speed, message.turn_rate)
        if message.velocity is not None:
            return self._steering.to_velocity(observation, message.velocity)
        if message.goal is not None:
            return self._steering.to_goal(observation, message.goal)
        return self._steering.to_rest(observation)
