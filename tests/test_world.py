"""The world: one trajectory per seed, time without summation, walls, detections, and any number of vehicles."""

import math

import msgspec
import numpy as np
import pytest

import reference_field as reference
from bus.messages.scenario import Area, Region, Sensor
from bus.registry import SENSORS
from flights import DESIRED, DT, HERE, R_O, R_V, U_A, U_G, V_A, V_G, R, escort, pairs, tracks
from outrider.running.flying import fly
from seeded import a_key
from sim.engine.run_keys import derive_keys
from sim.models.detection import detect
from sim.models.randomness import DETECTION_CHANCE, DETECTION_NOISE
from sim.scenario.loading import load_scenario
from sim.scenario.types import Coverage, Detections, Scenario
from sim.scenario.vehicle_types import Uav, Ugv
from sim.server.flight import Flight
from sim.world import World

MOVING = Ugv(position=HERE, goals=((25.0, 20.0), (25.0, 26.0)))


def _noisy(seed_of_file: int = 0, **fields: float) -> Scenario:
    noise = Detections(noise=0.1, dropout=0.1)
    fields = {"seed": seed_of_file, "duration": 20.0, **fields}
    return escort("logarithmic", ugv=MOVING, detections=noise, **fields)


def test_seed_of_the_run_alone_determines_its_bits() -> None:
    first, again, other = (
        fly(_noisy(of_file), seed)[0] for of_file, seed in ((1, 4), (2, 4), (1, 5))
    )
    assert first.recorder.states[:-1].tobytes() == again.recorder.states[:-1].tobytes()
    assert first.recorder.escorts.tobytes() == again.recorder.escorts.tobytes()
    assert first.world.coverage.tobytes() == again.world.coverage.tobytes()
    assert first.recorder.sha256() == again.recorder.sha256() != other.recorder.sha256()


@pytest.mark.parametrize("dt", [0.05, 0.3])
def test_time_is_the_tick_times_the_length_of_a_tick(dt: float) -> None:
    """A sum of the lengths would differ by rounding."""
    flight = Flight(escort(dt=dt), 0)
    for tick in range(100):
        assert flight.world.time == tick * dt
        assert {seen.time for seen in flight.observations().values()} == {tick * dt}
        flight.apply({})


def test_vehicle_stops_at_a_wall_and_can_leave() -> None:
    area = Area(width=10.0, height=8.0, cell=0.5)
    uav, ugv = Uav(position=(9.9, 4.0), velocity=(0.5, 0.1)), Ugv(position=(0.1, 7.9))
    world = World(escort(uav=uav, ugv=ugv, area=area), 0)
    for _ in range(40):
        world.step(np.array([[0.0, 0.0], [-0.1, 0.1]]))
        assert (world.position >= 0.0).all()
        assert (world.position <= (10.0, 8.0)).all()
    assert world.position[0, 0] == 10.0
    assert world.position[0, 1] == pytest.approx(4.0 + 40 * DT * 0.1, rel=1e-12)
    assert world.position[1].tolist() == [0.0, 8.0]
    assert world.velocity.tolist() == [[0.0, 0.1], [0.0, 0.0]]
    world.step(np.array([[-0.3, 0.0], [0.05, -0.05]]))
    assert world.position[0, 0] < 10.0
    assert world.position[1, 0] > 0.0
    assert world.position[1, 1] < 8.0


def test_commands_are_bounded_by_the_world() -> None:
    world = World(escort(), 0)
    for _ in range(100):
        world.step(np.array([[3.0, -4.0], [-3.0, 4.0]]))
        for row, (v_max, u_max) in enumerate(((V_A, U_A), (V_G, U_G))):
            assert np.hypot(*world.acceleration[row]) == pytest.approx(u_max, rel=1e-14)
            assert np.hypot(*world.velocity[row]) <= v_max * (1.0 + 1e-15)
    assert np.hypot(*world.velocity.T) == pytest.approx([V_A, V_G], rel=1e-14)


