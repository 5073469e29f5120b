"""`outrider falsify`: a search for what breaks the promise."""

import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bus.errors import PeerLost
from bus.plugins import require
from bus.registry import LAWS
from outrider.cli.options import AllowCode, Json, ScenarioName, Set
from outrider.cli.stopping import stop_on_signals
from outrider_falsify import options

if TYPE_CHECKING:
    from outrider_falsify.engines import Found, Wanted
    from outrider_falsify.limits import SearchLimits
    from sim.scenario.types import Scenario

_MINUTES = 1.0
_LINE = 10.0
"""The time between two lines of progress without a terminal [s]; one more comes at the first violation."""


def command(
    scenario: ScenarioName = "escort",
    law: options.Law = None,
    limit: options.Limit = None,
    runs: options.Runs = None,
    minutes: options.Minutes = None,
    duration: options.Duration = None,
    seed: options.Seed = 1,
    jobs: options.Jobs = None,
    expect: options.Expected = None,
    engine: options.OneEngine = None,
    control: options.Control = None,
    error: options.Error = None,
    changes: Set = None,
    allow_code: AllowCode = False,
    out: options.Out = None,
    json: Json = False,
) -> None:
    """Search for a run in which the UAV loses sight of its UGV.

    On all cores. Turned are the UGV's motion within its bounds, the start, the draws of the noise and, within the
    limits below, the network: first what the proofs fear, then chance, then CMA-ES on the largest distance. Starts are
    such that braking at once keeps the UGV within r_s, so that a law that loses it did so itself. The worst run with a
    violation is saved as a scenario that flies it again, to the last bit: `outrider run FILE --in-process`.

    The law `certified` promises only where it says so: a run counts as violated if every tick from its first certified
    one up to the loss was certified (after a gap: those of the last second), or if any tick was certified while the UGV
    was out of sight; all numbers are told. What the scenario does not declare in [certificate] is declared as the
    limits need it. For this law a compiled attack is flown as well, over its own grid: adversaries in the UAV and in
    the UGV, errors on the border of their ball, blackouts up to 15 s, commands up to 1 s late, walls and corners; and
    commands that are lost, early, doubled or later than declared, laws changed in flight, processes that join again.
    One in a hundred of --runs are whole flights, the others attacks; of --minutes, a third.

    The exit code is 0 whatever is found, unless --expect says otherwise; 130 after Ctrl-C, which keeps the best.
    Needs the extra [falsify].

    Example: outrider falsify --law switching --limit none
    """
    from outrider.running.resolve import resolve
    from outrider.running.user_code import check_code, check_own_functions
    from outrider_falsify.engines import Wanted
    from outrider_falsify.limits import SearchLimits
    from sim.compiling.threads import cores

    if control is not None and (law not in (None, "certified") or engine == "flights"):
        raise typer.BadParameter(
            "--control stands in the place of the law certified in the attack; leave --law and --engine out"
        )
    flown, named = resolve(
        scenario,
        law="certified" if control is not None else law,
        duration=options.FLIGHT if duration is None else duration,
        changes=changes,
    )
    check_code(flown, named, source=scenario, allowed=allow_code)
    check_own_functions(flown)
    certified = LAWS[flown.law.name].watched
    if (engine is not None or error is not None) and not certified:
        raise typer.BadParameter("--engine and --error are for the law certified")
    flies = control is None and engine != "attack"
    attacks = certified and (control is not None or engine != "flights")
    limits = SearchLimits(**options.limits_of(limit, flown.detections.noise))
    if attacks:
        _check_error(error)
    _check_out(out)
    wanted = Wanted(
        base=_base(flown, limits) if flies else flown,
        limits=limits,
        flies=flies,
        attacks=attacks,
        runs=runs,
        minutes=_MINUTES if runs is None and minutes is None else minutes,
        attack_duration=duration or options.ATTACK,
        seed=seed,
        jobs=jobs or cores(),
        control=None if control is None else str(control),
        eps=error,
        out=out,
    )
    _search(wanted, expect, json=json)


def _check_error(error: float | None) -> None:
    """Refuse an error that the attack does not try."""
    from outrider_falsify.attack_grid import EPS

    if error is not None and error not in EPS:
        allowed = ", ".join(f"{one:g}" for one in EPS)
        raise typer.BadParameter(f"--error {error:g}: not in the attack's grid; allowed: {allowed}")


def _base(given: "Scenario", limits: "SearchLimits") -> "Scenario":
    """Return the scenario that every flight starts from; warn of what the limits change or exceed in it."""
    from outrider.cli.console import print_warnings
    from outrider_falsify.limits import base_of, beyond_declared

    require("falsify")
    base = base_of(given, limits)
    raised: tuple[str, ...] = ()
    if base.command_timeout > given.command_timeout:
        raised = (
            f"command_timeout = {given.command_timeout:g} s is raised to {base.command_timeout:g} s, the "
            f"latest command that the limits allow",
        )
    print_warnings((*raised, *beyond_declared(base, limits)))
    return base


def _check_out(out: Path | None) -> None:
    """Raises if the file cannot be written: before the search, not after it."""
    if out is None:
        return
    if out.is_dir():
        raise typer.BadParameter(f"--out {out}: is a folder; allowed: a file")
    out.parent.mkdir(parents=True, exist_ok=True)


