"""Between the bus and the browsers: the newest of everything, to each as fast as it can take it and not faster.

Nobody waits for a browser: the inboxes keep the newest message alone, and a browser that has not drawn its last frames gets no
new one.
"""

import asyncio
import contextlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import msgspec

from bus.boxes import Outbox
from bus.errors import BusError
from bus.keys import CONTROL, COVERAGE, OPERATOR, SIMULATOR_NAME, STATUS, TRUTH, Role
from bus.messages import Control, CoverageMap, Drive, Message, Status, Truth
from bus.session import Session
from outrider.dashboard import LOOPBACK
from outrider.dashboard.history import History
from outrider.dashboard.wheel import Wheel

_LOG = logging.getLogger("outrider.dashboard")
FRAME = 0.05
"""Wall time between two frames of one browser at least [s]."""
_POLL = 0.0125
"""Wall time between two looks at the bus [s]."""
_IDLE_POLL = 0.1
"""The same while nobody looks on."""
_PACE = 6
"""Status messages, about a second of them, over which the real-time factor is taken."""
_SILENCE = 2.0
"""Without a status for so long [s] something is wrong."""
_ALIVE = 0.5
"""A browser hears something at least this often [s], also when nothing moves."""
_AHEAD = 2
"""Frames that a browser may have in hand."""


class Browser:
    """One page that looks on."""

    def __init__(self, number: int, name: str) -> None:
        self.number, self.name = number, name
        self.turn = asyncio.Event()
        self.due = self.told = 0.0
        self.in_hand = 0
        self.truth = self.status = self.map = 0  # versions that it has
        self.generation, self.rows = -1, 0

    def is_due(self, now: float, news: bool) -> bool:
        """Whether it can take a frame now."""
        return self.in_hand < _AHEAD and now >= self.due and (news or now - self.told >= _ALIVE)


