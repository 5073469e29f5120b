"""`outrider falsify`: a search for what breaks the promise."""

import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bus.errors import PeerLost
from bus.plugins import require
from bus.registry import LAWS
from outrider.cli.options import AllowCode, Json, ScenarioName, Set
from outrider.cli.stopping import stop_on_signals

if TYPE_CHECKING:
    from outrider_falsify.engines import Found, Wanted

_MINUTES = 1.0
_FLIGHT, _ATTACK = 60.0, 200.0
"""The length of a run by default [s]."""
_DELAY, _COMMAND_DELAY, _LOSS, _BLACKOUT = 1.0, 0.5, 0.3, 5.0
"""The limits by default [s], [s], share, [s]."""
_LINE = 10.0
"""The time between two lines of progress without a terminal [s]; one more comes at the first violation."""


Expect = Literal["none", "some"]
"""The violations that are expected; the exit code tells whether it is so."""


class ControlGuard(StrEnum):
    """Guards that are known to be wrong."""

    TRACKING = "tracking"
    ARGMIN = "argmin"
    PAPER_RADIUS = "paper-radius"
    SWITCHING = "switching"


def command(
    scenario: ScenarioName = "escort",
    law: Annotated[
        str | None, typer.Option("--law", help="The law to be broken, instead of the scenario's.")
    ] = None,
    undegraded: Annotated[
        bool,
        typer.Option(
            "--undegraded",
            help="No noise and a perfect network: the UGV's motion and the start alone.",
        ),
    ] = False,
    runs: Annotated[
        int | None, typer.Option(help="How many runs; the same seed finds the same.", min=1)
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(help="For how long; 1 minute by default.", min=0.01)
    ] = None,
    max_delay: Annotated[
        float | None,
        typer.Option(
            help=f"Of a detection, jitter and all, in s; {_DELAY:g} by default.", min=0.0, max=30.0
        ),
    ] = None,
    max_loss: Annotated[
        float | None,
        typer.Option(
            help=f"Share of detections that are lost; {_LOSS:g} by default.", min=0.0, max=0.99
        ),
    ] = None,
    max_blackout: Annotated[
        float | None,
        typer.Option(
            help=f"Of the detections, in s; {_BLACKOUT:g} by default.", min=0.0, max=1000.0
        ),
    ] = None,
    max_command_delay: Annotated[
        float | None,
        typer.Option(
            help=f"Of the UAV's commands, in s; {_COMMAND_DELAY:g} by default.", min=0.0, max=30.0
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="Of the detections: standard deviation per axis in m; the scenario's by default.",
            min=0.0,
            max=100.0,
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            help=f"Of a run in s; {_FLIGHT:g} by default, {_ATTACK:g} for the attack.", min=0.05
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the search.", min=0, max=2**53 - 1)] = 1,
    jobs: Annotated[
        int | None, typer.Option(help="Worker processes; one a core by default.", min=1, max=1024)
    ] = None,
    first: Annotated[
        bool, typer.Option("--first", help="End with the first violation, not with the budget.")
    ] = False,
    expect: Annotated[
        Expect | None,
        typer.Option(help="Exit with 1 if violations are found (none), or if none is (some)."),
    ] = None,
    engine: Annotated[
        Literal["flights", "attack"] | None,
        typer.Option(
            help="For the law certified: whole flights alone, or the compiled attack alone."
        ),
    ] = None,
    control: Annotated[
        ControlGuard | None,
        typer.Option(
            help="Attack a guard that is known to be wrong in the place of the filter, to see that it is caught."
        ),
    ] = None,
    eps: Annotated[
        float | None,
        typer.Option(help="For the attack: only this largest error of a detection, in m."),
    ] = None,
    changes: Set = None,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Where the counterexample goes; counterexample-LAW.toml by default.",
        ),
    ] = None,
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

    Example: outrider falsify --law switching --undegraded
    """
    from outrider.cli.console import print_warnings
    from outrider.running.resolve import resolve
    from outrider.running.user_code import check_code, check_own_functions
    from outrider_falsify.engines import Wanted
    from outrider_falsify.limits import SearchLimits, base_of, beyond_declared
    from sim.compiling.threads import cores

    limits_given = (max_delay, max_loss, max_blackout, max_command_delay, noise)
    if undegraded and any(given is not None for given in limits_given):
        raise typer.BadParameter(
            "--undegraded allows no --noise and no --max-...: leave one of them out"
        )
    if control is not None and (law not in (None, "certified") or engine == "flights"):
        raise typer.BadParameter(
            "--control stands in the place of the law certified in the attack; leave --law and --engine out"
        )
    flown, named = resolve(
        scenario,
        law="certified" if control is not None else law,
        duration=_FLIGHT if duration is None else duration,
        changes=changes,
    )
    check_code(flown, named, source=scenario, allowed=allow_code)
    check_own_functions(flown)
    certified = LAWS[flown.law.name].watched
    if (engine is not None or eps is not None) and not certified:
        raise typer.BadParameter("--engine and --eps are for the law certified")
    flies = control is None and engine != "attack"
    attacks = certified and (control is not None or engine != "flights")
    limits = SearchLimits()
    if not undegraded:
        limits = SearchLimits(
            delay=_DELAY if max_delay is None else max_delay,
            loss=_LOSS if max_loss is None else max_loss,
            blackout=_BLACKOUT if max_blackout is None else max_blackout,
            command_delay=_COMMAND_DELAY if max_command_delay is None else max_command_delay,
            noise=flown.detections.noise if noise is None else noise,
        )
    raised: tuple[str, ...] = ()
    if attacks and eps is not None:
        from outrider_falsify.attack_grid import EPS

        if eps not in EPS:
            raise typer.BadParameter(
                f"--eps {eps:g}: not in the attack's grid; allowed: {', '.join(f'{e:g}' for e in EPS)}"
            )
    if flies:
        require("falsify")
        given, flown = flown, base_of(flown, limits)
        if flown.hold > given.hold:
            raised = (
                f"hold = {given.hold:g} s is raised to {flown.hold:g} s, the latest command that the limits allow",
            )
    _check_out(out)
    wanted = Wanted(
        base=flown,
        limits=limits,
        flies=flies,
        attacks=attacks,
        runs=runs,
        minutes=_MINUTES if runs is None and minutes is None else minutes,
        attack_duration=duration or _ATTACK,
        seed=seed,
        jobs=jobs or cores(),
        first=first,
        control=None if control is None else str(control),
        eps=eps,
        out=out,
    )
    if flies:
        print_warnings((*raised, *beyond_declared(flown, limits)))
    _search(wanted, expect, json=json)


def _check_out(out: Path | None) -> None:
    """Raises if the file cannot be written: before the search, not after it."""
    if out is None:
        return
    if out.is_dir():
        raise typer.BadParameter(f"--out {out}: is a folder; allowed: a file")
    out.parent.mkdir(parents=True, exist_ok=True)


def _search(wanted: "Wanted", expect: Expect | None, *, json: bool) -> None:
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
    from outrider.running.user_code import foreign_code

    wanted, flights, attacks = found.wanted, found.flights, found.attacks
    law = (
        wanted.base.law.name
        if wanted.control is None
        else f"{wanted.control}, in the place of the filter"
    )
    rate = found.runs / found.seconds if found.seconds > 0.0 else 0.0
    much = f"{found.runs:,} runs in {found.seconds:.1f} s, {rate:.1f} runs/s"
    yield f"{law}: {found.violations:,} violations of r_v = {wanted.base.visibility.radius:g} m in {much}"
    if flights.runs:
        yield f"  flights: {flights.violations:,} of {flights.runs:,} lose sight; the farthest {flights.worst:.4f} m"
        if LAWS[wanted.base.law.name].watched:
            share = f"not every tick was certified in {flights.uncertified:,}"
            yield (
                f"    {share}; in {flights.lost - flights.violations:,} sight was lost after nothing was "
                "promised any more"
            )
            yield f"    certified while lost: {flights.certified_while_lost:,} ticks"
            yield f"    certificate lost while all assumptions held: {flights.certificate_broken:,} times"
    if attacks.worst is not None:
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
    if found.attack_again is not None and attacks.worst is not None:
        c = attacks.worst.conditions
        dark = f"motions lost for up to {c.outage:g} s, " if c.outage else ""
        dark += (
            f"blackouts up to {c.blackout_time:g} s, detections up to {c.latency:g} s and commands "
            f"{c.delay:g} s late"
        )
        yield f"  The worst attack: errors up to {attacks.worst.eps:g} m, {dark}. Again:"
        yield f"    {found.attack_again}"
    if found.path is not None:
        yield "  The worst flight:"
        yield from (f"    {line}" for line in found.words)
        yield f"  {found.path}"
        # the file names what the command has named
        code = " --allow-code" if foreign_code(wanted.base) else ""
        yield f"  outrider run {shlex.quote(str(found.path))} --in-process{code} flies it again: {found.sha256}"
