"""State of the ground, and of the UGVs' missions, in many worlds."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray, record_type, records
from sim.engine.briefing import can_hide
from sim.models.ground import TileArray
from sim.scenario.clearance import clearance_fault
from sim.scenario.ground_tables import ground_tables, world_corners
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Ugv

TickArray = npt.NDArray[np.int32]
"""Ticks, counted from 1; 0: never."""


class GroundParameters(NamedTuple):
    """Parameters of the ground, in SI units."""

    tile: float
    period: int
    """Ticks between two updates of a UAV's ground sensor."""
    miss: float
    false_alarm: float
    """Probability of reporting a tile with a hazard as clear, and a clear tile as blocked."""
    bumper: float
    stuck: bool
    """True if a vehicle that touches a blocking hazard is stuck; else it is damaged and drives on."""
    first_building: int
    end_building: int
    """Rows of the buildings among the hazards, end exclusive. A vehicle that touches one is always stuck."""
    mapped: bool
    """True if the vehicles know the state of every tile: they have a map, and the buildings are the only hazards."""


class Clearance(NamedTuple):
    """Distance of one UGV from buildings, a row of a table."""

    declared: float
    """`building_clearance` of the scenario [m]; 0: none."""
    guaranteed: bool
    """True while the driver in control guarantees it."""
    needed: bool
    """True if buildings may hide the UGV."""


class Progress(NamedTuple):
    """Mission progress of one UGV, a row of a table."""

    driven: float
    """Distance driven [m]."""
    seen_length: float
    """Distance driven on tiles that had been received by radio [m]."""
    entered: int
    """Ticks in which it drove over a tile that it did not know to be drivable."""
    claim: int
    """Its claim at this tick, a constant of `sim.models.ground`; 0: none."""
    near_building: int
    near_excused: int
    """Ticks in which it came nearer to a building than the clearance that it declares, between ticks too; of these,
    ticks under a driver that guarantees none.
    """
    near: bool
    """True if it came nearer between the previous tick and this one."""
    certified: int
    path_unknown: int
    no_stop: int
    not_own: int
    """Ticks in which it was certified to stay on known tiles, and in which it was not, by reason."""
    untrue: int
    """1 once it received a false report of a tile as drivable, or contradictory reports."""
    broken: int
    """Certified ticks after which it was not certified, or in which it left known tiles, although all reports were
    true.
    """
    still: int
    """Ticks in which it stood still before arrival."""
    reached: int
    """Goals reached."""
    arrived: int
    """Tick at which it reached the last goal; -1: not yet, or it has none."""
    received_tiles: int
    """Tiles received by radio, each counted once."""
    listed: int
    """Number of hazards in the list of near ones; -1: not listed yet."""
    listed_x: float
    listed_y: float
    """Its position when they were listed [m]."""


class GroundState(NamedTuple):
    """Ground of all worlds: constant arrays first, then arrays with a leading axis for worlds."""

    parameters: RecordArray
    """`GroundParameters`. Shape (1,)."""
    corners: FloatArray
    """Corners of all polygons [m]: common ones, then the random buildings' of each world. Shape (corners, 2)."""
    ugvs: IntArray
    """Row of each UGV among the vehicles. Shape (UGVs,)."""
    strides: FloatArray
    """Longest distance that each UGV drives in a tick [m]. Shape (1 or worlds, UGVs), see `BatchTables`."""
    clearances: RecordArray
    """`Clearance` of each UGV. Shape (UGVs,)."""
    hazards: RecordArray
    """`HazardRow`: the scenario's hazards, the buildings, then the random hazards. Shape (worlds, hazards)."""
    tiles: TileArray
    """True state of each tile. Shape (worlds, rows, columns)."""
    tile_coverage: npt.NDArray[np.float32]
    """C of (3) of each single UAV at the tiles' centers. Shape (worlds, UAVs, rows, columns)."""
    known: TileArray
    """State of each tile as reported by each vehicle's own sensor. Shape (worlds, vehicles, rows, columns)."""
    seen: npt.NDArray[np.int32]
    """Tiles reported since the previous tick, as row * columns + column. Shape (worlds, vehicles, room)."""
    report_counts: IntArray
    """Number of these tiles. Shape (worlds, vehicles)."""
    pace: FloatArray
    """Share of its maximum speed that each vehicle has at its position; 0: stuck. Shape (worlds, vehicles)."""
    before: FloatArray
    """Position of each UGV before its last move [m]. Shape (worlds, UGVs, 2)."""
    hits: npt.NDArray[np.uint8]
    """1 for each blocking hazard that a UGV has touched. Shape (worlds, UGVs, hazards)."""
    missions: RecordArray
    """`Progress`. Shape (worlds, UGVs)."""
    received: TickArray
    """Time at which each UGV first received each tile by radio. Shape (worlds, UGVs, rows, columns)."""
    radioed: TileArray
    """State of each tile as received by radio: BLOCK is final, others are overwritten. Shape as `received`."""
    warned: TickArray
    """Time of its first knowledge of each hazard, by radio or by its own sensor. Shape (worlds, UGVs, hazards)."""
    met: TickArray
    """Time at which it first came within `NEAR_PATH`. Shape (worlds, UGVs, hazards)."""
    nearest: FloatArray
    """Smallest distance to each hazard [m]. Shape (worlds, UGVs, hazards)."""
    near: npt.NDArray[np.int32]
    """Hazards that it could approach within `NEAR_PATH` before the next listing; the first `Progress.listed` are valid.

    Shape (worlds, UGVs, hazards).
    """
    found: TickArray
    """Time at which a vehicle's sensor first reported each hazard. Shape (worlds, hazards)."""


