"""The bus of a run as the hub has it: what the simulator tells, and what operators say."""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Iterator

from bus.boxes import Outbox
from bus.errors import BusError
from bus.keys import CONTROL, COVERAGE, GLANCE, OPERATOR, SIMULATOR_NAME, STATUS, Role
from bus.messages import Control, Drive, Message, Status, Truth
from bus.session import Session
from outrider.view.page.source import Standing

_LOG = logging.getLogger("outrider.view.page")
_PACE = 6
"""Status messages, about a second of them, over which the real-time factor is taken."""
_SILENCE = 2.0
"""Without a status for so long [s] something is wrong."""


class Live:
    """A run that is flown now.

    Nobody waits for us: the inboxes keep the newest message alone.

    Args:
        session: An operator's, or an observer's; then nothing can be steered.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._inboxes = [session.inbox(key, newest=1) for key in (STATUS, GLANCE, COVERAGE)]
        self._simulators: set[int] = set()
        self._seen_simulator = self._over = False
        self._heard = time.monotonic()
        self._told = 0.0
        self._clock: deque[tuple[float, float]] = deque(maxlen=_PACE)
        self._drives: dict[str, Outbox] = {}
        self._words: queue.Queue[tuple[Outbox, Message] | None] = queue.Queue(maxsize=64)
        self.may_steer = session.party.role is Role.OPERATOR
        self._controls = session.outbox(CONTROL) if self.may_steer else None
        session.watch(SIMULATOR_NAME, self._see_simulator)
        self._speaker = threading.Thread(target=self._speak, name="outrider-operator", daemon=True)
        self._speaker.start()

    def _see_simulator(self, _name: str, place: int, present: bool) -> None:
        if present:
            self._simulators.add(place)
            self._seen_simulator = True
            self._heard = time.monotonic()
        else:
            self._simulators.discard(place)

    def news(self) -> Iterator[Message]:
        """What has come since the last call."""
        with contextlib.suppress(BusError):  # the session closes
            for inbox in self._inboxes:
                letter = inbox.next_waiting()
                if letter is None:
                    continue
                if isinstance(letter.message, Status | Truth):
                    self._heard = time.monotonic()
                if isinstance(letter.message, Status):
                    self._set_clock(letter.message)
                yield letter.message

    def _set_clock(self, status: Status) -> None:
        if status.time == 0.0 or (self._clock and status.time < self._clock[-1][1]):
            self._clock.clear()  # nothing flown yet, or another flight
        self._clock.append((self._heard, status.time))
        self._over, self._told = status.over, status.realtime_factor

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time, over the last second.

        A status alone counts few ticks in real time.
        """
        if len(self._clock) < 2:
            return self._told
        (began, start), (now, end) = self._clock[0], self._clock[-1]
        return (end - start) / max(now - began, 1e-3)

    @property
    def standing(self) -> Standing:
        """How it stands, and what is wrong in one line."""
        level, line = self._banner()
        return Standing(
            level=level, line=line, router=self._session.connected, simulator=bool(self._simulators)
        )

    def _banner(self) -> tuple[str, str]:
        silence = time.monotonic() - self._heard
        if not self._session.connected:
            if self._over:
                return "info", "The run is over, and its router has left. Waiting for the next one."
            return (
                "bad",
                "The router is away: this page is cut off from the run, and shows what it knew last.",
            )
        if not self._simulators:
            if self._over:
                return (
                    "info",
                    "The run is over and its simulator has left. Waiting for the next one.",
                )
            if self._seen_simulator:
                return (
                    "bad",
                    "The simulator is gone: its process has died or has lost its way. Waiting for it to come back.",
                )
            return "info", "Waiting for a simulator to join the run."
        if self._over:
            return "info", "The run is over."
        if silence > _SILENCE:
            return "bad", f"The simulator has said nothing for {silence:.0f} s."
        return "", ""

    def control(self, control: Control) -> bool:
        """Say something to the simulator; False if it cannot be said."""
        return self._controls is not None and self._say(self._controls, control)

    def drive(self, vehicle: str, drive: Drive) -> bool:
        """Say something to a UGV; False if it cannot be said."""
        if not self.may_steer:
            return False
        if vehicle not in self._drives:
            self._drives[vehicle] = self._session.outbox(OPERATOR, vehicle)
        return self._say(self._drives[vehicle], drive)

    def _say(self, outbox: Outbox, message: Message) -> bool:
        try:
            self._words.put_nowait((outbox, message))
        except queue.Full:
            return False
        return True

    def _speak(self) -> None:
        """In a thread of its own: the bus may make a writer wait."""
        while (word := self._words.get()) is not None:
            outbox, message = word
            try:
                outbox.send(message)
            except (BusError, ValueError) as error:
                _LOG.warning("not sent: %s", error)

    def close(self) -> None:
        """Say no more."""
        with contextlib.suppress(queue.Full):
            self._words.put_nowait(None)
            self._speaker.join(1.0)
