"""The closed loop in many worlds.

Its laws and drivers give the same commands as the pilots in a single run.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.safety.decision import CERTIFIED
from bus.errors import ScenarioError
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from flights import altered
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.running.flying import fly, make_pilots
from sim.engine.batch import arrays_of
from sim.env.patch import CoveragePatch
from sim.env.rewards import RewardWeights
from sim.scenario.loading import given_scenario, load_scenario
from sim.scenario.types import Certificate, Detections, LinkTable, Scenario, Wind
from sim.scenario.vehicle_types import Uav
from sim.server.flight import Flight
from worlds import FLOWN, POOR, SCENARIOS, raw, small


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two runs have the same bits."""
    return one.tobytes() == np.ascontiguousarray(other).tobytes()


def _same_records(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether all fields have the same bits; padding between them does not matter."""
    names = one.dtype.names
    return (
        _same(one, other)
        if names is None
        else all(_same_records(one[name], other[name]) for name in names)
    )


def _near(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two runs agree up to the rounding of the two filters, amplified for some seconds."""
    return np.allclose(one, other, rtol=1e-6, atol=1e-6, equal_nan=True)


def _flown(scenario: Scenario, seeds: list[int], **options: Any) -> ClosedLoop:
    """Return worlds of these seeds, flown to the end."""
    loop = ClosedLoop(scenario, len(seeds), **options)
    loop.begin(seeds)
    loop.fly()
    return loop


def _broken(loop: ClosedLoop, seeds: list[int]) -> list[float]:
    """Fly worlds of these seeds to the end and return their counts of broken certificates."""
    loop.begin(seeds)
    loop.fly()
    return loop.metrics("uav_0")["certificate_broken"].tolist()


def _blackouts(**others: LinkSettings) -> LinkTable:
    """Return links with two blackouts of the detections, and these others."""
    return LinkTable(detections=LinkSettings(blackouts=((4.0, 2.0), (8.0, 3.0))), **others)


@pytest.mark.parametrize("name", FLOWN)
def test_world_k_flies_as_the_single_flight_of_its_seed(name: str) -> None:
    """Without estimator, whose rounding differs, a whole run has the same bits."""
    _compare(raw(SCENARIOS[name]), _same)


LIMITS = {
    "uav.*.max_speed": [0.45, 0.9],
    "uav.*.max_acceleration": [0.3, 0.5],
    "ugv.*.max_speed": [0.1, 0.2],
}
LATE_LINKS = {"links.detections.delay": [0.0, 0.3], "links.commands.delay": [0.0, 0.2]}
RANDOM: dict[str, tuple[Scenario, dict[str, list[float]]]] = {
    "links": (
        small("logarithmic", "evade", links=POOR, duration=15.0),
        {
            **LIMITS,
            **LATE_LINKS,
            "detections.noise": [0.05, 0.2],
            "detections.dropout": [0.0, 0.3],
            "links.radio.loss": [0.0, 0.5],
            "links.commands.duplicates": [0.1, 0.5],
        },
    ),
    "filter": (
        small("certified", "wander", wind=Wind(gust=0.01), duration=15.0),
        {
            **LIMITS,
            **LATE_LINKS,
            "wind.gust": [0.01, 0.03],
            "certificate.max_measurement_age": [1.0, 2.0],
            "certificate.margin": [0.0, 0.1],
        },
    ),
    "hazards": (
        given_scenario("minefield", 20.0),
        {**LIMITS, "links.commands.delay": [0.0, 0.2], "detections.noise": [0.02, 0.1]},
    ),
    "altitude": (
        given_scenario("town", 5.0),
        {"ugv.*.max_speed": [0.1, 0.2], "detections.noise": [0.02, 0.1]},
    ),
}


@pytest.mark.parametrize("name", RANDOM)
def test_random_worlds_fly_like_their_drawn_scenarios(name: str) -> None:
    scenario, ranges = RANDOM[name]
    loop = _flown(scenario, [5, 6, 4], randomize=ranges)
    loop.begin([9, 3, 4])
    loop.fly()
    drawn = np.stack(list(loop.drawn().values()))
    assert all(
        (low <= row).all() and (row <= high).all()
        for row, (low, high) in zip(drawn, ranges.values(), strict=True)
    )
    for k, seed in enumerate((9, 3, 4)):
        alone = _flown(loop.scenario_of(k), [seed])
        assert _same_records(loop.state.batch.vehicles[k], alone.state.batch.vehicles[0])
        assert _same_records(loop.state.rows.standings[k], alone.state.rows.standings[0])
        assert _same_records(loop.state.certificates[k], alone.state.certificates[0])


def test_no_random_world_breaks_a_certificate() -> None:
    scenario, ranges = RANDOM["filter"]
    found = _flown(scenario, list(range(50)), randomize=ranges).metrics("uav_0")
    assert found["certified"].mean() > 0.5
    assert not found["certified_while_lost"].any()
    assert not found["certificate_broken"].any()


@pytest.mark.parametrize("name", ["escort", *FLOWN])
def test_with_the_estimator_the_first_seconds_are_the_same(name: str) -> None:
    scenario = SCENARIOS[name] if name in SCENARIOS else load_scenario(name)
    _compare(msgspec.structs.replace(scenario, duration=5.0), _near)


def _compare(scenario: Scenario, alike: Callable[[np.ndarray, np.ndarray], bool]) -> None:
    seeds = [5, 11]
    loop = _flown(scenario, seeds, error=True, end_on_sight_lost=False)
    for k, seed in enumerate(seeds):
        flight, summary = fly(scenario, seed)
        for field in ("position", "velocity", "acceleration", "command", "detection"):
            assert alike(flight.world.vehicles[field], loop.state.batch.vehicles[field][k])
        assert alike(flight.world.coverage, loop.state.batch.coverage[k])
        escorts = flight.recorder.escorts
        for u, uav in enumerate(loop.uavs):
            found = {key: values[k] for key, values in loop.metrics(uav).items()}
            assert found["ticks"] == scenario.ticks
            assert found["max_distance"] == pytest.approx(escorts[:, u, 0].max(), rel=1e-6)
            assert found["mean_error"] == pytest.approx(escorts[:, u, 1].mean(), rel=1e-6)
            lost = (escorts[:, u, 0] >= scenario.visibility.radius).sum()
            assert found["visibility_violations"] == lost
        if summary.certified_share is not None and len(loop.uavs) == 1:
            for share in ("certified", "overridden"):
                assert found[share] == pytest.approx(
                    getattr(summary, f"{share}_share"), abs=1.5 / scenario.ticks
                )
        for count in ("certified_while_lost", "certificate_broken"):
            in_world = sum(loop.metrics(uav)[count][k] for uav in loop.uavs)
            assert in_world == getattr(summary, count) == 0
        if loop.degraded:
            status = {
                key: one
                for key, one in flight.world.links.status().items()
                if one.degraded and not key.endswith(str(LinkKind.OPERATOR))
            }
            assert {key: one for key, one in loop.links(k).items() if one.degraded} == status


def test_certified_tick_out_of_sight_counts_in_every_world() -> None:
    """End sight at half a metre, with another r_v in the safety filter."""
    scenario, seeds = SCENARIOS["evade"], [5, 11]
    loop = ClosedLoop(scenario, len(seeds), error=True, end_on_sight_lost=False)
    loop.tables.batch.world["r_v"] = 0.5
    loop.begin(seeds)
    standings, counted = loop.state.rows.standings[:, 0], np.zeros(len(seeds))
    decisions = loop.decisions("uav_0")
    for _ in range(scenario.ticks):
        far = standings["distance"] >= 0.5
        loop.fly(1)
        # claims refer to the tick of this distance
        counted += far & (decisions["reason"] == CERTIFIED)
    counted += (standings["distance"] >= 0.5) & (decisions["reason"] == CERTIFIED)
    assert loop.metrics("uav_0")["certified_while_lost"].tolist() == counted.tolist()
    assert counted.min() > 100


def test_ended_certificate_counts_unless_an_assumption_failed() -> None:
    """End a certificate by undeclared blackouts, which is a fault only if the counters allow that age."""
    scenario = small(
        "certified",
        links=_blackouts(commands=LinkSettings(delay=0.2)),
        certificate=Certificate(max_measurement_age=1.0),
        detections=Detections(noise=0.1, dropout=0.0),
    )
    loop = ClosedLoop(scenario, 1, error=True)
    assert _broken(loop, [5]) == [0.0]
    assert loop.pilots is not None
    loop.pilots.tables.monitored["max_age_ticks"] += 100
    assert _broken(loop, [5]) == [2.0]
    assert _broken(loop, [6]) == [2.0]  # an episode starts at tick 0


@pytest.mark.parametrize(
    ("declared", "given"),
    [
        (
            Certificate(max_measurement_age=1.0, max_measurement_error=0.29),
            {"detections": Detections(noise=0.1, truncation=math.inf)},
        ),
        (
            Certificate(max_measurement_age=1.0, max_tracking_error=0.08),
            {"wind": Wind(gust=0.05), "uav": Uav(position=(8.0, 7.0), position_error=0.05)},
        ),
    ],
    ids=["noise without a cut", "wind beyond what is declared"],
)
def test_a_broken_certificate_is_excused_by_actual_errors_alone(declared, given):
    """End the certificate twice by blackouts, at ages that the counters allow."""
    scenario = small("certified", links=_blackouts(), certificate=declared, **given)
    seeds = [5, 6, 7, 8, 9, 10]
    loop = ClosedLoop(scenario, len(seeds), error=True)
    assert loop.pilots is not None
    loop.pilots.tables.monitored["max_age_ticks"] += 100
    broken = _broken(loop, seeds)
    for k, seed in enumerate(seeds):
        record = fly(scenario, seed)[0].recorder
        off = np.hypot(*(record.states[:, 0, :2] - record.reference[:, 0, :2]).T)
        measured = record.escorts[:, 0, 2:4] - (record.states[:, 0, :2] - record.states[:, 1, :2])
        times = scenario.dt * np.arange(len(off))
        received = (times < 4.0) | (times >= 6.0) & (times < 8.0) | (times >= 11.0)
        wrong = (
            received & (np.hypot(*measured.T) > 0.29)
            if declared.max_measurement_error
            else off > 0.08
        )
        first = next(iter(times[wrong].tolist()), scenario.duration)
        assert broken[k] == (first > 5.0) + (first > 9.0), first
    assert {0.0, 2.0} <= set(broken)  # runs of both kinds


@pytest.mark.parametrize("name", ["evade", "network"])
def test_evading_ugv_hears_an_external_uav(name: str) -> None:
    scenario = msgspec.structs.replace(SCENARIOS[name], law=Law(name="logarithmic"))
    actions = np.random.default_rng(2).uniform(-0.3, 0.3, (scenario.ticks, 2))
    loop = ClosedLoop(scenario, 2, external=["uav_0"], end_on_sight_lost=False)
    loop.begin([4, 3])
    for action in actions:
        loop.step(np.broadcast_to(action, (2, 1, 2)).copy())
    for k, seed in enumerate([4, 3]):
        flight = Flight(scenario, seed)
        change = lambda seen: {"acceleration": tuple(actions[seen.tick].tolist())}  # noqa: E731
        flight.fly(altered(make_pilots(scenario, seed), "uav_0", change))
        assert _near(flight.world.position, loop.state.batch.vehicles["position"][k])
    wanders = msgspec.structs.replace(scenario.ugv[0], driver="wander")
    still = _flown(msgspec.structs.replace(scenario, ugv=(wanders,)), [4])
    assert not _near(
        still.state.batch.vehicles["position"][0, 1], loop.state.batch.vehicles["position"][0, 1]
    )


def test_pilots_are_chosen_by_name() -> None:
    scenario = small("tracking", "waypoints")
    loop = _flown(scenario, [2], pilots={"uav_0": "circle", "ugv_0": "wander"})
    flight, _ = fly(small("circle", "wander"), 2)
    assert _near(flight.world.position, loop.state.batch.vehicles["position"][0])


ANY = "(uav_0, ugv_0|ugv_0, uav_0)"


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"external": ["uav_9"]}, ValueError, f"vehicle = 'uav_9'; allowed: {ANY}"),
        ({"pilots": {"uav_0": "weighted"}}, ScenarioError, "user's function"),
        ({"pilots": {"ugv_0": "teleop"}}, ScenarioError, "no compiled form"),
        ({"pilots": {"uav_0": "nonsense"}}, ScenarioError, "unknown; allowed"),
        ({"external": ["uav_0"]}, ValueError, "need actions"),
    ],
)
def test_unsupported_pilot_is_refused(settings, error, message):
    with pytest.raises(error, match=message):
        ClosedLoop(small("tracking"), 1, **settings).fly()


