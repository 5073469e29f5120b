"""Connection to an autopilot over MAVLink: telemetry in, setpoints out."""

import logging
import math
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from bus.messages.base import Vector
from bus.messages.robot import MAX_OVERSPEED, MAX_STATE_AGE, RobotState
from bus.numbers import above, exact
from outrider.running.refused import Refusals, Refused
from outrider_mavlink.dialect import MavMessage, mavlink, packed
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE, TOO_MANY
from outrider_mavlink.identity import AUTOPILOT, status_texts
from outrider_mavlink.udp import UNREADABLE, Address, Network, Peer

OTHER_AUTOPILOT = "comes from another autopilot"
OLDER = "is older than the previous message"

_LOG = logging.getLogger("outrider.mavlink")
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
_TELEMETRY_INTERVAL = 50_000.0
"""Requested time between two position reports [µs]."""
_LARGEST = 1e5
"""Largest number of a position [m] or velocity [m/s]; the bus carries no much larger ones."""
_NO_YAW = 0b110_000_000_000
_NO_AUTOPILOT = mavlink.MAV_AUTOPILOT_INVALID


class Telemetry(NamedTuple):
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
    """Time on the local clock [s]."""


class Reference(NamedTuple):
    """Reference state to send to the autopilot, in scenario coordinates."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    altitude: float | None
    """Altitude [m]; None: the UAV flies in the plane."""
    climb_rate: float
    """Climb rate [m/s]."""
    since: float
    """Time on the local clock [s]."""


def _log_rejected(refused: Refused, count: int) -> None:
    _LOG.warning("rejected %d: %s %s", count, refused.what, refused.cause)


class AutopilotLink:
    """Connection to an autopilot: receives its telemetry and sends setpoints.

    Args:
        network: UDP sockets.
        clock: Local clock [s].
    """

    def __init__(self, network: Network, clock: Callable[[], float] = time.monotonic) -> None:
        self.network, self.clock = network, clock
        self.refusals = Refusals(_log_rejected)
        self.peer: Peer | None = None
        """Address and numbers of the autopilot; None: none connected so far."""
        self.armed = False
        """True if the autopilot is armed."""
        self.reported: Telemetry | None = None
        """Newest valid telemetry; None: none so far."""
        self.reports = self.setpoints = 0
        """Numbers of valid telemetry messages and of sent setpoints."""
        self.max_speed = math.inf
        """Maximum speed of the UAV [m/s]."""
        self.reference: Reference | None = None
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
        self._sent_reference: Reference | None = None
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
        now = self.clock()
        if self.peer is None:
            return
        while self._pending_texts:
            self._send_text(self._pending_texts.popleft(), self.peer.address)
        if now - self._heartbeat >= _HEARTBEAT:
            self._heartbeat = now
            if self.reported is None or now - self.reported.received > MAX_STATE_AGE:
                self._request_telemetry(self.peer)  # a restarted autopilot has lost the request
            kind = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
            self._send(mavlink.MAVLink_heartbeat_message(kind, _NO_AUTOPILOT, 0, 0, 4, 3))
        reference = self.reference
        if reference is not None and (
            reference is not self._sent_reference or now - self._sent >= _RESEND
        ):
            self._sent_reference, self._sent = reference, now
            self._send_setpoint(reference, paused=now - reference.since > _PAUSED)

    def _send_setpoint(self, reference: Reference, *, paused: bool) -> None:
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
                round(self.clock() * 1e3) % (1 << 32),
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
        self._last_received = self.clock()
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
        silent = self.clock() - self._last_received > _PEER_TIMEOUT
        return silent and peer != self.peer and self._same(peer)

    def _reject(self, cause: str, what: str, peer: Peer, hint: str = "") -> None:
        """Count a rejected message, and send the reason to its sender."""
        self.refusals.add(Refused(cause, what))
        self.rejected = f"{what} {cause}"
        now, key = self.clock(), (cause, peer.address)
        if self._packer is None or now - self._text_times.get(key, -math.inf) < _REPEAT:
            return
        if len(self._text_times) >= _MAX_TEXTS:
            self._text_times.clear()
        self._text_times[key] = now
        self._send_text(f"rejected: {self.rejected}{hint}", peer.address)

    def _connect(self, peer: Peer) -> None:
        """Connect to a peer as the autopilot, in the role of its onboard computer."""
        self.peer, self._last_received = peer, self.clock()
        ours = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        self._packer = mavlink.MAVLink(None, srcSystem=peer.system, srcComponent=ours)
        self._request_telemetry(peer)

    def _request_telemetry(self, peer: Peer) -> None:
        """Request position reports."""
        kind, pace = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        rest = (float(kind), _TELEMETRY_INTERVAL, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._send(mavlink.MAVLink_command_long_message(peer.system, AUTOPILOT, pace, 0, *rest))

    def _update_position(self, peer: Peer, message: MavMessage) -> None:
        values = (message.x, message.y, message.z, message.vx, message.vy, message.vz)
        speed, largest = math.hypot(message.vx, message.vy), max(map(abs, values))
        if not all(map(math.isfinite, values)):
            self._reject(NOT_FINITE, "telemetry", peer)
        elif largest > _LARGEST:
            self._reject(BEYOND_BOUNDS, f"telemetry with {largest:g} m or m/s", peer)
        elif self.reported is not None and self._is_older(self.reported, message.time_boot_ms):
            hint = f"; accepted after {MAX_STATE_AGE:g} s without telemetry"
            self._reject(OLDER, "telemetry", peer, hint)
        elif speed > (bound := self.max_speed + MAX_OVERSPEED):
            what = f"telemetry of {above(speed, bound)} m/s (allowed: up to {exact(bound)})"
            self._reject(BEYOND_BOUNDS, what, peer)
        else:
            self.reports += 1
            self.rejected = ""
            self.reported = Telemetry(
                message.time_boot_ms,
                (message.y, message.x),
                message.z,
                (message.vy, message.vx),
                self.clock(),
            )

    def _is_older(self, reported: Telemetry, boot: int) -> bool:
        """Return True if a time stamp [ms] is outdated; after a timeout, any stamp is valid (a restart)."""
        ahead = (boot - reported.boot) % _CLOCK
        if 0 < ahead < _CLOCK // 2:
            return False
        return ahead == 0 or self.clock() - reported.received <= MAX_STATE_AGE

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

    def age(self) -> float:
        """Return the age of the newest telemetry [s]; infinite without any."""
        return math.inf if self.reported is None else self.clock() - self.reported.received

    def deviation(self, position: Vector) -> float:
        """Return the reported tracking error for a reference position [m]; infinite without valid telemetry."""
        reported, anchor, age = self.reported, self.anchor, self.age()
        if reported is None or age > MAX_STATE_AGE:
            return math.inf
        if anchor is None:
            return 0.0
        (x, y), (v_x, v_y), (a_x, a_y) = reported.position, reported.velocity, anchor
        return math.hypot(x + v_x * age - a_x - position[0], y + v_y * age - a_y - position[1])

    def robot(self, ahead: float) -> RobotState | None:
        """Return the state of the robot in scenario coordinates; None without telemetry or anchor.

        Args:
            ahead: Time from now to the tick at which the simulator shows the state [s].
        """
        reported, anchor = self.reported, self.anchor
        if reported is None or anchor is None:
            return None
        (x, y), (a_x, a_y) = reported.position, anchor
        return RobotState(
            position=(x - a_x, y - a_y),
            altitude=self._anchor_altitude + self._down - reported.down,
            velocity=reported.velocity,
            age=self.age() + ahead,
        )
