"""`outrider falsify`: search for runs that violate the visibility guarantee."""

import shlex
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bus.errors import PeerLost
from bus.files import writing
from bus.plugins import require
from bus.registry import LAWS
from outrider.cli.options import AllowCode, Json, ScenarioName, Set
from outrider.cli.stopping import stop_on_signals
from outrider_falsify import options

if TYPE_CHECKING:
    from outrider_falsify.engines import SearchRequest, SearchResult
    from outrider_falsify.limits import SearchLimits
    from sim.scenario.types import Scenario

_MINUTES = 1.0
_LINE = 10.0
"""Interval between two progress lines without a terminal [s]; the first violation prints one at once."""


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
    altitude: options.Altitude = False,
    changes: Set = None,
    allow_code: AllowCode = False,
    out: options.Out = None,
    json: Json = False,
) -> None:
    """Search for a run in which the UAV loses sight of its UGV.

    The search uses all cores. It varies the UGV's motion within its limits, the start, the noise and, within --limit,
    the network. It tries critical cases of the proofs, then random candidates, then CMA-ES on the largest distance.
    From every start, braking at once keeps the UGV within r_s: a loss is the law's own fault. The worst violation is
    saved as a scenario that reproduces it exactly: `outrider run FILE --in-process`.

    The law `certified` guarantees visibility only at certified ticks. A run violates the guarantee if every tick from
    its first certified one to the loss was certified (after a gap: every tick of the last second). It also does if any
    tick was certified while the UGV was out of sight. Bounds missing from [certificate] are set to cover the limits.

    For this law a compiled attack runs as well: adversaries control the UAV, the UGV, the detection errors and the
    network, and break assumptions. It takes 99 of 100 of --runs, or two thirds of --minutes.

    The exit code is 0 for any result unless --expect is given; 130 after Ctrl-C, which keeps the best result.

    Example: outrider falsify --law switching --limit none
    """
    from outrider.running.resolve import resolve
    from outrider.running.user_code import check_code, check_own_functions
    from outrider_falsify.engines import SearchRequest
    from outrider_falsify.limits import SearchLimits
    from sim.compiling.threads import cores

    _check_control(control is not None, law, engine, altitude=altitude)
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
        raise typer.BadParameter(
            f"law = {flown.law.name}: --engine and --error need the law certified"
        )
    flies = control is None and engine != "attack"
    attacks = certified and (control is not None or engine != "flights")
    limits = SearchLimits(**options.limits_of(limit, flown.detections.noise))
    _check_error(error if attacks else None)
    _check_out(out)
    wanted = SearchRequest(
        base=_base(flown, limits) if flies else flown,
        limits=limits,
        flies=flies,
        attacks=attacks,
        runs=runs,
        minutes=_MINUTES if runs is None and minutes is None else minutes,
        attack_duration=duration or options.ATTACK,
        seed=seed,
        jobs=jobs or cores(),
        altitude=altitude,
        control=None if control is None else str(control),
        eps=error,
        out=out,
    )
    _search(wanted, expect, json=json)


def _check_error(error: float | None) -> None:
    """Raise BadParameter if the attack's grid lacks this error."""
    from outrider_falsify.attack_grid import EPS

    if error is not None and error not in EPS:
        allowed = ", ".join(f"{one:g}" for one in EPS)
        raise typer.BadParameter(f"--error {error:g}: not in the attack's grid; allowed: {allowed}")


def _base(given: "Scenario", limits: "SearchLimits") -> "Scenario":
    """Return the base scenario of every candidate; warn about fields that the limits raise or exceed."""
    from outrider.cli.console import print_warnings
    from outrider_falsify.limits import base_of, beyond_declared

    require("falsify")
    base = base_of(given, limits)
    raised: tuple[str, ...] = ()
    if base.command_timeout > given.command_timeout:
        raised = (
            f"command_timeout = {given.command_timeout:g} s: raised to {base.command_timeout:g} s, the "
            f"largest command delay within the limits",
        )
    print_warnings((*raised, *beyond_declared(base, limits)))
    return base


def _check_out(out: Path | None) -> None:
    """Raise BadParameter before the search if the file cannot be written."""
    if out is None:
        return
    if out.is_dir():
        raise typer.BadParameter(f"--out {out}: is a folder; allowed: a file")
    with writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=out.parent).close()


def _check_control(given: bool, law: str | None, engine: str | None, *, altitude: bool) -> None:
    """Raise `typer.BadParameter` if --control or --altitude cannot be combined with the law or the engine."""
    if altitude and (given or engine != "attack"):
        raise typer.BadParameter("--altitude: needs --engine attack, without --control")
    if given and (law not in (None, "certified") or engine == "flights"):
        raise typer.BadParameter(
            "--control: replaces the law certified in the attack; leave out --law and --engine"
        )


