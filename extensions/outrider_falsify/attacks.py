"""The compiled attack on the certificate, over its whole grid and on all cores; and laws that it must catch."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from outrider_falsify.attack import attack
from outrider_falsify.attack_grid import grid
from outrider_falsify.conditions import (
    AREAS,
    DISTURBANCES,
    GUARDS,
    PAPER_BOUNDS,
    Conditions,
    declared,
    spec_radius,
)
from outrider_falsify.pool import Workers
from outrider_falsify.search import Budget
from sim.models.safety import SafetyBounds
from sim.models.vehicles import raw_switching_radius

CONTROLS = {
    "tracking": GUARDS.switch_tracking,
    "argmin": GUARDS.switch_best,
    "paper-radius": GUARDS.switch_servo,
    "switching": GUARDS.paper,
}
"""Guards that are known to be wrong.

Beyond the specification's radius of d_cert tracking (15), or full speed to the detection with the least bound; full
speed to the newest one beyond a radius that does not know the delay; the paper's law (18)."""

_CHUNK = 8
"""Runs of a task, after the first round with one for each combination."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attacked:
    """The outcome of a few runs of one combination."""

    eps: float
    """Largest error of a detection [m]."""
    bounds: dict[str, float]
    """Of the vehicles and the tick, where they are not the paper's."""
    conditions: Conditions
    duration: float
    """Of each run [s]."""
    runs: int
    violations: int
    """Runs with a certified tick in which the distance reaches r_v, or, where nothing certifies, with any such tick."""
    broken: int
    """Runs in which the certificate was lost although its assumptions held."""
    lost: int
    """Runs with a distance of r_v or more."""
    uncertified: int
    """Runs with a tick that was not certified."""
    uncertified_share: float
    """Sum of the runs' shares of such ticks."""
    worst_run: int
    worst_distance: float
    """[m]"""
    excess: float
    """Largest distance less the certified one [m]; above 0 the bound is none."""

    @property
    def worst_share(self) -> float:
        """The largest distance as a share of r_v."""
        return self.worst_distance / self.conditions.r_v


def kind(conditions: Conditions) -> str:
    """Names the place, and what is special about the run or breaks A5'."""
    c, words = conditions, [AREAS._fields[conditions.area]]
    if c.wind or c.position_error or c.jumps:
        words.append("wind and own position")
    for given, word in (
        (c.bare, "bare accelerations"),
        (c.start_speed, "starts moving"),
        (c.outage, "motions lost"),
        (c.jitter, "jitter"),
        (c.duplicates, "duplicates"),
        (c.disturbance, DISTURBANCES._fields[c.disturbance].replace("_", " ")),
    ):
        if given:
            words.append(word)
    return ", ".join(words)


@dataclass(slots=True)
class KindTally:
    """Counts of one place with one disturbance."""

    runs: int = 0
    violations: int = 0
    broken: int = 0
    lost: int = 0
    uncertified: float = 0.0
    """Sum of the runs' shares of ticks that were not certified."""


@dataclass(slots=True)
class AttackTally:
    """Counts of a search so far."""

    runs: int = 0
    combinations: int = 0
    """Of network and error; each is flown with other adversaries in every run."""
    violations: int = 0
    broken: int = 0
    lost: int = 0
    uncertified: int = 0
    worst: Attacked | None = None
    excess: float = -math.inf
    kinds: dict[str, KindTally] = field(default_factory=dict)
    """By `kind`."""

    def take(self, found: Attacked, *, new: bool) -> None:
        """Count a task."""
        one = self.kinds.setdefault(kind(found.conditions), KindTally())
        one.uncertified += found.uncertified_share
        for tally in (self, one):
            tally.runs += found.runs
            tally.violations += found.violations
            tally.broken += found.broken
            tally.lost += found.lost
        self.combinations += new
        self.uncertified += found.uncertified
        self.excess = max(self.excess, found.excess)
        if self.worst is None or found.worst_share > self.worst.worst_share:
            self.worst = found


def warm() -> None:
    """Compile an attack, or load it from the cache."""
    conditions = Conditions()
    attack(declared(conditions, 0.0), conditions, 0, 0, 1, 1.0)


