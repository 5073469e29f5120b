"""Exceedance probabilities of declared bounds, against all outcomes of tiny runs and frequencies over the link."""

import functools
import importlib
import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from bus.messages.vehicle import MOST_CARRIED
from outrider_networks.link_runs import Probability
from outrider_networks.probabilities import (
    age_exceedance,
    command_interval_exceedance,
    error_exceedance,
    smallest_age,
    smallest_command_interval,
    smallest_error,
)
from outrider_networks.scenario_bounds import bounds_for, exceedance, in_runs
from properties import PROPERTY
from sim.channel.description import link_parameters
from sim.channel.recorded import pack
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

DT = 0.05
RUNS = 10_000
FEW = settings(PROPERTY, max_examples=20)
BURSTS = {"burst_length": 0.2, "burst_interval": 0.5, "burst_loss": 0.8}
BLACKOUTS = {"blackout_interval": 5.0, "blackout_length": 0.52}
SLOW = LinkSettings(bandwidth=15.0)
LATE = {"jitter": 0.1, "jitter_shape": "exponential", "max_jitter": 0.4}


DETECTIONS: dict[str, Any] = {"dt": DT, "period_ticks": 1, "dropout": 0.1, "ticks": 200}
PACKETS: dict[str, Any] = {"dt": DT, "delay_ticks": 4, "repeats": 6, "ticks": 200}


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[3] / "benchmarks"))
    return importlib.import_module("exceedance_table")


@functools.cache
def outcomes(
    link: LinkSettings, ticks: int, dropout: float = 0.0
) -> tuple[tuple[tuple[bool, ...], float], ...]:
    """Return each pattern of received messages, one a tick, with its probability, summed over burst states."""
    p = link_parameters(link, DT)
    turn = np.array([[1.0 - p.bad_enter, p.bad_enter], [1.0 - p.bad_stay, p.bad_stay]])
    through = (1.0 - dropout) * (1.0 - link.loss) * np.array([1.0, 1.0 - link.burst_loss])
    found = []
    for pattern in itertools.product((False, True), repeat=ticks):
        states = np.array([1.0 - p.bad_share, p.bad_share])
        for tick, got in enumerate(pattern):
            states = states @ turn if tick else states
            states = states * (through if got else 1.0 - through)
        found.append((pattern, float(states.sum())))
    return tuple(found)


def arrivals(got: tuple[bool, ...], flies: int) -> list[float]:
    """Return the arrival tick of the message sent in each tick; infinite if it is lost."""
    return [tick + flies if came else math.inf for tick, came in enumerate(got)]


def grows_old(arrives: list[float], period: int, age: int) -> bool:
    """Return whether the newest detection is ever older than `age`."""
    for tick in range(len(arrives)):
        arrived = [k for k in range(0, tick + 1, period) if arrives[k] <= tick]
        if arrived and tick - arrived[-1] > age:
            return True
    return False


def is_interrupted(arrives: list[float], delay: int, repeats: int, interval: int) -> bool:
    """Return whether a trajectory is ever replaced too late, by the protocol of pilot and receiver."""
    chain, flown, started = 0, -1, delay - 1
    packets: list[dict[int, int]] = []  # trajectory: its parent
    parents: dict[int, int] = {}
    for tick in range(len(arrives)):
        if tick - 1 - delay >= chain and flown != tick - 1 - delay:
            chain = tick
        parents[tick] = flown if tick == chain else tick - 1
        packets.append({j: parents[j] for j in range(max(chain, tick - repeats + 1), tick + 1)})
        known = [packets[k] for k in range(tick + 1) if arrives[k] <= tick]
        due = tick - delay
        if any(packet.get(due, -2) == flown for packet in known):
            flown, started = due, tick
        elif tick - started >= interval:
            return True
    return False


