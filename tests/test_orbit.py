"""Virtual point tracking, (20) to (25): the circle, its largest rate, and user paths."""

import math
import re

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
from sim.scenario.laws import largest_circle_rate
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv
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
    a_x, a_y = _after_a_second(u_x, u_y)
    d_x, d_y = desired_position(*_after_a_second(g_x, g_y), *_after_a_second(v_x, v_y))
    found = path_error_acceleration(u_x, u_y, g_x + v_x, g_y + v_y)
    assert found == pytest.approx((a_x - d_x, a_y - d_y), abs=1e-11)
    plain = path_error_acceleration(u_x, u_y, v_x, v_y)
    assert virtual_error_acceleration(u_x, u_y, v_x, v_y) == plain  # g = 0


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
    wanted = (r_pv * math.cos(omega * t), r_pv * math.sin(omega * t))
    assert (x, y) == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    d = 1e-3
    (b_x, b_y, *_), (c_x, c_y, *_) = circle(t - d, r_pv, omega), circle(t + d, r_pv, omega)
    second = ((c_x - 2.0 * x + b_x) / d**2, (c_y - 2.0 * y + b_y) / d**2)
    assert (a_x, a_y) == pytest.approx(second, abs=1e-4)
    speed = math.hypot(c_x - b_x, c_y - b_y) / (2.0 * d)
    assert speed == pytest.approx(r_pv * abs(omega), rel=1e-5, abs=1e-9)


bounds = st.floats(0.01, 5.0) | st.just(math.inf)


@given(st.floats(0.1, 10.0), st.floats(0.3, 5.0), st.floats(0.01, 0.3), bounds)
@settings(PROPERTY)
def test_the_largest_rate_exhausts_the_speed_or_the_acceleration(r_pv, v_a, v_g, u_a):
    omega = largest_circle_rate(r_pv, v_a, v_g, u_a)
    speed, acceleration = (r_pv * omega + v_g) / v_a, r_pv * omega**2 / u_a
    assert max(speed, acceleration) == pytest.approx(1.0, rel=1e-12)


def _round_trip(law: Law, duration: float = 100.0) -> Scenario:
    """Fly with a UGV that drives straight at full speed; the UAV starts on the circle."""
    ugv = Ugv(position=(10.0, 10.0), velocity=(V_G, 0.0), goals=((55.0, 10.0),))
    area = Area(width=60.0, height=20.0, cell=0.5)
    return escort(law, uav=Uav(position=(10.0 + R_S, 10.0)), ugv=ugv, area=area, duration=duration)


def _circle(rate: float, **parameters: float) -> Law:
    return Law(name="circle", parameters={"circle_rate": rate} | parameters)


def _path_error(flight: Flight, omega: float) -> FloatGrid:
    """Return the distance from the circle's point at each tick [m]."""
    uav, ugv = tracks(flight)
    wanted = [
        desired_position(x, y, *circle(k * DT, R_S, omega)[:2])
        for k, (x, y) in enumerate(ugv[:, :2].tolist())
    ]
    return np.hypot(*(uav[:, :2] - np.array(wanted)).T)


@pytest.mark.parametrize("omega", [0.1, -0.1, 0.108])
def test_a_circle_that_can_be_flown_is_followed(omega: float) -> None:
    flight, summary = fly(_round_trip(_circle(omega)), 0)
    assert _path_error(flight, omega)[1600:].max() < 1e-3
    assert summary.visibility_violations == 0
    assert distances(flight)[1600:] == pytest.approx(R_S, abs=1e-3)


@pytest.mark.parametrize(("omega", "mean_distance"), [(0.13, R_S), (1.0, 1.0)])
def test_faster_circles_are_not_followed(omega: float, mean_distance: float) -> None:
    """The paper's rate of 1 rad/s collapses the circle."""
    flight, summary = fly(_round_trip(_circle(omega), duration=160.0), 0)
    assert _path_error(flight, omega)[1600:].max() > 0.05
    assert summary.mean_distance < mean_distance


def test_user_radius_is_flown() -> None:
    flight, _ = fly(_round_trip(_circle(0.1, circle_radius=1.5)), 0)
    assert distances(flight)[1600:] == pytest.approx(1.5, abs=2e-3)


def _circle_path(t: float) -> Point:
    x, y, a_x, a_y = circle(t, R_S, 0.1)
    return (x, y), (a_x, a_y)


def test_user_path_equal_to_the_circle_flies_the_circles_bits() -> None:
    _, shipped = fly(_round_trip(_circle(0.1), duration=60.0), 0)
    _, own = fly(_round_trip(Law(name="path"), duration=60.0), 0, path=_circle_path)
    assert own.trajectory_sha256 == shipped.trajectory_sha256


def test_the_path_law_needs_a_path() -> None:
    with pytest.raises(ScenarioError, match="needs a path"):
        fly(_round_trip(Law(name="path"), duration=1.0), 0)


def _check(path: Path, duration: float = 100.0) -> tuple[str, ...]:
    return check_path(path, duration, R_V, V_A, V_G, U_A)


def test_paths_that_can_be_flown_pass() -> None:
    assert _check(_circle_path) == ()
    assert _check(lambda t: ((2.0, -1.0), (0.0, 0.0))) == ()


def test_too_fast_path_warns_with_time_and_bound() -> None:
    def path(t: float) -> Point:
        c, s = R_S * math.cos(0.35 * t), R_S * math.sin(0.35 * t)
        return (c, s), (-(0.35**2) * c, -(0.35**2) * s)

    speed, acceleration = _check(path)
    assert re.search(r"1.289 m/s at t = .*v_a - v_g = 0.4 m/s", speed)
    assert re.search(r"m/s² at t = .*u_a = 0.3 m/s²", acceleration)


BAD: dict[str, tuple[Path, str]] = {
    "outside": (lambda t: ((R_V, 0.0), (0.0, 0.0)), "allowed: less than r_v = 4.75 m"),
    "forgotten derivative": (lambda t: ((0.02 * t * t, 0.0), (0.0, 0.0)), "off by 0.04 m/s²"),
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
