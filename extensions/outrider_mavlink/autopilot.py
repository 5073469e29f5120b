"""An autopilot that flies along: the inner loop of a UAV, whose telemetry comes in and whose setpoints go out.

In a run a UAV's position is the one that its inner loop is to hold it to, and how far it truly is from there at most is
declared: `certificate.max_tracking_error`. A real autopilot is such a loop. It is sent that position, its velocity and
acceleration; where it says to be farther off than declared, or says nothing, its UAV in the run stays where it is, as
far as the safety filter lets it, and nothing is certified. Its telemetry moves nothing in the run otherwise: the
detections of a UGV that is simulated are simulated too.
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
from outrider.running.refused import Refusals, Refused
from outrider_mavlink.dialect import MavMessage, mavlink, packed
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE, TOO_MANY
from outrider_mavlink.identity import AUTOPILOT, status_texts
from outrider_mavlink.setpoints import REST, bounds, setpoint_control
from outrider_mavlink.udp import UNREADABLE, Address, Network, Peer

OTHER_AUTOPILOT = "comes from another party than the autopilot"
OLDER = "is older than what came before"

_LOG = logging.getLogger("outrider.mavlink")
_SILENCE = 1.0
"""After so long without telemetry nothing is known of the autopilot [s]."""
_LEFT = 3.0
"""After so long without a message the autopilot has gone, and another party with its system number is it [s]."""
_CLOCK = 1 << 32
"""Its clock starts again at 0 after this many milliseconds."""
_REPEAT = 1.0
"""Time between two texts to one party about one cause [s]."""
_MOST_TEXTS = 16
_STANDS = 0.3
"""After so long without a tick the run stands still, and what is wanted is to stay [s]."""
_RESEND = 0.1
"""The longest time between two setpoints [s]: an autopilot gives up where they stay out."""
_BEAT = 1.0
_SPEEDING = 1.1
"""So much faster than its bound, as a share, a UAV may say to be: a loop overshoots."""
_ASKED = 50_000.0
"""Time between two reports of its position that is asked for [µs]."""
_NO_YAW = 0b110_000_000_000
_NO_AUTOPILOT = mavlink.MAV_AUTOPILOT_INVALID


class Reported(NamedTuple):
    """The autopilot's own word on where it is, in its local frame."""

    boot: int
    """Its clock [ms]."""
    position: Vector
    """East and north [m]."""
    down: float
    """[m]"""
    velocity: Vector
    """East and north [m/s]."""
    received: float
    """Of our clock [s]."""


