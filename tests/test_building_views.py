"""Pictures and recordings of flights over buildings."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from towns import HOUSE, scenario

pytest.importorskip("foxglove", reason="the extra [record] is not installed")

from bus.messages.buildings import Building
from bus.messages.ground import Hazard
from bus.messages.scenario import Law
from observed import recorded
from outrider.recording.reader import Recording, entries, flight_of
from outrider.recording.refly import refly, restore
from outrider.view.film import Film
from sim.models.buildings import building_table, line_of_sight
from sim.scenario.ground_types import AltitudeLaw, HazardField
from sim.scenario.types import Scenario, Sensor, Visibility
from sim.scenario.vehicle_types import Uav, Ugv
from sim.scene.altitude import HiddenGround, ring_radius
from sim.scene.colors import INK, building
from sim.scene.drawing import Map, legend_of
from sim.scene.footprints import label_point
from sim.scene.ground_map import KNOWN, UNKNOWN, ground_map
from sim.scene.known import scene_of
from sim.scene.prism import prism, triangulated
from sim.world import World

COURT = ((0, 0), (6, 0), (6, 6), (4, 6), (4, 2), (2, 2), (2, 6), (0, 6))
"""A house with two wings; not convex."""
SHED = Building(polygon=((20.0, 20.0), (22.0, 20.0), (22.0, 22.0)), height=2.0)


def behind_a_house(**fields: object) -> Scenario:
    """A UGV that drives out from behind a house, from where its UAV does not see it."""
    ugv = Ugv(position=(12.0, 8.8), goals=((18.0, 8.8),), max_speed=0.4)
    uav = Uav(position=(15.5, 15.2), initial_altitude=7.0, max_altitude=20.0)
    given = {
        "uav": (uav,),
        "building": (HOUSE, SHED),
        "visibility": Visibility(radius=8.0),
        "sensor": Sensor(range=9.0),
        "law": Law(name="tracking"),
        "duration": 20.0,
        "name": "behind",
    }
    return scenario(ugv, **(given | fields))


def recording_of(one: Scenario, folder: Path) -> Recording:
    path = folder / "run.mcap"
    recorded(path, one, 3)
    return flight_of(path)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return recording_of(behind_a_house(), tmp_path_factory.mktemp("behind"))


def test_hidden_cells_are_those_without_a_line_of_sight() -> None:
    scene = scene_of(behind_a_house(), (HOUSE, SHED))
    x, y, z = 12.3, 16.1, 8.0
    hidden = HiddenGround(scene).cells({"uav_0": (x, y)}, {"uav_0": z}, (80, 80))
    tables, cell = building_table([(one.corners, one.height) for one in (HOUSE, SHED)]), 0.5
    radius = z * math.tan(0.785)
    for row, column in np.ndindex(80, 80):
        q = ((column + 0.5) * cell, (row + 0.5) * cell)
        near = math.dist(q, (x, y)) <= radius
        assert hidden[row, column] == (near and not line_of_sight(*tables, x, y, z, *q, 0.0))
    assert hidden.sum() > 50


def test_the_circles_shrink_with_the_altitude() -> None:
    scene = scene_of(behind_a_house())
    marker = scene.space.markers["ugv_0"]
    for ring in scene.rings:
        low, high = (ring_radius(scene, ring, {"uav_0": z}) for z in (2.0, 100.0))
        assert high == ring.radius
        expected = {"r": 2.0, "r_v": 2.0 - marker}.get(ring.symbol)
        wanted = ring.radius if expected is None else expected * math.tan(0.785)
        assert low == pytest.approx(wanted)


def test_observers_find_the_buildings_among_the_hazards() -> None:
    turned = Building(polygon=SHED.polygon[::-1], height=2.0)
    disc = Hazard(kind="block", center=(30.0, 30.0), radius=0.5)
    random = HazardField(kind="block", count=3, radius=(0.3, 0.6))
    one = behind_a_house(building=(HOUSE, turned), hazard=(disc,), hazard_field=(random,))
    world = World(one, 3)
    ground = ground_map(world)
    shapes = [{*ground.hazards[k].polygon} for k in ground.building_rows]
    assert shapes == [{*building.polygon} for building in world.buildings]
    assert sum(hazard.polygon == () for hazard in ground.hazards) == 4
    axes = Figure().add_subplot()
    Map(axes, scene_of(one, world.buildings), hazards=ground)
    areas = [area.get_paths() for area in axes.collections if len(area.get_paths())]
    assert sorted(map(len, areas)) == [2, 4]


def test_every_building_is_drawn_once_in_its_grey() -> None:
    world = World(behind_a_house(), 3)
    scene, ground = scene_of(world.scenario, world.buildings), ground_map(world)
    axes = Figure().add_subplot()
    drawn = Map(axes, scene, hazards=ground)
    fills = [area for area in axes.collections if len(area.get_paths())]
    assert len(fills) == 1
    greys = [tuple(color[:3]) for color in fills[0].get_facecolor()]
    assert greys == [to_rgb(building(one.height, (HOUSE, SHED))) for one in (HOUSE, SHED)]
    assert sum(greys[0]) < sum(greys[1])  # the house is taller
    labels = {artist.get_label() for artist in legend_of(scene, hazards=ground)}
    assert {"building, height [m]", "hidden from the camera"} <= labels
    assert "5.0" in {text.get_text() for text in axes.texts}
    assert drawn.artists


def test_heights_are_dark_on_faint_buildings() -> None:
    world = World(behind_a_house(), 3)
    scene, ground = scene_of(world.scenario, world.buildings), ground_map(world)
    axes = Figure().add_subplot()
    drawn = Map(axes, scene, hazards=ground)
    (label,) = (text for text in axes.texts if text.get_text() == "5.0")
    tracks = {one.name: np.array([one.position]) for one in world.scenario.vehicles}

    def shown(state: int) -> str:
        states = bytes([state] * len(ground.states))
        drawn.show(tracks, None, hazards=msgspec.structs.replace(ground, states=states))
        return str(label.get_color())

    assert shown(KNOWN) == "white"
    assert shown(UNKNOWN) == INK


def test_film_and_log_state_that_a_building_hides_the_ugv(recording: Recording) -> None:
    first, last = (frame[:90, :, :3].astype(int) for frame in Film(recording).frames([0.0, 20.0]))
    red = (np.abs(frame - (207, 42, 60)).max(axis=2) < 40 for frame in (first, last))
    assert [bool(pixels.any()) for pixels in red] == [True, False]
    lines = [entry.data for entry in entries(recording.path, ("/log",))]
    (lost,) = [line for line in lines if b"has lost sight of ugv_0" in line]
    assert b"hidden or too low" in lost
    assert any(b"sees ugv_0 again" in line for line in lines)


def test_recording_with_altitude_is_reflown_to_the_bit(recording: Recording, tmp_path) -> None:
    climbing = behind_a_house(altitude=AltitudeLaw(law="certified"))
    for one in (recording, recording_of(climbing, tmp_path)):
        again = refly(one)
        assert again.difference is None
        assert again.trajectory_sha256 == again.recorded_sha256
        restored = restore(one).recorder
        assert np.array_equal(restored.heights, again.flight.recorder.heights, equal_nan=True)
    heights = again.flight.recorder.heights
    assert np.ptp(heights[:, 0, 0]) > 0.5


def test_a_label_stands_on_its_building() -> None:
    assert label_point(HOUSE) == (12.0, 12.0)
    x, y = label_point(Building(polygon=COURT, height=3.0))
    assert not 1.0 < x < 5.0 or y <= 1.0  # not in the yard, nor at its walls
    assert 0.5 < y < 5.5


@pytest.mark.parametrize("polygon", [COURT, COURT[::-1], HOUSE.polygon])
def test_prisms_have_the_area_of_roof_and_walls(polygon: tuple[tuple[float, float], ...]) -> None:
    corners = np.array(polygon)
    x, y = corners.T
    area = abs(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    around = np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).sum()
    flat = [np.array(triangle) for triangle in triangulated(polygon)]
    assert sum(0.5 * np.linalg.det((b - a, c - a)) for a, b, c in flat) == pytest.approx(area)
    points = np.array(prism(Building(polygon=polygon, height=3.0))).reshape(-1, 3, 3)
    sizes = 0.5 * np.linalg.norm(
        np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1
    )
    assert sizes.sum() == pytest.approx(area + 3.0 * around)
