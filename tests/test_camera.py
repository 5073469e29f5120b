"""The camera's parameters at a height, against geometry and at their limits."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from properties import PROPERTY
from sim.models.camera import (
    CameraParameters,
    noise_at,
    peak_at,
    range_at,
    sensor_at,
    visibility_radius_at,
)
from sim.models.sensor import SensorParameters, sensor_quality

heights = st.floats(0.1, 50.0)
angles = st.floats(0.1, 1.5)


@given(st.floats(0.5, 10.0), angles, heights)
@settings(PROPERTY)
def test_range_ends_at_the_edge_of_the_cone_or_at_r(sensing_range, angle, z) -> None:
    found = range_at(sensing_range, math.tan(angle), z)
    if found < sensing_range:
        assert math.atan2(found, z) == pytest.approx(angle)
    else:
        assert found == sensing_range
        assert math.atan2(sensing_range, z) <= angle + 1e-9


@given(st.floats(0.1, 5.0), st.floats(1.0, 20.0), heights)
@settings(PROPERTY)
def test_peak_falls_with_the_square_of_the_height(peak, reference, z) -> None:
    assert peak_at(peak, reference, reference) == peak
    assert peak_at(peak, reference, 2.0 * z) == pytest.approx(0.25 * peak_at(peak, reference, z))


@given(st.floats(0.5, 10.0), angles, st.floats(0.0, 2.0), heights)
@settings(PROPERTY)
def test_visibility_radius_is_that_of_the_cone_at_the_marker(r_v, angle, marker, z) -> None:
    found = visibility_radius_at(r_v, math.tan(angle), marker, z)
    wanted = range_at(r_v, math.tan(angle), z - marker) if z > marker else 0.0
    assert found == wanted
    assert 0.0 <= found <= r_v
    assert visibility_radius_at(r_v, math.tan(angle), marker, 1e6) == r_v


@given(st.floats(0.01, 1.0), st.floats(1.0, 20.0), st.floats(0.0, 20.0), heights)
@settings(PROPERTY)
def test_noise_grows_with_the_distance_from_the_camera(sigma, reference, distance, z) -> None:
    assert noise_at(sigma, reference, 0.0, reference) == sigma
    assert noise_at(0.0, reference, distance, z) == 0.0
    found = noise_at(sigma, reference, distance, z)
    assert found == pytest.approx(sigma / reference * math.hypot(distance, z))


def test_sensor_at_a_height() -> None:
    sensor, camera = SensorParameters(0, 1.2, 5.0), CameraParameters(math.tan(0.5), 10.0, 0.4)
    low, same, high = (sensor_at(sensor, camera, z) for z in (5.0, 10.0, 20.0))
    assert low == (0, pytest.approx(4.8), pytest.approx(5.0 * math.tan(0.5)))
    assert same == (0, 1.2, 5.0)
    assert high == (0, pytest.approx(0.3), 5.0)
    assert sensor_quality(high, 0.0) == pytest.approx(0.3)
    assert sensor_quality(low, low.sensing_range**2) == 0.0