def _search(wanted: "SearchRequest", expect: options.Expected, *, json: bool) -> None:
    from outrider.cli.console import ERR, OUT, print_json
    from outrider_falsify.engines import SearchResult, save, search

    found, fault = SearchResult(wanted), None
    with stop_on_signals() as stop:
        try:
            with _progress(found) as show:
                search(found, asked=lambda: bool(stop), on_run=show)
        except PeerLost as error:  # print the result so far first
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
        ERR.tell(f"outrider: interrupted after {found.runs:,} runs; results so far are printed")
        raise typer.Exit(stop.exit_code)
    if expect is not None and not found.runs:
        ERR.tell(f"outrider: --expect {expect}: time ran out before the first run")
        raise typer.Exit(1)
    if expect is not None and (found.violations > 0) is (expect == "none"):
        ERR.tell(
            f"outrider: --expect {expect}: {found.violations:,} of {found.runs:,} runs are violations"
        )
        raise typer.Exit(1)


@contextmanager
def _progress(found: "SearchResult") -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar on a terminal, otherwise a line at intervals."""
    from outrider.cli.console import ERR, runs_bar

    began = printed = time.monotonic()
    shown = 0  # violations
    with runs_bar(width=30) as progress:
        task = progress.add_task("starting", total=1.0, note="")

        def show(engine: str, share: float) -> None:
            nonlocal printed, shown
            now = time.monotonic()
            rate = found.runs / max(now - began, 1e-9)
            note = (
                f"{found.runs:,} runs, {rate:.1f} runs/s, largest distance {found.worst:.4f} m, {found.violations:,} "
                "violations"
            )
            note += f", {found.lost:,} lost" if found.lost != found.violations else ""
            progress.update(task, description=engine, completed=min(1.0, share), note=note)
            if not ERR.is_terminal and (now - printed >= _LINE or (found.violations and not shown)):
                printed, shown = now, found.violations
                ERR.tell(f"{engine}: {note}")

        yield show


_KINDS = "area, violation of A5'"


def _lines(found: "SearchResult") -> Iterator[str]:
    """Yield the lines of the printed result."""
    from outrider.running.user_code import foreign_code

    wanted = found.wanted
    law = (
        wanted.base.law.name
        if wanted.control is None
        else f"{wanted.control}, in place of the filter"
    )
    rate = found.runs / found.seconds if found.seconds > 0.0 else 0.0
    amount = f"{found.runs:,} runs in {found.seconds:.1f} s, {rate:.1f} runs/s"
    yield f"{law}: {found.violations:,} violations of r_v = {wanted.base.visibility.radius:g} m in {amount}"
    yield from _flight_lines(found)
    yield from _attack_lines(found)
    if found.path is not None:
        yield "  Worst scenario:"
        yield from (f"    {line}" for line in found.description)
        yield f"  {found.path}"
        # the saved file refers to the same user code
        code = " --allow-code" if foreign_code(wanted.base) else ""
        yield f"  outrider run {shlex.quote(str(found.path))} --in-process{code} reproduces it: {found.sha256}"


def _flight_lines(found: "SearchResult") -> Iterator[str]:
    flights = found.flights
    if not flights.runs:
        return
    yield f"  scenarios: {flights.violations:,} of {flights.runs:,} lose sight; largest distance {flights.worst:.4f} m"
    if LAWS[found.wanted.base.law.name].watched:
        share = f"gaps in the certificate in {flights.uncertified:,}"
        yield (
            f"    {share}; sight lost without a certificate in "
            f"{flights.lost - flights.violations:,}"
        )
        yield f"    certified while lost: {flights.certified_while_lost:,} ticks"
        yield f"    certificate lost although all assumptions held: {flights.certificate_broken:,} times"


def _attack_lines(found: "SearchResult") -> Iterator[str]:
    wanted, attacks = found.wanted, found.attacks
    if attacks.worst is None:
        return
    worst = attacks.worst
    over = f"over {attacks.combinations:,} combinations of network and error"
    verdict = "are certified while sight is lost" if wanted.control is None else "lose sight"
    yield (
        f"  attack: {attacks.violations:,} of {attacks.runs:,} {over} {verdict}; largest distance "
        f"{worst.worst_distance:.6f} m"
    )
    if wanted.control is None:
        yield f"    certificate lost although all assumptions held in {attacks.broken:,}"
        yield f"    uncertified ticks in {attacks.uncertified:,}; sight lost in {attacks.lost:,}"
        yield (
            f"    {_KINDS:46}{'runs':>8}{'lost':>8}{'certified, lost':>17}"
            f"{'broken':>8}{'uncertified':>13}"
        )
        for name, one in sorted(attacks.kinds.items()):
            counts = f"{one.runs:8,}{one.lost:8,}{one.violations:17,}{one.broken:8,}"
            yield f"    {name:46}{counts}{one.uncertified / one.runs:13.1%}"
    else:
        yield "    this guard does not certify"
    if found.attack_again is not None:
        c = worst.conditions
        network = (
            f"trajectories lost for up to {c.max_command_interval:g} s, "
            if c.max_command_interval
            else ""
        )
        network += (
            f"blackouts up to {c.blackout_time:g} s, detections up to {c.latency:g} s and commands "
            f"{c.delay:g} s late"
        )
        yield f"  Worst attack: errors up to {worst.eps:g} m, {network}. To repeat it:"
        yield f"    {found.attack_again}"
