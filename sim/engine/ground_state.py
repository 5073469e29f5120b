"""The state of the ground in many worlds, and of the UGVs' missions on it.

Where a scenario has no hazards, the arrays are empty.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.kernels.compile import FloatArray, IntArray
from sim.kernels.records import RecordArray, record_type, records
from sim.models.ground import TileArray
from sim.scenario.ground_tables import ground_tables
from sim.scenario.types import Scenario, Ugv

TickArray = npt.NDArray[np.int32]
"""Ticks, counted from 1; 0: never."""


class GroundParameters(NamedTuple):
    """The numbers of the ground, in SI units."""

    tile: float
    period: int
    """Ticks between two looks of a UAV's sensor at the ground."""
    miss: float
    false_alarm: float
    """Chances of a tile with a hazard to be told as clear, and of a clear one to be told as blocked."""
    bumper: float
    stuck: bool
    """True if a vehicle that touches what blocks stays there; else it is damaged and drives on."""


class GroundConstants(NamedTuple):
    """The constants of all worlds."""

    parameters: RecordArray
    """`GroundParameters`. Shape (1,); (0,) where there are no hazards."""
    corners: FloatArray
    """Of all polygons [m]. Shape (any, 2)."""
    ugvs: IntArray
    """For each UGV its row among the vehicles. Shape (UGVs,)."""
    strides: FloatArray
    """The longest way of each UGV in a tick [m]. Shape (UGVs,)."""


class GroundState(NamedTuple):
    """The ground of each world. All arrays have an axis for worlds in front."""

    hazards: RecordArray
    """`HazardRow`: those of the scenario, then those that were drawn. Shape (worlds, hazards)."""
    tiles: TileArray
    """The true state of each tile. Shape (worlds, rows, columns)."""
    looked: npt.NDArray[np.float32]
    """C of (3) of each UAV alone at the tiles' centres. Shape (worlds, UAVs, rows, columns)."""
    known: TileArray
    """Tiles as each vehicle's own sensor has told them. Shape (worlds, vehicles, rows, columns)."""
    seen: npt.NDArray[np.int32]
    """The tiles of which it has told since the tick before, row * columns + column. Shape (worlds, vehicles, room)."""
    told: IntArray
    """Their number. Shape (worlds, vehicles)."""
    pace: FloatArray
    """Share of its largest speed that each vehicle has where it is; 0: it is stuck. Shape (worlds, vehicles)."""
    before: FloatArray
    """Position of each UGV before it moved [m]. Shape (worlds, UGVs, 2)."""
    hits: npt.NDArray[np.uint8]
    """1 where a UGV has touched a hazard that blocks. Shape (worlds, UGVs, hazards)."""


def ground_constants(scenario: Scenario) -> GroundConstants:
    """The constants of a scenario's ground."""
    ground, rows = scenario.ground, list[GroundParameters]()
    if scenario.has_ground:
        rows.append(
            GroundParameters(
                tile=float(ground.tile),
                period=scenario.ground_period,
                miss=float(ground.miss),
                false_alarm=float(ground.false_alarm),
                bumper=float(ground.bumper),
                stuck=ground.touch == "stuck",
            )
        )
    ugvs = [(k, one) for k, one in enumerate(scenario.vehicles) if isinstance(one, Ugv)]
    return GroundConstants(
        parameters=records(GroundParameters, rows),
        corners=ground_tables(scenario).corners,
        ugvs=np.array([k for k, _ in ugvs], dtype=np.int64),
        strides=np.array([one.max_speed * scenario.dt for _, one in ugvs]),
    )


def ground_state(scenario: Scenario, worlds: int) -> GroundState:
    """The ground before anything has been drawn or seen."""
    tables, ground = ground_tables(scenario), scenario.ground
    hazards, tiles = tables.hazards, tables.tiles
    if scenario.has_ground:
        reach = max(scenario.sensor.range, ground.bumper)
        room = min(tiles.size, (2 * math.ceil(reach / ground.tile) + 3) ** 2)
        vehicles, uavs, ugvs = len(scenario.vehicles), len(scenario.uav), len(scenario.ugv)
    else:
        tiles = np.zeros((0, 0), np.uint8)
        room = vehicles = uavs = ugvs = 0
    rows, columns = tiles.shape
    return GroundState(
        hazards=np.repeat(hazards[None], worlds, axis=0),
        tiles=np.repeat(tiles[None], worlds, axis=0),
        looked=np.zeros((worlds, uavs, rows, columns), np.float32),
        known=np.zeros((worlds, vehicles, rows, columns), np.uint8),
        seen=np.zeros((worlds, vehicles, room), np.int32),
        told=np.zeros((worlds, vehicles), np.int64),
        pace=np.ones((worlds, vehicles)),
        before=np.zeros((worlds, ugvs, 2)),
        hits=np.zeros((worlds, ugvs, len(hazards)), np.uint8),
    )


