"""Counts that tell whether a UAV's certificate is true: its reports, held against what truly is.

Two of them must be 0 in every flight of every law and network: ticks that are certified while the UGV is out of
sight, and certificates that end although everything holds that is declared. The simulator counts so for the vehicles
of a run, and the closed loop for each of many worlds.
"""

import math
from typing import NamedTuple

import numpy as np

from bus.messages import DeclaredBounds
from bus.ticks import first_tick_from, ticks_within
from sim.kernels.compile import compiled
from sim.kernels.records import RecordArray, record_type
from sim.models.motion import waited

_ROUNDING = 1e-9
"""A measured error that is larger than declared by no more than this [m] is as declared."""
NEVER = -(2**41)
"""The tick of a detection, where none has arrived."""


class CertificateBounds(NamedTuple):
    """The declared bounds of one UAV's detections and commands."""

    error: float
    """Largest error of a detection, as a vector's norm [m]; infinite: it has no bound."""
    tracking: float
    """Largest true distance of the UAV from where it is told that it is [m]; likewise."""
    age: int
    """Largest age of the newest detection that has arrived [ticks]."""
    delay: int
    """From the tick that a command answers to the one in which it acts [ticks]."""
    interval: int
    """Longest time from the start of a motion to the start of the next [ticks]."""


class CertificateCounts:
    """One UAV's counts and what they are made of, a row of a table."""

    newest: int
    """Tick of the newest detection that has arrived."""
    exact: bool
    """True while no detection had a larger error than declared."""
    tracked: bool
    """True while the UAV was as near as declared to where it was told that it is."""
    obeyed: bool
    """True if the motion that the UAV flies began no longer ago than declared."""
    promised: bool
    """True if the tick before was certified, and nothing excuses that this one is not."""
    suspected: int
    since: int
    """Certificates that have ended while everything held, but where an outage may yet be seen; the last one's tick."""
    longest_outage: int
    """The longest time from the beginning of a motion to that of the next [ticks]."""
    ticks: int
    certified: int
    intervened: int
    """Ticks that are watched; those of them that were certified; those in which the filter acted."""
    lost: int
    """Ticks that were certified although the UGV was out of sight, then or where the flight ended with the tick."""
    broken: int
    """Ticks that were not certified although the one before was and everything held."""


class ArrivalRecord:
    """The detections that have reached a UAV at one tick, a row of a table."""

    newest: int
    """The newest tick that one was taken in; NEVER: there is none."""
    error: float
    """The largest norm of an error, by the true relative position then [m]."""


class CertificateClaim(NamedTuple):
    """The claim of a safety filter at one tick, and what is true of it."""

    certified: bool
    """True if it says that sight is kept."""
    intervened: bool
    """True if it acted."""
    lost: bool
    """True if the UGV is out of sight, in the tick that is reported of."""
    current: bool
    """True if it is of this tick: with a clock that waits for nobody it may be of an earlier one, and without a report
    it is of none.
    """


def certificate_bounds(declared: DeclaredBounds, dt: float) -> CertificateBounds:
    """The bounds as they are counted with; dt [s] is the length of a tick."""

    def within(bound: float | None) -> float:
        return math.inf if bound is None else bound + _ROUNDING

    return CertificateBounds(
        error=within(declared.error),
        tracking=within(declared.tracking),
        age=ticks_within(declared.age, dt),
        delay=first_tick_from(declared.delay, dt),
        interval=max(1, ticks_within(declared.outage, dt)),
    )


def certificate_counts(uavs: int) -> RecordArray:
    """Nothing has been counted. Shape (uavs,)."""
    counts: RecordArray = np.zeros(uavs, record_type(CertificateCounts))
    for one in counts:
        begin_counts(one)
    return counts


@compiled
def begin_counts(counts: CertificateCounts) -> None:
    """Nothing has been counted: a flight begins."""
    counts.tracked, counts.obeyed = True, True
    counts.suspected, counts.since, counts.longest_outage = 0, 0, 0
    counts.ticks, counts.certified, counts.intervened, counts.lost, counts.broken = 0, 0, 0, 0, 0
    begin_filter(counts)


@compiled
def begin_filter(counts: CertificateCounts) -> None:
    """A filter without a memory begins: it answers for no detection of before, and need not certify."""
    counts.newest, counts.exact, counts.promised = NEVER, True, False


