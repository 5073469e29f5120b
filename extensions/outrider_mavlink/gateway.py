"""Gateway for ground stations: commands, parameters, message rates, and counts of rejected messages."""

import math
import time
from collections.abc import Mapping, Sequence

from outrider.running.refused import Refusals, Refused
from outrider_mavlink.dialect import MavMessage, mavlink, packed
from outrider_mavlink.identity import AUTOPILOT, VehicleSystem
from outrider_mavlink.services import NEGATIVE_REPLIES
from outrider_mavlink.udp import MAX_PEERS, UNREADABLE, Address, Network, Peer

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED

OTHER_SYSTEM = "is for another system"
OTHER_COMPONENT = "is for another component"
OUR_NUMBER = "uses the system number of a vehicle"
SECOND_STATION = "comes from a second ground station"
TOO_MANY = f"exceeds the maximum of {MAX_PEERS} ground stations"
OTHER_ADDRESS = "comes from an unknown address"
NOT_FINITE = "has a value that is not finite"
BEYOND_BOUNDS = "is beyond the bounds"
NOT_ALLOWED = "is not allowed"
NOT_SUPPORTED = "is not supported"

_CONTROL_TIMEOUT = 5.0
"""Time without a message after which a ground station loses control [s]."""
_SETTLE = 2.0
"""Minimum time between two texts about the same problem of a vehicle [s]."""
_REPEAT = 1.0
"""Minimum time between two texts to a ground station that is turned away [s]."""
_MAX_RATE = 50.0
"""Maximum rate of one message that a ground station can request [1/s]."""

RATES: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.2,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET: 5.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
}
"""Default rate of each message of a system, by message number [1/s of wall time]."""

Numbers = tuple[int | None, int | None]
"""Main and sub number of a requested mode; None for a value that is not a whole number."""


def _whole(value: float) -> int | None:
    """Return a command's parameter as a whole number; None if it is not one."""
    return int(value) if math.isfinite(value) and value == int(value) else None


class _Timer:
    """Timer of one message."""

    def __init__(self, rate: float) -> None:
        self.period = math.inf if rate == 0.0 else 1.0 / rate
        self.due = -math.inf

    def rings(self, now: float) -> bool:
        """Return True once per period."""
        if now < self.due or math.isinf(self.period):
            return False
        self.due = now + self.period if now - self.due > self.period else self.due + self.period
        return True


class _Problem:
    """Possible problem of a vehicle, and its state as last reported to the user."""

    def __init__(self) -> None:
        self.now = self.reported = self.critical = False
        self._since = -math.inf

    def news(self, wrong: bool, now: float) -> bool:
        """Update the problem; return True if its change should be reported now."""
        self.now = wrong
        if wrong == self.reported or now - self._since < _SETTLE:
            return False
        self.reported, self._since = wrong, now
        return True


