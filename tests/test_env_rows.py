"""Arrays of the environment: each entry as documented, and nothing that a vehicle must not know."""

import math

import msgspec
import numpy as np
import pytest

from agents.drivers.policy import UgvRows
from bus.messages.scenario import Region
from bus.messages.vehicle import UgvObservation
from bus.observations import UAV, UGV, by_name
from flights import DESIRED, R_O, R, escort, pairs
from outrider.envs.parallel import parallel_env
from row_messages import uav_observation, ugv_observation
from sim.models.field import coverage_gradient
from sim.models.sensor import SensorParameters
from sim.scenario.types import Coverage, Detections, Wind
from sim.scenario.vehicle_types import Uav, Ugv
from sim.server.flight import Flight
from sim.world import World
from worlds import BLURRED, FAST

GOALS = ((14.0, 10.0), (14.0, 16.0))


def scenario(*, uav=(12.0, 10.0), ugv=(10.0, 10.0), goals=GOALS, velocity=(0.0, 0.0), **detections):
    driven = Ugv(position=ugv, goals=goals, velocity=velocity)
    seen = Detections(**detections)
    return escort(uav=Uav(position=uav), ugv=driven, detections=seen, duration=60.0)


def drive(env, uav, ugv, ticks):
    """Return rows and infos of both vehicles at each tick, under constant actions."""
    observations, infos = env.reset(seed=1)
    rows = [(observations, infos)]
    for _ in range(ticks):
        observations, _, _, _, infos = env.step({"uav_0": uav, "ugv_0": ugv})
        rows.append((observations, infos))
    return rows


def test_rows_hold_what_the_vehicles_perceive_over_the_bus():
    """Compare the messages and the rows of the same world."""
    wind = Wind(mean=(0.05, 0.02), gust=0.03)
    observed = msgspec.structs.replace(scenario(noise=0.1, dropout=0.3, rate=10.0), wind=wind)
    env, flight = parallel_env(observed), Flight(observed, 3)
    rows, _ = env.reset(seed=3)
    seen = set()
    for tick in range(200):
        messages = flight.observations()
        assert uav_observation(rows["uav_0"], dt=observed.dt) == messages["uav_0"]
        assert ugv_observation(rows["ugv_0"], dt=observed.dt) == messages["ugv_0"]
        seen.add(bool(messages["uav_0"].detections))
        action = np.array([0.1 * math.cos(tick), 0.1])
        rows, *_ = env.step({"uav_0": action, "ugv_0": action})
        flight.world.step(np.array([action, action]))
    assert seen == {False, True}


def test_age_counts_from_the_newest_detection():
    env = parallel_env(scenario(rate=4.0))
    ages = [by_name(UAV, rows["uav_0"])["age"] for rows, _ in drive(env, [0.0, 0.0], [0.0, 0.0], 7)]
    np.testing.assert_allclose(ages, [0.0, 0.05, 0.1, 0.15, 0.2, 0.0, 0.05, 0.1], atol=1e-12)
    blind = parallel_env(scenario(dropout=1.0))
    for rows, _ in drive(blind, [0.0, 0.0], [0.0, 0.0], 3):
        assert rows["uav_0"][5:].tolist() == [0.0, 0.0, 0.0, 60.0]


def test_ugv_row_turns_to_the_next_goal_and_keeps_the_last():
    env = parallel_env(scenario(goals=((10.02, 10.0), (10.3, 10.0))), end_on_sight_lost=False)
    rows = [by_name(UGV, rows["ugv_0"]) for rows, _ in drive(env, [0.0, 0.0], [0.1, 0.0], 60)]
    # the first goal is within the tolerance
    assert (rows[0]["goal_x"], rows[0]["underway"]) == (10.3, 1.0)
    arrived = next(k for k, row in enumerate(rows) if not row["underway"])
    assert abs(rows[arrived]["x"] - 10.3) < 0.05 <= abs(rows[arrived - 1]["x"] - 10.3)
    assert [rows[-1][name] for name in ("goal_x", "goal_y", "underway")] == [10.3, 10.0, 0.0]


def test_ugv_without_goals_has_zeros():
    env = parallel_env(scenario(goals=()))
    assert env.reset()[0]["ugv_0"][5:].tolist() == [0.0, 0.0, 0.0]


