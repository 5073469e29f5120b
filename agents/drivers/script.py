"""A driver without eyes: a timed list of velocities, held one after the other."""

from bisect import bisect_right

from agents.drivers.steering import EARLY, Steering
from bus.messages import UgvBriefing, UgvObservation


class ScriptDriver:
    """Holds the velocity of the last step whose time has come; brakes before the first, keeps the last.

    A velocity longer than v_max is shortened to it. It does not look where it goes: at the border of Q it meets the wall.
    It remembers nothing, so it may take the wheel at any time.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._steering = Steering(briefing)
        steps = sorted(briefing.script, key=lambda step: step.time)  # of two at one time the later in the list counts
        self._times = [float(step.time) for step in steps]
        self._velocities = [step.velocity for step in steps]

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        begun = bisect_right(self._times, observation.time + EARLY * self._steering.dt)
        if not begun:
            return self._steering.to_rest(observation)
        return self._steering.to_velocity(observation, self._velocities[begun - 1])