@pytest.mark.parametrize("link", [{"loss": 0.3}, {"loss": 0.1, **BURSTS}])
@pytest.mark.parametrize(
    ("period", "flies", "age"), [(1, 0, 2), (1, 1, 3), (2, 0, 2), (3, 1, 4), (2, 2, 1), (1, 0, 0)]
)
def test_age_chance_matches_all_outcomes(link, period, flies, age) -> None:
    delayed = LinkSettings(delay=flies * DT, **link)
    chance = age_exceedance(
        delayed, dt=DT, period_ticks=period, dropout=0.1, ticks=10, age=age * DT
    )
    found = sum(
        p
        for got, p in outcomes(LinkSettings(**link), 10, 0.1)
        if grows_old(arrivals(got, flies), period, age)
    )
    assert chance.exact
    assert chance.value == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("link", [{"loss": 0.3}, {"loss": 0.1, **BURSTS}])
@pytest.mark.parametrize(
    ("flies", "delay", "repeats", "interval"),
    [
        *((0, 0, 6, 2), (0, 1, 6, 1), (0, 2, 2, 4), (1, 2, 6, 5)),
        *((1, 3, 2, 4), (2, 2, 1, 3), (0, 3, 6, 2), (2, 1, 6, 4)),
    ],
)
def test_command_gap_chance_matches_all_outcomes(link, flies, delay, repeats, interval):
    delayed = LinkSettings(delay=flies * DT, **link)
    chance = command_interval_exceedance(
        delayed,
        dt=DT,
        delay_ticks=delay,
        repeats=repeats,
        ticks=11,
        max_command_interval=interval * DT,
    )
    numbers = (delay, repeats, interval)
    found = sum(
        p
        for got, p in outcomes(LinkSettings(**link), 11)
        if is_interrupted(arrivals(got, flies), *numbers)
    )
    assert chance.exact
    assert chance.value == pytest.approx(found, rel=1e-9)


AGES: list[tuple[dict[str, Any], int, float]] = [
    ({"loss": 0.3}, 1, 0.3),
    ({"loss": 0.02, "delay": 0.1, **BURSTS}, 2, 1.0),
    ({"loss": 0.1, "blackouts": ((0.0, 1.5), (5.0, 0.3))}, 2, 0.5),
    ({"loss": 0.1, **BLACKOUTS}, 2, 1.0),
    ({"loss": 0.1, **BLACKOUTS, **BURSTS, "blackouts": ((3.0, 0.5),)}, 1, 1.3),
    ({"loss": 0.1, "delay": 0.1, **LATE, "duplicates": 0.1}, 2, 0.5),
    ({"loss": 0.1, "delay": 0.1, "reorder": 0.2, "reorder_delay": 0.3}, 2, 0.8),
    ({"loss": 0.1, "delay": 0.1, **LATE, "jitter_time": 0.5}, 2, 0.8),
    ({"loss": 0.3, "delay": 0.1, **LATE, "jitter_time": 2.0}, 1, 0.7),
    ({"loss": 0.1, "delay": 0.1, **LATE, "jitter_time": 2.0, **BLACKOUTS}, 2, 1.0),
    ({"loss": 0.2, "delay": 0.1, "bandwidth": 3.0, "queue": 2}, 1, 1.6),
    ({"loss": 0.2, "bandwidth": 2.4, "queue": 1, "keep": "oldest"}, 1, 2.2),
]
INTERVALS: list[tuple[dict[str, Any], int, int, float]] = [
    ({"loss": 0.3}, 2, 6, 0.2),
    ({"loss": 0.5, "delay": 0.1}, 4, 6, 0.8),
    ({"loss": 0.5, "delay": 0.1}, 9, 2, 0.8),
    ({"loss": 0.05, "delay": 0.1, **BURSTS}, 3, 6, 1.2),
    ({"loss": 0.05, "blackouts": ((0.0, 0.5), (5.0, 0.3))}, 3, 6, 0.6),
    ({"loss": 0.05, **BLACKOUTS}, 3, 6, 1.0),
    ({"loss": 0.05, "delay": 0.1, **LATE}, 6, 6, 0.5),
    ({"loss": 0.05, "delay": 0.1, **LATE, "jitter_time": 0.3}, 6, 6, 0.5),
    ({"loss": 0.05, "delay": 0.1, **LATE, **BLACKOUTS, "blackouts": ((6.0, 0.4),)}, 8, 6, 1.0),
]


