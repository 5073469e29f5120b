"""Virtual point tracking, (20) to (25): the circle, its largest rate, and user paths."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.control.orbit import (
    Path,
    check_path,
    circle,
    desired_position,
    orbit_control,
    orbit_error_acceleration,
    path_error_acceleration,
    virtual_error_acceleration,
)
from bus.errors import ScenarioError
from bus.messages.scenario import Area, Law
from flights import DT, R_S, R_V, U_A, V_A, V_G, distances, escort, tracks
from outrider.running.flying import fly
from properties import PROPERTY
from reference_field import FloatGrid
from sim.models.vehicles import step_vehicle
from sim.scenario.checks import largest_circle_rate
from sim.scenario.types import Scenario, Uav, Ugv
from sim.server.flight import Flight

numbers = st.floats(-100.0, 100.0)
Point = tuple[tuple[float, float], tuple[float, float]]


def _after_a_second(a_x: float, a_y: float) -> tuple[float, float]:
    """Return twice the distance [m] that a double integrator covers from rest, which is its acceleration [m/s²]."""
    p_x, p_y, *_ = step_vehicle(0.0, 0.0, 0.0, 0.0, a_x, a_y, math.inf, math.inf, 1.0)
    return 2.0 * p_x, 2.0 * p_y


@given(*[numbers] * 6)
@settings(PROPERTY)
def test_the_path_error_accelerates_as_the_paper_derives(u_x, u_y, g_x, g_y, v_x, v_y):
    (a_x, a_y), (d_x, d_y) = (
        _after_a_second(u_x, u_y),
        desired_position(*_after_a_second(g_x, g_y), *_after_a_second(v_x, v_y)),
    )
    assert path_error_acceleration(u_x, u_y, g_x + v_x, g_y + v_y) == pytest.approx(
        (a_x - d_x, a_y - d_y), abs=1e-11
    )
    assert virtual_error_acceleration(u_x, u_y, v_x, v_y) == path_error_acceleration(
        u_x, u_y, v_x, v_y
    )  # g = 0


@given(*[numbers] * 4)
@settings(PROPERTY)
def test_tracking_law_alone_drives_the_path_error(u_x, u_y, v_x, v_y):
    a_x, a_y = _after_a_second(*orbit_control(u_x, u_y, v_x, v_y))
    d_x, d_y = _after_a_second(v_x, v_y)
    assert (a_x - d_x, a_y - d_y) == pytest.approx((u_x, u_y), abs=1e-11)
    assert orbit_error_acceleration(u_x, u_y, v_x, v_y) == pytest.approx((u_x, u_y), abs=1e-11)


@given(st.floats(0.0, 500.0), st.floats(0.1, 10.0), st.floats(-2.0, 2.0))
@settings(PROPERTY)
def test_circle_has_its_radius_rate_and_second_derivative(t, r_pv, omega):
    x, y, a_x, a_y = circle(t, r_pv, omega)
    assert (x, y) == pytest.approx(
        (r_pv * math.cos(omega * t), r_pv * math.sin(omega * t)), rel=1e-12, abs=1e-12
    )
    d = 1e-3
    (b_x, b_y, *_), (c_x, c_y, *_) = circle(t - d, r_pv, omega), circle(t + d, r_pv, omega)
    assert (a_x, a_y) == pytest.approx(
        ((c_x - 2.0 * x + b_x) / d**2, (c_y - 2.0 * y + b_y) / d**2), abs=1e-4
    )
    assert math.hypot(c_x - b_x, c_y - b_y) / (2.0 * d) == pytest.approx(
        r_pv * abs(omega), rel=1e-5, abs=1e-9
    )


@given(
    st.floats(0.1, 10.0),
    st.floats(0.3, 5.0),
    st.floats(0.01, 0.3),
    st.floats(0.01, 5.0) | st.just(math.inf),
)
@settings(PROPERTY)
def test_the_largest_rate_exhausts_the_speed_or_the_acceleration(r_pv, v_a, v_g, u_a):
    omega = largest_circle_rate(r_pv, v_a, v_g, u_a)
    speed, acceleration = (r_pv * omega + v_g) / v_a, r_pv * omega**2 / u_a
    assert max(speed, acceleration) == pytest.approx(1.0, rel=1e-12)


def _round_trip(law: Law, duration: float = 160.0) -> Scenario:
    """Fly with a UGV that drives straight at full speed; the UAV starts on the circle."""
    ugv = Ugv(position=(10.0, 10.0), velocity=(V_G, 0.0), goals=((55.0, 10.0),))
    area = Area(width=60.0, height=20.0, cell=0.5)
    return escort(law, uav=Uav(position=(10.0 + R_S, 10.0)), ugv=ugv, area=area, duration=duration)


def _path_error(flight: Flight, omega: float) -> FloatGrid:
    """Return p_a - p_d at each tick [m]."""
    uav, ugv = tracks(flight)
    wanted = [
        desired_position(x, y, *circle(k * DT, R_S, omega)[:2])
        for k, (x, y) in enumerate(ugv[:, :2].tolist())
    ]
    return uav[:, :2] - np.array(wanted)


@pytest.mark.parametrize("omega", [0.1, -0.1, 0.108])
def test_a_circle_that_can_be_flown_is_followed(omega: float) -> None:
    flight, summary = fly(_round_trip(Law(name="circle", parameters={"circle_rate": omega})), 0)
    error = np.hypot(*_path_error(flight, omega).T)
    assert error[1600:].max() < 1e-3
    assert summary.visibility_violations == 0
    assert distances(flight)[1600:] == pytest.approx(R_S, abs=1e-3)


def test_a_circle_faster_than_the_largest_rate_is_not_followed() -> None:
    flight, _ = fly(_round_trip(Law(name="circle", parameters={"circle_rate": 0.13})), 0)
    assert np.hypot(*_path_error(flight, 0.13).T)[1600:].max() > 0.05


def test_the_papers_rate_collapses_the_circle() -> None:
    _, summary = fly(_round_trip(Law(name="circle", parameters={"circle_rate": 1.0})), 0)
    assert summary.mean_distance < 1.0


def test_user_radius_is_flown() -> None:
    flight, _ = fly(
        _round_trip(Law(name="circle", parameters={"circle_rate": 0.1, "circle_radius": 1.5})), 0
    )
    assert distances(flight)[1600:] == pytest.approx(1.5, abs=2e-3)


def _compiled_circle(t: float) -> Point:
    x, y, a_x, a_y = circle(t, R_S, 0.1)
    return (x, y), (a_x, a_y)


def _own_circle(t: float) -> Point:
    c, s = R_S * math.cos(0.1 * t), R_S * math.sin(0.1 * t)
    return (c, s), (-0.01 * c, -0.01 * s)


def test_user_path_equal_to_the_circle_flies_the_circle() -> None:
    shipped, by_law = fly(
        _round_trip(Law(name="circle", parameters={"circle_rate": 0.1}), duration=60.0), 0
    )
    scenario = _round_trip(Law(name="path"), duration=60.0)
    assert fly(scenario, 0, path=_compiled_circle)[1].trajectory_sha256 == by_law.trajectory_sha256
    own, _ = fly(scenario, 0, path=_own_circle)
    np.testing.assert_allclose(own.recorder.states, shipped.recorder.states, rtol=1e-9, atol=1e-9)


def test_the_path_law_needs_a_path() -> None:
    with pytest.raises(ScenarioError, match="needs a path"):
        fly(_round_trip(Law(name="path"), duration=1.0), 0)


def _check(path: Path, duration: float = 100.0) -> tuple[str, ...]:
    return check_path(path, duration, R_V, V_A, V_G, U_A)


def test_paths_that_can_be_flown_pass() -> None:
    assert _check(_own_circle) == ()
    assert _check(lambda t: ((2.0, -1.0), (0.0, 0.0))) == ()
    assert (
        _check(lambda t: ((3.0 * math.sin(0.1 * t), 0.5), (-0.03 * math.sin(0.1 * t), 0.0))) == ()
    )


def test_too_fast_path_warns_with_time_and_bound() -> None:
    def path(t: float) -> Point:
        c, s = R_S * math.cos(0.35 * t), R_S * math.sin(0.35 * t)
        return (c, s), (-(0.35**2) * c, -(0.35**2) * s)

    warnings = _check(path)
    assert len(warnings) == 2
    assert "1.289 m/s at t = " in warnings[0]
    assert "v_a - v_g = 0.4 m/s" in warnings[0]
    assert "m/s² at t = " in warnings[1]
    assert "u_a = 0.3 m/s²" in warnings[1]


BAD: dict[str, tuple[Path, str]] = {
    "outside": (
        lambda t: ((R_V, 0.0), (0.0, 0.0)),
        "4.75 m from the UGV; allowed: less than r_v = 4.75 m",
    ),
    "wrong derivative": (
        lambda t: ((math.cos(t), 0.0), (math.cos(t), 0.0)),
        "second derivative is off by",
    ),
    "forgotten derivative": (
        lambda t: ((0.02 * t * t, 0.0), (0.0, 0.0)),
        "second derivative is off by 0.04 m/s²",
    ),
    "not finite": (lambda t: ((math.nan, 0.0), (0.0, 0.0)), "all finite"),
    "one vector": (lambda t: (1.0, 2.0), "must return"),  # type: ignore[dict-item,return-value]
    "three axes": (lambda t: ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0)), "must return"),  # type: ignore[dict-item,return-value]
    "fails": (lambda t: ((1.0 / (t - t), 0.0), (0.0, 0.0)), "division by zero"),
}


@pytest.mark.parametrize(("path", "phrase"), BAD.values(), ids=BAD.keys())
def test_what_is_no_path_is_refused_with_the_time(path: Path, phrase: str) -> None:
    with pytest.raises(ScenarioError, match=r"^path at t = [\d.]+ s") as refused:
        _check(path)
    assert phrase in str(refused.value)
