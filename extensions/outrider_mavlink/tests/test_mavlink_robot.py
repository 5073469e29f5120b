"""A robot with a small vehicle model as the true UAV of a run."""

import math

import numpy as np
import pytest
from along import DECLARED, Along, flown_with, kept, uav_of
from vehicle_model import HOVER, VehicleModel

from bus.messages.decision import NotCertified
from flights import distances
from outrider.running.summary import summarize


def test_the_robot_is_the_true_uav_of_the_run():
    model, seen = VehicleModel(wind=(1.5, -1.0)), []

    def each_tick(_tick):
        north, east = model.position
        seen.append((east - HOVER[1], north - HOVER[0]))

    flight, summary, pilot = flown_with(model, each_tick=each_tick)
    states, reference = (
        array[:-1, uav_of(flight)] for array in (flight.recorder.states, flight.recorder.reference)
    )
    robot = np.array(seen) + reference[0, :2]
    # the velocity bridges one tick; tick 1 has no report yet
    assert np.abs(states[2:, :2] - robot[2:]).max() < 0.003
    assert np.abs(reference[2:, :2] - robot[2:]).max() > 0.05
    uav, ugv = (
        flight.world.position[flight.world.names.index(name)] for name in ("uav_0", "ugv_0")
    )
    assert distances(flight)[-1] == pytest.approx(math.dist(uav, ugv))
    assert summary.largest_tracking_error == pytest.approx(pilot.largest_deviation, abs=0.01)
    assert (summary.tracking_exceeded, pilot.held_ticks, flight.robots.unreported["uav_0"]) == (
        0,
        0,
        2,
    )
    assert kept(summary)
    assert summary.certified_share > 0.95


@pytest.mark.parametrize("declared", [DECLARED, 0.15])
def test_every_excess_of_the_declared_bound_is_counted(declared):
    model = VehicleModel(gust=0.3, seed=1)

    def storm(tick):
        model.wind = (0.0, 8.0) if 100 <= tick < 180 else (0.0, 0.0)

    change = f"certificate.max_tracking_error={declared}"
    flight, summary, pilot = flown_with(model, change, each_tick=storm)
    off = flight.recorder.states[:-1, uav_of(flight), :2]
    off = np.hypot(*(off - flight.recorder.reference[:-1, uav_of(flight), :2]).T)
    assert summary.tracking_exceeded == int((off > declared).sum()) > 20
    assert summary.largest_tracking_error > 0.35
    assert pilot.held_ticks > 20
    assert kept(summary)
    assert flight.recorder.escorts[-2, 0, 6] == 1.0  # certified again


def test_silence_is_counted_until_the_autopilot_is_back():
    silent = range(100, 160)
    flight, summary, pilot = flown_with(
        VehicleModel(gust=0.5), reports=lambda tick: tick not in silent
    )
    unreported = flight.robots.unreported["uav_0"]
    assert unreported == pytest.approx(2 + 60 - 20, abs=1)
    assert summary.uncertified[NotCertified.NO_ROBOT_STATE] == unreported
    assert pilot.held_ticks == pytest.approx(60 - 20, abs=1)
    certified = flight.recorder.escorts[:-1, 0, 6]
    assert not (certified[124:160] == 1.0).any()
    assert certified[-1] == 1.0
    assert kept(summary)


def test_a_flight_goes_on_after_a_restart_of_the_autopilot():
    along = Along(model=VehicleModel())

    def each_tick(tick):
        if tick == 160:
            along.autopilot.boot = 0

    flight = along.fly(each_tick, reports=lambda tick: not 100 <= tick < 160)
    along.close()
    assert along.pilot.held_ticks > 0
    assert flight.recorder.escorts[-2, 0, 6] == 1.0
    assert summarize(flight, seconds=1.0).largest_tracking_error < DECLARED


def test_a_minute_in_wind_keeps_the_declared_bound():
    model = VehicleModel(wind=(1.5, 1.3), gust=0.5)
    _, summary, pilot = flown_with(model, duration=60.0)
    assert 0.05 < summary.largest_tracking_error < DECLARED
    assert (summary.tracking_exceeded, summary.visibility_violations, pilot.held_ticks) == (0, 0, 0)
    assert summary.certified_share > 0.99
    assert kept(summary)