def test_ended_episode_restarts_like_the_first() -> None:
    scenario = small("certified", "evade", links=POOR)
    options: dict[str, Any] = {
        "gradient": True,
        "estimate": True,
        "coverage_patch": CoveragePatch(9, 0.5),
        "rewards": RewardWeights(seen=1.0),
    }
    used, fresh = ClosedLoop(scenario, 3, **options), ClosedLoop(scenario, 3, **options)
    used.begin([1, 2, 3])
    used.fly(333)
    used.begin([7, 8, 9])
    fresh.begin([7, 8, 9])
    for loop in (used, fresh):
        loop.fly(200)
    parts = [
        (s.rows.standings, s.rows.uav_rows, s.rows.ugv_rows, loop.patch("uav_0"), s.batch.coverage)
        for loop, s in ((used, used.state), (fresh, fresh.state))
    ]
    for one, other in zip(*parts, strict=True):
        assert one.tobytes() == other.tobytes()
    used.fly()
    assert used.state.rows.truncated.tolist() == [1, 1, 1]
    assert used.state.batch.ticks.tolist() == [scenario.ticks] * 3


def test_a_world_of_the_shipped_escort_needs_less_than_300_kb() -> None:
    state = ClosedLoop(load_scenario("escort"), 2).state
    sizes = {
        array.ctypes.data: array.nbytes for array in arrays_of(state)
    }  # the map is the coverage
    assert sum(sizes.values()) < 2 * 300_000
