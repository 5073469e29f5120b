"""The network budget: its limits hold, and a little more breaks a bound; the command and its errors."""

import json
import math
from typing import Any

import msgspec
import pytest

from bus.errors import ScenarioError
from bus.messages.links import LinkKind
from outrider.running.assumptions import how_certifiable
from outrider.running.tolerance import bounds_with, certified_bounds, smallest_changes, tolerances
from outrider_networks.budget import budget
from outrider_networks.probabilities import age_exceedance
from outrider_networks.scenario_bounds import detections_of
from outrider_networks.work import print_budget
from sim.scenario.loading import load_scenario

SHORT = {"duration": 20.0}
RISK = 1e-3


def load(**changes: Any) -> Any:
    return load_scenario("escort", overrides=SHORT | changes)


def test_largest_bounds_are_certifiable_and_a_tenth_more_is_not() -> None:
    scenario = load()
    uav = scenario.uav[0]
    for one in tolerances(scenario, uav):
        assert one.largest is not None
        assert one.declared <= one.largest
        assert bounds_with(scenario, uav, one.bound.field, one.largest) is not None
        beyond = bounds_with(scenario, uav, one.bound.field, 1.1 * one.largest)
        # beyond the limit nothing can be certified, or the law never acts
        assert beyond is None or one.bound.field == "max_command_delay"


def test_the_largest_loss_keeps_the_risk_and_more_does_not() -> None:
    scenario = load()
    found = budget(scenario, RISK)
    (loss,) = (one for one in found.links if (one.link, one.what) == ("detections", "loss"))
    assert loss.as_declared is not None
    assert loss.at_most is not None
    assert loss.now < loss.as_declared < loss.at_most < 1.0

    def risk(share: float) -> float:
        link = scenario.links.of("uav_0", LinkKind.DETECTIONS)
        given = detections_of(scenario, "uav_0") | {
            "settings": msgspec.structs.replace(link, loss=share)
        }
        return age_exceedance(**given, age=1.0).value or 0.0

    assert risk(loss.as_declared) <= RISK < risk(1.03 * loss.as_declared)
    age = next(one.largest for one in found.bounds if one.symbol == "A")
    late = next(one for one in found.links if (one.link, one.what) == ("detections", "delay"))
    assert age is not None
    assert late.at_most is not None
    assert 0.9 * age < late.at_most <= age
    link = {"links.detections.delay": late.at_most, "certificate.max_measurement_age": age}
    assert how_certifiable(load(**link)) in ("always", "not always")  # rarer than the risk


def test_a_scenario_without_a_certificate_has_no_budget() -> None:
    found = budget(load(**{"ugv.0.max_speed": 0.55}), RISK)
    assert found.r_cert == {"uav_0": None}
    assert all(one.largest is None for one in found.bounds)
    assert all(one.at_most is None for one in found.links)


@pytest.mark.parametrize(
    ("changes", "fields"),
    [
        ({"ugv.0.max_speed": 0.55}, {"ugv.0.max_speed"}),
        ({"certificate.max_measurement_age": 30.0}, {"certificate.max_measurement_age"}),
        ({"detections.noise": 1.0}, {"detections.noise"}),
        ({"uav.0.body": "reported"}, {"certificate.max_tracking_error"}),
        (
            {"detections.noise": 0.1, "detections.truncation": math.inf},
            {"certificate.max_measurement_error"},
        ),
    ],
)
def test_smallest_changes_make_sight_certifiable(
    changes: dict[str, float | str], fields: set[str]
) -> None:
    scenario = load(**changes)
    uav = scenario.uav[0]
    assert certified_bounds(scenario, uav) is None
    found = {one.field: one for one in smallest_changes(scenario, uav)}
    assert fields <= set(found)
    for field, one in found.items():
        value = float(one.allowed.split()[-2])
        mended = load_scenario("escort", overrides=SHORT | changes | {field: value})
        assert certified_bounds(mended, mended.uav[0]) is not None, one.line
        nearly = value + 0.05 * (min(one.value, 2.0 * value) - value)
        short = load_scenario("escort", overrides=SHORT | changes | {field: nearly})
        assert certified_bounds(short, short.uav[0]) is None, one.line


def test_the_command_prints_json_and_refuses_a_wrong_risk(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_budget(load(duration=5.0), RISK, json=True)
    printed = json.loads(capsys.readouterr().out)
    assert printed["certifiable"] == "always"
    assert {one["what"] for one in printed["links"]} == {"loss", "burst", "delay", "blackout"}
    for risk in (0.0, 1.0, -1.0):
        with pytest.raises(ScenarioError, match=r"--risk .*: out of range"):
            print_budget(load(), risk, json=False)
    with pytest.raises(ScenarioError, match="no UAV relies on declared bounds"):
        print_budget(load(**{"law.name": "tracking"}), RISK, json=False)
