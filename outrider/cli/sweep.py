"""`outrider sweep`: runs of laws, degradations and seeds on all cores."""

import shlex
import sys
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bus.messages.base import MAX_SEED
from bus.plugins import require
from outrider.cli.console import ERR, OUT, print_json, print_warnings, runs_bar
from outrider.cli.options import AllowCode, Duration, Json, Set
from outrider.experiments.sweep.definition import Sweep, describe_sweep
from outrider.experiments.sweep.plan import SweepPlan, lay_out
from sim.compiling.threads import cores

if TYPE_CHECKING:
    from outrider.experiments.sweep.folder import SweepFolder


SweepName = Annotated[
    str,
    typer.Argument(help="Shipped sweep (network), shipped scenario, or TOML file of either."),
]
Laws = Annotated[
    list[str] | None,
    typer.Option("--law", help="Fly these comma-separated laws; default: the file's; repeatable."),
]
Vary = Annotated[
    list[str] | None,
    typer.Option(
        "--vary",
        metavar="FIELD=V,V",
        help="Vary a field over these values; several fields: all combinations.",
    ),
]
Seeds = Annotated[
    int | None,
    typer.Option(help="Fly each point with this many seeds.", min=1, max=1_000_000),
]
FirstSeed = Annotated[
    int | None, typer.Option(help="Set the first seed; default: 0.", min=0, max=MAX_SEED)
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Write or resume the results in this folder; default: sweeps/NAME.",
    ),
]
Jobs = Annotated[
    int | None, typer.Option(help="Set the number of workers; default: one per core.", min=1)
]
Dask = Annotated[
    str,
    typer.Option(
        "--dask",
        metavar="ADDRESS",
        help="Fly on the Dask cluster with this scheduler; needs the extra [dask].",
    ),
]
Fresh = Annotated[
    bool, typer.Option("--fresh", help="Delete the folder's results and start again.")
]


def command(
    sweep: SweepName = "network",
    law: Laws = None,
    vary: Vary = None,
    duration: Duration = None,
    changes: Set = None,
    allow_code: AllowCode = False,
    seeds: Seeds = None,
    first_seed: FirstSeed = None,
    out: Out = None,
    jobs: Jobs = None,
    dask: Dask = "",
    fresh: Fresh = False,
    json: Json = False,
) -> None:
    """Fly each law under each degradation with many seeds, on all cores.

    Each run becomes a row of a Parquet table. After an interruption, the same command resumes the sweep. A run that
    fails is a row with its error, and the command then exits with 1. `outrider report FOLDER` draws the results. Needs
    the extra [sweep].

    Example: outrider sweep escort --law linear,switching --vary links.detections.delay=0,0.5,1 --seeds 20 --out
    sweeps/delay
    """
    require("sweep")
    if dask:
        require("dask")
    from outrider.experiments.sweep.folder import SweepFolder  # noqa: PLC0415 - the extra [sweep]
    from outrider.experiments.sweep.running import open_cluster  # noqa: PLC0415 - the extra [sweep]

    if duration is not None:
        changes = [*(changes or ()), f"duration={duration!r}"]
    described, text = describe_sweep(
        sweep,
        laws=",".join(law or ()),
        vary=vary or (),
        changes=changes or (),
        seeds=seeds,
        first_seed=first_seed,
    )
    where = out or Path("sweeps") / Path(sweep).stem
    plan = _lay_out(described, (*(changes or ()), *(vary or ())), allow_code=allow_code)
    print_warnings(plan.warnings)
    began = time.monotonic()
    with SweepFolder(
        where,
        plan,
        command=shlex.join(["outrider", *sys.argv[1:]]),
        text=text,
        fresh=fresh,
        on_notice=_warn,
    ) as folder:
        before = len(folder.done)
        try:
            with open_cluster(dask, plan.version) if dask else nullcontext() as client:
                _fly(plan, folder, jobs, client)
        except (KeyboardInterrupt, SystemExit) as end:
            _interrupted(plan, folder, end)
        file = folder.finish()
    seconds = time.monotonic() - began
    flown = len(folder.done) - before + folder.failed
    counts: dict[str, Any] = {
        "sweep": sweep,
        "rows": folder.rows,
        "failed": folder.failed,
        "flown": flown,
        "seconds": round(seconds, 3),
        "runs_per_second": round(flown / seconds, 3) if seconds > 0.0 else 0.0,
        "file": str(file),
    }
    _print_results(counts, folder, where, json=json)


