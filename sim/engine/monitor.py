"""Counts that tell whether a UAV's certificate is true: its reports, held against what truly is.

Two of them must be 0 in every flight of every law and network: ticks that are certified while the UGV is out of
sight, and certificates that end although everything holds that is declared. The simulator counts so for the vehicles
of a run, and the closed loop for each of many worlds.
"""

from typing import NamedTuple

import numpy as np

from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.motion import waited
from sim.models.safety import SafetyBounds

_ROUNDING = 1e-9
"""A measured error that is larger than declared by no more than this [m] is as declared."""
NEVER = -(2**41)
"""The tick of a detection, where none has arrived."""


class CertificateCounters:
    """One UAV's counts and what they are made of, a row of a table."""

    newest: int
    """Tick of the newest detection that has arrived."""
    errors_kept: bool
    """True while no detection had a larger error than declared."""
    tracking_kept: bool
    """True while the UAV was as near as declared to where it was told that it is."""
    interval_kept: bool
    """True if the motion that the UAV flies began no longer ago than declared."""
    certified_before: bool
    """True if the tick before was certified, and nothing excuses that this one is not."""
    suspected: int
    since: int
    """Certificates that have ended while everything held, but where an outage may yet be seen; the last one's tick."""
    longest_interval: int
    """The longest time from the beginning of a motion to that of the next [ticks]."""
    ticks: int
    certified: int
    overridden: int
    """Ticks that are watched; those of them that were certified; those in which the filter acted."""
    certified_while_lost: int
    """Ticks that were certified although the UGV was out of sight, then or where the flight ended with the tick."""
    broken: int
    """Ticks that were not certified although the one before was and everything held."""


class ArrivalRecord:
    """The detections that have reached a UAV at one tick, a row of a table."""

    newest: int
    """The newest tick that one was taken in; NEVER: there is none."""
    error: float
    """The largest norm of an error, by the true relative position then [m]."""


class Claim(NamedTuple):
    """The claim of a safety filter at one tick, and what is true of it."""

    certified: bool
    """True if it says that sight is kept."""
    overridden: bool
    """True if it acted."""
    lost: bool
    """True if the UGV is out of sight, in the tick that is reported of."""
    current: bool
    """True if it is of this tick: with a clock that waits for nobody it may be of an earlier one, and without a report
    it is of none.
    """


def certificate_counters(uavs: int) -> RecordArray:
    """Nothing has been counted. Shape (uavs,)."""
    counts: RecordArray = np.zeros(uavs, record_type(CertificateCounters))
    for one in counts:
        reset_counters(one)
    return counts


@compiled
def reset_counters(counts: CertificateCounters) -> None:
    """Nothing has been counted: a flight begins."""
    counts.tracking_kept, counts.interval_kept = True, True
    counts.suspected, counts.since, counts.longest_interval = 0, 0, 0
    (
        counts.ticks,
        counts.certified,
        counts.overridden,
        counts.certified_while_lost,
        counts.broken,
    ) = 0, 0, 0, 0, 0
    reset_filter(counts)


@compiled
def reset_filter(counts: CertificateCounters) -> None:
    """A filter without a memory begins: it answers for no detection of before, and need not certify."""
    counts.newest, counts.errors_kept, counts.certified_before = NEVER, True, False


@compiled
def record_arrival(
    bounds: SafetyBounds, counts: CertificateCounters, taken: int, error: float
) -> None:
    """A detection of the tick `taken` has reached the UAV; its error is so large [m]."""
    counts.newest = max(counts.newest, taken)
    counts.errors_kept = counts.errors_kept and error <= bounds.max_measurement_error + _ROUNDING


@compiled
def _confirm(bounds: SafetyBounds, counts: CertificateCounters, tick: int) -> None:
    """Count what was suspected, if everything has held for long enough at this tick.

    That is until the motion of the suspected tick's command may begin: a pilot knows of an outage as soon as nothing
    that is under way can end it in time.
    """
    if tick >= counts.since + bounds.delay_ticks - 1:
        counts.broken += counts.suspected
        counts.suspected = 0


