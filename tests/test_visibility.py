"""The visibility constraint (5), the switching radius (18), and their validity in discrete time."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from agents.control.tracking import relative_motion
from agents.control.visibility import is_visible, switching_radius
from agents.laws.selection import SelectedLaw
from agents.uav_parameters import uav_parameters
from bus.errors import ScenarioError
from bus.messages.scenario import Region
from bus.registry import LAWS
from flights import DT, HERE, R_S, R_V, U_A, V_A, V_G, briefing_of, distances, escort
from outrider.running.flying import fly
from properties import PROPERTY
from sim.models.vehicles import raw_switching_radius
from sim.scenario.laws import switching_radius_is_positive
from sim.scenario.types import Coverage, Scenario
from sim.scenario.vehicle_types import Uav, Ugv

speeds = st.floats(0.01, 5.0)


def test_the_ugv_is_visible_nearer_than_the_visibility_radius() -> None:
    assert is_visible(1.0, 2.0, 1.0, 2.0, R_V)
    assert is_visible(0.0, 0.0, math.nextafter(R_V, 0.0), 0.0, R_V)
    assert not is_visible(0.0, 0.0, R_V, 0.0, R_V)
    assert not is_visible(0.0, 0.0, 3.5, -3.5, R_V)


@given(st.floats(1.0, 50.0), speeds, speeds, st.floats(0.01, 10.0))
@settings(PROPERTY, max_examples=300)
def test_the_switching_radius_is_the_papers_two_phases(r_v, v_a, v_g, u_a):
    printed = r_v - (v_g * (v_a + v_g) + 0.5 * (v_a**2 - v_g**2)) / u_a
    assert raw_switching_radius(r_v, v_a, v_g, u_a) == pytest.approx(
        printed, rel=1e-12, abs=1e-12 * (r_v - printed)
    )
    assume(printed > 1e-9)
    assert switching_radius(r_v, v_a, v_g, u_a) == raw_switching_radius(r_v, v_a, v_g, u_a)


def test_the_papers_numbers_give_its_radius() -> None:
    assert switching_radius(R_V, V_A, V_G, U_A) == pytest.approx(3.6833, abs=5e-5)
    uav = uav_parameters(briefing_of(escort("logarithmic")))
    assert uav.switching_radius == switching_radius(R_V, V_A, V_G, U_A)
    assert switching_radius(R_V, V_A, V_G, math.inf) == R_V  # it stops on the spot


@given(st.floats(2.0, 50.0), speeds, speeds, st.floats(0.5, 10.0))
@settings(PROPERTY)
def test_worst_case_from_r_s_just_reaches_r_v(
    r_v: float, v_a: float, v_g: float, u_a: float
) -> None:
    r_s = raw_switching_radius(r_v, v_a, v_g, u_a)
    turn = (v_a + v_g) / u_a
    reached = [
        relative_motion(r_s, 0.0, v_a + v_g, 0.0, -u_a, 0.0, share * turn)[0]
        for share in (0.5, 0.99, 1.0, 1.01, 2.0)
    ]
    assert max(reached) == reached[2] == pytest.approx(r_v, rel=1e-9)


@pytest.mark.parametrize(
    ("r_v", "v_a", "v_g", "u_a", "r_s"),
    [
        *((R_V, 2.0, V_G, 0.3, r"-\S+"), (R_V, V_A, V_G, 0.06, r"-\S+")),
        *((R_V, math.inf, V_G, 0.3, "-inf"), (4.0, 0.75, 0.25, 0.125, "0")),
    ],
)
def test_a_uav_too_weak_for_the_radius_is_refused(r_v, v_a, v_g, u_a, r_s) -> None:
    with pytest.raises(
        ScenarioError, match=f"r_s = {r_s} m: the UAV .* too weak .*must be positive"
    ):
        switching_radius(r_v, v_a, v_g, u_a)


@pytest.mark.parametrize("law", LAWS)
def test_only_laws_that_use_the_switching_radius_ask_for_it(law: str) -> None:
    weak = escort(law, uav=Uav(position=HERE, max_acceleration=0.05))
    refused = bool(list(switching_radius_is_positive(weak)))
    assert refused is (law not in {"tracking", "coverage", "policy"})
    uav = uav_parameters(briefing_of(weak))
    assert uav.switching_radius < 0.0
    if refused:
        with pytest.raises(ScenarioError, match="too weak"):
            SelectedLaw(briefing_of(weak), weak.law, uav)
    else:
        SelectedLaw(briefing_of(weak), weak.law, uav)


def _worst_case(law: str, **fields: float) -> Scenario:
    """Fly with all uncovered ground on one side while the UGV drives off to the other."""
    covered = Coverage(covered=(Region(lower=(0.0, 0.0), upper=(40.0, 24.0)),))
    return escort(
        law,
        ugv=Ugv(position=HERE, goals=((20.0, 2.0),)),
        coverage=covered,
        **{"duration": 30.0, **fields},
    )


def test_proposition_2_has_no_margin_for_a_sample_time() -> None:
    """Documented behaviour: the sampled switching law loses a UGV that drives straight away, the less the shorter the
    tick.
    """
    flight, summary = fly(_worst_case("switching"), 0)
    assert R_V < summary.max_distance <= R_V + (V_A + V_G) * DT
    assert summary.visibility_violations > 0
    assert distances(flight)[0] == 0.0
    finer = fly(_worst_case("switching", dt=DT / 4.0), 0)[1].max_distance
    assert finer - R_V <= (V_A + V_G) * DT / 4.0 < summary.max_distance - R_V


@pytest.mark.parametrize("law", ["linear", "logarithmic"])
def test_weights_that_fade_have_a_margin(law: str) -> None:
    _, summary = fly(_worst_case(law), 0)
    assert summary.visibility_violations == 0
    assert summary.max_distance > 0.8 * R_S
