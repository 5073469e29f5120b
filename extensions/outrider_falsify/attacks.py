"""Compiled attack over the whole grid on all cores, and faulty guards that it must expose."""

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
from outrider_falsify.heights import FLIGHTS, certifiable, over_town
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
"""Guards with known faults.

`tracking` and `argmin` switch at the specification's radius of d_cert: to tracking (15), or to full speed towards the
detection with the smallest bound. `paper-radius` flies at full speed towards the newest detection, beyond a radius that
ignores the delay. `switching` is the paper's law (18).
"""

_CHUNK = 8
"""Runs per task after the first round, which flies each combination once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attacked:
    """Result of some runs of one combination."""

    eps: float
    """Largest detection error [m]."""
    bounds: dict[str, float]
    """Limits of the vehicles and tick length that differ from the paper's."""
    conditions: Conditions
    flight: int | None
    """Row of `FLIGHTS`; None: in the plane."""
    duration: float
    """Duration of each run [s]."""
    runs: int
    violations: int
    """Runs with a certified tick at which the distance reaches r_v; any tick for guards that do not certify."""
    broken: int
    """Runs that lost the certificate although its assumptions held."""
    lost: int
    """Runs with a tick out of sight."""
    uncertified: int
    """Runs with an uncertified tick."""
    uncertified_share: float
    """Sum over the runs of their shares of uncertified ticks."""
    worst_run: int
    worst_distance: float
    """[m]"""
    excess: float
    """Largest distance minus the certified distance [m]; a positive value refutes the bound."""

    @property
    def worst_share(self) -> float:
        """Return the largest distance as a share of r_v."""
        return self.worst_distance / self.conditions.r_v


def kind(conditions: Conditions) -> str:
    """Describe the area, special features of the run, and disturbances that break A5'."""
    c, parts = conditions, [AREAS._fields[conditions.area]]
    if c.wind or c.position_error or c.jumps:
        parts.append("wind and position error")
    for given, text in (
        (c.bare, "bare accelerations"),
        (c.start_speed, "starts moving"),
        (c.max_command_interval, "trajectories lost"),
        (c.jitter, "jitter"),
        (c.duplicates, "duplicates"),
        (c.disturbance, DISTURBANCES._fields[c.disturbance].replace("_", " ")),
    ):
        if given:
            parts.append(text)
    return ", ".join(parts)


@dataclass(slots=True)
class KindTally:
    """Counters of one area with one disturbance."""

    runs: int = 0
    violations: int = 0
    broken: int = 0
    lost: int = 0
    uncertified: float = 0.0
    """Sum over the runs of their shares of uncertified ticks."""


@dataclass(slots=True)
class AttackTally:
    """Running counters of a search."""

    runs: int = 0
    combinations: int = 0
    """Combinations of network and error; each run of one has other adversaries."""
    violations: int = 0
    broken: int = 0
    lost: int = 0
    uncertified: int = 0
    worst: Attacked | None = None
    excess: float = -math.inf
    kinds: dict[str, KindTally] = field(default_factory=dict)
    """Counters by `kind`."""

    def take(self, found: Attacked, *, new: bool) -> None:
        """Add the result of a task."""
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


def warm(*, altitude: bool = False) -> None:
    """Compile an attack, in the plane or at an altitude, or load it from the cache."""
    conditions = Conditions()
    bounds = declared(conditions, 0.0)
    flight = over_town(bounds, conditions, 0) if altitude else None
    attack(bounds, conditions, 0, 0, 1, 1.0, flight)


def _guarded(control: str | None, bounds: SafetyBounds, conditions: Conditions) -> Conditions:
    """Return the conditions with the faulty guard in place of the filter."""
    if control is None:
        return conditions
    paper = PAPER_BOUNDS
    radius = spec_radius(bounds, with_latency=control != "paper-radius")
    if control == "switching":
        radius = float(raw_switching_radius(paper["r_v"], paper["v_a"], paper["v_g"], paper["u_a"]))
    return conditions._replace(law=CONTROLS[control], radius=radius)


