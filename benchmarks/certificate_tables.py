"""Tables of docs/explanation/proof.md, about a minute each.

python benchmarks/certificate_tables.py NAME, with a NAME of `TABLES`.

radius: R_h, E and r_cert over eps, A and tau_c; and the largest A.
guards: loss of sight under faulty guards, and under the filter.
interval: cost of the command interval B: R_h, E, r_cert and the largest A.
wind: cost of the tracking error w, and w of some inner loops.
commands: effect of early, late or lost commands on sight and certificate.
profiles: whole runs over each shipped network profile: share of certified ticks, mean e(t), and the count that must be
zero.
"""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from markdown_tables import head, print_chosen

from agents.safety.handover import certificate, certified_radius, largest_age
from bus.messages.scenario import SafetyParameters
from bus.profiles import PROFILES
from outrider.running.flying import InProcess, make_pilots
from outrider_falsify.attack import attack
from outrider_falsify.conditions import (
    AREAS,
    BLACKOUTS,
    DISTURBANCES,
    ERRORS,
    GUARDS,
    INNERS,
    PAPER_BOUNDS,
    UGVS,
    Conditions,
    declared,
    spec_radius,
)
from sim.compiling.records import RecordArray
from sim.models.inner_loop import InnerLoop, needed_reserve, tracking_error
from sim.models.safety import SafetyBounds, safety_bounds
from sim.scenario.loading import load_scenario
from sim.server.flight import Flight

RUNS, DURATION = 1000, 200.0
SEEDS = 10
NUMBERS = {name: PAPER_BOUNDS[name] for name in ("v_a", "u_a", "v_g", "dt")}


def _certificate(**declared: float) -> SafetyBounds:
    """Return the bounds with these declarations and the paper's limits."""
    n = {"delay": 0.0, "interval": 0.0, "tracking": 0.0} | declared
    safety = SafetyParameters(
        max_measurement_error=n["eps"],
        max_measurement_age=n["age"],
        max_command_delay=n["delay"],
        max_command_interval=n["interval"],
        max_tracking_error=n["tracking"],
    )
    return certificate(safety_bounds(safety, visibility_radius=PAPER_BOUNDS["r_v"], **NUMBERS))


def radius() -> Iterator[str]:
    """Yield the declared bounds and the resulting radii."""
    yield head("ε [m] | A [s] | τ_c [s] | R_h [m] | E [m] | r_cert [m]")
    rows = [(0.0, 0.05, 0.0), *((0.3, age, 0.0) for age in (0.05, 5.0, 10.0, 15.0))]
    rows += [(0.9, 10.0, 0.0), (1.5, 0.05, 0.0), (1.5, 5.0, 0.0)]
    rows += [(0.3, 0.05, 0.5), (0.3, 0.05, 1.0), (0.3, 15.0, 1.0)]
    for eps, age, delay in rows:
        c = _certificate(eps=eps, age=age, delay=delay)
        cells = f"{c.handover_radius:.3f} | {c.handover_bound:.2f} | {certified_radius(c):.2f}"
        yield f"| {eps:g} | {age:g} | {delay:g} | {cells} |"
    yield ""
    errors = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)
    yield head(f"largest A [s] at ε [m] | {' | '.join(f'{eps:g}' for eps in errors)}")
    for delay in (0.0, 1.0):
        ages = [largest_age(_certificate(eps=eps, age=0.05, delay=delay)) for eps in errors]
        yield f"| τ_c = {delay:g} s | {' | '.join(f'{age:.1f}' for age in ages)} |"


def _attacked(task: tuple[str, Conditions, float, float]) -> tuple[str, RecordArray]:
    name, conditions, eps, margin = task
    return name, attack(declared(conditions, eps, margin=margin), conditions, 3, 0, RUNS, DURATION)


def _fly(tasks: list[tuple[str, Conditions, float, float]]) -> Iterator[tuple[str, RecordArray]]:
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        yield from pool.map(_attacked, tasks)


