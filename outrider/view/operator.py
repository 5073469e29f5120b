"""The client of a run that terminal and page share: what the simulator tells, and what an operator says to it."""

import contextlib
import queue
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence

from bus import keys
from bus.errors import BusError
from bus.messages.base import Message, Vector
from bus.messages.control import Action, Control
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from bus.presence import Presence
from bus.queues import Outbox
from bus.registry import TELEOP
from bus.session import Session

SILENCE = 2.0
"""Without a status for so long [s] something is wrong."""
READ = (keys.STATUS, keys.SAMPLED_TRUTH, keys.COVERAGE, keys.GROUND)
"""Topics of a client that draws a run."""
_PACE = 6
"""Status messages, about a second of them, over which the real-time factor is taken."""


class RunClient:
    """Reads a run and speaks to it; nobody ever waits for us, and we never wait for the bus.

    Args:
        session: An operator's, or an observer's; then nothing can be said.
        status: The first one, if it has been read already.
        read: What it reads.
    """

    def __init__(
        self, session: Session, status: Status | None = None, *, read: Sequence[keys.Key] = READ
    ) -> None:
        self._session = session
        self._inboxes = [session.inbox(key, newest=1) for key in read]
        self._clock: deque[tuple[float, float]] = deque(maxlen=_PACE)
        self._outboxes: dict[str, Outbox] = {}
        self._unsent: queue.Queue[tuple[Outbox, Message] | None] = queue.Queue(maxsize=64)
        self.status = status
        self.truth: Truth | None = None
        self.coverage: CoverageMap | None = None
        self.ground: GroundMap | None = None
        self._received = time.monotonic()
        self.fault = ""
        """Why the last message could not be sent; empty: it was."""
        self.may_steer = session.party.role is keys.Role.OPERATOR
        self._controls = session.outbox(keys.CONTROL) if self.may_steer else None
        self.simulator = Presence(session, keys.SIMULATOR_NAME)
        self._sender = threading.Thread(target=self._send, name="outrider-operator", daemon=True)
        self._sender.start()

    @property
    def name(self) -> str:
        """Of the party."""
        return self._session.party.name

    @property
    def connected(self) -> bool:
        """True if there is a router."""
        return self._session.connected

    @property
    def age(self) -> float:
        """Time since the simulator has told something, or joined [s]."""
        return time.monotonic() - max(self._received, self.simulator.joined)

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time, over the last second.

        A status alone counts few ticks in real time.
        """
        if len(self._clock) < 2:
            return 0.0 if self.status is None else self.status.realtime_factor
        (began, start), (now, end) = self._clock[0], self._clock[-1]
        return (end - start) / max(now - began, 1e-3)

    def news(self) -> Iterator[Message]:
        """Status, truth, coverage and hazards that have come since the last call: the newest of each."""
        with contextlib.suppress(BusError):  # the session closes
            for inbox in self._inboxes:
                received = inbox.next_waiting()
                if received is not None:
                    self._take(received.message)
                    yield received.message

    def _take(self, message: Message) -> None:
        match message:
            case Status():
                self.status, self._received = message, time.monotonic()
                if message.time == 0.0 or (self._clock and message.time < self._clock[-1][1]):
                    self._clock.clear()  # nothing flown yet, or another flight
                self._clock.append((self._received, message.time))
            case Truth():
                self.truth, self._received = message, time.monotonic()
            case CoverageMap():
                self.coverage = message
            case GroundMap():
                self.ground = message

    def control(self, control: Control) -> bool:
        """Say something to the simulator; False if it cannot be said."""
        return self._controls is not None and self._say(self._controls, control)

    def drive(self, vehicle: str, drive: Teleoperation) -> bool:
        """Say something to a UGV; False if it cannot be said."""
        if not self.may_steer:
            return False
        if vehicle not in self._outboxes:
            self._outboxes[vehicle] = self._session.outbox(keys.OPERATOR, vehicle)
        return self._say(self._outboxes[vehicle], drive)

    def _say(self, outbox: Outbox, message: Message) -> bool:
        try:
            self._unsent.put_nowait((outbox, message))
        except queue.Full:
            self.fault = "the bus takes no more messages"
            return False
        return True

    def _send(self) -> None:
        """Send in a thread of its own: the bus may make a writer wait."""
        while (unsent := self._unsent.get()) is not None:
            outbox, message = unsent
            try:
                outbox.send(message)
                self.fault = ""
            except (BusError, ValueError) as error:
                self.fault = str(error)

    def close(self) -> None:
        """Send what has been said, and say no more."""
        with contextlib.suppress(queue.Full):
            self._unsent.put_nowait(None)
            self._sender.join(1.0)


class Helm:
    """Takes the wheels of UGVs for an operator, and hands them back to whoever drove before.

    Args:
        control: Says something to the simulator.
        drive: Says something to a UGV: its name, and what is wanted.
    """

    def __init__(
        self, control: Callable[[Control], bool], drive: Callable[[str, Teleoperation], bool]
    ) -> None:
        self._control, self._drive = control, drive
        self._before: dict[str, str] = {}
        self.operator = f"operator_{secrets.token_hex(6)}"
        """Name of the operator: another one's, even with the same credentials, is different."""

    def take(self, vehicle: str, driver: str) -> bool:
        """Ask for the wheel of a UGV that this driver drives now; False if it cannot be asked for."""
        if driver not in ("", TELEOP):
            self._before[vehicle] = driver
        return self._control(
            Control(action=Action.DRIVER, vehicle=vehicle, driver=TELEOP, operator=self.operator)
        )

    def holds(self, status: Status | None, vehicle: str) -> bool:
        """True if the UGV obeys this operator."""
        return _at_wheel(status, vehicle) == self.operator

    def displaced(self, status: Status | None, vehicle: str) -> bool:
        """True if the UGV obeys another operator."""
        return _at_wheel(status, vehicle) not in ("", self.operator)

    def steer(self, vehicle: str, name: str, velocity: Vector | None) -> bool:
        """Say which velocity [m/s] the operator of this name wants; None is to brake."""
        return self._drive(vehicle, Teleoperation(operator=name, velocity=velocity))

    def hand_back(self, vehicle: str, to: str = "") -> str:
        """Let a driver drive on, or the one from before; its name, empty where nobody is known."""
        heir = to or self._before.get(vehicle, "")
        if heir and self._control(Control(action=Action.DRIVER, vehicle=vehicle, driver=heir)):
            self._before.pop(vehicle, None)
            return heir
        return ""

    def waiting(self, status: Status | None) -> list[str]:
        """The UGVs that obey this operator and whose driver from before waits for the wheel."""
        return [
            name
            for name, driver in ({} if status is None else status.drivers).items()
            if driver == TELEOP and name in self._before and not self.displaced(status, name)
        ]


def _at_wheel(status: Status | None, vehicle: str) -> str:
    """The operator whom a UGV obeys; empty: none, or an unknown one."""
    if status is None or status.drivers.get(vehicle) != TELEOP:
        return ""
    return status.operators.get(vehicle, "")
