"""Conversion of seconds to ticks, once, at the edge."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.messages.vehicle import Detection
from bus.ticks import NO_TICK, detection_rows, first_tick_from, tick_of, ticks_within

steps = st.sampled_from([1e-4, 0.02, 0.05, 0.1, 1.0 / 3.0, 0.7, 3.0])


@given(st.integers(0, 10**9), steps)
def test_a_time_stamp_is_its_tick_again(tick: int, dt: float) -> None:
    assert tick_of(tick * dt, dt) == tick
    assert ticks_within(tick * dt, dt) == first_tick_from(tick * dt, dt) == tick


@given(st.integers(0, 10**6), st.floats(0.01, 0.99), steps)
def test_a_time_between_two_ticks_is_of_none(tick: int, share: float, dt: float) -> None:
    time = (tick + share) * dt
    assert tick_of(time, dt) == NO_TICK
    assert ticks_within(time, dt) == first_tick_from(time, dt) - 1 == tick


@pytest.mark.parametrize("time", [-0.05, math.nan, math.inf, -math.inf, 1e300])
def test_what_is_no_time_of_a_run_is_of_no_tick(time: float) -> None:
    assert tick_of(time, 0.05) == NO_TICK


def test_a_sum_of_ticks_is_forgiven() -> None:
    found = (Detection(time=sum([0.1] * 10), relative_position=(1.0, 2.0)),)
    assert detection_rows(found, 0.1) == ((10, 1.0, 2.0),)
