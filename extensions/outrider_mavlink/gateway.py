"""Answers to ground stations: commands, parameters and rates, and a count of all that is refused."""

import math
import time
from collections.abc import Mapping, Sequence

from outrider.running.refused import Refusals, Refused
from outrider_mavlink.dialect import MavMessage, mavlink, packed
from outrider_mavlink.identity import AUTOPILOT, VehicleSystem
from outrider_mavlink.services import NEGATIVE_REPLIES
from outrider_mavlink.udp import MOST_PEERS, UNREADABLE, Address, Network, Peer

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED

OTHER_SYSTEM = "is for another system"
OTHER_COMPONENT = "is for another component"
OUR_NUMBER = "bears the number of a vehicle"
SECOND_STATION = "comes from a second ground station"
TOO_MANY = f"comes from one ground station too many; {MOST_PEERS} are the most"
OTHER_ADDRESS = "comes from an address that nothing is sent to"
NOT_FINITE = "has a number that is none"
BEYOND_BOUNDS = "is beyond the bounds"
NOT_ALLOWED = "is not allowed"
NOT_SUPPORTED = "is not supported"

_RELEASE = 5.0
"""A ground station that has been silent for so long has no hold on a vehicle any more [s]."""
_SETTLE = 2.0
"""Time between two texts about the same trouble of a vehicle [s]."""
_REPEAT = 1.0
"""Time between two texts to a ground station that is turned away [s]."""
_FASTEST = 50.0
"""Messages of one kind that a party may ask for in a second [1/s]."""

RATES: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.2,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET: 5.0,
}
"""Rate of each message about each system, by its number [1/s] of wall time."""

Numbers = tuple[int | None, int | None]
"""Of a mode, main and sub, as somebody wants them; None where it is no whole number."""


def _whole(value: float) -> int | None:
    """A command's parameter as a whole number; None where it is none."""
    return int(value) if math.isfinite(value) and value == int(value) else None


class _Timer:
    """Time at which one kind of message is due."""

    def __init__(self, rate: float) -> None:
        self.period = math.inf if rate == 0.0 else 1.0 / rate
        self.due = -math.inf

    def rings(self, now: float) -> bool:
        """True once a period."""
        if now < self.due or math.isinf(self.period):
            return False
        self.due = now + self.period if now - self.due > self.period else self.due + self.period
        return True


class _Trouble:
    """Something that may be wrong with a vehicle, and what people were told of it."""

    def __init__(self) -> None:
        self.now = self.told = self.critical = False
        self._since = -math.inf

    def news(self, wrong: bool, now: float) -> bool:
        """True if it is time to tell that it has changed."""
        self.now = wrong
        if wrong == self.told or now - self._since < _SETTLE:
            return False
        self.told, self._since = wrong, now
        return True


