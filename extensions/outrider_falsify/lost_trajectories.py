"""Adversary of commands with trajectories: it knows the protocol and exploits every loss that A5' allows.

It decides once per trajectory, not per command; repeated transmission would only make more trajectories arrive. Early,
duplicated and reordered arrivals are left to the link.
"""

from typing import NamedTuple

from outrider_falsify.rng import RngState, next_share
from sim.compiling.compile import compiled


class Losses(NamedTuple):
    """Strategies for losing the first trajectory of a chain, and the later ones that would start the next chain."""

    none: int = 0
    random: int = 1
    when_far: int = 2
    at_a_plans_end: int = 3
    whenever_it_may: int = 4
    every_other: int = 5


LOSSES = Losses()

ALIVE = -1.0
"""Value of `since` while the vehicle executes the trajectories sent; else the tick of the first lost one."""


class Pending(NamedTuple):
    """Adversary's view of the trajectory being sent."""

    tick: int
    """Current tick."""
    delay_ticks: int
    """Command delay tau_c."""
    interval_ticks: int
    """Largest command interval B."""
    share: float
    """Distance as a share of r_v."""
    left: int
    """Remaining ticks for which the trajectory sent still moves the UAV."""


@compiled
def _wants(kind: int, random: RngState, pending: Pending) -> bool:
    if kind == LOSSES.random:
        return next_share(random) < 0.05
    if kind == LOSSES.when_far:
        return pending.share > 0.6 and next_share(random) < 0.3
    if kind == LOSSES.at_a_plans_end:
        return pending.left <= 1
    if kind == LOSSES.every_other:
        return next_share(random) < 0.5
    return kind == LOSSES.whenever_it_may


@compiled
def loses(kind: int, random: RngState, since: float, pending: Pending) -> tuple[bool, float]:
    """Decide on the loss of this tick's trajectory, such that the next one still starts within B.

    After a loss, a new chain starts every tau_c + 1 ticks until the first trajectory of one arrives. If c chains fail,
    a trajectory starts c (tau_c + 1) + 1 ticks after the last. Trajectories sent in between have no effect.

    Args:
        kind: Code of `LOSSES`.
        random: State of the random number generator. Shape (1,).
        since: ALIVE, or the tick of the first lost trajectory.
        pending: View of the trajectory.

    Returns:
        True if the trajectory is lost, and `since` for the next tick.
    """
    c, cycle = pending, pending.delay_ticks + 1
    if since < 0.0:
        if cycle + 1 > c.interval_ticks or not _wants(kind, random, c):
            return False, ALIVE
        return True, float(c.tick)
    passed = c.tick - int(since)
    if passed % cycle != 0:
        return next_share(random) < 0.5, since
    lasts = (passed // cycle + 1) * cycle + 1
    if lasts > c.interval_ticks or (kind == LOSSES.random and next_share(random) < 0.2):
        return False, ALIVE
    return True, since
