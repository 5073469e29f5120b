"""UAVs without a map of the buildings discover them, and see behind none of them."""

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import LineString, Point, Polygon

import outrider
from agents.uav import UavPilot
from bus.messages.buildings import Building
from bus.messages.vehicle import UavCommand, UavObservation
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.env_pilots import pilots
from outrider.running.flying import InProcess, make_pilots
from processes import python
from sim.engine.briefing import all_buildings, uav_briefing
from sim.models.camera import range_at
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight

CHANGES = [
    "duration=40",
    "building_field=[]",
    "altitude.law=best",
    "uav.0.max_altitude=20",
    "ugv.0.building_clearance=0",
]
BLOCKS = {
    "house": ((6.0, 1.0), (8.0, 1.0), (8.0, 3.0), (6.0, 3.0)),
    "yard": ((5.0, 7.0), (9.0, 7.0), (9.0, 8.0), (6.0, 8.0), (6.0, 9.0), (5.0, 9.0)),
    "hut behind the tower": ((11.0, 4.0), (11.4, 4.0), (11.4, 4.4), (11.0, 4.4)),
    "tower": ((9.0, 3.5), (10.5, 3.5), (10.5, 5.0), (9.0, 5.0)),
    "far away": ((30.0, 30.0), (33.0, 30.0), (33.0, 33.0), (30.0, 33.0)),
}
"""Footprints [m] of buildings, of which one hides another."""
HEIGHTS = (2.0, 4.0, 1.0, 11.0, 5.0)
SEED = 3


def town(*changes: str) -> Scenario:
    """Return a town whose buildings the UAV meets on its route."""
    houses = (
        f"{{polygon={[list(corner) for corner in polygon]}, height={height}}}"
        for polygon, height in zip(BLOCKS.values(), HEIGHTS, strict=True)
    )
    blocks = f"building=[{', '.join(houses)}]"
    return load_scenario("town", overrides=[*CHANGES, blocks, "buildings.known=false", *changes])


class Flown:
    """Run of a town in one process, with all observations of its UAV."""

    def __init__(self, scenario: Scenario) -> None:
        self.seen: list[UavObservation] = []
        self.flight = Flight(scenario, SEED)
        vehicles = make_pilots(scenario, SEED)
        pilot: Any = vehicles["uav_0"]
        self.pilot: UavPilot = pilot
        act = pilot.act

        def record(observation: UavObservation) -> UavCommand:
            self.seen.append(observation)
            return act(observation)

        pilot.act = record
        self.flight.fly(InProcess(vehicles))
        pilot.perceive(self.flight.perceptions["uav_0"].observe(over=True))  # of the last state

    @property
    def town(self) -> tuple[Building, ...]:
        """Buildings of the run."""
        return all_buildings(self.flight.scenario, SEED)

    @property
    def found(self) -> dict[int, int]:
        """Number of buildings discovered in each tick with a discovery."""
        return {one.tick: len(one.buildings) for one in self.seen if one.buildings}


@pytest.fixture(scope="module")
def flown() -> Flown:
    return Flown(town())


def visible_corners(flown: Flown, observation: UavObservation) -> list[set[int]]:
    """Return the corners that a UAV sees of each building of its town, by shapely."""
    scenario = flown.flight.scenario
    (x, y), z = observation.position, observation.altitude or 0.0
    sensing_range = range_at(scenario.sensor.range, np.tan(scenario.camera.half_angle), z)
    shapes = [(Polygon(one.polygon), one.height) for one in flown.town]

    def sees(corner: tuple[float, float], height: float) -> bool:
        if Point(corner).distance(Point(x, y)) > sensing_range:
            return False
        for shape, other in shapes:
            if other > height:
                share = (other - height) / (z - height)
                end = [a + share * (b - a) for a, b in zip(corner, (x, y), strict=True)]
                if LineString([corner, end]).intersects(shape):
                    return False
        return True

    return [
        {n for n, corner in enumerate(one.polygon) if sees(corner, one.height)}
        for one in flown.town
    ]


def test_building_is_discovered_once_all_corners_are_detected(flown: Flown) -> None:
    """The UAV never flies lower than the roofs here."""
    corners: list[set[int]] = [set() for _ in flown.town]
    known: set[int] = set()
    for one in flown.seen:
        for seen, now in zip(corners, visible_corners(flown, one), strict=True):
            seen.update(now)
        complete = {k for k, seen in enumerate(corners) if len(seen) == len(flown.town[k].polygon)}
        polygons = [flown.town[k].polygon for k in sorted(complete - known)]
        assert [building.polygon for building in one.buildings] == polygons, one.tick
        known |= complete
    assert len(known) > 2
    assert any(0 < len(seen) < 4 for seen in corners)
    assert max(flown.found) > min(flown.found) > 0


