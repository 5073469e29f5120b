"""Environments with hazards: observations of a UGV, rewards, mission results; the suite of missions."""

import hashlib
import json
import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from runpy import run_path
from typing import Any

import msgspec
import numpy as np
import pytest

import outrider
from agents.drivers.policy import PolicyDriver
from bus.errors import ScenarioError
from bus.messages.ground import Hazard
from bus.messages.telemetry import MissionResult
from bus.messages.vehicle import UgvCommand, UgvObservation
from flights import Piloted
from outrider.envs.env_pilots import pilots
from outrider.experiments.intervals import interquartile_interval
from outrider.running.flying import make_pilots
from outrider_learning.suite.board import leaderboard
from outrider_learning.suite.missions import mission_score, shortest_time
from outrider_learning.suite.scoring import Team
from outrider_learning.suite.tasks import SEEDS, SUITES, TASKS, Task
from refusals import refused
from sim.engine.briefing import briefing
from sim.env.observation import one_of_world
from sim.models.ground import CLEAR, OUTSIDE, UNSEEN
from sim.models.hazards import BLOCK, ROUGH
from sim.scenario.loading import load_scenario, shipped_text
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from worlds import equal, small

ROOT = Path(__file__).resolve().parents[3]
SECRET = bytes(range(16)).hex()
WALL = Hazard(kind="block", polygon=((9.0, 5.0), (9.5, 5.0), (9.5, 7.0), (9.0, 7.0)))
MUD = Hazard(kind="rough", center=(7.5, 7.5), radius=0.8, speed_share=0.5)
PAID = outrider.RewardWeights(reported=0.05, hit=20.0, still=0.1, effort=0.3)


def grounded(*, duration: float = 12.0, driver: str = "navigate") -> Scenario:
    """Return a scenario with a UGV at (8, 6) m, its goal at (12, 6) m, and a wall in between."""
    plain = small("tracking", driver)
    (ugv,) = plain.ugv
    ugv = msgspec.structs.replace(ugv, position=(8.0, 6.0), goals=((12.0, 6.0),))
    return msgspec.structs.replace(plain, hazard=(WALL, MUD), ugv=(ugv,), duration=duration, seed=5)


def test_vector_world_has_the_bits_of_the_parallel_environment() -> None:
    """Compare tiles, rewards and final infos while the UGV drives straight at the wall."""
    env = outrider.parallel_env(grounded(), rewards=PAID)
    worlds = outrider.parallel_vector_env(grounded(), num_envs=2, rewards=PAID)
    law, paid = pilots(env)["uav_0"], dict.fromkeys(env.possible_agents, 0.0)
    seen, infos = env.reset(seed=5)
    all_seen, _ = worlds.reset(seed=[5, 6])
    assert all(math.isnan(infos["ugv_0"][key]) for key in infos["ugv_0"] if key != "goals_reached")
    while env.agents:
        assert all(equal(seen[name], one_of_world(all_seen[name], 0)) for name in seen)
        actions = {
            "uav_0": np.array(law(seen["uav_0"]).acceleration),
            "ugv_0": np.array([0.1, 0.0]),
        }
        seen, rewards, *_, infos = env.step(actions)
        all_seen, all_rewards, *_, all_infos = worlds.step(
            {name: np.tile(action, (2, 1)) for name, action in actions.items()}
        )
        for name, reward in rewards.items():
            assert reward == all_rewards[name][0]
            paid[name] += reward
    final = all_infos["ugv_0"]["final_info"]
    result = infos["ugv_0"]
    assert set(result) == {"goals_reached", *MissionResult.__struct_fields__} - {"guarantees"}
    assert infos["uav_0"] == {}  # no truth reaches a UAV
    for key, value in result.items():
        assert np.array_equal(final[key][0], value, equal_nan=True)
    assert (result["hazards_hit"], result["arrived"]) == (1, False)
    assert math.isnan(result["mission_time"])
    tiles = seen["ugv_0"]["tiles"]
    assert equal(tiles, all_infos["ugv_0"]["final_obs"][0]["tiles"])
    received = env.world.ground.missions["received_tiles"].item()
    assert received > 100
    metrics = env.metrics()["ugv_0"]
    assert metrics["reward_hit"] == 0.0  # paid once, some ticks ago
    assert metrics["reward_still"] == pytest.approx(-0.1 * env.scenario.dt)
    assert -20.0 < paid["ugv_0"] < -18.0  # a metre nearer, and one hit
    worlds.close()


