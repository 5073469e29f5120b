"""The ground: distances to hazards, contacts, and the map of tiles, against brute-force geometry."""

import itertools
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path

from bus.messages.ground import Hazard
from bus.registry import HAZARDS
from properties import PROPERTY
from sim.models.ground import CLEAR, UNSEEN, fill_tiles, state_at, tiles_shape
from sim.models.hazards import (
    BLOCK,
    FOUND,
    ROUGH,
    TOUCH,
    crosses_hazard,
    distance_to_hazard,
    hazard_at,
    point_in_hazard,
    rough_share,
)
from sim.scenario.ground_checks import hazards_have_a_shape
from sim.scenario.ground_tables import corners_of, hazard_rows
from sim.scenario.loading import load_scenario

ESCORT = load_scenario("escort")
GEOMETRY = settings(PROPERTY, max_examples=60)
SIDE, TILE = 6.0, 0.5
places = st.floats(-0.5, SIDE + 0.5)
points = st.tuples(places, places)
kinds = st.sampled_from(tuple(HAZARDS))


@st.composite
def discs(draw, kinds=kinds) -> Hazard:
    kind = draw(kinds)
    share = draw(st.floats(0.1, 1.0)) if kind == "rough" else None
    return Hazard(
        kind=kind, center=draw(points), radius=draw(st.floats(0.01, 2.5)), speed_share=share
    )


@st.composite
def stars(draw, kinds=kinds) -> Hazard:
    """Draw a simple polygon, mostly not convex: its corners surround one of its points."""
    x, y = draw(points)
    radii = draw(st.lists(st.floats(0.05, 2.5), min_size=3, max_size=9))
    turn, step = draw(st.floats(0.0, 6.28)), draw(st.sampled_from((1, -1)))
    angles = [turn + 2.0 * math.pi * n / len(radii) for n in range(len(radii))][::step]
    corners = tuple(
        (x + r * math.cos(angle), y + r * math.sin(angle))
        for r, angle in zip(radii, angles, strict=True)
    )
    return Hazard(kind=draw(kinds), polygon=corners)


grounds = st.lists(st.one_of(discs(), stars()), min_size=1, max_size=5).map(tuple)


def tables(hazards) -> tuple[np.ndarray, np.ndarray]:
    return hazard_rows(hazards), corners_of(hazards)


def filled(hazards, tile: float = TILE) -> np.ndarray:
    tiles = np.full(tiles_shape(SIDE, SIDE, tile), UNSEEN, dtype=np.uint8)
    fill_tiles(*tables(hazards), tile, tiles)
    return tiles