def counted(
    flown: ModuleType, chance_of: Callable[..., Probability], link: LinkSettings, **numbers: Any
) -> tuple[float, float]:
    """Check that a probability agrees with its frequency in runs over the link, and return both."""
    exceeded = getattr(flown, f"{chance_of.__name__.removesuffix('_exceedance')}s_exceeded")
    chance, count = chance_of(link, **numbers), exceeded(link, **numbers, runs=RUNS)
    assert 0 < count < RUNS
    assert flown.agrees(chance, count, RUNS), (chance, count)
    return chance.value, count / RUNS


@pytest.mark.parametrize(("link", "period", "age"), AGES)
def test_age_chance_agrees_with_its_frequency(flown, link, period, age):
    numbers = DETECTIONS | {"period_ticks": period, "age": age}
    counted(flown, age_exceedance, LinkSettings(**link), **numbers)


@pytest.mark.parametrize(("link", "delay", "repeats", "interval"), INTERVALS)
def test_command_gap_chance_agrees_with_its_frequency(flown, link, delay, repeats, interval):
    numbers = PACKETS | {"delay_ticks": delay, "repeats": repeats, "max_command_interval": interval}
    counted(flown, command_interval_exceedance, LinkSettings(**link), **numbers)


# Over a recorded link

FAR = Path(__file__).resolve().parents[3] / "examples" / "networks" / "wifi-far.csv"


@pytest.mark.parametrize(("number", "ticks"), [(1, 30), (2, 30), (3, 6)])
def test_recorded_link_chance_is_the_share_of_all_offsets(number, ticks) -> None:
    random, places = np.random.default_rng(number), 41
    took = random.choice([math.inf, 0.0, 1.0, 2.0, 6.0], size=places, p=[0.4, 0.2, 0.2, 0.1, 0.1])
    rows = [f"{k * DT:.2f},{n * DT if n < math.inf else 'lost'}" for k, n in enumerate(took)]
    traces = (pack("table", "\n".join(["sent,delay", *rows]).encode()),)
    link = LinkSettings(trace="table", blackouts=((0.8, 0.2),))
    flights = [
        [math.inf if 16 <= k < 20 else k + took[(k + begins) % places] for k in range(ticks)]
        for begins in range(places)
    ]
    common: dict[str, Any] = {"dt": DT, "ticks": ticks, "traces": traces}
    for period, age in itertools.product((1, 3), (0, 2, 4, 7)):
        age_settings = {**common, "period_ticks": period, "age": age * DT}
        exact = age_exceedance(link, dropout=0.0, **age_settings)
        share = np.mean([grows_old(flight, period, age) for flight in flights])
        assert exact == (pytest.approx(share), "")
        bound = age_exceedance(link, dropout=1e-9, **age_settings)
        assert (bound.exact, share - 1e-6 <= bound.value <= share + 0.15) == (False, True)
    for delay, repeats, interval in itertools.product((0, 2, 5), (1, 6), (1, 3, 8, 20)):
        packets = {
            **common,
            "delay_ticks": delay,
            "repeats": repeats,
            "max_command_interval": interval * DT,
        }
        share = np.mean([is_interrupted(flight, delay, repeats, interval) for flight in flights])
        assert command_interval_exceedance(link, **packets) == (pytest.approx(share), "")