def test_ugv_observes_the_surrounding_tiles_that_it_knows() -> None:
    env = outrider.parallel_env(grounded(), tile_patch=31)
    silent = msgspec.structs.replace(
        grounded(), ground=msgspec.structs.replace(grounded().ground, map_update_rate=0.0)
    )
    bare = outrider.parallel_env(silent, tile_patch=31)
    fly = pilots(env)
    seen = env.reset(seed=5)[0]
    bare.reset(seed=5)
    for _ in range(120):
        actions = {name: fly[name](seen[name]) for name in env.agents}
        seen, *_ = env.step(actions)
        alone, *_ = bare.step(actions)
    tiles, truth = seen["ugv_0"]["tiles"], env.world.ground.tiles[0]
    assert env.observation_space("ugv_0").contains(seen["ugv_0"])
    x, y = seen["ugv_0"]["row"][1:3]
    row, column = int(y / 0.5), int(x / 0.5)
    for i in range(31):
        for j in range(31):
            at = row + i - 15, column + j - 15
            inside = 0 <= at[0] < truth.shape[0] and 0 <= at[1] < truth.shape[1]
            assert tiles[i, j] in ((UNSEEN, truth[at]) if inside else (OUTSIDE,))
    assert {UNSEEN, CLEAR, ROUGH, BLOCK, OUTSIDE} == set(np.unique(tiles).tolist())
    by_bumper = np.isin(alone["ugv_0"]["tiles"], (CLEAR, BLOCK)).sum()
    assert 2 * by_bumper < np.isin(tiles, (CLEAR, BLOCK)).sum()  # the rest was received by radio


def test_nothing_changes_without_hazards() -> None:
    env = outrider.parallel_env("escort", duration=0.1, tile_patch=3)
    seen, _ = env.reset(seed=1)
    assert seen["ugv_0"].shape == (8,)
    infos: dict[str, Any] = {}
    while env.agents:
        *_, infos = env.step(dict.fromkeys(env.agents, (0.0, 0.0)))
    assert infos == {"uav_0": {}, "ugv_0": {"goals_reached": 0}}
    assert not {"reward_told", "reward_hit"} & {*env.metrics()["uav_0"], *env.metrics()["ugv_0"]}


@pytest.mark.parametrize("side", [0, 4, 257, 2.5, True, math.nan, math.inf])
def test_a_picture_of_tiles_has_a_middle(side: Any) -> None:
    with refused(ValueError, "tile_patch = .*allowed: an odd whole number from 1 to 255"):
        outrider.parallel_env(grounded(), tile_patch=side)
    with refused(ValueError, "tile_patch = "):
        outrider.vector_env(grounded(), num_envs=1, tile_patch=side)
    assert outrider.parallel_env(grounded(), tile_patch=np.float64(3.0)).observation_space("ugv_0")


class Tiny:
    """A user's policy that saves its space like learning libraries, and drives where nothing blocks."""

    def __init__(self, env: Any) -> None:
        self.observation_space = env.observation_space("ugv_0")
        self.seen: list[dict[str, np.ndarray]] = []

    def predict(self, seen: dict[str, np.ndarray]) -> tuple[float, float]:
        self.seen.append(seen)
        ahead = seen["tiles"][10, 11:14]
        return (-0.1, 0.0) if BLOCK in ahead.tolist() else (0.05, 0.02)


