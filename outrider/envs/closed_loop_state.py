"""Parameters, tables and state of `outrider.envs.closed_loop`: the arrays that its compiled tick works on."""

from typing import Any, NamedTuple

from agents.drivers.dispatch import DriverTables
from agents.drivers.tile_map import GroundMemory
from agents.estimation.map_updates import TellingMemory
from agents.laws.dispatch import LawTables
from agents.safety.memory import FilterMemory
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.engine.world_state import BatchState, BatchTables
from sim.env.rows import RowState, RowTables
from sim.models.ground import TileArray


class LoopParameters(NamedTuple):
    """The switches and numbers of the pilots."""

    estimate: bool
    """True if the rows have the filter's estimate in the place of the raw detection."""
    gradient: bool
    """True if the rows have the gradient."""
    own_maps: bool
    """True if each UAV has a map of its own; else all that is truly seen is its own."""
    radio: bool
    """True if any UGV uses the radio."""
    radio_ticks: int
    telling_ticks: int
    """Every how many ticks a UAV radios a block of tiles; 0: never, there is no ground to tell of."""
    tile: float
    """Width of a tile [m]; 0 likewise."""
    meters_per_pixel: float


class CommandedTables(NamedTuple):
    """The constants of all worlds in which every action comes from outside."""

    batch: BatchTables
    rows: RowTables
    hand: IntArray
    """For each vehicle its row in the actions from outside; -1: it is flown in here. Shape (vehicles,)."""


class CommandedState(NamedTuple):
    """Everything that changes there. All arrays have an axis for worlds in front."""

    batch: BatchState
    rows: RowState
    """Standings and observation rows."""
    certificates: RecordArray
    """`CertificateCounters` of each UAV. Shape (worlds, UAVs)."""


class LoopTables(NamedTuple):
    """The constants of all worlds with pilots, estimates or pictures: `CommandedTables` and more."""

    batch: BatchTables
    rows: RowTables
    hand: IntArray
    laws: LawTables
    drivers: DriverTables
    thinking: IntArray
    """For each UAV whether its estimate is needed. Shape (UAVs,)."""
    filtered: IntArray
    """For each UAV whether the safety filter watches over it. Shape (UAVs,)."""
    receivers: IntArray
    """For each UAV the row among the UGVs of the one that receives its radio. Shape (UAVs,)."""
    kalman: RecordArray
    """`KalmanParameters` of each UAV. Shape (UAVs,)."""
    safety: RecordArray
    """`SafetyBounds` of each UAV's filter. Shape (UAVs,)."""
    monitored: RecordArray
    """`SafetyBounds` of each UAV, with which its certificates are counted. Shape (UAVs,)."""
    scripts: FloatArray
    script_rows: IntArray
    late: IntArray
    """For each UGV after how many ticks its commands act. Shape (UGVs,)."""


class LoopState(NamedTuple):
    """Everything that changes there: `CommandedState` and more. All arrays have an axis for worlds in front."""

    batch: BatchState
    rows: RowState
    certificates: RecordArray
    maps: FloatArray
    """The UAVs' own maps, where they differ from the world's. Shape (worlds, UAVs or 0, rows, columns)."""
    laws: Any
    """`PerLaw`: memories of the laws. Shape (worlds, UAVs) each."""
    drivers: Any
    """`PerDriver`: memories of the drivers. Shape (worlds, UGVs) each."""
    kalman: RecordArray
    """`EstimatorRow` of each UAV. Shape (worlds, UAVs, 1 + depth): see `agents.estimation.batch_filter`."""
    filters: FilterMemory
    """Memory of each UAV's safety filter. Shape (worlds, UAVs, ...)."""
    grounds: GroundMemory
    """The ground as each UGV knows it; without tiles where there are no hazards. Shape (worlds, UGVs, ...)."""
    outbox: RecordArray
    """`Packet`: the radio messages that each UAV has just sent, of its relative position and of the ground.

    Shape (worlds, UAVs, 2).
    """
    looks: FloatArray
    """Room for the detections that have reached one UAV: tick, p_delta [m]. Shape (worlds, room, 3)."""
    inboxes: FloatArray
    """The radio messages of where it is that have reached each UGV at this tick: the tick, p_delta [m].

    Shape (worlds, UGVs, room, 3).
    """
    arrived: IntArray
    """Their number. Shape (worlds, UGVs)."""
    patches: FloatArray
    """Pictures of the UAVs' own maps. Shape (worlds, UAVs or 0, pixels, pixels)."""
    telling: TellingMemory
    """Of each UAV. Shape (worlds, UAVs, ...)."""
    places: IntArray
    states: TileArray
    """Room for tiles that a UGV is told of: rows and columns, and states. Shapes (worlds, 2, room), (worlds, room)."""
