"""The body `reported`: a UAV's true state is the one that its process reports of a robot."""

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

import outrider
from bus.errors import ScenarioError
from bus.messages.decision import NotCertified
from bus.messages.robot import RobotState
from bus.messages.vehicle import UavObservation
from flights import altered, distances, modelled
from outrider.running.first_tick import check_first_tick
from outrider.running.flying import fly, make_pilots
from outrider.running.summary import Summary, summarize
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from sim.server.robots import NO_ROBOT, NOT_FINITE, TOO_FAR, TOO_FAST

DECLARED = 0.3
"""Declared bound of the tracking error [m]."""
OFF = (0.12, -0.05)
"""Offset of a robot from its reference [m]."""
BASE = (
    "law.name=certified",
    "uav.0.body=reported",
    "duration=12.0",
    "detections.noise=0",
    "detections.dropout=0",
)
Report = Callable[[UavObservation], RobotState | None]


def load(*changes: str, declared: float = DECLARED) -> Scenario:
    bound = f"certificate.max_tracking_error={declared}"
    return load_scenario("escort", overrides=[*BASE, bound, *changes])


def beside(seen: UavObservation, off: tuple[float, float] = OFF, age: float = 0.0) -> RobotState:
    """Report a robot beside the reference of this tick."""
    (x, y), (d_x, d_y) = seen.position, off
    return RobotState(position=(x + d_x, y + d_y), velocity=seen.velocity, age=age)


def flown(
    scenario: Scenario, report: Report, notices: list[str] | None = None
) -> tuple[Flight, Summary]:
    """Fly in this process, with a program that adds a report to each command."""
    told = list[str]() if notices is None else notices
    flight = Flight(scenario, 3, on_notice=told.append)
    exchange = altered(
        make_pilots(modelled(scenario), 3), "uav_0", lambda seen: {"robot": report(seen)}
    )
    flight.fly(exchange)
    return flight, summarize(flight, seconds=1.0)


def off_reference(flight: Flight) -> np.ndarray:
    """Return the distance of the robot from its reference at each tick [m]."""
    row = flight.world.names.index("uav_0")
    off = flight.recorder.states[:, row, :2] - flight.recorder.reference[:, row, :2]
    return np.hypot(off[:, 0], off[:, 1])


def test_detections_and_coverage_follow_the_robot() -> None:
    flight, summary = flown(load(), beside)
    uav, ugv = (flight.world.names.index(name) for name in ("uav_0", "ugv_0"))
    states, reference = flight.recorder.states, flight.recorder.reference
    # the state reported at tick k is the true one at tick k + 1
    assert states[1:, uav, :2] == pytest.approx(reference[:-1, uav, :2] + OFF)
    detected = flight.recorder.escorts[:, 0, 2:4]
    found = ~np.isnan(detected[:, 0])
    assert detected[found] == pytest.approx((states[:, uav] - states[:, ugv])[found, :2])
    farther, _ = flown(load(), lambda seen: beside(seen, (2.0, 0.0)))
    assert not np.array_equal(flight.world.coverage, farther.world.coverage)
    assert distances(flight) == pytest.approx(flight.recorder.escorts[:, 0, 0])
    assert summary.largest_tracking_error == pytest.approx(off_reference(flight).max())
    assert summary.tracking_exceeded == 0
    assert summary.certified_share > 0.9
    assert (summary.certified_while_lost, summary.certificate_broken) == (0, 0)
    assert flight.robots.unreported["uav_0"] == 1  # tick 0, before the first command


def test_reports_make_reproducible_runs_and_cross_no_link() -> None:
    (_, first), (_, again) = (flown(load(), beside) for _ in range(2))
    assert first.trajectory_sha256 == again.trajectory_sha256
    late, _ = flown(load("links.commands.delay=0.2"), beside)
    row = late.world.names.index("uav_0")
    assert late.recorder.states[1:, row, :2] == pytest.approx(
        late.recorder.reference[:-1, row, :2] + OFF
    )


def test_every_excess_of_the_declared_bound_is_counted() -> None:
    flight, summary = flown(load(declared=0.1), beside)
    assert summary.tracking_exceeded == int((off_reference(flight)[:-1] > 0.1).sum()) > 200
    assert (summary.max_tracking_error, summary.certificate_broken) == (0.1, 0)


def test_the_velocity_bridges_the_age_of_a_state() -> None:
    def aged(seen: UavObservation) -> RobotState | None:
        state = RobotState(position=seen.position, velocity=(0.4, 0.0), age=0.1)
        return state if seen.tick == 0 else None

    flight, _ = flown(load("duration=3.0"), aged)
    states = flight.recorder.states[:, flight.world.names.index("uav_0")]
    travelled = states[:, 0] - states[0, 0]
    assert travelled[1:4] == pytest.approx([0.04, 0.06, 0.08])
    assert travelled[21:] == pytest.approx(0.4)  # no farther than a second of travel
    assert states[21:, 2] == pytest.approx(0.0)
    assert flight.robots.unreported["uav_0"] == 1 + (60 - 20)


