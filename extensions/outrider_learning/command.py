"""`outrider suite`: the benchmark suite and its leaderboard."""

from typing import Annotated

import typer

from bus.policies import policy_forms
from outrider.cli.options import Json, Secret

_Law = Annotated[
    list[str] | None,
    typer.Option(
        "--law",
        help="Score these laws, comma-separated (repeatable); default: the baselines.",
    ),
]
_UavPolicy = Annotated[
    list[str] | None,
    typer.Option(
        "--uav-policy",
        metavar="POLICY",
        help=f"Score your own policy (repeatable): {policy_forms('uav')}.",
    ),
]
_Name = Annotated[
    str,
    typer.Option(
        "--suite",
        help="Select the suite: suite-v1 (coverage), missions-v1, towns-v1 or teams-v1.",
    ),
]
_Only = Annotated[list[str] | None, typer.Option(help="Run only this task (repeatable).")]
_Estimate = Annotated[
    bool,
    typer.Option(
        "--estimate",
        help="Give policies the estimate in place of the raw detection.",
    ),
]
_Gradient = Annotated[
    bool,
    typer.Option("--gradient", help="Add the coverage gradient to the policies' observations."),
]
_SafetyFilter = Annotated[
    bool, typer.Option("--safety-filter", help="Run policies inside the safety filter.")
]
_Seeds = Annotated[int, typer.Option(help="Use only this number of seeds.", min=1, max=20)]
_Markdown = Annotated[
    bool, typer.Option("--markdown", help="Print the table as Markdown on stdout.")
]
_ListTasks = Annotated[bool, typer.Option("--list", help="List the tasks and exit.")]


def command(
    law: _Law = None,
    uav_policy: _UavPolicy = None,
    name: _Name = "suite-v1",
    only: _Only = None,
    estimate: _Estimate = False,
    gradient: _Gradient = False,
    safety_filter: _SafetyFilter = False,
    seeds: _Seeds = 20,
    secret: Secret = "",
    markdown: _Markdown = False,
    list_tasks: _ListTasks = False,
    json: Json = False,
) -> None:
    """Score laws and policies on the benchmark's tasks.

    Each task runs with 20 seeds. The score is the covered share of the ground around the UGV, averaged over the
    episode, in percent. Ticks after the loss of sight score zero.

    In missions the score is 100 T*/T, times the share of finds, divided by one plus the number of hazards hit. T is the
    mission time, and T* the time along straight lines at full speed. A mission that does not arrive scores zero.
    Missions have one more baseline: 'none', a UGV without an escort.

    Example: outrider suite --law logarithmic,certified --only noise --only bursts
    Example: outrider suite --suite missions-v1 --seeds 3
    """
    from outrider_learning.work import (  # noqa: PLC0415 - the compiler
        print_board,
        print_tasks,
        score,
    )

    if list_tasks:
        print_tasks(name, only or [], json=json)
        return
    chosen = {"estimate": estimate, "gradient": gradient, "safety_filter": safety_filter}
    settings = {name: True for name, wanted in chosen.items() if wanted}
    if settings and not uav_policy:
        raise typer.BadParameter(
            f"--{'/'.join(settings).replace('_', '-')}: applies to policies only; allowed: with --uav-policy"
        )
    if markdown and json:
        raise typer.BadParameter(
            "--markdown and --json: both write to stdout; allowed: one of them"
        )
    laws = [one.strip() for one in ",".join(law or ()).split(",") if one.strip()]
    board = score(name, only or [], laws, uav_policy or [], settings, secret=secret, seeds=seeds)
    print_board(board, markdown=markdown, json=json)
