"""Probability that one link exceeds a bound within one run, and the smallest bound for a risk.

`DrawnRun` evaluates a link with random losses, `RecordedRun` a replayed trace from each start position
(`outrider_networks.recorded_positions`).
"""

from collections.abc import Callable
from typing import NamedTuple

from outrider_networks.automaton import Plan, pushed, summed
from sim.channel.gaps import LossChain
from sim.compiling.compile import FloatArray

MOST_CELLS = 1e8
"""Largest effort for a run: ticks of the run times ticks of a window."""
_MOST_TICKS = 100_000
SUMMED = "the expected number of exceedances bounds the probability"


class Probability(NamedTuple):
    """Probability of an event within a run."""

    value: float | None
    """Value; None if unknown."""
    why: str
    """Limits of the statement; empty if it is exact."""

    @property
    def exact(self) -> bool:
        """Return false for an upper bound or an unknown value."""
        return not self.why


class DrawnRun(NamedTuple):
    """Run of a link with random losses."""

    chain: LossChain
    plans: tuple[Plan, ...]
    """Plans, each of which gives a bound."""
    ticks: int
    regular: bool
    """True if messages leave at equal intervals throughout: no planned blackouts, no queue."""
    why: str
    """Reason why the result is a bound; empty if it is exact."""
    longest: int
    """Largest number that can be exceeded before the run ends [ticks]."""

    def summed(self, plan: Plan, number: int, *, regular: bool) -> float:
        """Return the expected number of exceedances; `regular` ignores planned blackouts and queue."""
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

    def keeps(self, number: int, risk: float) -> bool:
        """Return whether this number of ticks is exceeded with at most a probability; quicker than the probability.

        The expected number of exceedances bounds the probability, and takes one window instead of a run.
        """
        window, exact = self.plans[0].window(number), not self.why and len(self.plans) == 1
        long = self.ticks > _MOST_TICKS or self.ticks * window.last > MOST_CELLS
        if long or not exact:
            value = self.probability(number).value
            return value is not None and value <= risk
        (plan,) = self.plans
        if self.regular and self.summed(plan, number, regular=True) <= risk:
            return True
        ((_, leaves),) = plan.schedules
        return pushed(self.chain, leaves, window, plan.first(number), risk) <= risk

    def smallest(self, risk: float) -> int | None:
        """Return the smallest number of ticks exceeded with at most this probability; None if none is."""

        def kept(number: int) -> bool:
            return self.keeps(number, risk)

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
    """Run of a link that replays a recorded table."""

    exceeded: Callable[[int], FloatArray]
    """Function from a number of ticks to its exceedance probability or a bound, by start position."""
    ticks: int
    why: str
    longest: int

    def probability(self, number: int) -> Probability:
        """Return the mean probability over all start positions, which are equally likely."""
        return Probability(float(self.exceeded(number).mean()), self.why)

    def keeps(self, number: int, risk: float) -> bool:
        """Return whether this number of ticks is exceeded with at most a probability."""
        return float(self.exceeded(number).mean()) <= risk

    def smallest(self, risk: float) -> int | None:
        """Return the smallest number of ticks exceeded with at most this probability; None if none is."""
        return _first(lambda number: self.exceeded(number).mean() <= risk, 0, self.longest)


LinkRun = DrawnRun | RecordedRun | str
"""Link run; a string gives the reason why its result is unknown."""


def _first(holds: Callable[[int], bool], least: int, most: int) -> int | None:
    """Return the smallest number in [least, most] for which a monotonic condition holds; None if there is none."""
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