def contains(hazard: Hazard, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return True where points lie in the hazard, by another method."""
    if hazard.center is not None:
        return np.hypot(x - hazard.center[0], y - hazard.center[1]) <= hazard.radius
    return Path([*hazard.polygon, hazard.polygon[0]]).contains_points(np.stack([x, y], axis=-1))


@given(st.one_of(discs(), stars()), points)
@GEOMETRY
def test_hazard_distance_is_that_to_its_nearest_edge_point(hazard, point):
    found = distance_to_hazard(*tables((hazard,)), 0, *point)
    if hazard.center is not None:
        angle = np.linspace(0.0, 2.0 * np.pi, 4001)
        edge = np.array(hazard.center) + hazard.radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    else:
        corners = np.array([*hazard.polygon, hazard.polygon[0]])
        shares = np.linspace(0.0, 1.0, 1001)[:, None]
        edge = np.concatenate([a + shares * (b - a) for a, b in itertools.pairwise(corners)])
    near = float(np.hypot(*(edge - point).T).min())
    if near < 1e-6:
        return  # samples cannot decide on the edge
    if contains(hazard, *np.array(point)[:, None])[0]:
        assert found == 0.0
        assert point_in_hazard(*tables((hazard,)), 0, *point)
    else:
        assert 0.0 < found <= near + 1e-12 <= found + 0.01
        assert not point_in_hazard(*tables((hazard,)), 0, *point)


@given(grounds, points)
@GEOMETRY
def test_what_is_at_a_point_is_the_best_of_all(hazards, point) -> None:
    rows, corners = tables(hazards)
    away = [distance_to_hazard(rows, corners, k, *point) for k in range(len(hazards))]
    shares = [h.kept_share for h, d in zip(hazards, away, strict=True) if d == 0.0]
    assert rough_share(rows, corners, *point) == min(shares, default=1.0)
    for name, row in HAZARDS.items():
        mine = [(d, k) for k, d in enumerate(away) if hazards[k].kind == name]
        there = [k for d, k in mine if d == 0.0]
        assert hazard_at(rows, corners, row.code, *point) == min(there, default=-1)


@given(grounds, points, points)
@GEOMETRY
def test_path_meets_the_first_hazard_that_its_points_meet(hazards, start, end) -> None:
    rows, corners = tables(hazards)
    found, share = crosses_hazard(rows, corners, BLOCK, start, end)
    shares = np.linspace(0.0, 1.0, 2001)
    path = np.array(start) + shares[:, None] * (np.array(end) - np.array(start))
    blocking = [h for h in hazards if h.kind == "block"]
    met = np.any([contains(h, *path.T) for h in blocking], axis=0) if blocking else np.zeros(2001)
    if met.any():
        first = shares[met.argmax()]
        assert share <= first + 1e-9
        assert rows[found]["kind"] == BLOCK
    if found >= 0:
        at = np.array(start) + share * (np.array(end) - np.array(start))
        assert distance_to_hazard(rows, corners, found, *at) < 1e-7
        assert not met[shares < share - 1e-6].any()
    else:
        assert share == math.inf


THIN = Hazard(kind="block", polygon=((2.0, 0.0), (2.002, 0.0), (2.002, 4.0), (2.0, 4.0)))
ROUND = Hazard(kind="block", center=(2.0, 2.0), radius=1.0)


@pytest.mark.parametrize(
    ("hazard", "kind", "start", "end", "share"),
    [
        (THIN, BLOCK, (1.0, 1.0), (3.0, 1.5), 0.5),
        (THIN, BLOCK, (1.0, 4.0), (3.0, 4.0), 0.5),
        (THIN, ROUGH, (1.0, 1.0), (3.0, 1.5), math.inf),
        (ROUND, BLOCK, (0.0, 3.0), (4.0, 3.0), 0.5),
        (ROUND, BLOCK, (2.0, 2.0), (2.0, 2.0), 0.0),
        (ROUND, BLOCK, (0.0, 2.0), (1.0, 2.0), 1.0),
    ],
)
def test_thin_and_touched_hazards_are_never_jumped(hazard, kind, start, end, share) -> None:
    found, met = crosses_hazard(*tables((hazard,)), kind, start, end)
    assert (found, met) == (-1 if math.isinf(share) else 0, pytest.approx(share, abs=1e-3))


@given(grounds, st.sampled_from((0.7, 0.5, 2.0)))
@settings(GEOMETRY, max_examples=30)
def test_tiles_have_the_state_of_their_hazards_alone(hazards, tile):
    tiles = filled(hazards, tile)
    rows, corners = tables(hazards)
    share = np.linspace(0.0, 1.0, 9)
    rank = {CLEAR: 0, FOUND: 1, ROUGH: 2, BLOCK: 3}
    codes = [HAZARDS[h.kind].code for h in hazards]
    for (i, j), state in np.ndenumerate(tiles):
        x, y = (axis.ravel() for axis in np.meshgrid((j + share) * tile, (i + share) * tile))
        on = [code for h, code in zip(hazards, codes, strict=True) if contains(h, x, y).any()]
        assert rank[int(state)] >= max((rank[code] for code in on), default=0)
        if state != CLEAR:
            middle = (j + 0.5) * tile, (i + 0.5) * tile
            mine = [k for k, code in enumerate(codes) if code == state]
            near = min(distance_to_hazard(rows, corners, k, *middle) for k in mine)
            assert near <= tile * math.sqrt(0.5) + 2 * TOUCH
            if near > tile * 0.5 - 1e-6:  # it may touch at a corner at most
                samples = itertools.product(mine, zip(x, y, strict=True))
                near = min(distance_to_hazard(rows, corners, k, *at) for k, at in samples)
                assert near <= tile / 8 * math.sqrt(0.5) + 2 * TOUCH


@given(grounds, st.lists(points, min_size=20, max_size=20))
@GEOMETRY
def test_where_a_tile_is_clear_no_point_touches_a_hazard(hazards, tried) -> None:
    tiles, (rows, corners) = filled(hazards), tables(hazards)
    for x, y in tried:
        if 0.0 <= x <= SIDE and 0.0 <= y <= SIDE:
            state = state_at(tiles, TILE, x, y)
            if state != BLOCK:
                assert hazard_at(rows, corners, BLOCK, x, y) < 0
            if state in (CLEAR, FOUND):
                assert rough_share(rows, corners, x, y) == 1.0
            if state == CLEAR:
                assert hazard_at(rows, corners, FOUND, x, y) < 0


def test_hazard_reaching_a_tile_edge_touches_the_tile() -> None:
    tiles = filled((Hazard(kind="block", center=(1.25, 1.25), radius=0.25),))
    assert sorted(zip(*np.nonzero(tiles == BLOCK), strict=True)) == [
        (1, 2), (2, 1), (2, 2), (2, 3), (3, 2)
    ]  # fmt: skip
    square = ((1.0, 1.0), (1.5, 1.0), (1.5, 1.5), (1.0, 1.5))
    tiles = filled((Hazard(kind="rough", polygon=square),))
    assert (tiles[1:4, 1:4] == ROUGH).all()
    assert (tiles == ROUGH).sum() == 9
    assert set(np.unique(filled(()))) == {CLEAR}


def test_last_tiles_include_the_far_edge_of_the_area() -> None:
    assert tiles_shape(6.0, 3.1, 0.5) == (7, 12)
    assert tiles_shape(0.3 * 3, 0.1 * 3, 0.1) == (3, 9)  # 0.1 * 3 is more than 0.3
    tiles = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert state_at(tiles, 1.0, 4.0, 3.0) == 11
    assert state_at(tiles, 1.0, 0.0, 0.0) == 0
    assert state_at(tiles, 1.0, 2.0, 1.0) == 6


# Refusals


def faults(*hazards) -> list[str]:
    s = msgspec.structs.replace(ESCORT, hazard=hazards)
    return [fault.wrong for fault in hazards_have_a_shape(s)]


@given(st.integers(4, 40), st.integers(0, 39), st.floats(0.0, 6.0))
@GEOMETRY
def test_swapped_corners_make_a_convex_polygon_cross_itself(count, n, turn) -> None:
    angles = turn + 2.0 * np.pi * np.arange(count) / count
    corners = [(3.0 + math.cos(a), 3.0 + math.sin(a)) for a in angles]
    assert faults(Hazard(kind="rough", polygon=tuple(corners))) == []
    n %= count - 1
    corners[n], corners[n + 1] = corners[n + 1], corners[n]
    (wrong,) = faults(Hazard(kind="rough", polygon=tuple(corners)))
    assert wrong.startswith("crosses itself: the sides from corners")


@given(stars(st.just("rough")), st.integers(-12, -3), st.floats(0.0, 7.0), st.integers(0, 3))
@GEOMETRY
def test_a_simple_ring_that_closes_but_for_rounding_is_accepted(
    star, exponent, angle, repeated
) -> None:
    x, y = star.polygon[0]
    off = 10.0**exponent
    closing = (x + off * math.cos(angle), y + off * math.sin(angle))
    corners = list(star.polygon)
    corners.insert(repeated % len(corners), corners[repeated % len(corners)])
    ring = Hazard(kind="rough", polygon=(*corners, closing))
    assert faults(ring) == []
    assert ring.corners == star.polygon


@pytest.mark.parametrize(
    "corners",
    [
        [(1, 1), (3, 1), (3, 3), (2, 1), (1, 3)],  # a corner on another side
        [(1, 1), (3, 1), (2, 1), (2, 3)],  # back on itself
        [(1, 1), (3, 1), (3, 3), (1, 1), (1, 3), (0, 3)],  # one corner twice
        [(1, 1), (3, 1), (4, 1), (3.5, 1), (2, 2)],
    ],
)
def test_sides_that_meet_but_at_their_corners_are_refused(corners) -> None:
    (wrong,) = faults(Hazard(kind="rough", polygon=tuple(corners)))
    assert wrong.startswith("crosses itself")


def test_ten_thousand_hazards_of_a_file_are_read_and_checked():
    discs = [
        {"kind": "block", "center": [k % 100 * 0.4, 30.0 + k // 100 * 0.1], "radius": 0.1}
        for k in range(9_900)
    ]
    fields = [{"kind": "block", "count": 40, "radius": [0.2, 0.4]}]
    scenario = load_scenario("escort", overrides={"hazard": discs, "hazard_field": fields})
    assert len(scenario.hazard) == 9_900
    assert scenario.has_ground
