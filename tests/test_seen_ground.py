"""The ground under the vehicles and the tiles that their sensors report, against plain arithmetic."""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.messages.ground import BLOCK_SIDE, TILE_LETTERS, Hazard, MapUpdate, TileReport
from bus.messages.vehicle import RelativeInformation, UavObservation
from flights import Piloted, altered
from outrider.running.flying import InProcess, make_pilots
from sim.models.ground import CLEAR
from sim.models.hazards import BLOCK, ROUGH
from sim.scenario.types import Ground, Scenario
from sim.scenario.vehicle_types import Ugv
from sim.server.flight import Flight
from sim.server.perception import UgvPerception
from sim.world import World
from worlds import small

DISC = Hazard(kind="block", center=(10.0, 6.0), radius=0.5)
MUD = Hazard(
    kind="rough", polygon=((5.0, 5.0), (7.0, 5.0), (7.0, 7.0), (5.0, 7.0)), speed_share=0.3
)
FLAG = Hazard(kind="find", center=(8.0, 8.0), radius=0.2)
EAST = (0.1, 0.0)


def scenario_with(
    *hazards: Hazard, at: tuple[float, float] = (8.0, 6.0), duration: float = 20.0, **ground: Any
) -> Scenario:
    """Return a UAV above a UGV on ground with these hazards."""
    plain = small("tracking", duration=duration)
    (uav,), (ugv,) = plain.uav, plain.ugv
    return msgspec.structs.replace(
        plain,
        hazard=hazards,
        ground=Ground(**ground),
        uav=(msgspec.structs.replace(uav, position=at),),
        ugv=(msgspec.structs.replace(ugv, position=at, goals=((12.0, 6.0),)),),
    )


def drive(
    world: World, ticks: int, ugv=EAST, uav=(0.02, 0.01)
) -> list[list[tuple[TileReport, ...]]]:
    """Return the tiles that UAV and UGV report at each tick."""
    seen = [[world.seen_ground(k) for k in (0, 1)]]
    for _ in range(ticks):
        world.send(0, world.tick, uav)
        world.send(1, world.tick, ugv)
        world.advance()
        seen.append([world.seen_ground(k) for k in (0, 1)])
    return seen


def places(seen: tuple[TileReport, ...]) -> set[tuple[int, int]]:
    return {(tile.row, tile.column) for tile in seen}


def test_uav_reports_a_tile_once_after_seeing_its_center() -> None:
    scenario = scenario_with(DISC, MUD)
    world = World(scenario, 1)
    tile, every, dt = scenario.ground.tile, 5, scenario.dt
    rows, columns = world.ground.tiles.shape[1:]
    y, x = (np.mgrid[0:rows, 0:columns] + 0.5) * tile
    seen_for, reported = np.zeros((rows, columns)), set[tuple[int, int]]()
    for tick in range(1, 301):
        _, now = drive(world, 1)
        reported_now = places(now[0])
        assert not reported & reported_now
        reported |= reported_now
        if tick % every:
            assert not reported_now
            continue
        (p_x, p_y), sensing_range = world.position[0].tolist(), scenario.sensor.range
        rho2 = (x - p_x) ** 2 + (y - p_y) ** 2
        quality = np.where(
            rho2 <= sensing_range**2, (rho2 - sensing_range**2) ** 2 / sensing_range**4, 0.0
        )  # (2)
        seen_for += scenario.sensor.peak * quality * every * dt
        sure = np.abs(seen_for - scenario.coverage.desired) > 1e-4  # single precision
        expected = set(map(tuple, np.argwhere(seen_for >= scenario.coverage.desired).tolist()))
        assert {p for p in reported ^ expected if sure[p]} == set()
    assert len(reported) > 50


