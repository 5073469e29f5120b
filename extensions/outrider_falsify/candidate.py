"""One candidate flown, and whether it broke the promise."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bus.registry import LAWS
from outrider.running.flying import fly
from outrider_falsify.adversary import fly_adversary
from outrider_falsify.genome import Candidate, decode, tactics_of, with_script
from outrider_falsify.limits import SearchLimits
from sim.scenario.types import Scenario
from sim.server.flight import Flight


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateResult:
    """The outcome of a run."""

    number: int
    score: float
    """Largest distance while the promise stood [m]."""
    violated: bool
    """True if the UGV was lost while the promise stood."""
    lost: bool
    """True if it was lost at all."""
    uncertified: bool
    """True if the law certifies, and did not certify every tick from the first certified one on."""
    certified_while_lost: int = 0
    """Ticks that were certified although the UGV was out of sight then; any is a violation."""
    certificate_broken: int = 0
    """Ticks that were not certified although the one before was and all assumptions held."""


_WHILE = 1.0
"""After an uncertified tick a promise counts again once it has stood for so long and for the commands' delay [s]."""


def promised(certified: npt.NDArray[np.bool_], patience: int) -> npt.NDArray[np.bool_]:
    """At which states the promise stands.

    Without a gap since the run's first certified tick, or for long enough since a gap.

    Args:
        certified: Of each tick whether sight was certified from there on.
        patience: How many ticks are long enough.

    Returns:
        Of each state, one more than ticks.
    """
    stands = np.zeros(len(certified) + 1, dtype=np.bool_)
    length, gaps = 0, 0
    for tick, holds in enumerate(certified.tolist()):
        gaps += length > 0 and not holds
        length = length + 1 if holds else 0
        stands[tick + 1] = length > (patience if gaps else 0)
    return stands


def flown(
    candidate: Candidate, base: Scenario, limits: SearchLimits
) -> tuple[Scenario, Flight, CandidateResult]:
    """Fly a candidate.

    Args:
        candidate: What is flown.
        base: What all candidates have in common.
        limits: Within what is searched.

    Returns:
        The scenario that flies the same by itself, the flight, and what came out.
    """
    scenario = decode(candidate, base, limits)
    certified = np.zeros(scenario.ticks, dtype=np.bool_)  # that sight is kept from there on

    def see(flight: Flight) -> None:
        report = flight.answers.reports[0]
        decision = None if report is None else report.decision
        certified[flight.world.tick - 1] = decision is not None and decision.certified

    if candidate.kind == "adversary":
        flight, script = fly_adversary(scenario, tactics_of(candidate.vector, scenario), see)
        scenario = with_script(scenario, script)
    else:
        flight, _ = fly(scenario, scenario.seed, on_tick=see)
    distance = flight.recorder.escorts[:, 0, 0]
    certifies = LAWS[scenario.law.name].watched
    patience = math.ceil((_WHILE + scenario.links.commands.delay) / scenario.dt)
    stands = promised(certified, patience) if certifies else np.ones(len(distance), dtype=np.bool_)
    stands[:-1] |= certified  # whatever has been before: such a tick says that the UGV is in sight
    lost = distance >= scenario.visibility.radius
    result = CandidateResult(
        number=candidate.number,
        score=float(distance[stands].max(initial=0.0)),
        violated=bool(np.any(lost & stands)),
        lost=bool(np.any(lost)),
        uncertified=certifies and not bool(np.all(certified[int(certified.argmax()) :])),
        certified_while_lost=flight.answers.assurance.certified_while_lost,
        certificate_broken=flight.answers.assurance.certificate_broken,
    )
    return scenario, flight, result


def fly_candidate(candidate: Candidate, base: Scenario, limits: SearchLimits) -> CandidateResult:
    """Fly a candidate; for a worker."""
    return flown(candidate, base, limits)[2]
