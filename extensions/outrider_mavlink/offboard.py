"""Offboard control of a UAV by setpoints inside the safety filter: its pilot and its MAVLink gateway."""

import math
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from agents.uav import UavPilot
from bus.messages.base import Vector
from bus.messages.vehicle import UavBriefing, UavCommand, UavObservation
from bus.registry import LAWS
from bus.ticks import ticks_within
from outrider.running.refused import Refused
from outrider_mavlink.dialect import MavMessage
from outrider_mavlink.gateway import ACCEPTED, DENIED, UNSUPPORTED, Gateway, Numbers
from outrider_mavlink.identity import (
    HOLD,
    MISSION,
    OFFBOARD,
    Mode,
    Moving,
    VehicleSystem,
)
from outrider_mavlink.setpoints import (
    REST,
    Setpoint,
    bounds,
    read_setpoint,
    setpoint_control,
)
from outrider_mavlink.udp import Network, Peer

if TYPE_CHECKING:
    from outrider_mavlink.autopilot_link import AutopilotLink

TOO_EARLY = "comes before the UAV has joined"
_OVERRIDE_HOLD = 1.0
"""Time for which an override by the filter is reported; overrides recur every few ticks [s]."""
_TURN = 0.02
"""Maximum wall time between two updates of the telemetry [s]."""
_MODES = {(mode.main, mode.sub): mode for mode in (MISSION, HOLD, OFFBOARD)}


class Flown(NamedTuple):
    """Observation and command of a tick."""

    observation: UavObservation
    command: UavCommand
    by_setpoint: bool
    """True if a setpoint determined the nominal control."""


class OffboardPilot:
    """Pilot that applies the run's law, tracks a setpoint or holds the position, inside the safety filter.

    Another thread sets the mode and the setpoint. A setpoint is valid for the scenario's `command_timeout`, counted
    in simulated time from the first tick that uses it. Then the law controls the UAV until the next setpoint.
    """

    def __init__(self) -> None:
        self.mode: Mode = MISSION
        """Mode set by ground stations."""
        self.briefing: UavBriefing | None = None
        """Briefing of the UAV when it last joined; None: not joined yet."""
        self.flown: Flown | None = None
        """Newest tick; None: none so far."""
        self.ticks = self.setpoint_ticks = self.interventions = 0
        """Number of ticks, of ticks with a valid setpoint, and of ticks overridden by the filter."""
        self.overridden_at = -math.inf
        """Simulated time of the last override by the filter [s]."""
        self._setpoint: Setpoint | None = None
        self._applied: Setpoint | None = None
        self._since = 0
        self._timeout_ticks = 0
        self._by_setpoint = False

    def make(self, briefing: UavBriefing) -> "OffboardPilot":
        """Join the run; earlier setpoints become invalid."""
        self._timeout_ticks = ticks_within(briefing.command_timeout, briefing.dt)
        self._setpoint = self._applied = None
        self.briefing = briefing
        self._pilot = pilot = UavPilot(briefing, inner=self._inner)
        # Delegate the other methods required by the process to the law's pilot.
        self.perceive, self.forget_commands = pilot.perceive, pilot.forget_commands
        return self

    def set_setpoint(self, setpoint: Setpoint) -> None:
        """Set the setpoint; may be called from any thread."""
        self._setpoint = Setpoint(*setpoint)  # a copy: an equal setpoint restarts the timeout

    def act(self, observation: UavObservation) -> UavCommand:
        """Return the command for an observation."""
        command = self._pilot.act(observation)
        self.ticks += 1
        self.setpoint_ticks += self._by_setpoint
        decision = None if command.report is None else command.report.decision
        if decision is not None and decision.overridden:
            self.interventions += 1
            self.overridden_at = observation.time
        self.flown = Flown(observation, command, self._by_setpoint)
        return command

    def _inner(self, observation: UavObservation) -> Vector | None:
        wanted, briefing, mode = self._setpoint, self.briefing, self.mode
        if wanted is not self._applied:
            self._applied, self._since = wanted, observation.tick
        valid = wanted is not None and observation.tick - self._since <= self._timeout_ticks
        self._by_setpoint = mode is OFFBOARD and valid
        flown = REST if mode is HOLD else wanted if self._by_setpoint else None
        if flown is None or briefing is None:
            return None
        return setpoint_control(flown, observation, briefing)


