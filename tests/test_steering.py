"""UGVs that steer: arrival, one flight everywhere, sight, the operator's twist, and the cautious filter."""

import math
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.drivers.cautious import is_safe
from agents.drivers.compiled import CompiledDriver
from agents.drivers.policy import UgvRows
from agents.drivers.teleop import TeleopDriver
from bus.messages.scenario import Limits
from bus.messages.vehicle import Teleoperation, UgvObservation
from flights import flown_in_both, ugv_briefing
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.parallel import parallel_env
from outrider.running.flying import fly
from sim.engine.briefing import uav_briefing
from sim.models.kinematics import (
    Kinematics,
    UgvState,
    kinematics_of,
    signed_speed,
    step_ugv,
    ugv_within_walls,
    wrapped,
)
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from worlds import raw

DIFFERENTIAL = {"kinematics": "differential", "track": 0.5}
CAR = {"kinematics": "ackermann", "max_curvature": 0.8}
KINDS = pytest.mark.parametrize("kind", [DIFFERENTIAL, CAR], ids=["differential", "ackermann"])
V, U, DT = 0.8, 0.5, 0.05


def _steering(name: str, kind: dict[str, Any], *changes: str) -> Scenario:
    fields = [f"ugv.0.{field}={value}" for field, value in kind.items()]
    return load_scenario(name, overrides=[*fields, *changes])


def _briefing(kind: dict[str, Any], **fields: Any) -> Any:
    limits = Limits(max_speed=V, max_acceleration=U)
    return ugv_briefing(dt=DT, limits=limits, goal_tolerance=0.1, **kind, **fields)


def _seen(tick: int, state: UgvState, *operator: Teleoperation) -> UgvObservation:
    return UgvObservation(
        tick=tick,
        time=tick * DT,
        position=state[:2],
        velocity=state[2:4],
        heading=state.heading,
        operator=operator,
    )


def _moved(briefing: Any, state: UgvState, u: tuple[float, float]) -> UgvState:
    kinematics = kinematics_of(briefing)
    after = step_ugv(kinematics, state, *u, (V, U), V, DT)
    return ugv_within_walls(kinematics, after, briefing.area.width, briefing.area.height)


@KINDS
@pytest.mark.parametrize("seed", range(8))
def test_it_reaches_goals_anywhere(kind: dict[str, Any], seed: int) -> None:
    """Goals beside the UGV, behind it and within its smallest circle."""
    rng = np.random.default_rng(seed)
    goals = tuple((float(x), float(y)) for x, y in rng.uniform(3.0, 12.0, (3, 2)))
    goals = (*goals, (goals[-1][0] + 0.3, goals[-1][1] - 0.3))
    briefing = _briefing(kind, goals=goals)
    driver = CompiledDriver(briefing, "waypoints")
    state = UgvState(*rng.uniform(3.0, 12.0, 2).tolist(), 0.0, 0.0, rng.uniform(-3.0, 3.0))
    for tick in range(5000):
        state = _moved(briefing, state, driver.drive(_seen(tick, state)))
        if int(driver.memory["goal"]) == 3 and math.dist(state[:2], goals[-1]) < 0.1:
            return
    raise AssertionError(f"it is at {state} on its way to {goals}")


@KINDS
def test_an_operator_drives_by_speed_and_turn_rate(kind: dict[str, Any]) -> None:
    briefing = _briefing(kind, command_timeout=60.0)
    driver, state = TeleopDriver(briefing), UgvState(10.0, 10.0, 0.0, 0.0, 0.3)
    twist = Teleoperation(operator="nav2", speed=0.4, turn_rate=0.2)
    for tick in range(100):
        state = _moved(briefing, state, driver.drive(_seen(tick, state, twist)))
    assert signed_speed(state) == pytest.approx(0.4)
    before, state = state, _moved(briefing, state, driver.drive(_seen(100, state)))
    assert wrapped(state.heading - before.heading) / DT == pytest.approx(0.2)
    back = Teleoperation(operator="nav2", speed=-0.2)
    for tick in range(101, 200):
        state = _moved(briefing, state, driver.drive(_seen(tick, state, back)))
    assert signed_speed(state) == pytest.approx(-0.2)
    still = Teleoperation(operator="nav2", speed=0.0, turn_rate=0.5)
    for tick in range(200, 240):
        before, state = state, _moved(briefing, state, driver.drive(_seen(tick, state, still)))
    turned = wrapped(state.heading - before.heading) / DT
    assert turned == pytest.approx(0.5 if kind is DIFFERENTIAL else 0.0, abs=1e-6)
    assert state[2:4] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_point_ignores_a_speed_along_a_heading() -> None:
    twist = Teleoperation(operator="nav2", speed=0.4, turn_rate=0.2)
    observation = UgvObservation(
        tick=0, time=0.0, position=(1.0, 1.0), velocity=(0.0, 0.0), operator=(twist,)
    )
    assert TeleopDriver(ugv_briefing()).drive(observation) == (0.0, 0.0)


@KINDS
def test_environment_run_and_batch_fly_alike(kind: dict[str, Any]) -> None:
    scenario = raw(_steering("escort", kind, "duration=30.0", "ugv.0.driver=wander"))
    _, flight, _ = flown_in_both(scenario, 4)
    loop = ClosedLoop(scenario, 2, threads=1)
    loop.begin([5, 4])
    loop.fly()
    vehicles = loop.state.batch.vehicles[1]
    assert np.array_equal(vehicles["position"], flight.world.position)
    assert np.array_equal(vehicles["heading"], flight.world.vehicles["heading"])
    assert abs(flight.world.vehicles["heading"][1]) > 0.01


