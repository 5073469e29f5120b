"""What `outrider.envs.closed_loop` is told, keeps and shares: the arrays that its compiled tick works on."""

from typing import NamedTuple

from agents.control.guard import GuardState
from agents.estimation.twin import KalmanState
from bus.layout import GradientCue, UavRow
from sim.channel.link import LinkState, LinkTable
from sim.engine.world_state import BatchState, BatchTables
from sim.kernels.compile import FloatArray, IntArray
from sim.kernels.records import RecordArray

UAV_ROW = len(UavRow._fields) + len(GradientCue._fields)
"""Numbers of a UAV's row: `UavRow`, then `GradientCue`."""

(
    NEWEST,
    WAS_LOST,
    LOST,
    DISTANCE,
    MAX_DISTANCE,
    VIOLATIONS,
    ERROR,
    ERROR_SUM,
    INTERVENED,
    CERTIFIED_TICKS,
    SHIELDED,
) = range(11)
ACTED, SURE, BOUND = range(11, 14)
OBEYED, FALSE_TICKS, BROKEN = range(14, 17)
"""Columns of `LoopState.uav_seats`: tick of the newest detection (-1: none); whether sight was and is lost.

Distance now and at
most [m]; ticks out of sight; e(t) now and summed over the ticks so far [m²]; ticks in which the safety filter
acted, which were
certified, and which it was asked; of the last tick, whether it acted, whether certified, and the distance that it
bounds [m];
whether the command that acted in the last tick was the one that was due; ticks that were certified out of sight, and
ticks that were not certified although the one before was and all assumptions held."""
SEAT_SIZE = 17

REACHED, ARRIVALS, NEARER, TO_GO = range(4)
"""Columns of `LoopState.ugv_seats`.

Goals reached, those of this tick, how much nearer it came [m], way to the next one [m].
"""


class LoopParameters(NamedTuple):
    """What the loop does, as plain numbers."""

    ticks: int
    """Of an episode."""
    error: bool
    """Whether e(t) is needed at every tick."""
    estimate: bool
    """Whether the rows have the filter's estimate in the place of the raw detection."""
    gradient: bool
    """Whether the rows have the gradient."""
    end_on_sight_lost: bool
    end_on_goals: bool
    own_maps: bool
    """Whether each UAV has a map of its own; else all that is seen is its own."""
    radio: bool
    """Whether any UGV listens to the radio."""
    radio_ticks: int
    full: float
    """`full_error` [m²]."""
    meters_per_pixel: float


class LoopTables(NamedTuple):
    """What all worlds share and nobody changes."""

    batch: BatchTables
    place: IntArray
    """For each vehicle its row among the UAVs, or -1 - its row among the UGVs. Shape (vehicles,)."""
    hand: IntArray
    """For each vehicle its row in the actions from outside; -1: it is flown in here. Shape (vehicles,)."""
    ugv_rows: IntArray
    """Rows of the UGVs. Shape (UGVs,)."""
    thinking: IntArray
    """For each UAV whether its estimate is needed. Shape (UAVs,)."""
    guarded: IntArray
    """For each UAV whether the safety filter watches over it. Shape (UAVs,)."""
    faults: IntArray
    """For each UAV whether its certificate's assumptions fail. Shape (UAVs,)."""
    delays: IntArray
    """For each UAV the declared delay of its commands [ticks]. Shape (UAVs,)."""
    ages: IntArray
    """For each UAV the declared age of the newest detection [ticks]. Shape (UAVs,)."""
    bounded: IntArray
    """For each UAV whether no detection can have a larger error than is declared. Shape (UAVs,)."""
    listeners: IntArray
    """For each UAV the row among the UGVs of the one that hears it. Shape (UAVs,)."""
    kalman: RecordArray
    """`KalmanParameters` of each UAV. Shape (UAVs,)."""
    promises: RecordArray
    """`Promise` of each UAV. Shape (UAVs,)."""
    tolerances: FloatArray
    """Goal tolerance of each UGV [m]. Shape (UGVs,)."""
    goals: FloatArray
    """The goals of all UGVs [m]. Shape (any, 2)."""
    goal_rows: IntArray
    """Where each UGV's begin. Shape (UGVs + 1,)."""
    scripts: FloatArray
    script_rows: IntArray
    weights: FloatArray
    """The numbers of `RewardWeights`, in its order."""
    radio: LinkTable
    """A row for each UAV."""
    seen: IntArray
    """The sensor's disc, and of the density (9), from `sim.kernels.prefetch.disc_widths`."""
    around: IntArray


class LoopState(NamedTuple):
    """Everything that changes. All arrays have an axis for worlds in front."""

    batch: BatchState
    maps: FloatArray
    """The UAVs' own maps, where they differ from the world's. Shape (worlds, UAVs or 0, rows, columns)."""
    sent: FloatArray
    """The UAVs' last commands [m/s²], that of tick k in row k % (delay + 1).

    Shape (worlds, UAVs, largest delay + 1, 2).
    """
    laws: RecordArray
    """`LawParameters` of each UAV, with the key of its pilot in this world. Shape (worlds, UAVs)."""
    drivers: RecordArray
    """`DriverParameters` of each UGV, likewise. Shape (worlds, UGVs)."""
    law_states: FloatArray
    """Shape (worlds, UAVs, STATE_SIZE)."""
    kalman: KalmanState
    guards: GuardState
    driver_states: FloatArray
    """Shape (worlds, UGVs, DRIVER_STATE)."""
    outbox: FloatArray
    """The radio message that each UAV has just sent: the tick of it (-1: none), p_delta [m]. Shape (worlds, UAVs, 3)."""
    radio: LinkState
    inbox: FloatArray
    """What has arrived by one radio link: tick, p_delta [m]. Shape (worlds, room, 3)."""
    heard: FloatArray
    """What each UGV hears at this tick. Shape (worlds, UGVs, room, 3)."""
    hearing: IntArray
    """How many. Shape (worlds, UGVs)."""
    uav_seats: FloatArray
    ugv_seats: FloatArray
    uav_rows: FloatArray
    """What each UAV observes. Shape (worlds, UAVs, UAV_ROW)."""
    ugv_rows: FloatArray
    """What each UGV observes. Shape (worlds, UGVs, 8)."""
    patches: FloatArray
    """Pictures of the UAVs' own maps. Shape (worlds, UAVs or 0, pixels, pixels)."""
    rewards: FloatArray
    """Of the last tick. Shape (worlds, vehicles)."""
    terminated: IntArray
    truncated: IntArray
    """Shape (worlds,)."""
