"""Dynamic coverage, (8) and (10) to (12): the law's parts, Proposition 1, and the start right above the UGV."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.control.coverage import (
    approach_control,
    coverage_control,
    desired_velocity,
    is_zero_gradient,
    single_integrator_command,
    velocity_error,
)
from agents.laws.common import coverage_term
from agents.laws.inputs import LawInputs
from agents.uav import UavPilot
from bus.messages.scenario import Area, Law, Sensor
from bus.registry import SENSORS
from flights import (
    DESIRED,
    DT,
    HERE,
    U_A,
    V_A,
    briefing_of,
    errors,
    escort,
    flown_law,
    target_at,
    tracks,
    uav_sees,
)
from outrider.running.flying import fly
from properties import PROPERTY
from sim.models.sensor import SensorParameters
from sim.models.vehicles import State, clip_norm, norm, step_vehicle
from sim.scenario.types import Scenario, Visibility
from sim.scenario.vehicle_types import Uav, Ugv

numbers = st.floats(-100.0, 100.0)
UNBOUNDED = {"max_speed": math.inf, "max_acceleration": math.inf}


@given(numbers, numbers, st.floats(1e-6, 1e6))
@settings(PROPERTY)
def test_gradient_counts_unless_negligible_beside_its_integrand(x, y, size):
    chosen = single_integrator_command(x, y, size, 7.0, 8.0)
    zero = math.hypot(x, y) / size < 1e-9
    assert is_zero_gradient(x, y, size) == zero
    assert chosen == ((7.0, 8.0) if zero else (x, y))


@given(numbers, numbers, numbers, numbers, st.floats(0.01, 5.0))
@settings(PROPERTY)
def test_velocity_error_leads_to_nominal_speed_along_the_command(x, y, v_x, v_y, v_ref):
    e_x, e_y = velocity_error(x, y, v_ref, v_x, v_y, True)
    wanted = (e_x + v_x, e_y + v_y)
    assert wanted == pytest.approx(desired_velocity(x, y, v_ref), abs=1e-12)
    assert velocity_error(x, y, v_ref, v_x, v_y, False) == (-v_x, -v_y)  # all is covered
    if norm(x, y) > 1e-100:
        assert math.hypot(*wanted) == pytest.approx(v_ref, abs=1e-11)
        assert wanted[0] * x + wanted[1] * y == pytest.approx(v_ref * math.hypot(x, y), rel=1e-9)


def test_the_law_is_finite_without_a_direction() -> None:
    assert single_integrator_command(0.0, 0.0, 0.0, 7.0, 8.0) == (7.0, 8.0)
    assert velocity_error(0.0, 0.0, 0.6, 0.3, -0.2, True) == (-0.3, 0.2)
    assert coverage_control(0.25, -0.5, 10.0) == (2.5, -5.0)


@given(*[numbers] * 6, st.floats(0.1, 30.0), st.floats(0.1, 2.0))
@settings(PROPERTY)
def test_the_approach_is_the_printed_one(q_x, q_y, p_x, p_y, v_x, v_y, k_v, v_ref):
    distance = math.hypot(q_x - p_x, q_y - p_y)
    if distance > 1e-9:
        pull = k_v * v_ref / distance
        wanted = (pull * (q_x - p_x) - k_v * v_x, pull * (q_y - p_y) - k_v * v_y)
        found = approach_control(q_x, q_y, p_x, p_y, v_x, v_y, k_v, v_ref)
        assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("v_max", "u_max"), [(V_A, U_A), (math.inf, math.inf)])
@pytest.mark.parametrize("k_v", [0.5, 2.0, 10.0, 20.0, 30.0])
def test_the_approach_reaches_its_point_and_stays_near_it(v_max, u_max, k_v):
    rng = np.random.default_rng(5)
    for _ in range(5):
        (q_x, q_y), start = rng.uniform(0.0, 15.0, (2, 2)).tolist()
        state = (*start, *clip_norm(*rng.uniform(-V_A, V_A, 2).tolist(), V_A))
        distances = []
        for _ in range(1600):
            u = approach_control(q_x, q_y, *state, k_v, V_A)
            *state, _, _ = step_vehicle(*state, *u, v_max, u_max, DT)
            distances.append(norm(state[0] - q_x, state[1] - q_y))
        assert min(distances) < V_A * DT
        assert max(distances[1001:]) < V_A**2 / (2.0 * U_A) + 2.0 * V_A * DT


def _standing(k_v: float, sensor: str, **limits: float) -> Scenario:
    return escort(
        Law(name="coverage", parameters={"speed_gain": k_v, "reference_speed": V_A}),
        uav=Uav(position=(4.0, 4.0), **limits),
        ugv=Ugv(position=(4.0, 4.0)),
        area=Area(width=9.0, height=8.0, cell=0.25),
        sensor=Sensor(model=sensor, range=2.0),
        visibility=Visibility(radius=1.5),
        duration=110.0,
    )


@pytest.mark.parametrize("limits", [{}, UNBOUNDED], ids=["bounded", "unbounded"])
@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("k_v", [1.0, 10.0])
def test_coverage_around_a_standing_ugv_completes(k_v, sensor, limits):
    """Check Proposition 1, and that the UAV brakes afterwards, (10)."""
    flight, summary = fly(_standing(k_v, sensor, **limits), 0)
    assert summary.initial_error > 90.0
    assert summary.final_error == 0.0
    assert (np.diff(errors(flight)) <= 0.0).all()
    assert np.abs(tracks(flight)[0][-1, 2:4]).max() < 1e-9


def test_over_covered_ground_the_law_brakes_with_its_gain() -> None:
    c, coverage = flown_law(escort("coverage")), np.full((160, 160), DESIRED)
    inputs = LawInputs(coverage, 0, State(*HERE, 0.3, -0.2), target_at(21.0, 20.0))
    found = coverage_term(*c[1:], inputs)
    k_v = c.law["speed_gain"]
    assert found == pytest.approx((-k_v * 0.3, k_v * 0.2), rel=1e-15)


def test_the_gain_of_the_gradient_drops_out() -> None:
    coverage = np.random.default_rng(1).uniform(0.0, 2.0, (160, 160))
    inputs = LawInputs(coverage, 0, State(21.0, 22.0, 0.1, 0.0), target_at(*HERE))
    one, ten = (
        coverage_term(*flown_law(escort("coverage"), sensor=sensor)[1:], inputs)
        for sensor in (SensorParameters(0, peak, 5.0) for peak in (1.0, 10.0))
    )
    assert one == pytest.approx(ten, rel=1e-12)


CORNER = (20.0, 20.0)
above = pytest.mark.parametrize("place", [(20.125, 20.125), CORNER], ids=["cell centre", "corner"])
laws = pytest.mark.parametrize("law", ["coverage", "linear", "switching", "logarithmic"])


def _first_command(law: str, place: tuple[float, float], seed: int) -> tuple[float, float]:
    """Return the UAV's command when it first detects the UGV, exactly below."""
    pilot = UavPilot(briefing_of(escort(law), seed))
    return pilot.act(uav_sees(0, (0.0, (0.0, 0.0)), position=place)).acceleration


@above
@laws
def test_uav_above_the_ugv_departs_in_a_keyed_direction(law, place):
    commands = [_first_command(law, place, seed) for seed in range(40)]
    for u_x, u_y in commands:
        assert norm(u_x, u_y) == pytest.approx(U_A, rel=1e-12)
    directions = {(round(u_x, 9), round(u_y, 9)) for u_x, u_y in commands}
    assert len(directions) == (4 if place == CORNER else 40)


@above
@laws
def test_right_above_the_ugv_the_uav_leaves_and_lowers_the_error(law, place):
    scenario = escort(law, uav=Uav(position=place), ugv=Ugv(position=place), duration=10.0)
    flight, summary = fly(scenario, 3)
    assert summary.max_distance > 1.0
    assert summary.final_error < summary.initial_error
    assert np.isfinite(flight.recorder.states[:-1]).all()