def _guarded(control: str | None, promise: SafetyBounds, conditions: Conditions) -> Conditions:
    """The same conditions with the guard that is to be caught."""
    if control is None:
        return conditions
    bounds = PAPER_BOUNDS
    radius = spec_radius(promise, with_latency=control != "paper-radius")
    if control == "switching":
        radius = float(
            raw_switching_radius(bounds["r_v"], bounds["v_a"], bounds["v_g"], bounds["u_a"])
        )
    return conditions._replace(law=CONTROLS[control], radius=radius)


def fly_attack(
    promise: SafetyBounds, conditions: Conditions, seed: int, first: int, runs: int, duration: float
) -> Attacked:
    """A few runs of one combination; for a worker. Arguments as in `outrider_falsify.attack.attack`."""
    found = attack(promise, conditions, seed, first, runs, duration)
    lost, uncertified = found["max_distance"] >= conditions.r_v, found["uncertified"] > 0.0
    certifies = conditions.law == GUARDS.filter
    distance = found["max_certified" if certifies else "max_distance"]
    violated = found["certified_lost"] > 0.0 if certifies else lost
    worst = int(np.argmax(distance / conditions.r_v))
    return Attacked(
        eps=promise.max_measurement_error,
        bounds={
            name: getattr(promise, name)
            for name in ("v_a", "u_a", "v_g", "dt")
            if getattr(promise, name) != PAPER_BOUNDS[name]
        },
        conditions=conditions,
        duration=duration,
        runs=runs,
        violations=int(np.sum(violated)),
        broken=int(np.sum(found["broken"] > 0.0)),
        lost=int(np.sum(lost)),
        uncertified=int(np.sum(uncertified)),
        uncertified_share=float(np.sum(found["uncertified"])),
        worst_run=first + worst,
        worst_distance=float(distance[worst]),
        excess=float(found["max_excess"].max()),
    )


def _calls(
    control: str | None, eps: float | None, seed: int, runs: int | None, duration: float
) -> Iterator[tuple[SafetyBounds, Conditions, int, int, int, float]]:
    """Every combination once, then again and again with more runs, as many as are asked for."""
    left = math.inf if runs is None else runs
    flown: list[tuple[SafetyBounds, Conditions]] = []

    def length(promise: SafetyBounds) -> float:
        return duration * max(1.0, promise.dt / PAPER_BOUNDS["dt"])

    for promise, conditions in grid():
        if left <= 0:
            return
        if eps is None or promise.max_measurement_error == eps:
            flown.append((promise, _guarded(control, promise, conditions)))
            left -= 1
            yield *flown[-1], seed, 0, 1, length(promise)
    first = 1
    while flown:
        for promise, conditions in flown:
            if left <= 0:
                return
            count = int(min(_CHUNK, left))
            left -= count
            yield promise, conditions, seed, first, count, length(promise)
        first += _CHUNK


def run_attack(
    workers: Workers,
    budget: Budget,
    tally: AttackTally,
    *,
    control: str | None = None,
    eps: float | None = None,
    seed: int = 1,
    duration: float = 200.0,
    on_task: Callable[[], None] = lambda: None,
) -> None:
    """Attack until the budget is used up.

    Args:
        workers: Who fly.
        budget: How much.
        tally: What is found, counted as it comes.
        control: Instead of the filter a guard that is known to be wrong, a row of `CONTROLS`.
        eps: Only this error [m].
        seed: Of all draws.
        duration: Of each run [s]; longer where a tick is longer than the paper's, so that no run has fewer ticks.
        on_task: Is told after every few runs.
    """
    calls = _calls(control, eps, seed, budget.runs, duration)
    for found in workers.stream(fly_attack, calls, budget.ends):
        tally.take(found, new=found.runs == 1 and tally.runs == tally.combinations)
        on_task()


_NAMES = (
    "import math; from outrider_falsify.attack import attack; "
    "from outrider_falsify.conditions import Conditions, declared"
)


def again(found: Attacked, seed: int) -> str:
    """The worst run as a line of Python that flies it again."""
    told = ", ".join(
        f"{name}=math.inf" if value == math.inf else f"{name}={value!r}"
        for name, value in found.conditions._asdict().items()
        if value != Conditions._field_defaults[name]
        and (name not in ("law", "radius") or found.conditions.law)
    )
    conditions = f"c = Conditions({told})"
    bounds = "".join(f", {name}={value!r}" for name, value in found.bounds.items())
    return (
        f"{_NAMES}; {conditions}; attack(declared(c, {found.eps!r}{bounds}), c, {seed}, {found.worst_run}, 1, "
        f"{found.duration!r})[0]"
    )
