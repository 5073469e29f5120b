"""Real autopilot as the inner loop of a simulated UAV: telemetry in, setpoints out.

The state of a UAV in the run is the reference state of its inner loop; `certificate.max_tracking_error` bounds the
tracking error. The autopilot receives position, velocity and acceleration of the reference state as setpoints. If its
reported tracking error exceeds the bound, or its telemetry is missing, the UAV in the run holds its position inside the
safety filter, and nothing is certified. The telemetry has no other effect on the run: the UGV and its detections are
simulated.
"""

import logging
import math
import time
from collections import deque
from typing import NamedTuple

import msgspec

from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.vehicle import UavBriefing, UavCommand, UavObservation
from bus.numbers import above, exact
from outrider.running.refused import Refusals, Refused
from outrider_mavlink.dialect import MavMessage, mavlink, packed
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE, TOO_MANY
from outrider_mavlink.identity import AUTOPILOT, status_texts
from outrider_mavlink.setpoints import REST, bounds, setpoint_control
from outrider_mavlink.udp import UNREADABLE, Address, Network, Peer

OTHER_AUTOPILOT = "comes from another autopilot"
OLDER = "is older than the previous message"

_LOG = logging.getLogger("outrider.mavlink")
_TELEMETRY_TIMEOUT = 1.0
"""Age beyond which the telemetry is invalid [s]."""
_PEER_TIMEOUT = 3.0
"""Time without a message after which the autopilot may reconnect from another address [s]."""
_CLOCK = 1 << 32
"""Period of the autopilot's clock [ms]."""
_REPEAT = 1.0
"""Minimum time between two texts to one address about one cause [s]."""
_MAX_TEXTS = 16
_PAUSED = 0.3
"""Time without a tick after which the run counts as paused and the setpoint as one at rest [s]."""
_RESEND = 0.1
"""Maximum time between two setpoints; an autopilot leaves its offboard mode without them [s]."""
_HEARTBEAT = 1.0
"""Time between two heartbeats [s]."""
_SPEED_TOLERANCE = 1.1
"""Maximum reported speed as a multiple of the UAV's bound, to allow for overshoot."""
_TELEMETRY_INTERVAL = 50_000.0
"""Requested time between two position reports [µs]."""
_NO_YAW = 0b110_000_000_000
_NO_AUTOPILOT = mavlink.MAV_AUTOPILOT_INVALID


class Reported(NamedTuple):
    """Position and velocity reported by the autopilot, in its local frame."""

    boot: int
    """Time on the autopilot's clock [ms]."""
    position: Vector
    """East and north [m]."""
    down: float
    """Down [m]."""
    velocity: Vector
    """East and north [m/s]."""
    received: float
    """Time on the local monotonic clock [s]."""