def test_the_chances_over_a_recorded_link_agree_with_frequencies(flown: ModuleType) -> None:
    link, traces = LinkSettings(trace="far"), (pack("far", FAR.read_bytes()),)
    age_settings, packets = (
        DETECTIONS | {"traces": traces},
        PACKETS | {"delay_ticks": 2, "traces": traces},
    )
    for dropout, age in ((0.0, 0.1), (0.1, 0.2)):
        numbers = age_settings | {"dropout": dropout, "age": age}
        chance, share = counted(flown, age_exceedance, link, **numbers)
        assert chance < 1.2 * share
    counted(flown, command_interval_exceedance, link, **packets, max_command_interval=0.1)
    for smallest, chance_of, name, numbers in (
        (smallest_age, age_exceedance, "age", age_settings),
        (
            smallest_command_interval,
            command_interval_exceedance,
            "max_command_interval",
            packets,
        ),
    ):
        found = smallest(link, **numbers, risk=0.05).value
        assert chance_of(link, **numbers, **{name: found}).value <= 0.05
        assert chance_of(link, **numbers, **{name: found - DT}).value > 0.05


def test_mahimahi_and_overlong_recordings_have_no_chance() -> None:
    granted = {"settings": LinkSettings(trace="m"), "traces": (pack("m", b"1\n20\n"),)}
    assert "Mahimahi" in age_exceedance(**granted, **DETECTIONS, age=1.0).why
    link, traces = LinkSettings(trace="far"), (pack("far", FAR.read_bytes()),)
    long = DETECTIONS | {"ticks": 100_000, "traces": traces}
    assert "too long" in age_exceedance(link, **long, age=1.0).why


KINDS = st.sampled_from(
    [{}, BURSTS, BLACKOUTS, LATE, {**BURSTS, **BLACKOUTS, "blackouts": ((2.0, 0.3),)}]
)


def rises(chance: Callable[..., Any], less: dict[str, Any], **more: Any) -> bool:
    low, high = chance(**less).value, chance(**{**less, **more}).value
    return bool(low <= high + 1e-12)


@FEW
@given(KINDS, st.floats(0.0, 0.5), st.integers(4, 30), st.integers(1, 3))
def test_age_chance_rises_as_conditions_worsen(kind, loss, age, period) -> None:
    link = LinkSettings(delay=0.1, loss=loss, **kind)
    numbers = {"settings": link, "dt": DT, "period_ticks": period, "dropout": 0.1, "ticks": 200}
    numbers["age"] = age * DT
    assert rises(age_exceedance, numbers, age=(age - 1) * DT)
    assert rises(age_exceedance, numbers, ticks=230)
    assert rises(age_exceedance, numbers, dropout=0.2)
    assert rises(age_exceedance, numbers, settings=msgspec.structs.replace(link, delay=0.15))
    assert rises(age_exceedance, numbers, settings=msgspec.structs.replace(link, loss=loss + 0.1))


@FEW
@given(KINDS, st.floats(0.0, 0.5), st.integers(10, 40), st.integers(2, 10), st.integers(1, 6))
def test_command_gap_chance_rises_as_conditions_worsen(kind, loss, interval, delay, repeats):
    link = LinkSettings(delay=0.1, loss=loss, **kind)
    numbers: dict[str, Any] = {"settings": link, "dt": DT, "delay_ticks": delay, "ticks": 200}
    numbers.update(max_command_interval=interval * DT, repeats=repeats)
    assert rises(command_interval_exceedance, numbers, max_command_interval=(interval - 1) * DT)
    assert rises(command_interval_exceedance, numbers, ticks=230)
    assert rises(command_interval_exceedance, {**numbers, "repeats": repeats + 1}, repeats=repeats)
    assert rises(
        command_interval_exceedance,
        numbers,
        settings=msgspec.structs.replace(link, loss=loss + 0.1),
    )