CONSTANTS = ("parameters", "corners", "ugvs", "strides", "clearances")
"""Arrays of `GroundState` without an axis for worlds."""


def ground_of(scenario: Scenario, worlds: int, rows: int = 1) -> GroundState | None:
    """Return the initial ground, before hazards are drawn or reported; None: no hazards.

    `rows`: As in `batch_tables`.
    """
    if not scenario.has_ground:
        return None
    tables = ground_tables(scenario)
    driving = [(k, one) for k, one in enumerate(scenario.vehicles) if isinstance(one, Ugv)]
    vehicles, uavs, ugvs = len(scenario.vehicles), len(scenario.uav), len(driving)
    size, count = tables.tiles.shape, len(tables.hazards)
    missions = np.zeros((worlds, ugvs), dtype=record_type(Progress))
    missions["arrived"] = missions["listed"] = -1
    warned = np.zeros((worlds, ugvs, count), np.int32)
    if scenario.buildings.known:
        warned[:, :, tables.buildings.start : tables.buildings.stop] = 1
    return GroundState(
        parameters=records(GroundParameters, [_parameters(scenario, tables.buildings)]),
        corners=world_corners(scenario, tables, worlds),
        ugvs=np.array([k for k, _ in driving], dtype=np.int64),
        strides=np.repeat(strides_of(scenario)[None], rows, axis=0),
        clearances=records(
            Clearance,
            [
                Clearance(
                    declared=one.building_clearance,
                    guaranteed=not clearance_fault(scenario, one),
                    needed=can_hide(scenario, one),
                )
                for _, one in driving
            ],
        ),
        hazards=np.repeat(tables.hazards[None], worlds, axis=0),
        tiles=np.repeat(tables.tiles[None], worlds, axis=0),
        tile_coverage=np.zeros((worlds, uavs, *size), np.float32),
        known=np.zeros((worlds, vehicles, *size), np.uint8),
        seen=np.zeros((worlds, vehicles, _room(scenario, tables.tiles.size)), np.int32),
        report_counts=np.zeros((worlds, vehicles), np.int64),
        pace=np.ones((worlds, vehicles)),
        before=np.zeros((worlds, ugvs, 2)),
        hits=np.zeros((worlds, ugvs, count), np.uint8),
        missions=missions,
        received=np.zeros((worlds, ugvs, *size), np.int32),
        radioed=np.zeros((worlds, ugvs, *size), np.uint8),
        warned=warned,
        met=np.zeros((worlds, ugvs, count), np.int32),
        nearest=np.full((worlds, ugvs, count), np.inf),
        near=np.zeros((worlds, ugvs, count), np.int32),
        found=np.zeros((worlds, count), np.int32),
    )


def strides_of(scenario: Scenario) -> FloatArray:
    """Return the longest distance that each UGV drives in a tick [m]. Shape (UGVs,)."""
    ugvs = [one for one in scenario.vehicles if isinstance(one, Ugv)]
    return np.array([one.max_speed * scenario.dt for one in ugvs])


def set_driver(scenario: Scenario, ground: GroundState | None, name: str, driver: str) -> None:
    """Set the driver in control of a UGV, which decides whether it keeps its distance from buildings.

    Args:
        scenario: The scenario.
        ground: Ground of all worlds; changed. None: no ground.
        name: Name of the UGV.
        driver: Its driver, `EXTERNAL` for external actions.
    """
    if ground is None:
        return
    ugvs = [one for one in scenario.vehicles if isinstance(one, Ugv)]
    row = [one.name for one in ugvs].index(name)
    ground.clearances["guaranteed"][row] = not clearance_fault(scenario, ugvs[row], driver)


def _parameters(scenario: Scenario, buildings: range) -> GroundParameters:
    ground = scenario.ground
    return GroundParameters(
        tile=float(ground.tile),
        period=scenario.ground_period,
        miss=float(ground.miss),
        false_alarm=float(ground.false_alarm),
        bumper=float(ground.sensing_range),
        stuck=ground.touch == "stuck",
        first_building=buildings.start,
        end_building=buildings.stop,
        mapped=scenario.only_known_buildings,
    )


def _room(scenario: Scenario, tiles: int) -> int:
    """Return the largest number of tiles that a vehicle reports in a tick."""
    longest_range = max(scenario.sensor.range, scenario.ground.sensing_range)
    return min(tiles, (2 * math.ceil(longest_range / scenario.ground.tile) + 3) ** 2)
