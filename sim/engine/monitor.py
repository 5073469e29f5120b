"""Counters that check a UAV's certificate: its reports, compared with the true state.

Two of them must be 0 in every run, with every control law and network: certified ticks in which the UGV is out of
sight, and certificates that end although all declared bounds hold. The simulator counts them for the vehicles of a run,
and the closed loop for each of many worlds.
"""

from typing import NamedTuple

import numpy as np

from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.safety import SafetyBounds
from sim.models.trajectories import waited

_ROUNDING = 1e-9
"""Tolerance when a measured error is compared with its bound [m]."""
NEVER = -(2**41)
"""Placeholder tick: no detection has arrived."""


class CertificateCounters:
    """Counters of one UAV, a row of a table."""

    newest: int
    """Tick of the newest received detection."""
    errors_kept: bool
    """True while no detection error exceeded its bound."""
    tracking_kept: bool
    """True while the tracking error stayed within its bound."""
    interval_kept: bool
    """True if the active trajectory started no longer ago than the bound allows."""
    certified_before: bool
    """True if the previous tick was certified and this one is not excused."""
    suspected: int
    since: int
    """Certificates that ended although all bounds held, while a lost command may still explain it; tick of the last
    one.
    """
    longest_interval: int
    """Longest time from the start of one trajectory to the start of the next [ticks]."""
    ticks: int
    certified: int
    overridden: int
    """Supervised ticks; of these, ticks certified, and ticks overridden by the filter."""
    certified_while_lost: int
    """Certified ticks in which, or at whose end, the UGV was out of sight."""
    revoked: int
    lost_without_clearance: int
    """Ticks that the filter certified, but in which the UGV kept no distance from buildings; of these, ticks in which
    it was out of sight. They are not counted as certified.
    """
    broken: int
    """Ticks not certified although the previous tick was and all bounds held."""
    tracking_exceeded: int
    """Ticks in which the tracking error exceeded its bound."""


class ArrivalRecord:
    """Detections that reached a UAV at one tick, a row of a table."""

    newest: int
    """Tick of the newest one; NEVER: none."""
    error: float
    """Largest norm of a detection error, relative to the true relative position [m]."""


class Evidence(NamedTuple):
    """True state of a tick; the arrays change during the run."""

    arrivals: RecordArray
    """`ArrivalRecord` of each UAV. Shape (UAVs,)."""
    vehicles: RecordArray
    """`Vehicle`. Shape (vehicles,)."""
    flown: RecordArray
    """Active `CheckedTrajectory` of each vehicle. Shape (vehicles,)."""


class Claim(NamedTuple):
    """Claim of a safety filter at one tick, with its true state."""

    certified: bool
    """True if the filter certifies visibility."""
    overridden: bool
    """True if the filter overrode the control law."""
    lost: bool
    """True if the UGV is out of sight in the reported tick."""
    current: bool
    """True if the claim belongs to this tick; in real time it may belong to an earlier one, and without a report to
    none.
    """
    clear: bool
    """True if the UGV keeps the distance from buildings that the filter assumes, see
    `sim.engine.mission.keeps_clearance`.
    """


def certificate_counters(uavs: int) -> RecordArray:
    """Return counters that are all zero. Shape (uavs,)."""
    counts: RecordArray = np.zeros(uavs, record_type(CertificateCounters))
    for one in counts:
        reset_counters(one)
    return counts


@compiled
def reset_counters(counts: CertificateCounters) -> None:
    """Reset the counters at the start of a run."""
    counts.tracking_kept, counts.interval_kept = True, True
    counts.suspected, counts.since, counts.longest_interval = 0, 0, 0
    (
        counts.ticks,
        counts.certified,
        counts.overridden,
        counts.certified_while_lost,
        counts.broken,
        counts.revoked,
        counts.lost_without_clearance,
        counts.tracking_exceeded,
    ) = 0, 0, 0, 0, 0, 0, 0, 0
    reset_filter(counts)


@compiled
def reset_filter(counts: CertificateCounters) -> None:
    """Reset the memory of a new filter: it has no earlier detections, and need not be certified."""
    counts.newest, counts.errors_kept, counts.certified_before = NEVER, True, False


@compiled
def record_arrival(
    bounds: SafetyBounds, counts: CertificateCounters, measured: int, error: float
) -> None:
    """Record a detection of the tick `measured` that has reached the UAV, with its error [m]."""
    counts.newest = max(counts.newest, measured)
    counts.errors_kept = counts.errors_kept and error <= bounds.max_measurement_error + _ROUNDING


