"""The world: one trajectory per seed, time without summation, walls, detections, and any number of vehicles."""

import math

import numpy as np
import pytest

import reference_field as reference
from bus.messages.scenario import Area, Region, Sensor
from bus.registry import SENSORS
from flights import DESIRED, DT, HERE, R_O, R_V, U_A, U_G, V_A, V_G, R, escort, tracks
from outrider.running.flying import fly
from sim.scenario.loading import load_scenario
from sim.scenario.types import Coverage, Detections, Scenario, Uav, Ugv
from sim.server.flight import Flight
from sim.world import World

MOVING = Ugv(position=HERE, goals=((25.0, 20.0), (25.0, 26.0)))


def _noisy(seed_of_file: int = 0, **fields: float) -> Scenario:
    noise = Detections(noise=0.1, dropout=0.1)
    fields = {"seed": seed_of_file, "duration": 20.0, **fields}
    return escort("logarithmic", ugv=MOVING, detections=noise, **fields)


def test_seeds_determine_the_bits_of_a_flight() -> None:
    first, again, other = (fly(_noisy(), seed)[0] for seed in (4, 4, 5))
    assert first.recorder.states[:-1].tobytes() == again.recorder.states[:-1].tobytes()
    assert first.recorder.escorts.tobytes() == again.recorder.escorts.tobytes()
    assert first.world.coverage.tobytes() == again.world.coverage.tobytes()
    assert first.recorder.sha256() == again.recorder.sha256() != other.recorder.sha256()


def test_the_seed_that_counts_is_the_runs_and_not_the_files() -> None:
    one, other = (fly(_noisy(seed_of_file=seed), 4)[1].trajectory_sha256 for seed in (1, 2))
    assert one == other


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.3])
def test_time_is_the_tick_times_the_length_of_a_tick(dt: float) -> None:
    flight = Flight(escort(dt=dt), 0)
    summed, differs = 0.0, False
    for tick in range(100):
        assert flight.world.time == tick * dt
        assert {seen.time for seen in flight.observations().values()} == {tick * dt}
        differs = differs or summed != tick * dt
        flight.apply({})
        summed += dt
    assert differs  # a sum would differ


def test_vehicle_stops_at_a_wall_and_can_leave() -> None:
    area = Area(width=10.0, height=8.0, cell=0.5)
    uav, ugv = Uav(position=(9.9, 4.0), velocity=(0.5, 0.1)), Ugv(position=(0.1, 7.9))
    world = World(escort(uav=uav, ugv=ugv, area=area), 0)
    uav, ugv = world.names.index("uav_0"), world.names.index("ugv_0")
    for _ in range(40):
        push = np.zeros((2, 2))
        push[ugv] = -0.1, 0.1
        world.step(push)
        assert (world.position >= 0.0).all()
        assert (world.position <= (10.0, 8.0)).all()
    assert world.position[uav, 0] == 10.0
    assert world.velocity[uav].tolist() == [0.0, 0.1]
    assert world.position[uav, 1] == pytest.approx(4.0 + 40 * DT * 0.1, rel=1e-12)
    assert world.position[ugv].tolist() == [0.0, 8.0]
    assert np.abs(world.velocity[ugv]).max() == 0.0
    away = np.zeros((2, 2))
    away[uav], away[ugv] = (-0.3, 0.0), (0.05, -0.05)
    world.step(away)
    assert world.position[uav, 0] < 10.0
    assert world.position[ugv, 0] > 0.0
    assert world.position[ugv, 1] < 8.0


def test_commands_are_bounded_by_the_world() -> None:
    world = World(escort(), 0)
    for _ in range(100):
        world.step(np.array([[3.0, -4.0], [-3.0, 4.0]]))
        for row, (v_max, u_max) in enumerate(((V_A, U_A), (V_G, U_G))):
            assert np.hypot(*world.acceleration[row]) == pytest.approx(u_max, rel=1e-14)
            assert np.hypot(*world.velocity[row]) <= v_max * (1.0 + 1e-15)
    assert np.hypot(*world.velocity.T) == pytest.approx([V_A, V_G], rel=1e-14)


@pytest.mark.parametrize(("rate", "period"), [(20.0, 1), (4.0, 5), (1.0, 20)])
def test_detections_come_at_their_period_and_at_no_other_tick(rate: float, period: int) -> None:
    scenario = escort(
        "tracking", ugv=MOVING, detections=Detections(rate=rate, noise=0.05), duration=20.0
    )
    detected = ~np.isnan(fly(scenario, 0)[0].recorder.escorts[:, 0, 2])
    assert np.flatnonzero(detected).tolist() == list(range(0, len(detected), period))


def test_noise_and_dropouts_in_flight_are_those_of_the_scenario() -> None:
    sigma, cut, dropout = 0.2, 2.0, 0.25
    noise = Detections(noise=sigma, truncation=cut, dropout=dropout)
    flight, _ = fly(escort("logarithmic", ugv=MOVING, detections=noise, duration=200.0), 2)
    uav, ugv = tracks(flight)
    errors = flight.recorder.escorts[:, 0, 2:4] - (uav[:, :2] - ugv[:, :2])
    found = ~np.isnan(errors[:, 0])
    assert flight.recorder.escorts[:, 0, 0].max() < R_V
    assert found.mean() == pytest.approx(
        1.0 - dropout, abs=4.0 * math.sqrt(dropout * (1.0 - dropout) / len(found))
    )
    assert np.hypot(*errors[found].T).max() <= cut * sigma + 1e-13
    h = 0.5 * cut * cut
    variance = sigma**2 * (1.0 - h / math.expm1(h))
    assert errors[found].var(axis=0) == pytest.approx(
        [variance, variance], rel=4.0 * math.sqrt(2.0 / found.sum())
    )


