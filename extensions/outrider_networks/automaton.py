r"""Exceedance probabilities of one link over a run: an automaton over the Markov chain of its losses.

A *base* is a message that arrives. After each base, the messages in a window are useful; the first of them to arrive in
time is the next base. If none does, the bound is exceeded for the rest of the run. `pushed` propagates the joint
distribution of chain and base through the run, tick by tick. With a fixed delay the result is exact.

**Variable delays.** The last base alone does not determine the outcome. Let E_k be the event that message k arrives and
no message of its window is in time, each with its own share of short enough delays. Every exceedance implies some E_k.
The sum of their probabilities, the expected number of exceedances, is therefore an upper bound: `summed`.

**Random blackouts.** Exponential times between blackouts and fixed blackout lengths do not form a chain over ticks. The
sum over E_k needs them within one window only, see `sim.channel.gaps.none_in_time`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sim.channel.gaps import LossChain, Mask, none_in_time, useful_shares
from sim.compiling.compile import FloatArray, IntArray, compiled

_GROUP = 4096
"""Number of bases evaluated at a time."""


class Window(NamedTuple):
    """Useful messages after a base, and the tick of the exceedance if none of them arrives in time."""

    useful: FloatArray
    """Share of received messages that arrive in time, by ticks since the base at 0."""
    fails: int
    """Ticks from the base to the exceedance."""

    @property
    def last(self) -> int:
        """Return the ticks from the base to the last useful message; 0 without any."""
        return len(self.useful) - 1


class Plan(NamedTuple):
    """Transmission schedule, with the windows after its messages."""

    window: Callable[[int], Window]
    """Window after each base, as a function of the bound [ticks]."""
    first: Callable[[int], Window]
    """Window at the start, with the tick before the first as a base."""
    schedules: tuple[tuple[float, Mask], ...]
    """Ticks at which a message leaves outside planned blackouts, with the probability of each schedule."""
    regular: Mask
    """Ticks after a message at which another leaves, without planned blackouts."""
    extra: float = 0.0
    """Probability that the run follows none of the schedules."""


def window_of(limits: IntArray, by_delay: FloatArray, fails: int) -> Window:
    """Return the window with these limits, see `sim.channel.gaps`."""
    return Window(useful_shares(limits, by_delay), fails)


def endless_window(ticks: int) -> Window:
    """Return the window of the first arrival, which exceeds nothing within the run."""
    return Window(np.ones(ticks + 1), ticks + 1)


def _most_within(leaves: Mask, ticks: int) -> int:
    """Return the largest number of messages that leave within this time."""
    before = np.concatenate(([0], np.cumsum(leaves)))
    ends = np.minimum(np.arange(len(leaves)) + ticks, len(leaves))
    return int((before[ends] - before[:-1]).max(initial=0))


def pushed(
    chain: LossChain, leaves: Mask, window: Window, first: Window, enough: float = math.inf
) -> float:
    """Propagate chain and base through a run without random blackouts; return the probability of exceedance.

    Args:
        chain: Losses of the link.
        leaves: Ticks at which a message leaves outside planned blackouts. Shape (ticks,).
        window: Window after each base.
        first: Window at the start, counted from the tick before the first.
        enough: Stop once the probability is larger; the result is then a lower bound above this number.
    """
    if first.fails <= len(leaves) and first.last == 0:
        return 1.0
    rows = _most_within(leaves, window.last + 1) + 1
    return float(
        _push(
            chain.turn,
            chain.through,
            leaves,
            (window.useful, window.fails),
            (first.useful, first.fails),
            np.zeros((rows, len(chain.through))),
            chain.share.copy(),
            enough,
        )
    )


@compiled
def _push(
    turn: FloatArray,
    through: FloatArray,
    leaves: Mask,
    window: tuple[FloatArray, int],
    first: tuple[FloatArray, int],
    mass: FloatArray,
    early: FloatArray,
    enough: float,
) -> float:
    """Return the probability of `pushed`.

    Args:
        turn, through: See `sim.channel.gaps.LossChain`.
        leaves: See `pushed`.
        window, first: Fields of the two windows.
        mass: Probability of each base, a ring of rows, and state; changed.
        early: Probability of each state without a base; changed.
        enough: See `pushed`.
    """
    (useful, fails), (first_useful, first_fails) = window, first
    ticks, last, first_last = len(leaves), len(useful) - 1, len(first_useful) - 1
    states, rows = len(through), len(mass)
    bases, fresh, before = np.zeros(rows, dtype=np.int64), np.zeros(states), np.zeros(states)
    oldest, newest, value = 0, 0, 0.0
    for tick in range(ticks):
        # the chain's step
        for k in range(oldest, newest + 1):
            row = early if k == newest else mass[k % rows]
            before[:] = row
            for state in range(states):
                row[state] = 0.0
                for origin in range(states):
                    row[state] += turn[origin, state] * before[origin]
        # a message leaves
        fresh[:] = 0.0
        if leaves[tick]:
            for k in range(oldest, newest):
                row, share = mass[k % rows], useful[min(tick - bases[k % rows], last)]
                for state in range(states):
                    got = through[state] * share
                    fresh[state] += got * row[state]
                    row[state] *= 1.0 - got
            share = first_useful[tick + 1] if tick < first_last else 0.0
            for state in range(states):
                got = through[state] * share
                fresh[state] += got * early[state]
                early[state] *= 1.0 - got
        # windows end, and one begins
        if first_fails <= ticks and tick + 1 == first_last:
            value += early.sum()
        while oldest < newest and bases[oldest % rows] + last <= tick:
            value += mass[oldest % rows].sum()
            oldest += 1
        if value > enough:
            break
        if leaves[tick] and tick + fails < ticks:
            if last == 0:
                value += fresh.sum()
            else:
                bases[newest % rows] = tick
                mass[newest % rows] = fresh
                newest += 1
    return value


def summed(
    chain: LossChain, leaves: Mask, window: Window, first: Window, regular: Mask | None
) -> float:
    """Return the expected number of bases after which no useful message arrives in time.

    Args:
        chain, leaves, window, first: See `pushed`.
        regular: Ticks after a message at which another leaves; None if the pattern varies.
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
