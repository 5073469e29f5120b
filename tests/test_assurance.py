"""Certificates against the truth: false claims are counted, unless an assumption failed."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.process import Pilot
from agents.uav import UavPilot
from bus.messages.decision import FilterDecision, NotCertified, Source
from bus.messages.scenario import Law
from bus.messages.vehicle import UavCommand, UavObservation, UavReport
from flights import R_V, Piloted, altered, escort
from outrider.cli.console import OUT
from outrider.cli.summary_table import print_summary
from outrider.experiments.sweep.columns import row_of
from outrider.running.flying import make_pilots
from outrider.running.summary import Summary, summarize
from sim.compiling.records import record_type
from sim.engine.briefing import briefing
from sim.engine.monitor import NEVER, ArrivalRecord, Evidence
from sim.engine.world_state import Vehicle
from sim.models.trajectories import NO_TRAJECTORY, no_trajectories
from sim.scenario.loading import load_scenario
from sim.scenario.types import Certificate, LinkTable, Scenario
from sim.scenario.vehicle_types import Ugv
from sim.server.assurance import Assurance
from sim.server.flight import Flight
from tabular import words

DELAYED = load_scenario(
    "escort",
    overrides={
        "law.name": "certified",
        "links.commands.delay": 0.1,
        "certificate.max_measurement_error": 0.3,
        "certificate.max_measurement_age": 0.5,
    },
)
"""Commands act two ticks late, and the newest detection is at most ten ticks old."""


def report_of(certified: bool, *, distance: float = 1.0) -> UavReport:
    reason = None if certified else NotCertified.NO_PLAN
    decision = FilterDecision(
        acceleration=(0.0, 0.0), source=Source.NOMINAL, reason=reason, certified_distance=distance
    )
    return UavReport(
        estimate=(1.0, 2.0), covariance=(1.0, 0.0, 1.0), age=0.0, rejected=0, decision=decision
    )


def assurance_after(*claims: bool | None, at: float = 1.0) -> Assurance:
    """Return the counters after ticks with these claims and valid assumptions; None: no report."""
    assurance = Assurance(DELAYED)
    for tick, certified in enumerate(claims):
        record_tick(assurance, tick, certified, distance=at)
    return assurance


def record_tick(
    assurance: Assurance,
    tick: int,
    certified: bool | None,
    *,
    distance: float = 1.0,
    arrivals: Sequence[tuple[int, float]] | None = None,
    flown: int | None = None,
    bare: bool = False,
    current: bool = True,
    answers: bool = True,
    off: float = 0.0,
    excused: bool = False,
    watched: bool = True,
) -> None:
    """Record a tick with this claim.

    Args:
        assurance, tick, certified: The counters, the tick, and its claim; None: no report.
        distance: Distance to the UGV [m].
        arrivals: Tick and error [m] of each arriving detection; None: one of this tick.
        flown: First tick of the active trajectory; None: this tick.
        bare: True if a bare acceleration acts.
        current: False if the report is of the previous tick.
        answers: False if there is no command.
        off: Tracking error before the tick [m].
        excused: True if the filter restarts.
        watched: True if the law has a filter.
    """
    if off:
        assurance.track(0, off)
    if excused:
        assurance.excuse(0)
    seen = [(tick, 0.3)] if arrivals is None else arrivals
    evidence = Evidence(
        np.zeros(1, record_type(ArrivalRecord)),
        np.zeros(2, record_type(Vehicle)),
        no_trajectories(2),
    )
    evidence.arrivals["newest"] = max((taken for taken, _ in seen), default=NEVER)
    evidence.arrivals["error"] = max((error for _, error in seen), default=0.0)
    evidence.vehicles["command_tick"] = tick
    evidence.flown["begins"], evidence.flown["plain"] = tick if flown is None else flown, bare
    report = None if certified is None else report_of(certified)
    answered = tick if current else tick - 1
    command = UavCommand(tick=answered, acceleration=(0.0, 0.0), report=report) if answers else None
    lost = distance >= R_V
    assurance.record(0, tick, command, evidence=evidence, lost=lost, watched=watched)


def test_a_tick_that_is_certified_out_of_sight_is_counted() -> None:
    for at, lies in ((R_V - 1e-9, 0), (R_V, 2), (9.0, 2)):
        counted = assurance_after(True, False, True, None, at=at)
        assert (counted.ticks, counted.certified, counted.certified_while_lost) == (4, 2, lies)
    assert assurance_after(False, None, at=9.0).certified_while_lost == 0


def test_certificate_ended_under_its_assumptions_counts_once() -> None:
    assert assurance_after(*[True] * 5, *[False] * 5, True, False, False).certificate_broken == 2
    assert assurance_after(False, False, True, True).certificate_broken == 0


AT = 6
"""The tick at which a certificate ends, unless a case sets another; the tick before was certified."""
Truths = dict[int, dict[str, Any]]


def every(until: int = AT, **truth: Any) -> Truths:
    return dict.fromkeys(range(until + 1), truth)


EXCUSES: dict[str, tuple[Truths, dict[str, Any]]] = {
    "an earlier trajectory was still flown": ({AT - 1: {"flown": AT - 2}}, {}),
    "the trajectory continues after the certificate has ended": ({AT: {"flown": AT - 1}}, {}),
    "a bare acceleration acts, which is late": (every(bare=True), {}),
    "no detection for longer than declared": (every(arrivals=[]), {}),
    "a detection arrives that is older than declared": (
        {tick: {"arrivals": [(tick - 11, 0.0)]} for tick in range(AT + 1)},
        {},
    ),
    "a larger error than declared": ({AT: {"arrivals": [(AT, 0.31)]}}, {}),
    "a larger error than declared long before": ({0: {"arrivals": [(0, 0.31)]}}, {}),
    "the report is of an earlier tick": ({AT: {"current": False}}, {}),
    "the report before was of an earlier tick": ({AT - 1: {"current": False}}, {}),
    "it does not answer at the tick of the only detection that is new enough": (
        every(12, arrivals=[]) | {0: {}, 3: {"arrivals": [(3, 0.0)], "answers": False}},
        {"ends": 12},
    ),
    "there was no detection, however old one may be": (
        every(arrivals=[]),
        {"max_measurement_age": 1e12},
    ),
    "it was once farther than declared from its place": (
        {1: {"off": 0.21}},
        {"max_tracking_error": 0.2},
    ),
    "its law changes or its process joins again": ({AT: {"excused": True}}, {}),
}
NO_EXCUSES: dict[str, tuple[Truths, dict[str, Any]]] = {
    "nothing": ({}, {}),
    "an age of exactly what is declared": (
        every(arrivals=[]) | {0: {"arrivals": [(-4, 0.0)]}},
        {},
    ),
    "an error of exactly what is declared": ({AT: {"arrivals": [(AT, 0.3)]}}, {}),
    "an old detection that comes after newer ones": (
        {AT: {"arrivals": [(AT - 10, 0.0), (AT - 30, 0.0)]}},
        {},
    ),
    "a trajectory continued long before": ({1: {"flown": NO_TRAJECTORY}}, {}),
    "a bare acceleration acts at once": (every(bare=True), {"max_command_delay": 0.0}),
    "a detection that was new enough, and that it has seen": (
        every(12, arrivals=[]) | {0: {}, 3: {"arrivals": [(3, 0.0)]}},
        {"ends": 12},
    ),
    "one detection long ago, where any age is declared": (
        every(arrivals=[]) | {0: {"arrivals": [(0, 0.0)]}},
        {"max_measurement_age": 1e12},
    ),
    "it was as far as declared from its place": ({1: {"off": 0.2}}, {"max_tracking_error": 0.2}),
    "its law changed the tick before": ({AT: {"excused": True}}, {"ends": AT + 1}),
    "no command has acted yet": ({}, {"ends": 1}),
}


@pytest.mark.parametrize(
    ("broken", "truths", "declarations"),
    [
        pytest.param(broken, *case, id=name)
        for broken, cases in ((0, EXCUSES), (1, NO_EXCUSES))
        for name, case in cases.items()
    ],
)
def test_certificate_ends_only_where_an_assumption_fails(broken, truths, declarations):
    ends = declarations.get("ends", AT)
    declared = {name: value for name, value in declarations.items() if name != "ends"}
    certificate = msgspec.structs.replace(DELAYED.certificate, **declared)
    assurance = Assurance(msgspec.structs.replace(DELAYED, certificate=certificate))
    for tick in range(ends + 2):  # the trajectory of its command may start in the following tick
        record_tick(assurance, tick, tick < ends, **truths.get(tick, {}))
    assert assurance.certificate_broken == broken


def test_filter_started_in_flight_is_a_new_one() -> None:
    """It inherits neither detections nor a certificate."""
    assurance = Assurance(DELAYED)
    record_tick(assurance, 0, True, arrivals=[(0, 9.0)])
    for tick in range(10, 20):  # the law was not watched in between
        record_tick(assurance, tick, tick < 15)
    assert assurance.certificate_broken == 1
    assurance = assurance_after(True, True)
    for tick in range(10, 14):
        record_tick(assurance, tick, tick > 11)
    assert assurance.certificate_broken == 0
    assurance = assurance_after(True, True)
    for tick in range(3, 9):  # without a detection of its own
        record_tick(assurance, tick, tick < 8, arrivals=[])
    assert assurance.certificate_broken == 0


@pytest.mark.parametrize(("flown_on", "broken"), [(True, 1), (False, 0)])
def test_later_command_gap_excuses_an_ended_certificate(flown_on, broken) -> None:
    """A pilot predicts the gap between two plans before it becomes too long."""
    certificate = Certificate(
        max_command_delay=0.25,
        max_command_interval=0.3,
        max_measurement_error=0.3,
        max_measurement_age=0.5,
    )
    assurance = Assurance(msgspec.structs.replace(DELAYED, certificate=certificate))
    for tick in range(20, 32):
        flown = tick if tick <= 24 or flown_on else 24
        record_tick(assurance, tick, tick < 26, flown=flown)
        assert assurance.certificate_broken in (0, broken)
    assert assurance.certificate_broken == broken


def test_certificate_covers_no_tick_after_the_filter_stops() -> None:
    assurance = assurance_after(True, True)
    record_tick(assurance, 2, None, watched=False)
    assurance.end(0, lost=True)
    assert assurance.certified_while_lost == 0


def lying(pilots: Mapping[str, Pilot]) -> Piloted:
    """Return the pilots, with a UAV that always claims to be certified."""
    lie = report_of(True, distance=0.5)
    return altered(pilots, "uav_0", lambda seen: {"report": lie if seen.tick != 7 else None})


AREA, DETECTIONS = escort().area, escort().links.detections
LOSING = escort(
    "certified",
    name="losing",
    duration=40.0,
    area=msgspec.structs.replace(AREA, cell=0.5),
    # nothing can be certified, and no detection arrives after 5 s
    certificate=Certificate(max_measurement_age=60.0),
    links=LinkTable(detections=msgspec.structs.replace(DETECTIONS, blackouts=((5.0, 60.0),))),
    ugv=Ugv(position=(21.0, 20.0), goals=((39.0, 20.0),)),
)


@pytest.fixture(scope="module")
def lied(tmp_path_factory: pytest.TempPathFactory) -> tuple[Flight, Summary, Path]:
    pytest.importorskip("foxglove", reason="the extra [record] is not installed")
    from observed import recorded  # noqa: PLC0415 - an extra

    path = tmp_path_factory.mktemp("lied") / "run.mcap"
    flight = recorded(path, LOSING, 3, exchange=lying(make_pilots(LOSING, 3)))
    return flight, summarize(flight, seconds=1.0), path


def test_sight_lost_at_the_last_certified_tick_counts_once() -> None:
    for ticks, last, lost in (
        ((True, True), R_V, 1),
        ((True, True), R_V - 1e-6, 0),
        ((True, False), R_V, 0),
        ((True, None), R_V, 0),
    ):
        assurance = assurance_after(*ticks)
        for _ in range(2):
            assurance.end(0, lost=last >= R_V)
            assert assurance.certified_while_lost == lost


def test_filter_around_user_control_is_checked_against_truth() -> None:
    """Only `inner` flies inside the safety filter; the laws of the paper do not."""
    counts = []
    for law in ("certified", "linear"):
        flown = msgspec.structs.replace(LOSING, law=Law(name=law))
        flight, pilots = Flight(flown, 3), make_pilots(flown, 3)
        pilots["uav_0"] = UavPilot(
            briefing(flown, "uav_0", 3), inner=lambda observation: (-0.3, 0.0)
        )
        flight.fly(lying(pilots))
        counters = flight.answers.assurance
        counts.append((counters.certified, counters.certified_while_lost))
    assert counts[0] == counts[1]
    assert counts[0][1] > 20


def test_every_lie_of_a_flight_is_in_its_summary(lied: tuple[Flight, Summary, Path]) -> None:
    flight, summary, _ = lied
    lost = int((flight.recorder.escorts[:, 0, 0] >= R_V).sum())  # including the last state
    assert summary.certified_while_lost == lost > 20
    assert summary.certified_share == pytest.approx((LOSING.ticks - 1) / LOSING.ticks)
    assert summary.certificate_broken == 0
    row = row_of(summary, 1.0)
    assert (row["certified_while_lost"], row["certificate_broken"]) == (lost, 0)
    truth = flight.truth().escorts[0].report
    assert truth is not None
    assert truth.decision.certified


def test_trajectory_file_states_the_certificate_of_each_tick(lied, tmp_path):
    flight, summary, _ = lied
    flight.recorder.write(tmp_path / "trajectory.csv")
    with (tmp_path / "trajectory.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[-2:] == ["uav_0.certified", "uav_0.certified_distance [m]"]
    claims = [row["uav_0.certified"] for row in rows]
    # no report at tick 7, none after the last tick
    assert claims == ["1"] * 7 + [""] + ["1"] * (LOSING.ticks - 8) + [""]
    assert {row["uav_0.certified_distance [m]"] for row in rows} == {"0.5", ""}
    claimed = [float(row["uav_0.distance [m]"]) for row in rows if row["uav_0.certified"] == "1"]
    claimed.append(float(rows[-1]["uav_0.distance [m]"]))  # after a certified tick
    assert sum(d >= R_V for d in claimed) == summary.certified_while_lost


def test_recording_has_the_same_counts_and_each_ticks_claim(lied, command):
    from outrider.recording.reader import flight_of  # noqa: PLC0415 - an extra

    _, summary, path = lied
    truths = flight_of(path).truths
    reports = [truth.escorts[0].report for truth in truths[1:]]  # the report of the previous tick
    assert [report is not None and report.decision.certified for report in reports] == [
        tick != 7 for tick in range(LOSING.ticks)
    ]
    assert {report.decision.certified_distance for report in reports if report is not None} == {0.5}
    claimed = [t.escorts[0].distance for t, report in zip(truths, reports, strict=False) if report]
    claimed.append(truths[-1].escorts[0].distance)  # after a certified tick
    assert sum(d >= R_V for d in claimed) == summary.certified_while_lost
    names = words(
        "certified_share overridden_share uncertified certified_while_lost certificate_broken"
    )
    for option in ((), ("--refly",)):
        printed = json.loads(command("replay", path, *option, "--json").stdout)
        assert [printed[name] for name in names] == [getattr(summary, name) for name in names]


@pytest.mark.parametrize(
    ("lost", "broken", "lines"),
    [(1, 0, {"certified while lost"}), (0, 3, {"certificate broken"}), (0, 0, set())],
)
def test_summary_table_lists_certificate_faults_only(lied, lost, broken, lines):
    counts = {"certified_while_lost": lost, "certificate_broken": broken}
    with OUT.capture() as captured:
        print_summary(msgspec.structs.replace(lied[1], **counts), [])
    faults = {"certified while lost", "certificate broken"}
    assert {line for line in faults if line in captured.get()} == lines


def interrupted_claims(scenario: Scenario) -> Piloted:
    """Return the pilots, with a UAV that now and then is not certified."""

    def change(seen: UavObservation) -> dict[str, Any]:
        return {"report": report_of(seen.tick % 50 != 49)}

    return altered(make_pilots(scenario, 7), "uav_0", change)


@pytest.mark.parametrize(
    ("changes", "broken"),
    [
        ({}, 4),
        ({"links.commands.delay": 0.5}, 3),  # the last one may be a command gap yet to come
        ({"detections.noise": 0.5, "certificate.max_measurement_error": 0.1}, 0),
        ({"links.detections.delay": 1.0, "certificate.max_measurement_age": 0.9}, 0),
        ({"links.detections.delay": 1.0, "certificate.max_measurement_age": 1.0}, 4),
        ({"links.commands.delay": 0.5, "certificate.max_command_delay": 0.45}, 0),
    ],
    ids=str,
)
def test_certificate_breaks_only_under_its_declared_bounds(
    changes: dict[str, Any], broken: int
) -> None:
    given = {
        "law.name": "certified",
        "area.cell": 0.5,
        "duration": 10.0,
        "uav.0.velocity": [0.3, 0.2],
        "detections.dropout": 0.0,
    }
    scenario = load_scenario("escort", overrides=given | changes)
    flight = Flight(scenario, 7)
    flight.fly(interrupted_claims(scenario))
    assert flight.answers.assurance.certificate_broken == broken
    assert flight.answers.assurance.reasons[NotCertified.NO_PLAN] == 4


def test_law_change_excuses_its_first_tick() -> None:
    scenario = load_scenario(
        "escort", overrides={"law.name": "certified", "area.cell": 0.5, "duration": 10.0}
    )

    def broken(at: int | None) -> int:
        flight = Flight(scenario, 7)

        def change_law() -> None:
            if flight.world.tick == at:
                flight.order(Law(name="certified", parameters={"weight_gain": 10.0}))

        flight.fly(interrupted_claims(scenario), on_tick=change_law)
        return flight.answers.assurance.certificate_broken

    assert (broken(None), broken(49), broken(48), broken(50)) == (4, 3, 4, 4)