@pytest.mark.parametrize("risk", [0.3, 1e-2, 1e-6])
@pytest.mark.parametrize("kind", [{}, BURSTS, BLACKOUTS, {"blackouts": ((2.0, 0.4),)}, LATE])
def test_smallest_bound_cannot_be_lowered(kind: dict[str, Any], risk: float) -> None:
    link = LinkSettings(delay=0.1, loss=0.1, **kind)
    age_settings, packets = DETECTIONS | {"period_ticks": 2, "ticks": 400}, PACKETS | {"ticks": 400}
    age = smallest_age(link, **age_settings, risk=risk).value
    interval = smallest_command_interval(link, **packets, risk=risk).value
    kept = (
        age_exceedance(link, **age_settings, age=age).value,
        command_interval_exceedance(link, **packets, max_command_interval=interval).value,
    )
    exceeded = (
        age_exceedance(link, **age_settings, age=age - DT).value,
        command_interval_exceedance(link, **packets, max_command_interval=interval - DT).value,
    )
    assert max(kept) <= risk < min(exceeded)


def test_unbounded_quantity_is_reported_without_a_number() -> None:
    for probability in (
        age_exceedance(SLOW, **DETECTIONS, age=1.0),
        command_interval_exceedance(SLOW, **PACKETS, max_command_interval=1.0),
        smallest_age(SLOW, **DETECTIONS, risk=0.1),
        smallest_command_interval(SLOW, **PACKETS, risk=0.1),
        smallest_command_interval(LinkSettings(loss=1.0), **PACKETS, risk=0.1),
    ):
        assert probability.value is None
        assert probability.why


def test_permanently_late_packets_start_no_trajectory() -> None:
    late = LinkSettings(delay=0.5)
    assert command_interval_exceedance(late, **PACKETS, max_command_interval=5.0) == (1.0, "")


def test_flight_too_long_for_enumeration_has_a_bound() -> None:
    link, numbers = LinkSettings(loss=0.3), {"dt": DT, "period_ticks": 1, "dropout": 0.0}
    long = age_exceedance(link, **numbers, ticks=2_000_000, age=1.0)
    short = age_exceedance(link, **numbers, ticks=2_000, age=1.0)
    assert short.exact
    assert not long.exact
    assert long.value == pytest.approx(1000.0 * short.value, rel=0.02)
    planned = msgspec.structs.replace(link, blackouts=((1.0, 1.0),))
    assert age_exceedance(planned, **numbers, ticks=2_000_000, age=1.0).value is None


def test_smallest_error_is_exceeded_with_the_given_risk() -> None:
    eps = smallest_error(0.1, math.inf, 4000, 1e-3)
    assert error_exceedance(0.1, math.inf, 4000, eps).value == pytest.approx(1e-3, rel=1e-9)
    assert smallest_error(0.1, 3.0, 4000, 1e-3) == pytest.approx(0.3)
    assert error_exceedance(0.1, 3.0, 4000, 0.3).value == 0.0
    errors = np.linalg.norm(np.random.default_rng(3).normal(0.0, 0.1, (2000, 50, 2)), axis=2)
    share = np.mean(errors.max(axis=1) > 0.33)
    assert error_exceedance(0.1, math.inf, 50, 0.33).value == pytest.approx(share, abs=0.03)


# In a scenario


def scenario(*overrides: str) -> Scenario:
    """Return the default scenario over a jammed link."""
    return load_scenario("escort", overrides=["links.detections.profile=jammed", *overrides])


def test_bounds_share_the_risk_equally() -> None:
    one = scenario("links.commands.profile=wifi-poor", "command_timeout=2.0")
    packets = PACKETS | {"delay_ticks": 12, "repeats": MOST_CARRIED, "ticks": one.ticks}
    detections, commands = one.links.detections, one.links.commands
    both = bounds_for(one, 1e-3).set
    age_settings = DETECTIONS | {"ticks": one.ticks}
    assert (
        both["certificate.max_measurement_age"]
        == smallest_age(detections, **age_settings, risk=5e-4).value
    )
    assert (
        both["certificate.max_command_interval"]
        == smallest_command_interval(commands, **packets, risk=5e-4).value
    )
    uncut = bounds_for(scenario("detections.truncation=inf"), 1.5e-3).set
    assert uncut["certificate.max_measurement_age"] == both["certificate.max_measurement_age"]
    assert uncut["certificate.max_measurement_error"] == smallest_error(
        0.1, math.inf, one.ticks, 5e-4
    )