def test_bumper_reports_tiles_within_its_range() -> None:
    scenario = scenario_with(DISC, MUD, sensing_range=0.9, tile=0.4)
    world, reported, truth = World(scenario, 1), set[tuple[int, int]](), {}
    tiles = world.ground.tiles[0]
    for tick in range(200):
        seen = world.seen_ground(1)
        assert not reported & places(seen)
        reported |= places(seen)
        truth |= {(one.row, one.column): one.state for one in seen}
        x, y = world.position[1]
        for row in range(tiles.shape[0]):
            for column in range(tiles.shape[1]):
                d_x = max(0.4 * column - x, x - 0.4 * (column + 1), 0.0)
                d_y = max(0.4 * row - y, y - 0.4 * (row + 1), 0.0)
                if math.hypot(d_x, d_y) <= 0.9 - 1e-9:
                    assert (row, column) in reported, tick
        drive(world, 1)
    assert all(truth[place] == TILE_LETTERS[tiles[place]] for place in reported)
    assert {BLOCK, CLEAR} <= {int(tiles[place]) for place in reported}


@pytest.mark.parametrize(("chances", "wrong"), [({"miss": 1.0}, "."), ({"false_alarm": 1.0}, "#")])
def test_misses_and_false_alarms_are_the_uavs_alone(chances: dict[str, float], wrong: str) -> None:
    world = World(scenario_with(DISC, MUD, FLAG, **chances), 1)
    tiles = world.ground.tiles[0]
    seen = drive(world, 200)
    of_uav = {(t.row, t.column): t.state for tick in seen for t in tick[0]}
    for place, state in of_uav.items():
        errs = (tiles[place] == CLEAR) == (wrong == "#")
        assert state == (wrong if errs else TILE_LETTERS[tiles[place]])
    assert set(of_uav.values()) == ({"."} if wrong == "." else {"#", "~", "*"})
    of_ugv = {(t.row, t.column): t.state for tick in seen for t in tick[1]}
    assert all(state == TILE_LETTERS[tiles[place]] for place, state in of_ugv.items())


def test_miss_chance_of_a_half_misses_half_by_seed() -> None:
    field = Hazard(kind="rough", center=(8.0, 6.0), radius=4.0)
    reports = []
    for seed in (1, 2):
        seen = drive(World(scenario_with(field, miss=0.5), seed), 200)
        reports.append({(t.row, t.column): t.state for tick in seen for t in tick[0]})
    assert reports[0] != reports[1]
    count = sum(state == "~" for one in reports for state in one.values())
    assert 0.4 < count / sum(map(len, reports)) < 0.6


def test_a_ugv_that_touches_what_blocks_stays_at_its_edge() -> None:
    wall = Hazard(kind="block", polygon=((9.0, 4.0), (9.002, 4.0), (9.002, 8.0), (9.0, 8.0)))
    for hazard, speed, push, edge in ((DISC, 0.2, 0.1, 9.5), (wall, 9.0, 50.0, 9.0)):
        scenario = scenario_with(hazard)
        ugv = msgspec.structs.replace(scenario.ugv[0], max_speed=speed, max_acceleration=push)
        world = World(msgspec.structs.replace(scenario, ugv=(ugv,)), 1)
        drive(world, 600 if hazard is DISC else 20, ugv=(push, 0.0))
        assert world.position[1].tolist() == pytest.approx([edge, 6.0], abs=1e-9)
        assert world.velocity[1].tolist() == [0.0, 0.0]
        assert world.mission.hazards_hit == 1
        assert not world.mission.arrived


def test_rough_ground_slows_the_ugv_and_only_there() -> None:
    world, speeds = World(scenario_with(MUD, at=(4.0, 6.0)), 1), list[tuple[float, float]]()
    for _ in range(1300):
        drive(world, 1)
        speeds.append((float(world.position[1, 0]), float(np.hypot(*world.velocity[1]))))
    limit = world.scenario.ugv[0].max_speed
    within = [v for x, v in speeds if 5.05 < x < 7.0]
    after = [v for x, v in speeds if x > 7.5]
    assert max(within) == pytest.approx(0.3 * limit)
    assert max(after) == pytest.approx(limit)