class MissionRecord(NamedTuple):
    """The columns of a table: how one UGV does."""

    way: float
    """That it has driven [m]."""
    seen_way: float
    """Of it on tiles that had come by radio before [m]."""
    entered: int
    """Ticks in which it drove over a tile that it did not know to be drivable."""
    claim: int
    """Its claim at this tick, one of `sim.models.ground`'s; 0: none."""
    certified: int
    way_unknown: int
    no_stop: int
    """Ticks in which it claimed to stay on tiles that it knows, and in which it did not, by reason."""
    untrue: int
    """1 once a tile has been told it as drivable that is not, or as both."""
    broken: int
    """Certified ticks after which it was not, or in which it left them, although it was told the truth."""
    still: int
    """Ticks in which it stood still before it had arrived."""
    reached: int
    """Goals."""
    arrived: int
    """The tick at which it had reached the last of them; -1: not yet, or it has none."""
    told: int
    """Tiles that have come by radio, each counted once."""
    listed: int
    """Number of hazards near it when they were listed; -1: not yet."""
    listed_x: float
    listed_y: float
    """Its position then [m]."""


class MissionConstants(NamedTuple):
    """The constants of all worlds."""

    goals: FloatArray
    """Of all UGVs [m]. Shape (any, 2)."""
    goal_rows: IntArray
    """First row of each UGV's. Shape (UGVs + 1,)."""
    tolerances: FloatArray
    """[m]. Shape (UGVs,)."""


class MissionState(NamedTuple):
    """The UGVs' missions in each world. All arrays have an axis for worlds in front."""

    ugvs: RecordArray
    """`MissionRecord`. Shape (worlds, UGVs)."""
    received: TickArray
    """Time at which each UGV was told of each tile by radio first. Shape (worlds, UGVs, rows, columns)."""
    told: TileArray
    """State that the radio has told of each: BLOCK stays, the rest gives way to later words. Shape as `received`."""
    warned: TickArray
    """Time at which it knew of each hazard first, by radio or by its bumper. Shape (worlds, UGVs, hazards)."""
    met: TickArray
    """Time at which it was nearer than `ON_WAY` first. Shape (worlds, UGVs, hazards)."""
    nearest: FloatArray
    """Smallest distance to each hazard [m]. Shape (worlds, UGVs, hazards)."""
    near: npt.NDArray[np.int32]
    """Those that it could come nearer to than `ON_WAY` before they are listed anew, in order: `MissionRecord.listed`
    of them. Shape (worlds, UGVs, hazards).
    """
    found: TickArray
    """Time at which any vehicle's sensor told of each hazard first. Shape (worlds, hazards)."""


def joined(arrays: Sequence[FloatArray], width: int) -> tuple[FloatArray, IntArray]:
    """Arrays one after the other, and where each begins."""
    edges = np.cumsum([0, *(len(array) for array in arrays)]).astype(np.int64)
    return np.concatenate([np.zeros((0, width)), *arrays]), edges


def mission_constants(scenario: Scenario) -> MissionConstants:
    """The goals of a scenario."""
    ugvs = [one for one in scenario.vehicles if isinstance(one, Ugv)]
    goals, goal_rows = joined(
        [np.array(one.goals, dtype=np.float64).reshape(-1, 2) for one in ugvs], 2
    )
    tolerances = np.array([one.goal_tolerance for one in ugvs], dtype=np.float64)
    return MissionConstants(goals, goal_rows, tolerances)


def mission_state(ground: GroundState) -> MissionState:
    """Nothing has happened yet on this ground."""
    worlds, ugvs = ground.before.shape[:2]
    count = ground.hazards.shape[1]
    numbers = np.zeros((worlds, ugvs), dtype=record_type(MissionRecord))
    numbers["arrived"] = numbers["listed"] = -1
    return MissionState(
        ugvs=numbers,
        received=np.zeros((worlds, ugvs, *ground.tiles.shape[1:]), np.int32),
        told=np.zeros((worlds, ugvs, *ground.tiles.shape[1:]), np.uint8),
        warned=np.zeros((worlds, ugvs, count), np.int32),
        met=np.zeros((worlds, ugvs, count), np.int32),
        nearest=np.full((worlds, ugvs, count), np.inf),
        near=np.zeros((worlds, ugvs, count), np.int32),
        found=np.zeros((worlds, count), np.int32),
    )
