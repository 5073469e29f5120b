"""UGVs among buildings: the tiles of their map, contact, and the distance that a cautious UGV keeps."""

import itertools
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.drivers.compiled import briefed_grid, update_grid
from bus.messages.buildings import Building
from bus.messages.ground import Hazard, MapUpdate, TileReport
from bus.messages.vehicle import UgvObservation
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.running.flying import fly
from properties import PROPERTY
from sim.engine.briefing import briefing
from sim.models.ground import CLEAR, UNSEEN, add_polygon
from sim.models.hazards import BLOCK
from sim.scenario.checks import check_scenario, scenario_warnings
from sim.scenario.clearance import guaranteed_clearance
from sim.scenario.ground_types import HazardField
from sim.scenario.loading import load_scenario
from sim.scenario.types import Ground, Scenario
from sim.scenario.vehicle_types import Uav, Ugv
from sim.scene.ground_map import KNOWN, UNKNOWN, ground_map
from sim.world import World
from test_ground_flights import assert_batch_flies_alike
from towns import HOUSE, PASSING, UNKNOWN_MAP, as_reported, distances, drawn, scenario

PLACES = st.tuples(st.floats(0.5, 39.5), st.floats(0.5, 39.5))


@pytest.fixture(scope="module")
def town() -> Scenario:
    return load_scenario("town")


ABOVE = Uav(position=(7.0, 8.8), initial_altitude=9.0)


def pushed(one: Scenario, u_x: float, u_y: float, ticks: int = 400) -> World:
    """The world after its UGV has driven under a constant command, below a UAV at rest."""
    world = World(one, 1)
    for _ in range(ticks):
        world.step(np.array([[0.0, 0.0], [u_x, u_y]]))
    return world


def near_building(one: Scenario, seeds: int = 1) -> list[int]:
    """The simulator's counter after the flight with each seed, in which every UGV arrives."""
    loop = ClosedLoop(one, seeds, threads=1, end_on_sight_lost=False)
    loop.begin(list(range(seeds)))
    loop.fly()
    missions = [loop.mission(k) for k in range(seeds)]
    loop.close()
    assert all(one.arrived for one in missions)
    assert sum(one.ground_certificate_broken for one in missions) == 0
    counts = [one.guarantees["ugv_0"].near_building for one in missions]
    assert [one.near_building or 0 for one in missions] == counts
    return counts


# Tiles near a building

CORNERS = st.lists(st.floats(0.3, 2.5), min_size=3, max_size=8)


@given(CORNERS, st.floats(0.0, 6.3), PLACES, st.floats(0.0, 2.0))
@settings(PROPERTY, max_examples=20)
def test_tiles_near_a_polygon_are_those_within_the_distance(radii, turn, place, distance):
    angles = [turn + 2.0 * math.pi * n / len(radii) for n in range(len(radii))]
    x, y = 3.0 + place[0] / 20.0, 3.0 + place[1] / 20.0
    shape = tuple(
        (x + r * math.cos(a), y + r * math.sin(a)) for r, a in zip(radii, angles, strict=True)
    )
    tiles = np.full((16, 16), CLEAR, np.uint8)
    add_polygon(np.array(shape), distance, BLOCK, 0.5, tiles)
    building = (Building(polygon=shape, height=1.0),)
    grid = np.linspace(0.0, 0.5, 4)
    for row, column in itertools.product(range(16), range(16)):
        points = itertools.product(column * 0.5 + grid, row * 0.5 + grid)
        nearest = min(distances(building, *point)[0] for point in points)
        if tiles[row, column] == CLEAR:
            assert nearest > distance
        else:
            assert nearest <= distance + 0.5 * math.hypot(grid[1], grid[1])


# The map of a UGV


def test_ugv_knows_all_tiles_if_buildings_are_the_only_hazards() -> None:
    find = Hazard(kind="find", center=(30.0, 30.0), radius=0.3)
    for one, others in ((scenario(), CLEAR), (scenario(hazard=(find,)), UNSEEN)):
        grid = briefed_grid(briefing(one, "ugv_0", 0))
        rows, columns = np.nonzero(grid.tiles == BLOCK)
        # 1.5 m more than the house on each side; tiles are closed, so that one more row is touched
        assert (rows.min(), rows.max(), columns.min(), columns.max()) == (16, 31, 16, 31)
        assert set(np.unique(grid.tiles)) == {BLOCK, others}
        assert grid.tiles[16, 16] == others  # rounded at the corners
    unknown = scenario(buildings={"known": False})
    assert (briefed_grid(briefing(unknown, "ugv_0", 0)).tiles == UNSEEN).all()


