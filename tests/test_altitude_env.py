"""Altitude in the environments: a third action, two more observations, and the same flight as over the bus."""

import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from shapely import Polygon, contains_xy

import outrider
from agents.uav import UavPilot
from bus.observations import ALTITUDE, UAV, by_name
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.env_pilots import pilots
from outrider.running.flying import fly
from sim.engine.briefing import uav_briefing
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

with warnings.catch_warnings():
    # PettingZoo 1.27 creates an old environment of its own
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import parallel_api_test

CHANGES = ["duration=6", "altitude.law=best", "uav.0.max_altitude=20", "uav.0.min_altitude=7"]
COUNTERS = ("certified_while_lost", "certificate_broken")


def town(*changes: str) -> Scenario:
    return load_scenario("town", overrides=[*CHANGES, *changes])


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    made = outrider.parallel_env(town(), end_on_sight_lost=False)
    yield made
    made.close()


def test_altitude_is_a_third_action_and_two_more_entries(env: Any) -> None:
    uav, ugv = env.action_space("uav_0"), env.action_space("ugv_0")
    assert (uav.shape, ugv.shape) == ((3,), (2,))
    assert (uav.low[2], uav.high[2]) == (-1.0, 1.0)
    space = env.observation_space("uav_0")
    low, high = by_name(UAV + ALTITUDE, space.low), by_name(UAV + ALTITUDE, space.high)
    assert (low["altitude"], high["altitude"]) == (0.0, 20.0)
    assert (low["climb_rate"], high["climb_rate"]) == (-1.0, 1.0)
    assert [name for name in env.state_names if name.startswith("uav_0.")][-2:] == [
        "uav_0.altitude",
        "uav_0.climb_rate",
    ]


def test_detections_from_any_altitude_fit_into_their_space(env: Any) -> None:
    """A detection at 5 m from 20 m above has an error of up to 3 * 0.1 m * hypot(20, 5) / 10."""
    high = by_name(UAV + ALTITUDE, env.observation_space("uav_0").high)
    largest = pytest.approx(5.0 + 0.03 * np.hypot(20.0, 5.0), rel=1e-6)
    assert high["relative_x"] == high["relative_y"] == largest


def test_pettingzoo_and_gymnasium_accept_the_environment(env: Any) -> None:
    parallel_api_test(env, num_cycles=50)
    check_env(outrider.single_env(town()), skip_render_check=True)


@pytest.mark.parametrize("action", [[0.0, 0.0], [0.0, 0.0, np.nan], [[0.0, 0.0, 0.0]]])
def test_an_action_without_a_third_number_is_refused(env: Any, action: Any) -> None:
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r"action of uav_0 .*three (finite )?numbers"):
        env.step({"uav_0": action, "ugv_0": [0.0, 0.0]})
    single = outrider.single_env(town())
    single.reset(seed=1)
    with pytest.raises(ValueError, match=r"action of uav_0 .*three (finite )?numbers"):
        single.step(action)


def test_pilots_fly_the_environment_like_a_run(env: Any) -> None:
    seen, _ = env.reset(seed=3)
    policies = pilots(env)
    while env.agents:
        seen, *_ = env.step({name: policies[name](seen[name]) for name in env.agents})
    flight, summary = fly(town(), 3)
    assert np.array_equal(env.world.reference_position, flight.world.reference_position)
    assert np.array_equal(env.world.vertical, flight.world.vertical)
    assert env.world.vertical["altitude"][0] != 14.0
    assert summary.certified_while_lost == 0


@pytest.mark.parametrize("law", ["fixed", "certified", "best"])
def test_batches_fly_like_a_run(law: str) -> None:
    scenario = town(f"altitude.law={law}")
    loop = ClosedLoop(scenario, 2, error=True, end_on_sight_lost=False)
    loop.begin([3, 4])
    loop.fly()
    vehicles, metrics = loop.state.batch.vehicles, loop.metrics("uav_0")
    for k, seed in enumerate((3, 4)):
        flight, summary = fly(scenario, seed)
        position = vehicles["reference_position"][k]
        assert position == pytest.approx(flight.world.reference_position, abs=1e-9)
        height = vehicles["vertical"]["altitude"][k]
        assert height == pytest.approx(flight.world.vertical["altitude"], abs=1e-9)
        assert metrics["certified"][k] == pytest.approx(summary.certified_share)
        assert metrics["mean_error"][k] == pytest.approx(summary.mean_error)
    assert [metrics[name].sum() for name in COUNTERS] == [0.0, 0.0]