def test_silence_is_counted_and_certifies_nothing() -> None:
    notices = list[str]()
    silent = range(80, 150)
    flight, summary = flown(
        load(), lambda seen: None if seen.tick in silent else beside(seen), notices
    )
    # the last report bridges 1 s: ticks 80 to 100
    assert flight.robots.unreported["uav_0"] == 1 + (151 - 101)
    assert summary.faults["uav_0"] == {"no state of its robot": 51}
    certified = flight.recorder.escorts[:-1, 0, 6]
    assert not certified[101:151].any()
    assert certified[80:100].all()
    assert certified[170:].all()
    assert summary.uncertified[NotCertified.NO_ROBOT_STATE] == 51
    assert (summary.certified_while_lost, summary.certificate_broken) == (0, 0)
    assert [one.partition(": ")[2] for one in notices] == [
        "its process has reported no valid state of its robot for 1 s: the true position stays at the last one, "
        "and nothing is certified",
        "its robot's state is reported again",
    ]


def test_a_robot_that_is_never_reported_is_named() -> None:
    flight, summary = flown(load(), lambda _seen: None)
    (warning,) = flight.status().warnings
    assert warning.startswith("uav_0: its process has reported no valid state of its robot")
    assert flight.status().vehicles["uav_0"].unreported_ticks == summary.ticks
    assert summary.certified_share == 0.0
    assert summary.uncertified == {NotCertified.NO_ROBOT_STATE: summary.ticks}
    assert (summary.certified_while_lost, summary.certificate_broken) == (0, 0)


@pytest.mark.parametrize(
    ("wrong", "cause"),
    [
        ({"position": (math.nan, 0.0)}, NOT_FINITE),
        ({"age": math.inf}, NOT_FINITE),
        ({"position": (500.0, 20.0)}, TOO_FAR),
        ({"altitude": -12.0}, TOO_FAR),
        ({"velocity": (5.0, 4.0)}, TOO_FAST),
    ],
)
def test_wrong_reports_are_rejected_and_counted(wrong: dict[str, object], cause: str) -> None:
    def report(seen: UavObservation) -> RobotState:
        right = beside(seen)
        return msgspec.structs.replace(right, **wrong) if seen.tick % 3 == 2 else right

    notices = list[str]()
    flight, summary = flown(load("duration=3.0"), report, notices)
    assert flight.robots.rejected["uav_0"] == {cause: 20}
    assert summary.faults["uav_0"][cause] == 20
    assert off_reference(flight).max() < 0.2  # the reports before them bridge the gaps
    assert flight.robots.unreported["uav_0"] == 1
    (line,) = notices
    assert line.startswith(f"uav_0: {cause}: ")
    assert flight.status().vehicles["uav_0"].rejected == {cause: 20}


def test_a_report_for_another_body_changes_nothing() -> None:
    scenario = load("uav.0.body=point", "duration=3.0")
    flight, summary = flown(scenario, beside)
    _, plain = fly(scenario, 3)
    assert summary.trajectory_sha256 == plain.trajectory_sha256
    assert flight.robots.rejected["uav_0"] == {NO_ROBOT: 60}


def test_a_recorded_robot_flies_again(here) -> None:
    pytest.importorskip("foxglove", reason="the extra [record] is not installed")
    from observed import recorded  # noqa: PLC0415 - needs the extra
    from outrider.recording.reader import flight_of  # noqa: PLC0415 - an extra
    from outrider.recording.refly import refly, restore  # noqa: PLC0415 - an extra

    scenario, path = load("duration=6.0"), here / "flight.mcap"
    exchange = altered(
        make_pilots(modelled(scenario), 3),
        "uav_0",
        lambda seen: {"robot": None if 40 <= seen.tick < 80 else beside(seen)},
    )
    flight = recorded(path, scenario, 3, exchange=exchange)
    recording = flight_of(path)
    again = refly(recording)
    assert again.difference is None
    assert again.trajectory_sha256 == flight.recorder.sha256()
    for flown_again in (again.flight, restore(recording)):
        assert np.array_equal(flown_again.world.coverage, flight.world.coverage)
        found = flown_again.recorder.tracking_error
        assert found == pytest.approx(flight.recorder.tracking_error)


def test_runs_without_a_process_for_the_robot_refuse_it(command, here) -> None:
    scenario = load()
    check_first_tick(scenario)
    for start in (
        lambda: fly(scenario, 0),
        lambda: outrider.parallel_env(scenario),
        lambda: outrider.vector_env(scenario, num_envs=2),
        lambda: outrider.run(scenario),
    ):
        with pytest.raises(
            ScenarioError, match=r"^uav\.0\.body = 'reported': only a process"
        ) as no:
            start()
        assert "\n" not in str(no.value)
    (here / "sweep.toml").write_text(
        'scenario = "escort"\nseeds = 1\n[set]\n"uav.0.body" = "reported"\n', encoding="utf-8"
    )
    for words in (("run", "escort"), ("run", "escort", "--in-process"), ("sweep", "sweep.toml")):
        change = () if words[0] == "sweep" else ("--set", "uav.0.body=reported")
        refused = command(*words, *change)
        assert refused.returncode == 2
        assert "uav.0.body = 'reported': only a process of its own" in refused.stderr
