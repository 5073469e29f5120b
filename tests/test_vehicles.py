"""The vehicles (1): exact between their bounds, never beyond them, and the braking distances of their drivers."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from properties import PROPERTY
from sim.models.vehicles import (
    brake,
    clip_norm,
    goal_reached,
    norm,
    speed_to_stop_within,
    step_vehicle,
    stopping_distance,
    within_walls,
)

ONE = 1.0 + 4.0 * np.finfo(float).eps  # possible rounding error of a norm

numbers = st.floats(-100.0, 100.0)
bounds = st.floats(1e-3, 100.0) | st.just(math.inf)
ticks = st.sampled_from((0.001, 0.05, 0.1, 1.0))


@given(*[numbers] * 6, ticks, st.integers(1, 50))
@settings(PROPERTY)
def test_constant_acceleration_matches_the_closed_form(
    p_x: float, p_y: float, v_x: float, v_y: float, u_x: float, u_y: float, dt: float, count: int
) -> None:
    state = (p_x, p_y, v_x, v_y)
    for _ in range(count):
        *state, a_x, a_y = step_vehicle(*state, u_x, u_y, math.inf, math.inf, dt)
        assert (a_x, a_y) == (u_x, u_y)
    t = count * dt
    wanted = (
        p_x + v_x * t + 0.5 * u_x * t * t,
        p_y + v_y * t + 0.5 * u_y * t * t,
        v_x + u_x * t,
        v_y + u_y * t,
    )
    assert state == pytest.approx(wanted, rel=1e-12, abs=1e-10 * max(1.0, t * t))


@given(st.floats(0.05, 2.0), st.floats(0.05, 2.0), ticks)
@settings(PROPERTY)
def test_acceleration_to_the_bound_matches_the_closed_form(v_max, u_max, dt):
    state = (0.0, 0.0, 0.0, 0.0)
    for k in range(1, 61):
        *state, _, _ = step_vehicle(*state, u_max, 0.0, v_max, u_max, dt)
        t, full = k * dt, v_max / u_max
        wanted = 0.5 * u_max * t * t if t <= full else 0.5 * v_max * full + v_max * (t - full)
        assert state[2] == pytest.approx(min(u_max * t, v_max), rel=1e-12)
        # the tick in which the bound is reached
        assert abs(state[0] - wanted) <= u_max * dt * dt / 8.0 + 1e-9
        assert state[1] == state[3] == 0.0


@given(*[numbers] * 6, bounds, bounds, ticks)
@settings(PROPERTY, max_examples=500)
def test_speed_and_acceleration_never_exceed_their_bounds(
    p_x, p_y, v_x, v_y, u_x, u_y, v_max, u_max, dt
) -> None:
    q_x, q_y, w_x, w_y, a_x, a_y = step_vehicle(p_x, p_y, v_x, v_y, u_x, u_y, v_max, u_max, dt)
    assert norm(a_x, a_y) <= u_max * ONE
    assert norm(w_x, w_y) <= v_max * ONE
    assert norm(q_x - p_x, q_y - p_y) <= 0.5 * (norm(v_x, v_y) + v_max) * dt * ONE + 1e-12
    assert all(map(math.isfinite, (q_x, q_y, w_x, w_y, a_x, a_y)))


def test_bounds_are_on_the_norm_and_not_on_each_axis() -> None:
    _, _, w_x, w_y, a_x, a_y = step_vehicle(0.0, 0.0, 0.0, 0.0, 3.0, 4.0, 10.0, 1.0, 1.0)
    assert (a_x, a_y) == pytest.approx((0.6, 0.8), rel=1e-15)
    _, _, w_x, w_y, _, _ = step_vehicle(0.0, 0.0, 0.0, 0.0, 3.0, 4.0, 1.0, 10.0, 1.0)
    assert (w_x, w_y) == pytest.approx((0.6, 0.8), rel=1e-15)


@given(numbers, numbers, bounds)
@settings(PROPERTY)
def test_clipping_shortens_what_is_too_long_and_turns_nothing(x, y, limit):
    c_x, c_y = clip_norm(x, y, limit)
    if norm(x, y) <= limit:
        assert (c_x, c_y) == (x, y)
    else:
        assert norm(c_x, c_y) == pytest.approx(limit, rel=1e-14)
        assert (c_x * norm(x, y), c_y * norm(x, y)) == pytest.approx(
            (x * limit, y * limit), rel=1e-13, abs=1e-250
        )


@given(numbers, numbers, st.floats(0.05, 5.0) | st.just(math.inf), ticks)
@settings(PROPERTY)
def test_braking_stops_on_a_straight_line_without_turning_back(v_x, v_y, u_max, dt):
    state, speeds = (0.0, 0.0, v_x, v_y), [norm(v_x, v_y)]
    needed = 1 if math.isinf(u_max) else math.ceil(speeds[0] / (u_max * dt)) + 1
    for _ in range(min(needed, 2000)):
        *state, _, _ = step_vehicle(
            *state, *brake(state[2], state[3], u_max, dt), math.inf, u_max, dt
        )
        speeds.append(norm(state[2], state[3]))
        assert state[2] * v_x + state[3] * v_y >= -1e-12
    assert all(later <= earlier for earlier, later in pairwise(speeds))
    if needed <= 2000:
        assert speeds[-1] <= 1e-12
        travelled = norm(state[0], state[1])
        wanted = stopping_distance(speeds[0], u_max)
        assert wanted - 1e-9 <= travelled <= wanted + 0.5 * speeds[0] * dt + 1e-9
        assert abs(state[0] * v_y - state[1] * v_x) <= 1e-9 * max(1.0, travelled) * speeds[0]


@given(st.floats(-1.0, 100.0), st.floats(0.01, 10.0) | st.just(math.inf), ticks)
@settings(PROPERTY)
def test_stopping_speed_leaves_room_for_one_more_tick(distance, u_max, dt):
    speed = speed_to_stop_within(distance, u_max, dt)
    assert speed >= 0.0
    assert stopping_distance(speed, u_max) == pytest.approx(0.5 * speed**2 / u_max, rel=1e-12)
    needed = speed * dt + stopping_distance(speed, u_max)
    assert needed == pytest.approx(max(distance, 0.0), rel=1e-9, abs=1e-9)


def test_a_goal_is_reached_nearer_than_the_tolerance() -> None:
    assert goal_reached(1.0, 2.0, 1.03, 2.0, 0.05)
    assert not goal_reached(1.0, 2.0, 1.0, 2.5, 0.5)


def test_walls_stop_a_vehicle_that_flies_against_them() -> None:
    assert within_walls(-0.1, -0.5, 10.0) == (0.0, 0.0)
    assert within_walls(10.2, 0.4, 10.0) == (10.0, 0.0)
    assert within_walls(-0.1, 0.3, 10.0) == (0.0, 0.3)  # it leaves the wall
    assert within_walls(4.0, -0.5, 10.0) == (4.0, -0.5)
    assert within_walls(-3.0, -0.5, math.inf) == (-3.0, -0.5)