@KINDS
def test_its_row_has_the_heading_over_the_bus_too(kind: dict[str, Any]) -> None:
    env = parallel_env(_steering("escort", kind, "duration=5.0"), end_on_sight_lost=False)
    env.reset(seed=1)
    rows, reads = {}, UgvRows(env.briefing("ugv_0"))
    for _ in range(60):
        rows, *_ = env.step({"uav_0": np.zeros(2), "ugv_0": np.array([0.05, 0.08])})
    world = env.world
    observation = UgvObservation(
        tick=world.tick,
        time=world.time,
        position=tuple(world.position[1].tolist()),
        velocity=tuple(world.velocity[1].tolist()),
        heading=world.heading(1),
    )
    np.testing.assert_array_equal(reads.row(observation), rows["ugv_0"])
    ahead = rows["ugv_0"][-2:]
    assert ahead == pytest.approx(world.velocity[1] / np.hypot(*world.velocity[1]))
    names = [one for one in env.state_names if one.startswith("ugv_0.heading")]
    assert len(names) == 2
    assert env.state()[-2:] == pytest.approx(ahead)


@KINDS
def test_sight_stays_certified_while_it_evades(kind: dict[str, Any]) -> None:
    changes = ("law.name=certified", "ugv.0.driver=evade", "duration=60.0")
    loop = ClosedLoop(_steering("escort", kind, *changes, "links.profile=wifi"), 8, threads=1)
    loop.begin(range(8))
    loop.fly()
    counts, standings = loop.state.certificates, loop.state.rows.standings
    assert not standings["violations"].any()
    assert not counts["certified_while_lost"].any()
    assert not counts["broken"].any()
    driven = loop.state.batch.vehicles["position"][:, 1] - np.array(loop.scenario.ugv[0].position)
    assert np.hypot(*driven.T).min() > 0.2


@KINDS
def test_a_cautious_ugv_that_steers_enters_no_unknown_tile(kind: dict[str, Any]) -> None:
    for profile, arrives in (("perfect", True), ("jammed", False)):  # arrival is not guaranteed
        changes = (f"links.profile={profile}", "duration=400.0")
        mission = fly(_steering("minefield", kind, *changes), 1)[1].mission
        assert mission is not None
        assert mission.entered_unknown_tile == 0
        assert mission.hazards_hit == 0
        assert mission.arrived or not arrives


@KINDS
def test_a_process_that_rejoins_receives_its_headings(kind: dict[str, Any]) -> None:
    flight, _ = fly(_steering("escort", kind, "duration=10.0", "ugv.0.driver=wander"), 3)
    past = flight.past("ugv_0", 0, flight.world.tick, ())
    assert len({one.heading for one in past}) > 10
    assert all(one.heading is not None for one in past)


def test_uavs_learn_nothing_of_the_kinematics() -> None:
    """The briefing of a UAV is the same to the byte."""
    plain, car = load_scenario("escort"), _steering("escort", CAR)
    briefings = [uav_briefing(one, "uav_0", 0) for one in (plain, car)]
    assert msgspec.json.encode(briefings[0]) == msgspec.json.encode(briefings[1])


@pytest.fixture
def cautious(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parent.parent / "benchmarks"))
    pytest.importorskip("cautious_attacks", reason="a copy of the core alone has no benchmarks")
    import cautious_attacks  # noqa: PLC0415 - from the folder above

    return cautious_attacks


def test_it_enters_no_unknown_tile_under_attack(cautious: ModuleType) -> None:
    """The long version with 10,000 runs: `python benchmarks/cautious_attacks.py steering`."""
    flights = [
        cautious.fly(cautious.draw_steering_trial(seed), seed, lossy=True) for seed in range(100)
    ]
    assert sum(one.entered + one.broken for one in flights) == 0
    assert sum(one.driven > 0.0 for one in flights) > 60


def _as_a_point(ugv: Any, late: bool, tiles: Any, ground: Any, own: UgvState, *u: float) -> bool:
    return is_safe(_changed(ugv, Kinematics()), late, tiles, ground, own, *u)


def _changed(ugv: Any, kinematics: Kinematics) -> Any:
    new = ugv.copy()
    new["kinematics"] = kinematics
    return new


def test_a_filter_that_predicts_a_point_is_caught(cautious: ModuleType) -> None:
    trials = [cautious.draw_steering_trial(seed, wheel="swerve") for seed in range(60)]
    caught = (cautious.fly(one, k, _as_a_point).entered for k, one in enumerate(trials))
    assert any(caught)


def test_ground_that_limits_the_turn_too_would_break_the_proof(
    cautious: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def moved(ugv: Any, own: UgvState, u: tuple[float, float], ground_speed: float) -> UgvState:
        bounds = ground_speed, ugv.max_acceleration
        after = step_ugv(ugv.kinematics, own, *u, bounds, ground_speed, ugv.dt)
        return ugv_within_walls(ugv.kinematics, after, ugv.width, ugv.height)

    monkeypatch.setattr(cautious, "moved", moved)
    trials = [cautious.draw_steering_trial(seed, wheel="swerve") for seed in range(400)]
    assert any(cautious.fly(one, k, is_safe).entered for k, one in enumerate(trials))
