"""Garbage for a scenario is never anything but a ScenarioError, and whatever loads can be told to the vehicles."""

import math
from pathlib import Path

import msgspec
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bus.errors import ScenarioError
from refusals import SMALL, written
from sim.engine.briefing import briefing
from sim.scenario import checks
from sim.scenario.checks import check_scenario, scenario_warnings
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

ESCORT = load_scenario("escort")

FUZZ = settings(
    max_examples=200,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
TEXTS = [
    path.read_bytes() for path in sorted((Path(checks.__file__).parent / "shipped").glob("*.toml"))
]
NUMBERS = [math.nan, math.inf, -math.inf, 1e308, 1e12, 1e13, 5e-324, 1e-300, -0.0, 0, 1, 10**400]
ODD = (
    st.sampled_from([*NUMBERS, -(2**63), "", "inf", None, True])
    | (st.floats() | st.integers() | st.text(max_size=8))
    | st.lists(st.floats() | st.text(max_size=3), max_size=3)
    | st.dictionaries(st.text(max_size=4), st.integers(), max_size=2)
)


def paths(value: object, path: tuple[str, ...] = ()) -> list[str]:
    """The path of every table, list and value of the escort."""
    inner = value.items() if isinstance(value, dict) else ()
    inner = enumerate(value) if isinstance(value, tuple) else inner
    return [".".join(path)] * bool(path) + [
        found for key, part in inner for found in paths(part, (*path, str(key)))
    ]


PATHS = paths(msgspec.to_builtins(ESCORT))


def must_load_or_be_refused_in_one_line(source, overrides=()) -> None:
    refused = ""
    try:
        scenario = load_scenario(source, overrides=overrides)
    except ScenarioError as error:
        refused = str(error)
    assert len(refused.splitlines()) <= 1
    assert refused.isprintable()
    if not refused:
        assert check_scenario(scenario) == scenario
        scenario_warnings(scenario)
        assert_vehicles_can_be_told(scenario)


def assert_vehicles_can_be_told(scenario: Scenario) -> None:
    """A scenario that loads fits the messages' own bounds."""
    for vehicle in scenario.vehicles:
        told = briefing(scenario, vehicle.name, scenario.seed)
        assert msgspec.json.decode(msgspec.json.encode(told), type=type(told)) == told


@FUZZ
@given(
    st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace"))
)
def test_garbage_is_never_anything_but_a_scenario_error(tmp_path: Path, garbage: bytes) -> None:
    must_load_or_be_refused_in_one_line(written(tmp_path, garbage))
    must_load_or_be_refused_in_one_line(written(tmp_path, SMALL.encode() + garbage))


@FUZZ
@given(
    st.sampled_from(TEXTS),
    st.integers(0, 2000),
    st.integers(0, 12),
    st.binary(max_size=12) | st.sampled_from([b"nan", b"1e999", b"[["]),
)
def test_a_mutated_file_is_never_anything_but_a_scenario_error(tmp_path, text, at, cut, put):
    at = min(at, len(text))
    must_load_or_be_refused_in_one_line(written(tmp_path, text[:at] + put + text[at + cut :]))


@FUZZ
@given(st.dictionaries(st.sampled_from(PATHS), ODD, min_size=1, max_size=3))
def test_a_mutated_value_is_never_anything_but_a_scenario_error(changes: dict[str, object]) -> None:
    must_load_or_be_refused_in_one_line("escort", changes)


@FUZZ
@given(
    st.lists(
        st.text(max_size=30)
        | st.tuples(st.sampled_from(PATHS), ODD).map(lambda pair: f"{pair[0]}={pair[1]}"),
        max_size=3,
    )
)
def test_a_mutated_command_line_is_never_anything_but_a_scenario_error(changes: list[str]) -> None:
    must_load_or_be_refused_in_one_line("escort", changes)
