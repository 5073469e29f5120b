"""The adversary of commands that carry motions: it knows the protocol, and loses what hurts for as long as A5' allows.

It decides for each motion, and not for each command: that commands repeat motions only makes more of them arrive. What
it lets through may come early, twice, and overtake; that is the link's.
"""

from typing import NamedTuple

from outrider_falsify.draws import Words, next_share
from sim.compiling.compile import compiled


class Losses(NamedTuple):
    """The times at which the first motion of a chain is lost, and those after it that would begin the next chain."""

    none: int = 0
    random: int = 1
    when_far: int = 2
    at_a_plans_end: int = 3
    whenever_it_may: int = 4
    every_other: int = 5


LOSSES = Losses()

ALIVE = -1.0
"""The adversary's memory while the vehicle flies what is sent; else the tick of the first motion that was lost."""


class Pending(NamedTuple):
    """The adversary's view of the motion that sets out."""

    tick: int
    """Now."""
    delay_ticks: int
    """tau_c."""
    outage_ticks: int
    """B."""
    share: float
    """The distance as a share of r_v."""
    left: int
    """The time for which the plan that it carries still moves the UAV [ticks]."""


@compiled
def _wants(kind: int, random: Words, pending: Pending) -> bool:
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
def loses(kind: int, random: Words, since: float, pending: Pending) -> tuple[bool, float]:
    """Decide whether the motion of this tick is lost, so that the next one begins within B all the same.

    After a motion is lost, a new chain begins every tau_c + 1 ticks, until the first motion of one arrives: c chains
    later a motion begins c (tau_c + 1) + 1 ticks after the last. What is sent in between is void.

    Args:
        kind: A code of `LOSSES`.
        random: State of the adversary's draws. (1,)
        since: ALIVE, or the tick of the first motion that was lost.
        pending: What it sees.

    Returns:
        The decision, and `since` for the next tick.
    """
    c, cycle = pending, pending.delay_ticks + 1
    if since < 0.0:
        if cycle + 1 > c.outage_ticks or not _wants(kind, random, c):
            return False, ALIVE
        return True, float(c.tick)
    passed = c.tick - int(since)
    if passed % cycle != 0:
        return next_share(random) < 0.5, since
    lasts = (passed // cycle + 1) * cycle + 1
    if lasts > c.outage_ticks or (kind == LOSSES.random and next_share(random) < 0.2):
        return False, ALIVE
    return True, since