def test_perception_depends_on_seen_ground_alone() -> None:
    """Another hazard far away changes no bit until a reported tile touches it."""
    far, farther = (Hazard(kind="block", center=(x, 6.0), radius=0.5) for x in (13.0, 14.0))
    flights = [
        drive(World(scenario_with(DISC, hazard), 1), 300, uav=(0.01, 0.0))
        for hazard in (far, farther)
    ]
    touched = range(24, 30)
    for one, other in zip(*flights, strict=True):
        if any(tile.column in touched for seen in (*one, *other) for tile in seen):
            break
        assert one == other
    else:
        pytest.fail("no tile near the hazard was reported")


def blocks_received(flight: Flight) -> dict[int, tuple[MapUpdate, ...]]:
    ugv = flight.perceptions["ugv_0"]
    assert isinstance(ugv, UgvPerception)
    return ugv.blocks


def radio_received(
    scenario: Scenario, sent: Callable[[UavObservation], tuple[RelativeInformation, ...]]
) -> tuple[list[RelativeInformation], Flight]:
    """Return what the UGV receives from a UAV that sends these messages, and the flight."""
    flight, received = Flight(scenario, 1), list[RelativeInformation]()
    flight.fly(
        altered(make_pilots(scenario, 1), "uav_0", lambda seen: {"radio": sent(seen)}),
        on_tick=lambda: received.extend(flight.observations()["ugv_0"].radio),
    )
    return received, flight


@pytest.mark.parametrize(
    ("column", "row", "tiles"),
    [(0, 0, "." * 64), (1000, 52_417, "?" * 64), (0, 3, "?" * 64)],
    ids=["not sensed", "beyond the area", "nothing known"],
)
def test_block_beyond_the_uavs_sensor_data_is_not_sent(column: int, row: int, tiles: str) -> None:
    forged = MapUpdate(column=column, row=row, tiles=tiles)
    scenario = scenario_with(DISC, duration=5.0)
    flight = Flight(scenario, 1)
    flight.fly(altered(make_pilots(scenario, 1), "uav_0", lambda _: {"map_updates": (forged,)}))
    assert flight.radio.refused == {"uav_0": scenario.ticks}
    assert not blocks_received(flight)


def test_omitted_tiles_of_a_block_carry_no_information() -> None:
    """Let a UAV report a tile for a 1 and omit it for a 0: the UGV receives all tiles of the sensor."""
    scenario = scenario_with(DISC, MUD, duration=20.0)
    pilots = make_pilots(scenario, 1)
    act = pilots["uav_0"].act

    def masked(observation: Any) -> Any:
        command = act(observation)
        blocks = (
            msgspec.structs.replace(one, tiles="?" + one.tiles[1:32] + "?" * 32)
            for one in command.map_updates
        )
        return msgspec.structs.replace(command, map_updates=tuple(blocks))

    flights = [Flight(scenario, 1) for _ in range(2)]
    flights[0].fly(InProcess(make_pilots(scenario, 1)))
    flights[1].fly(Piloted(pilots, "uav_0", masked))
    honest, rogue = map(blocks_received, flights)
    assert honest == rogue
    assert len(honest) > 20


def test_relative_information_comes_five_times_a_second() -> None:
    scenario = scenario_with(DISC, duration=10.0)

    def talkative(observation: UavObservation) -> tuple[RelativeInformation, ...]:
        now = observation.tick * scenario.dt
        times = (now + 1e-8 * scenario.dt, now, 999_999.0, now + 0.5 * scenario.dt)
        rest = {"relative_position": (1.0, 2.0), "coverage_error": 0.0}
        return tuple(RelativeInformation(time=time, **rest) for time in times)

    received, flight = radio_received(scenario, talkative)
    ticks = list(range(0, scenario.ticks, 4))
    assert [one.time for one in received] == [tick * scenario.dt for tick in ticks]  # exactly
    assert flight.radio.refused == {"uav_0": 4 * scenario.ticks - len(ticks)}


def test_sign_of_a_zero_carries_no_information() -> None:
    scenario = scenario_with(DISC, duration=1.0)
    message = RelativeInformation(time=-0.0, relative_position=(1.0, 2.0), coverage_error=0.0)
    received, _ = radio_received(scenario, lambda _: (message,))
    assert [math.copysign(1.0, one.time) for one in received] == [1.0]