@compiled
def note_arrival(
    bounds: CertificateBounds, counts: CertificateCounts, taken: int, error: float
) -> None:
    """A detection of the tick `taken` has reached the UAV; its error is so large [m]."""
    counts.newest = max(counts.newest, taken)
    counts.exact = counts.exact and error <= bounds.error


@compiled
def _confirm(bounds: CertificateBounds, counts: CertificateCounts, tick: int) -> None:
    """Count what was suspected, if everything has held for long enough at this tick.

    That is until the motion of the suspected tick's command may begin: a pilot knows of an outage as soon as nothing
    that is under way can end it in time.
    """
    if tick >= counts.since + bounds.delay - 1:
        counts.broken += counts.suspected
        counts.suspected = 0


@compiled
def note_report(
    bounds: CertificateBounds, counts: CertificateCounts, tick: int, said: CertificateClaim
) -> None:
    """Count a tick in which a safety filter watches over the UAV, after what has arrived at it."""
    held = counts.exact and counts.tracked and counts.obeyed and tick - counts.newest <= bounds.age
    counts.ticks += 1
    if said.intervened:
        counts.intervened += 1
    if said.certified:
        counts.certified += 1
        if said.lost:
            counts.lost += 1
    elif said.current and counts.promised and held:
        counts.suspected += 1
        counts.since = tick
        _confirm(bounds, counts, tick - 1)
    counts.promised = said.certified and said.current


@compiled
def note_action(
    bounds: CertificateBounds, counts: CertificateCounts, tick: int, begins: int, bare: int
) -> None:
    """Hold what a UAV flies in this tick against the longest time between two motions.

    Args:
        bounds, counts: Of the UAV.
        tick: Which.
        begins: Tick in which the motion began that it flies; NO_MOTION: none.
        bare: Tick that the bare acceleration answers that acts instead; NEVER: a motion is flown.
    """
    if bare != NEVER:
        counts.obeyed = bare == tick and bounds.delay == 0 and bounds.interval == 1
    else:
        wait = waited(tick, begins, bounds.delay) + 1  # so long at least
        counts.longest_outage = max(counts.longest_outage, wait)
        counts.obeyed = wait <= bounds.interval
    if not counts.obeyed:
        counts.suspected = 0
    _confirm(bounds, counts, tick)


@compiled
def note_end(counts: CertificateCounts, lost: bool) -> None:
    """The flight ends, and nobody is asked at its last state any more.

    Args:
        counts: Of the UAV.
        lost: Whether the UGV is out of sight there. If the tick before was certified, and everything held, that counts
            as certified out of sight.
    """
    if counts.promised and counts.exact and counts.tracked and counts.obeyed and lost:
        counts.lost += 1
    counts.promised = False


@compiled
def count_tracking(bounds: RecordArray, counts: RecordArray, uav: int, off: float) -> None:
    """One UAV truly is so far from where it is told that it is [m].

    Once that is farther than declared, what is seen from there may be wrong for as long as it is remembered.
    """
    counts[uav].tracked = counts[uav].tracked and off <= bounds[uav].tracking


@compiled
def count_tick(
    tables: tuple[RecordArray, RecordArray],
    evidence: tuple[RecordArray, RecordArray, RecordArray],
    place: tuple[int, int, int],
    answers: bool,
    said: tuple[bool, bool, bool, bool],
) -> None:
    """`note_arrival`, `note_report` and `note_action` of one UAV, for Python.

    Args:
        tables: `CertificateBounds` and `CertificateCounts` of all UAVs.
        evidence: The truth of this tick: `ArrivalRecord` of each UAV, `Vehicle` of each vehicle, and `MotionRecord` of
            the motion that each flew.
        place: Its row among the UAVs, its row among all vehicles, and the tick.
        answers: Whether it has a new command; else it has seen nothing either.
        said: A `CertificateClaim`.
    """
    (bounds, counts), (arrivals, vehicles, flown), (uav, vehicle, tick) = tables, evidence, place
    b, c = bounds[uav], counts[uav]
    if answers:
        note_arrival(b, c, arrivals[uav].newest, arrivals[uav].error)
    note_report(b, c, tick, CertificateClaim(said[0], said[1], said[2], said[3]))
    bare = vehicles[vehicle].command_tick if flown[vehicle].plain == 1 else NEVER
    note_action(b, c, tick, flown[vehicle].begins, bare)