def fly_attack(
    bounds: SafetyBounds,
    conditions: Conditions,
    flight: int | None,
    seed: int,
    first: int,
    runs: int,
    duration: float,
) -> Attacked:
    """Simulate some runs of one combination in a worker; arguments as in `outrider_falsify.attack.attack`.

    `flight` is the row of `FLIGHTS`; None: the UAV flies in the plane.
    """
    above = None if flight is None else over_town(bounds, conditions, flight)
    found = attack(bounds, conditions, seed, first, runs, duration, above)
    lost, uncertified = found["lost"] > 0.0, found["uncertified"] > 0.0
    certifies = conditions.law == GUARDS.filter
    distance = found["max_certified" if certifies else "max_distance"]
    violated = found["certified_lost"] > 0.0 if certifies else lost
    worst = int(np.argmax(distance / conditions.r_v))
    return Attacked(
        eps=bounds.max_measurement_error,
        bounds={
            name: getattr(bounds, name)
            for name in ("v_a", "u_a", "v_g", "dt")
            if getattr(bounds, name) != PAPER_BOUNDS[name]
        },
        conditions=conditions,
        flight=flight,
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


def _combinations(*, altitude: bool) -> Iterator[tuple[SafetyBounds, Conditions, int | None]]:
    """Yield every combination; those with an altitude take turns with the rows of `FLIGHTS`."""
    for k, (bounds, conditions) in enumerate(grid()):
        flight = k % len(FLIGHTS) if altitude else None
        if flight is None or certifiable(bounds, conditions, flight):
            yield bounds, conditions, flight


def _calls(
    control: str | None,
    eps: float | None,
    seed: int,
    runs: int | None,
    duration: float,
    *,
    altitude: bool,
) -> Iterator[tuple[SafetyBounds, Conditions, int | None, int, int, int, float]]:
    """Yield every combination once, then more runs of each until the requested number is reached."""
    left = math.inf if runs is None else runs
    flown: list[tuple[SafetyBounds, Conditions, int | None]] = []

    def length(bounds: SafetyBounds) -> float:
        return duration * max(1.0, bounds.dt / PAPER_BOUNDS["dt"])

    for bounds, conditions, flight in _combinations(altitude=altitude):
        if left <= 0:
            return
        if eps is None or bounds.max_measurement_error == eps:
            flown.append((bounds, _guarded(control, bounds, conditions), flight))
            left -= 1
            yield *flown[-1], seed, 0, 1, length(bounds)
    first = 1
    while flown:
        for bounds, conditions, flight in flown:
            if left <= 0:
                return
            count = int(min(_CHUNK, left))
            left -= count
            yield bounds, conditions, flight, seed, first, count, length(bounds)
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
    altitude: bool = False,
    on_task: Callable[[], None] = lambda: None,
) -> None:
    """Attack until the budget is used up.

    Args:
        workers: Worker processes.
        budget: Limit on runs and time.
        tally: Counters, updated with each result.
        control: Faulty guard in place of the filter, a row of `CONTROLS`.
        eps: Restriction to one detection error [m].
        seed: Seed of all draws.
        duration: Duration of each run [s]; scaled up with ticks longer than the paper's, to keep the number of ticks.
        altitude: True if the UAV dives and climbs over towns; False: it flies in the plane.
        on_task: Callback after each task.
    """
    calls = _calls(control, eps, seed, budget.runs, duration, altitude=altitude)
    for found in workers.stream(fly_attack, calls, budget.ends):
        tally.take(found, new=found.runs == 1 and tally.runs == tally.combinations)
        on_task()


_NAMES = (
    "import math; from outrider_falsify.attack import attack; "
    "from outrider_falsify.conditions import Conditions, declared"
)


def again(found: Attacked, seed: int) -> str:
    """Return one line of Python that repeats the worst run."""
    arguments = ", ".join(
        f"{name}=math.inf" if value == math.inf else f"{name}={value!r}"
        for name, value in found.conditions._asdict().items()
        if value != Conditions._field_defaults[name]
        and (name not in ("law", "radius") or found.conditions.law)
    )
    conditions = f"c = Conditions({arguments})"
    bounds = "".join(f", {name}={value!r}" for name, value in found.bounds.items())
    names, flight = _NAMES, ""
    if found.flight is not None:
        names += "; from outrider_falsify.heights import over_town"
        flight = f", over_town(b, c, {found.flight})"
    return (
        f"{names}; {conditions}; b = declared(c, {found.eps!r}{bounds}); "
        f"attack(b, c, {seed}, {found.worst_run}, 1, {found.duration!r}{flight})[0]"
    )