def test_ugv_is_detected_always_within_r_v_and_never_beyond_r():
    """Coverage alone drifts away from its UGV."""
    covered = Coverage(covered=(Region(lower=(0.0, 0.0), upper=(40.0, 24.0)),))
    ugv = Ugv(position=HERE, goals=((20.0, 2.0),))
    flight, _ = fly(escort("coverage", ugv=ugv, coverage=covered, duration=60.0), 0)
    escorts = flight.recorder.escorts[:, 0]
    distance, detected = escorts[:, 0], ~np.isnan(escorts[:, 2])
    assert detected[distance < R_V].all()
    assert not detected[distance >= R].any()
    between = (distance >= R_V) & (distance < R)
    assert 0 < detected[between].sum() < between.sum()
    assert (distance >= R).sum() > 100


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_map_is_what_was_seen_along_the_track(sensor: str) -> None:
    scenario = escort("logarithmic", ugv=MOVING, sensor=Sensor(model=sensor), duration=5.0)
    flight, _ = fly(scenario, 0)
    wanted = np.zeros((160, 160))
    for x, y in tracks(flight)[0][1:, :2].tolist():
        wanted = reference.accumulate(wanted, x, y, tuple(SENSORS).index(sensor), 1.0, R, 0.25, DT)
    np.testing.assert_allclose(flight.world.coverage, wanted, rtol=1e-11, atol=1e-13)


def test_distance_and_error_are_measured_with_the_true_positions() -> None:
    flight, _ = fly(_noisy(duration=5.0), 0)
    uav, ugv = (track[-1, :2].tolist() for track in tracks(flight))
    distance, error = flight.recorder.escorts[-1, 0, :2]
    assert distance == pytest.approx(math.dist(uav, ugv), rel=1e-14)
    assert error == pytest.approx(
        reference.coverage_error(flight.world.coverage, *ugv, R_O, DESIRED, 0.25), rel=1e-11
    )


def test_initially_covered_ground_is_known_to_world_and_uav() -> None:
    region = Region(lower=(0.0, 0.0), upper=(40.0, 40.0))
    _, summary = fly(escort("coverage", coverage=Coverage(covered=(region,)), duration=5.0), 0)
    assert summary.initial_error == 0.0
    assert summary.max_distance == 0.0  # nothing to cover, nowhere to drive


def _two_pairs() -> Scenario:
    return Scenario(
        uav=(
            Uav(name="uav_0", escorts="ugv_1", position=(30.0, 30.0)),
            Uav(name="uav_1", escorts="ugv_0", position=(10.0, 10.0)),
        ),
        ugv=(
            Ugv(name="ugv_1", position=(30.0, 29.0), goals=((30.0, 20.0),)),
            Ugv(name="ugv_0", position=(10.0, 11.0), goals=((20.0, 11.0),)),
        ),
        detections=Detections(noise=0.1),
        duration=40.0,
    )


def test_two_pairs_fly_each_uav_with_the_ugv_it_escorts() -> None:
    flight, summary = fly(_two_pairs(), 0)
    assert flight.world.names == ("uav_0", "uav_1", "ugv_0", "ugv_1")
    assert flight.world.escorts.tolist() == [[0, 3], [1, 2]]
    assert summary.visibility_violations == 0
    states = flight.recorder.states
    for row, (a, g) in enumerate(((0, 3), (1, 2))):
        distance = np.hypot(*(states[:, a, :2] - states[:, g, :2]).T)
        np.testing.assert_allclose(flight.recorder.escorts[:, row, 0], distance, rtol=1e-13)
        assert 1.0 < distance.max() < R_V
    # V_G t - V_G²/(2 U_G)
    np.testing.assert_allclose(states[-1, 2:, :2], [(17.8, 11.0), (30.0, 21.2)], atol=1e-6)


def test_one_map_holds_what_all_uavs_have_seen() -> None:
    flight, _ = fly(_two_pairs(), 0)
    for p in flight.recorder.states[-1, :2, :2]:
        assert flight.world.coverage[int(p[1] / 0.25), int(p[0] / 0.25)] > 0.0


def test_two_uavs_draw_noise_of_their_own() -> None:
    flight, _ = fly(_two_pairs(), 0)
    states, escorts = flight.recorder.states, flight.recorder.escorts
    noise = [
        escorts[:, k, 2:4] - (states[:, a, :2] - states[:, g, :2])
        for k, (a, g) in enumerate(((0, 3), (1, 2)))
    ]
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.1


def test_vehicles_brake_when_their_commands_stop() -> None:
    """The last command stays in effect for `command_timeout`; then both vehicles come to rest."""
    scenario = load_scenario("escort", overrides=["links.commands.delay=0"])
    world, held = World(scenario, 1), round(scenario.command_timeout / scenario.dt)
    for _ in range(20):
        for vehicle in range(2):
            world.send(vehicle, world.tick, (0.05, 0.0))
        world.advance()
    for _ in range(held):
        world.advance()
        assert (world.commands[:, 0] == 0.05).all()
    for _ in range(100):
        world.advance()
    assert (world.velocity == 0.0).all()