class _Reference(NamedTuple):
    """Reference state to send to the autopilot, in scenario coordinates."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    altitude: float | None
    """Altitude [m]; None: the UAV flies in the plane."""
    climb_rate: float
    """Climb rate [m/s]."""
    since: float
    """Time on the local monotonic clock [s]."""


def _log_rejected(refused: Refused, count: int) -> None:
    _LOG.warning("rejected %d: %s %s", count, refused.what, refused.cause)


class AutopilotLink:
    """Connection to an autopilot: receives its telemetry and sends setpoints.

    Args:
        network: UDP sockets.
    """

    def __init__(self, network: Network) -> None:
        self.network = network
        self.refusals = Refusals(_log_rejected)
        self.peer: Peer | None = None
        """Address and numbers of the autopilot; None: none connected so far."""
        self.armed = False
        """True if the autopilot is armed."""
        self.reported: Reported | None = None
        """Newest valid telemetry; None: none so far."""
        self.reports = self.setpoints = 0
        """Numbers of valid telemetry messages and of sent setpoints."""
        self.max_speed = math.inf
        """Maximum speed of the UAV [m/s]."""
        self.reference: _Reference | None = None
        """Reference state to send; None: none so far."""
        self.anchor: Vector | None = None
        """Local position of the scenario's origin, set when autopilot and UAV coincide at the start [m]."""
        self.rejected = ""
        """Reason why the newest telemetry was rejected; empty: it was accepted."""
        self._pending_texts: deque[str] = deque(maxlen=_MAX_TEXTS)
        self._text_times: dict[tuple[str, Address], float] = {}
        self._texts = 0
        self._last_received = -math.inf
        self._down = self._anchor_altitude = 0.0
        self._sent = self._heartbeat = -math.inf
        self._sent_reference: _Reference | None = None
        self._packer: MavMessage = None

    def turn(self, patience: float) -> None:
        """Process the received messages; wait up to `patience` [s] for the first one."""
        before = self.network.unreadable
        for peer, message in self.network.receive(patience):
            self._handle(peer, message)
        for peer, message in self.network.turned_away:
            self._reject(TOO_MANY, f"{message.get_type()} of {peer}", peer)
        if self.network.unreadable > before:
            self.refusals.add(Refused(UNREADABLE, "datagram"), self.network.unreadable - before)

    def refresh(self) -> None:
        """Send heartbeats, texts and setpoints that are due."""
        now = time.monotonic()
        if self.peer is None:
            return
        while self._pending_texts:
            self._send_text(self._pending_texts.popleft(), self.peer.address)
        if now - self._heartbeat >= _HEARTBEAT:
            self._heartbeat = now
            if self.reported is None or now - self.reported.received > _TELEMETRY_TIMEOUT:
                self._request_telemetry(self.peer)  # a restarted autopilot has lost the request
            kind = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
            self._send(mavlink.MAVLink_heartbeat_message(kind, _NO_AUTOPILOT, 0, 0, 4, 3))
        reference = self.reference
        if reference is not None and (
            reference is not self._sent_reference or now - self._sent >= _RESEND
        ):
            self._sent_reference, self._sent = reference, now
            self._send_setpoint(reference, paused=now - reference.since > _PAUSED)

    def _send_setpoint(self, reference: _Reference, *, paused: bool) -> None:
        if self.peer is None or self.anchor is None or self.reported is None:
            return
        (x, y), (a_x, a_y) = reference.position, self.anchor
        zero = (0.0, 0.0)
        (v_x, v_y), (u_x, u_y) = (
            (zero, zero) if paused else (reference.velocity, reference.acceleration)
        )
        climb = 0.0 if paused else reference.climb_rate
        rise = 0.0 if reference.altitude is None else reference.altitude - self._anchor_altitude
        self.setpoints += 1
        self._send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                round(time.monotonic() * 1e3) % (1 << 32),
                self.peer.system,
                self.peer.component,
                mavlink.MAV_FRAME_LOCAL_NED,
                _NO_YAW,
                *(y + a_y, x + a_x, self._down - rise),
                *(v_y, v_x, 0.0 - climb),
                *(u_y, u_x, 0.0),
                *zero,
            )
        )

    def _send(self, message: MavMessage) -> None:
        to = None if self.peer is None else self.peer.address
        self.network.send(packed(message, self._packer), message.get_type(), to)

    def _handle(self, peer: Peer, message: MavMessage) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot != _NO_AUTOPILOT and self._is_autopilot(peer):
            self._connect(peer)
        if kind not in ("HEARTBEAT", "LOCAL_POSITION_NED"):
            return
        if peer != self.peer:
            if self.peer is not None and getattr(message, "autopilot", 0) != _NO_AUTOPILOT:
                hint = (
                    f"; accepted after {_PEER_TIMEOUT:g} s of silence" if self._same(peer) else ""
                )
                self._reject(OTHER_AUTOPILOT, f"{kind} of {peer}", peer, hint)
            return
        self._last_received = time.monotonic()
        if kind == "HEARTBEAT":
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        else:
            self._update_position(peer, message)

    def _same(self, peer: Peer) -> bool:
        """Return True if a peer has the autopilot's system and component numbers, at any address."""
        return self.peer is not None and peer[1:] == self.peer[1:]

    def _is_autopilot(self, peer: Peer) -> bool:
        """Return True if a peer is the autopilot: the first one, or the same one at a new address."""
        if self.peer is None:
            return True
        silent = time.monotonic() - self._last_received > _PEER_TIMEOUT
        return silent and peer != self.peer and self._same(peer)

    def _reject(self, cause: str, what: str, peer: Peer, hint: str = "") -> None:
        """Count a rejected message, and send the reason to its sender."""
        self.refusals.add(Refused(cause, what))
        self.rejected = f"{what} {cause}"
        now, key = time.monotonic(), (cause, peer.address)
        if self._packer is None or now - self._text_times.get(key, -math.inf) < _REPEAT:
            return
        if len(self._text_times) >= _MAX_TEXTS:
            self._text_times.clear()
        self._text_times[key] = now
        self._send_text(f"rejected: {self.rejected}{hint}", peer.address)

    def _connect(self, peer: Peer) -> None:
        """Connect to a peer as the autopilot, in the role of its onboard computer."""
        self.peer, self._last_received = peer, time.monotonic()
        ours = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        self._packer = mavlink.MAVLink(None, srcSystem=peer.system, srcComponent=ours)
        self._request_telemetry(peer)

    def _request_telemetry(self, peer: Peer) -> None:
        """Request position reports."""
        kind, pace = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        rest = (float(kind), _TELEMETRY_INTERVAL, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._send(mavlink.MAVLink_command_long_message(peer.system, AUTOPILOT, pace, 0, *rest))

    def _update_position(self, peer: Peer, message: MavMessage) -> None:
        values = (message.x, message.y, message.z, message.vx, message.vy)
        speed = math.hypot(message.vx, message.vy)
        if not all(map(math.isfinite, values)):
            self._reject(NOT_FINITE, "telemetry", peer)
        elif self.reported is not None and self._is_older(self.reported, message.time_boot_ms):
            hint = f"; accepted after {_TELEMETRY_TIMEOUT:g} s without telemetry"
            self._reject(OLDER, "telemetry", peer, hint)
        elif speed > self.max_speed * _SPEED_TOLERANCE:
            what = f"telemetry of {above(speed, self.max_speed)} m/s (allowed: up to {exact(self.max_speed)})"
            self._reject(BEYOND_BOUNDS, what, peer)
        else:
            self.reports += 1
            self.rejected = ""
            self.reported = Reported(
                message.time_boot_ms,
                (message.y, message.x),
                message.z,
                (message.vy, message.vx),
                time.monotonic(),
            )

    @staticmethod
    def _is_older(reported: Reported, boot: int) -> bool:
        """Return True if a time stamp [ms] is outdated; after a timeout, any stamp is valid (a restart)."""
        ahead = (boot - reported.boot) % _CLOCK
        if 0 < ahead < _CLOCK // 2:
            return False
        return ahead == 0 or time.monotonic() - reported.received <= _TELEMETRY_TIMEOUT

    def say(self, text: str) -> None:
        """Queue a text for the autopilot's user; may be called from any thread."""
        self._pending_texts.append(text)

    def _send_text(self, text: str, to: Address) -> None:
        self._texts = self._texts % 65_535 + 1
        for message in status_texts(text, self._texts, warns=True):
            self.network.send(packed(message, self._packer), message.get_type(), to)

    def set_anchor(self, position: Vector, altitude: float | None = None) -> None:
        """Set the anchor for a UAV at this position and altitude [m]; without an altitude, it holds its height."""
        reported = self.reported
        if reported is None:
            return
        (x, y), (p_x, p_y) = reported.position, position
        self.anchor, self._down = (x - p_x, y - p_y), reported.down
        self._anchor_altitude = altitude or 0.0

    def deviation(self, position: Vector) -> float:
        """Return the reported tracking error for a reference position [m]; infinite without valid telemetry."""
        reported, anchor = self.reported, self.anchor
        if reported is None or time.monotonic() - reported.received > _TELEMETRY_TIMEOUT:
            return math.inf
        if anchor is None:
            return 0.0
        (x, y), (a_x, a_y), (p_x, p_y) = reported.position, anchor, position
        return math.hypot(x - a_x - p_x, y - a_y - p_y)


class AutopilotPilot:
    """Pilot that applies the run's law while the autopilot tracks the reference state, and else holds its position.

    Both controls pass through the safety filter.

    Args:
        link: Connection to the autopilot.
    """

    def __init__(self, link: AutopilotLink) -> None:
        self._link = link
        self.ticks = self.held_ticks = 0
        """Numbers of ticks, and of ticks in which the UAV held its position for the autopilot."""
        self.largest_deviation = 0.0
        """Largest reported tracking error [m]."""
        self._tracks = True
        self._next: _Reference | None = None

    def make(self, briefing: UavBriefing) -> "AutopilotPilot":
        """Join the run.

        Raises:
            ScenarioError: If the run allows no tracking error.
        """
        tracking = briefing.safety.max_tracking_error
        if tracking is not None and tracking <= 0.0:
            raise ScenarioError(
                "certificate.max_tracking_error = 0: an autopilot has a tracking error; allowed: a bound above 0 m, "
                "set for the simulator, such as --set certificate.max_tracking_error=0.3"
            )
        self._bound = math.inf if tracking is None else tracking
        self._briefing = briefing
        self._link.max_speed = bounds(briefing.limits)[0]
        self._link.anchor = self._link.reference = self._next = None
        self._pilot = pilot = UavPilot(briefing, inner=self._inner)
        # Delegate the other methods required by the process to the law's pilot.
        self.perceive, self.forget_commands = pilot.perceive, pilot.forget_commands
        return self

    def act(self, observation: UavObservation) -> UavCommand:
        """Return the command for an observation."""
        command = self._pilot.act(observation)
        self.ticks += 1
        self.held_ticks += not self._tracks
        self._next = _Reference(
            observation.position,
            observation.velocity,
            command.acceleration,
            observation.altitude,
            observation.climb_rate,
            time.monotonic(),
        )
        if self._tracks or command.report is None:
            return command
        uncertified = msgspec.structs.replace(command.report, decision=None)
        return msgspec.structs.replace(command, report=uncertified)

    def prepare(self) -> None:
        """Pass the reference state to the autopilot once the command is sent; skips past ticks after a rejoin."""
        reference = self._next
        if reference is not None:
            if self._link.anchor is None:
                self._link.set_anchor(reference.position, reference.altitude)
            self._link.reference = reference

    def _inner(self, observation: UavObservation) -> Vector | None:
        error = self._link.deviation(observation.position)
        if math.isfinite(error):
            self.largest_deviation = max(self.largest_deviation, error)
        tracks = error <= self._bound and self._link.armed
        if tracks != self._tracks:
            self._tracks = tracks
            text = self._state_text(error)
            _LOG.warning("%s", text)
            self._link.say(text)
        return None if tracks else setpoint_control(REST, observation, self._briefing)

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
        """Return the numbers of ticks, setpoints, telemetry messages and rejections."""
        link = self._link
        return {
            "ticks": self.ticks,
            "held_ticks": self.held_ticks,
            "largest_deviation": self.largest_deviation,
            "setpoints": link.setpoints,
            "reports": link.reports,
            "refused": dict(link.refusals.counts),
        }
