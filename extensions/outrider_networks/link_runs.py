"""One link over one run: the probability that a bound is exceeded, and the smallest bound for a risk.

`DrawnRun` evaluates a link whose losses are drawn, `RecordedRun` one that plays a table, from each place at which a run
may begin in it (`outrider_networks.places`).
"""

from collections.abc import Callable
from typing import NamedTuple

from outrider_networks.automaton import Plan, pushed, summed
from sim.channel.gaps import LossChain
from sim.compiling.compile import FloatArray

MOST_CELLS = 1e8
"""Largest effort for a run: its ticks times those of a window."""
_MOST_TICKS = 100_000
SUMMED = "the expected number of exceedances bounds the probability"


class Probability(NamedTuple):
    """A probability within a run."""

    value: float | None
    """None: it is not known."""
    why: str
    """Limits of the statement; empty where it is exact."""

    @property
    def exact(self) -> bool:
        """False: a bound, or not known."""
        return not self.why


class DrawnRun(NamedTuple):
    """A link whose losses are drawn, over one run."""

    chain: LossChain
    plans: tuple[Plan, ...]
    """Each of them gives a bound."""
    ticks: int
    regular: bool
    """True if messages leave at equal intervals all the time: no planned blackouts, no queue."""
    why: str
    """Why it is a bound; empty: it is exact."""
    longest: int
    """Largest number that can be exceeded before the run ends [ticks]."""

    def summed(self, plan: Plan, number: int, *, regular: bool) -> float:
        """Return the expected number of exceedances; `regular`: without planned blackouts and queue."""
        window, first = plan.window(number), plan.first(number)
        pattern = plan.regular if regular else None
        return plan.extra + sum(
            weight * summed(self.chain, leaves, window, first, pattern)
            for weight, leaves in plan.schedules
        )

    def probability(self, number: int) -> Probability:
        """Return the probability that this number of ticks is exceeded."""
        window = self.plans[0].window(number)
        long = self.ticks > _MOST_TICKS or self.ticks * window.last > MOST_CELLS
        if not self.why and not long:
            (plan,) = self.plans
            ((_, leaves),) = plan.schedules
            value = pushed(self.chain, leaves, window, plan.first(number))
            return Probability(min(1.0, value), "")
        if long and not self.regular:
            return Probability(None, "the run is too long to be evaluated tick by tick")
        value = min(self.summed(plan, number, regular=self.regular) for plan in self.plans)
        return Probability(min(1.0, value), self.why or SUMMED)

    def smallest(self, risk: float) -> int | None:
        """Return the smallest number of ticks exceeded with at most this probability; None: none within the run."""

        def kept(number: int) -> bool:
            value = self.probability(number).value
            return value is not None and value <= risk

        def seems_kept(number: int) -> bool:
            return min(self.summed(plan, number, regular=True) for plan in self.plans) <= risk

        most = min(self.longest, _MOST_TICKS)
        guess = _first(seems_kept, 0, most)
        if guess is not None and kept(guess):
            while guess > 0 and kept(guess - 1):
                guess -= 1
            return guess
        return None if self.regular and self.why else _first(kept, guess or 0, most)


class RecordedRun(NamedTuple):
    """A link that plays a recorded table, over one run."""

    exceeded: Callable[[int], FloatArray]
    """By the place at which it begins, the probability that a number of ticks is exceeded, or a bound."""
    ticks: int
    why: str
    longest: int

    def probability(self, number: int) -> Probability:
        """Return the mean of the probability over all places, which are equally likely."""
        return Probability(float(self.exceeded(number).mean()), self.why)

    def smallest(self, risk: float) -> int | None:
        """Return the smallest number of ticks exceeded with at most this probability; None: none within the run."""
        return _first(lambda number: self.exceeded(number).mean() <= risk, 0, self.longest)


LinkRun = DrawnRun | RecordedRun | str
"""A string: why nothing is known."""


def _first(holds: Callable[[int], bool], least: int, most: int) -> int | None:
    """Return the smallest number from `least` to `most` for which it holds, if it does for all larger ones."""
    step, below = 1, least - 1
    while not holds(min(below + step, most)):
        if below + step >= most:
            return None
        below, step = below + step, 2 * step
    above = min(below + step, most)
    while above - below > 1:
        middle = (above + below) // 2
        if holds(middle):
            above = middle
        else:
            below = middle
    return above