class Gateway:
    """Tells of some systems, and answers whoever asks.

    Args:
        network: Where they are told.
        systems: Of which.
    """

    def __init__(self, network: Network, systems: Sequence[VehicleSystem]) -> None:
        self.network = network
        self.systems = {system.number: system for system in systems}
        self.refusals = Refusals(self._say_refused)
        self.received = 0
        """Messages that were understood."""
        self.holder: Peer | None = None
        """The ground station whose commands count."""
        self.silent = False
        """True: there is nothing to be told of now."""
        self._received = -math.inf
        self._last_refusals: dict[Address, float] = {}
        self._troubles: dict[tuple[str, str], _Trouble] = {}
        self._timers = {
            number: {kind: _Timer(rate) for kind, rate in RATES.items()} for number in self.systems
        }

    # What a gateway of one's own may say otherwise

    def parameters(self, system: VehicleSystem) -> Mapping[str, float]:
        """The parameters of a system by name, of 16 letters at most."""
        del system
        return {}

    def set_parameter(self, peer: Peer, system: VehicleSystem, name: str, value: float) -> None:
        """Change a parameter, or refuse to."""
        del peer, system, value
        self.refuse(NOT_ALLOWED, f"parameter {name} can only be read")

    def change_mode(self, peer: Peer, system: VehicleSystem, mode: Numbers) -> int:
        """Change the mode to the one of these numbers, main and sub; MAVLink's result."""
        del peer, system, mode
        return UNSUPPORTED

    def setpoint(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Take a setpoint, or refuse it."""
        del peer
        self.refuse(NOT_ALLOWED, f"{message.get_type()}: {system.name} is flown by its own process")

    def manual(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Take what a person does with the sticks, or refuse it."""
        del peer, message
        self.refuse(NOT_ALLOWED, f"MANUAL_CONTROL: {system.name} has no wheel here")

    # What all do

    def turn(self, patience: float) -> None:
        """Take in what has come, after a wait of up to `patience` [s] for the first of it, and tell what is due."""
        before, strangers = self.network.unreadable, self.network.strangers
        for peer, message in self.network.receive(patience):
            self.received += 1
            self._take(peer, message)
        for peer, message in self.network.turned_away:
            self._turn_away(peer, message)
        if self.network.strangers > strangers:
            count = self.network.strangers - strangers
            self.refuse(OTHER_ADDRESS, "what is sent here", count)
        unreadable = self.network.unreadable - before
        if unreadable:
            self.refuse(UNREADABLE, "bytes that are none, or damaged", unreadable)
        now = time.monotonic()
        if self.silent:
            return
        for number, timers in self._timers.items():
            for kind, timer in timers.items():
                if timer.rings(now):
                    self.tell(self.systems[number], kind)

    def tell(self, system: VehicleSystem, kind: int, peer: Peer | None = None) -> bool:
        """Tell the message of this number, to one party or to all; False if it is not known yet."""
        message = system.build(kind)
        if message is not None:
            self.send(system, message, peer)
        return message is not None

    def send(self, system: VehicleSystem, message: MavMessage, peer: Peer | None = None) -> None:
        """Send a message from a system, to one party or to all."""
        to = None if peer is None else peer.address
        self.network.send(packed(message, system.sender), message.get_type(), to)

    def say(self, system: VehicleSystem, text: str, *, warns: bool = False) -> None:
        """Say a text for people."""
        for message in system.texts(text, warns=warns):
            self.send(system, message)

    def judge(
        self,
        system: VehicleSystem,
        kind: str,
        *,
        wrong: bool,
        worse: str,
        better: str,
        critical: bool = True,
    ) -> None:
        """Say that something is wrong with a vehicle, and when it is well again; neither too often.

        Args:
            system: The vehicle's.
            kind: What may be wrong, for us.
            wrong: Whether it is.
            worse, better: What is said when it begins and when it ends.
            critical: Whether heartbeats tell it too.
        """
        trouble = self._troubles.setdefault((system.name, kind), _Trouble())
        if trouble.news(wrong, time.monotonic()):
            self.say(system, worse if wrong else better, warns=wrong)
        trouble.critical = critical
        system.critical = any(
            one.now and one.critical
            for (whose, _), one in self._troubles.items()
            if whose == system.name
        )

    def refuse(self, cause: str, what: str, count: int = 1) -> None:
        """Count what is refused, and say so the 1st, 2nd, 4th, 8th ... time."""
        self.refusals.add(Refused(cause, what), count)

    def _say_refused(self, refused: Refused, count: int) -> None:
        first = next(iter(self.systems.values()))
        self.say(first, f"refused {count}: {refused.what} {refused.cause}", warns=True)

    def holds(self, peer: Peer) -> bool:
        """True if this ground station may steer: the first that does so, until it falls silent."""
        if self.holder is None or time.monotonic() - self._received > _RELEASE:
            self.holder = peer
        if self.holder != peer:
            self.refuse(SECOND_STATION, f"what {peer} wants")
            return False
        self._received = time.monotonic()
        return True

    def _turn_away(self, peer: Peer, message: MavMessage) -> None:
        """Refuse a ground station for which there is no room: deny its command, and say why once a second."""
        kind, now = message.get_type(), time.monotonic()
        self.refuse(TOO_MANY, f"{kind} of {peer}")
        system = self.systems.get(getattr(message, "target_system", 0))
        system = system or next(iter(self.systems.values()))
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._acknowledge(peer, system, message.command, DENIED)
        if now - self._last_refusals.get(peer.address, -math.inf) < _REPEAT:
            return
        if len(self._last_refusals) >= MOST_PEERS:
            self._last_refusals.clear()
        self._last_refusals[peer.address] = now
        for text in system.texts(f"refused: {MOST_PEERS} ground stations already", warns=True):
            self.send(system, text, peer)

    def _take(self, peer: Peer, message: MavMessage) -> None:
        kind = message.get_type()
        if peer.system in self.systems:
            self.refuse(OUR_NUMBER, f"{kind} of {peer}")
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
            self.refuse(OTHER_SYSTEM, f"{kind} for {target}")
            return
        if getattr(message, "target_component", 0) not in (0, AUTOPILOT):
            self.refuse(OTHER_COMPONENT, f"{kind} for {message.target_component}")
            return
        for system in [self.systems[target]] if target else list(self.systems.values()):
            self._obey(peer, system, kind, message)

    def _obey(self, peer: Peer, system: VehicleSystem, kind: str, message: MavMessage) -> None:
        match kind:
            case "COMMAND_LONG" | "COMMAND_INT":
                self._answer_command(peer, system, message)
            case "SET_MODE":
                mode = message.custom_mode
                self.change_mode(peer, system, (mode >> 16 & 255, mode >> 24))
            case "PARAM_REQUEST_LIST" | "PARAM_REQUEST_READ":
                self._tell_parameters(peer, system, message)
            case "PARAM_SET":
                self._take_parameter(peer, system, message)
            case _ if kind in NEGATIVE_REPLIES:
                self.refusals.counts[f"service {NOT_SUPPORTED}"] += 1  # the reply says it
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
                result = self._pace(system, _whole(message.param1), message.param2)
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:  # it moves as long as the run
                result = ACCEPTED if message.param1 == 1.0 else DENIED
            case mavlink.MAV_CMD_DO_SET_MODE:
                mode = _whole(message.param2), _whole(message.param3)
                result = self.change_mode(peer, system, mode)
            case _:
                result = UNSUPPORTED
        if result == UNSUPPORTED:
            self.refusals.counts[f"command {NOT_SUPPORTED}"] += 1  # the answer says it
        self._acknowledge(peer, system, message.command, result)

    def _acknowledge(self, peer: Peer, system: VehicleSystem, command: int, result: int) -> None:
        answer = mavlink.MAVLink_command_ack_message(
            command, result, 0, 0, peer.system, peer.component
        )
        self.send(system, answer, peer)

    def _request(self, peer: Peer, system: VehicleSystem, kind: int | None) -> int:
        if kind is None or not system.knows(kind):
            return UNSUPPORTED
        told = self.tell(system, kind, peer)
        return ACCEPTED if told else int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)

    def _pace(self, system: VehicleSystem, kind: int | None, interval: float) -> int:
        """Tell a message at another interval [µs]; -1: never, 0: as it was."""
        if kind is None or kind not in RATES or not math.isfinite(interval):
            return UNSUPPORTED
        if interval > 0.0 and 1e6 / interval > _FASTEST:
            return DENIED
        rate = 0.0 if interval < 0.0 else RATES[kind] if interval == 0.0 else 1e6 / interval
        self._timers[system.number][kind] = _Timer(rate)
        return ACCEPTED

    def _tell_parameters(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        names = list(self.parameters(system))
        wanted = range(len(names))
        if message.get_type() == "PARAM_REQUEST_READ":
            index = message.param_index
            if index < 0 and message.param_id in names:
                index = names.index(message.param_id)
            if not 0 <= index < len(names):
                self.refuse(NOT_SUPPORTED, f"parameter {message.param_id or message.param_index}")
                return
            wanted = range(index, index + 1)
        for index in wanted:
            self._tell_parameter(system, names[index], peer)

    def _tell_parameter(self, system: VehicleSystem, name: str, peer: Peer) -> None:
        values = self.parameters(system)
        message = mavlink.MAVLink_param_value_message(
            name.encode(),
            values[name],
            mavlink.MAV_PARAM_TYPE_REAL32,
            len(values),
            list(values).index(name),
        )
        self.send(system, message, peer)

    def _take_parameter(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        name = message.param_id
        if name not in self.parameters(system):
            self.refuse(NOT_SUPPORTED, f"parameter {name}")
            return
        if not math.isfinite(message.param_value):
            self.refuse(NOT_FINITE, f"parameter {name}")
        elif self.holds(peer):
            self.set_parameter(peer, system, name, message.param_value)
        self._tell_parameter(system, name, peer)  # as it is now, which is the protocol's answer

    def counts(self) -> dict[str, object]:
        """Counts of what was told, taken and refused."""
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
"""Messages that are meant for a system; of all others nothing is wanted here."""
