"""Random hazards: allowed positions, as many as fit, and never across the last open route."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from properties import PROPERTY
from seeded import a_key
from sim.compiling.records import records
from sim.engine.run_keys import derive_keys
from sim.models.ground import CLEAR, add_disc, fill_tiles, tile_index, tiles_shape
from sim.models.hazard_fields import MOST_MISSES, HazardFieldRow, place_hazards
from sim.models.hazards import BLOCK, FOUND, ROUGH, HazardRow
from sim.models.randomness import HAZARD_FIELDS, HAZARD_PLACE, draw, key_of
from sim.scenario.ground_tables import ground_tables, place_fields
from sim.scenario.loading import load_scenario

TILE = 0.5
AREA = (7.0, 5.0)
SHAPE = tiles_shape(*AREA, TILE)
NO_CORNERS = np.zeros((0, 2))
places = st.tuples(st.floats(0.0, AREA[0]), st.floats(0.0, AREA[1]))


def tile_of(point) -> tuple[int, int]:
    return tile_index(point[1], TILE, SHAPE[0]), tile_index(point[0], TILE, SHAPE[1])


def route_tiles(*routes) -> np.ndarray:
    tiles = [(tile_of(start), tile_of(goal)) for start, *goals in routes for goal in goals]
    return np.array([(*a, *b) for a, b in tiles], dtype=np.int64)


def field(
    kind: int, count: int, radius=(0.2, 0.7), clear: float = 0.0, kept: float = 0.0
) -> HazardFieldRow:
    share = 0.5 if kind == ROUGH else 1.0
    return HazardFieldRow(kind, count, *radius, share=share, clear=clear, kept=kept)


def place(fields, routes, key, given=()) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the table, the tiles, and the first empty row."""
    room = sum(one.discs for one in fields)
    hazards = records(HazardRow, [*given, *[HazardRow(9, *[0.0] * 5, 0, 0)] * room])
    tiles = np.zeros(SHAPE, dtype=np.uint8)
    fill_tiles(hazards[: len(given)], NO_CORNERS, TILE, tiles)
    points = np.array([point for route in routes for point in route])
    wanted, tiles_of_routes = records(HazardFieldRow, fields), route_tiles(*routes)
    ground = hazards, len(given), tiles
    behind = place_hazards(wanted, points, tiles_of_routes, AREA, TILE, key, *ground)
    return hazards, tiles, behind


def enlarged(hazards: np.ndarray, kept: float) -> np.ndarray:
    """Return the tiles that the hazards touch, enlarged by a distance [m]."""
    tiles = np.zeros(SHAPE, dtype=np.uint8)
    for one in hazards:
        add_disc(one["x"], one["y"], one["radius"] + kept, BLOCK, TILE, tiles)
    return tiles


def is_open(tiles: np.ndarray, routes) -> bool:
    """Return whether every route is open from tile to tile, by filling the free ground."""
    regions, _ = label(tiles != BLOCK)
    return all(
        regions[tile_of(route[0])] == regions[tile_of(point)] > 0
        for route in routes
        for point in route
    )


def one_by_one(fields, routes, key) -> list[tuple[float, ...]]:
    """Place the same discs, and check each by filling the free ground around all of them."""
    kept: list[HazardRow] = []
    tiles = np.full(SHAPE, CLEAR, dtype=np.uint8)
    for f, one in enumerate(fields):
        placed = last = 0
        for attempt in itertools.count():
            if placed == one.discs or attempt - last == MOST_MISSES:
                break
            u, v, w = (
                (int(word) >> 11) * 2.0**-53 for word in draw(key, HAZARD_PLACE, f, attempt)[:3]
            )
            radius = one.smallest + w * (one.largest - one.smallest)
            x, y = u * AREA[0], v * AREA[1]
            near = min(np.hypot(x - p[0], y - p[1]) for route in routes for p in route)
            if near < radius + one.clear:
                continue
            if tiles[tile_of((x, y))] in (BLOCK, one.kind):
                continue
            new = HazardRow(one.kind, one.share, x, y, radius, radius, 0, 0)
            alone, after = np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8)
            fill_tiles(records(HazardRow, [new]), NO_CORNERS, TILE, alone)
            fill_tiles(records(HazardRow, [*kept, new]), NO_CORNERS, TILE, after)
            hidden = tiles[alone != CLEAR]
            if FOUND in hidden or (one.kind == FOUND and (hidden != CLEAR).any()):
                continue
            if is_open(after, routes):
                kept, tiles, placed, last = [*kept, new], after, placed + 1, attempt + 1
    return [tuple(row) for row in kept]


