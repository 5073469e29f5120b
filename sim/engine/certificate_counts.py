"""Counts that tell whether a UAV's certificate is true: its reports, held against what truly is.

Two of them must be 0 in every flight of every law and network: ticks that are certified while the UGV is out of
sight, and certificates that end although everything holds that is declared. The simulator counts so for the vehicles
of a run, and the closed loop for each of many worlds.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.messages import DeclaredBounds
from bus.ticks import first_tick_from, ticks_within
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, record_type
from sim.models.motion import waited

_ROUNDING = 1e-9
"""A measured error that is larger than declared by no more than this [m] is as declared."""
NEVER = -(2**41)
"""The tick of a detection, where none has arrived."""
_NO_OUTAGE = -1


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
    outage: int
    """From the beginning of a motion to that of the next at most [ticks]; -1: commands carry no motions."""


class CertificateCounts:
    """One UAV's counts and what they are made of, a row of a table."""

    newest: int
    """Tick of the newest detection that has arrived."""
    exact: bool
    """True while no detection had a larger error than declared."""
    tracked: bool
    """True while the UAV was as near as declared to where it was told that it is."""
    obeyed: bool
    """True if in the last tick that command acted, or such a motion was flown, as should have been."""
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

    outage = declared.outage
    return CertificateBounds(
        error=within(declared.error),
        tracking=within(declared.tracking),
        age=ticks_within(declared.age, dt),
        delay=first_tick_from(declared.delay, dt),
        outage=_NO_OUTAGE if outage is None else ticks_within(outage, dt),
    )


def certificate_counts(uavs: int) -> RecordArray:
    """Nothing has been counted. Shape (uavs,)."""
    counts: RecordArray = np.zeros(uavs, record_type(CertificateCounts))
    counts["newest"] = NEVER
    for name in ("exact", "tracked", "obeyed"):
        counts[name] = True
    return counts


def sent_commands(bounds: Sequence[CertificateBounds]) -> FloatArray:
    """Room for each UAV's last commands: the tick that each answers, and the acceleration [m/s²].

    Before the first there is none, and nothing acts. Shape (UAVs, largest delay + 1, 3).
    """
    rows = max((one.delay for one in bounds), default=0) + 1
    sent = np.zeros((len(bounds), rows, 3))
    sent[:, :, 0] = np.arange(rows) - rows
    return sent


@compiled
def note_arrival(
    bounds: CertificateBounds, counts: CertificateCounts, taken: int, error: float
) -> None:
    """A detection of the tick `taken` has reached the UAV; its error is so large [m]."""
    counts.newest = max(counts.newest, taken)
    counts.exact = counts.exact and error <= bounds.error


@compiled
def note_sent(sent: FloatArray, answered: int, u_x: float, u_y: float) -> None:
    """The UAV's command [m/s²] for the tick `answered` has set out."""
    row = answered % sent.shape[0]
    sent[row, 0], sent[row, 1], sent[row, 2] = answered, u_x, u_y


@compiled
def _confirm(bounds: CertificateBounds, counts: CertificateCounts, tick: int) -> None:
    """Count what was suspected, if everything has held for long enough at this tick.

    Where commands carry motions that is until the motion of the suspected tick's command may begin: a pilot knows of an
    outage as soon as nothing that is under way can end it in time.
    """
    if bounds.outage == _NO_OUTAGE or tick >= counts.since + bounds.delay - 1:
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
    bounds: CertificateBounds,
    counts: CertificateCounts,
    sent: FloatArray,
    tick: int,
    u_x: float,
    u_y: float,
    begins: int,
) -> None:
    """A command [m/s²] acts in this tick, or a motion that began in the tick `begins`; NO_MOTION: none is flown."""
    if bounds.outage != _NO_OUTAGE:
        wait = waited(tick, begins, bounds.delay) + 1  # so long at least
        counts.longest_outage = max(counts.longest_outage, wait)
        counts.obeyed = wait <= bounds.outage
        if not counts.obeyed:
            counts.suspected = 0
        _confirm(bounds, counts, tick)
        return
    due = tick - bounds.delay
    row = due % sent.shape[0]
    counts.obeyed = sent[row, 0] == due and sent[row, 1] == u_x and sent[row, 2] == u_y


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
    tables: tuple[RecordArray, RecordArray, FloatArray],
    evidence: tuple[RecordArray, FloatArray, RecordArray],
    place: tuple[int, int, int],
    command: tuple[int, float, float],
    said: tuple[bool, bool, bool, bool],
) -> None:
    """`note_sent`, `note_arrival`, `note_report` and `note_action` of one UAV, for Python.

    Args:
        tables: `CertificateBounds`, `CertificateCounts` and `sent_commands` of all UAVs.
        evidence: What is true of this tick: `ArrivalRecord` of each UAV, the commands that acted [m/s²] in the shape
            (vehicles, 2), and `MotionRecord` of the motion that each vehicle flew.
        place: Its row among the UAVs, its row among all vehicles, and the tick.
        command: The tick that its new command answers, and the acceleration [m/s²]; NEVER: it has none, and so it has
            seen nothing either.
        said: A `CertificateClaim`.
    """
    (bounds, counts, sent), (arrivals, acted, flown), (uav, vehicle, tick) = tables, evidence, place
    b, c = bounds[uav], counts[uav]
    if command[0] != NEVER:
        note_sent(sent[uav], command[0], command[1], command[2])
        note_arrival(b, c, arrivals[uav].newest, arrivals[uav].error)
    note_report(b, c, tick, CertificateClaim(said[0], said[1], said[2], said[3]))
    u_x, u_y = acted[vehicle, 0], acted[vehicle, 1]
    note_action(b, c, sent[uav], tick, u_x, u_y, flown[vehicle].begins)