@given(
    st.integers(0, 2**32),
    st.sampled_from([0.0, 0.3, 0.5, 0.7, 1.0, 1.5]),
    st.floats(0.0, 1.0),
)
@settings(PROPERTY, max_examples=40)
def test_tiles_open_once_all_within_the_clearance_are_reported(seed, clearance, unseen):
    rng = np.random.default_rng(seed)
    ugv = msgspec.structs.replace(PASSING, building_clearance=clearance)
    grid = briefed_grid(briefing(scenario(ugv, buildings={"known": False}), "ugv_0", 0))
    letters = np.array(list(".~#*"))
    for _ in range(6):
        tiles = rng.choice(letters, size=64, p=[0.8, 0.08, 0.04, 0.08])
        tiles[rng.random(64) < unseen] = "?"
        column, row = rng.integers(0, 3, 2).tolist()
        block = MapUpdate(column=column, row=row, tiles="".join(tiles.tolist()))
        own = tuple(
            TileReport(row=row, column=column, state=str(rng.choice(letters)))
            for row, column in rng.integers(0, 24, (int(rng.integers(3)), 2)).tolist()
        )
        here = {"position": (7.0, 8.8), "velocity": (0.0, 0.0), "tile_reports": own}
        update_grid(grid, UgvObservation(tick=0, time=0.0, **here, map_updates=(block,)))
        assert (grid.tiles == as_reported(grid.reported, clearance / 0.5)).all()


def test_no_report_opens_a_tile_near_a_known_building() -> None:
    grid = briefed_grid(briefing(scenario(), "ugv_0", 0))
    before = grid.tiles.copy()
    reports = (TileReport(20, 17, "."), TileReport(0, 0, "."))
    block = MapUpdate(column=2, row=2, tiles="." * 64)
    alarm = MapUpdate(column=0, row=0, tiles="#" * 64)
    own = {"position": (8.0, 8.8), "velocity": (0.0, 0.0), "tile_reports": reports}
    update_grid(grid, UgvObservation(tick=0, time=0.0, **own, map_updates=(block, alarm)))
    assert (grid.tiles == before).all()


def test_observers_see_buildings_that_are_known_from_the_start() -> None:
    given = {"uav": (ABOVE,), "hazard": (Hazard(kind="find", center=(30.0, 30.0), radius=0.3),)}
    shown = {}
    for known in (True, False):
        told = ground_map(World(scenario(**given, buildings={"known": known}), 1))
        assert [hazard.polygon for hazard in told.hazards] == [(), HOUSE.polygon]
        shown[known] = list(told.states), np.frombuffer(told.tiles, np.uint8)
    assert shown[True][0] == [UNKNOWN, KNOWN]
    assert shown[False][0] == [UNKNOWN, UNKNOWN]
    assert (shown[True][1] == BLOCK).sum() == 100  # the house touches 10 x 10 tiles
    assert (shown[False][1] != BLOCK).all()
    town = load_scenario("town")
    told = ground_map(World(town, 5))
    assert [h.polygon for h in told.hazards] == [one.polygon for one in drawn(town, 5)]
    assert set(told.tiles) == {CLEAR, BLOCK}


# Contact, and the declared clearance


def test_a_building_stops_a_ugv_whatever_a_touch_does() -> None:
    disc = Hazard(kind="block", center=(8.9, 12.0), radius=0.2)
    mine = Hazard(kind="block", center=(10.0, 12.0), radius=0.05)  # in its wall, touched first
    ugv = Ugv(position=(8.0, 12.0))
    hazards = {"hazard": (disc, mine), "ground": Ground(touch="damage")}
    one = scenario(ugv, uav=(ABOVE,), **hazards)
    world = pushed(one, 0.1, 0.0)
    assert world.position[1].tolist() == pytest.approx([10.0, 12.0])
    assert world.velocity[1].tolist() == [0.0, 0.0]
    assert world.mission.hazards_hit == 3
    away = pushed(one, -0.1, 0.0)
    assert away.position[1, 0] < 5.0
    assert away.mission.hazards_hit == 0


def test_waypoints_driver_that_cuts_a_corner_is_counted() -> None:
    assert near_building(scenario()) > [100]
    far = msgspec.structs.replace(PASSING, position=(7.0, 8.2), goals=((17.0, 8.2),))
    assert near_building(scenario(far)) == [0]
    none = msgspec.structs.replace(PASSING, building_clearance=0.0)
    assert near_building(scenario(none)) == [0]


def test_a_building_too_near_between_two_ticks_is_counted() -> None:
    """The UGV drives 0.5 m per tick, past the tip of a building in 0.1 m; it keeps 0.2 m at every tick."""
    tip = Building(polygon=((8.0, 12.0), (7.0, 9.1), (6.0, 12.0)), height=5.0)
    ugv = Ugv(position=(5.0, 9.0), max_speed=10.0, max_acceleration=200.0, building_clearance=0.2)
    world = World(scenario(ugv, building=(tip,)), 1)
    places = []
    for _ in range(10):
        world.step(np.array([[200.0, 0.0]]))
        places.append(distances((tip,), *world.position[0])[0])
    assert world.velocity[0].tolist() == [10.0, 0.0]
    assert min(places) > 0.2
    assert world.mission.guarantees["ugv_0"].near_building == 1


