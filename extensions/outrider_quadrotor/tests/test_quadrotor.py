"""The quadrotor: its flight, its faults, its place in worlds and environments, and the measured bound."""

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import outrider
from bus.errors import OutriderError, ScenarioError
from bus.observations import UAV, names
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.running.assumptions import shortfalls
from outrider.running.flying import fly
from sim.engine.briefing import briefing
from sim.models.body import Influences, Motion, ReferenceTick
from sim.scenario.checks import scenario_warnings
from sim.scenario.loading import load_scenario
from sim.world import World

pytest.importorskip("mujoco", reason="not installed here")

from outrider_quadrotor import quadrotor
from outrider_quadrotor.comparison import compare
from outrider_quadrotor.measurement import measure, rounded_up
from outrider_quadrotor.references import REFERENCES, Bounds, influences
from outrider_quadrotor.work import print_comparison, print_measurement

DECLARED = 0.15
"""A tracking error that the quadrotor keeps in `escort` [m]."""
CALM = Influences(wind=(0.0, 0.0), position_error=(0.0, 0.0))
BOUNDS = Bounds(speed=0.6, acceleration=0.3, wind=0.1, position_error=0.05)
DT = 0.05


def load(*changes: str, declared: float | None = DECLARED) -> Any:
    bound = [] if declared is None else [f"certificate.max_tracking_error={declared}"]
    return load_scenario(
        "escort", overrides=["uav.0.body=quadrotor", "duration=4.0", *bound, *changes]
    )


def at(position: tuple[float, float, float], velocity: float = 0.0) -> Motion:
    return Motion(position, (velocity, 0.0, 0.0))


def hovering(seed: int, causes: Influences, seconds: float) -> Motion:
    """Hover in one place and return the last state."""
    scenario = load()
    body, here = quadrotor.Quadrotor(scenario, scenario.uav[0]), at((1.0, 2.0, 10.0))
    body.reset(here, np.random.default_rng(seed))
    found = here
    for _ in range(round(seconds / DT)):
        found = body.step(ReferenceTick(here, here), causes)
    return found


# -- the body


def test_it_holds_its_place_and_yields_to_a_position_error() -> None:
    still = hovering(3, CALM, 20.0)
    assert still.position == pytest.approx((1.0, 2.0, 10.0), abs=0.005)
    off = hovering(3, CALM._replace(position_error=(0.2, -0.1)), 20.0)
    assert off.position == pytest.approx((0.8, 2.1, 10.0), abs=0.005)


def test_wind_pushes_it_before_its_integral_acts() -> None:
    pushed = hovering(3, CALM._replace(wind=(0.5, 0.0)), 1.5)
    assert 0.03 < pushed.position[0] - 1.0 < 0.2
    assert hovering(3, CALM._replace(wind=(0.5, 0.0)), 60.0).position[0] == pytest.approx(
        1.0, abs=0.005
    )


def test_its_parameters_follow_from_the_random_numbers() -> None:
    first, again, other = (hovering(seed, CALM, 1.0) for seed in (3, 3, 4))
    assert first == again
    assert first != other


def test_a_crash_and_a_weak_drone_are_told_in_one_line() -> None:
    scenario = load()
    body, here = quadrotor.Quadrotor(scenario, scenario.uav[0]), at((0.0, 0.0, 10.0))
    body.reset(here, np.random.default_rng(1))
    with pytest.raises(OutriderError, match=r"^crashed, .* below its reference") as crashed:
        body.step(ReferenceTick(here, at((0.0, 0.0, 40.0))), CALM)
    assert "\n" not in str(crashed.value)
    for strong in ("uav.0.max_acceleration=inf", "wind.mean=[9.8, 0.0]"):
        with pytest.raises(ScenarioError, match=r"uav\.0\.body = 'quadrotor': too weak"):
            World(load(strong), 1)


def test_a_weak_drone_is_refused_by_check_and_run(command: Any, here: Path) -> None:
    weak = ("--set", "uav.0.body=quadrotor", "--set", "uav.0.max_acceleration=30")
    for name in ("check", "run"):
        refused = command(name, "escort", *weak, "--set", "certificate.max_tracking_error=0.1")
        assert refused.returncode == 2
        (line,) = refused.stderr.strip().splitlines()
        assert line.startswith("outrider: uav.0.body = 'quadrotor': too weak")


