"""Client of a run, shared by terminal and page: reads the simulator's messages and sends the operator's."""

import contextlib
import math
import queue
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence

from bus import keys
from bus.errors import BusError
from bus.messages.base import Message
from bus.messages.control import Action, Control
from bus.messages.ground import GroundMap
from bus.messages.team import Request, Role
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from bus.presence import Presence
from bus.queues import Outbox
from bus.registry import TELEOP
from bus.session import Session

SILENCE = 2.0
"""Longest time without a message of the simulator [s]; after it the display shows a fault."""
READ = (keys.STATUS, keys.SAMPLED_TRUTH, keys.COVERAGE, keys.GROUND)
"""Topics of a client that draws a run."""
_PACE = 6
"""Number of status messages over which the real-time factor is averaged, about a second."""


class RunClient:
    """Client that reads a run's messages and sends an operator's, without ever blocking on the bus.

    Args:
        session: Session of an operator, or of an observer, who cannot send.
        status: First status, if it was received already.
        read: Topics to read.
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
        """Reason why the last message could not be sent; empty: it was sent."""
        self.may_steer = session.party.role is keys.Role.OPERATOR
        self._controls = session.outbox(keys.CONTROL) if self.may_steer else None
        self.simulator = Presence(session, keys.SIMULATOR_NAME)
        self._sender = threading.Thread(target=self._send, name="outrider-operator", daemon=True)
        self._sender.start()

    @property
    def name(self) -> str:
        """Name of the party."""
        return self._session.party.name

    @property
    def connected(self) -> bool:
        """True if the router is connected."""
        return self._session.connected

    @property
    def age(self) -> float:
        """Time since the simulator's last message, or since it joined [s]."""
        return time.monotonic() - max(self._received, self.simulator.joined)

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time, averaged over the last second.

        The factor in a single status covers only a few ticks.
        """
        if len(self._clock) < 2:
            return 0.0 if self.status is None else self.status.realtime_factor
        (began, start), (now, end) = self._clock[0], self._clock[-1]
        return (end - start) / max(now - began, 1e-3)

    def news(self) -> Iterator[Message]:
        """Yield the newest status, truth, coverage and ground map that arrived since the last call."""
        with contextlib.suppress(BusError):  # the session closes
            for inbox in self._inboxes:
                received = inbox.next_waiting()
                if received is not None:
                    self._store(received.message)
                    yield received.message

    def _store(self, message: Message) -> None:
        match message:
            case Status():
                self.status, self._received = message, time.monotonic()
                if message.time == 0.0 or (self._clock and message.time < self._clock[-1][1]):
                    self._clock.clear()  # before the first tick, or another flight
                self._clock.append((self._received, message.time))
            case Truth():
                self.truth, self._received = message, time.monotonic()
            case CoverageMap():
                self.coverage = message
            case GroundMap():
                self.ground = message

    def control(self, control: Control) -> bool:
        """Queue a control for the simulator; return false if it cannot be sent."""
        return self._controls is not None and self._queue(self._controls, control)

    def drive(self, vehicle: str, drive: Teleoperation) -> bool:
        """Queue a command for a UGV; return false if it cannot be sent."""
        if not self.may_steer:
            return False
        if vehicle not in self._outboxes:
            self._outboxes[vehicle] = self._session.outbox(keys.OPERATOR, vehicle)
        return self._queue(self._outboxes[vehicle], drive)

    def _queue(self, outbox: Outbox, message: Message) -> bool:
        try:
            self._unsent.put_nowait((outbox, message))
        except queue.Full:
            self.fault = "the bus accepts no more messages"
            return False
        return True

    def _send(self) -> None:
        """Send the queued messages, in a separate thread, as the bus may block a sender."""
        while (unsent := self._unsent.get()) is not None:
            outbox, message = unsent
            try:
                outbox.send(message)
                self.fault = ""
            except (BusError, ValueError) as error:
                self.fault = str(error)

    def close(self) -> None:
        """Send the queued messages, and close the client for sending."""
        with contextlib.suppress(queue.Full):
            self._unsent.put_nowait(None)
            self._sender.join(1.0)


def request_of(status: Status | None, ugv: str, request: Request) -> Control | None:
    """Return the control that calls or relieves a UAV of a UGV's team; None: no UAV can follow.

    RELIEF goes to the guard with the smallest number, GUARD to the scout with the largest charge.
    """
    if status is None or status.team is None or status.geometry is None:
        return None
    numbers, charges = status.team.numbers, status.team.charges
    team = [uav for uav, its in status.geometry.uavs.items() if its == ugv and uav in numbers]
    wanted = Role.GUARD if request is Request.RELIEF else Role.SCOUT
    found = [uav for uav in sorted(team) if status.roles.get(uav) is wanted]
    if not found:
        return None
    if request is Request.RELIEF:
        uav = min(found, key=lambda name: numbers[name])
    else:
        uav = max(found, key=lambda name: charges.get(name, math.inf))
    return Control(action=Action.REQUEST, vehicle=uav, request=request)


class Helm:
    """Transfer of control over UGVs to an operator, and back to the previous driver.

    Args:
        control: Sends a control to the simulator.
        drive: Sends a command to a UGV, by the UGV's name.
    """

    def __init__(
        self, control: Callable[[Control], bool], drive: Callable[[str, Teleoperation], bool]
    ) -> None:
        self._control, self._drive = control, drive
        self._before: dict[str, str] = {}
        self.operator = f"operator_{secrets.token_hex(6)}"
        """Unique name of the operator, even among operators with the same credentials."""

    def take(self, vehicle: str, driver: str) -> bool:
        """Request control over a UGV from its current driver; return false if the request cannot be sent."""
        if driver not in ("", TELEOP):
            self._before[vehicle] = driver
        return self._control(
            Control(action=Action.DRIVER, vehicle=vehicle, driver=TELEOP, operator=self.operator)
        )

    def holds(self, status: Status | None, vehicle: str) -> bool:
        """Return true if this operator controls the UGV."""
        return _operator_of(status, vehicle) == self.operator

    def displaced(self, status: Status | None, vehicle: str) -> bool:
        """Return true if another operator controls the UGV."""
        return _operator_of(status, vehicle) not in ("", self.operator)

    def steer(self, vehicle: str, drive: Teleoperation) -> bool:
        """Send an operator's input to a UGV; return false if it cannot be sent."""
        return self._drive(vehicle, drive)

    def hand_back(self, vehicle: str, to: str = "") -> str:
        """Return control to a driver, by default the previous one; return its name, empty if none is known."""
        heir = to or self._before.get(vehicle, "")
        if heir and self._control(Control(action=Action.DRIVER, vehicle=vehicle, driver=heir)):
            self._before.pop(vehicle, None)
            return heir
        return ""

    def waiting(self, status: Status | None) -> list[str]:
        """Return the UGVs that this operator controls and whose previous driver is known."""
        return [
            name
            for name, driver in ({} if status is None else status.drivers).items()
            if driver == TELEOP and name in self._before and not self.displaced(status, name)
        ]


def _operator_of(status: Status | None, vehicle: str) -> str:
    """Return the operator that controls a UGV; empty: none or unknown."""
    if status is None or status.drivers.get(vehicle) != TELEOP:
        return ""
    return status.operators.get(vehicle, "")