def differing(flown: Flown) -> dict[tuple[float, float], float]:
    """Return by how much the UAV's own map exceeds that of the world, by the centers of the cells [m]."""
    more, cell = flown.pilot.coverage - flown.flight.world.coverage, flown.flight.scenario.area.cell
    return {((i + 0.5) * cell, (j + 0.5) * cell): more[j, i] for j, i in np.argwhere(more).tolist()}


def test_own_map_shows_nothing_that_the_uav_has_not_seen(flown: Flown) -> None:
    """Outside of discovered buildings, it covers at least what is covered, within the sensor's range."""
    path = LineString([one.position for one in flown.seen]).buffer(5.0 + 1e-6)
    found = [Polygon(building.polygon) for one in flown.seen for building in one.buildings]
    differing_cells = differing(flown)
    assert differing_cells
    for place, more in differing_cells.items():
        under = any(shape.intersects(Point(place)) for shape in found)
        assert under or (more > 0.0 and path.contains(Point(place)))


def test_own_map_omits_ground_hidden_by_a_discovered_building() -> None:
    """Two huts whose corners are all in view from the start: except under them, the map is that of the world."""
    huts = "building=[{polygon=[[5,4],[6,4],[6,5],[5,5]], height=4}, {polygon=[[3,7],[4,7],[3,8]], height=5}]"
    flown = Flown(town(huts))
    assert flown.found == {0: 2}
    shapes = [Polygon(one.polygon).buffer(1e-6) for one in flown.town]
    assert all(any(shape.contains(Point(place)) for shape in shapes) for place in differing(flown))


def test_batch_and_environment_discover_like_a_run(flown: Flown) -> None:
    loop = ClosedLoop(flown.flight.scenario, 2, error=True, end_on_sight_lost=False)
    loop.begin([SEED, SEED + 1])
    loop.fly()
    state, world = loop.state, flown.flight.world
    position = state.batch.vehicles["reference_position"][0]
    assert position == pytest.approx(world.reference_position, abs=1e-9)
    found = state.batch.town.found
    ticks, counts = np.unique(found[0, 0][found[0, 0] >= 0], return_counts=True)
    assert dict(zip(ticks.tolist(), counts.tolist(), strict=True)) == flown.found
    assert not np.array_equal(found[0], found[1])
    assert loop.pilots is not None
    own_map = loop.pilots.state.uavs.coverage[0, 0]
    np.testing.assert_allclose(own_map, flown.pilot.coverage, atol=1e-9)
    env = outrider.parallel_env(flown.flight.scenario, end_on_sight_lost=False)
    seen, _ = env.reset(seed=SEED)
    policies = pilots(env)
    while env.agents:
        seen, *_ = env.step({name: policies[name](seen[name]) for name in env.agents})
    assert np.array_equal(env.world.reference_position, world.reference_position)


@pytest.mark.parametrize(
    "duplicate",
    [copy.deepcopy, lambda pilot: pickle.loads(pickle.dumps(pilot))],  # noqa: S301
)
def test_copied_pilot_flies_as_the_original(flown: Flown, duplicate: Any) -> None:
    """Copied in flight, when it knows some of the buildings."""
    pilot, end = UavPilot(uav_briefing(flown.flight.scenario, "uav_0", SEED)), min(flown.found) + 1
    for one in flown.seen[:end]:
        pilot.act(one)
    other = duplicate(pilot)
    for one in flown.seen[end : end + 20]:
        assert other.act(one) == pilot.act(one)
    assert np.array_equal(other.coverage, pilot.coverage)


def test_a_discovery_compiles_nothing_in_flight() -> None:
    code = (
        "from test_discovery import Flown, town\n"
        "from agents.uav_tick import fly_law\n"
        "seen = Flown(town()).seen\n"
        "first = next(one.tick for one in seen if one.buildings)\n"
        "print(first > 1, len(fly_law.signatures))"
    )
    assert python(code, cwd=Path(__file__).parent).stdout.split() == ["True", "1"]


def test_a_vehicle_that_rejoins_learns_of_them_again(flown: Flown) -> None:
    perception = flown.flight.perceptions["uav_0"]
    end = max(flown.found) + 1
    states = np.zeros((end, 4)), np.zeros((end, 2))
    missed = min(flown.found)
    past = perception.past(0, end, *states, missed=())
    assert [one.buildings for one in past] == [one.buildings for one in flown.seen[:end]]
    assert not perception.past(0, end, *states, missed=(missed,))[missed].buildings


@pytest.mark.parametrize("drawn", [False, True], ids=["given", "drawn"])
def test_only_buildings_of_no_briefing_are_discovered(drawn: bool) -> None:
    """A UAV is never briefed on the blocks of a field."""
    scenario = load_scenario("town") if drawn else town("buildings.known=true")
    loop = ClosedLoop(scenario, 8)
    loop.begin(range(8))
    loop.fly()
    found = loop.state.batch.town
    assert (found.found >= 0).any() == drawn
    assert found.known.any()