class Gateway:
    """Gateway that sends the telemetry of systems and answers requests.

    Args:
        network: UDP sockets.
        systems: Systems of the vehicles.
    """

    def __init__(self, network: Network, systems: Sequence[VehicleSystem]) -> None:
        self.network = network
        self.systems = {system.number: system for system in systems}
        self.refusals = Refusals(self._report_rejected)
        self.received = 0
        """Number of valid messages received."""
        self.holder: Peer | None = None
        """Ground station in control; None: none so far."""
        self.silent = False
        """True to send no telemetry."""
        self._received = -math.inf
        self._last_refusals: dict[Address, float] = {}
        self._problems: dict[tuple[str, str], _Problem] = {}
        self._timers = {
            number: {kind: _Timer(rate) for kind, rate in RATES.items()} for number in self.systems
        }

    # Methods for subclasses to override

    def parameters(self, system: VehicleSystem) -> Mapping[str, float]:
        """Return the parameters of a system by name (16 characters at most)."""
        del system
        return {}

    def set_parameter(self, peer: Peer, system: VehicleSystem, name: str, value: float) -> None:
        """Change a parameter, or reject the request."""
        del peer, system, value
        self.reject(NOT_ALLOWED, f"writing the read-only parameter {name}")

    def change_mode(self, peer: Peer, system: VehicleSystem, mode: Numbers) -> int:
        """Change the mode to a main and sub number; return MAVLink's result code."""
        del peer, system, mode
        return UNSUPPORTED

    def setpoint(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Apply a setpoint, or reject it."""
        del peer
        self.reject(
            NOT_ALLOWED, f"{message.get_type()} for {system.name}, controlled by its own process,"
        )

    def manual(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Apply the joystick input of an operator, or reject it."""
        del peer, message
        self.reject(NOT_ALLOWED, f"MANUAL_CONTROL of {system.name}")

    # Common behavior

    def turn(self, patience: float) -> None:
        """Process received messages and send those that are due; wait up to `patience` [s] for the first one."""
        before, strangers = self.network.unreadable, self.network.strangers
        for peer, message in self.network.receive(patience):
            self.received += 1
            self._handle(peer, message)
        for peer, message in self.network.turned_away:
            self._turn_away(peer, message)
        if self.network.strangers > strangers:
            count = self.network.strangers - strangers
            self.reject(OTHER_ADDRESS, "datagram", count)
        unreadable = self.network.unreadable - before
        if unreadable:
            self.reject(UNREADABLE, "datagram", unreadable)
        now = time.monotonic()
        if self.silent:
            return
        for number, timers in self._timers.items():
            for kind, timer in timers.items():
                if timer.rings(now):
                    self.send_kind(self.systems[number], kind)

    def send_kind(self, system: VehicleSystem, kind: int, peer: Peer | None = None) -> bool:
        """Send the message with this number to one or all peers; return False if its content is still unknown."""
        message = system.build(kind)
        if message is not None:
            self.send(system, message, peer)
        return message is not None

    def send(self, system: VehicleSystem, message: MavMessage, peer: Peer | None = None) -> None:
        """Send a message from a system to one or all peers."""
        to = None if peer is None else peer.address
        self.network.send(packed(message, system.sender), message.get_type(), to)

    def say(self, system: VehicleSystem, text: str, *, warns: bool = False) -> None:
        """Send a text for the user."""
        for message in system.texts(text, warns=warns):
            self.send(system, message)

    def report_problem(
        self,
        system: VehicleSystem,
        kind: str,
        *,
        wrong: bool,
        worse: str,
        better: str,
        critical: bool = True,
    ) -> None:
        """Report the start and end of a problem of a vehicle, at a limited rate.

        Args:
            system: System of the vehicle.
            kind: Internal name of the problem.
            wrong: True if the problem exists now.
            worse, better: Texts for the start and the end of the problem.
            critical: True if the problem makes the system's state critical in heartbeats.
        """
        problem = self._problems.setdefault((system.name, kind), _Problem())
        if problem.news(wrong, time.monotonic()):
            self.say(system, worse if wrong else better, warns=wrong)
        problem.critical = critical
        system.critical = any(
            one.now and one.critical
            for (whose, _), one in self._problems.items()
            if whose == system.name
        )

    def reject(self, cause: str, what: str, count: int = 1) -> None:
        """Count a rejected message, and report the 1st, 2nd, 4th, 8th ... of its cause."""
        self.refusals.add(Refused(cause, what), count)

    def _report_rejected(self, refused: Refused, count: int) -> None:
        first = next(iter(self.systems.values()))
        self.say(first, f"rejected {count}: {refused.what} {refused.cause}", warns=True)

    def holds(self, peer: Peer) -> bool:
        """Return True if this ground station has control: the first one that sends a command, until it falls silent."""
        if self.holder is None or time.monotonic() - self._received > _CONTROL_TIMEOUT:
            self.holder = peer
        if self.holder != peer:
            self.reject(SECOND_STATION, f"command of {peer}")
            return False
        self._received = time.monotonic()
        return True

    def _turn_away(self, peer: Peer, message: MavMessage) -> None:
        """Reject a message of a ground station beyond the maximum, and send it the reason once per second."""
        kind, now = message.get_type(), time.monotonic()
        self.reject(TOO_MANY, f"{kind} of {peer}")
        system = self.systems.get(getattr(message, "target_system", 0))
        system = system or next(iter(self.systems.values()))
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._acknowledge(peer, system, message.command, DENIED)
        if now - self._last_refusals.get(peer.address, -math.inf) < _REPEAT:
            return
        if len(self._last_refusals) >= MAX_PEERS:
            self._last_refusals.clear()
        self._last_refusals[peer.address] = now
        for text in system.texts(f"rejected: already {MAX_PEERS} ground stations", warns=True):
            self.send(system, text, peer)

    def _handle(self, peer: Peer, message: MavMessage) -> None:
        kind = message.get_type()
        if peer.system in self.systems:
            self.reject(OUR_NUMBER, f"{kind} of {peer}")
            return
        if peer == self.holder:
            self._received = time.monotonic()
        if kind == "TIMESYNC":
            self._answer_time(peer, message)
            return
        if kind not in _ADDRESSED:
            if getattr(message, "target_system", 0) in self.systems and "_ACK" not in kind:
                self.refusals.counts[f"message {NOT_SUPPORTED}"] += 1
            return
        target = message.target if kind == "MANUAL_CONTROL" else message.target_system
        if target and target not in self.systems:
            self.reject(OTHER_SYSTEM, f"{kind} for {target}")
            return
        if getattr(message, "target_component", 0) not in (0, AUTOPILOT):
            self.reject(OTHER_COMPONENT, f"{kind} for {message.target_component}")
            return
        for system in [self.systems[target]] if target else list(self.systems.values()):
            self._dispatch(peer, system, kind, message)

    def _dispatch(self, peer: Peer, system: VehicleSystem, kind: str, message: MavMessage) -> None:
        match kind:
            case "COMMAND_LONG" | "COMMAND_INT":
                self._answer_command(peer, system, message)
            case "SET_MODE":
                mode = message.custom_mode
                self.change_mode(peer, system, (mode >> 16 & 255, mode >> 24))
            case "PARAM_REQUEST_LIST" | "PARAM_REQUEST_READ":
                self._send_parameters(peer, system, message)
            case "PARAM_SET":
                self._set_parameter(peer, system, message)
            case _ if kind in NEGATIVE_REPLIES:
                self.refusals.counts[f"service {NOT_SUPPORTED}"] += 1  # reported by the reply
                reply = NEGATIVE_REPLIES[kind](peer, message)
                if reply is not None:
                    self.send(system, reply, peer)
            case "MANUAL_CONTROL":
                self.manual(peer, system, message)
            case _:
                self.setpoint(peer, system, message)

    def _answer_time(self, peer: Peer, message: MavMessage) -> None:
        if message.tc1 == 0:
            system = next(iter(self.systems.values()))
            reply = mavlink.MAVLink_timesync_message(time.monotonic_ns(), message.ts1)
            self.send(system, reply, peer)

    def _answer_command(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        match message.command:
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                result = self._request(peer, system, _whole(message.param1))
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                result = self._request(peer, system, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                result = self._set_interval(system, _whole(message.param1), message.param2)
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:  # armed for the whole run
                result = ACCEPTED if message.param1 == 1.0 else DENIED
            case mavlink.MAV_CMD_DO_SET_MODE:
                mode = _whole(message.param2), _whole(message.param3)
                result = self.change_mode(peer, system, mode)
            case _:
                result = UNSUPPORTED
        if result == UNSUPPORTED:
            self.refusals.counts[f"command {NOT_SUPPORTED}"] += 1  # reported by the acknowledgement
        self._acknowledge(peer, system, message.command, result)

    def _acknowledge(self, peer: Peer, system: VehicleSystem, command: int, result: int) -> None:
        answer = mavlink.MAVLink_command_ack_message(
            command, result, 0, 0, peer.system, peer.component
        )
        self.send(system, answer, peer)

    def _request(self, peer: Peer, system: VehicleSystem, kind: int | None) -> int:
        if kind is None or not system.knows(kind):
            return UNSUPPORTED
        sent = self.send_kind(system, kind, peer)
        return ACCEPTED if sent else int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)

    def _set_interval(self, system: VehicleSystem, kind: int | None, interval: float) -> int:
        """Set the interval of a message [µs]; -1: disable it, 0: restore the default."""
        if kind is None or kind not in RATES or not math.isfinite(interval):
            return UNSUPPORTED
        if interval > 0.0 and 1e6 / interval > _MAX_RATE:
            return DENIED
        rate = 0.0 if interval < 0.0 else RATES[kind] if interval == 0.0 else 1e6 / interval
        self._timers[system.number][kind] = _Timer(rate)
        return ACCEPTED

    def _send_parameters(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        names = list(self.parameters(system))
        wanted = range(len(names))
        if message.get_type() == "PARAM_REQUEST_READ":
            index = message.param_index
            if index < 0 and message.param_id in names:
                index = names.index(message.param_id)
            if not 0 <= index < len(names):
                self.reject(NOT_SUPPORTED, f"parameter {message.param_id or message.param_index}")
                return
            wanted = range(index, index + 1)
        for index in wanted:
            self._send_parameter(system, names[index], peer)

    def _send_parameter(self, system: VehicleSystem, name: str, peer: Peer) -> None:
        values = self.parameters(system)
        message = mavlink.MAVLink_param_value_message(
            name.encode(),
            values[name],
            mavlink.MAV_PARAM_TYPE_REAL32,
            len(values),
            list(values).index(name),
        )
        self.send(system, message, peer)

    def _set_parameter(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        name = message.param_id
        if name not in self.parameters(system):
            self.reject(NOT_SUPPORTED, f"parameter {name}")
            return
        if not math.isfinite(message.param_value):
            self.reject(NOT_FINITE, f"parameter {name}")
        elif self.holds(peer):
            self.set_parameter(peer, system, name, message.param_value)
        self._send_parameter(system, name, peer)  # the protocol's answer is the current value

    def counts(self) -> dict[str, object]:
        """Return the numbers of sent, received and rejected messages."""
        return {
            "sent": dict(self.network.sent),
            "received": self.received,
            "refused": dict(self.refusals.counts),
        }


_ADDRESSED = frozenset(
    {
        "COMMAND_LONG",
        "COMMAND_INT",
        "SET_MODE",
        "PARAM_REQUEST_LIST",
        "PARAM_REQUEST_READ",
        "PARAM_SET",
        *NEGATIVE_REPLIES,
        "MANUAL_CONTROL",
        "SET_POSITION_TARGET_LOCAL_NED",
        "SET_POSITION_TARGET_GLOBAL_INT",
        "SET_ATTITUDE_TARGET",
    }
)
"""Messages addressed to a system; others are ignored."""