def _search(wanted: "Wanted", expect: options.Expected, *, json: bool) -> None:
    from outrider.cli.console import ERR, OUT, print_json
    from outrider_falsify.engines import Found, save, search

    found, fault = Found(wanted), None
    with stop_on_signals() as stop:
        try:
            with _progress(found) as show:
                search(found, asked=lambda: bool(stop), on_run=show)
        except PeerLost as error:  # what has been found by then is told all the same
            fault = error
        save(found)
    if json:
        print_json(found.as_plain())
    else:
        for line in _lines(found):
            OUT.tell(line)
    if fault is not None:
        raise fault
    if stop:
        ERR.tell(f"outrider: interrupted after {found.runs:,} runs; what was found by then is told")
        raise typer.Exit(stop.exit_code)
    if expect is not None and not found.runs:
        ERR.tell(f"outrider: --expect {expect}, but the time was over before anything had flown")
        raise typer.Exit(1)
    if expect is not None and (found.violations > 0) is (expect == "none"):
        ERR.tell(
            f"outrider: --expect {expect}, but {found.violations:,} of {found.runs:,} runs are violations"
        )
        raise typer.Exit(1)


@contextmanager
def _progress(found: "Found") -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal, else a line now and then."""
    from outrider.cli.console import ERR, runs_bar

    began = said = time.monotonic()
    shown = 0  # violations
    with runs_bar(width=30) as progress:
        task = progress.add_task("starting", total=1.0, note="")

        def show(engine: str, share: float) -> None:
            nonlocal said, shown
            now = time.monotonic()
            rate = found.runs / max(now - began, 1e-9)
            note = (
                f"{found.runs:,} runs, {rate:.1f} runs/s, farthest {found.worst:.4f} m, {found.violations:,} "
                "violations"
            )
            note += f", {found.lost:,} lost" if found.lost != found.violations else ""
            progress.update(task, description=engine, completed=min(1.0, share), note=note)
            if not ERR.is_terminal and (now - said >= _LINE or (found.violations and not shown)):
                said, shown = now, found.violations
                ERR.tell(f"{engine}: {note}")

        yield show


_KINDS = "place, what breaks A5'"


def _lines(found: "Found") -> Iterator[str]:
    """Tell what was found."""
    from outrider.running.user_code import foreign_code

    wanted = found.wanted
    law = (
        wanted.base.law.name
        if wanted.control is None
        else f"{wanted.control}, in the place of the filter"
    )
    rate = found.runs / found.seconds if found.seconds > 0.0 else 0.0
    much = f"{found.runs:,} runs in {found.seconds:.1f} s, {rate:.1f} runs/s"
    yield f"{law}: {found.violations:,} violations of r_v = {wanted.base.visibility.radius:g} m in {much}"
    yield from _flight_lines(found)
    yield from _attack_lines(found)
    if found.path is not None:
        yield "  The worst flight:"
        yield from (f"    {line}" for line in found.words)
        yield f"  {found.path}"
        # the file names what the command has named
        code = " --allow-code" if foreign_code(wanted.base) else ""
        yield f"  outrider run {shlex.quote(str(found.path))} --in-process{code} flies it again: {found.sha256}"


def _flight_lines(found: "Found") -> Iterator[str]:
    flights = found.flights
    if not flights.runs:
        return
    yield f"  flights: {flights.violations:,} of {flights.runs:,} lose sight; the farthest {flights.worst:.4f} m"
    if LAWS[found.wanted.base.law.name].watched:
        share = f"not every tick was certified in {flights.uncertified:,}"
        yield (
            f"    {share}; in {flights.lost - flights.violations:,} sight was lost after nothing was "
            "promised any more"
        )
        yield f"    certified while lost: {flights.certified_while_lost:,} ticks"
        yield f"    certificate lost while all assumptions held: {flights.certificate_broken:,} times"


def _attack_lines(found: "Found") -> Iterator[str]:
    wanted, attacks = found.wanted, found.attacks
    if attacks.worst is None:
        return
    worst = attacks.worst
    over = f"over {attacks.combinations:,} combinations of network and error"
    said = "are certified while sight is lost" if wanted.control is None else "lose sight"
    yield (
        f"  attack: {attacks.violations:,} of {attacks.runs:,} {over} {said}; the farthest "
        f"{worst.worst_distance:.6f} m"
    )
    if wanted.control is None:
        yield f"    the certificate is lost although its assumptions hold in {attacks.broken:,}"
        yield f"    not every tick was certified in {attacks.uncertified:,}; sight was lost in {attacks.lost:,}"
        yield (
            f"    {_KINDS:46}{'runs':>8}{'lost':>8}{'certified, lost':>17}"
            f"{'broken':>8}{'uncertified':>13}"
        )
        for name, one in sorted(attacks.kinds.items()):
            counts = f"{one.runs:8,}{one.lost:8,}{one.violations:17,}{one.broken:8,}"
            yield f"    {name:46}{counts}{one.uncertified / one.runs:13.1%}"
    else:
        yield "    nothing certifies here"
    if found.attack_again is not None:
        c = worst.conditions
        dark = f"motions lost for up to {c.outage:g} s, " if c.outage else ""
        dark += (
            f"blackouts up to {c.blackout_time:g} s, detections up to {c.latency:g} s and commands "
            f"{c.delay:g} s late"
        )
        yield f"  The worst attack: errors up to {worst.eps:g} m, {dark}. Again:"
        yield f"    {found.attack_again}"