def guards() -> Iterator[str]:
    """Yield faulty guards and the filter."""
    outward, flees = INNERS.outward, UGVS.flees
    sphere, periodic = ERRORS.sphere, BLACKOUTS.periodic
    tasks: list[tuple[str, Conditions, float, float]] = []

    def add(name: str, conditions: Conditions, eps: float) -> None:
        if conditions.law != GUARDS.filter and not conditions.radius:
            late = conditions.law != GUARDS.switch_servo or not conditions.delay
            conditions = conditions._replace(
                radius=spec_radius(declared(conditions, eps), with_latency=late)
            )
        tasks.append((name, conditions, eps, 0.0))

    paper = Conditions(law=GUARDS.paper, radius=spec_radius(declared(Conditions(), 0.0)) + 0.04)
    add("(18), undegraded", paper, 0.0)
    add("(18), inner outward, UGV flees", paper._replace(inner=outward, ugv=flees), 0.0)
    add("(18), detections 0.5 s late", paper._replace(latency=0.5), 0.0)
    add("(18), commands 0.5 s late", paper._replace(delay=0.5), 0.0)
    add("(18), blackouts of 10 s", paper._replace(blackout=periodic, blackout_time=10.0), 0.0)
    tracking = Conditions(law=GUARDS.switch_tracking)
    add("d_cert and (15), ε 0.3 m", tracking, 0.3)
    add("d_cert and (15), errors of norm 0.3 m", tracking._replace(error=sphere), 0.3)
    add("d_cert and (15), ε 0.9 m", tracking, 0.9)
    add(
        "d_cert and the best detection, ε 0.9 m, blackouts of 8 s",
        Conditions(GUARDS.switch_best, blackout=1, blackout_time=8.0),
        0.9,
    )
    add(
        "d_cert and the servo without τ_c, commands 1 s late",
        Conditions(law=GUARDS.switch_servo, delay=1.0),
        0.3,
    )
    add("d_cert and the servo, cos θ = 1, ε 0.3 m", Conditions(law=GUARDS.switch_servo), 0.3)
    add("d_cert and the servo, cos θ = 1, ε 1.5 m", Conditions(law=GUARDS.switch_servo), 1.5)
    add("the filter, ε 0.3 m", Conditions(), 0.3)
    add("the filter, ε 1.5 m", Conditions(), 1.5)
    add("the filter, errors of norm 0.3 m", Conditions(error=sphere), 0.3)
    add(
        "the filter, ε 0.9 m, blackouts of 8 s",
        Conditions(blackout=periodic, blackout_time=8.0),
        0.9,
    )
    add(
        "the filter, ε 0.3 m, blackouts of 15 s",
        Conditions(blackout=periodic, blackout_time=15.0),
        0.3,
    )
    add("the filter, commands 1 s late", Conditions(delay=1.0), 0.3)
    add("the filter, in a small room", Conditions(area=AREAS.small), 0.3)
    columns = "lose sight | certified while lost | certificate broken | largest d [m] | mean d [m]"
    yield head(f"guard and conditions, {RUNS:,} runs | {columns}")
    for name, rows in _fly(tasks):
        counts = [
            f"{int((rows[column] > 0).sum())}" if "filter" in name else "–"
            for column in ("certified_lost", "broken")
        ]
        lost, far = int((rows["max_distance"] >= 4.75).sum()), rows["max_distance"].max()
        yield f"| {name} | {lost} | {counts[0]} | {counts[1]} | {far:.4f} | {rows['mean_distance'].mean():.2f} |"


