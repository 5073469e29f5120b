"""`outrider suite`: the benchmark suite and its leaderboard."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from bus.errors import OutriderError, ScenarioError, error_with_place
from bus.policies import policy_forms
from outrider.cli.options import Json, Secret
from outrider.cli.standard_files import print_text

if TYPE_CHECKING:
    from rich.text import Text

    from agents.laws.policy import UavPolicy
    from outrider_learning.suite.board import Leaderboard, Standing
    from outrider_learning.suite.scoring import Entry, Result
    from outrider_learning.suite.tasks import Suite
    from sim.env.observation import AgentObservation
    from sim.scenario.types import Scenario

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
        help="Select the suite: suite-v1 (coverage), missions-v1 (missions) or towns-v1 (buildings).",
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
    from outrider.cli.console import ERR, OUT, print_json
    from outrider_learning.suite.tasks import SUITES, suite

    if name not in SUITES:
        raise typer.BadParameter(f"--suite {name}: unknown suite; allowed: {', '.join(SUITES)}")
    tasks = _tasks(suite(name), only or [])
    if list_tasks:
        _print_tasks(tasks, json=json)
        return
    chosen = {"estimate": estimate, "gradient": gradient, "safety_filter": safety_filter}
    settings = {name: True for name, wanted in chosen.items() if wanted}
    laws = [one.strip() for one in ",".join(law or ()).split(",") if one.strip()]
    entries = _entries(laws, uav_policy or [], tasks)
    if settings and not uav_policy:
        raise typer.BadParameter(
            f"--{'/'.join(settings).replace('_', '-')}: applies to policies only; allowed: with --uav-policy"
        )
    if markdown and json:
        raise typer.BadParameter(
            "--markdown and --json: both write to stdout; allowed: one of them"
        )
    from outrider.cli.options import secret_of

    board = _fly(entries, tasks, settings, secret_of(secret, wanted=True), seeds)
    if json:
        print_json(board)
        return
    if markdown:
        print_text(board.markdown())
    else:
        OUT.print(_table(board))
    console = ERR if markdown else OUT
    console.tell(f"  secret {board.secret}: pass it with --secret to reproduce the scores")


def _tasks(whole: "Suite", only: list[str]) -> "Suite":
    from outrider_learning.suite.tasks import Suite
    from sim.input.faults import near

    unknown = [name for name in only if name not in whole.names]
    if unknown:
        meant = near(unknown[0], whole.names)
        raise ScenarioError(
            f"--only {unknown[0]}: unknown task{meant}; allowed: {', '.join(whole.names)}"
        )
    return Suite([task for task in whole if not only or task.name in only])


def _entries(laws: list[str], policies: list[str], tasks: "Suite") -> "dict[str, Entry]":
    from outrider.envs.closed_loop_pilots import pilot_names
    from outrider.running.user_code import load_policy
    from outrider_learning.suite.board import BASELINES, MISSION_BASELINES
    from outrider_learning.suite.tasks import NO_ESCORT

    allowed, baselines = pilot_names(tasks[0].scenario, "uav_0"), BASELINES
    if tasks[0].mission:
        allowed, baselines = (NO_ESCORT, *allowed), MISSION_BASELINES
    for law in laws:
        if law not in allowed:
            raise ScenarioError(
                f"law {law!r}: unknown; allowed: {', '.join(allowed)}, or --uav-policy"
            )
    entries: dict[str, Entry] = {law: law for law in laws or ([] if policies else baselines)}
    for name in policies:
        entries[name] = _UserPolicy(name, load_policy(name, what="--uav-policy"))
    return entries


class _UserPolicy:
    """Policy of the user's own that reports its errors in one line with its name; a copy has its own memory."""

    def __init__(self, name: str, policy: "UavPolicy") -> None:
        self._name, self._policy = name, policy
        self.setup = getattr(policy, "setup", {})

    def check(self, scenario: "Scenario") -> None:
        """Raise ScenarioError for a task that the policy does not support."""
        if not hasattr(self._policy, "check"):
            return
        try:
            self._policy.check(scenario)
        except ValueError as error:
            raise ScenarioError(f"--uav-policy {self._name}: {error}") from error

    def __call__(self, observation: "AgentObservation") -> Any:  # noqa: ANN401 - the environment checks the action
        try:
            return self._policy(observation)
        except Exception as error:
            raise OutriderError(f"--uav-policy {self._name}: {error_with_place(error)}") from error


def _fly(
    entries: "dict[str, Entry]",
    tasks: "Suite",
    settings: dict[str, Any],
    secret: str,
    seeds: int,
) -> "Leaderboard":
    from outrider.cli.console import share_progress
    from outrider_learning.suite.board import leaderboard
    from outrider_learning.suite.tasks import SEEDS

    with share_progress("compiling, then simulating") as show:
        try:
            return leaderboard(
                entries,
                tasks=tasks,
                seeds=SEEDS[:seeds],
                secret=secret,
                on_progress=show,
                **settings,
            )
        except ScenarioError:
            raise
        except ValueError as error:
            raise OutriderError(f"a policy cannot run: {error}") from error


def _table(board: "Leaderboard") -> Any:  # noqa: ANN401 - rich's
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from outrider_learning.suite.board import middle_cell

    measure = "Mission score" if board.mission else "Covered share of the ground"
    title = f"{measure} [%], mean of {len(board.standings[0].results[0].scores)} seeds"
    table = Table(
        title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    table.add_column("task", no_wrap=True)
    for standing in board.standings:
        table.add_column(standing.entry, justify="right")
    for k, task in enumerate(board.tasks):
        cells = (_cell(standing.results[k]) for standing in board.standings)
        table.add_row(task, *cells, end_section=k == len(board.tasks) - 1)
    table.add_row("mean", *map(_cell, board.standings), style="bold")
    table.add_row("interquartile mean", *map(middle_cell, board.standings), style="bold")
    return table


def _cell(result: "Result | Standing") -> "Text":
    from rich.text import Text

    score = f"{result.score:.1f}"
    return Text.assemble(score, (f"\n{result.lost} lost", "red")) if result.lost else Text(score)


def _print_tasks(tasks: "Suite", *, json: bool) -> None:
    from outrider.cli.console import print_json, print_table

    if json:
        listed = [{"name": task.name, "hard": task.hard, "env_id": task.env_id} for task in tasks]
        print_json({"tasks": listed})
        return
    rows = [(task.name, task.hard, task.env_id) for task in tasks]
    headings = ("task", "difficulty", "Gymnasium ID")
    print_table(headings, rows, title="Tasks of the suite", whole=("task",))
