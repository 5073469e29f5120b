"""Between a run, or its recording, and the browsers.

The newest of everything, to each as fast as it can take it and not faster.

Nobody waits for a browser: one that has not drawn its last frames gets no new one.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from bus.locator import LOOPBACK
from bus.messages.base import Message
from bus.messages.control import Action
from bus.messages.ground import GroundMap
from bus.messages.scenario import Law
from bus.messages.telemetry import CoverageMap, Status, Truth
from outrider_dashboard.chart_data import ChartData
from outrider_dashboard.controls.link_words import said_of_links
from outrider_dashboard.controls.wheel import SharedWheel
from outrider_dashboard.sources.protocol import Source
from sim.scene.model import Scene, observed_scene

FRAME = 0.05
"""Wall time between two frames of one browser at least [s]."""
_POLL = 0.0125
"""Wall time between two looks for news [s]."""
_IDLE_POLL = 0.1
"""The same while nobody looks on."""
_ALIVE = 0.5
"""A browser is sent something at least this often [s], also when nothing moves."""
_AHEAD = 2
"""Frames that a browser may have in hand."""
_CHANGES = 20
"""So many changes a status tells at most."""


_PARTS: dict[type[Message], str] = {
    Truth: "truth",
    Status: "status",
    CoverageMap: "map",
    GroundMap: "ground",
}
"""The messages of which a browser gets the newest, by their names in a frame."""


class Browser:
    """One page that looks on."""

    def __init__(self, number: int, name: str) -> None:
        self.number, self.name = number, name
        self.turn = asyncio.Event()
        self.due = self.told = 0.0
        self.in_hand = 0
        self.versions = dict.fromkeys(_PARTS, 0)
        """Those that it has."""
        self.generation, self.rows = -1, 0

    def is_due(self, now: float, news: bool) -> bool:
        """True if it can take a frame now."""
        return self.in_hand < _AHEAD and now >= self.due and (news or now - self.told >= _ALIVE)


class Hub:
    """Keeps the newest of a run, and the browsers that look on.

    Args:
        source: Where it is flown, or played.
        law: What the UAVs fly at first, where that is known.
        on_end: Called when all browsers have been given the end of a flight.
    """

    def __init__(
        self, source: Source, law: Law | None = None, on_end: Callable[[], None] = lambda: None
    ) -> None:
        self.source = source
        self.history = ChartData()
        self.status: Status | None = None
        self.first_law = law
        self.browsers: dict[int, Browser] = {}
        self.wheel = SharedWheel(source.control, source.drive)
        self._on_end, self._end_is_told = on_end, False
        self._numbers = 0
        self._versions = dict.fromkeys(_PARTS, 0)
        self._raw: dict[type[Message], msgspec.Raw] = {}

    async def follow(self) -> None:
        """Look for news and give each browser its turn, until cancelled."""
        while True:
            self.take_in()
            self.wheel.check()
            now = time.monotonic()
            for browser in self.browsers.values():
                if browser.is_due(now, self._has_news(browser)):
                    browser.due = max(browser.due, now - FRAME) + FRAME
                    browser.told = now
                    browser.turn.set()
            self._tell_of_the_end()
            await asyncio.sleep(_POLL if self.browsers else _IDLE_POLL)

    def _tell_of_the_end(self) -> None:
        if self.status is None or not self.status.over:
            self._end_is_told = False
        elif not self._end_is_told and not any(map(self._has_news, self.browsers.values())):
            self._end_is_told = True
            self._on_end()

    def take_in(self) -> None:
        """Take what has come."""
        newest: dict[type[Message], Message] = {}
        for message in self.source.news():
            newest[type(message)] = message
            if isinstance(message, Status):
                self.status = message
                self.history.losses.take(message)
                self.wheel.follow(message)
            elif isinstance(message, Truth):
                self.history.add(message, self.source.factor, self._dt)
        for message in newest.values():
            self._keep(message)

    def _keep(self, message: Message) -> None:
        kind = type(message)
        encoded = msgspec.Raw(msgspec.json.encode(message))
        if kind in (CoverageMap, GroundMap) and self._raw.get(kind) == encoded:
            return
        self._raw[kind] = encoded
        self._versions[kind] += 1

    @property
    def _scene(self) -> Scene | None:
        """The map's scene, as far as it is known."""
        status, escorts = self.status, dict(self.history.escorts)
        if status is None or not self.history.vehicles:
            return None
        return observed_scene(
            status.scenario, status.geometry, escorts=escorts, vehicles=self.history.vehicles
        )

    @property
    def _dt(self) -> float:
        geometry = None if self.status is None else self.status.geometry
        return 0.0 if geometry is None else geometry.dt

    @property
    def drivers(self) -> Mapping[str, str]:
        """The driver of each UGV."""
        if self.status is None:
            return {}
        if self.status.drivers:
            return self.status.drivers
        return {ugv: "" for _, ugv in self.history.escorts}

    @property
    def law(self) -> Law | None:
        """The UAVs' law now, with its gains; None where those are not known."""
        return None if self.status is None else running_law(self.status, self.first_law)

    def close(self) -> None:
        """Say no more."""
        self.wheel.release()
        self.source.close()

    # What goes to the browsers

    def welcome(self, host: str) -> Browser:
        """A page has opened, on this machine or another."""
        self._numbers += 1
        browser = Browser(
            self._numbers, f"browser {self._numbers}" + ("" if host in LOOPBACK else f" at {host}")
        )
        self.browsers[browser.number] = browser
        return browser

    def leave(self, browser: Browser) -> None:
        """A page has gone."""
        self.browsers.pop(browser.number, None)
        self.wheel.leave(browser.number)

    def _has_news(self, browser: Browser) -> bool:
        return browser.versions != self._versions

    def frame(self, browser: Browser) -> bytes:
        """All that is new for this browser, as JSON."""
        frame: dict[str, Any] = {"kind": "frame", "state": self._state(browser)}
        for kind, version in self._versions.items():
            if browser.versions[kind] != version:
                frame[_PARTS[kind]], browser.versions[kind] = self._raw[kind], version
        if "truth" in frame:
            frame["now"] = self.history.newest
        if "status" in frame:
            frame["links"] = None if self.status is None else said_of_links(self.status)
        history = self.history
        if browser.generation != history.generation:
            frame["history"] = {"vehicles": history.vehicles, "escorts": history.escorts}
            browser.generation, browser.rows = history.generation, 0
        if "status" in frame or "history" in frame:
            frame["scene"] = self._scene
        if browser.rows < len(history.rows):
            frame["rows"] = history.rows[browser.rows :]
            browser.rows = len(history.rows)
        browser.in_hand += 1
        return msgspec.json.encode(frame)

    def _state(self, browser: Browser) -> dict[str, Any]:
        wheel = self.wheel
        return {
            **msgspec.structs.asdict(self.source.standing),
            "factor": self.source.factor,
            "browsers": len(self.browsers),
            "wheel": "mine"
            if wheel.holder == browser.number
            else "other"
            if wheel.holder
            else "free",
            "driver": wheel.name,
            "vehicle": wheel.vehicle,
            "full": wheel.full,
            "back": wheel.can_be_handed_back(),
            "strangers": wheel.strangers(),
        }


def running_law(status: Status, first: Law | None) -> Law | None:
    """The law that is flown, with its gains; None where those are not known.

    Args:
        status: Tells its name, and the last changes; a reset brings the first law back.
        first: What was flown at first, where that is known.
    """
    changes = status.changes
    begun = max(
        (k + 1 for k, change in enumerate(changes) if change.control.action is Action.RESET),
        default=0,
    )
    chosen = [
        change.control.law for change in changes[begun:] if change.control.action is Action.LAW
    ]
    complete = begun or len(changes) < _CHANGES
    law = chosen[-1] if chosen else first if complete else None
    return law if law is not None and law.name == status.law else None
