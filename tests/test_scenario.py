"""Scenarios: the shipped ones, files and overrides, checks against other formulas, and warnings."""

import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.drivers.compiled import CompiledDriver
from bus.errors import ScenarioError
from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from bus.messages.vehicle import UgvObservation
from properties import PROPERTY
from refusals import SHIPPED, SMALL, refusal, written
from sim.engine.briefing import briefing
from sim.models.vehicles import step_vehicle
from sim.scenario import laws
from sim.scenario.checks import check_scenario, scenario_warnings
from sim.scenario.loading import load_scenario, scenario_names
from sim.scenario.vehicle_types import Uav

STRAIGHT_LINE = tuple(name for name in SHIPPED if name.startswith(("circle", "figure")))
ESCORT = load_scenario("escort")


# The shipped ones


def test_shipped_scenarios_begin_with_the_default() -> None:
    assert scenario_names() == SHIPPED
    assert load_scenario() == ESCORT


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_have_the_papers_parameters(name: str) -> None:
    s = load_scenario(name)
    assert (s.name, s.dt, s.title != "") == (name, 0.05, True)
    assert (s.area.width, s.area.height, s.area.cell) == (40.0, 40.0, 0.25)
    sight = (s.sensor.model, s.sensor.peak, s.sensor.range, s.visibility.radius)
    assert sight == ("hill", 1.0, 5.0, 4.75)
    law = law_parameters(s.law)
    assert s.coverage.desired == 2.0
    assert getattr(law, "weight_gain", 20.0) == 20.0
    if s.law.name != "lookahead":
        assert (law.a_c, law.b_c, law.c_c, law.d_c) == (-3.0, -3.0, -8.0 / 3.0, -3.0)
    (ugv,) = s.ugv
    unbounded = name in {"figure-1-low-gain", "figure-1-high-gain"}
    bounds = (math.inf, math.inf) if unbounded else (0.6, 0.3)
    assert {(uav.max_speed, uav.max_acceleration) for uav in s.uav} == {bounds}
    heavy = name == "minefield"  # needs 1.5 m to stop, which is why it needs an escort
    assert (ugv.max_speed, ugv.max_acceleration) == ((0.3, 0.03) if heavy else (0.2, 0.1))
    low = name == "figure-1-low-gain"
    assert getattr(law, "speed_gain", 10.0) == (1.0 if low else 10.0)


@pytest.mark.parametrize("name", STRAIGHT_LINE)
def test_figures_1_and_3_fly_the_independent_reference_line(name: str) -> None:
    s = load_scenario(name)
    line = (s.uav[0].position, s.ugv[0].position, s.ugv[0].goals)
    assert line == ((6.0, 21.0), (6.0, 20.0), ((34.0, 20.0),))
    assert (s.detections.noise, s.detections.dropout) == (0.0, 0.0)
    # coverage alone loses sight, and only the filter continues to predict
    assert s.estimator.enabled == name.startswith("figure-1")
    assert s.duration == (240.0 if name.startswith("figure-1") else 160.0)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_ugvs_stand_at_their_goal_for_the_last_2_s(name: str) -> None:
    s = load_scenario(name)
    briefed = briefing(s, "ugv_0", 0)
    driver = CompiledDriver(briefed, "waypoints")
    p_x, p_y, v_x, v_y = *s.ugv[0].position, 0.0, 0.0
    for tick in range(s.ticks - round(2.0 / s.dt)):
        seen = UgvObservation(tick=tick, time=tick * s.dt, position=(p_x, p_y), velocity=(v_x, v_y))
        state = (p_x, p_y, v_x, v_y, *driver.drive(seen))
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(*state, 0.2, 0.1, s.dt)
    assert math.dist((p_x, p_y), s.ugv[0].goals[-1]) < s.ugv[0].goal_tolerance
    assert math.hypot(v_x, v_y) < 1e-3


def test_scenario_2_is_scenario_1_with_covered_ground() -> None:
    first, second = load_scenario("scenario-1"), load_scenario("scenario-2")
    assert second.ugv == first.ugv
    assert second.uav == first.uav
    (region,), (x, y) = second.coverage.covered, first.ugv[0].position
    assert region.lower[0] <= x
    assert region.upper[0] >= x + 40.0 * first.ugv[0].max_speed
    assert region.upper[1] <= y  # on one side only