def _lay_out(sweep: Sweep, named: Sequence[str], *, allow_code: bool) -> SweepPlan:
    """Load all points, with a progress bar."""
    with runs_bar() as progress:
        task = progress.add_task("loading the points", total=None, note="")
        return lay_out(
            sweep,
            named=named,
            allow_code=allow_code,
            on_progress=lambda done, of: progress.update(task, completed=done, total=of),
        )


def _fly(plan: SweepPlan, folder: "SweepFolder", jobs: int | None, client: Any) -> None:  # noqa: ANN401 - an extra's type
    """Fly the missing runs, with a progress bar.

    The bar counts the estimated cost of the runs, so that the remaining time is right for ticks of any length.
    """
    from outrider.experiments.sweep.running import (  # noqa: PLC0415 - the extra [sweep]
        cost_of,
        fly_sweep,
    )

    workers = jobs or (sum(client.ncores().values()) if client is not None else cores())
    costs = [cost_of(point.scenario) for point in plan.points]
    done = folder.done
    kept = sum(costs[run // plan.sweep.seeds] for run in done)
    started, flown = time.monotonic(), 0
    with runs_bar(stays=True) as progress:
        bar = progress.add_task(
            "flying",
            total=sum(costs) * plan.sweep.seeds,
            completed=kept,
            note=f"{len(done):,} of {plan.runs:,} runs",
        )

        def show(results: list[dict[str, Any]]) -> None:
            nonlocal flown
            flown += len(results)
            rate = flown / (time.monotonic() - started)
            failed = f", {folder.failed} failed" if folder.failed else ""
            note = f"{folder.rows:,} of {plan.runs:,} runs, {rate:.1f} runs/s{failed}"
            progress.update(
                bar,
                advance=sum(costs[row["run"] // plan.sweep.seeds] for row in results),
                note=note,
            )

        fly_sweep(plan, folder, jobs=workers, client=client, on_results=show)


def _interrupted(
    plan: SweepPlan, folder: "SweepFolder", end: KeyboardInterrupt | SystemExit
) -> None:

    folder.count_rows()  # rows may be written, but not counted yet
    kept = f"{len(folder.done):,} of {plan.runs:,} runs are in {folder.path}"
    ERR.tell(f"outrider: interrupted; {kept}; run the same command to resume")
    raise typer.Exit(130 if isinstance(end, KeyboardInterrupt) else int(end.code or 0)) from end


def _print_results(
    counts: dict[str, Any], folder: "SweepFolder", where: Path, *, json: bool
) -> None:
    """Print the results of a sweep, and exit with 1 if a run failed."""
    from outrider.experiments.sweep.folder import (  # noqa: PLC0415 - the extra [sweep]
        read_head,
        read_results,
    )

    if json:
        print_json(counts)
    else:
        new = f"{counts['flown']:,} of them now in {counts['seconds']:.1f} s, {counts['runs_per_second']:.1f} runs/s"
        OUT.tell(
            f"{counts['rows']:,} runs, {new}; the UGV was out of sight in {folder.violated:,} runs"
        )
        OUT.tell(f"  {counts['file']}\n  draw them with outrider report {shlex.quote(str(where))}")
    if folder.failed:
        head = read_head(folder.path)
        errors = [] if head is None else read_results(folder.path, head.columns)["error"]
        reason = next((error for error in errors if error is not None), "")
        again = "run the same command to fly them again"
        ERR.tell(f"outrider: {folder.failed} of {counts['rows']:,} runs failed: {reason}; {again}")
        raise typer.Exit(1)


def _warn(line: str) -> None:
    print_warnings([line])
