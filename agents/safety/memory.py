"""Memory of one UAV's safety filter: measurements, own positions, pending commands and the last decision.

Call in each tick: `add_position`, then `add_measurement` for each detection that has arrived, then
`agents.safety.decision.decide` with the nominal acceleration.

Positions in the world's frame [m], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.safety.discs import MOST_KEPT, NEVER, Disc, add_disc, no_discs
from agents.safety.pending import (
    PendingCommands,
    forget_checks,
    mark_unchecked,
    pending_commands,
    reset_pending,
)
from bus.messages.decision import FilterDecision, NotCertified, Source
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, code, record_type
from sim.models.safety import SafetyBounds
from sim.models.trajectories import clear_trajectories, no_trajectories
from sim.models.vehicles import State, within_walls

_TRACK = 120.0
"""Time for which own positions are kept [s]; the declared measurement age if it is longer."""

_NOMINAL, _NO_MEASUREMENT = code(Source.NOMINAL), code(NotCertified.NO_MEASUREMENT)


class OwnPosition(NamedTuple):
    """Position of the UAV in a past tick."""

    x: float
    y: float
    """Position [m]."""
    tick: int
    """Tick of the position; NEVER: the row is empty."""


class FilterFlags(NamedTuple):
    """Flags of the filter, a row of an array of length one."""

    contradicted: int
    """1 after measurements have contradicted each other."""
    tick: int
    """Tick of the last decision; NEVER before the first."""
    from_start: int
    """1 if this filter has sent all commands since tick 0."""


class SpiralSearch:
    """Search for a UGV out of sight, see `agents.safety.search`; a row of an array of length one."""

    tick: int
    """Tick of the measurement around which the UAV searches; NEVER: it has not searched."""
    direction: float
    """1 outward, -1 inward; 0: the UAV still flies to the measurement."""
    phase: float
    """Angle of the pursued point along the spiral [rad]."""
    heading: float
    """Direction of the spiral at its centre [rad]."""
    pitch: float
    speed: float
    reach: float
    """See `agents.safety.search.Spiral`."""


class FilterMemory(NamedTuple):
    """Memory of one UAV's filter, from `filter_memory`.

    For many worlds, the arrays have further axes in front.
    """

    discs: RecordArray
    """`Disc` of each kept measurement, from `add_disc`. Shape (KEPT,)."""
    plan: RecordArray
    """`CheckedTrajectory` of the current plan. Shape (1,)."""
    track: RecordArray
    """`OwnPosition` in past ticks: tick k in row k % depth. Shape (depth,)."""
    flags: RecordArray
    """`FilterFlags`. Shape (1,)."""
    pending: PendingCommands
    """Sent plans and the committed trajectory."""
    decision: RecordArray
    """`FilterDecision` of the last tick. Shape (1,)."""
    search: RecordArray
    """`SpiralSearch`. Shape (1,)."""


def track_ticks(bounds: SafetyBounds) -> int:
    """Return the number of ticks for which own positions are kept; each takes 24 bytes, allocated at once."""
    return max(1, min(MOST_KEPT, max(math.ceil(_TRACK / bounds.dt), bounds.max_age_ticks + 1)))


def filter_memory(delay_ticks: int, depth: int) -> FilterMemory:
    """Return an empty memory, without measurements and commands.

    Args:
        delay_ticks: Declared command delay, from the tick of a command to the tick in which it takes effect.
        depth: Number of ticks for which own positions are kept, at most `track_ticks`; detections that are older on
            arrival are ignored.

    Raises:
        ValueError: If the depth is not positive.
    """
    if depth < 1:
        raise ValueError(f"depth = {depth}: too small; allowed: at least 1")
    memory = FilterMemory(
        discs=no_discs(),
        plan=no_trajectories(1),
        track=np.zeros(depth, dtype=record_type(OwnPosition)),
        flags=np.zeros(1, dtype=record_type(FilterFlags)),
        pending=pending_commands(delay_ticks),
        decision=np.zeros(1, dtype=record_type(FilterDecision)),
        search=np.zeros(1, dtype=record_type(SpiralSearch)),
    )
    reset_memory(memory)
    return memory


@compiled
def _reset_search(search: RecordArray) -> None:
    row = search[0]
    row.tick, row.direction, row.phase, row.heading = NEVER, 0.0, 0.0, 0.0
    row.pitch, row.speed, row.reach = 0.0, 0.0, 0.0


@compiled
def reset_memory(memory: FilterMemory) -> None:
    """Reset a memory in place to the state from `filter_memory`, at the start of an episode."""
    for k in range(memory.discs.shape[0]):
        disc = memory.discs[k]
        disc.x, disc.y, disc.radius, disc.tick = 0.0, 0.0, 0.0, NEVER
    clear_trajectories(memory.plan)
    for k in range(memory.track.shape[0]):
        row = memory.track[k]
        row.x, row.y, row.tick = 0.0, 0.0, NEVER
    flags = memory.flags[0]
    flags.contradicted, flags.tick, flags.from_start = 0, NEVER, 0
    reset_pending(memory.pending)
    decision = memory.decision[0]
    decision.acceleration[0], decision.acceleration[1] = 0.0, 0.0
    decision.vertical_acceleration = 0.0
    decision.source, decision.reason = _NOMINAL, _NO_MEASUREMENT
    decision.certified_distance = math.inf
    _reset_search(memory.search)


@compiled
def restart_memory(memory: FilterMemory) -> None:
    """Start a new filter on a UAV whose plans so far are pending: forget all but these, which are unchecked."""
    for k in range(memory.discs.shape[0]):
        memory.discs[k].tick = NEVER
    clear_trajectories(memory.plan)
    for k in range(memory.track.shape[0]):
        memory.track[k].tick = NEVER
    memory.flags[0].contradicted, memory.flags[0].from_start = 0, 0
    _reset_search(memory.search)
    forget_checks(memory.pending)


@compiled
def add_position(memory: FilterMemory, tick: int, p_x: float, p_y: float) -> None:
    """Record the UAV's position at this tick [m], for detections of this tick that arrive later."""
    row = memory.track[tick % memory.track.shape[0]]
    row.x, row.y, row.tick = p_x, p_y, tick


@compiled
def add_measurement(
    bounds: SafetyBounds,
    memory: FilterMemory,
    taken: int,
    relative: tuple[float, float],
    tick: int,
    own: State,
) -> None:
    """Add a detection, in any order of arrival. Without a recorded own position of its tick it is ignored.

    Args:
        bounds: Bounds of the filter.
        memory: Memory of the filter, changed in place.
        taken: Tick of the detection.
        relative: Detected p_a - p_g at that tick [m].
        tick: Current tick.
        own: Current state of the UAV.
    """
    was = memory.track[taken % memory.track.shape[0]]
    if taken < 0 or was.tick != taken:
        return
    z_x, _ = within_walls(was.x - relative[0], 0.0, bounds.width)  # the UGV is in the area
    z_y, _ = within_walls(was.y - relative[1], 0.0, bounds.height)
    disc = Disc(z_x, z_y, bounds.placed_error, taken)
    if not add_disc(bounds, memory.discs, disc, tick, own.p_x, own.p_y):
        memory.flags[0].contradicted = 1


@compiled
def invalidate_plans(memory: FilterMemory) -> None:
    """Mark all plans unchecked, since the last commands may not have been sent.

    Nothing is certified until the vehicle executes a plan that is sent after this call.
    """
    memory.flags[0].from_start = 0
    mark_unchecked(memory.pending)
