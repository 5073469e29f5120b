"""A person at the wheel, over a link that may fall silent."""

from agents.drivers.steering import Steering
from bus.messages.vehicle import Teleoperation, UgvBriefing, UgvObservation
from bus.ticks import ticks_within


class TeleopDriver:
    """Does what the operator said last: drives at a velocity, or to a goal, or brakes.

    Whatever is asked for, the UGV keeps its bounds: a velocity longer than v_max is shortened to it, and a goal is
    driven to as the paper's driver does. Where a message has both, the velocity counts. A message counts for
    `command_timeout` seconds; afterwards the UGV brakes and stands until the operator's next message.

    It knows nothing of what was said before it took the wheel, so it begins by braking. It does not look where it
    goes: Q has walls.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._steering = Steering(briefing)
        self._hold = ticks_within(briefing.command_timeout, briefing.dt)
        self._word: Teleoperation | None = None
        self._received = 0  # the tick at which that came

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        if observation.operator:
            self._word, self._received = observation.operator[-1], observation.tick
        word = self._word
        if word is None or observation.tick - self._received > self._hold:
            return self._steering.to_rest(observation)
        if word.velocity is not None:
            return self._steering.to_velocity(observation, word.velocity)
        if word.goal is not None:
            return self._steering.to_goal(observation, word.goal)
        return self._steering.to_rest(observation)