@given(st.integers(0, 2**32), places, places, places, places)
@settings(PROPERTY, max_examples=8)
def test_discs_match_a_fill_of_the_ground_for_each(seed, a, b, c, d):
    fields = [field(BLOCK, 12, clear=0.4), field(FOUND, 5), field(ROUGH, 8), field(BLOCK, 9)]
    routes, key = [[a, b, c], [d, a]], a_key(seed)
    hazards, tiles, behind = place(fields, routes, key)
    assert [tuple(row) for row in hazards[:behind].tolist()] == one_by_one(fields, routes, key)
    assert {FOUND, ROUGH} <= set(hazards["kind"][:behind].tolist())
    again = np.zeros(SHAPE, dtype=np.uint8)
    fill_tiles(hazards, NO_CORNERS, TILE, again)
    assert (tiles == again).all()


@given(
    st.integers(0, 2**32),
    st.lists(st.lists(places, min_size=2, max_size=4), min_size=1, max_size=3),
    st.floats(0.0, 1.0),
    st.sampled_from([0.0, 0.6]),
)
@settings(PROPERTY, max_examples=80)
def test_hazard_fields_keep_routes_open_and_clearance(seed, routes, clear, kept):
    fields = [field(BLOCK, 80, clear=clear, kept=kept)]
    hazards, tiles, behind = place(fields, routes, a_key(seed))
    assert is_open(tiles, routes)
    assert is_open(enlarged(hazards[:behind], kept), routes)
    assert (hazards["kind"] == np.where(np.arange(80) < behind, BLOCK, 0)).all()
    for point in itertools.chain(*routes):
        away = np.hypot(hazards["x"] - point[0], hazards["y"] - point[1]) - hazards["radius"]
        assert (away[:behind] >= clear - 1e-12).all()
    assert ((hazards["radius"] >= 0.2) & (hazards["radius"] <= 0.7))[:behind].all()


def test_a_wall_with_one_gap_keeps_its_gap() -> None:
    wall = [HazardRow(BLOCK, 1.0, 3.7, y, 0.1, 0.1, 0, 0) for y in np.arange(0.0, 5.0, 0.4)]
    wall = [row for row in wall if not 2.0 < row.y < 3.0]
    routes = [[(0.6, 2.5), (6.2, 2.5)]]
    for seed in range(30):
        _, tiles, behind = place([field(BLOCK, 60)], routes, a_key(seed), given=wall)
        assert is_open(tiles, routes)
        assert behind > len(wall) + 10


def test_each_seed_has_other_hazards_and_the_same_seed_the_same() -> None:
    def placed(seed: int) -> list[tuple[float, ...]]:
        key = key_of.py_func(derive_keys((seed,), 1)[0, :, 0], HAZARD_FIELDS)
        return place([field(BLOCK, 20)], [[(0.6, 0.6), (6.2, 4.4)]], key)[0].tolist()

    assert placed(1) == placed(1)
    assert not set(placed(1)) & set(placed(2))


def test_ten_thousand_hazards_leave_routes_open_on_a_large_map() -> None:
    s = load_scenario(
        "escort",
        overrides={
            "area": {"width": 160.0, "height": 160.0, "cell": 0.5},
            "hazard_field": [{"kind": "block", "count": 10_000, "radius": [0.2, 0.6]}],
        },
    )
    t = ground_tables(s)
    behind = place_fields(s, t, a_key(5))
    assert behind == 10_000
    regions, _ = label(t.tiles != BLOCK)
    ends = {regions[tuple(tile)] for route in t.routes for tile in (route[:2], route[2:])}
    assert len(ends) == 1
    assert 0 not in ends
    assert len(t.stops) == 1 + len(s.ugv[0].goals)