def test_with_the_bounds_of_a_risk_a_run_meets_it() -> None:
    links = ["links.commands.loss=0.1", "detections.truncation=inf"]
    found = bounds_for(scenario(*links), 1e-2).set
    declared = scenario(*links, *(f"{field}={value!r}" for field, value in found.items()))
    chances = exceedance(declared)
    assert sorted(chances.exceedance_probability) == [
        "uav_0/max_command_interval",
        "uav_0/max_measurement_age",
        "uav_0/max_measurement_error",
    ]
    assert 0.0 < chances.loss_probability <= 1e-2
    assert chances.loss_probability == sum(chances.exceedance_probability.values())


def test_errors_are_bounded_for_the_noise_at_the_greatest_range() -> None:
    changes = ["detections.truncation=inf", "uav.0.max_altitude=20"]
    town = load_scenario("town", overrides=changes)
    found = bounds_for(town, 3e-3)
    largest = 0.1 * math.hypot(20.0, 5.0) / 10.0
    bound = found.set["certificate.max_measurement_error"]
    assert bound == pytest.approx(smallest_error(largest, math.inf, town.ticks, 1e-3))
    assert any("slant range" in note for note in found.notes)
    declared = load_scenario(
        "town", overrides=[*changes, f"certificate.max_measurement_error={bound!r}"]
    )
    chance = exceedance(declared).exceedance_probability["uav_0/max_measurement_error"]
    assert chance == pytest.approx(1e-3)


def test_a_risk_that_no_bound_meets_is_refused() -> None:
    slow = scenario("links.detections.bandwidth=15.0", "links.detections.queue=1")
    with pytest.raises(ScenarioError, match=r"--risk = 0.001: .* links.detections of uav_0"):
        bounds_for(slow, 1e-3)


@pytest.mark.parametrize(
    "broken",
    [
        "links.commands.blackouts=[[5.0,3.0]]",
        "links.detections.blackouts=[[30.0,20.0]]",
        "certificate.max_measurement_age=60.0",
        "detections.truncation=inf",
    ],
)
def test_other_broken_assumption_leaves_loss_probability_unknown(broken: str) -> None:
    quiet = load_scenario("escort", overrides=["links.detections.loss=0.5"])
    assert exceedance(quiet).loss_probability > 0.0
    assert exceedance(scenario(broken)).loss_probability is None


def test_another_law_relies_on_no_bounds() -> None:
    with pytest.raises(ScenarioError, match="relies on declared bounds"):
        exceedance(scenario("law.name=linear"))


@pytest.mark.parametrize(
    ("probability", "words"),
    [
        (0.0, "with probability 0"),
        (1e-13, "in less than 1 of 10^12 runs"),
        (3.1e-4, "in at most 1 of 3,200 runs"),
        (0.01, "in at most 1 of 100 runs"),
        (0.0371, "in at most 38 of 1,000 runs"),
        (1.0, "with a probability of up to 100 %"),
    ],
)
def test_a_probability_in_words_is_never_less_than_it_is(probability: float, words: str) -> None:
    assert in_runs(probability) == words


def test_the_bounds_are_options_of_run(command) -> None:
    printed = command("network", "bounds", "escort", "--risk", "1e-3")
    assert printed.stdout.split() == [
        "--set",
        "certificate.max_measurement_age=0.3",
        "--set",
        "certificate.max_command_interval=0.05",
    ]
    result = json.loads(
        command("network", "chances", "escort", *printed.stdout.split(), "--json").stdout
    )
    assert 0.0 < result["loss_probability"] < 1e-3
