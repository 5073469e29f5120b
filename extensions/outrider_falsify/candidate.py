"""Simulation of one candidate and its verdict."""

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
    """Result of one run."""

    number: int
    score: float
    """Largest distance at states with guaranteed visibility [m], plus what the radius of sight there lacks of r_v."""
    violated: bool
    """True if the UGV was lost at a state with guaranteed visibility."""
    lost: bool
    """True if the UGV was lost at any state."""
    uncertified: bool
    """True if the law certifies, but missed a tick after its first certified one."""
    certified_while_lost: int = 0
    """Ticks certified while the UGV was out of sight; each is a violation."""
    certificate_broken: int = 0
    """Ticks that lost the certificate although all assumptions held."""


_WHILE = 1.0
"""Certified time, besides the command delay, after which visibility is guaranteed again [s]."""


def guaranteed(certified: npt.NDArray[np.bool_], patience: int) -> npt.NDArray[np.bool_]:
    """Return the states at which visibility is guaranteed.

    A state counts if every tick since the first certified one is certified, or if enough ticks after a gap are.

    Args:
        certified: Certified ticks. Shape (ticks,).
        patience: Certified ticks required after a gap.

    Returns:
        Mask of the states. Shape (ticks + 1,).
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
    """Simulate a candidate.

    Args:
        candidate: Candidate to simulate.
        base: Scenario shared by all candidates.
        limits: Limits of the search.

    Returns:
        The scenario that reproduces the run, the run, and its result.
    """
    scenario = decode(candidate, base, limits)
    certified = np.zeros(scenario.ticks, dtype=np.bool_)

    def see(flight: Flight) -> None:
        reasons = flight.answers.reasons()  # of UAVs with a safety filter
        uav = flight.world.uavs[0].name
        certified[flight.world.tick - 1] = uav in reasons and reasons[uav] is None

    if candidate.kind == "adversary":
        flight, script = fly_adversary(scenario, tactics_of(candidate.vector, scenario), see)
        scenario = with_script(scenario, script)
    else:
        flight, _ = fly(scenario, scenario.seed, on_tick=see)
    distance = flight.recorder.escorts[:, 0, 0]
    certifies = LAWS[scenario.law.name].watched
    patience = math.ceil((_WHILE + scenario.links.commands.delay) / scenario.dt)
    stands = (
        guaranteed(certified, patience) if certifies else np.ones(len(distance), dtype=np.bool_)
    )
    stands[:-1] |= certified  # a certified tick asserts visibility whatever came before
    lost = flight.recorder.lost[:, 0]
    reached = distance + (scenario.visibility.radius - flight.recorder.radii[:, 0])
    result = CandidateResult(
        number=candidate.number,
        score=float(reached[stands].max(initial=0.0)),
        violated=bool(np.any(lost & stands)),
        lost=bool(np.any(lost)),
        uncertified=certifies and not bool(np.all(certified[int(certified.argmax()) :])),
        certified_while_lost=flight.answers.assurance.certified_while_lost,
        certificate_broken=flight.answers.assurance.certificate_broken,
    )
    return scenario, flight, result


def fly_candidate(candidate: Candidate, base: Scenario, limits: SearchLimits) -> CandidateResult:
    """Simulate a candidate in a worker."""
    return flown(candidate, base, limits)[2]
