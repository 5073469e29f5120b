"""`outrider falsify`: search for runs that violate the visibility guarantee."""

import tempfile
from pathlib import Path

import typer

from bus.files import writing
from bus.registry import LAWS
from outrider.cli.options import AllowCode, Json, ScenarioName, Set
from outrider_falsify import options
from sim.compiling.threads import cores

_MINUTES = 1.0


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
    team: options.Team = False,
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

    With --team, the adversary attacks the guarantee of a team. It ends processes in the tick of an acceptance, blacks
    out the link between the UAVs while a scout is at the end of its leash, and asks for relief without need. The file
    of a counterexample contains these events: `outrider falsify FILE --team` repeats them.

    The exit code is 0 for any result unless --expect is given; 130 after Ctrl-C, which keeps the best result.

    Example: outrider falsify --law switching --limit none
    """
    _check_out(out)
    if minutes is None and runs is None:
        minutes = _MINUTES
    if team:
        if control is not None or error is not None or engine is not None or altitude:
            raise typer.BadParameter(
                "--team: excludes --engine, --control, --error and --altitude; leave them out"
            )
        from outrider_falsify.team import work as team_work  # noqa: PLC0415 - the compiler

        how = team_work.TeamOptions(
            law=law, limit=limit, duration=duration, changes=changes, allow_code=allow_code
        )
        budget = team_work.TeamBudget(
            runs=runs, minutes=minutes, seed=seed, jobs=jobs or cores(), out=out
        )
        team_work.run_command(scenario, how, budget, expect, json=json)
        return
    from outrider_falsify import work  # noqa: PLC0415 - the compiler
    from outrider_falsify.engines import SearchRequest  # noqa: PLC0415 - the compiler

    _check_control(control is not None, law, engine, altitude=altitude)
    flown = work.flown_scenario(
        scenario,
        law="certified" if control is not None else law,
        duration=options.FLIGHT if duration is None else duration,
        changes=changes,
        allow_code=allow_code,
    )
    certified = LAWS[flown.law.name].watched
    if (engine is not None or error is not None) and not certified:
        raise typer.BadParameter(
            f"law = {flown.law.name}: --engine and --error need the law certified"
        )
    flies = control is None and engine != "attack"
    attacks = certified and (control is not None or engine != "flights")
    limits = work.limits_of_search(limit, flown)
    work.check_error(error if attacks else None)
    wanted = SearchRequest(
        base=work.base_scenario(flown, limits) if flies else flown,
        limits=limits,
        flies=flies,
        attacks=attacks,
        runs=runs,
        minutes=minutes,
        attack_duration=duration or options.ATTACK,
        seed=seed,
        jobs=jobs or cores(),
        altitude=altitude,
        control=None if control is None else str(control),
        eps=error,
        out=out,
    )
    work.falsify(wanted, expect, json=json)


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
