"""Imported footprints contain every given wall, and are what a scenario accepts: shown for random towns."""

import math
from collections import Counter

import numpy as np
import pytest

pytest.importorskip("shapely", reason="the extra [geo] is not installed")
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Polygon, affinity

from bus.geodesy import geodetic, local
from bus.messages.buildings import MOST_BUILDING_CORNERS
from bus.messages.scenario import Origin
from outrider_geo import shapes
from outrider_geo.reading import Buildings, Outline
from outrider_geo.town import Options, Town, import_town
from sim.scenario.polygon_checks import first_contact, polygon_faults

CENTER = Origin(latitude=60.2, longitude=24.9, altitude=0.0)
SIDE = 60.0
"""Side of the area [m]; the buildings lie in and around it."""
BOX = shapely.box(0.0, 0.0, SIDE, SIDE)


def bowtie(width: float, depth: float) -> list[list[tuple[float, float]]]:
    return [[(0.0, 0.0), (width, depth), (width, 0.0), (0.0, depth)]]


def ring(width: float, depth: float) -> list[list[tuple[float, float]]]:
    outer = [(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)]
    inner = [(0.3 * width, 0.3 * depth), (0.3 * width, 0.7 * depth), (0.7 * width, 0.7 * depth)]
    return [outer, inner]


def bent(width: float, depth: float) -> list[list[tuple[float, float]]]:
    x, y = 0.4 * width, 0.6 * depth
    return [[(0.0, 0.0), (width, 0.0), (width, y), (x, y), (x, depth), (0.0, depth)]]


def spike(width: float, depth: float) -> list[list[tuple[float, float]]]:
    return [[(0.0, 0.0), (width, 0.0), (0.5 * width, 0.05 * depth)]]


def disc(width: float, depth: float) -> list[list[tuple[float, float]]]:
    angles = np.linspace(0.0, 2.0 * math.pi, 150, endpoint=False)
    reach = 1.0 + 0.1 * np.arange(150) % 0.2
    return [
        [
            (width * r * math.cos(a), depth * r * math.sin(a))
            for a, r in zip(angles, reach, strict=True)
        ]
    ]


Rings = list[np.ndarray]


@st.composite
def walls(draw: st.DrawFn) -> Rings:
    """Draw the rings of a building [m]."""
    form = draw(st.sampled_from([bowtie, ring, bent, spike, disc]))
    width, depth = draw(st.floats(0.3, 25.0)), draw(st.floats(0.3, 25.0))
    angle = math.radians(draw(st.sampled_from([0.0, 45.0, 90.0]) | st.floats(0.0, 360.0)))
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    place = st.sampled_from([0.0, 10.0, 10.25, 35.0]) | st.floats(-10.0, SIDE)
    at = np.array([draw(place), draw(place)])
    return [np.array(one) @ turn + at for one in form(width, depth)]


def imported(buildings: list[Rings], **options: float) -> Town:
    """Import buildings whose coordinates are in metres from the lower left corner of the area."""
    corner = Origin(
        latitude=geodetic(CENTER, -0.5 * SIDE, -0.5 * SIDE)[0],
        longitude=geodetic(CENTER, -0.5 * SIDE, -0.5 * SIDE)[1],
        altitude=0.0,
    )
    outlines = []
    for rings in buildings:
        degrees = [[geodetic(corner, *point)[1::-1] for point in one.tolist()] for one in rings]
        outlines.append(Outline((degrees,), 5.0))
    center = CENTER.latitude, CENTER.longitude
    settled = Options(center, (SIDE, SIDE), **options)
    return import_town(Buildings(tuple(outlines), Counter(), ()), settled, "town")


def placed(town: Town, rings: Rings) -> list[LineString]:
    """Return the walls of a building in the coordinates of the town, whose origin is its lower left corner."""
    corner = Origin(
        latitude=geodetic(CENTER, -0.5 * SIDE, -0.5 * SIDE)[0],
        longitude=geodetic(CENTER, -0.5 * SIDE, -0.5 * SIDE)[1],
        altitude=0.0,
    )
    found = []
    for one in rings:
        degrees = np.array([geodetic(corner, *point)[:2] for point in one.tolist()])
        metres = local(town.origin, degrees[:, 0], degrees[:, 1])
        found.append(LineString(np.concatenate([metres, metres[:1]])))
    return found


@settings(max_examples=150, deadline=None)
@given(
    st.lists(walls(), min_size=1, max_size=8),
    st.sampled_from([0.0, 0.5, 3.0]),
    st.sampled_from([0.05, 0.3, 1.0]),
)
def test_every_wall_is_inside_the_imported_buildings(buildings, gap, tolerance):
    within = BOX.buffer(-1e-3)
    if not any(within.intersects(shapes.repaired([one]).shapes[0]) for one in buildings):
        return
    town = imported(buildings, gap=gap, tolerance=tolerance)
    footprints = [np.array(one.polygon) for one in town.buildings]
    union = shapely.union_all([Polygon(one) for one in footprints])
    for rings in buildings:
        for line in placed(town, rings):
            assert shapely.difference(shapely.intersection(line, BOX), union).length <= 1e-6
    assert town.uncovered <= 1e-6
    assert first_contact(footprints) is None
    for one in town.buildings:
        assert not [*polygon_faults("polygon", one.polygon)]
        assert len(one.polygon) <= MOST_BUILDING_CORNERS
        assert min(map(min, one.polygon)) >= 0.0
        assert max(map(max, one.polygon)) <= SIDE


@settings(max_examples=100, deadline=None)
@given(walls(), st.floats(0.05, 2.0))
def test_a_simplified_wall_moves_outwards_by_the_tolerance(rings, tolerance):
    (given_one,) = shapes.repaired([rings]).shapes
    for polygon in shapes.filled(shapes.merged([given_one], 0.0)):
        found = shapes.simplified(polygon, tolerance)
        assert shapely.covers(found, polygon)
        assert shapely.covers(shapely.buffer(polygon, tolerance * 1.01), found)


def test_a_right_angle_keeps_its_corners():
    house = shapely.box(0.0, 0.0, 8.0, 5.0)
    found = shapes.simplified(affinity.rotate(house, 30.0), 0.3)
    assert shapes.corners_of(found) == 4
    assert found.area == pytest.approx(8.24 * 5.24, abs=0.01)


def test_footprints_that_meet_at_a_corner_become_one():
    pair = [shapely.box(0.0, 0.0, 5.0, 5.0), shapely.box(5.005, 5.005, 9.0, 9.0)]
    (found,) = shapes.apart(pair, BOX, 0.1)
    assert all(shapely.covers(shapely.buffer(found, 1e-3), one) for one in pair)
    assert shapes.corners_of(found) <= MOST_BUILDING_CORNERS