def test_many_worlds_equal_single_ones_bit_for_bit() -> None:
    many = outrider.vector_env(town(), num_envs=2, end_on_sight_lost=False)
    one = outrider.single_env(town(), end_on_sight_lost=False)
    rng, high = np.random.default_rng(1), one.action_space.high
    actions = rng.uniform(-high, high, (40, 2, 3))
    first, _ = many.reset(seed=5)
    rows = [first, *(many.step(action)[0] for action in actions)]
    for k in range(2):
        seen, _ = one.reset(seed=5 + k)
        own = [seen, *(one.step(action[k])[0] for action in actions)]
        assert np.array_equal(np.array(own), np.array(rows)[:, k])


def test_filter_keeps_diving_actions_in_sight() -> None:
    worlds = outrider.vector_env(town("duration=60"), num_envs=8, safety_filter=True)
    worlds.reset(seed=1)
    rng, certified = np.random.default_rng(1), 0
    for k in range(600):
        if k % 40 == 0:
            action = rng.uniform(-0.3, 0.3, (8, 3))
            action[:, 2] = rng.choice([-1.0, -1.0, 1.0], 8)
        *_, infos = worlds.step(action)
        certified += int(infos["certified"].sum())
    metrics = worlds.metrics()["uav_0"]
    assert metrics["ticks"].tolist() == [600.0] * 8
    assert certified > 0.9 * 600 * 8
    assert [metrics[name].sum() for name in COUNTERS] == [0.0, 0.0]
    assert worlds.worlds.loop.state.batch.vehicles["vertical"]["altitude"][:, 0].min() < 13.0


@pytest.mark.parametrize("pilots_of", [{"ugv_0": "wander"}, {}], ids=["wander", "navigate"])
def test_batches_certify_only_beside_a_ugv_that_keeps_clear(pilots_of: dict[str, str]) -> None:
    loop = ClosedLoop(town("duration=10"), 4, pilots=pilots_of, end_on_sight_lost=False)
    loop.begin([1, 2, 3, 4])
    loop.fly()
    metrics = loop.metrics("uav_0")
    assert [metrics[name].sum() for name in COUNTERS] == [0.0, 0.0]
    assert (metrics["certified"] > 0.9).tolist() == [not pilots_of] * 4
    assert (metrics["certified"] > 0.0).tolist() == [not pilots_of] * 4


def still(rows: Any) -> Any:
    return np.zeros((len(rows["row"]), 2))


DECLARED = "ugv.0.keeps_clearance=true"


@pytest.mark.parametrize(
    ("change", "driver", "certified"),
    [
        ("seed=1", "wander", False),
        (DECLARED, "wander", False),
        ("seed=1", still, False),
        (DECLARED, still, True),
        ("seed=1", "navigate", True),
        ("ugv.0.driver=wander", "navigate", False),  # its receiver executes no stops
    ],
)
def test_environments_brief_uavs_for_the_driver_in_control(
    change: str, driver: Any, certified: bool
) -> None:
    worlds = outrider.vector_env(
        town(change), num_envs=2, others={"ugv_0": driver}, safety_filter=True
    )
    single = outrider.single_env(town(change), others={"ugv_0": driver}, safety_filter=True)
    worlds.reset(seed=1)
    single.reset(seed=1)
    for _ in range(20):
        *_, infos = worlds.step(np.zeros((2, 3)))
        *_, info = single.step(np.zeros(3))
    assert infos["certified"].tolist() == [certified] * 2
    assert info["certified"] is certified
    assert (worlds.metrics()["uav_0"]["certified"] > 0.5).tolist() == [certified] * 2