def test_policy_sees_the_same_tiles_over_the_bus() -> None:
    scenario = grounded(duration=6.0)
    env = outrider.parallel_env(scenario)
    there, here, law = Tiny(env), Tiny(env), pilots(env)["uav_0"]
    seen, _ = env.reset(seed=5)
    while env.agents:
        action = there.predict(seen["ugv_0"])
        seen, *_ = env.step({"uav_0": law(seen["uav_0"]), "ugv_0": action})
    own_briefing = briefing(scenario, "ugv_0", 5)
    driver = PolicyDriver(own_briefing, policy=here, name="tiny:drive")

    def act(seen: UgvObservation) -> UgvCommand:
        return UgvCommand(tick=seen.tick, acceleration=driver.drive(seen))

    Flight(scenario, 5).fly(Piloted(make_pilots(scenario, 5), "ugv_0", act))
    assert len(there.seen) == len(here.seen)
    assert all(equal(one, other) for one, other in zip(there.seen, here.seen, strict=True))
    assert any((one["tiles"] == BLOCK).any() for one in here.seen)


def test_navigation_example_approaches_its_goal_on_known_ground() -> None:
    example = run_path(str(ROOT / "examples" / "navigate_by_tiles.py"))
    policy = example["policy"]
    env = outrider.parallel_env(msgspec.structs.replace(load_scenario("minefield"), duration=30.0))
    law = pilots(env)["uav_0"]
    seen, _ = env.reset(seed=1)
    far = seen["ugv_0"]["row"][6:8] - seen["ugv_0"]["row"][1:3]
    while env.agents:
        action = policy.predict(seen["ugv_0"])
        assert np.hypot(*action) < 0.03 + 1e-9
        seen, _, *_, infos = env.step({"uav_0": law(seen["uav_0"]), "ugv_0": action})
    near = seen["ugv_0"]["row"][6:8] - seen["ugv_0"]["row"][1:3]
    assert np.hypot(*near) < np.hypot(*far) - 2.0
    assert infos["ugv_0"]["hazards_hit"] == 0


def test_a_policy_that_observes_tiles_needs_hazards() -> None:
    model, own_briefing = (
        Tiny(outrider.parallel_env(grounded())),
        briefing(small("tracking"), "ugv_0", 1),
    )
    with refused(ScenarioError, "policy = 'tiny:drive': observes tiles, but the scenario has no"):
        PolicyDriver(own_briefing, policy=model, name="tiny:drive")


def fingerprint(tasks: Sequence[Task]) -> str:
    """Return the SHA-256 of all that defines tasks: names, scenarios, changes, kind of score, and seeds."""
    bases = {task.base: tomllib.loads(shipped_text(task.base)) for task in tasks}
    rows = [[task.name, task.base, task.mission, task.changes] for task in tasks]
    whole = json.dumps([bases, rows, SEEDS], sort_keys=True)
    return hashlib.sha256(whole.encode()).hexdigest()


FROZEN = {
    "suite-v1": "d0af2ce7d7aac54ce8337002c49277a6efeb50b511e506be4410a321df4e8ec7",
    "missions-v1": "4c13e27984ee0daf66b574bcb8657067646305e9f6ab26b8081ee14998987994",
    "teams-v1": "672903a624e7aad37f75a75f0003e000457634c90e7d53e137a75a803766f4a9",
    "towns-v1": "f8fbae8b617ca7b6d0a1af2a328a2db16c6334eacc2b581b14ffd10fc29478a5",
}


@pytest.mark.parametrize("name", SUITES)
def test_the_tasks_of_a_suite_with_a_number_never_change(name: str) -> None:
    """A change of a task needs a suite with the next number."""
    assert fingerprint(SUITES[name]) == FROZEN[name]
    assert len({task.mission for task in SUITES[name]}) == 1  # or no leaderboard could compare them


def test_a_missions_score_is_the_share_of_the_shortest_time() -> None:
    none = dict.fromkeys(("hazards_hit", "near_misses", "finds", "found"), 0)
    warnings = {"hazards_on_path": 3, "warned": 3, "mean_warning_time": 5.0, "reported_share": 0.5}
    went = MissionResult(arrived=True, mission_time=50.0, stationary_time=0.0, **warnings, **none)
    changed = msgspec.structs.replace
    assert mission_score(went, 20.0) == pytest.approx(40.0)
    assert mission_score(changed(went, hazards_hit=1), 20.0) == pytest.approx(20.0)
    assert mission_score(changed(went, finds=8, found=2), 20.0) == pytest.approx(10.0)
    assert mission_score(changed(went, mission_time=10.0), 20.0) == 100.0
    assert mission_score(changed(went, arrived=False, mission_time=None), 20.0) == 0.0
    assert shortest_time(grounded()) == pytest.approx(4.0 / grounded().ugv[0].max_speed)