# -- its place in a world


class Broken:
    """A body that fails in its third tick."""

    states: Any = None

    def __init__(self, scenario: Any, uav: Any) -> None:
        self.left = 2

    def reset(self, start: Motion, rng: np.random.Generator) -> None:
        pass

    def step(self, reference: ReferenceTick, causes: Influences) -> Motion:
        self.left -= 1
        return reference.end if self.left >= 0 else self.states()


def test_faults_of_a_body_name_the_uav_and_the_time(monkeypatch) -> None:
    def lost() -> Motion:
        return at((math.nan, 0.0, 0.0))

    for states, wrong in ((lost, "not a state"), (dict[int, Motion]().popitem, "KeyError")):
        monkeypatch.setattr(Broken, "states", staticmethod(states))
        monkeypatch.setattr(quadrotor, "Quadrotor", Broken)
        world = World(load(), 1)
        for _ in range(2):
            world.step(np.zeros((2, 2)))
        with pytest.raises(OutriderError, match=rf"^uav_0 at 0\.15 s: body 'quadrotor': .*{wrong}"):
            world.step(np.zeros((2, 2)))


def test_environment_and_world_agree_under_the_same_commands() -> None:
    scenario = load("wind.mean=[0.1, 0.0]", "wind.gust=0.05", "uav.0.position_error=0.05")
    env, world = outrider.parallel_env(scenario), World(scenario, 5)
    env.reset(seed=5)
    for tick in range(60):
        actions = np.array([[0.3 * math.sin(0.2 * tick), 0.2], [0.05, 0.0]])
        observed, *_ = env.step(dict(zip(("uav_0", "ugv_0"), actions, strict=True)))
        world.step(actions)
    shown = env.worlds.loop.state.batch.vehicles[0]
    assert np.array_equal(world.position, shown["position"])
    assert np.array_equal(world.velocity, shown["velocity"])
    off = world.position - world.reference_position
    assert 0.01 < np.hypot(*off[0]) < 0.2
    assert not off[1].any()
    own = [observed["uav_0"][names(UAV).index(axis)] for axis in "xy"]  # nothing of the body
    assert own == pytest.approx(world.reference_position[0], abs=1e-5)
    env.reset(seed=5)
    assert np.array_equal(shown["position"], shown["reference_position"])


def test_no_vehicle_learns_which_body_flies() -> None:
    for vehicle in ("uav_0", "ugv_0"):
        assert briefing(load(), vehicle, 1) == briefing(load("uav.0.body=point"), vehicle, 1)


def test_batch_of_worlds_keeps_its_bound_certified() -> None:
    loop = ClosedLoop(load("detections.dropout=0.0"), 3, error=True, end_on_sight_lost=False)
    loop.begin([3, 4, 5])
    loop.fly()
    found = loop.metrics("uav_0")
    assert found["certified"].tolist() == [1.0] * 3
    for count in ("tracking_exceeded", "certified_while_lost", "certificate_broken"):
        assert not found[count].any(), count
    one = fly(load("detections.dropout=0.0"), 4)[0].recorder.states[-1, 0, :2]
    assert loop.state.batch.vehicles["position"][1, 0] == pytest.approx(one, abs=1e-6)