@pytest.mark.parametrize(("change", "kept"), [("seed=1", 0.0), (DECLARED, 1.5)])
def test_external_ugv_keeps_only_a_declared_clearance(change: str, kept: float) -> None:
    env = outrider.parallel_env(town(change), safety_filter=True, end_on_sight_lost=False)
    env.reset(seed=1)
    assert env.briefing("uav_0").guaranteed_clearance == kept
    for _ in range(20):
        *_, infos = env.step({"uav_0": [0.0, 0.0, 0.0], "ugv_0": [0.0, 0.0]})
    assert infos["uav_0"]["certified"] == (kept > 0.0)


def test_ugv_that_breaks_its_declared_clearance_is_counted() -> None:
    """It drives into a house; the certificate is not accused of what then hides it."""
    house = "building=[{height=5, polygon=[[10, 5], [20, 5], [20, 30], [10, 30]]}]"
    start = ["ugv.0.position=[7.5, 15]", "ugv.0.goals=[]", "ugv.0.building_clearance=1"]
    start += ["uav.0.position=[4.5, 15]", "uav.0.initial_altitude=8", DECLARED]
    env = outrider.single_env(
        town("building_field=[]", house, *start, "duration=30"),
        others={"ugv_0": lambda rows: np.full((1, 2), (0.1, 0.0))},
        safety_filter=True,
        end_on_sight_lost=False,
    )
    env.reset(seed=1)
    while not env.step(np.array([0.1, 0.0, -1.0]))[3]:
        pass
    metrics, mission = env.metrics()["uav_0"], env.worlds.mission(0)
    assert mission is not None
    assert mission.near_building is not None
    assert mission.near_building > 100
    assert mission.near_building_excused == 0
    assert 0.0 < metrics["certified"] < 0.9
    assert metrics["certified_while_lost"] == 0.0


@pytest.mark.parametrize("clearance", [1.5, 0.01], ids=["certified", "never certified"])
def test_no_filtered_uav_touches_a_building(clearance: float) -> None:
    changes = ["duration=60", "uav.0.min_altitude=1", f"ugv.0.building_clearance={clearance}"]
    worlds = outrider.vector_env(
        town(*changes), num_envs=8, safety_filter=True, end_on_sight_lost=False
    )
    worlds.reset(seed=1)
    rng, state, lowest = np.random.default_rng(2), worlds.worlds.loop.state.batch, np.inf
    certified = 0
    for k in range(1199):
        if k % 40 == 0:
            action = rng.uniform(-0.3, 0.3, (8, 3))
            action[:, 2] = rng.choice([-1.0, -1.0, 1.0], 8)
        *_, infos = worlds.step(action)
        certified += int(infos["certified"].sum())
        lowest = min(lowest, state.vehicles["vertical"]["altitude"][:, 0].min())
    assert not state.vehicles["vertical"]["contacts"].any()
    assert lowest >= 6.0  # roofs of at most 5 m, and a vertical clearance of 1 m
    assert (certified > 0) == (lowest < 7.5) == (clearance == 1.5)


@pytest.mark.parametrize("side", [16.4, 13.6])
def test_uav_that_starts_below_the_roofs_brakes_and_climbs(side: float) -> None:
    """It flies towards a wall, and the line to the UGV leads along it; its stopping distance of 0.6 m just suffices."""
    wall = "building=[{height=5, polygon=[[10, 5], [12, 5], [12, 30], [10, 30]]}]"
    start = ["uav.0.position=[9.35, 15]", "uav.0.velocity=[0.6, 0]", "uav.0.initial_altitude=2"]
    place = [f"ugv.0.position=[9.0, {side}]", "ugv.0.goals=[]", "ugv.0.building_clearance=0.3"]
    changes = ["building_field=[]", wall, *start, *place, "duration=30", "uav.0.min_altitude=1"]
    worlds = outrider.vector_env(
        town(*changes), num_envs=2, safety_filter=True, end_on_sight_lost=False
    )
    worlds.reset(seed=1)
    state = worlds.worlds.loop.state.batch
    for _ in range(599):
        worlds.step(np.tile([0.3, 0.0, -1.0], (2, 1)))
    assert not state.vehicles["vertical"]["contacts"].any()
    assert state.vehicles["vertical"]["altitude"][:, 0].min() >= 6.0


# -- the information contract


