"""Buildings in scenarios: the shipped ones, random towns, and what vehicles are briefed on."""

import itertools
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from bus.messages.buildings import AltitudeLimits, Building, Camera
from bus.messages.ground import Hazard
from properties import PROPERTY
from refusals import refusal
from sim.engine.briefing import briefing
from sim.models.buildings import tables_of
from sim.models.ground import CLEAR, add_polygon, fill_tiles, tile_index, tiles_shape
from sim.models.hazards import BLOCK
from sim.scenario.building_tables import max_building_height
from sim.scenario.checks import check_scenario
from sim.scenario.loading import load_scenario
from sim.scenario.types import BuildingField, Buildings, Ground, HazardField, Scenario
from sim.scenario.vehicle_types import Uav, Ugv
from sim.world import World
from towns import HOUSE, UNKNOWN_MAP, as_reported, distances, drawn, scenario

SECRET = bytes(range(16)).hex()
PLACES = st.tuples(st.floats(0.5, 39.5), st.floats(0.5, 39.5))


# The shipped ones


@pytest.mark.parametrize("name", ["town", "rescue-town", "courtyard"])
def test_shipped_towns_leave_four_metres_of_sight(name: str) -> None:
    """The walls of the courtyard may hide the UGV."""
    briefed = briefing(load_scenario(name), "uav_0", 7)
    z, h_m = briefed.altitude.initial_altitude, briefed.marker_height
    occlusion = briefed.guaranteed_clearance * (z - h_m) / (briefed.max_building_height - h_m)
    seen = min(briefed.visibility_radius, (z - h_m) * math.tan(briefed.camera.half_angle))
    assert seen >= 4.0
    assert (occlusion < 0.5 * seen) if name == "courtyard" else (occlusion >= 4.0)


def a_ring(x: float, y: float, corners: int) -> dict[str, Any]:
    turns = [2.0 * math.pi * n / corners for n in range(corners)]
    return {"polygon": [[x + math.cos(turn), y + math.sin(turn)] for turn in turns], "height": 9.0}


def test_a_thousand_buildings_fit_into_a_briefing_and_no_more() -> None:
    area = {"width": 410.0, "height": 300.0, "cell": 0.5}
    places = list(itertools.product(range(5, 405, 10), range(15, 265, 10)))
    given = {"area": area, "uav": [], "building": [a_ring(x, y, 10) for x, y in places]}
    loaded = load_scenario("escort", overrides=given)
    assert len(loaded.building) == 1000
    assert len(msgspec.json.encode(briefing(loaded, "ugv_0", 0))) < 1 << 19
    given["building"][7] = a_ring(*places[7], 11)
    line = refusal(overrides=given)
    assert line.endswith("makes 10,001 corners in total; allowed: up to 10,000 in total")


# Random towns


@pytest.fixture(scope="module")
def town() -> Scenario:
    return load_scenario("town")


def test_a_town_is_a_function_of_seed_and_secret(town: Scenario) -> None:
    assert drawn(town, 3) == drawn(town, 3)
    others = {drawn(town, 3), drawn(town, 4), drawn(town, 3, SECRET)}
    assert len(others) == 3
    fast = msgspec.structs.replace(town, dt=0.1, hazard=(), title="another")
    assert drawn(fast, 3) == drawn(town, 3)


def test_towns_keep_sides_heights_streets_and_share() -> None:
    field = BuildingField(block=(3.0, 5.0), street=4.0, height=(3.0, 9.0), share=0.7)
    one = scenario(Ugv(position=(1.0, 1.0)), building=(), building_field=(field,))
    built, possible = 0, 0
    for seed in range(60):
        boxes = np.array([[*low, *high] for low, high in (one.bounds for one in drawn(one, seed))])
        sides = boxes[:, 2:] - boxes[:, :2]
        assert sides.min() > 3.0 - 1e-9
        assert sides.max() < 5.0 + 1e-9
        assert all(3.0 <= building.height <= 9.0 for building in drawn(one, seed))
        assert boxes.min() >= 4.0 - 1e-9
        assert boxes.max() <= 36.0 + 1e-9
        left, low, right, high = boxes.T
        gap = np.maximum(left[:, None] - right, low[:, None] - high)
        gap = np.maximum(gap, gap.T) + np.diag(np.full(len(boxes), np.inf))
        assert gap.min() > 4.0 - 1e-9
        built += len(boxes)
        possible += len(set(left)) * len(set(low))
    assert built / possible == pytest.approx(0.7, abs=0.05)


