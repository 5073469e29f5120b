"""Work of `outrider falsify`: scenario, limits, search and report."""

import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from bus.errors import PeerLost
from bus.plugins import require
from bus.registry import LAWS
from outrider.cli.console import ERR, OUT, print_json, print_warnings, runs_bar
from outrider.cli.stopping import stop_on_signals
from outrider.running.own_functions import check_own_functions
from outrider.running.resolve import resolve
from outrider.running.user_code import check_code, foreign_code
from outrider_falsify.attack_grid import EPS
from outrider_falsify.engines import SearchRequest, SearchResult, save, search
from outrider_falsify.limits import SearchLimits, base_of, beyond_declared
from outrider_falsify.options import Expect, limits_of
from sim.scenario.checks import check_no_robot
from sim.scenario.types import Scenario

_LINE = 10.0
"""Interval between two progress lines without a terminal [s]; the first violation prints one at once."""


def flown_scenario(
    name: str,
    *,
    law: str | None,
    duration: float,
    changes: list[str] | None,
    allow_code: bool,
) -> Scenario:
    """Load a scenario with its changes, and check its user code; errors as in `resolve` and `check_code`."""
    flown, named = resolve(name, law=law, duration=duration, changes=changes)
    check_code(flown, named, source=name, allowed=allow_code)
    check_own_functions(flown)
    check_no_robot(flown)
    return flown


def limits_of_search(given: list[str] | None, flown: Scenario) -> SearchLimits:
    """Return the limits of `--limit`; errors as in `limits_of`."""
    return SearchLimits(**limits_of(given, flown.detections.noise))


def check_error(error: float | None) -> None:
    """Raise BadParameter if the attack's grid lacks this error."""
    if error is not None and error not in EPS:
        allowed = ", ".join(f"{one:g}" for one in EPS)
        raise typer.BadParameter(f"--error {error:g}: not in the attack's grid; allowed: {allowed}")


def base_scenario(given: Scenario, limits: SearchLimits) -> Scenario:
    """Return the base scenario of every candidate; warn about fields that the limits raise or exceed."""
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


def falsify(wanted: SearchRequest, expect: Expect | None, *, json: bool) -> None:
    """Search, print the result and save the worst violation.

    Raises:
        Exit: If a signal ended the search, or the result is not the expected one.
        PeerLost: If a worker failed; the result so far is printed.
    """
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
def _progress(found: SearchResult) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar on a terminal, otherwise a line at intervals."""
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


def _lines(found: SearchResult) -> Iterator[str]:
    """Yield the lines of the printed result."""
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


def _flight_lines(found: SearchResult) -> Iterator[str]:
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


def _attack_lines(found: SearchResult) -> Iterator[str]:
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