class Hub:
    """What is known of the run, and who looks on.

    Args:
        session: An operator's, or an observer's; then nothing can be steered.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._inboxes = [session.inbox(key, newest=1) for key in (STATUS, TRUTH, COVERAGE)]
        self._simulators: set[str] = set()
        self._seen_simulator = False
        self._heard = time.monotonic()
        self._numbers = 0
        self._clock: deque[tuple[float, float]] = deque(maxlen=_PACE)
        self._versions = {Truth: 0, Status: 0, CoverageMap: 0}
        self._raw: dict[type[Message], msgspec.Raw] = {}
        self._drives: dict[str, Outbox] = {}
        self._words: queue.Queue[tuple[Outbox, Message] | None] = queue.Queue(maxsize=64)
        self.may_steer = session.party.role is Role.OPERATOR
        self._controls = session.outbox(CONTROL) if self.may_steer else None
        self.history = History()
        self.status: Status | None = None
        self.browsers: dict[int, Browser] = {}
        self.wheel = Wheel(self.control, self.drive)
        session.watch(SIMULATOR_NAME, self._see_simulator)
        self._speaker = threading.Thread(target=self._speak, name="outrider-operator", daemon=True)
        self._speaker.start()

    # What comes from the bus

    def _see_simulator(self, _name: str, session: str, present: bool) -> None:
        if present:
            self._simulators.add(session)
            self._seen_simulator = True
            self._heard = time.monotonic()
        else:
            self._simulators.discard(session)

    async def follow(self) -> None:
        """Look at the bus and give each browser its turn, until cancelled."""
        while True:
            with contextlib.suppress(BusError):  # the session closes
                self._take_in()
            self.wheel.check(self.drivers)
            now = time.monotonic()
            for browser in self.browsers.values():
                if browser.is_due(now, self._has_news(browser)):
                    browser.due = max(browser.due, now - FRAME) + FRAME
                    browser.told = now
                    browser.turn.set()
            await asyncio.sleep(_POLL if self.browsers else _IDLE_POLL)

    def _take_in(self) -> None:
        for inbox in self._inboxes:
            letter = inbox.next_waiting()
            message = None if letter is None else letter.message
            if isinstance(message, Status):
                self._heard = time.monotonic()
                self._set_clock(message)
                self.status = message
                self._keep(message)
            elif isinstance(message, Truth):
                self._heard = time.monotonic()
                self.history.add(message, self.factor, self._dt)
                self._keep(message)
            elif isinstance(message, CoverageMap):
                self._keep(message)

    def _keep(self, message: Message) -> None:
        kind = type(message)
        encoded = msgspec.json.encode(message)
        if kind is CoverageMap and kind in self._raw and bytes(self._raw[kind]) == encoded:
            return
        self._raw[kind] = msgspec.Raw(encoded)
        self._versions[kind] += 1

    def _set_clock(self, status: Status) -> None:
        if self._clock and status.time < self._clock[-1][1]:
            self._clock.clear()  # another flight
        self._clock.append((self._heard, status.time))

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time, over the last second: a status alone counts few ticks in real time."""
        if len(self._clock) < 2:
            return 0.0 if self.status is None else self.status.realtime_factor
        (began, start), (now, end) = self._clock[0], self._clock[-1]
        return (end - start) / max(now - began, 1e-3)

    @property
    def _dt(self) -> float:
        geometry = None if self.status is None else self.status.geometry
        return 0.0 if geometry is None else geometry.dt

    @property
    def drivers(self) -> Mapping[str, str]:
        """Who drives each UGV."""
        if self.status is None:
            return {}
        if self.status.drivers:
            return self.status.drivers
        return {ugv: "" for _, ugv in self.history.escorts}

    # What goes to the bus

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
        self.wheel.release()
        with contextlib.suppress(queue.Full):
            self._words.put_nowait(None)
            self._speaker.join(1.0)

    # What goes to the browsers

    def welcome(self, host: str) -> Browser:
        """A page has opened, on this machine or another."""
        self._numbers += 1
        browser = Browser(self._numbers, f"browser {self._numbers}" + ("" if host in LOOPBACK else f" at {host}"))
        self.browsers[browser.number] = browser
        return browser

    def leave(self, browser: Browser) -> None:
        """A page has gone."""
        self.browsers.pop(browser.number, None)
        self.wheel.leave(browser.number)

    def _has_news(self, browser: Browser) -> bool:
        have = (browser.truth, browser.status, browser.map)
        return have != (self._versions[Truth], self._versions[Status], self._versions[CoverageMap])

    def frame(self, browser: Browser) -> bytes:
        """What this browser does not know yet, as JSON."""
        frame: dict[str, Any] = {"kind": "frame", "state": self._state(browser)}
        versions = self._versions
        if browser.truth != versions[Truth]:
            frame["truth"], frame["now"] = self._raw[Truth], self.history.newest
        if browser.status != versions[Status]:
            frame["status"] = self._raw[Status]
        if browser.map != versions[CoverageMap]:
            frame["map"] = self._raw[CoverageMap]
        browser.truth, browser.status, browser.map = versions[Truth], versions[Status], versions[CoverageMap]
        history = self.history
        if browser.generation != history.generation:
            frame["history"] = {"vehicles": history.vehicles, "escorts": history.escorts}
            browser.generation, browser.rows = history.generation, 0
        if browser.rows < len(history.rows):
            frame["rows"] = history.rows[browser.rows :]
            browser.rows = len(history.rows)
        browser.in_hand += 1
        return msgspec.json.encode(frame)

    def _state(self, browser: Browser) -> dict[str, Any]:
        level, line = self._banner()
        wheel = self.wheel
        return {
            "level": level,
            "line": line,
            "router": self._session.connected,
            "factor": self.factor,
            "simulator": bool(self._simulators),
            "browsers": len(self.browsers),
            "wheel": "mine" if wheel.holder == browser.number else "other" if wheel.holder else "free",
            "driver": wheel.name,
            "vehicle": wheel.vehicle,
            "full": wheel.full,
            "back": wheel.can_be_handed_back(self.drivers),
        }

    def _banner(self) -> tuple[str, str]:
        """What is wrong, in one line, and how badly: `bad`, `info`, or nothing."""
        silence = time.monotonic() - self._heard
        over = self.status is not None and self.status.over
        if not self._session.connected:
            return "bad", "The router is away: this page is cut off from the run, and shows what it knew last."
        if not self._simulators:
            if over:
                return "info", "The run is over and its simulator has left. Waiting for the next one."
            if self._seen_simulator:
                return "bad", "The simulator is gone: its process has died or has lost its way. Waiting for it to come back."
            return "info", "Waiting for a simulator to join the run."
        if over:
            return "info", "The run is over."
        if silence > _SILENCE:
            return "bad", f"The simulator has said nothing for {silence:.0f} s."
        return "", ""
