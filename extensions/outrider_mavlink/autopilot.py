"""Real autopilot as the inner loop of a UAV: its robot's true state returns to the run.

The state of the pilot is the reference state of the inner loop, and `certificate.max_tracking_error` bounds the
tracking error. The autopilot receives position, velocity and acceleration of the reference state as setpoints. Each
command carries the state that it reports, so that detections and coverage follow the robot. If the tracking error
exceeds the bound, or telemetry is missing, the UAV in the run holds its position inside the safety filter, and nothing
is certified.
"""

import logging
import math
from collections import deque

import msgspec

from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.vehicle import UavBriefing, UavCommand, UavObservation
from bus.numbers import above, exact
from bus.ticks import tick_of
from outrider_mavlink.autopilot_link import AutopilotLink, Reference
from outrider_mavlink.setpoints import REST, bounds, setpoint_control

_LOG = logging.getLogger("outrider.mavlink")
_REMEMBERED = 1000
"""Number of ticks that are remembered for their tracking error."""


class AutopilotPilot:
    """Pilot that applies the run's law while the autopilot tracks the reference state, and else holds its position.

    Both controls pass through the safety filter. Detections that the robot made while its tracking error was unknown
    or beyond the bound are dropped: their error may exceed what the filter assumes.

    Args:
        link: Connection to the autopilot.
    """

    def __init__(self, link: AutopilotLink) -> None:
        self._link = link
        self.ticks = self.held_ticks = self.dropped = 0
        """Numbers of ticks, of ticks in which the UAV held its position for the autopilot, and of dropped detections.
        """
        self.largest_deviation = 0.0
        """Largest reported tracking error [m]."""
        self._tracks = True
        self._off: deque[int] = deque(maxlen=_REMEMBERED)  # ticks with too large a tracking error
        self._next: Reference | None = None
        self._last_briefing: UavBriefing | None = None
        self._old_anchor: Vector | None = None

    def make(self, briefing: UavBriefing) -> "AutopilotPilot":
        """Join the run.

        Raises:
            ScenarioError: If the run takes no state of a robot, or allows no tracking error.
        """
        if not briefing.has_robot:
            raise ScenarioError(
                f"uav.body of {briefing.vehicle}: a model, not a robot; allowed with --autopilot: 'reported', set for "
                "the simulator, such as --set uav.*.body=reported"
            )
        tracking = briefing.safety.max_tracking_error
        if not tracking:
            raise ScenarioError(
                f"certificate.max_tracking_error = {'none' if tracking is None else 0}: an autopilot has a tracking "
                "error; allowed: a bound above 0 m, set for the simulator, such as "
                "--set certificate.max_tracking_error=0.3"
            )
        link = self._link
        self._bound = tracking
        same = briefing == self._last_briefing
        self._old_anchor = (link.anchor or self._old_anchor) if same else None
        self._briefing = self._last_briefing = briefing
        link.max_speed = bounds(briefing.limits)[0]
        link.anchor = link.reference = self._next = None
        self._off.clear()
        self._pilot = pilot = UavPilot(briefing, inner=self._inner)
        # Delegate the other method required by the process to the law's pilot.
        self.forget_commands = pilot.forget_commands
        return self

    def act(self, observation: UavObservation) -> UavCommand:
        """Return the command for an observation, with the state of the robot."""
        self._compare(observation)
        command = self._pilot.act(self._trusted(observation))
        self.ticks += 1
        self.held_ticks += not self._tracks
        self._next = Reference(
            observation.position,
            observation.velocity,
            command.acceleration,
            observation.altitude,
            observation.climb_rate,
            self._link.clock(),
        )
        report = command.report
        if report is not None and not self._tracks:
            report = msgspec.structs.replace(report, decision=None)
        robot = self._link.robot(self._briefing.dt)
        return msgspec.structs.replace(command, report=report, robot=robot)

    def perceive(self, observation: UavObservation) -> None:
        """Process an observation that the process was too slow to answer."""
        if not self._tracks:
            self._off.append(observation.tick)
        self._pilot.perceive(self._trusted(observation))

    def prepare(self) -> None:
        """Pass the reference state to the autopilot once the command is sent; skips past ticks after a rejoin."""
        reference, link = self._next, self._link
        if reference is None:
            return
        if link.anchor is None:
            self._set_anchor(reference)
        link.reference = reference

    def _set_anchor(self, reference: Reference) -> None:
        """Let robot and reference coincide; after a rejoin, keep the anchor unless the robot is elsewhere."""
        link = self._link
        link.anchor = self._old_anchor
        off = link.deviation(reference.position)
        if self._old_anchor is None or off >= self._briefing.visibility_radius:
            link.set_anchor(reference.position, reference.altitude)

    def _compare(self, observation: UavObservation) -> None:
        """Compare the robot with the reference state of this tick."""
        error = self._link.deviation(observation.position)
        if math.isfinite(error):
            self.largest_deviation = max(self.largest_deviation, error)
        within = error <= self._bound
        if not within:
            self._off.append(observation.tick)
        tracks = within and self._link.armed
        if tracks != self._tracks:
            self._tracks = tracks
            text = self._state_text(error)
            _LOG.warning("%s", text)
            self._link.say(text)

    def _trusted(self, observation: UavObservation) -> UavObservation:
        """Return the observation without detections of ticks in which the tracking error exceeded its bound."""
        if not self._off:
            return observation
        dt = self._briefing.dt
        kept = tuple(
            one for one in observation.detections if tick_of(one.time, dt) not in self._off
        )
        self.dropped += len(observation.detections) - len(kept)
        return msgspec.structs.replace(observation, detections=kept)

    def _inner(self, observation: UavObservation) -> Vector | None:
        if self._tracks:
            return None
        return setpoint_control(REST, observation, self._briefing)

    def _state_text(self, error: float) -> str:
        if self._tracks:
            return "the autopilot tracks the reference state: the run's law flies"
        if math.isinf(error):
            rejected = self._link.rejected
            why = f"rejected: {rejected}" if rejected else "the autopilot is silent"
        elif not self._link.armed:
            why = "the autopilot is not armed"
        else:
            why = f"tracking error {above(error, self._bound)} m, allowed up to {exact(self._bound)} m"
        return f"{why}: the UAV holds its position, and nothing is certified"

    def counts(self) -> dict[str, object]:
        """Return the numbers of ticks, detections dropped, setpoints, telemetry messages and rejections."""
        link = self._link
        return {
            "ticks": self.ticks,
            "held_ticks": self.held_ticks,
            "dropped_detections": self.dropped,
            "largest_deviation": self.largest_deviation,
            "setpoints": link.setpoints,
            "reports": link.reports,
            "refused": dict(link.refusals.counts),
        }
