"""The border of Q: the coverage law never crosses it, wherever the UGV stands."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.control.coverage import border_distance, coverage_control, keep_off_border
from bus.messages.scenario import Area, Law
from flights import DT, R_V, U_A, V_A, escort, tracks
from outrider.running.flying import fly
from properties import PROPERTY
from sim.models.vehicles import State, norm, step_vehicle
from sim.scenario.types import Detections
from sim.scenario.vehicle_types import Uav, Ugv

WIDTH, HEIGHT = 16.0, 12.0
AREA = Area(width=WIDTH, height=HEIGHT, cell=0.5)
MARGIN = border_distance(V_A, U_A, DT)
UNBOUNDED = {"max_speed": math.inf, "max_acceleration": math.inf}
speeds = st.floats(-V_A, V_A)


def test_safety_distance_exceeds_the_papers_by_two_ticks_at_most() -> None:
    assert V_A**2 / (2.0 * U_A) + V_A * DT <= MARGIN <= V_A**2 / (2.0 * U_A) + 2.0 * V_A * DT
    assert border_distance(V_A, math.inf, DT) <= 2.0 * V_A * DT


def _kept(u, p, v):
    return keep_off_border(*u, State(*p, *v), 10.0, WIDTH, HEIGHT, MARGIN, DT)


inside = st.tuples(st.floats(MARGIN, WIDTH - MARGIN), st.floats(MARGIN, HEIGHT - MARGIN))


@given(inside, st.floats(-9.0, 9.0), speeds, speeds)
@settings(PROPERTY)
def test_law_is_unchanged_away_from_the_border(p, u, v_x, v_y):
    assert _kept((u, -u), p, (v_x, v_y)) == (u, -u)


@given(st.floats(0.0, 1.0), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), speeds, speeds)
@settings(PROPERTY, max_examples=300)
def test_law_never_points_outward_at_a_side(depth, u_x, u_y, v_x, v_y):
    """Check the side x = 0, and the opposite one by reflection."""
    p = (0.999 * depth * MARGIN, 0.5 * HEIGHT)
    a_x, a_y = _kept((u_x, u_y), p, (v_x, v_y))
    if v_x < 0.0:
        assert (a_x, a_y) == (-v_x / DT, 0.0)
    else:
        assert a_x == (-10.0 * v_x if u_x + 10.0 * v_x < 0.0 else u_x)
        assert a_y == u_y
    mirrored = _kept((-u_x, u_y), (WIDTH - p[0], p[1]), (-v_x, v_y))
    assert mirrored == pytest.approx((-a_x, a_y), abs=1e-12)


@given(st.integers(0, 2**32), st.floats(0.0, math.tau), st.sampled_from((1.0, 10.0, 39.0)))
@settings(PROPERTY, max_examples=150)
def test_no_command_crosses_the_border(seed, course, k_v):
    """Start at full speed anywhere outside the margin, with a new, mostly outward command every few ticks."""
    rng = np.random.default_rng(seed)
    start = (rng.uniform(MARGIN, WIDTH - MARGIN), rng.uniform(MARGIN, HEIGHT - MARGIN))
    state, direction = (*start, V_A * math.cos(course), V_A * math.sin(course)), course
    for _ in range(600):
        if rng.random() < 0.1:
            direction = rng.normal(course, 1.0)
        w_x, w_y = V_A * math.cos(direction), V_A * math.sin(direction)
        u = coverage_control(w_x - state[2], w_y - state[3], k_v)
        u = keep_off_border(*u, State(*state), k_v, WIDTH, HEIGHT, MARGIN, DT)
        *state, _, _ = step_vehicle(*state, *u, V_A, U_A, DT)
        assert 0.0 < state[0] < WIDTH
        assert 0.0 < state[1] < HEIGHT


edges = [st.sampled_from((0.0, 0.3, size - 0.3, size)) for size in (WIDTH, HEIGHT)]
anywhere = [st.floats(0.0, size) for size in (WIDTH, HEIGHT)]
places = st.tuples(*edges) | st.tuples(edges[0], anywhere[1]) | st.tuples(anywhere[0], edges[1])


def _between(share: float, center: float, stopping: float, size: float) -> float:
    """Return a coordinate in sight of the UGV's, with room to stop inside the area."""
    least, most = (
        max(center - 0.7 * R_V, 0.0, -stopping),
        min(center + 0.7 * R_V, size, size - stopping),
    )
    return least + share * (most - least)


@given(
    places,
    st.tuples(st.floats(0.01, 0.99), st.floats(0.01, 0.99)),
    st.floats(0.0, V_A) | st.just(V_A),
    st.floats(0.0, math.tau),
    st.sampled_from((1.0, 10.0, 20.0, 30.0)),
    st.lists(places, max_size=2),
    st.sampled_from(({}, {"max_acceleration": 50.0}, UNBOUNDED)),
)
@settings(PROPERTY, max_examples=25)
def test_the_coverage_law_never_reaches_the_border(ugv, share, speed, course, k_v, goals, limits):
    velocity = (speed * math.cos(course), speed * math.sin(course))
    stop = speed / (2.0 * U_A) + 2.0 * DT  # a UAV that could not stop in time is excluded
    start = tuple(
        _between(share[k], ugv[k], stop * velocity[k], size)
        for k, size in enumerate((WIDTH, HEIGHT))
    )
    assert norm(start[0] - ugv[0], start[1] - ugv[1]) < R_V
    scenario = escort(
        Law(name="coverage", parameters={"speed_gain": k_v, "reference_speed": V_A}),
        uav=Uav(position=start, velocity=velocity, **limits),
        ugv=Ugv(position=ugv, goals=tuple(goals)),
        area=AREA,
        detections=Detections(rate=20.0),
        duration=45.0,
    )
    uav, _ = tracks(fly(scenario, 0)[0])
    assert (uav[:, :2] > 0.0).all()  # the walls hold a vehicle at 0, so it never touched them
    assert (uav[:, :2] < (WIDTH, HEIGHT)).all()


@pytest.mark.parametrize("ugv", [(0.0, 0.0), (16.0, 6.0), (15.7, 11.7)])
def test_ground_at_the_border_is_covered_too(ugv: tuple[float, float]) -> None:
    """Check Proposition 1 in a corner and at a side."""
    start = (min(max(ugv[0], 1.0), WIDTH - 1.0), min(max(ugv[1], 1.0), HEIGHT - 1.0))
    vehicles = {"uav": Uav(position=start), "ugv": Ugv(position=ugv)}
    _, summary = fly(escort("coverage", **vehicles, area=AREA, duration=200.0), 0)
    assert summary.initial_error > summary.final_error == 0.0
