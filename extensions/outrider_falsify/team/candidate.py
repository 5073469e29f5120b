"""Flight of an attack on a team, and its result."""

from dataclasses import dataclass, field

from agents.ugv import UgvPilot
from outrider_falsify.candidate import CandidateResult
from outrider_falsify.genome import Candidate, tactics_of, with_script
from outrider_falsify.limits import SearchLimits
from outrider_falsify.search import SearchSpace, Tally
from outrider_falsify.team.attack import AttackedPilots, Repetition, TeamAdversary, TeamUgv
from outrider_falsify.team.events import Events
from outrider_falsify.team.genome import (
    PAIR,
    TEAM_SIZES,
    decode_team,
    team_cases,
    team_tactics,
)
from outrider_falsify.team.judge import TeamJudge
from sim.engine.briefing import ugv_briefing
from sim.scenario.types import Scenario
from sim.server.flight import Flight

_VIOLATION = 10.0
"""Added to the score of a violation, so that the search keeps it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamCounts:
    """Counts of a flight, or sums over flights."""

    ticks: int = 0
    certified: int = 0
    """Ticks with a certified guard."""
    team_certified_while_lost: int = 0
    team_certificate_broken: int = 0
    unguarded: int = 0
    """Ticks without a certified guard that contradict the theorem."""
    leash_missed: int = 0
    """Scouts that turned back and did not see the UGV within the time of the leash."""
    excused: int = 0
    """Ticks without a certified guard after g losses."""
    returned: int = 0
    """Scouts that turned back."""
    handovers: int = 0
    deaths: int = 0
    blackouts: int = 0
    requests: int = 0
    left_without_relief: int = 0

    def plus(self, other: "TeamCounts") -> "TeamCounts":
        """Return the sums."""
        names = self.__dataclass_fields__
        return TeamCounts(**{name: getattr(self, name) + getattr(other, name) for name in names})

    @property
    def violations(self) -> int:
        """Return the sum of all that must not happen."""
        return (
            self.team_certified_while_lost
            + self.team_certificate_broken
            + self.unguarded
            + self.leash_missed
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamResult(CandidateResult):
    """Result of a flight.

    Its score is the larger share: of r_v by a certified guard, or of the time of the leash by a scout.
    """

    counts: TeamCounts
    farthest: float
    """Largest distance of a certified guard [m]."""
    slowest: float
    """Largest share of the time of the leash after which a scout that turned back saw the UGV."""


@dataclass(slots=True)
class TeamTally(Tally):
    """Running counters of a search; scores are shares, see `TeamResult`."""

    counts: TeamCounts = field(default_factory=TeamCounts)
    farthest: float = 0.0
    slowest: float = 0.0

    def take(self, candidate: Candidate, result: CandidateResult) -> None:
        """Add the result of a flight."""
        Tally.take(self, candidate, result)
        if isinstance(result, TeamResult):
            self.counts = self.counts.plus(result.counts)
            self.farthest = max(self.farthest, result.farthest)
            self.slowest = max(self.slowest, result.slowest)


def _finish(flight: Flight, pilots: AttackedPilots, number: int) -> TeamResult:
    """Fly and return the result."""
    judge = TeamJudge(flight, pilots.away)
    flight.fly(pilots, on_tick=judge.see)
    status, assurance = flight.answers.teams.status(), flight.answers.assurance
    kinds = [event.kind.value for event in pilots.events]
    counts = TeamCounts(
        ticks=judge.ticks,
        certified=judge.certified,
        team_certified_while_lost=status.team_certified_while_lost if status else 0,
        team_certificate_broken=status.team_certificate_broken if status else 0,
        unguarded=judge.unguarded,
        leash_missed=judge.leash_missed,
        excused=judge.excused,
        returned=judge.returned,
        handovers=status.handovers if status else 0,
        deaths=pilots.deaths,
        blackouts=kinds.count("BLACKOUT"),
        requests=kinds.count("REQUEST"),
        left_without_relief=status.left_without_relief if status else 0,
    )
    broken, lies = assurance.certificate_broken, assurance.certified_while_lost
    violated = counts.violations + broken + lies > 0
    share = max(judge.farthest / flight.scenario.visibility.radius, judge.slowest)
    return TeamResult(
        number=number,
        score=share + (_VIOLATION if violated else 0.0),
        violated=violated,
        lost=status is not None and status.team_out_of_sight > 0,
        uncertified=judge.certified < judge.ticks,
        certified_while_lost=lies,
        certificate_broken=broken,
        counts=counts,
        farthest=judge.farthest,
        slowest=judge.slowest,
    )


def attacked(
    candidate: Candidate, base: Scenario, limits: SearchLimits
) -> tuple[Scenario, Events, Flight, TeamResult]:
    """Fly an attack.

    Args:
        candidate: Candidate to fly.
        base: Scenario shared by all candidates.
        limits: Limits of the search.

    Returns:
        The scenario and the events that repeat the flight, the flight, and its result.
    """
    scenario = decode_team(candidate, base, limits)
    flight = Flight(scenario, scenario.seed)
    tactics = team_tactics(candidate.vector, scenario)
    pilots = AttackedPilots(flight, TeamAdversary(tactics, flight, scenario.seed))
    briefing = ugv_briefing(scenario, scenario.ugv[0].name, scenario.seed)
    moves = tactics_of(candidate.vector[:PAIR], scenario)
    ugv = TeamUgv(moves, flight, briefing, flees=tactics.flees > 0.5)
    pilots.pilots[briefing.vehicle] = UgvPilot(briefing, driver=ugv)
    result = _finish(flight, pilots, candidate.number)
    return with_script(scenario, ugv.script), tuple(pilots.events), flight, result


def repeated(scenario: Scenario, events: Events) -> tuple[Flight, TeamResult]:
    """Fly a recorded attack again."""
    flight = Flight(scenario, scenario.seed)
    return flight, _finish(flight, AttackedPilots(flight, Repetition(events)), 0)


def attack_team(candidate: Candidate, base: Scenario, limits: SearchLimits) -> TeamResult:
    """Fly an attack in a worker."""
    return attacked(candidate, base, limits)[3]


TEAMS = SearchSpace(TEAM_SIZES, team_cases(), attack_team)
"""Attacks on teams."""