def test_rows_bound_a_detection_that_itself_is_not_bounded():
    env = parallel_env(BLURRED, duration=2.0, end_on_sight_lost=False)
    rows, _ = env.reset(seed=1)
    largest, beyond = env.observation_space("uav_0").high[6], 0
    while env.agents:
        for one in env.world.received(0):
            bounded = np.clip(one.relative_position, -largest, largest)
            np.testing.assert_array_equal(rows["uav_0"][6:8], bounded)
            beyond += int(np.abs(one.relative_position).max() > largest)
        rows, *_ = env.step(dict.fromkeys(env.agents, np.zeros(2)))
    assert beyond > 0


def test_a_ugvs_policy_over_the_bus_has_the_same_bounds():
    env = parallel_env(FAST, duration=1.0, end_on_sight_lost=False)
    env.reset(seed=1)
    rows, *_ = env.step(dict.fromkeys(env.agents, np.array([1e6, 1e6])))
    state = env.world.position[1], env.world.velocity[1]
    position, velocity = (tuple(one.tolist()) for one in state)
    observation = UgvObservation(tick=1, time=0.05, position=position, velocity=velocity)
    row = UgvRows(env.briefing("ugv_0")).row(observation)
    np.testing.assert_array_equal(row, rows["ugv_0"])


def test_gradient_points_from_the_estimate_to_new_ground():
    env = parallel_env(scenario(noise=0.1), estimate=True, gradient=True)
    env.reset(seed=1)
    for _ in range(40):
        rows, *_ = env.step({"uav_0": [0.1, 0.2], "ugv_0": [0.1, 0.0]})
        x, y, p_delta_x, p_delta_y = rows["uav_0"][[1, 2, 6, 7]].tolist()
        places, sensor = (x, y, x - p_delta_x, y - p_delta_y), SensorParameters(0, 1.0, R)
        u_x, u_y, size = coverage_gradient(env.world.coverage, *places, R_O, DESIRED, sensor, 0.25)
        assert rows["uav_0"][9:] == pytest.approx((u_x / size, u_y / size), abs=1e-12)
    assert np.hypot(*rows["uav_0"][9:]) > 0.01


# -- the information contract


def test_uav_perceives_nothing_of_the_ugv_but_its_detections():
    """Change velocity, goals and actions of an undetected UGV: no bit of the UAV's row changes."""
    options = {"end_on_sight_lost": False, "coverage_patch": (9, 1.0)}
    moving = {"ugv": (11.0, 9.0), "velocity": (0.2, 0.0), "goals": ((20.0, 20.0),)}
    still, fast = (
        drive(parallel_env(scenario(dropout=1.0, **fields), **options), [0.1, 0.0], ugv, 100)
        for fields, ugv in (({}, [0.0, 0.0]), (moving, [0.1, 0.05]))
    )
    for (a, info), (b, other) in zip(still, fast, strict=True):
        assert a["uav_0"]["row"].tobytes() == b["uav_0"]["row"].tobytes()
        assert a["uav_0"]["coverage"].tobytes() == b["uav_0"]["coverage"].tobytes()
        assert info["uav_0"] == other["uav_0"] == {}


def test_uav_sees_the_position_of_a_detected_ugv_alone():
    slow = parallel_env(scenario(noise=0.1)).reset(seed=1)[0]["uav_0"]
    moving = scenario(noise=0.1, velocity=(0.1, 0.1), goals=((1.0, 1.0),))
    fast = parallel_env(moving).reset(seed=1)[0]["uav_0"]
    assert by_name(UAV, slow)["detected"]
    assert slow.tobytes() == fast.tobytes()


def test_ugv_perceives_nothing_of_the_uav():
    near, away = (
        drive(parallel_env(scenario(uav=place), end_on_sight_lost=False), uav, [0.1, 0.0], 100)
        for place, uav in (((12.0, 10.0), [0.1, 0.3]), ((8.0, 13.0), [-0.3, 0.0]))
    )
    for (a, info), (b, other) in zip(near, away, strict=True):
        assert a["ugv_0"].tobytes() == b["ugv_0"].tobytes()
        assert info["ugv_0"] == other["ugv_0"]
        assert info["ugv_0"].keys() == {"goals_reached"}


def test_with_noise_the_true_relative_position_is_in_no_row():
    env = parallel_env(scenario(noise=0.2, uav=(12.123, 10.456)))
    rows, _ = env.reset(seed=1)
    for _ in range(50):
        p_delta = env.world.position[0] - env.world.position[1]
        assert np.abs(rows["uav_0"][:, np.newaxis] - p_delta).min() > 1e-9
        rows, *_ = env.step({"uav_0": [0.05, 0.01], "ugv_0": [0.05, 0.03]})


