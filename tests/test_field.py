"""The field: sensor (2), accumulation (3), error (4), density (9) and the integral of (6), by NumPy and calculus."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import reference_field as reference
from agents.control.coverage import is_zero_gradient
from bus.registry import SENSORS
from properties import PROPERTY
from reference_field import FloatGrid
from sim.models.field import (
    Demand,
    accumulate,
    accumulate_with_gain,
    cover,
    coverage_error,
    coverage_gradient,
    coverage_shares,
    density,
    empty_coverage,
    penalty,
    penalty_slope,
)
from sim.models.sensor import SensorParameters, sensor_quality, sensor_slope

R, R_V, DESIRED = 5.0, 4.75, 2.0
R_O = R_V + R


class Patch(NamedTuple):
    """A patch of ground, partly covered, with both vehicles on it or beside it."""

    coverage: FloatGrid
    cell: float
    p_ax: float
    p_ay: float
    p_gx: float
    p_gy: float
    sensing_range: float
    r_o: float
    sensor: int


@st.composite
def patches(draw: st.DrawFn) -> Patch:
    """Draw non-square areas, cells of many sizes, and vehicles inside Q, on its border and outside."""
    cell = draw(st.sampled_from((0.1, 0.25, 0.37, 1.0)))
    rows, columns = draw(st.integers(1, 60)), draw(st.integers(1, 60))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    covered = rng.random((rows, columns)) < draw(st.floats(0.0, 1.0))
    coverage = rng.uniform(0.0, 2.0 * DESIRED, (rows, columns)) * covered
    x, y = (
        st.sampled_from((0.0, side, 0.5 * side)) | st.floats(-3.0, side + 3.0)
        for side in (columns * cell, rows * cell)
    )
    sensing_range, sensor = draw(st.floats(0.05, 8.0)), st.sampled_from(range(len(SENSORS)))
    both, r_o = (draw(one) for one in (x, y, x, y)), sensing_range * draw(st.floats(1.01, 2.0))
    return Patch(coverage, cell, *both, sensing_range, r_o, draw(sensor))


@given(patches())
@settings(PROPERTY, max_examples=300)
def test_accumulation_is_quality_times_time_in_every_cell(patch: Patch) -> None:
    sensor, kernel = SensorParameters(patch.sensor, 1.7, patch.sensing_range), patch.coverage.copy()
    accumulate(kernel, patch.p_ax, patch.p_ay, sensor, patch.cell, 0.05)
    wanted = reference.accumulate(patch.coverage, patch.p_ax, patch.p_ay, *sensor, patch.cell, 0.05)
    np.testing.assert_allclose(kernel, wanted, rtol=1e-12, atol=1e-12 * 1.7 * 0.05)


@given(patches())
@settings(PROPERTY, max_examples=300)
def test_error_is_the_integral_over_the_whole_grid(patch: Patch) -> None:
    arguments = (patch.coverage, patch.p_gx, patch.p_gy, patch.r_o, DESIRED, patch.cell)
    wanted = reference.coverage_error(*arguments)
    least = 1e-12 * DESIRED**2 * patch.cell**2
    assert coverage_error(*arguments) == pytest.approx(wanted, rel=1e-12, abs=least)


@given(patches())
@settings(PROPERTY, max_examples=300)
def test_gradient_is_the_integral_over_the_whole_grid(patch: Patch) -> None:
    arguments = (patch.coverage, patch.p_ax, patch.p_ay, patch.p_gx, patch.p_gy, patch.r_o, DESIRED)
    sensor = SensorParameters(patch.sensor, 1.7, patch.sensing_range)
    u_x, u_y, size = coverage_gradient(*arguments, sensor, patch.cell)
    wanted = reference.coverage_gradient(*arguments, *sensor, patch.cell)
    assert (u_x, u_y) == pytest.approx(wanted, rel=1e-12, abs=1e-12 * size)


@pytest.mark.parametrize("sensor", range(len(SENSORS)), ids=SENSORS.keys())
def test_gradient_points_where_the_error_falls_fastest(sensor: int) -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        coverage = rng.uniform(0.0, 1.5 * DESIRED, (80, 60))
        p_ax, p_ay, p_gx, p_gy = rng.uniform(-1.0, 16.0, 4)
        rest = (p_gx, p_gy, R_O, DESIRED, SensorParameters(sensor, 1.0, R), 0.25)

        def decrease(d_x: float, d_y: float, rest=rest, coverage=coverage, p=(p_ax, p_ay)) -> float:
            return error_decrease(coverage, p[0] + d_x, p[1] + d_y, *rest)

        d = 1e-4
        slope_x = (decrease(d, 0.0) - decrease(-d, 0.0)) / (2 * d)
        slope_y = (decrease(0.0, d) - decrease(0.0, -d)) / (2 * d)
        u_x, u_y, size = coverage_gradient(coverage, p_ax, p_ay, *rest)
        assert (u_x, u_y) == pytest.approx((slope_x, slope_y), abs=1e-7 * size)


@pytest.mark.parametrize("sensor", range(len(SENSORS)), ids=SENSORS.keys())
@pytest.mark.parametrize("p", [(20.0, 20.0), (20.125, 20.125), (20.0, 20.125), (6.5, 20.0)])
def test_gradient_vanishes_in_symmetric_states_and_only_there(sensor, p):
    coverage = empty_coverage(40.0, 40.0, 0.25)
    rest = (*p, R_O, DESIRED, SensorParameters(sensor, 1.0, R), 0.25)
    assert is_zero_gradient(*coverage_gradient(coverage, *p, *rest))
    assert not is_zero_gradient(*coverage_gradient(coverage, p[0] + 1e-6, p[1], *rest))


def error_decrease(coverage, p_ax, p_ay, p_gx, p_gy, r_o, desired, sensor, cell):
    r"""Return $-\dot e$ while the UGV stands: $\int h'(C^* - C)\, S_a(p_a, q)\, \phi\, dq$.

    Arguments as in `coverage_gradient`.
    """
    from_uav = reference.distances(coverage, p_ax, p_ay, cell)
    quality = reference.sensor_quality(sensor.model, from_uav, sensor.peak, sensor.sensing_range)
    density_ = reference.density(reference.distances(coverage, p_gx, p_gy, cell), r_o)
    lack = 2.0 * np.maximum(0.0, desired - coverage)
    return float((lack * quality * density_).sum() * cell**2)


@pytest.mark.parametrize("sensor", range(len(SENSORS)), ids=SENSORS.keys())
def test_sensor_falls_from_its_peak_to_nothing_at_its_range(sensor: int) -> None:
    parameters, d = SensorParameters(sensor, 1.3, R), 1e-4
    rho2 = np.linspace(0.01, 2.0 * R**2, 4001)
    slope = [sensor_slope(parameters, s) for s in rho2]
    after, before = ([sensor_quality(parameters, s + step) for s in rho2] for step in (d, -d))
    np.testing.assert_allclose(slope, np.subtract(after, before) / (2 * d), atol=1e-6)
    assert max(slope) <= 0.0
    assert sensor_quality(parameters, 0.0) == 1.3
    for rho in (R, math.nextafter(R, 9.0), 2.0 * R, 1e6):
        assert sensor_quality(parameters, rho**2) == 0.0
        assert sensor_slope(parameters, rho**2) == 0.0


def test_sensors_differ() -> None:
    sensors = [SensorParameters(sensor, 1.0, R) for sensor in range(len(SENSORS))]
    qualities = {sensor_quality(sensor, 0.5 * R**2) for sensor in sensors}
    assert len(qualities) == len(SENSORS)


def test_hill_sensor_covers_a_third_of_its_cylinder() -> None:
    coverage = empty_coverage(12.0, 12.0, 0.05)
    accumulate(coverage, 6.0, 6.0, SensorParameters(reference.HILL, 1.5, R), 0.05, 2.0)
    assert coverage.sum() * 0.05**2 == pytest.approx(2.0 * 1.5 * math.pi * R**2 / 3.0, rel=1e-6)


@pytest.mark.parametrize("offset", [0.0, 1.3, 4.0, 4.99, 5.01])
def test_coverage_after_flying_past_is_the_integral_over_time(offset: float) -> None:
    """C = M/(r⁴v) ∫ (l² - s²)² ds over the chord 2l, which is 16/15 M l⁵ / (r⁴ v)."""
    coverage, v, dt = np.zeros((1, 1)), 0.6, 0.005
    sensor = SensorParameters(reference.HILL, 1.0, R)
    for k in range(round(12.0 / (v * dt))):
        x = 0.5 - 6.0 + (k + 0.5) * v * dt
        accumulate(coverage, x, 0.5 + offset, sensor, 1.0, dt)
    half = math.sqrt(max(0.0, R**2 - offset**2))
    assert coverage[0, 0] == pytest.approx(16.0 / 15.0 * half**5 / (R**4 * v), rel=1e-5, abs=1e-12)


def test_density_is_the_printed_cosine_up_to_its_radius() -> None:
    rho = np.linspace(0.0, R_O, 20001)
    phi = np.array([density(d * d, R_O) for d in rho])
    assert np.abs(phi - (np.cos(np.pi * rho / R_O) + 1.0)).max() < 1e-12
    assert (phi >= 0.0).all()
    for beyond in (R_O, math.nextafter(R_O, 99.0), 10.0, 1e9):
        assert density(beyond * beyond, R_O) == 0.0


@given(st.floats(-10.0, 10.0))
@settings(PROPERTY)
def test_penalty_counts_lack_alone_and_matches_its_derivative(lack: float) -> None:
    d = 1e-6
    assert penalty(lack) == max(0.0, lack) * max(0.0, lack)  # ** differs from it by a rounding
    slope = (penalty(lack + d) - penalty(lack - d)) / (2 * d)
    assert penalty_slope(lack) == pytest.approx(slope, abs=1e-5)


def test_error_of_bare_ground_converges_to_the_analytic_value() -> None:
    wanted = 8.0 * math.pi * R_O**2 * (0.5 - 2.0 / math.pi**2)
    off = [
        abs(coverage_error(empty_coverage(40.0, 40.0, h), 19.9, 20.3, R_O, DESIRED, h) - wanted)
        for h in (2.0, 0.5, 0.25, 0.125)
    ]
    assert off[0] > 4.0 * off[1] > 16.0 * off[3]
    assert off[2] < 1e-3


def test_error_is_nothing_where_all_is_covered_and_only_there() -> None:
    coverage = np.full((160, 160), DESIRED)
    assert coverage_error(coverage, 20.0, 20.0, R_O, DESIRED, 0.25) == 0.0
    coverage[80, 80] = math.nextafter(DESIRED, 0.0)
    assert coverage_error(coverage, 20.0, 20.0, R_O, DESIRED, 0.25) > 0.0
    assert coverage_error(coverage, 35.0, 35.0, R_O, DESIRED, 0.25) == 0.0  # it is not near the UGV


@given(patches(), st.sampled_from((DESIRED, 0.3, 7.0)))
@PROPERTY
def test_shares_are_those_of_every_cell(patch: Patch, desired: float) -> None:
    for coverage in (patch.coverage, np.minimum(patch.coverage, desired)):  # also C = C*
        covered, seen = coverage_shares(coverage, desired)
        assert covered == np.count_nonzero(coverage >= desired) / coverage.size
        assert seen == pytest.approx(np.minimum(coverage / desired, 1.0).mean(), rel=1e-12)


def test_covered_ground_keeps_the_larger_value() -> None:
    coverage = empty_coverage(3.0, 2.0, 0.5)
    assert coverage.shape == (4, 6)
    coverage[0, 0], coverage[3, 5] = 9.0, 9.0
    cover(coverage, (0.0, 0.0), (1.25, 0.75), 0.5, DESIRED)
    wanted = np.zeros((4, 6))
    wanted[:2, :3] = DESIRED  # centres at 0.25, 0.75 and 1.25 m
    wanted[0, 0], wanted[3, 5] = 9.0, 9.0
    np.testing.assert_array_equal(coverage, wanted)


@pytest.mark.parametrize("sensor", range(len(SENSORS)))
@pytest.mark.parametrize("position", [(20.0, 20.0), (0.4, 39.7)])
def test_gain_of_a_sensing_step_is_the_decrease_of_the_error(sensor, position):
    ground = np.random.default_rng(3).uniform(0.0, 2.5, (160, 160))
    (p_x, p_y), (g_x, g_y), dt = position, (position[0] + 1.5, position[1] - 2.0), 0.05
    plain, seen, parameters = ground.copy(), ground.copy(), SensorParameters(sensor, 1.0, R)
    accumulate(plain, p_x, p_y, parameters, 0.25, dt)
    demand = Demand(g_x, g_y, R_O, DESIRED)
    gain = accumulate_with_gain(seen, p_x, p_y, demand, parameters, 0.25, dt)
    assert seen.tobytes() == plain.tobytes()
    before, after = (coverage_error(c, g_x, g_y, R_O, DESIRED, 0.25) for c in (ground, seen))
    assert gain == pytest.approx(before - after, rel=1e-9)
    rate = error_decrease(ground, p_x, p_y, *demand, parameters, 0.25)
    # the penalty's second derivative over one tick
    assert 0.95 * rate * dt <= gain < rate * dt