# Files and overrides


def test_own_name_precedes_the_file_stem(tmp_path: Path) -> None:
    assert load_scenario(written(tmp_path, SMALL.encode())).name == "mine"
    other = written(tmp_path, f"name = 'other'\n{SMALL}".encode("utf-8-sig"))
    assert load_scenario(str(other)).name == "other"
    odd = tmp_path / "a\nb.toml"
    odd.write_text(SMALL, encoding="utf-8")
    assert load_scenario(odd).name == "a\\nb"


def test_overrides_are_toml_values_or_plain_text() -> None:
    changes = ["law.parameters.circle_rate=0.2", "uav.0.max_speed=0.5", "detections.noise = 0.2 "]
    changes += ["duration=30", "law.name=circle", "title=", "ugv.0.goals.0=[9, 9]"]
    s = load_scenario("escort", overrides=changes)
    found = (s.law.parameters["circle_rate"], s.uav[0].max_speed, s.detections.noise)
    assert found == (0.2, 0.5, 0.2)
    assert (s.duration, s.law.name, s.title) == (30.0, "circle", "")
    assert s.ugv[0].goals[:2] == ((9.0, 9.0), (20.0, 13.0))
    assert load_scenario("escort", overrides=['title="a = b"']).title == "a = b"
    with pytest.raises(ScenarioError, match=r"title = "):  # one change, not two
        load_scenario("escort", overrides=["title=1\nseed = 3"])
    assert load_scenario("escort", overrides="duration=30").duration == 30.0


def test_overrides_accept_python_values_and_leave_them_unchanged() -> None:
    law = {"name": "circle"}
    changes = {
        "duration": np.float64(30.0),
        "law": law,
        "law.parameters.circle_rate": 0.05,
        "title": "5",
        "uav.0.position": np.array([7, 9]),
    }
    s = load_scenario("escort", overrides=changes)
    found = (s.duration, s.law.name, s.law.parameters["circle_rate"], s.title, s.uav[0].position)
    assert found == (30.0, "circle", 0.05, "5", (7.0, 9.0))
    assert law == {"name": "circle"}
    assert load_scenario("escort", overrides={"law": Law(name="linear")}).law.name == "linear"
    assert "object" in refusal(overrides={"dt": object()})


# Scenarios made in Python


def test_a_scenario_made_in_python_is_held_to_the_same() -> None:
    uav = Uav(position=np.array([7, 9]), max_speed=1)
    changed = {"name": "", "uav": (uav,), "duration": 30, "seed": np.int64(3)}
    checked = check_scenario(msgspec.structs.replace(ESCORT, **changed))
    assert checked.uav[0].position == (7.0, 9.0)
    numbers = (checked.uav[0].max_speed, checked.duration, checked.seed)
    assert [type(number) for number in numbers] == [float, float, int]
    for broken, line in (
        ({"dt": None}, "here: dt: no value; allowed: a number"),
        ({"ugv": ()}, "here: ugv = []: out of bounds; allowed: a list of length >= 1"),
        ({"duration": math.nan}, "here: duration = nan: "),
        ({"uav": (Uav(position=(7, math.nan)),)}, "here: uav.0.position.1 = nan: "),
        (
            {"law": Law(parameters={"circle_rate": math.inf})},
            "here: law.parameters.circle_rate = inf",
        ),
        ({"title": object()}, "here: object is not a number, text, list or table; allowed: "),
        ({"uav": (Uav(position=(1, 2, 3)),)}, "here: uav.0.position = [1, 2, 3]: out of bounds"),
    ):
        with pytest.raises(ScenarioError, match=re.escape(line)):
            check_scenario(msgspec.structs.replace(ESCORT, **broken), source="here")
    with pytest.raises(ScenarioError, match=r"^escort: dt = 2"):
        check_scenario(msgspec.structs.replace(ESCORT, dt=2.0))


@given(
    number=st.floats(1e-9, 1e6),
    seed=st.integers(0, 2**53 - 1),
    point=st.tuples(st.floats(0.0, 40.0), st.floats(0.0, 40.0)),
)
@PROPERTY
def test_numbers_survive_exactly(number: float, seed: int, point: tuple[float, float]) -> None:
    changes = [
        f"law.parameters.speed_gain={number!r}",
        f"seed={seed}",
        f"ugv.0.goals.0={list(point)!r}",
    ]
    s = load_scenario("escort", overrides=changes)
    assert (s.law.parameters["speed_gain"], s.seed, s.ugv[0].goals[0]) == (number, seed, point)