def interval() -> Iterator[str]:
    """Yield the cost of B."""
    waits = (0.05, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0)
    yield head(f"B [s] | {' | '.join(f'{wait:g}' for wait in waits)}")
    for eps, age, delay in ((0.3, 1.0, 0.0), (0.3, 5.0, 0.0), (0.3, 1.0, 0.5), (0.9, 1.0, 0.0)):
        found = [_certificate(eps=eps, age=age, delay=delay, interval=wait) for wait in waits]
        name = f"ε {eps:g} m, A {age:g} s, τ_c {delay:g} s"
        yield from _bounds(name, found)
    for eps, delay in ((0.0, 0.0), (0.3, 0.0), (0.9, 0.0), (0.3, 1.0)):
        found = [_certificate(eps=eps, age=0.05, delay=delay, interval=wait) for wait in waits]
        yield _oldest(f"ε {eps:g} m, τ_c {delay:g} s", found)


def wind() -> Iterator[str]:
    """Yield the cost of w, and its size."""
    offs = (0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2)
    yield head(f"w [m] | {' | '.join(f'{off:g}' for off in offs)}")
    for eps, age, interval in ((0.3, 1.0, 0.0), (0.3, 5.0, 0.0), (0.3, 1.0, 2.0)):
        found = [_certificate(eps=eps, age=age, interval=interval, tracking=off) for off in offs]
        name = f"ε {eps:g} m, A {age:g} s" + (f", B {interval:g} s" if interval else "")
        yield from _bounds(name, found)
    for eps, interval in ((0.0, 0.0), (0.3, 0.0), (0.9, 0.0), (0.3, 2.0)):
        found = [_certificate(eps=eps, age=0.05, interval=interval, tracking=off) for off in offs]
        yield _oldest(f"ε {eps:g} m" + (f", B {interval:g} s" if interval else ""), found)
    yield ""
    pushes = ((0.1, 0.0), (0.2, 0.0), (0.0, 0.2), (0.1, 0.2))
    heads = " | ".join(f"W {most:g} m/s², ε_a {own:g} m" for most, own in pushes)
    yield head(f"k_p [1/s²], k_d [1/s]; w [m] (reserve [m/s²]) at | {heads}")
    for gains in ((1.0, 2.0), (2.25, 3.0), (4.0, 4.0), (1.0, 1.0), (1.0, 0.4)):
        loop, cells = (
            InnerLoop(position_gain=gains[0], velocity_gain=gains[1], reserve=math.inf),
            [],
        )
        for push in pushes:
            off, least = (of(loop, *push, NUMBERS["dt"]) for of in (tracking_error, needed_reserve))
            cells.append(f"{off:.3f} ({least:.3f})")
        yield f"| {gains[0]:g}, {gains[1]:g} | {' | '.join(cells)} |"


def _bounds(case: str, found: list[SafetyBounds]) -> Iterator[str]:
    """Yield rows of R_h, E and r_cert."""
    for name, row in (
        ("R_h [m]", [f"{c.handover_radius:.3f}" for c in found]),
        ("E [m]", [f"{c.handover_bound:.2f}" for c in found]),
        ("r_cert [m]", [f"{certified_radius(c):.2f}" for c in found]),
    ):
        yield f"| {name} at {case} | {' | '.join(row).replace('nan', '–')} |"


def _oldest(case: str, found: list[SafetyBounds]) -> str:
    """Return a row of the largest A."""
    ages = [largest_age(c) for c in found]
    row = " | ".join("–" if math.isnan(age) else f"{age:.1f}" for age in ages)
    return f"| largest A [s] at {case} | {row} |"


def _unreliable() -> dict[str, tuple[Conditions, float]]:
    """Return cases of early, late or lost commands, with the longest duration of each."""
    silences = DISTURBANCES.silences
    cases = {
        f"0 to {late:g} s late": (Conditions(delay=late, jitter=True), late)
        for late in (0.2, 0.5, 1.0)
    }
    for name, kind in (
        ("single losses", DISTURBANCES.single_losses),
        ("up to 0.25 s later than declared", DISTURBANCES.late),
    ):
        cases[name] = (Conditions(disturbance=kind), 0.3)
    cases |= {
        f"lost for up to {out:g} s": (
            Conditions(disturbance=silences, silence=out, command_timeout=0.5),
            out,
        )
        for out in (0.2, 0.5, 1.0, 2.0)
    }
    return cases


