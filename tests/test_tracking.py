"""Tracking, (13) to (16).

The controller's exact discretization, its closed loop, and continuous integration.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from agents.control.tracking import (
    relative_acceleration,
    relative_motion,
    state_feedback,
    tracking_output,
    tracking_step,
)
from agents.laws.inputs import LawInputs
from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from flights import (
    DT,
    HERE,
    R_S,
    V_G,
    distances,
    escort,
    flown_law,
    target_at,
    tracks,
)
from outrider.running.flying import fly
from properties import PROPERTY
from reference_field import FloatGrid
from sim.models.field import empty_coverage
from sim.models.vehicles import State, step_vehicle
from sim.scenario.vehicle_types import Uav, Ugv

A_C, B_C, C_C, D_C = -3.0, -3.0, -8.0 / 3.0, -3.0
numbers = st.floats(-10.0, 10.0)


states = st.tuples(*[numbers] * 4)
commands = st.tuples(numbers, numbers)


@given(states, commands, states, commands, st.floats(0.0, 5.0))
@settings(PROPERTY)
def test_the_error_accelerates_by_the_difference_of_the_commands(uav, u_a, ugv, u_g, t) -> None:
    a = step_vehicle(*uav, *u_a, math.inf, math.inf, t)
    g = step_vehicle(*ugv, *u_g, math.inf, math.inf, t)
    error = (np.array(uav) - ugv).tolist()
    found = relative_motion(*error, *relative_acceleration(*u_a, *u_g), t)
    assert found == pytest.approx((np.array(a[:4]) - g[:4]).tolist(), rel=1e-12, abs=1e-10)


@pytest.mark.parametrize("poles", [(-1.0, -1.0), (-0.5, -2.0), (-1.0 + 1.0j, -1.0 - 1.0j)])
def test_state_feedback_places_the_poles_of_its_gains(poles: tuple[complex, complex]) -> None:
    _, k_1, k_0 = np.poly(poles).real.tolist()
    columns = [
        [v, state_feedback(p, 0.0, v, 0.0, k_0, k_1)[0]] for p, v in ((1.0, 0.0), (0.0, 1.0))
    ]
    np.testing.assert_allclose(np.poly(np.array(columns).T), np.poly(poles).real, atol=1e-12)
    assert state_feedback(0.0, 3.0, 0.0, 2.0, k_0, k_1) == pytest.approx(
        (0.0, -3.0 * k_0 - 2.0 * k_1)
    )


@given(st.floats(-50.0, 5.0), numbers, st.floats(1e-3, 1.0))
@settings(PROPERTY)
def test_the_controllers_step_is_scipys_zero_order_hold(a_c: float, b_c: float, dt: float) -> None:
    a_d, b_d, *_ = cont2discrete(np.array([[[a_c]], [[b_c]], [[1.0]], [[0.0]]]), dt, method="zoh")
    x, y = tracking_step(1.7, -0.4, 2.3, 5.1, a_c, b_c, dt)
    wanted = (a_d[0, 0] * 1.7 + b_d[0, 0] * 2.3, a_d[0, 0] * -0.4 + b_d[0, 0] * 5.1)
    assert (x, y) == pytest.approx(wanted, rel=1e-10, abs=1e-10)


def test_controller_without_a_pole_is_a_plain_integral() -> None:
    plain = (1.0 + B_C * 3.0 * 0.1, -2.0 + B_C * 4.0 * 0.1)
    assert tracking_step(1.0, -2.0, 3.0, 4.0, 0.0, B_C, 0.1) == pytest.approx(
        plain, rel=1e-14, abs=1e-14
    )
    for a_c in (1e-6, -1e-6, 1e-12, -1e-300):
        found = tracking_step(1.0, -2.0, 3.0, 4.0, a_c, B_C, 0.1)
        assert found == pytest.approx(plain, abs=1e-6)


def _loop() -> FloatGrid:
    """Return the closed loop of (15) and (16) on one axis, state (p, v, x_c), from the shipped functions."""
    law = law_parameters(Law())
    rows = [
        tracking_output(x, 0.0, p, 0.0, law.c_c, law.d_c)[0] for p, x in ((1.0, 0.0), (0.0, 1.0))
    ]
    return np.array([[0.0, 1.0, 0.0], [rows[0], 0.0, rows[1]], [law.b_c, 0.0, law.a_c]])


def test_the_papers_gains_put_all_three_poles_at_minus_one() -> None:
    np.testing.assert_allclose(np.poly(_loop()), [1.0, 3.0, 3.0, 1.0], atol=1e-12)


def _sampled_loop(dt: float) -> FloatGrid:
    """Return the loop as flown, one step of controller and motion, column by column."""
    columns = []
    for p, v, x in np.eye(3).tolist():
        u, _ = tracking_output(x, 0.0, p, 0.0, C_C, D_C)
        q, _, w, _ = relative_motion(p, 0.0, v, 0.0, u, 0.0, dt)
        columns.append((q, w, tracking_step(x, 0.0, p, 0.0, A_C, B_C, dt)[0]))
    return np.array(columns).T


def test_the_sampled_loop_converges_and_nears_the_continuous_one() -> None:
    assert np.abs(np.linalg.eigvals(_sampled_loop(DT))).max() < 1.0
    for dt in (0.1, 0.05, 0.01):
        rate = (_sampled_loop(dt) - np.eye(3)) / dt
        np.testing.assert_allclose(rate, _loop(), atol=5.0 * dt)


def test_tracking_alone_reaches_a_ugv_of_constant_velocity() -> None:
    ugv = Ugv(position=HERE, velocity=(V_G, 0.0), goals=((39.0, 20.0),))
    flight, summary = fly(
        escort("tracking", uav=Uav(position=(18.5, 22.0)), ugv=ugv, duration=60.0), 0
    )
    assert distances(flight)[-200:].max() < 1e-3
    assert summary.visibility_violations == 0
    np.testing.assert_allclose(tracks(flight)[0][-1, 2:4], (V_G, 0.0), atol=1e-4)


@pytest.mark.parametrize(
    "law", ["switching", "linear", "logarithmic", "coverage", "weighted", "tracking"]
)
def test_tracking_keeps_integrating_while_its_weight_is_zero(law: str) -> None:
    angle = np.linspace(0.0, 7.0, 120)
    positions = np.stack(((1.0 + 0.2 * angle) * np.cos(angle), 2.0 * np.sin(2.0 * angle)), axis=1)
    assert np.hypot(*positions.T).max() < R_S
    # from the end of the first detection's tick to the end of the last one
    age = DT * np.arange(len(positions) - 1, -1, -1)
    share = np.exp(A_C * age) * (np.exp(A_C * DT) - 1.0) / A_C * B_C
    c, coverage = flown_law(escort(law)), empty_coverage(40.0, 40.0, 0.25)
    for tick, (x, y) in enumerate(positions.tolist()):
        own = State(HERE[0] + x, HERE[1] + y, 0.1, 0.0)
        c.command(LawInputs(coverage, tick, own, target_at(*HERE)))
    np.testing.assert_allclose(c.memory["x_c"], share @ positions, rtol=1e-10)