# The formulas against others


def test_the_acceleration_that_the_refusal_names_is_enough() -> None:
    near = ["visibility.radius=1.0", "uav.0.position=[7.0, 8.5]"]
    said = refusal(overrides=near).rpartition("allowed: above ")[2]
    least, most = (float(part.split()[0]) for part in said.split(", or uav.0.max_speed below "))
    assert load_scenario("escort", overrides=[*near, f"uav.0.max_acceleration={least * 1.001}"])
    refusal(overrides=[*near, f"uav.0.max_acceleration={least * 0.999}"])
    assert load_scenario("escort", overrides=[*near, f"uav.0.max_speed={most * 0.999}"])
    refusal(overrides=[*near, f"uav.0.max_speed={most * 1.001}"])


@given(*[st.floats(-6.0, 6.0)] * 4)
@PROPERTY
def test_controller_with_an_unstable_root_is_refused(a, b, c, d):
    largest = np.roots([1.0, -a, -d, d * a - b * c]).real.max()
    s = msgspec.structs.replace(
        ESCORT, law=Law(parameters={"a_c": a, "b_c": b, "c_c": c, "d_c": d})
    )
    if abs(largest) > 1e-6:
        assert (not list(laws.controller_is_stable(s))) == (largest < 0.0)


# Warnings


def test_the_paper_s_circle_is_warned_of_with_its_bound() -> None:
    (line,) = scenario_warnings(load_scenario("circle-too-fast"))
    assert line.startswith(
        "law.parameters.circle_rate = 1.0: cannot be flown: needs 3.68 m/s and 3.68 m/s² of uav_0"
    )
    assert "allowed up to 0.108597 rad/s" in line


@pytest.mark.parametrize(
    ("overrides", "bound"),
    [
        ([], 0.4 / (4.75 - 0.64 / 0.6)),
        (["law.parameters.circle_radius=4.0"], 0.1),
        (["law.parameters.circle_radius=0.2"], math.sqrt(0.3 / 0.2)),  # by the acceleration
        (["law.parameters.circle_radius=4.0", "uav.0.max_acceleration=inf"], 0.1),
    ],
)
def test_a_circle_is_warned_of_just_above_the_bound(overrides: list[str], bound: float) -> None:
    def warned(rate: float) -> tuple[str, ...]:
        changes = [*overrides, f"law.parameters.circle_rate={rate}"]
        return scenario_warnings(load_scenario("circle", overrides=changes))

    for sign in (1.0, -1.0):
        assert warned(sign * bound) == ()
        (line,) = warned(sign * bound * 1.0001)
        allowed = float(line.partition("allowed up to ")[2].split()[0])
        assert bound * (1.0 - 1e-3) < allowed <= bound * (1.0 + 1e-9)


def test_surprising_settings_and_nothing_else_give_warnings() -> None:
    warned = {name: scenario_warnings(load_scenario(name)) for name in SHIPPED}
    assert {name for name, lines in warned.items() if lines} == {
        name for name in SHIPPED if "figure-1" in name or "fast" in name
    }
    lost = [warned[name][0] for name in SHIPPED if "figure-1" in name]
    assert all("visibility is not maintained" in line for line in lost)
    (line,) = scenario_warnings(load_scenario("escort", overrides=["ugv.0.goals=[]"]))
    assert line.startswith("ugv.0.goals = []: ugv_0 will stand still")


@pytest.mark.parametrize("driver", ["waypoints", "wander", "evade", "navigate"])
def test_drivers_that_ignore_hazards_are_named(driver: str) -> None:
    hazard = '{kind = "block", center = [10.0, 8.0], radius = 0.5}'
    changes = [f"hazard=[{hazard}]", f"ugv.0.driver={driver}"]
    warnings = " ".join(scenario_warnings(load_scenario("escort", overrides=changes)))
    assert ("does not avoid hazards" in warnings) == (driver != "navigate")
    assert ("from position to goals.0 crosses hazard.0" in warnings) == (driver == "waypoints")