def beside_a_hut(x: float, known: str) -> Any:
    """Return an environment with a hut whose left side is at x, and a picture of the UAV's own map."""
    place = f"building=[{{height=4, polygon=[[{x},2],[{x + 1},2],[{x + 1},5],[{x},5]]}}]"
    changed = town("building_field=[]", f"buildings.known={known}", place)
    env = outrider.single_env(changed, end_on_sight_lost=False, coverage_patch=(13, 1.0))
    env.reset(seed=2)
    return env


def test_own_map_shows_no_building_before_its_corners_are_seen() -> None:
    """Without a map, the UAV's own map does not depend on where buildings are until it has seen all corners of one."""
    envs = [beside_a_hut(x, "false") for x in (8, 9)]
    for _ in range(120):
        maps = [env.step([0.3, 0.0, 0.0])[0]["coverage"] for env in envs]
        x, y = envs[0].worlds.loop.state.batch.vehicles["reference_position"][0, 0]
        # 5 m: range of its sensor; the farthest corners are at y = 2 m
        seen = [np.hypot(left + 1.0 - x, 2.0 - y) <= 5.0 for left in (8, 9)]
        if any(seen):
            break
        assert np.array_equal(*maps)
    assert not np.array_equal(*maps)
    assert seen == [True, False]
    assert x > 3.5  # it starts at 3 m


def test_own_map_shows_the_buildings_on_which_the_uav_is_briefed() -> None:
    maps = [beside_a_hut(x, "true").step([0.3, 0.0, 0.0])[0]["coverage"] for x in (7, 8)]
    assert not np.array_equal(*maps)


def test_ground_under_known_buildings_counts_as_covered() -> None:
    """Nobody can ever see it, so it must not draw a law."""
    scenario = load_scenario("courtyard", overrides=["duration=2"])
    loop = ClosedLoop(scenario, 1)
    loop.begin([3])
    assert loop.pilots is not None
    own, desired = loop.pilots.state.uavs.coverage[0, 0], scenario.coverage.desired
    cell, house = scenario.area.cell, Polygon(scenario.building[0].polygon)
    rows, columns = np.indices(own.shape)
    under = contains_xy(house, (columns + 0.5) * cell, (rows + 0.5) * cell)
    assert under.sum() > 1000
    assert (own[under] == desired).all()
    assert not own[~under].any()
    assert np.array_equal(UavPilot(uav_briefing(scenario, "uav_0", 3)).coverage, own)


def weave(k: int) -> Any:
    """Return the action of a UAV that turns and climbs by the number of its calls."""
    return np.array([[0.1, 0.05 * (-1.0) ** (k // 20), 0.4 * (-1.0) ** (k // 15)]])


def test_a_policy_in_flight_sees_the_rows_of_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows: list[Any] = []

    def act(seen: Any) -> Any:
        rows.append(seen[0].copy())
        return weave(len(rows))

    module = ModuleType("weaving_policy_of_a_test")
    module.act = act  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    fly(town("law.name=policy", f"custom.uav_policy={module.__name__}:act"), 3)
    env = outrider.single_env(town(), end_on_sight_lost=False)
    seen, _ = env.reset(seed=3)
    for k, row in enumerate(rows):
        assert np.array_equal(seen, row)
        seen, *_ = env.step(weave(k + 1)[0])
    assert len({row[9] for row in rows}) > 50


@pytest.mark.parametrize("filtered", [True, False], ids=["filtered", "not filtered"])
def test_no_certified_ugv_hides_behind_real_buildings(
    filtered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two towns of `make wall-test`. Without the filter the adversaries hide the UGV and hit buildings."""
    monkeypatch.syspath_prepend(Path(__file__).parent / "acceptance")
    from walls import COUNTS, attack  # noqa: PLC0415 - from the folder above

    counts = attack(100_001, filtered) + attack(100_003, filtered)
    assert counts["runs that break the clearance"] == 0
    if filtered:
        assert not any(counts[name] for name in COUNTS)
        assert counts["certified ticks"] > 0.9 * counts["ticks"]
    else:
        assert counts["ticks behind a building"] > 1000
        assert counts["contacts"] > 100
