"""Kinematics of UGVs that steer: bounds, turns, and motion along the heading only."""

import math

import numpy as np
import pytest

from sim.models.kinematics import (
    ACKERMANN,
    DIFFERENTIAL,
    POINT,
    REST,
    Kinematics,
    UgvState,
    signed_speed,
    step_ugv,
    ugv_within_walls,
    wrapped,
)
from sim.models.vehicles import norm, step_vehicle

CAR, CART = Kinematics(ACKERMANN, max_curvature=1.5), Kinematics(DIFFERENTIAL, track=0.4)
V, U, DT = 0.8, 0.5, 0.05
KINDS = pytest.mark.parametrize("kinematics", [CAR, CART], ids=["ackermann", "differential"])


def _start(rng: np.random.Generator) -> UgvState:
    heading, speed = rng.uniform(-math.pi, math.pi), rng.choice([0.0, rng.uniform(-V, V)])
    velocity = speed * math.cos(heading), speed * math.sin(heading)
    return UgvState(*rng.uniform(5.0, 15.0, 2).tolist(), *velocity, heading)


def _command(rng: np.random.Generator) -> tuple[float, float]:
    size, angle = rng.choice([1e-8, 0.1, 1.0, 30.0]) * rng.uniform(), rng.uniform(-math.pi, math.pi)
    return size * math.cos(angle), size * math.sin(angle)


@KINDS
def test_every_motion_is_one_of_the_double_integrator(kinematics: Kinematics) -> None:
    """Speed and acceleration keep the bounds, however commands turn, reverse and exceed them."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        state = _start(rng)
        for _ in range(100):
            after = step_ugv(kinematics, state, *_command(rng), (V, U), V, DT)
            change = after.v_x - state.v_x, after.v_y - state.v_y
            assert norm(*change) <= U * DT + 2.0 * REST
            assert norm(after.v_x, after.v_y) <= V * (1.0 + 1e-12)
            assert after.p_x == pytest.approx(state.p_x + 0.5 * DT * (state.v_x + after.v_x))
            assert after.p_y == pytest.approx(state.p_y + 0.5 * DT * (state.v_y + after.v_y))
            # never sideways
            aside = after.v_y * math.cos(after.heading) - after.v_x * math.sin(after.heading)
            assert abs(aside) < 1e-12
            state = after


def test_it_drives_on_with_the_component_along_its_new_heading() -> None:
    rng = np.random.default_rng(3)
    for _ in range(2000):
        state, u = _start(rng), _command(rng)
        after = step_ugv(CAR, state, *u, (V, U), V, DT)
        point = step_vehicle(*state[:4], *u, V, U, DT)
        along = point[2] * math.cos(after.heading) + point[3] * math.sin(after.heading)
        if norm(after.v_x, after.v_y) > REST:
            assert signed_speed(after) == pytest.approx(along, abs=1e-12)


@KINDS
def test_turns_keep_their_limit(kinematics: Kinematics) -> None:
    rng = np.random.default_rng(2)
    largest = 0.0
    for _ in range(300):
        state = _start(rng)
        for _ in range(60):
            after = step_ugv(kinematics, state, *_command(rng), (V, U), V, DT)
            turn = abs(wrapped(after.heading - state.heading))
            ends = abs(signed_speed(state)), abs(signed_speed(after))
            if kinematics.kind == ACKERMANN:
                driven = 0.5 * DT * sum(ends)
                assert turn <= kinematics.max_curvature * driven + 1e-9
                largest = max(largest, turn / driven if driven > 1e-3 else 0.0)
            else:  # the faster wheel
                wheel = max(ends) + 0.5 * kinematics.track * turn / DT
                assert wheel <= V + 1e-9
                largest = max(largest, wheel)
            state = after
    assert largest > 0.95 * (kinematics.max_curvature if kinematics.kind == ACKERMANN else V)


def test_a_differential_drive_turns_in_place_and_a_car_does_not() -> None:
    command = REST * math.cos(0.5), REST * math.sin(0.5)
    for kinematics, expected in ((CART, 0.5), (CAR, 0.0)):
        state = UgvState(1.0, 1.0, 0.0, 0.0, 0.0)
        for _ in range(40):
            state = step_ugv(kinematics, state, *command, (V, U), V, DT)
        assert state[:4] == pytest.approx((1.0, 1.0, 0.0, 0.0), abs=1e-8)
        assert state.heading == pytest.approx(expected, abs=1e-6)


def test_a_car_drives_a_circle_of_its_smallest_radius() -> None:
    """The distance between opposite points of the circle is 2 / κ."""
    state, speed = UgvState(0.0, 0.0, 0.3, 0.0, 0.0), 0.3
    headings, east, north = [0.0], [0.0], [0.0]
    for _ in range(800):
        aim = state.heading + 1.5 * speed * DT
        u = (
            (speed * math.cos(aim) - state.v_x) / DT,
            (speed * math.sin(aim) - state.v_y) / DT,
        )
        state = step_ugv(CAR, state, *u, (V, U), V, DT)
        headings.append(state.heading)
        east.append(state.p_x)
        north.append(state.p_y)
    assert max(east) - min(east) == pytest.approx(2.0 / 1.5, rel=2e-3)
    assert max(north) - min(north) == pytest.approx(2.0 / 1.5, rel=2e-3)


@KINDS
def test_braking_leads_straight_on(kinematics: Kinematics) -> None:
    state = UgvState(1.0, 1.0, -0.3, -0.4, math.atan2(0.4, 0.3))
    for _ in range(40):
        u = -state.v_x / DT, -state.v_y / DT
        after = step_ugv(kinematics, state, *u, (V, U), V, DT)
        expected = step_vehicle(*state[:4], *u, V, U, DT)[:4]
        assert after[:4] == pytest.approx(expected, abs=1e-12)
        assert after.heading == pytest.approx(state.heading, abs=1e-9)
        state = after
    assert norm(state.v_x, state.v_y) <= REST


def test_rough_ground_shortens_the_velocity_and_stuck_ground_keeps_the_heading() -> None:
    state = UgvState(1.0, 1.0, 0.5, 0.0, 0.0)
    after = step_ugv(CAR, state, 0.0, 0.5, (V, U), V, DT)
    slow = step_ugv(CAR, state, 0.0, 0.5, (V, U), 0.2, DT)
    assert (slow.heading, norm(slow.v_x, slow.v_y)) == (after.heading, pytest.approx(0.2))
    assert slow.v_y / slow.v_x == pytest.approx(after.v_y / after.v_x)
    stuck = step_ugv(CAR, state, 0.0, 0.5, (V, U), 0.0, DT)
    assert stuck[2:] == (0.0, 0.0, 0.0)


def test_a_wall_stops_a_vehicle_that_steers_and_only_turns_a_point_aside() -> None:
    state = UgvState(-0.1, 5.0, -0.3, 0.4, 2.2)
    assert ugv_within_walls(CAR, state, 10.0, 10.0) == (0.0, 5.0, 0.0, 0.0, 2.2)
    assert ugv_within_walls(Kinematics(POINT), state, 10.0, 10.0)[:4] == (0.0, 5.0, 0.0, 0.4)