# -- the coverage patch


def brute_patch(coverage, x, y, desired, cell, pixels, scale):
    picture = np.ones((pixels, pixels))
    for j in range(pixels):
        for i in range(pixels):
            q_x = x + (i - (pixels - 1) / 2) * scale
            q_y = y + (j - (pixels - 1) / 2) * scale
            column, row = math.floor(q_x / cell), math.floor(q_y / cell)
            if 0 <= row < coverage.shape[0] and 0 <= column < coverage.shape[1]:
                picture[j, i] = min(1.0, coverage[row, column] / desired)
    return picture


@pytest.mark.parametrize(("pixels", "scale"), [(1, 1.0), (8, 0.25), (9, 1.7), (32, 0.5)])
def test_coverage_patch_is_covered_outside_the_area(pixels, scale):
    env = parallel_env(scenario(uav=(1.0, 2.0), ugv=(2.0, 2.0)), coverage_patch=(pixels, scale))
    env.reset(seed=0)
    for _ in range(40):
        rows, *_ = env.step({"uav_0": [0.3, 0.1], "ugv_0": [0.0, 0.0]})
    x, y = env.world.position[0]
    expected = brute_patch(env.world.coverage, x, y, 2.0, 0.25, pixels, scale)
    np.testing.assert_allclose(rows["uav_0"]["coverage"], expected, rtol=1e-15)


def test_of_several_uavs_each_sees_its_own_map_alone():
    """The map contains nothing that the other UAV has covered; ground covered at the start is in both."""
    region = Region(lower=(0.0, 0.0), upper=(8.0, 40.0))
    uavs = [{"position": (x, 10.0), "escorts": "ugv_0"} for x in (12.0, 14.0)]
    two = pairs(uavs, ((12.0, 12.0),), coverage=Coverage(covered=(region,)))
    envs = [parallel_env(two, coverage_patch=(21, 1.0), end_on_sight_lost=False) for _ in range(2)]
    alone = World(msgspec.structs.replace(two, uav=two.uav[:1]), 0)
    for env in envs:
        env.reset(seed=0)
    for _ in range(60):
        rows = [
            env.step({"uav_0": [0.1, 0.1], "uav_1": other, "ugv_0": [0.0, 0.0]})[0]
            for env, other in zip(envs, ([0.3, 0.0], [-0.3, 0.0]), strict=True)
        ]
        alone.step(np.array([[0.1, 0.1], [0.0, 0.0]]))
    assert rows[0]["uav_0"]["coverage"].tobytes() == rows[1]["uav_0"]["coverage"].tobytes()
    x, y = alone.position[0]
    wanted = brute_patch(alone.coverage, x, y, 2.0, 0.25, 21, 1.0)
    np.testing.assert_array_equal(rows[0]["uav_0"]["coverage"], wanted)
    assert (envs[0].world.coverage > alone.coverage + 0.1).any()


# -- the state


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_state_is_the_whole_truth_under_its_names(dtype):
    env = parallel_env(scenario(noise=0.1, rate=4.0), dtype=dtype)
    drive(env, [0.1, 0.2], [0.1, 0.0], 33)
    world, state = env.world, env.state()
    distance, error = world.measure()[0]
    truth = {
        "time": 1.65,
        "covered": (world.coverage >= 2.0).mean(),
        "seen": np.minimum(world.coverage / 2.0, 1.0).mean(),
        **dict(zip(("uav_0.x", "uav_0.y"), world.position[0], strict=True)),
        **dict(zip(("uav_0.vx", "uav_0.vy"), world.velocity[0], strict=True)),
        "uav_0.distance": distance,
        "uav_0.coverage_error": error,
        "uav_0.age": 3 * 0.05,
        **dict(zip(("ugv_0.x", "ugv_0.y"), world.position[1], strict=True)),
        **dict(zip(("ugv_0.vx", "ugv_0.vy"), world.velocity[1], strict=True)),
        "ugv_0.underway": 1.0,
        "ugv_0.goal_x": 14.0,
        "ugv_0.goal_y": 10.0,
    }
    assert list(truth) == env.state_names
    assert state.dtype == dtype
    assert distance > 1.0
    rtol = 1e-12 if dtype is np.float64 else 1e-6
    np.testing.assert_allclose(state, list(truth.values()), rtol=rtol)
