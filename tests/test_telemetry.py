"""Telemetry: every scenario's fits its messages, and no error of it changes a run."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from bus.errors import BusError, ScenarioError
from bus.keys import COVERAGE, GROUND, KEYS, SAMPLED_TRUTH, STATUS, TRUTH, Key
from bus.messages.base import LONGEST_TEXT, fitted, fitted_lines
from bus.messages.buildings import MOST_BUILDING_CORNERS, MOST_BUILDINGS, Building
from bus.messages.telemetry import CoverageMap
from bus.profiles import PROFILES
from outrider.running.assumptions import assumption_warnings
from outrider.running.flying import fly
from outrider.running.parent import Output
from outrider.running.summary import summarize
from processes import wait_until
from refusals import refused
from sim.scenario.loading import load_scenario, scenario_names
from sim.scene.known import geometry_of
from sim.server.flight import Flight
from sim.server.telemetry import Telemetry
from staging import stage
from statuses import a_status

TELEMETRY = (TRUTH, SAMPLED_TRUTH, COVERAGE, STATUS, GROUND)


class Reader:
    """Outbox of one key that always has a reader, which decodes what it receives."""

    wanted = True

    def __init__(self, key: Key) -> None:
        self._key = key
        self.received: list[Any] = []

    def send(self, message: Any) -> None:
        payload = msgspec.json.encode(message)
        assert len(payload) <= self._key.largest
        self.received.append(msgspec.json.decode(payload, type=self._key.message))


class Refusing:
    """Outbox whose session fails."""

    wanted = True

    def __init__(self, fault: Exception) -> None:
        self._fault = fault

    def send(self, _message: Any) -> None:
        raise self._fault


def telemetry_of(
    flight: Flight,
    outbox: Callable[[Key], Any],
    on_event: Callable[[str], None],
    warn: Any = assumption_warnings,
) -> Telemetry:
    """Return the telemetry of a flight over these outboxes."""
    session: Any = SimpleNamespace(outbox=outbox)
    sessions: Any = SimpleNamespace(follow=lambda: None, statuses=dict)
    pace = SimpleNamespace(factor=None)
    operators: Any = SimpleNamespace(
        pace=pace, late_ticks=0, paused=False, operators={}, changes=[], rejections=[]
    )
    return Telemetry(session, flight, sessions, operators, warn, on_event)


@pytest.mark.parametrize("name", scenario_names())
def test_telemetry_fits_its_messages_with_every_profile(name: str) -> None:
    flight = Flight(load_scenario(name), 1)
    for profile in PROFILES:
        scenario = load_scenario(name, overrides=[("links.profile", profile)])
        readers = {key.topic: Reader(key) for key in KEYS}
        events: list[str] = []

        def warn(_scenario: Any, _links: Any, flown: Any = scenario) -> tuple[str, ...]:
            return assumption_warnings(flown)

        telemetry = telemetry_of(flight, lambda key, at=readers: at[key.topic], events.append, warn)
        telemetry.send_tick()
        assert not telemetry.faults, events
        status = readers["status"].received[0]
        assert len(status.warnings) == len(assumption_warnings(scenario))
        grounded = {"ground"} if flight.scenario.has_ground else set()
        sent = {topic for topic, reader in readers.items() if reader.received}
        assert sent == {"truth", "sampled-truth", "coverage", "status"} | grounded


def test_long_warning_keeps_its_start_and_its_remedy() -> None:
    scenario = load_scenario("minefield", overrides=[("links.profile", "jammed")])
    line = max(assumption_warnings(scenario), key=len)
    assert len(line) > LONGEST_TEXT
    short = fitted(line)
    start, gap, end = short.partition(" … ")
    assert gap
    assert line.startswith(f"{start} ")
    assert line.endswith(f" {end}")
    assert LONGEST_TEXT - 40 < len(short) <= LONGEST_TEXT
    assert "improve the link" in end
    assert fitted("x" * 999) == f"{'x' * 298} … {'x' * 199}"
    assert fitted("file \udcff") == "file ?"
    assert len(fitted_lines([line] * 1000)) == 51


@pytest.mark.parametrize("profile", ["wifi-poor", "jammed"])
def test_observer_of_a_poor_network_changes_nothing(tmp_path: Path, profile: str) -> None:
    def stop(flight: Flight) -> None:
        if flight.world.tick == 60:
            flight.stop()

    scenario = load_scenario("minefield", overrides=[("links.profile", profile)])
    assert max(map(len, assumption_warnings(scenario))) > LONGEST_TEXT
    with stage(tmp_path, 0, scenario=scenario, warn=assumption_warnings) as run:
        observer = run.client("observer")
        inboxes = [observer.inbox(key, newest=4096) for key in TELEMETRY]
        run.start_both()
        flight = run.fly(lambda: stop(run.server.flight))
        for inbox in inboxes:
            wait_until(inbox.holds_any)
    assert run.server.telemetry_faults == {}
    unobserved = fly(scenario, scenario.seed, on_tick=stop)[0]
    assert flight.recorder.sha256() == unobserved.recorder.sha256()


def fails(fault: Exception) -> Callable[..., Any]:
    """Return a function that raises this."""

    def fail(*_arguments: Any, **_fields: Any) -> Any:
        raise fault

    return fail


def test_telemetry_that_fails_is_counted_and_reported_once(tmp_path: Path) -> None:
    with stage(tmp_path, 200, warn=fails(RuntimeError("no\nwarnings"))) as run:
        observer = run.client("observer")
        truths = observer.inbox(TRUTH, newest=4096)
        observer.inbox(STATUS)
        run.start_both()
        flight = run.fly()
        wait_until(truths.holds_any)
    reported = [event for event in run.events if "observers miss" in event]
    assert len(reported) == 1
    assert r"the status of tick 0: no\nwarnings" in reported[0]
    faults = run.server.telemetry_faults
    assert set(faults) == {"status"}
    assert faults["status"] > 1
    assert summarize(flight, seconds=1.0, telemetry_faults=faults).telemetry_faults == faults
    assert flight.complete
    assert flight.recorder.sha256() == fly(flight.scenario, flight.seed)[1].trajectory_sha256


@pytest.mark.parametrize(
    "fault",
    [
        BusError("cannot send: the session is closed"),
        ValueError("Expected `float`, got `null`"),
        UnicodeEncodeError("utf-8", "\udcff", 0, 1, "surrogates not allowed"),
        RecursionError("maximum recursion depth exceeded"),
        MemoryError(),
    ],
    ids=lambda fault: type(fault).__name__,
)
def test_no_error_of_an_outbox_reaches_the_flight(fault: Exception) -> None:
    flight = Flight(load_scenario("escort"), 1)
    events: list[str] = []
    telemetry = telemetry_of(flight, lambda _key: Refusing(fault), events.append)
    for _ in range(3):
        telemetry.send_tick()
        telemetry.refresh(at_once=True)
    assert dict(telemetry.faults) == {"truth": 3, "sampled-truth": 4, "status": 4, "coverage": 4}
    assert len(events) == 4


def test_largest_map_and_town_fit_their_messages() -> None:
    cells = CoverageMap(tick=0, columns=2000, rows=2000, cell=0.1, cells=bytes(4_000_000))
    corners = tuple((1.0 / (3 + k), 1e-5 / (3 + k)) for k in range(MOST_BUILDING_CORNERS))
    town = (Building(polygon=corners, height=1.0 / 3.0),) * MOST_BUILDINGS
    geometry = geometry_of(load_scenario("town"), town)
    for key, message in ((COVERAGE, cells), (STATUS, a_status(geometry=geometry))):
        Reader(key).send(message)


@pytest.mark.parametrize("option", ["folder", "record"])
def test_output_without_an_encoding_is_refused(option: str) -> None:
    with refused(ScenarioError, "not UTF-8"):
        Output(**{option: "runs/\udcff"})