@compiled
def record_decision(
    bounds: SafetyBounds, counts: CertificateCounters, tick: int, said: Claim
) -> None:
    """Count a tick in which a safety filter watches over the UAV, after what has arrived at it."""
    held = (
        counts.errors_kept
        and counts.tracking_kept
        and counts.interval_kept
        and tick - counts.newest <= bounds.max_age_ticks
    )
    counts.ticks += 1
    if said.overridden:
        counts.overridden += 1
    if said.certified:
        counts.certified += 1
        if said.lost:
            counts.certified_while_lost += 1
    elif said.current and counts.certified_before and held:
        counts.suspected += 1
        counts.since = tick
        _confirm(bounds, counts, tick - 1)
    counts.certified_before = said.certified and said.current


@compiled
def record_interval(
    bounds: SafetyBounds, counts: CertificateCounters, tick: int, begins: int, bare: int
) -> None:
    """Hold what a UAV flies in this tick against the longest time between two motions.

    Args:
        bounds, counts: Of the UAV.
        tick: Which.
        begins: Tick in which the motion began that it flies; NO_MOTION: none.
        bare: Tick that the bare acceleration answers that acts instead; NEVER: a motion is flown.
    """
    if bare != NEVER:
        counts.interval_kept = (
            bare == tick and bounds.delay_ticks == 0 and bounds.interval_ticks == 1
        )
    else:
        wait = waited(tick, begins, bounds.delay_ticks) + 1  # so long at least
        counts.longest_interval = max(counts.longest_interval, wait)
        counts.interval_kept = wait <= bounds.interval_ticks
    if not counts.interval_kept:
        counts.suspected = 0
    _confirm(bounds, counts, tick)


@compiled
def record_end(counts: CertificateCounters, lost: bool) -> None:
    """The flight ends, and nobody is asked at its last state any more.

    Args:
        counts: Of the UAV.
        lost: Whether the UGV is out of sight there. If the tick before was certified, and everything held, that counts
            as certified out of sight.
    """
    if (
        counts.certified_before
        and counts.errors_kept
        and counts.tracking_kept
        and counts.interval_kept
        and lost
    ):
        counts.certified_while_lost += 1
    counts.certified_before = False


@compiled
def record_tracking_error(bounds: RecordArray, counts: RecordArray, uav: int, off: float) -> None:
    """One UAV truly is so far from where it is told that it is [m].

    Once that is farther than declared, what is seen from there may be wrong for as long as it is remembered.
    """
    kept = off <= bounds[uav].max_tracking_error + _ROUNDING
    counts[uav].tracking_kept = counts[uav].tracking_kept and kept


@compiled
def record_tick(
    tables: tuple[RecordArray, RecordArray],
    evidence: tuple[RecordArray, RecordArray, RecordArray],
    place: tuple[int, int, int],
    answers: bool,
    said: tuple[bool, bool, bool, bool],
) -> None:
    """`record_arrival`, `record_decision` and `record_interval` of one UAV, for Python.

    Args:
        tables: `SafetyBounds` and `CertificateCounters` of all UAVs.
        evidence: The truth of this tick: `ArrivalRecord` of each UAV, `Vehicle` of each vehicle, and
            `CheckedTrajectory` that each flew.
        place: Its row among the UAVs, its row among all vehicles, and the tick.
        answers: Whether it has a new command; else it has seen nothing either.
        said: A `Claim`.
    """
    (bounds, counts), (arrivals, vehicles, flown), (uav, vehicle, tick) = tables, evidence, place
    b, c = bounds[uav], counts[uav]
    if answers:
        record_arrival(b, c, arrivals[uav].newest, arrivals[uav].error)
    record_decision(b, c, tick, Claim(said[0], said[1], said[2], said[3]))
    bare = vehicles[vehicle].command_tick if flown[vehicle].plain == 1 else NEVER
    record_interval(b, c, tick, flown[vehicle].begins, bare)