def test_processes_fly_the_hash_of_one_process(command: Any, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["escort", "--duration", "2", "--json", "--set", "uav.0.body=quadrotor"]
    options += ["--set", f"certificate.max_tracking_error={DECLARED}"]
    found = []
    for more in ((), ("--in-process",)):
        done = command("run", *options, *more)
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    assert found[0]["trajectory_sha256"] == found[1]["trajectory_sha256"]
    assert found[0]["tracking_exceeded"] == 0 < found[0]["largest_tracking_error"] < DECLARED


def test_excess_over_the_declared_bound_is_counted_and_excuses_the_certificate() -> None:
    _, summary = fly(load(declared=0.005), 3)
    assert summary.tracking_exceeded
    assert summary.largest_tracking_error > summary.max_tracking_error == 0.005
    assert summary.certificate_broken == 0


def test_without_a_declared_bound_nothing_is_certified_and_a_warning_says_so() -> None:
    scenario = load(declared=None)
    (line,) = (one for one in scenario_warnings(scenario) if "uav.0.body" in one)
    assert "declare certificate.max_tracking_error" in line
    assert any("max_tracking_error" in one.line for one in shortfalls(scenario))
    assert not [one for one in scenario_warnings(load()) if "uav.0.body" in one]
    assert fly(scenario, 1)[1].certified_share == 0.0


# -- the measurement


@pytest.mark.parametrize("name", REFERENCES)
def test_references_keep_the_bounds_and_reach_them(name: str) -> None:
    rng, ticks = np.random.default_rng(7), 400
    states = list(REFERENCES[name](BOUNDS, DT, ticks, rng))
    assert len(states) == ticks + 1
    velocity = np.array([one.velocity for one in states])
    position = np.array([one.position for one in states])
    speed, change = np.hypot(*velocity.T), np.hypot(*np.diff(velocity, axis=0).T) / DT
    assert speed.max() <= BOUNDS.speed * (1.0 + 1e-9)
    assert speed.max() > 0.999 * BOUNDS.speed or name == "periodic reversals"
    assert change.max() > 0.999 * BOUNDS.acceleration
    stops = change > BOUNDS.acceleration * (1.0 + 1e-9)
    assert stops.any() == (name == "stops at walls")
    assert not speed[1:][stops].any()
    if name == "circles at the speed limit":
        assert change[-200:].min() == pytest.approx(BOUNDS.acceleration, rel=0.01)
        assert np.ptp(position[-260:], axis=0) == pytest.approx([2.4, 2.4], abs=0.05)
    moved = 0.5 * DT * (velocity[1:] + velocity[:-1])
    assert np.diff(position, axis=0)[~stops] == pytest.approx(moved[~stops], abs=1e-12)


def test_influences_stay_at_their_limits_and_change_direction() -> None:
    found = list(itertools.islice(influences(BOUNDS, DT, np.random.default_rng(2)), 2000))
    for values, size in (
        ([one.wind for one in found], 0.1),
        ([o.position_error for o in found], 0.05),
    ):
        assert np.hypot(*np.array(values).T) == pytest.approx(np.full(2000, size))
        assert len(set(values)) > 5


def test_the_proposed_bound_exceeds_every_measured_error(capsys) -> None:
    told: list[float] = []
    found = measure(load(declared=None), 2, 0.25, lambda step, share: told.append(share))
    assert [one.reference for one in found.flights] == [*REFERENCES, "the scenario's flights"]
    assert found.largest == max(one.largest for one in found.flights) > 0.03
    assert 1.25 * found.largest <= found.max_tracking_error <= 1.45 * found.largest
    for one in found.flights:
        assert 0.0 < one.median <= one.q999 <= one.largest
    assert told == sorted(told)
    print_measurement(load(), 1, 0.0, markdown=True, json=False)
    assert "| uav_0 | full reversals | 1 | 0.0" in capsys.readouterr().out


def test_rounding_of_the_proposal_is_upwards() -> None:
    assert [rounded_up(value) for value in (0.1201, 0.12, 1.31, 12.5, 0.0)] == [
        0.13,
        0.12,
        1.4,
        13.0,
        0.0,
    ]


def test_comparison_counts_an_exceeded_bound(capsys) -> None:
    with pytest.raises(ScenarioError, match="outrider quadrotor measure"):
        compare(load(declared=None), 1, lambda step, share: None)
    with pytest.raises(ScenarioError, match="no safety filter"):
        compare(load("law.name=linear"), 1, lambda step, share: None)
    with pytest.raises(typer.Exit) as ended:
        print_comparison(load(declared=0.005), 2, markdown=False, json=True)
    assert ended.value.exit_code == 1
    point, body = json.loads(capsys.readouterr().out)["bodies"]
    assert point["tracking_exceeded"] == point["largest_tracking_error"] == 0
    assert body["tracking_exceeded"] > 0
    assert body["largest_tracking_error"] > body["max_tracking_error"] == 0.005