def test_the_interquartile_mean_and_its_interval_are_rliables() -> None:
    scores = np.array([[0.0, 10.0, 20.0, 90.0], [5.0, 15.0, 25.0, 30.0]])
    middle, low, high = interquartile_interval(scores.tolist())
    assert middle == np.mean([10.0, 15.0, 20.0, 25.0])
    random = np.random.default_rng(3)
    again = [
        np.mean(np.sort(np.concatenate([random.choice(one, 4) for one in scores]))[2:6])
        for _ in range(4000)
    ]
    assert (low, high) == pytest.approx(np.percentile(again, [2.5, 97.5]), abs=1.5)
    middle, *interval = interquartile_interval([[3.0], [5.0]])
    assert (middle, np.isnan(interval).all()) == (4.0, True)
    with refused(ValueError, "tasks: empty, or with different numbers of seeds"):
        interquartile_interval([[1.0, 2.0], [1.0]])


class Short(Task):
    @property
    def scenario(self) -> Scenario:
        return grounded(duration=4.0)


class Left(Task):
    """A goal that is as near as the end of sight."""

    @property
    def scenario(self) -> Scenario:
        plain, changed = grounded(), msgspec.structs.replace
        (uav,), (ugv,) = plain.uav, plain.ugv
        return changed(
            plain,
            uav=(changed(uav, velocity=(0.0, 0.6)),),
            ugv=(changed(ugv, goals=((8.0, 5.4),)),),
            visibility=changed(plain.visibility, radius=3.0),
        )


def test_mission_continues_out_of_sight_and_ends_the_count() -> None:
    turn = iter(range(10**9))

    def away(seen: np.ndarray) -> np.ndarray:
        return np.tile([0.0, 0.3], (len(seen), 1))

    def drive(_seen: dict[str, np.ndarray]) -> np.ndarray:
        """Drive so that UGV 0 arrives before its UAV is out of sight, and UGV 1 starts only then."""
        return np.array([[0.0, -0.1], [0.0, -0.1 if next(turn) > 80 else 0.0]])

    task = Left(name="left", hard="", changes={}, mission=True)
    result = task.evaluate(Team(uav=away, ugv=drive), seeds=[1, 2], secret=SECRET)
    assert (result.arrived, result.lost) == (2, 1)  # type: ignore[attr-defined]
    assert result.scores[0] > result.scores[1] > 0.0


def test_requested_map_is_a_copy() -> None:
    env = outrider.parallel_env(grounded())
    env.reset(seed=1)
    known = env.known_tiles("ugv_0")
    known[:] = BLOCK
    assert not (env.known_tiles("ugv_0") == BLOCK).all()


@pytest.mark.long
def test_missions_are_flown_by_laws() -> None:
    task = Short(name="short", hard="", changes={}, mission=True)
    result: Any = task.evaluate("tracking", seeds=[1, 2], secret=SECRET)
    assert result.hazards_hit == 0
    assert result.reported_share > 0.3


def test_missions_are_flown_by_teams() -> None:
    task = Short(name="short", hard="", changes={}, mission=True)

    def drive(seen: dict[str, np.ndarray]) -> np.ndarray:
        assert seen["tiles"].shape == (2, 21, 21)
        return np.tile([0.1, 0.0], (2, 1))

    board = leaderboard({"team": Team(ugv=drive)}, tasks=[task], seeds=[1, 2], secret=SECRET)
    (result,) = board.standings[0].results
    assert result.reported_share > 0.3  # type: ignore[attr-defined]
    assert board.markdown().splitlines()[-1].startswith("| **interquartile mean** | 0.0 [0.0, 0.0]")
    with refused(ValueError, "tasks: missions and other tasks"):
        leaderboard(["tracking"], tasks=[task, TASKS[0]])
    with refused(ValueError, "entry: a team needs a mission"):
        TASKS[0].evaluate(Team())