def test_ugv_receives_the_ground_the_uav_has_seen() -> None:
    scenario = scenario_with(DISC, MUD, duration=30.0)
    flight = Flight(scenario, 1)
    flight.fly(InProcess(make_pilots(scenario, 1)))
    known = flight.world.ground.known[0, 0]
    received = np.zeros_like(known)
    for tick, blocks in blocks_received(flight).items():
        assert tick % 5 == 1  # four times per second, delayed by one tick of radio
        for block in blocks:
            for place, letter in enumerate(block.tiles):
                row, column = block.row * 8 + place // 8, block.column * 8 + place % 8
                if letter != "?":
                    received[row, column] = TILE_LETTERS.index(letter)
    assert flight.radio.refused == {"uav_0": 0}
    assert (received[received > 0] == known[received > 0]).all()
    assert (received > 0).sum() > 0.5 * (known > 0).sum()
    assert {BLOCK, ROUGH} <= set(received.ravel().tolist())


def test_mission_reports_the_warning_time_of_each_hazard() -> None:
    scenario = scenario_with(DISC, MUD, at=(7.2, 5.7), touch="damage")
    world = World(scenario, 1)
    block = MapUpdate(column=2, row=1, tiles="." * 32 + "....##.." + "." * 24)
    for tick in range(401):
        if tick == 20:
            world.receive_block(1, block)  # with two tiles of DISC
        drive(world, 1)
    mission = world.mission
    assert (mission.hazards_on_path, mission.warned, mission.hazards_hit) == (2, 1, 1)
    assert mission.near_misses == 0
    assert world.position[1, 0] > 10.5  # damaged, it drives on
    assert 0.0 < mission.reported_share < 1.0


def test_distance_seen_ahead_is_on_tiles_known_by_then() -> None:
    world = World(scenario_with(FLAG, at=(7.2, 5.7)), 1)
    block, known = MapUpdate(column=2, row=1, tiles="." * 64), False
    side, driven, seen = BLOCK_SIDE * world.scenario.ground.tile, 0.0, 0.0
    for _ in range(401):
        before = world.position[1].tolist()
        if not known and [p // side for p in before] == [block.column, block.row]:
            world.receive_block(1, block)  # the block around the UGV
            known = True
        drive(world, 1)
        after = world.position[1].tolist()
        driven += math.dist(before, after)
        if known and [p // side for p in after] == [block.column, block.row]:
            seen += math.dist(before, after)
    assert 0.1 * driven < seen < 0.9 * driven
    assert world.mission.reported_share == pytest.approx(seen / driven, rel=1e-9)


def test_hazard_clearance_is_the_smallest_distance() -> None:
    rng = np.random.default_rng(4)
    discs = [
        Hazard(kind="block", center=(float(x), float(y)), radius=0.3)
        for x, y in rng.uniform(0.5, 11.5, (40, 2))
    ]
    world = World(scenario_with(*discs, at=(3.0, 3.0), touch="damage"), 1)
    state, track = world.ground, [world.position[1].copy()]
    for tick in range(700):  # out and back: farther than the range of its list of hazards
        drive(world, 1, ugv=(0.1, 0.06) if tick < 350 else (-0.1, 0.02))
        track.append(world.position[1].copy())
    away = np.array([np.hypot(*(np.array(track) - one.center).T) - one.radius for one in discs])
    near = away.min(axis=1).clip(0.0)
    assert 5 < (near <= 2.0).sum() < 35
    on_way = near <= 2.0
    np.testing.assert_allclose(state.nearest[0, 0][on_way], near[on_way], atol=1e-12)
    first = np.array([(row <= 2.0).argmax() + 1 for row in away])
    assert (state.met[0, 0] == np.where(on_way, first, 0)).all()


def test_every_ugv_has_a_bumper_of_its_own() -> None:
    scenario = scenario_with(DISC)
    second = Ugv(name="ugv_1", position=(2.0, 2.0))
    world = World(msgspec.structs.replace(scenario, ugv=(*scenario.ugv, second)), 1)
    assert not places(world.seen_ground(1)) & places(world.seen_ground(2))