def test_ugv_at_a_wall_is_visible_from_the_open_side() -> None:
    wall = Building(polygon=((5.0, 7.0), (15.0, 7.0), (15.0, 20.0), (5.0, 20.0)), height=10.0)
    for x, y, radius in ((10.0, 5.0, 4.75), (10.0, 8.0, 0.0), (10.0, 7.0, 4.75)):
        uav = Uav(position=(x, y), initial_altitude=14.0, max_altitude=20.0)
        one = scenario(Ugv(position=(10.0, 6.0)), uav=(uav,), building=(wall,))
        world = pushed(one, 0.0, 0.1)
        assert world.position[1].tolist() == pytest.approx([10.0, 7.0])
        assert world.velocity[1].tolist() == [0.0, 0.0]
        world.measure()
        assert world.vehicles["sight_radius"][0] == radius
        assert np.isfinite(world.detections).all() == (radius > 0.0)


@pytest.mark.parametrize("seeds", [10, pytest.param(50, marks=pytest.mark.long)])
def test_cautious_ugv_keeps_its_clearance_in_towns(town: Scenario, seeds: int) -> None:
    assert near_building(msgspec.structs.replace(town, uav=()), seeds) == [0] * seeds


@pytest.mark.parametrize("seeds", [4, pytest.param(50, marks=pytest.mark.long)])
def test_cautious_ugv_keeps_its_clearance_in_unknown_towns(seeds: int) -> None:
    """Its UAV is certified all the time, without a map of either vehicle."""
    mines = HazardField(kind="block", count=30, radius=(0.2, 0.4))
    town = load_scenario("town", overrides={**UNKNOWN_MAP, "duration": 1200.0})
    one = check_scenario(msgspec.structs.replace(town, hazard_field=(mines,)))
    assert near_building(one, seeds) == [0] * seeds
    assert fly(msgspec.structs.replace(one, duration=60.0), 1)[1].certified_share == 1.0


def test_cautious_ugvs_of_the_other_shipped_scenarios_keep_it() -> None:
    courtyard = load_scenario("courtyard", overrides=["uav=[]"])
    assert near_building(courtyard) == [0]
    mission = fly(load_scenario("rescue-town"), 1)[1].mission  # on tiles that its UAV reports
    assert mission is not None
    assert mission.guarantees["ugv_0"].near_building == 0


def test_cautious_ugv_keeps_its_clearance_around_its_path() -> None:
    """Straight paths would lead past the house in less, and through it."""
    goals = ((17.0, 8.2), (7.0, 12.0), (17.0, 12.0))
    ugv = Ugv(position=(7.0, 12.0), goals=goals, building_clearance=1.5, driver="navigate")
    assert near_building(scenario(ugv, duration=350.0)) == [0]


def test_clearance_is_warned_of_unless_it_is_kept() -> None:
    def warned(**changes: Any) -> bool:
        one = load_scenario("town", overrides=changes)
        return any("building_clearance = 1.5: not ensured" in x for x in scenario_warnings(one))

    unknown = {**UNKNOWN_MAP, "building_field.0.street": 6.0, "ugv.0.building_clearance": 1.5}
    assert not warned()
    assert not warned(**unknown)
    for changes in ({"ugv.0.caution": "bold"}, {"ugv.0.driver": "wander"}):
        assert warned(**changes)
    assert warned(**unknown, **{"ground.miss": 0.1})
    assert warned(**unknown, **{"ground.false_alarm": 0.1})


def test_clearance_from_mapped_buildings_needs_no_misses() -> None:
    """If buildings are the only hazards, the map is complete: there is nothing to miss."""
    mines = HazardField(kind="block", count=30, radius=(0.2, 0.4))
    for hazard_field, miss, ensured in (
        ((), 0.1, True),
        ((mines,), 0.0, True),
        ((mines,), 0.1, False),
    ):
        town = load_scenario("town", overrides={"ground.miss": miss})
        one = check_scenario(msgspec.structs.replace(town, hazard_field=hazard_field))
        warned = any("not ensured (A9)" in x for x in scenario_warnings(one))
        assert warned != ensured
        assert (guaranteed_clearance(one, one.ugv[0]) > 0.0) == ensured


def test_ugv_waiting_beside_unknown_building_gives_a_warning() -> None:
    for sensing, told in ((1.9, True), (2.0, False)):
        changes = {**UNKNOWN_MAP, "ground.sensing_range": sensing}
        warnings = scenario_warnings(load_scenario("town", overrides=changes))
        assert any("may wait forever beside an unknown building" in x for x in warnings) == told
    others = load_scenario("town", overrides={**UNKNOWN_MAP, "ugv.0.driver": "waypoints"})
    assert not any("may wait forever" in x for x in scenario_warnings(others))


def test_legs_through_a_given_building_are_warned_of() -> None:
    ugv = Ugv(position=(8.0, 12.0), goals=((16.0, 12.0),))
    (line,) = scenario_warnings(scenario(ugv))
    assert "its leg from position to goals.0 crosses building.0" in line


def test_a_town_has_one_trajectory_in_run_and_batch(town: Scenario) -> None:
    """Without its UAV, whose altitude a batch refuses; tests/test_altitude.py flies that over processes."""
    short = msgspec.structs.replace(town, duration=20.0, uav=())
    assert_batch_flies_alike(short, fly(short, 4)[0])