class _Wanted(NamedTuple):
    """The setpoint that the autopilot is to hold."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    since: float
    """Of our clock [s]."""


def _log_refused(refused: Refused, count: int) -> None:
    _LOG.warning("refused %d: %s %s", count, refused.what, refused.cause)


class AutopilotLink:
    """Receives from an autopilot, and tells it what to hold.

    Args:
        network: Where it is reached.
    """

    def __init__(self, network: Network) -> None:
        self.network = network
        self.refusals = Refusals(_log_refused)
        self.peer: Peer | None = None
        """The autopilot; None: none has been received from."""
        self.armed = False
        self.reported: Reported | None = None
        """Its newest telemetry that was believed."""
        self.reports = self.setpoints = 0
        """Telemetry that was believed, and setpoints that were sent."""
        self.max_speed = math.inf
        """The UAV's bound [m/s]."""
        self.wanted: _Wanted | None = None
        self.anchor: Vector | None = None
        """Its local position where the scenario's origin is [m]: when it joins it is where its UAV is then."""
        self.refused = ""
        """Why its newest telemetry was refused; empty: it was not."""
        self._stories: deque[str] = deque(maxlen=_MOST_TEXTS)
        self._said: dict[tuple[str, Address], float] = {}
        self._texts = 0
        self._last_received = -math.inf
        self._down = 0.0
        self._sent = self._beat = -math.inf
        self._told: _Wanted | None = None
        self._packer: MavMessage = None

    def turn(self, patience: float) -> None:
        """Take in what has come, after a wait of up to `patience` [s] for the first of it."""
        before = self.network.unreadable
        for peer, message in self.network.receive(patience):
            self._take(peer, message)
        for peer, message in self.network.turned_away:
            self._refuse(TOO_MANY, f"{message.get_type()} of {peer}", peer)
        if self.network.unreadable > before:
            self.refusals.add(Refused(UNREADABLE, "bytes"), self.network.unreadable - before)

    def refresh(self) -> None:
        """Tell the autopilot what to hold, if it is time."""
        now = time.monotonic()
        if self.peer is None:
            return
        while self._stories:
            self._send_text(self._stories.popleft(), self.peer.address)
        if now - self._beat >= _BEAT:
            self._beat = now
            if self.reported is None or now - self.reported.received > _SILENCE:
                self._ask(self.peer)  # one that has started again does not remember it
            kind = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
            self._send(mavlink.MAVLink_heartbeat_message(kind, _NO_AUTOPILOT, 0, 0, 4, 3))
        wanted = self.wanted
        if wanted is not None and (wanted is not self._told or now - self._sent >= _RESEND):
            self._told, self._sent = wanted, now
            self._send_setpoint(wanted, stands=now - wanted.since > _STANDS)

    def _send_setpoint(self, wanted: _Wanted, *, stands: bool) -> None:
        if self.peer is None or self.anchor is None or self.reported is None:
            return
        (x, y), (a_x, a_y) = wanted.position, self.anchor
        nothing = (0.0, 0.0)
        (v_x, v_y), (u_x, u_y) = (
            (nothing, nothing) if stands else (wanted.velocity, wanted.acceleration)
        )
        self.setpoints += 1
        self._send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                round(time.monotonic() * 1e3) % (1 << 32),
                self.peer.system,
                self.peer.component,
                mavlink.MAV_FRAME_LOCAL_NED,
                _NO_YAW,
                *(y + a_y, x + a_x, self._down),
                *(v_y, v_x, 0.0),
                *(u_y, u_x, 0.0),
                *nothing,
            )
        )

    def _send(self, message: MavMessage) -> None:
        to = None if self.peer is None else self.peer.address
        self.network.send(packed(message, self._packer), message.get_type(), to)

    def _take(self, peer: Peer, message: MavMessage) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot != _NO_AUTOPILOT and self._may_be(peer):
            self._meet(peer)
        if kind not in ("HEARTBEAT", "LOCAL_POSITION_NED"):
            return
        if peer != self.peer:
            if self.peer is not None and getattr(message, "autopilot", 0) != _NO_AUTOPILOT:
                hint = f"; accepted after {_LEFT:g} s of its silence" if self._same(peer) else ""
                self._refuse(OTHER_AUTOPILOT, f"{kind} of {peer}", peer, hint)
            return
        self._last_received = time.monotonic()
        if kind == "HEARTBEAT":
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        else:
            self._take_position(peer, message)

    def _same(self, peer: Peer) -> bool:
        """Return whether this party has the autopilot's numbers, at whatever address."""
        return self.peer is not None and peer[1:] == self.peer[1:]

    def _may_be(self, peer: Peer) -> bool:
        """Return whether this party is the autopilot: the first one, or the same one at another port."""
        if self.peer is None:
            return True
        gone = time.monotonic() - self._last_received > _LEFT
        return gone and peer != self.peer and self._same(peer)

    def _refuse(self, cause: str, what: str, peer: Peer, hint: str = "") -> None:
        """Count what is refused, and say why to its sender."""
        self.refusals.add(Refused(cause, what))
        self.refused = f"{what} {cause}"
        now, key = time.monotonic(), (cause, peer.address)
        if self._packer is None or now - self._said.get(key, -math.inf) < _REPEAT:
            return
        if len(self._said) >= _MOST_TEXTS:
            self._said.clear()
        self._said[key] = now
        self._send_text(f"refused: {self.refused}{hint}", peer.address)

    def _meet(self, peer: Peer) -> None:
        """Take a party for the autopilot; we are a computer on board of it."""
        self.peer, self._last_received = peer, time.monotonic()
        ours = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        self._packer = mavlink.MAVLink(None, srcSystem=peer.system, srcComponent=ours)
        self._ask(peer)

    def _ask(self, peer: Peer) -> None:
        """Ask for telemetry."""
        kind, pace = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        rest = (float(kind), _ASKED, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._send(mavlink.MAVLink_command_long_message(peer.system, AUTOPILOT, pace, 0, *rest))

    def _take_position(self, peer: Peer, message: MavMessage) -> None:
        values = (message.x, message.y, message.z, message.vx, message.vy)
        speed = math.hypot(message.vx, message.vy)
        if not all(map(math.isfinite, values)):
            self._refuse(NOT_FINITE, "telemetry", peer)
        elif self.reported is not None and self._is_older(self.reported, message.time_boot_ms):
            hint = f"; accepted after {_SILENCE:g} s without any other"
            self._refuse(OLDER, "telemetry", peer, hint)
        elif speed > self.max_speed * _SPEEDING:
            what = f"telemetry of {speed:.2f} m/s with at most {self.max_speed:g}"
            self._refuse(BEYOND_BOUNDS, what, peer)
        else:
            self.reports += 1
            self.refused = ""
            self.reported = Reported(
                message.time_boot_ms,
                (message.y, message.x),
                message.z,
                (message.vy, message.vx),
                time.monotonic(),
            )

    @staticmethod
    def _is_older(reported: Reported, boot: int) -> bool:
        """Return whether a time stamp is older than the newest; after a silence the autopilot has started again."""
        ahead = (boot - reported.boot) % _CLOCK
        if 0 < ahead < _CLOCK // 2:
            return False
        return ahead == 0 or time.monotonic() - reported.received <= _SILENCE

    def say(self, text: str) -> None:
        """Say a text for people to the autopilot; may be called from any thread."""
        self._stories.append(text)

    def _send_text(self, text: str, to: Address) -> None:
        self._texts = self._texts % 65_535 + 1
        for message in status_texts(text, self._texts, warns=True):
            self.network.send(packed(message, self._packer), message.get_type(), to)

    def set_anchor(self, position: Vector) -> None:
        """It is where the UAV is now, and at that height it stays."""
        reported = self.reported
        if reported is None:
            return
        (x, y), (p_x, p_y) = reported.position, position
        self.anchor, self._down = (x - p_x, y - p_y), reported.down

    def deviation(self, position: Vector) -> float:
        """Distance of the autopilot from where it is wanted [m]; infinite where nothing is known."""
        reported, anchor = self.reported, self.anchor
        if reported is None or time.monotonic() - reported.received > _SILENCE:
            return math.inf
        if anchor is None:
            return 0.0
        (x, y), (a_x, a_y), (p_x, p_y) = reported.position, anchor, position
        return math.hypot(x - a_x - p_x, y - a_y - p_y)


class AutopilotPilot:
    """Flies the run's law where the autopilot holds what it is told, and else stays, both inside the safety filter.

    Args:
        link: To the autopilot.
    """

    def __init__(self, link: AutopilotLink) -> None:
        self._link = link
        self.ticks = self.held_ticks = 0
        """Ticks flown, and those in which the UAV had to stay since the autopilot was not where it should be."""
        self.largest_deviation = 0.0
        """The farthest that it said to be from where it was wanted [m]."""
        self._follows = True
        self._next: _Wanted | None = None

    def make(self, briefing: UavBriefing) -> "AutopilotPilot":
        """Join.

        Raises:
            ScenarioError: If the run declares that a UAV is always exactly where it should be.
        """
        tracking = briefing.safety.max_tracking_error
        if tracking is not None and tracking <= 0.0:
            raise ScenarioError(
                "certificate.max_tracking_error = 0: no autopilot is always exactly where it should be; "
                "declare how far off "
                "it may be, in m, where the simulator is started, such as --set certificate.max_tracking_error=0.3"
            )
        self._bound = math.inf if tracking is None else tracking
        self._briefing = briefing
        self._link.max_speed = bounds(briefing.limits)[0]
        self._link.anchor = self._link.wanted = self._next = None
        self._pilot = pilot = UavPilot(briefing, inner=self._inner)
        # The law's own pilot does what the process asks besides.
        self.perceive, self.forget_commands = pilot.perceive, pilot.forget_commands
        return self

    def act(self, observation: UavObservation) -> UavCommand:
        """The command for this observation."""
        command = self._pilot.act(observation)
        self.ticks += 1
        self.held_ticks += not self._follows
        self._next = _Wanted(
            observation.position,
            observation.velocity,
            command.acceleration,
            time.monotonic(),
        )
        if self._follows or command.report is None:
            return command
        nothing = msgspec.structs.replace(command.report, decision=None)
        return msgspec.structs.replace(command, report=nothing)

    def prepare(self) -> None:
        """The command is on its way: only now is the autopilot told, and never of the past of one that joins again."""
        wanted = self._next
        if wanted is not None:
            if self._link.anchor is None:
                self._link.set_anchor(wanted.position)
            self._link.wanted = wanted

    def _inner(self, observation: UavObservation) -> Vector | None:
        off = self._link.deviation(observation.position)
        if math.isfinite(off):
            self.largest_deviation = max(self.largest_deviation, off)
        follows = off <= self._bound and self._link.armed
        if follows != self._follows:
            self._follows = follows
            story = self._story(off)
            _LOG.warning("%s", story)
            self._link.say(story)
        return None if follows else setpoint_control(REST, observation, self._briefing)

    def _story(self, off: float) -> str:
        if self._follows:
            return "the autopilot holds what it is told: the run's law flies"
        if math.isinf(off):
            refused = self._link.refused
            why = f"refused: {refused}" if refused else "the autopilot is silent"
        elif not self._link.armed:
            why = "the autopilot is not armed"
        else:
            why = f"the autopilot is {off:.2f} m off, declared are {self._bound:g} m"
        return f"{why}: its UAV stays, and nothing is certified"

    def counts(self) -> dict[str, object]:
        """Counts of what was told, received and refused."""
        link = self._link
        return {
            "ticks": self.ticks,
            "held_ticks": self.held_ticks,
            "largest_deviation": self.largest_deviation,
            "setpoints": link.setpoints,
            "reports": link.reports,
            "refused": dict(link.refusals.counts),
        }