def assert_open(tiles: np.ndarray, tile: float, ugv: Ugv) -> None:
    """Check that all goals can be reached over tiles that are not blocked."""
    regions, _ = label(tiles != BLOCK)
    found = {
        int(regions[tile_index(y, tile, len(tiles)), tile_index(x, tile, len(tiles[0]))])
        for x, y in (ugv.position, *ugv.goals)
    }
    assert len(found) == 1
    assert 0 not in found


@given(
    st.integers(0, 2**32),
    st.lists(PLACES, min_size=2, max_size=5),
    st.floats(0.0, 2.0),
    st.sampled_from([0.25, 0.4, 0.5, 1.0]),
    st.floats(0.0, 3.0),
    st.sampled_from([0.0, 2.5]),
    st.booleans(),
)
@settings(PROPERTY, max_examples=120)
def test_narrow_streets_around_given_walls_stay_open(
    seed, places, clearance, tile, extra, clear, known
):
    """Given buildings leave one gap; two fields fill the rest as far as they may.

    Tiles near unknown buildings open only once all tiles within the clearance are reported as clear.
    """
    start, *goals = places
    ugv = Ugv(position=start, goals=tuple(goals), building_clearance=clearance)
    tiles_to_stop = 1.5 if known or clearance == 0.0 else 3.0
    least = clearance + tiles_to_stop * tile
    street = 2.0 * least + extra
    sizes = {"block": (1.0, 6.0), "street": street, "height": (3.0, 5.0)}
    field = BuildingField(**sizes, share=1.0, clearance=clear)
    wall = ((19.0, 0.0), (21.0, 0.0), (21.0, 34.0), (19.0, 34.0))
    one = Scenario(
        ugv=(ugv,),
        building=(Building(polygon=wall, height=4.0),),
        building_field=(field, msgspec.structs.replace(field, share=0.9)),
        ground=Ground(tile=tile),
        buildings=Buildings(known=known),
    )
    if min(distances(one.building, x, y)[0] for x, y in places) < least:
        return
    buildings = drawn(one, seed)
    away = [distance for x, y in places for distance in distances(buildings[1:], x, y)]
    assert min(away, default=math.inf) >= max(clearance, clear) - 1e-9
    tiles = np.full(tiles_shape(one.area.width, one.area.height, tile), CLEAR, np.uint8)
    fill_tiles(*tables_of(buildings), tile, tiles)
    if known:
        for building in buildings:
            add_polygon(np.array(building.corners), clearance, BLOCK, tile, tiles)
    else:
        tiles = as_reported(tiles, clearance / tile)
    assert_open(tiles, tile, ugv)


def test_blocks_stay_away_from_given_hazards_and_starts_of_uavs() -> None:
    field = BuildingField(block=(3.0, 5.0), street=4.0, height=(3.0, 9.0), share=1.0, clearance=3.0)
    disc = Hazard(kind="block", center=(30.0, 30.0), radius=1.0)
    uav = Uav(position=(9.0, 9.0), initial_altitude=14.0)
    ugv = Ugv(position=(9.0, 10.0))
    one = scenario(ugv, uav=(uav,), building=(), building_field=(field,), hazard=(disc,))
    for seed in range(30):
        buildings = drawn(one, seed)
        assert min(distances(buildings, 30.0, 30.0)) >= 5.0 - 1e-9
        assert min(distances(buildings, 9.0, 9.0)) >= 3.0


