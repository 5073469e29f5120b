"""Distribution of a live or recorded run to the browsers.

Each browser receives the newest state at its own pace: it gets no new frame until it has drawn earlier ones. A slow
browser delays neither the run nor the other browsers.
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
from outrider_dashboard.budget_job import BudgetJob
from outrider_dashboard.chart_data import ChartData
from outrider_dashboard.controls.link_settings import describe_links
from outrider_dashboard.controls.teleoperation import SharedTeleoperation
from outrider_dashboard.sources.protocol import Source
from sim.scene.model import Scene, observed_scene

FRAME = 0.05
"""Minimum wall time between two frames to one browser [s]."""
_POLL = 0.0125
"""Wall time between two polls of the source [s]."""
_IDLE_POLL = 0.1
"""Wall time between two polls while no browser is connected [s]."""
_ALIVE = 0.5
"""Maximum wall time between two frames to one browser, even without new messages [s]."""
_MAX_UNDRAWN = 2
"""Frames sent to a browser before it must confirm drawing one."""
_CHANGES = 20
"""Maximum number of changes listed in a status."""

_PARTS: dict[type[Message], str] = {
    Truth: "truth",
    Status: "status",
    CoverageMap: "map",
    GroundMap: "ground",
}
"""Names in a frame of the messages that a browser receives."""


class Browser:
    """One connected page."""

    def __init__(self, number: int, name: str) -> None:
        self.number, self.name = number, name
        self.ready = asyncio.Event()
        self.due = self.sent = 0.0
        self.undrawn = 0
        self.versions = dict.fromkeys(_PARTS, 0)
        """Version of each message sent last."""
        self.generation, self.rows = -1, 0

    def is_due(self, now: float, news: bool) -> bool:
        """Return True if a frame should be sent now."""
        due = self.undrawn < _MAX_UNDRAWN and now >= self.due
        return due and (news or now - self.sent >= _ALIVE)


class Hub:
    """Newest state of a run, and the connected browsers.

    Args:
        source: Live or recorded run.
        law: Initial law of the UAVs, if known.
        on_end: Called when all browsers have received the end of a run.
        scenario: Resolved scenario as TOML; empty: unknown.
    """

    def __init__(
        self,
        source: Source,
        law: Law | None = None,
        on_end: Callable[[], None] = lambda: None,
        scenario: str = "",
    ) -> None:
        self.budget = BudgetJob(scenario)
        self.source = source
        self.history = ChartData()
        self.status: Status | None = None
        self.truth: Truth | None = None
        self.first_law = law
        self.browsers: dict[int, Browser] = {}
        self.teleoperation = SharedTeleoperation(source.control, source.drive)
        self._on_end, self._end_reported = on_end, False
        self._numbers = 0
        self._versions = dict.fromkeys(_PARTS, 0)
        self._raw: dict[type[Message], msgspec.Raw] = {}

    async def follow(self) -> None:
        """Poll the source and schedule the frames of each browser, until cancelled."""
        while True:
            self.update()
            self.teleoperation.check()
            now = time.monotonic()
            for browser in self.browsers.values():
                if browser.is_due(now, self._has_news(browser)):
                    browser.due = max(browser.due, now - FRAME) + FRAME
                    browser.sent = now
                    browser.ready.set()
            self._report_end()
            await asyncio.sleep(_POLL if self.browsers else _IDLE_POLL)

    def _report_end(self) -> None:
        if self.status is None or not self.status.over:
            self._end_reported = False
        elif not self._end_reported and not any(map(self._has_news, self.browsers.values())):
            self._end_reported = True
            self._on_end()

    def update(self) -> None:
        """Process the new messages of the source."""
        newest: dict[type[Message], Message] = {}
        for message in self.source.news():
            newest[type(message)] = message
            if isinstance(message, Status):
                self.status = message
                self.history.losses.update(message)
                self.teleoperation.update(message)
            elif isinstance(message, Truth):
                self.truth = message
                self.history.add(message, self.source.factor, self._dt)
        for message in newest.values():
            self._store(message)

    def _store(self, message: Message) -> None:
        kind = type(message)
        encoded = msgspec.Raw(msgspec.json.encode(message))
        if kind in (CoverageMap, GroundMap) and self._raw.get(kind) == encoded:
            return
        self._raw[kind] = encoded
        self._versions[kind] += 1

    @property
    def scene(self) -> Scene | None:
        """Scene of the map; None until it is known."""
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
        """Driver of each UGV."""
        if self.status is None:
            return {}
        if self.status.drivers:
            return self.status.drivers
        return {ugv: "" for _, ugv in self.history.escorts}

    def has_uav(self, name: str) -> bool:
        """Return True if the run has a UAV of this name."""
        return any(uav == name for uav, _ in self.history.escorts)

    @property
    def law(self) -> Law | None:
        """Current law of the UAVs with its gains; None if the gains are unknown."""
        return None if self.status is None else running_law(self.status, self.first_law)

    def close(self) -> None:
        """Release control, end the computation, and close the source."""
        self.budget.close()
        self.teleoperation.release()
        self.source.close()

    # Browsers

    def add_browser(self, host: str) -> Browser:
        """Register a page, opened on this machine or another."""
        self._numbers += 1
        browser = Browser(
            self._numbers, f"browser {self._numbers}" + ("" if host in LOOPBACK else f" at {host}")
        )
        self.browsers[browser.number] = browser
        return browser

    def remove_browser(self, browser: Browser) -> None:
        """Unregister a closed page and release its control."""
        self.browsers.pop(browser.number, None)
        self.teleoperation.leave(browser.number)

    def _has_news(self, browser: Browser) -> bool:
        return browser.versions != self._versions

    def frame(self, browser: Browser) -> bytes:
        """Return the messages that are new to this browser, as JSON."""
        frame: dict[str, Any] = {"kind": "frame", "state": self._state(browser)}
        for kind, version in self._versions.items():
            if browser.versions[kind] != version:
                frame[_PARTS[kind]], browser.versions[kind] = self._raw[kind], version
        if "truth" in frame:
            frame["now"] = self.history.newest
        if "status" in frame:
            frame["links"] = None if self.status is None else describe_links(self.status)
        history = self.history
        if browser.generation != history.generation:
            frame["history"] = {"vehicles": history.vehicles, "escorts": history.escorts}
            browser.generation, browser.rows = history.generation, 0
        if "status" in frame or "history" in frame:
            frame["scene"] = self.scene
        if browser.rows < len(history.rows):
            frame["rows"] = history.rows[browser.rows :]
            browser.rows = len(history.rows)
        browser.undrawn += 1
        return msgspec.json.encode(frame)

    def _state(self, browser: Browser) -> dict[str, Any]:
        teleoperation = self.teleoperation
        return {
            **msgspec.structs.asdict(self.source.state),
            "factor": self.source.factor,
            "browsers": len(self.browsers),
            "control": "mine"
            if teleoperation.holder == browser.number
            else "other"
            if teleoperation.holder
            else "free",
            "operator": teleoperation.name,
            "vehicle": teleoperation.vehicle,
            "can_hand_back": teleoperation.can_be_handed_back(),
            "other_operators": teleoperation.other_operators(),
        }


def running_law(status: Status, first: Law | None) -> Law | None:
    """Return the current law with its gains; None if the gains are unknown.

    Args:
        status: Status with the law's name and the latest changes; a reset restores the initial law.
        first: Initial law, if known.
    """
    changes = status.changes
    start = max(
        (k + 1 for k, change in enumerate(changes) if change.control.action is Action.RESET),
        default=0,
    )
    chosen = [
        change.control.law for change in changes[start:] if change.control.action is Action.LAW
    ]
    complete = start or len(changes) < _CHANGES
    law = chosen[-1] if chosen else first if complete else None
    return law if law is not None and law.name == status.law else None
