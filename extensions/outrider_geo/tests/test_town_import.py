"""`outrider scenarios import`: what it reads, what it writes, and the flight of a real town."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("shapely", reason="the extra [geo] is not installed")
import shapely
from shapely import Polygon

from bus.geodesy import local
from bus.messages.buildings import MOST_BUILDINGS
from outrider.running.flying import fly
from outrider.view.flight_picture import draw_flight
from outrider_geo.heights import height_of
from pages import words
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from tabular import rows

ROOT = Path(__file__).resolve().parents[3]
HELSINKI = ROOT / "examples" / "towns" / "helsinki.geojson"
PICTURE = ROOT / "docs" / "how-to" / "helsinki.png"
LATITUDE, LONGITUDE = 52.0, 5.0
METRE = 1.0 / 111_266.0, 1.0 / 68_678.0
"""A metre at 52 degrees north, in degrees of latitude and of longitude."""

Tags = dict[str, Any]


def square(
    x: float, y: float, side: float = 8.0, longitude: float = LONGITUDE
) -> list[list[float]]:
    """Return the ring of a square; its lower left corner is at this distance from the centre [m]."""
    corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side), (0.0, 0.0)]
    east = [longitude + METRE[1] * (x + a) for a, _ in corners]
    return [
        [(lon + 180.0) % 360.0 - 180.0, LATITUDE + METRE[0] * (y + b)]
        for lon, (_, b) in zip(east, corners, strict=True)
    ]


def feature(coordinates: Any, kind: str = "Polygon", **tags: Any) -> Tags:
    return {
        "type": "Feature",
        "properties": {"building": "yes"} | tags,
        "geometry": {"type": kind, "coordinates": coordinates},
    }


def collection(*features: Tags, **members: Any) -> Tags:
    return {"type": "FeatureCollection", "features": [*features], **members}


Import = Callable[..., tuple[Scenario, dict[str, Any]]]


@pytest.fixture
def importing(here: Path, command: Any) -> Import:
    """Import a collection; return the scenario and the report."""

    def run(content: Tags, *options: object) -> tuple[Scenario, dict[str, Any]]:
        (here / "in.geojson").write_text(json.dumps(content), encoding="utf-8")
        done = command("scenarios", "import", "in.geojson", "--json", *options)
        assert done.returncode == 0, done.stderr
        return load_scenario(here / "in.toml"), json.loads(done.stdout)

    return run


def test_houses_that_touch_become_one_as_high_as_the_highest(importing: Import) -> None:
    row = [feature([square(8.0 * k, 0.0)], height=f"{4 + k} m") for k in range(3)]
    near = feature([square(24.5, 0.0)], **{"building:levels": "1"})
    scenario, report = importing(collection(*row, near, feature([square(0.0, 20.0)])))
    assert [one.height for one in scenario.building] == [6.0, 6.0]
    assert report["counts"]["contacts"] == 2
    assert report["counts"]["raised"] == 3
    assert [report["counts"][f"height_{source}"] for source in ("height", "levels", "missing")] == [
        3,
        1,
        1,
    ]
    large = max(scenario.building, key=lambda one: Polygon(one.polygon).area)
    assert len(large.polygon) == 4
    # 32.5 m x 8 m, each wall 0.4 times the tolerance of 0.3 m farther out
    assert Polygon(large.polygon).area == pytest.approx(32.74 * 8.24, rel=2e-3)
    assert report["uncovered_area"] == 0.0


def test_courts_are_filled_and_counted(importing: Import) -> None:
    court = feature([square(0.0, 0.0, 30.0), square(5.0, 5.0, 20.0)])
    inside = feature([square(10.0, 10.0, 5.0)], height=12)
    scenario, report = importing(collection(court, inside))
    (one,) = scenario.building
    assert (one.height, report["counts"]["courts"]) == (12.0, 1)
    areas = {step["name"]: step["area"] for step in report["steps"]}
    assert areas["merged"] == pytest.approx(30.0**2 - 20.0**2 + 5.0**2, rel=2e-3)
    assert areas["courts filled"] == pytest.approx(30.0**2, rel=2e-3)


def test_both_polygons_of_a_multipolygon_are_walls(importing: Import) -> None:
    scenario, _ = importing(collection(feature([[square(0, 0)], [square(30, 0)]], "MultiPolygon")))
    assert len(scenario.building) == 2


def test_other_features_are_no_buildings_and_are_counted(importing: Import) -> None:
    road = feature([square(0, 0)[0], square(9, 9)[0]], "LineString", building=None, highway="path")
    park = feature([square(40, 40)], building="no", leisure="park")
    cellar = feature([square(60, 0)], location="underground")
    node = feature(square(0, 0)[0], "Point")
    part = feature([square(0, 30)], **{"building": None, "building:part": "yes"})
    old = feature([square(0, 60)], tags={"building": "yes", "height": "9"}, building=None)
    scenario, report = importing(collection(road, park, cellar, node, part, old))
    assert [one.height for one in scenario.building] == [6.0, 9.0]
    counts = report["counts"]
    assert [counts[k] for k in ("not_buildings", "underground", "without_polygon")] == [2, 1, 1]


def test_overture_needs_no_building_property(importing: Import) -> None:
    given = {"sources": [{"dataset": "Microsoft ML Buildings"}, {"dataset": "OpenStreetMap"}]}
    overture = [feature([square(20 * k, 0)], num_floors=k + 1, **given) for k in range(2)]
    for one in overture:
        del one["properties"]["building"]
    overture[1]["properties"] |= {"is_underground": True}
    scenario, report = importing(collection(*overture))
    assert [one.height for one in scenario.building] == [3.0]
    assert "datasets: Microsoft ML Buildings, OpenStreetMap" in report["statements"]
    assert any("ODbL" in line for line in report["statements"])


def test_invalid_polygons_are_repaired_and_counted(importing: Import) -> None:
    a, b, c, d, _ = square(0, 0, 20.0)
    scenario, report = importing(collection(feature([[a, c, b, d, a]])))
    assert report["counts"]["repaired"] == 1
    assert len(scenario.building) == 1
    assert report["uncovered_area"] == 0.0


def test_a_town_across_the_antimeridian_stays_together(importing: Import) -> None:
    east, west = square(-20, 0, longitude=180.0), square(12, 0, longitude=180.0)
    scenario, _ = importing(collection(feature([east]), feature([west])))
    assert scenario.area.width < 80.0
    assert abs(scenario.origin.longitude - 180.0) < 0.01
    assert len(scenario.building) == 2


def test_walls_are_where_the_origin_says(importing: Import) -> None:
    scenario, _ = importing(
        collection(feature([square(0, 0)])), "--size", "100,60", "--origin", "52,5"
    )
    assert (scenario.area.width, scenario.area.height) == (100.0, 60.0)
    ring = np.array(square(0, 0))
    wall = local(scenario.origin, ring[:, 1], ring[:, 0])
    assert wall[0] == pytest.approx((50.0, 30.0), abs=0.01)
    (one,) = scenario.building
    assert shapely.covers(Polygon(one.polygon), Polygon(wall))


def test_clipping_and_small_buildings_are_reported(importing: Import) -> None:
    shed, house, far = (
        feature([square(0, 20, 1.0)]),
        feature([square(0, 0)]),
        feature([square(500, 0)]),
    )
    scenario, report = importing(
        collection(shed, house, far), "--size", "100,100", "--origin", "52,5", "--min-area", 5
    )
    assert len(scenario.building) == 1
    assert (report["counts"]["outside"], report["counts"]["dropped"]) == (1, 1)
    assert report["uncovered_area"] == pytest.approx(1.0, abs=0.01)


def test_the_report_and_the_file_name_source_and_licence(here: Path, command: Any) -> None:
    stated = {
        "copyright": "The data included in this document is from www.openstreetmap.org. The data is made available "
        "under ODbL.",
        "timestamp": "2026-01-02T03:04:05Z",
        "generator": "overpass-turbo\nradius = 1",
    }
    (here / "a b.geojson").write_text(json.dumps(collection(feature([square(0, 0)]), **stated)))
    done = command("scenarios", "import", "a b.geojson", "--out", "t.toml")
    assert done.returncode == 0, done.stderr
    head = (here / "t.toml").read_text(encoding="utf-8").partition("title")[0]
    for text in (stated["copyright"], stated["timestamp"]):
        assert text in head
        assert text in done.stdout
    assert all(line.startswith("#") for line in head.splitlines())
    (here / "plain.geojson").write_text(json.dumps(collection(feature([square(0, 0)]))))
    done = command("scenarios", "import", "plain.geojson")
    assert "states no licence" in done.stderr


@pytest.mark.parametrize(
    ("tags", "height", "source"),
    [
        ({"height": 7}, 7.0, "height"),
        ({"height": "7.5 m"}, 7.5, "height"),
        ({"height": "7,5"}, 7.5, "height"),
        ({"height": "30'"}, 9.144, "height"),
        ({"height": "10'6\""}, 3.2004, "height"),
        ({"height": None, "num_floors": 2}, 6.0, "levels"),
        ({"building:levels": "2", "roof:levels": "1"}, 9.0, "levels"),
        ({"height": "tall", "building:levels": "2"}, 6.0, "levels"),
        *[
            ({"height": bad}, None, "unreadable")
            for bad in ("tall", math.nan, math.inf, -1, 0, True, [3], 10**400)
        ],
        ({"building:levels": "-2"}, None, "unreadable"),
        ({"height": "9999"}, None, "unreadable"),
        ({}, None, "missing"),
        ({"height": ""}, None, "missing"),
    ],
)
def test_heights_are_read_or_counted_as_unreadable(
    tags: Tags, height: float | None, source: str
) -> None:
    found, where = height_of(tags)
    assert where == source
    assert found == (None if height is None else pytest.approx(height))


BAD = rows(r"""
no such file | nowhere.geojson | no such file
a folder | . | Is a directory
not JSON | text | not JSON: Expecting value
not UTF-8 | bytes | not JSON
nested too deeply | deep | nested too deeply
no object | list | not GeoJSON
other JSON | other | not GeoJSON with polygons
Overpass JSON | overpass | Overpass JSON; allowed: GeoJSON
no features | no_features | features: missing
a feature of another type | feature_type | features.0 = 3: no object
empty | empty | 0 features, no building
only roads | roads | 1 features, no building
projected | projected | projected coordinates, not degrees; allowed: WGS 84
named projection | crs | crs.properties.name = "urn:ogc:def:crs:EPSG::28992": not WGS 84
a coordinate of NaN | nan | not finite
a coordinate of text | text_point | not a position
a huge coordinate | huge | projected coordinates
two points | two | not a ring
a number for coordinates | number | no list
near the pole | pole | too near to a pole
too large | wide | too large; allowed: 2000 m at most, such as --size
""")
CONTENTS: dict[str, object] = {
    "text": "hello",
    "bytes": b'{"type": "\xff"}',
    "deep": "[" * 100_000,
    "list": [],
    "other": {"type": "Topology"},
    "overpass": {"version": 0.6, "elements": []},
    "no_features": {"type": "FeatureCollection"},
    "feature_type": collection(3),  # type: ignore[arg-type]
    "empty": collection(),
    "roads": collection(feature(square(0, 0)[:2], "LineString")),
    "projected": collection(feature([[[155_000.0, 463_000.0]] * 4])),
    "crs": collection(
        feature([square(0, 0)]),
        crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::28992"}},
    ),
    "nan": collection(feature([[[math.nan, 1.0]] * 4])),
    "text_point": collection(feature([[["5", "52"]] * 4])),
    "huge": collection(feature([[[10**400, 1.0]] * 4])),
    "two": collection(feature([square(0, 0)[:2]])),
    "number": collection(feature(3)),
    "pole": collection(feature([[[5.0, 85.0], [5.1, 85.0], [5.0, 85.1], [5.0, 85.0]]])),
    "wide": collection(feature([square(0, 0)]), feature([square(5000, 0)])),
}


@pytest.mark.parametrize(("file", "phrase"), [row[1:] for row in BAD], ids=[row[0] for row in BAD])
def test_a_bad_file_gives_one_line(file: str, phrase: str, here: Path, command: Any) -> None:
    content = CONTENTS.get(file)
    if isinstance(content, bytes):
        (here / file).write_bytes(content)
    elif content is not None:
        text = content if isinstance(content, str) else json.dumps(content)
        (here / file).write_text(text, encoding="utf-8")
    done = command("scenarios", "import", file, "--out", "out.toml")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert phrase in done.stderr
    assert "allowed:" in done.stderr
    assert not (here / "out.toml").exists()


OPTIONS = rows(r"""
--out town.json | wrong ending; allowed: town.json.toml
--out escort.toml | name of a shipped scenario
--out there.toml | exists already; --force
--origin 52 | not two numbers; allowed: LAT,LON
--origin 152,5 | out of range; allowed: LAT,LON
--origin nan,5 | out of range
--size 5,5 | out of range; allowed: X,Y in metres, from 10 to 2000
--size 3000,3000 | out of range
--size inf,nan | out of range
--origin 53,5 --size 100,100 | no building in the area; allowed: --origin and --size with a building inside
--min-area 1000 | no building in the area
--clearance 90 --size 60,60 | no free ground for a UGV that keeps 90 m
--height nan | --height
--simplify 0 | --simplify
""")


@pytest.mark.parametrize(("options", "phrase"), OPTIONS)
def test_a_bad_option_gives_one_line(options: str, phrase: str, here: Path, command: Any) -> None:
    (here / "in.geojson").write_text(json.dumps(collection(feature([square(0, 0)]))))
    (here / "there.toml").touch()
    done = command("scenarios", "import", "in.geojson", *options.split())
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert phrase in done.stderr


def test_too_many_buildings_name_a_size_that_has_few_enough(here: Path, command: Any) -> None:
    side = math.ceil(math.sqrt(MOST_BUILDINGS)) + 4
    houses = [feature([square(14.0 * i, 14.0 * j)]) for i in range(side) for j in range(side)]
    (here / "many.geojson").write_text(json.dumps(collection(*houses)))
    done = command("scenarios", "import", "many.geojson")
    assert done.returncode == 2
    assert f"allowed: {MOST_BUILDINGS:,} buildings" in done.stderr
    size = done.stderr.partition("--size ")[2].split()[0]
    done = command("scenarios", "import", "many.geojson", "--size", size)
    assert done.returncode == 0, done.stderr
    count = len(load_scenario(here / "many.toml").building)
    assert 0.8 * MOST_BUILDINGS < count <= MOST_BUILDINGS


def test_a_real_town_is_flown_in_sight(here: Path, command: Any) -> None:
    options = ("--size", "300,300", "--height", 20, "--json")
    done = command("scenarios", "import", HELSINKI, *options)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["valid"], report["certifiable"]) == (True, "always")
    assert report["uncovered_area"] == 0.0
    assert report["counts"]["contacts"] > 50
    assert any("ODbL" in line for line in report["statements"])
    scenario = load_scenario(here / "helsinki.toml", overrides={"duration": 20.0})
    flight, summary = fly(scenario, scenario.seed)
    assert summary.visibility_violations == 0
    assert summary.certified_share == 1.0
    assert summary.certified_while_lost == 0
    assert summary.mission is not None
    assert summary.mission.near_building == 0
    assert summary.max_distance > 2.0
    draw_flight(flight, here / "drawn.png")
    assert words(PICTURE) == words(here / "drawn.png"), "draw this picture again"