def test_hazards_among_buildings_leave_a_route(town: Scenario) -> None:
    mines = HazardField(kind="block", count=40, radius=(0.3, 0.6))
    one = check_scenario(msgspec.structs.replace(town, hazard_field=(mines,)))
    for seed in range(10):
        world = World(one, seed)
        closed = world.tiles.copy()
        for building in drawn(one, seed):
            add_polygon(np.array(building.corners), 1.5, BLOCK, 0.5, closed)
        assert_open(closed, one.ground.tile, one.ugv[0])
        assert (world.ground.hazards["kind"][0, -40:] == BLOCK).all()


# What vehicles are briefed on


def test_altitudes_and_bounds_are_in_the_briefing_of_a_uav() -> None:
    one = load_scenario("town", overrides={"ugv.0.marker_height": 0.5, "altitude.law": "best"})
    told = briefing(one, "uav_0", 1)
    assert told.altitude == AltitudeLimits(
        initial_altitude=14.0, min_altitude=12.0, max_altitude=16.0, law="best"
    )
    assert told.camera == Camera() == one.camera
    assert (told.marker_height, told.guaranteed_clearance) == (0.5, 1.5)
    assert told.max_building_height == max_building_height(one) == 5.0
    declared = load_scenario("town", overrides={"certificate.max_building_height": 7.0})
    assert briefing(declared, "uav_0", 1).max_building_height == 7.0
    assert briefing(one, "ugv_0", 1).ground.building_clearance == 1.5
    unknown = load_scenario("town", overrides=UNKNOWN_MAP)
    ground = briefing(unknown, "ugv_0", 1).ground
    assert (ground.building_clearance, ground.tile_clearance) == (1.0, 1.0)
    planar = briefing(load_scenario("minefield"), "uav_0", 1)
    assert (planar.altitude, planar.camera, planar.max_building_height) == (None, None, None)
    assert planar.buildings == ()


@pytest.mark.parametrize("secret", ["", SECRET])
def test_maps_show_what_their_vehicle_may_know(town: Scenario, secret: str) -> None:
    """Blocks of a field stay clear of the goals, which no UAV may know: it gets the given buildings only."""
    unknown = load_scenario("town", overrides=UNKNOWN_MAP)
    given = msgspec.structs.replace(town, building=(HOUSE,))
    assert briefing(given, "uav_0", 5, secret).buildings == (HOUSE,)
    assert briefing(town, "uav_0", 5, secret).buildings == ()
    assert briefing(town, "ugv_0", 5, secret).buildings == drawn(town, 5, secret)
    for name in ("uav_0", "ugv_0"):
        hidden = briefing(unknown, name, 5, secret)
        assert hidden.buildings == ()
        assert b"polygon" not in msgspec.json.encode(hidden)
    assert not briefing(unknown, "ugv_0", 5).ground.only_buildings
    assert briefing(unknown, "uav_0", 5).max_building_height == 5.0


def test_map_reveals_neither_random_hazards_nor_goals(town: Scenario) -> None:
    mines = HazardField(kind="block", count=9, radius=(0.3, 0.6))
    mined = check_scenario(msgspec.structs.replace(town, hazard_field=(mines,)))
    told, other = (briefing(one, "uav_0", 5) for one in (town, mined))
    assert told == other
    assert not briefing(mined, "ugv_0", 5).ground.only_buildings
    world = World(mined, 5)
    text = msgspec.json.encode(briefing(mined, "ugv_0", 5)).decode()
    for row in world.ground.hazards[0][world.ground.hazards["radius"][0] > 0.0]:
        assert repr(float(row["x"])) not in text
    (ugv,) = town.ugv  # a goal in a street moves no building
    moved = msgspec.structs.replace(ugv, goals=(*ugv.goals[:1], (2.0, 37.0)))
    assert briefing(msgspec.structs.replace(town, ugv=(moved,)), "uav_0", 5) == told
