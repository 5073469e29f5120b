"""A UAV that is flown by setpoints, inside the safety filter: its pilot on the bus, and its system in MAVLink."""

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
    from outrider_mavlink.autopilot import AutopilotLink

TOO_EARLY = "comes before the UAV has joined"
_LATELY = 1.0
"""The time for which the filter is said to act after it did so last [s]: it does so every few ticks."""
_TURN = 0.02
"""The longest time between two looks at what is flown [s]."""
_MODES = {(mode.main, mode.sub): mode for mode in (MISSION, HOLD, OFFBOARD)}


class Flown(NamedTuple):
    """A tick as the UAV has flown it."""

    observation: UavObservation
    command: UavCommand
    by_setpoint: bool
    """True if a setpoint was wanted in it."""


class OffboardPilot:
    """Flies the run's law, a setpoint, or stays where it is, always inside the safety filter.

    The mode and the setpoint come from another thread. A setpoint counts for the scenario's `command_timeout`, in
    simulated time from the tick that met it first; then the law flies until the next one comes.
    """

    def __init__(self) -> None:
        self.mode: Mode = MISSION
        """As ground stations want it."""
        self.briefing: UavBriefing | None = None
        """The briefing of the UAV when it joined last."""
        self.flown: Flown | None = None
        """The newest tick."""
        self.ticks = self.setpoint_ticks = self.interventions = 0
        """Ticks flown, those for which a setpoint counted, and those in which the filter acted instead."""
        self.intervened_at = -math.inf
        """Time at which the filter acted last [s]."""
        self._setpoint: Setpoint | None = None
        self._met: Setpoint | None = None
        self._since = 0
        self._hold = 0
        self._by_setpoint = False

    def make(self, briefing: UavBriefing) -> "OffboardPilot":
        """Join: all that was wanted before counts no more."""
        self._hold = ticks_within(briefing.command_timeout, briefing.dt)
        self._setpoint = self._met = None
        self.briefing = briefing
        self._pilot = pilot = UavPilot(briefing, inner=self._inner)
        # The law's own pilot does what the process asks besides.
        self.perceive, self.forget_commands = pilot.perceive, pilot.forget_commands
        return self

    def want(self, setpoint: Setpoint) -> None:
        """Take a setpoint; may be called from any thread."""
        self._setpoint = Setpoint(*setpoint)  # a new one, though it may say the same

    def act(self, observation: UavObservation) -> UavCommand:
        """The command for this observation."""
        command = self._pilot.act(observation)
        self.ticks += 1
        self.setpoint_ticks += self._by_setpoint
        decision = None if command.report is None else command.report.decision
        if decision is not None and decision.overridden:
            self.interventions += 1
            self.intervened_at = observation.time
        self.flown = Flown(observation, command, self._by_setpoint)
        return command

    def _inner(self, observation: UavObservation) -> Vector | None:
        wanted, briefing, mode = self._setpoint, self.briefing, self.mode
        if wanted is not self._met:
            self._met, self._since = wanted, observation.tick
        counts = wanted is not None and observation.tick - self._since <= self._hold
        self._by_setpoint = mode is OFFBOARD and counts
        flown = REST if mode is HOLD else wanted if self._by_setpoint else None
        if flown is None or briefing is None:
            return None
        return setpoint_control(flown, observation, briefing)


class OffboardGateway(Gateway):
    """Tells of one UAV what it knows itself, and takes its modes and setpoints.

    Args:
        pilot: Flies it.
        network: Where it is told.
        system: Its system.
    """

    def __init__(self, pilot: OffboardPilot, network: Network, system: VehicleSystem) -> None:
        super().__init__(network, [system])
        self._pilot, self._system = pilot, system
        self.silent = True  # until it has joined

    def refresh(self) -> None:
        """Take in what was flown."""
        flown, briefing, system = self._pilot.flown, self._pilot.briefing, self._system
        if flown is None or briefing is None:
            return
        self.silent, system.origin = False, briefing.origin
        seen, report = flown.observation, flown.command.report
        system.move(Moving(seen.time, seen.position, seen.velocity, flown.command.acceleration))
        system.mode = self._pilot.mode
        self.judge(
            system,
            "setpoints",
            wrong=system.mode is OFFBOARD and not flown.by_setpoint,
            worse="no setpoint counts: the run's law flies",
            better=f"setpoints fly {system.name}",
            critical=False,
        )
        if report is None:
            return
        system.followed = Moving(
            seen.time, report.estimate, (0.0, 0.0), covariance=report.covariance
        )
        self.judge(
            system,
            "turned",
            wrong=seen.time - self._pilot.intervened_at < _LATELY and system.mode is not MISSION,
            worse="the safety filter acts: sight of the UGV would be lost",
            better="the safety filter lets everything through",
            critical=False,
        )
        if report.decision is not None:
            reason = report.decision.reason
            self.judge(
                system,
                "certified",
                wrong=reason is not None,
                worse=f"sight is not certified: {reason.text if reason else ''}",
                better="sight is certified again",
            )

    def setpoint(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Take a setpoint of the ground station that steers, or refuse it."""
        del system
        briefing = self._pilot.briefing
        if briefing is None:
            self.refuse(TOO_EARLY, "a setpoint")
            return
        try:
            wanted = read_setpoint(message, briefing.limits)
        except Refused as refused:
            self.refusals.add(refused)
            return
        if self.holds(peer):
            self._pilot.want(wanted)

    def change_mode(self, peer: Peer, system: VehicleSystem, mode: Numbers) -> int:
        """Let the law fly, setpoints, or stay."""
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
        """The briefing of the UAV when it joined."""
        del system
        briefing = self._pilot.briefing
        return {} if briefing is None else dict(_told(briefing))

    def counts(self) -> dict[str, object]:
        """Counts of what was told, taken, refused and flown."""
        pilot = self._pilot
        flown = {
            "ticks": pilot.ticks,
            "setpoint_ticks": pilot.setpoint_ticks,
            "interventions": pilot.interventions,
        }
        return super().counts() | flown


def _told(briefing: UavBriefing) -> Iterator[tuple[str, float]]:
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
    """Serve MAVLink in a thread of its own while the vehicle is flown; its error is raised where the flight ends."""
    closing, errors = threading.Event(), list[Exception]()

    def serve() -> None:
        try:
            while not closing.is_set():
                gateway.refresh()
                gateway.turn(_TURN)
        except Exception as error:  # noqa: BLE001 - raised where the flight ends
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
