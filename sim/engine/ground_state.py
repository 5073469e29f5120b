"""State of the ground in many worlds, and of the UGVs' missions on it."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray, record_type, records
from sim.models.ground import TileArray
from sim.scenario.ground_tables import ground_tables
from sim.scenario.types import Scenario, Ugv

TickArray = npt.NDArray[np.int32]
"""Ticks, counted from 1; 0: never."""


class GroundParameters(NamedTuple):
    """Parameters of the ground, in SI units."""

    tile: float
    period: int
    """Ticks between two looks of a UAV's sensor at the ground."""
    miss: float
    false_alarm: float
    """Chances of a tile with a hazard to be told as clear, and of a clear one to be told as blocked."""
    bumper: float
    stuck: bool
    """True if a vehicle that touches what blocks stays there; else it is damaged and drives on."""


class Progress(NamedTuple):
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


class GroundState(NamedTuple):
    """Ground of all worlds: two constant arrays, then arrays with an axis for worlds in front."""

    parameters: RecordArray
    """`GroundParameters`. Shape (1,)."""
    corners: FloatArray
    """Corners of all polygons [m]. Shape (any, 2)."""
    ugvs: IntArray
    """Row of each UGV among the vehicles. Shape (UGVs,)."""
    strides: FloatArray
    """Longest way of each UGV in a tick [m]. Shape (UGVs,)."""
    hazards: RecordArray
    """`HazardRow`: those of the scenario, then those that were drawn. Shape (worlds, hazards)."""
    tiles: TileArray
    """True state of each tile. Shape (worlds, rows, columns)."""
    looked: npt.NDArray[np.float32]
    """C of (3) of each UAV alone at the tiles' centres. Shape (worlds, UAVs, rows, columns)."""
    known: TileArray
    """Tiles as each vehicle's own sensor has reported them. Shape (worlds, vehicles, rows, columns)."""
    seen: npt.NDArray[np.int32]
    """Tiles that it has reported since the tick before, row * columns + column. Shape (worlds, vehicles, room)."""
    told: IntArray
    """Their number. Shape (worlds, vehicles)."""
    pace: FloatArray
    """Share of its maximum speed that each vehicle has where it is; 0: it is stuck. Shape (worlds, vehicles)."""
    before: FloatArray
    """Position of each UGV before it moved [m]. Shape (worlds, UGVs, 2)."""
    hits: npt.NDArray[np.uint8]
    """1 for each blocking hazard that a UGV has touched. Shape (worlds, UGVs, hazards)."""
    missions: RecordArray
    """`Progress`. Shape (worlds, UGVs)."""
    received: TickArray
    """Time at which each UGV received each tile by radio first. Shape (worlds, UGVs, rows, columns)."""
    radioed: TileArray
    """State that the radio has reported of each: BLOCK stays, others are overwritten. Shape as `received`."""
    warned: TickArray
    """Time at which it knew of each hazard first, by radio or by its bumper. Shape (worlds, UGVs, hazards)."""
    met: TickArray
    """Time at which it was nearer than `ON_WAY` first. Shape (worlds, UGVs, hazards)."""
    nearest: FloatArray
    """Smallest distance to each hazard [m]. Shape (worlds, UGVs, hazards)."""
    near: npt.NDArray[np.int32]
    """Hazards that it could come nearer to than `ON_WAY` before they are listed anew; `Progress.listed` of them.

    Shape (worlds, UGVs, hazards).
    """
    found: TickArray
    """Time at which any vehicle's sensor reported each hazard first. Shape (worlds, hazards)."""


CONSTANTS = ("parameters", "corners", "ugvs", "strides")
"""Arrays of `GroundState` without an axis for worlds."""


def ground_of(scenario: Scenario, worlds: int) -> GroundState | None:
    """Return the ground before anything has been drawn or seen; None if there are no hazards."""
    if not scenario.has_ground:
        return None
    tables, ground = ground_tables(scenario), scenario.ground
    parameters = GroundParameters(
        tile=float(ground.tile),
        period=scenario.ground_period,
        miss=float(ground.miss),
        false_alarm=float(ground.false_alarm),
        bumper=float(ground.sensing_range),
        stuck=ground.touch == "stuck",
    )
    reach = max(scenario.sensor.range, ground.sensing_range)
    room = min(tables.tiles.size, (2 * math.ceil(reach / ground.tile) + 3) ** 2)
    rows = [(k, one) for k, one in enumerate(scenario.vehicles) if isinstance(one, Ugv)]
    vehicles, uavs, ugvs = len(scenario.vehicles), len(scenario.uav), len(rows)
    size, count = tables.tiles.shape, len(tables.hazards)
    missions = np.zeros((worlds, ugvs), dtype=record_type(Progress))
    missions["arrived"] = missions["listed"] = -1
    return GroundState(
        parameters=records(GroundParameters, [parameters]),
        corners=tables.corners,
        ugvs=np.array([k for k, _ in rows], dtype=np.int64),
        strides=np.array([one.max_speed * scenario.dt for _, one in rows]),
        hazards=np.repeat(tables.hazards[None], worlds, axis=0),
        tiles=np.repeat(tables.tiles[None], worlds, axis=0),
        looked=np.zeros((worlds, uavs, *size), np.float32),
        known=np.zeros((worlds, vehicles, *size), np.uint8),
        seen=np.zeros((worlds, vehicles, room), np.int32),
        told=np.zeros((worlds, vehicles), np.int64),
        pace=np.ones((worlds, vehicles)),
        before=np.zeros((worlds, ugvs, 2)),
        hits=np.zeros((worlds, ugvs, count), np.uint8),
        missions=missions,
        received=np.zeros((worlds, ugvs, *size), np.int32),
        radioed=np.zeros((worlds, ugvs, *size), np.uint8),
        warned=np.zeros((worlds, ugvs, count), np.int32),
        met=np.zeros((worlds, ugvs, count), np.int32),
        nearest=np.full((worlds, ugvs, count), np.inf),
        near=np.zeros((worlds, ugvs, count), np.int32),
        found=np.zeros((worlds, count), np.int32),
    )
