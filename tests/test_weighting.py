"""The weighting of tracking against coverage.

The combination (17), the three weightings with (19), the conditions of Proposition 2, and user weightings.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.control.tracking import tracking_output
from agents.control.weighting import (
    Weighting,
    check_weighting,
    combine,
    linear_weights,
    logarithmic_weights,
    switching_weights,
)
from agents.laws.common import coverage_term
from agents.laws.inputs import LawInputs
from bus.errors import ScenarioError
from bus.messages.scenario import Law
from flights import HERE, R_S, escort, flown_law, target_at
from outrider.running.flying import fly
from properties import PROPERTY
from sim.models.vehicles import State, norm
from sim.scenario.vehicle_types import Ugv

K_BETA, LIMIT = 20.0, 100.0
SHIPPED = ("linear", "switching", "logarithmic")
numbers = st.floats(-100.0, 100.0)
radii = st.floats(0.1, 20.0)
shares = st.floats(0.0, 0.999999)


@given(*[numbers] * 6)
@settings(PROPERTY)
def test_the_combined_law_is_the_weighted_sum(a, b, t_x, t_y, c_x, c_y):
    assert combine(a, b, t_x, t_y, c_x, c_y) == pytest.approx(
        (a * t_x + b * c_x, a * t_y + b * c_y), rel=1e-14, abs=1e-11
    )
    assert combine(1.0, 0.0, t_x, t_y, c_x, c_y) == (t_x, t_y)
    assert combine(0.0, 1.0, t_x, t_y, c_x, c_y) == (c_x, c_y)


@given(radii, shares)
@settings(PROPERTY)
def test_linear_and_switching_weights_are_the_papers(r_s: float, share: float) -> None:
    alpha, beta = linear_weights(share * r_s, r_s)
    assert alpha == pytest.approx(share, abs=1e-15)
    assert alpha + beta == pytest.approx(1.0, rel=1e-15)
    assert switching_weights(share * r_s, r_s) == (0.0, 1.0)


@given(radii, st.floats(1e-9, 0.999999) | st.just(0.0), st.floats(0.1, 50.0))
@settings(PROPERTY)
def test_logarithmic_weights_follow_the_logarithm_to_their_limit(r_s, share, k_beta):
    distance = max(share * r_s, 5e-324)  # the smallest number, whose share may be rounded to zero
    alpha, beta = logarithmic_weights(distance, r_s, k_beta, LIMIT)
    assert alpha == 1.0
    share = distance / r_s
    wanted = min(-k_beta * math.log(share), LIMIT) if share > 0.0 else LIMIT
    assert beta == pytest.approx(wanted, rel=1e-9, abs=1e-13 * k_beta)


@pytest.mark.parametrize("law", SHIPPED)
@given(st.floats(1.0, 1e6))
@settings(PROPERTY)
def test_shipped_weights_fulfil_the_conditions_of_proposition_2(law: str, share: float) -> None:
    c = flown_law(escort(law))
    r_s = c.uav["switching_radius"]
    assert c.weights(r_s) == (1.0, 0.0)
    assert c.weights(share * r_s) == (1.0, 0.0)
    alpha, beta = c.weights(r_s / share)
    assert 0.0 <= alpha <= 1.0
    assert 0.0 <= beta <= LIMIT


@pytest.mark.parametrize("law", [*SHIPPED, "coverage", "weighted"])
@pytest.mark.parametrize("place", [(20.5, 21.0), (22.5, 18.0), (24.5, 20.0)])
def test_every_law_weighs_the_same_two_terms(law: str, place: tuple[float, float]) -> None:
    c, weights = flown_law(escort(law)), (0.0, 1.0)
    coverage = np.random.default_rng(2).uniform(0.0, 3.0, (160, 160))
    c.memory["x_c"] = 0.4, -1.0
    if law == "weighted":
        weights = c.memory["alpha"], c.memory["beta"] = 0.3, 0.9
    elif law != "coverage":
        weights = c.weights(norm(place[0] - HERE[0], place[1] - HERE[1]))
    x, y = place[0] - HERE[0], place[1] - HERE[1]
    inputs = LawInputs(coverage, 3, State(*place, 0.2, 0.1), target_at(*HERE))
    tracking = tracking_output(0.4, -1.0, x, y, c.law["c_c"], c.law["d_c"])
    covering = coverage_term(c.uav, c.law, c.memory.copy(), inputs)
    wanted = combine(*weights, *tracking, *covering)
    assert c.command(inputs) == pytest.approx(wanted, rel=1e-12)


def _linear(distance: float, r_s: float) -> tuple[float, float]:
    alpha = distance / r_s if distance < r_s else 1.0
    return alpha, 1.0 - alpha


def _cosine(distance: float, r_s: float) -> tuple[float, float]:
    covering = 1.0 + math.cos(math.pi * distance / r_s) if distance < r_s else 0.0
    return 1.0, 5.0 * covering


@pytest.mark.parametrize("weighting", [_linear, switching_weights, _cosine])
def test_a_weighting_within_proposition_2_is_accepted(weighting: Weighting) -> None:
    check_weighting(weighting, R_S)


def _from(distance: float, bad: object) -> Weighting:
    """Return a linear weighting that is wrong from this distance on."""
    return lambda d, r_s: bad if d >= distance else _linear(d, r_s)


BAD: dict[str, tuple[float, object]] = {
    "coverage never ends": (R_S, (1.0, 1e-9)),
    "tracking at half strength outside": (2.0 * R_S, (0.5, 0.0)),
    "negative alpha": (1.0, (-0.1, 1.0)),
    "negative beta": (1.5, (1.0, -1e-12)),
    "not a number": (2.0, (math.nan, 0.5)),
    "one number": (0.5, 1.0),
    "text": (0.5, ("1", "0")),
}


@pytest.mark.parametrize(("distance", "bad"), BAD.values(), ids=BAD.keys())
def test_weighting_against_proposition_2_is_refused(distance, bad):
    with pytest.raises(ScenarioError, match=r"^weighting at a distance of [\d.]+ m") as refused:
        check_weighting(_from(distance, bad), R_S)
    named = float(str(refused.value).split("distance of ")[1].split(" m")[0])
    assert distance - 1e-5 <= named <= distance + R_S / 2000 + 1e-5


def test_a_weighting_that_fails_is_refused_at_its_distance() -> None:
    with pytest.raises(ScenarioError, match=r"distance of 0 m: .*must return alpha and beta"):
        check_weighting(lambda d, r_s: (1.0, -math.log(d / r_s)), R_S)


def test_the_weighted_law_needs_a_weighting_that_fits() -> None:
    scenario = escort("weighted", duration=1.0)
    with pytest.raises(ScenarioError, match="needs a weighting"):
        fly(scenario, 0)
    with pytest.raises(ScenarioError, match="Proposition 2"):
        fly(scenario, 0, weighting=lambda d, r_s: (0.0, 1.0))


def test_user_linear_weighting_flies_the_linear_laws_bits() -> None:
    ugv = Ugv(position=HERE, goals=((25.0, 20.0), (25.0, 26.0)))
    _, shipped = fly(escort("linear", ugv=ugv, duration=60.0), 0)
    _, own = fly(escort("weighted", ugv=ugv, duration=60.0), 0, weighting=_linear)
    _, other = fly(escort("weighted", ugv=ugv, duration=60.0), 0, weighting=_cosine)
    assert own.trajectory_sha256 == shipped.trajectory_sha256 != other.trajectory_sha256
    assert own.max_distance > 1.0
    assert other.visibility_violations == 0


def test_the_limit_of_the_logarithmic_weight_is_the_scenarios() -> None:
    parameters = {"weight_gain": 3.0, "weight_limit": 7.0}
    c = flown_law(escort(Law(name="logarithmic", parameters=parameters)))
    assert c.weights(0.0) == (1.0, 7.0)
    assert c.weights(R_S / math.e)[1] == pytest.approx(3.0, rel=1e-12)