class OffboardGateway(Gateway):
    """Gateway of one UAV: its own telemetry, mode changes and setpoints.

    Args:
        pilot: Pilot of the UAV.
        network: UDP sockets.
        system: MAVLink system of the UAV.
    """

    def __init__(self, pilot: OffboardPilot, network: Network, system: VehicleSystem) -> None:
        super().__init__(network, [system])
        self._pilot, self._system = pilot, system
        self.silent = True  # until the UAV has joined

    def refresh(self) -> None:
        """Update the telemetry from the newest tick."""
        flown, briefing, system = self._pilot.flown, self._pilot.briefing, self._system
        if flown is None or briefing is None:
            return
        self.silent, system.origin = False, briefing.origin
        observation, report = flown.observation, flown.command.report
        position, velocity = observation.position, observation.velocity
        system.move(
            Moving(
                observation.time,
                position,
                velocity,
                flown.command.acceleration,
                altitude=observation.altitude,
                climb_rate=observation.climb_rate,
            )
        )
        system.mode = self._pilot.mode
        self.report_problem(
            system,
            "setpoints",
            wrong=system.mode is OFFBOARD and not flown.by_setpoint,
            worse="no valid setpoint: the run's law flies",
            better=f"setpoints control {system.name}",
            critical=False,
        )
        if report is None:
            return
        system.followed = Moving(
            observation.time, report.estimate, (0.0, 0.0), covariance=report.covariance
        )
        self.report_problem(
            system,
            "overridden",
            wrong=observation.time - self._pilot.overridden_at < _OVERRIDE_HOLD
            and system.mode is not MISSION,
            worse="the safety filter acts: the UGV would be lost from sight",
            better="the safety filter is inactive",
            critical=False,
        )
        if report.decision is not None:
            reason = report.decision.reason
            self.report_problem(
                system,
                "certified",
                wrong=reason is not None,
                worse=f"not certified: {reason.text if reason else ''}",
                better="certified again",
            )

    def setpoint(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Apply a setpoint of the ground station in control, or reject it."""
        del system
        briefing = self._pilot.briefing
        if briefing is None:
            self.reject(TOO_EARLY, "a setpoint")
            return
        try:
            wanted = read_setpoint(message, briefing.limits)
        except Refused as refused:
            self.refusals.add(refused)
            return
        if self.holds(peer):
            self._pilot.set_setpoint(wanted)

    def change_mode(self, peer: Peer, system: VehicleSystem, mode: Numbers) -> int:
        """Change the mode to MISSION, HOLD or OFFBOARD."""
        main, sub = mode
        wanted = _MODES.get((main or 0, sub or 0))
        if wanted is None:
            return UNSUPPORTED
        if wanted is self._pilot.mode:
            return ACCEPTED
        if not self.holds(peer):
            return DENIED
        self._pilot.mode = system.mode = wanted
        self.say(system, f"mode {wanted.name}")
        return ACCEPTED

    def parameters(self, system: VehicleSystem) -> Mapping[str, float]:
        """Return the settings in the UAV's briefing."""
        del system
        briefing = self._pilot.briefing
        return {} if briefing is None else dict(_settings(briefing))

    def counts(self) -> dict[str, object]:
        """Return the numbers of messages, rejections and ticks."""
        pilot = self._pilot
        flown = {
            "ticks": pilot.ticks,
            "setpoint_ticks": pilot.setpoint_ticks,
            "interventions": pilot.interventions,
        }
        return super().counts() | flown


def _settings(briefing: UavBriefing) -> Iterator[tuple[str, float]]:
    v_max, u_max = bounds(briefing.limits)
    target_v_max, _ = bounds(briefing.target_limits)
    names = list(LAWS)
    yield "AREA_HEIGHT", briefing.area.height
    yield "AREA_WIDTH", briefing.area.width
    yield "CERT_AGE", briefing.safety.max_measurement_age
    yield "CERT_DELAY", briefing.safety.max_command_delay
    yield "DT", briefing.dt
    yield "HOLD", briefing.command_timeout
    yield "LAW", float(names.index(briefing.law.name)) if briefing.law.name in names else -1.0
    yield "MAX_ACCEL", u_max
    yield "MAX_SPEED", v_max
    yield "SENSOR_RANGE", briefing.sensor.range
    yield "TARGET_SPEED", target_v_max
    yield "VIS_RADIUS", briefing.visibility_radius


@contextmanager
def serving(gateway: "OffboardGateway | AutopilotLink") -> Iterator[None]:
    """Serve MAVLink in a separate thread; its error is raised at the end of the context."""
    closing, errors = threading.Event(), list[Exception]()

    def serve() -> None:
        try:
            while not closing.is_set():
                gateway.refresh()
                gateway.turn(_TURN)
        except Exception as error:  # noqa: BLE001 - raised at the end of the context
            errors.append(error)

    thread = threading.Thread(target=serve, name="outrider-mavlink", daemon=True)
    thread.start()
    try:
        yield
    finally:
        closing.set()
        thread.join()
    if errors:
        raise errors[0]
