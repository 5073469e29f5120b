r"""Exceedance probabilities of one link over a run: an automaton over the Markov chain of its losses.

A *base* is a message that gets through. After each base a window of later messages is useful; the first of them that
arrives in time is the next base. If none does, the bound is exceeded, for good. `pushed` pushes the distribution of
chain and base through the run, tick by tick. With a fixed delay this is exact.

**Where delays vary** the last base alone does not decide. Let E_k be that message k gets through and that none of its
window is in time, each with its own share of delays that are short enough. Wherever the bound is exceeded some E_k
holds, so the sum of their probabilities, the expected number of exceedances, is a bound: `summed`.

**Random blackouts** are exponential times without and fixed times with a blackout, which no chain over ticks has. The
sum of the probabilities of E_k needs them within one window only, see `sim.channel.gaps.none_in_time`.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sim.channel.gaps import LossChain, Mask, none_in_time, useful_shares
from sim.compiling.compile import FloatArray, IntArray

_GROUP = 4096
"""Bases that are evaluated at a time."""


class Window(NamedTuple):
    """Messages that are useful after a base, and when the bound is exceeded if none of them arrives in time."""

    useful: FloatArray
    """By ticks since the base, which is 0: the share of those that are not lost which arrive in time."""
    fails: int
    """Ticks from the base to the first at which the bound is exceeded."""

    @property
    def last(self) -> int:
        """Ticks from the base to the last useful message; 0: there is none."""
        return len(self.useful) - 1


class Plan(NamedTuple):
    """A schedule by which messages leave, with the windows after them."""

    window: Callable[[int], Window]
    """After each base, by the bound [ticks] that must not be exceeded."""
    first: Callable[[int], Window]
    """The same at the start, as if the tick before the first were a base of which nothing is known."""
    schedules: tuple[tuple[float, Mask], ...]
    """By tick, whether a message leaves that no planned blackout hides; each with the probability of this schedule."""
    regular: Mask
    """By ticks after a message, whether another leaves, were it not for planned blackouts."""
    extra: float = 0.0
    """Probability that the run follows none of the schedules."""


def window_of(limits: IntArray, by_delay: FloatArray, fails: int) -> Window:
    """Return the window with these limits: see `sim.channel.gaps`."""
    return Window(useful_shares(limits, by_delay), fails)


def endless_window(ticks: int) -> Window:
    """Return the wait for the first message that gets through, which exceeds nothing within the run."""
    return Window(np.ones(ticks + 1), ticks + 1)


def _most_within(leaves: Mask, ticks: int) -> int:
    """Return the largest number of messages that leave within this time."""
    before = np.concatenate(([0], np.cumsum(leaves)))
    ends = np.minimum(np.arange(len(leaves)) + ticks, len(leaves))
    return int((before[ends] - before[:-1]).max(initial=0))


def pushed(chain: LossChain, leaves: Mask, window: Window, first: Window) -> float:
    """Push the distribution of chain and base through a run without random blackouts; return the absorbed mass.

    Args:
        chain: Losses of the link.
        leaves: By tick, whether a message leaves that no planned blackout hides. Shape (ticks,).
        window: After each base.
        first: At the start, from the tick before the first on.
    """
    ticks, through = len(leaves), chain.through
    at_first = first.fails <= ticks
    if at_first and first.last == 0:
        return 1.0
    rows = _most_within(leaves, window.last + 1) + 1
    mass, begun = np.zeros((len(through), rows)), np.zeros(rows, dtype=int)
    early, oldest, newest, value = chain.share, 0, 0, 0.0
    for tick in range(ticks):
        mass, early = chain.push(mass), chain.push(early)
        fresh = np.zeros(len(through))
        if leaves[tick]:
            got = through[:, None] * window.useful[np.minimum(tick - begun, window.last)]
            sooner = through * (first.useful[tick + 1] if tick < first.last else 0.0)
            fresh = (got * mass).sum(axis=1) + sooner * early
            mass, early = (1.0 - got) * mass, (1.0 - sooner) * early
        if at_first and tick + 1 == first.last:
            value += float(early.sum())
        while oldest < newest and begun[oldest % rows] + window.last <= tick:
            value += float(mass[:, oldest % rows].sum())
            mass[:, oldest % rows] = 0.0
            oldest += 1
        if leaves[tick] and tick + window.fails < ticks:
            if window.last == 0:
                value += float(fresh.sum())
            else:
                begun[newest % rows] = tick
                mass[:, newest % rows] = fresh
                newest += 1
    return value


def summed(
    chain: LossChain, leaves: Mask, window: Window, first: Window, regular: Mask | None
) -> float:
    """Return the expected number of bases after which no useful message arrives in time.

    Args:
        chain, leaves, window, first: See `pushed`.
        regular: By ticks after a message, whether another leaves, where that is the same throughout.
    """
    ticks, value = len(leaves), 0.0
    through = chain.share * chain.through * chain.light
    bases = np.flatnonzero(leaves[: max(0, ticks - window.fails)])
    groups = [bases[k : k + _GROUP] for k in range(0, len(bases), _GROUP)]
    if regular is not None and len(bases):
        useful = window.useful * regular[: window.last + 1]
        value = len(bases) * float(through @ none_in_time(chain, useful[:, None])[0][:, 0])
        groups = []
    for group in groups:
        useful = window.useful[:, None] * leaves[group + np.arange(window.last + 1)[:, None]]
        value += float((through @ none_in_time(chain, useful)[0]).sum())
    if first.fails <= ticks:
        useful = first.useful * np.concatenate(([False], leaves))[: first.last + 1]
        value += float(none_in_time(chain, useful[:, None])[1][0])
    return value