def commands() -> Iterator[str]:
    """Yield cases of early, late or lost commands.

    A gap of n ticks needs B of n + 1; late commands need a delay.
    """
    tasks = []
    for name, (conditions, longest) in _unreliable().items():
        late = conditions.delay if conditions.jitter else 0.0
        kept = conditions._replace(
            delay=late, max_command_interval=longest + 0.05 if not late else 0.05
        )
        if conditions.disturbance == DISTURBANCES.late:
            kept = kept._replace(max_command_interval=1.0)
        tasks.append((name, kept, 0.3, 0.0))
    columns = "B [s] | lose sight | certified while lost | certificate broken | uncertified ticks | mean d [m]"
    yield head(f"commands, {RUNS:,} runs | {columns}")
    for (name, rows), (_, conditions, _, _) in zip(_fly(tasks), tasks, strict=True):
        counts = [int((rows[k] > 0).sum()) for k in ("certified_lost", "broken")]
        lost = int((rows["max_distance"] >= 4.75).sum())
        share, mean = rows["uncertified"].mean(), rows["mean_distance"].mean()
        cells = f"{conditions.max_command_interval:g} | {lost} | {counts[0]} | {counts[1]}"
        yield f"| {name} | {cells} | {share:.1%} | {mean:.2f} |"


_DECLARED = {
    "narrowband": ["certificate.max_command_delay=1.0", "certificate.max_command_interval=5.0"]
}
"""Declarations about the commands on a profile, if they differ from B = 4 s and the link's longest delay."""


def _flown(task: tuple[str, str, int]) -> tuple[float, float, int, float]:
    profile, links, seed = task
    changes = [
        "law.name=certified",
        "ugv.0.driver=evade",
        "area.cell=0.5",
        "duration=160.0",
        "command_timeout=2.0",
        "certificate.max_measurement_age=6.0",
    ]
    if links != "detections":
        changes += _DECLARED.get(profile, ["certificate.max_command_interval=4.0"])
    names = ("detections", "commands") if links == "both" else (links,)
    scenario = load_scenario(
        "escort",
        overrides=[*changes, *(f"links.{name}={{profile = '{profile}'}}" for name in names)],
    )
    flight, reports = Flight(scenario, seed), []
    flight.fly(
        InProcess(make_pilots(scenario, seed)),
        on_tick=lambda: reports.append(flight.answers.reports[0]),
    )
    distance, error = flight.recorder.escorts[:, 0, 0], flight.recorder.escorts[:, 0, 1]
    certified = [
        report is not None and report.decision is not None and report.decision.certified
        for report in reports
    ]
    false = sum(distance[tick] >= 4.75 for tick, sure in enumerate(certified) if sure)
    return sum(certified) / len(certified), float(error.mean()), int(false), float(distance.max())


def profiles() -> Iterator[str]:
    """Yield whole runs against an evading UGV over each shipped profile."""
    columns = "certified ticks | certified while lost | mean e(t) [m²] | largest d [m]"
    yield head(f"profile, {SEEDS} runs of 160 s | on | {columns}")
    tasks = [
        (profile, links, seed)
        for profile in PROFILES
        for links in ("detections", "commands", "both")
        for seed in range(SEEDS)
    ]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        found = list(pool.map(_flown, tasks))
    for k in range(0, len(tasks), SEEDS):
        share, error, false, far = zip(*found[k : k + SEEDS], strict=True)
        cells = f"{math.fsum(share) / SEEDS:.1%} | {sum(false)} | {math.fsum(error) / SEEDS:.1f} | {max(far):.3f}"
        yield f"| {tasks[k][0]} | {tasks[k][1]} | {cells} |"


TABLES: dict[str, Callable[[], Iterator[str]]] = {
    "interval": interval,
    "wind": wind,
    "radius": radius,
    "guards": guards,
    "commands": commands,
    "profiles": profiles,
}

if __name__ == "__main__":
    print_chosen(TABLES, __doc__)
