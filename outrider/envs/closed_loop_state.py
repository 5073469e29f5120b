"""Parameters, tables and state of `outrider.envs.closed_loop`: the arrays of its compiled tick."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agents.drivers.dispatch import DriverTables
from agents.drivers.tile_map import OccupancyGrid
from agents.estimation.map_updates import MapUpdateMemory
from agents.laws.dispatch import LawTables
from agents.safety.memory import FilterMemory
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.engine.batch import Batch
from sim.engine.monitor import certificate_counters
from sim.engine.world_state import BatchState, BatchTables
from sim.env.rows import RowState, RowTables, row_state
from sim.models.ground import TileArray
from sim.scenario.types import Scenario


class LoopParameters(NamedTuple):
    """Switches and parameters of the pilots."""

    estimate: bool
    """True if the rows contain the estimate instead of the raw detection."""
    gradient: bool
    """True if the rows contain the coverage gradient."""
    own_maps: bool
    """True if each UAV has its own map; otherwise the world's coverage serves as its map."""
    radio: bool
    """True if any UGV uses the radio."""
    radio_ticks: int
    map_update_ticks: int
    """Period of the map updates [ticks]; 0: never, without ground."""
    tile: float
    """Width of a tile [m]; 0 without ground."""
    meters_per_pixel: float


class CommandedTables(NamedTuple):
    """Constants of all worlds, if all actions are external."""

    batch: BatchTables
    rows: RowTables
    action_row: IntArray
    """Row of each vehicle in the external actions; -1: it has a pilot. Shape (vehicles,)."""


class CommandedState(NamedTuple):
    """State of all worlds, if all actions are external. All arrays have an axis for worlds in front."""

    batch: BatchState
    rows: RowState
    """Metrics and observation rows."""
    certificates: RecordArray
    """`CertificateCounters` of each UAV. Shape (worlds, UAVs)."""


class HeightTables(NamedTuple):
    """Constants of the UAVs that have an altitude."""

    laws: RecordArray
    """`HeightParameters` of each UAV; empty for one that flies in the plane. Shape (1 or worlds, UAVs)."""
    levels: RecordArray
    """`SafetyBounds` of each UAV's filter by increasing floor; unused rows have an infinite floor.

    Shape (1 or worlds, UAVs, most).
    """


class LoopTables(NamedTuple):
    """Constants of worlds with pilots, estimates or coverage patches: extends `CommandedTables`.

    Some have one row for all worlds, or one for each if the worlds differ, as in `BatchTables`.
    """

    batch: BatchTables
    rows: RowTables
    action_row: IntArray
    laws: LawTables
    drivers: DriverTables
    estimating: IntArray
    """1 for each UAV whose estimate is needed. Shape (UAVs,)."""
    filtered: IntArray
    """1 for each UAV with an active safety filter. Shape (UAVs,)."""
    receivers: IntArray
    """Index of the UGV that receives each UAV's radio. Shape (UAVs,)."""
    kalman: RecordArray
    """`KalmanParameters` of each UAV. Shape (1 or worlds, UAVs)."""
    safety: RecordArray
    """`SafetyBounds` of each UAV's filter. Shape (1 or worlds, UAVs)."""
    monitored: RecordArray
    """`SafetyBounds` by which each UAV's certificates are counted. Shape (1 or worlds, UAVs)."""
    heights: HeightTables | None
    """None if all UAVs fly in the plane; nothing is compiled for altitudes then."""
    scripts: FloatArray
    script_rows: IntArray
    late: IntArray
    """Rows of pending commands of each UGV: its command delay in ticks, plus 2. Shape (1 or worlds, UGVs)."""


class LoopState(NamedTuple):
    """State of all worlds with pilots: extends `CommandedState`. All arrays have an axis for worlds in front."""

    batch: BatchState
    rows: RowState
    certificates: RecordArray
    maps: FloatArray
    """Maps of the UAVs; one, the world's coverage, if they do not differ. Shape (worlds, UAVs or 1, rows, columns)."""
    uavs: RecordArray
    """`UavParameters` of each UAV, with its sensor at its altitude. Shape (worlds, UAVs)."""
    heights: RecordArray
    """`HeightMemory` of each UAV. Shape (worlds, UAVs)."""
    laws: RecordArray
    """Memories of the laws, nested by law. Shape (worlds, UAVs)."""
    drivers: RecordArray
    """Memories of the drivers, nested by driver. Shape (worlds, UGVs)."""
    kalman: RecordArray
    """`EstimatorRow` of each UAV. Shape (worlds, UAVs, 1 + depth): see `agents.estimation.batch_filter`."""
    filters: FilterMemory
    """Memory of each UAV's safety filter. Shape (worlds, UAVs, ...)."""
    grids: OccupancyGrid | None
    """Occupancy grid of each UGV; None without ground. Shape (worlds, UGVs, ...)."""
    outbox: RecordArray
    """`Packet`: radio messages just sent by each UAV, with its relative position and with a map update.

    Shape (worlds, UAVs, 2).
    """
    detections: FloatArray
    """Work array for the detections received by one UAV: tick, p_delta [m]. Shape (worlds, room, 3)."""
    inboxes: FloatArray
    """Radio messages with the relative position received by each UGV in this tick: tick, p_delta [m].

    Shape (worlds, UGVs, room, 3).
    """
    arrived: IntArray
    """Number of valid rows of `inboxes`. Shape (worlds, UGVs)."""
    patches: FloatArray
    """Coverage patches of the UAVs. Shape (worlds, UAVs or 0, pixels, pixels)."""
    map_updates: MapUpdateMemory
    """Map and transmission state of each UAV. Shape (worlds, UAVs, ...)."""
    places: IntArray
    states: TileArray
    """Work arrays for tiles reported to a UGV: indices and states. Shapes (worlds, 2, room), (worlds, room)."""


def commanded(
    scenario: Scenario, batch: Batch, external: Sequence[str], rows: RowTables
) -> tuple[CommandedTables, CommandedState]:
    """Return the tables and the state of worlds in which all actions are external.

    Args:
        scenario: Scenario of all worlds.
        batch: The worlds.
        external: Vehicles with external actions, in the order of the actions.
        rows: Tables of the observation rows.
    """
    names = [vehicle.name for vehicle in scenario.vehicles]
    action_row = [external.index(name) if name in external else -1 for name in names]
    counters = certificate_counters(len(scenario.uav))[None]
    tables = CommandedTables(batch.tables, rows, np.array(action_row, dtype=np.int64))
    state = CommandedState(
        batch=batch.state,
        rows=row_state(rows, batch.worlds),
        certificates=np.repeat(counters, batch.worlds, axis=0),
    )
    return tables, state