@compiled
def _confirm(bounds: SafetyBounds, counts: CertificateCounters, tick: int) -> None:
    """Count the suspected violations once all bounds have held for long enough.

    That is until the trajectory of the suspected tick's command may start: a pilot knows that an interval is too long
    as soon as no pending command can end it in time.
    """
    if tick >= counts.since + bounds.delay_ticks - 1:
        counts.broken += counts.suspected
        counts.suspected = 0


@compiled
def record_decision(
    bounds: SafetyBounds, counts: CertificateCounters, tick: int, claim: Claim
) -> None:
    """Record a tick in which a safety filter supervises the UAV, after its arrivals."""
    bounds_kept = (
        counts.errors_kept
        and counts.tracking_kept
        and counts.interval_kept
        and tick - counts.newest <= bounds.max_age_ticks
    )
    counts.ticks += 1
    if claim.overridden:
        counts.overridden += 1
    if claim.certified and not claim.clear:
        counts.revoked += 1
        if claim.lost:
            counts.lost_without_clearance += 1
    elif claim.certified:
        counts.certified += 1
        if claim.lost:
            counts.certified_while_lost += 1
    elif claim.current and counts.certified_before and bounds_kept:
        counts.suspected += 1
        counts.since = tick
        _confirm(bounds, counts, tick - 1)
    counts.certified_before = claim.certified and claim.current


@compiled
def record_interval(
    bounds: SafetyBounds, counts: CertificateCounters, tick: int, begins: int, bare: int
) -> None:
    """Compare the trajectory that a UAV executes in this tick with the longest command interval.

    Args:
        bounds, counts: Bounds and counters of the UAV.
        tick: The tick.
        begins: First tick of the active trajectory; NO_TRAJECTORY: none.
        bare: Tick answered by the bare acceleration that acts instead; NEVER: a trajectory is active.
    """
    if bare != NEVER:
        counts.interval_kept = (
            bare == tick and bounds.delay_ticks == 0 and bounds.interval_ticks == 1
        )
    else:
        wait = waited(tick, begins, bounds.delay_ticks) + 1  # a lower bound of the interval
        counts.longest_interval = max(counts.longest_interval, wait)
        counts.interval_kept = wait <= bounds.interval_ticks
    if not counts.interval_kept:
        counts.suspected = 0
    _confirm(bounds, counts, tick)


@compiled
def record_end(counts: CertificateCounters, lost: bool, clear: bool) -> None:
    """Finish a run: the vehicles report nothing about its last state.

    Args:
        counts: Counters of the UAV.
        lost: True if the UGV is out of sight there. If the previous tick was certified and all bounds held, this counts
            as certified out of sight.
        clear: As in `Claim`.
    """
    if (
        counts.certified_before
        and counts.errors_kept
        and counts.tracking_kept
        and counts.interval_kept
        and lost
    ):
        if clear:
            counts.certified_while_lost += 1
        else:
            counts.lost_without_clearance += 1
    counts.certified_before = False


@compiled
def record_tracking_error(bounds: RecordArray, counts: RecordArray, uav: int, off: float) -> None:
    """Record the tracking error of a UAV [m].

    After it exceeds its bound, measurements may stay wrong for as long as the filter remembers them.
    """
    kept = off <= bounds[uav].max_tracking_error + _ROUNDING
    counts[uav].tracking_kept = counts[uav].tracking_kept and kept
    if not kept:
        counts[uav].tracking_exceeded += 1


@compiled
def record_tick(
    tables: tuple[RecordArray, RecordArray],
    evidence: Evidence,
    uav: int,
    vehicle: int,
    tick: int,
    answers: bool,
    claim: Claim,
) -> None:
    """Call `record_arrival`, `record_decision` and `record_interval` for one UAV, from Python.

    Args:
        tables: `SafetyBounds` and `CertificateCounters` of all UAVs.
        evidence: True state of this tick.
        uav, vehicle: Row among the UAVs, and row among all vehicles.
        tick: The tick.
        answers: True if it has a new command; without one, its detections count as not received.
        claim: Claim of its filter.
    """
    (bounds, counts), (arrivals, vehicles, flown) = tables, evidence
    b, c = bounds[uav], counts[uav]
    if answers:
        record_arrival(b, c, arrivals[uav].newest, arrivals[uav].error)
    record_decision(b, c, tick, claim)
    bare = vehicles[vehicle].command_tick if flown[vehicle].plain == 1 else NEVER
    record_interval(b, c, tick, flown[vehicle].begins, bare)
