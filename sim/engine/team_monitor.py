"""Counters that check a team's guarantee: its UAVs' reports, compared with their stored numbers and the true state.

Two of them must be 0 in every run: ticks in which a guard is certified although no UAV of the team sees the UGV, and
ticks that contradict the lemma of docs/explanation/proof.md: the UAVs with the g largest numbers guard, unless they
left exhausted.
"""

import numpy as np

from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, record_type

_NONE = -1
_ROUNDING = 1e-6
"""Tolerance of a distance between UAVs [m]."""


class TeamCounters:
    """Counters of one team, a row of a table."""

    ticks: int
    """Monitored ticks."""
    certified: int
    """Ticks in which a guard was certified."""
    lost: int
    """Ticks in which no UAV of the team saw the UGV."""
    certified_while_lost: int
    """Ticks in which a guard was certified although no UAV of the team saw the UGV."""
    broken: int
    """Ticks in which a UAV with one of the g largest numbers reported a role other than guard."""
    handovers: int
    """Changes of the UAV with the largest number."""
    left: int
    """Times that a guard with one of the g largest numbers left for its base."""
    extra: int
    """Ticks with more than g guards."""
    top: int
    """Row of the UAV with the largest number in the team; -1: none has one."""


class TeamReport:
    """Report of one UAV in a tick, and its true state."""

    number: int
    """Its stored number, as in its observation of this tick."""
    current: bool
    """True if it has reported in this tick; only then its role is checked."""
    guards: bool
    """True if it reports the role of a guard."""
    exhausted: bool
    """True if it reports to fly to its base, and its charge does not last longer."""
    left: bool
    """True since it left as a guard, exhausted; until it guards again."""
    certified: bool
    """True if its safety filter certifies sight as a guard's."""
    lost: bool
    """True if the UGV is out of its sight."""


def team_counters(teams: int) -> RecordArray:
    """Return counters at the start of a run. Shape (teams,)."""
    counts = np.zeros(teams, record_type(TeamCounters))
    counts["top"] = _NONE
    return counts


def team_reports(uavs: int) -> RecordArray:
    """Return empty reports of a team. Shape (uavs,)."""
    return np.zeros(uavs, record_type(TeamReport))


@compiled
def are_too_near(points: FloatArray, separation: float) -> bool:
    """Return whether two points are nearer to each other than the separation [m]; points [m]: shape (UAVs, 3)."""
    least = separation - _ROUNDING
    for i in range(points.shape[0]):
        for k in range(i):
            x, y = points[i, 0] - points[k, 0], points[i, 1] - points[k, 1]
            z = points[i, 2] - points[k, 2]
            if least > 0.0 and x * x + y * y + z * z < least * least:
                return True
    return False


@compiled
def _rank(reports: RecordArray, k: int) -> int:
    """Return how many UAVs have a greater number."""
    greater = 0
    for other in range(reports.shape[0]):
        if reports[other].number > reports[k].number:
            greater += 1
    return greater


@compiled
def record_team(counts: TeamCounters, reports: RecordArray, guards: int) -> None:
    """Count one tick of a team.

    Args:
        counts: Counters of the team, changed in place.
        reports: `TeamReport` of each of its UAVs. Shape (UAVs,).
        guards: Number of guards g.
    """
    certified, seen, broken, many, top = False, False, False, 0, _NONE
    for k in range(reports.shape[0]):
        one = reports[k]
        rank = _rank(reports, k)
        if one.number > 0 and rank == 0:
            top = k
        if one.guards:
            one.left = False
        if one.number > 0 and rank < guards and one.current and not (one.guards or one.left):
            if one.exhausted:
                one.left = True
                counts.left += 1
            else:
                broken = True
        certified = certified or (one.guards and one.certified)
        seen = seen or not one.lost
        many += 1 if one.guards else 0
    counts.ticks += 1
    counts.certified += 1 if certified else 0
    counts.lost += 0 if seen else 1
    counts.certified_while_lost += 1 if certified and not seen else 0
    counts.broken += 1 if broken else 0
    counts.handovers += 1 if top not in (counts.top, _NONE) and counts.top != _NONE else 0
    counts.extra += 1 if many > guards else 0
    counts.top = top