@pytest.mark.parametrize(("rate", "period"), [(20.0, 1), (4.0, 5)])
def test_detections_of_a_run_are_the_detectors(rate: float, period: int) -> None:
    """Coverage alone drifts away from its UGV: within r_v, between r_v and R, and beyond R."""
    covered = Coverage(covered=(Region(lower=(0.0, 0.0), upper=(40.0, 24.0)),))
    detections = Detections(rate=rate, noise=0.2, truncation=2.0, dropout=0.25)
    ugv = Ugv(position=HERE, goals=((20.0, 2.0),))
    scenario = escort("coverage", ugv=ugv, coverage=covered, detections=detections, duration=60.0)
    flight, _ = fly(scenario, 2)
    uav, ugv = tracks(flight)
    apart, keys = uav[:, :2] - ugv[:, :2], derive_keys((2,), 2)[0, :, 0]
    drawn = [a_key(*keys[purpose]) for purpose in (DETECTION_NOISE, DETECTION_CHANCE)]
    wanted = np.full(apart.shape, np.nan)
    for tick in range(0, len(apart), period):
        wanted[tick] = detect(*apart[tick], R_V, R, 0.25, 0.2, 2.0, *drawn, tick)[1:]
    np.testing.assert_array_equal(flight.recorder.escorts[:, 0, 2:4], wanted)
    distance = np.hypot(*apart.T)
    for low, high in ((0.0, R_V), (R_V, R), (R, math.inf)):
        assert ((distance >= low) & (distance < high)).sum() >= 5


@pytest.mark.parametrize("sensor", SENSORS)
def test_map_distance_and_error_follow_the_true_track(sensor: str) -> None:
    flight, _ = fly(msgspec.structs.replace(_noisy(duration=5.0), sensor=Sensor(model=sensor)), 0)
    wanted = np.zeros((160, 160))
    uav, ugv = (track[:, :2].tolist() for track in tracks(flight))
    for x, y in uav[1:]:
        wanted = reference.accumulate(wanted, x, y, tuple(SENSORS).index(sensor), 1.0, R, 0.25, DT)
    np.testing.assert_allclose(flight.world.coverage, wanted, rtol=1e-11, atol=1e-13)
    distance, error = flight.recorder.escorts[-1, 0, :2]
    assert distance == pytest.approx(math.dist(uav[-1], ugv[-1]), rel=1e-14)
    remaining = reference.coverage_error(wanted, *ugv[-1], R_O, DESIRED, 0.25)
    assert error == pytest.approx(remaining, rel=1e-11)


def test_two_pairs_fly_each_uav_with_the_ugv_it_escorts() -> None:
    uavs = [
        {"position": (30.0, 30.0), "escorts": "ugv_1"},
        {"position": (10.0, 10.0), "escorts": "ugv_0"},
    ]
    ugvs = [
        {"position": (30.0, 29.0), "name": "ugv_1", "goals": ((30.0, 20.0),)},
        {"position": (10.0, 11.0), "name": "ugv_0", "goals": ((20.0, 11.0),)},
    ]
    flight, _ = fly(pairs(uavs, ugvs, detections=Detections(noise=0.1), duration=40.0), 0)
    assert flight.world.names == ("uav_0", "uav_1", "ugv_0", "ugv_1")
    assert flight.world.escorts.tolist() == [[0, 3], [1, 2]]
    states, escorts, noise = flight.recorder.states, flight.recorder.escorts, []
    for row, (a, g) in enumerate(((0, 3), (1, 2))):
        apart = states[:, a, :2] - states[:, g, :2]
        distance = np.hypot(*apart.T)
        np.testing.assert_allclose(escorts[:, row, 0], distance, rtol=1e-13)
        assert 1.0 < distance.max() < R_V
        noise.append((escorts[:, row, 2:4] - apart).ravel())
        column, line = (states[-1, a, :2] / 0.25).astype(int)
        assert flight.world.coverage[line, column] > 0.0  # one map of all UAVs
    assert abs(np.corrcoef(*noise)[0, 1]) < 0.1
    # V_G t - V_G²/(2 U_G)
    np.testing.assert_allclose(states[-1, 2:, :2], [(17.8, 11.0), (30.0, 21.2)], atol=1e-6)


def test_vehicles_brake_when_their_commands_stop() -> None:
    """The last command stays in effect for `command_timeout`; then both vehicles come to rest."""
    scenario = load_scenario("escort", overrides=["links.commands.delay=0"])
    world, ticks = World(scenario, 1), round(scenario.command_timeout / scenario.dt)
    for _ in range(20):
        for vehicle in range(2):
            world.send(vehicle, world.tick, (0.05, 0.0))
        world.advance()
    for _ in range(ticks):
        world.advance()
        assert (world.commands[:, 0] == 0.05).all()
    for _ in range(100):
        world.advance()
    assert (world.velocity == 0.0).all()
