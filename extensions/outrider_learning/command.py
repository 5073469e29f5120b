"""`outrider suite`: the benchmark suite, and the leaderboard of who has flown it."""

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
        help="Laws, between commas; by default the paper's and certified, in missions also 'none', a UGV without "
        "an escort; or no law beside a --uav-policy. May be repeated.",
    ),
]
_UavPolicy = Annotated[
    list[str] | None,
    typer.Option(
        "--uav-policy",
        metavar="POLICY",
        help="A policy of your own, a UAV's observations in all worlds in, its accelerations out, or a saved one, "
        f"with the observation that it was trained on: {policy_forms('uav')}; may be repeated.",
    ),
]
_Name = Annotated[
    str,
    typer.Option(
        "--suite",
        help="Which: suite-v1, scored by what was seen, or missions-v1, by how the UGV got through.",
    ),
]
_Only = Annotated[list[str] | None, typer.Option(help="Only this task; may be repeated.")]
_Estimate = Annotated[
    bool,
    typer.Option(
        "--estimate",
        help="Policies observe the filter's estimate in the place of the raw detection.",
    ),
]
_Gradient = Annotated[
    bool,
    typer.Option("--gradient", help="Policies observe the direction to new ground besides."),
]
_SafetyFilter = Annotated[
    bool, typer.Option("--safety-filter", help="Policies fly inside the safety filter.")
]
_Seeds = Annotated[int, typer.Option(help="Fly only the first so many seeds.", min=1, max=20)]
_Markdown = Annotated[
    bool, typer.Option("--markdown", help="Print the table as Markdown on stdout.")
]
_ListTasks = Annotated[
    bool, typer.Option("--list", help="Tell what the tasks are, and fly nothing.")
]


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
    """Score laws and policies over the benchmark's tasks.

    Each task is flown with 20 seeds. The score is the share of the ground around the UGV that was seen, averaged over
    the flight, in percent; from the tick at which sight is lost on, nothing counts as seen.

    In missions it is 100 T*/T of a flight that arrives in the time T, T* being that of straight ways, times the share
    of the things that were found, divided by 1 and the hazards that were run into.

    Example: outrider suite --law logarithmic,certified --only noise --only bursts
    Example: outrider suite --suite missions-v1 --seeds 3
    """
    from outrider.cli.console import ERR, OUT, print_json
    from outrider_learning.suite.tasks import SUITES, suite

    if name not in SUITES:
        raise typer.BadParameter(f"--suite {name}: no such suite; allowed: {', '.join(SUITES)}")
    tasks = _tasks(suite(name), only or [])
    if list_tasks:
        _tell_tasks(tasks, json=json)
        return
    chosen = {"estimate": estimate, "gradient": gradient, "safety_filter": safety_filter}
    settings = {name: True for name, wanted in chosen.items() if wanted}
    laws = [one.strip() for one in ",".join(law or ()).split(",") if one.strip()]
    entries = _entries(laws, uav_policy or [], tasks)
    if settings and not uav_policy:
        raise typer.BadParameter(
            f"--{'/'.join(settings).replace('_', '-')}: for a --uav-policy alone; the laws are as they are"
        )
    if markdown and json:
        raise typer.BadParameter("--markdown and --json both want stdout; choose one")
    from outrider.cli.options import secret_of

    board = _fly(entries, tasks, settings, secret_of(secret, wanted=True), seeds)
    if json:
        print_json(board)
        return
    if markdown:
        print_text(board.markdown())
    else:
        OUT.print(_table(board))
    told = ERR if markdown else OUT
    told.tell(f"  secret {board.secret}: with --secret the same scores again")


def _tasks(whole: "Suite", only: list[str]) -> "Suite":
    from outrider_learning.suite.tasks import Suite
    from sim.input.faults import near

    unknown = [name for name in only if name not in whole.names]
    if unknown:
        meant = near(unknown[0], whole.names)
        raise ScenarioError(
            f"--only {unknown[0]}: no such task{meant}; allowed: {', '.join(whole.names)}"
        )
    return Suite([task for task in whole if not only or task.name in only])


def _entries(laws: list[str], policies: list[str], tasks: "Suite") -> "dict[str, Entry]":
    from outrider.envs.pilot_numbers import pilot_names
    from outrider.running.user_code import load_uav_policy
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
        entries[name] = _Own(name, load_uav_policy(name, what="--uav-policy"))
    return entries


class _Own:
    """A policy of the user's own whose errors become one line that names it; a copy of it has a memory of its own."""

    def __init__(self, name: str, policy: "UavPolicy") -> None:
        self._name, self._policy = name, policy
        self.setup = getattr(policy, "setup", {})

    def check(self, scenario: "Scenario") -> None:
        """Refuse a task that it was not made for."""
        if not hasattr(self._policy, "check"):
            return
        try:
            self._policy.check(scenario)
        except ValueError as error:
            raise ScenarioError(f"--uav-policy {self._name}: {error}") from error

    def __call__(self, seen: "AgentObservation") -> Any:  # noqa: ANN401 - what it answers is checked where it flies
        try:
            return self._policy(seen)
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

    with share_progress("compiling, then flying") as show:
        try:
            return leaderboard(
                entries,
                tasks=tasks,
                seeds=SEEDS[:seeds],
                secret=secret,
                on_progress=show,
                **settings,
            )
        except ValueError as error:
            raise OutriderError(f"a policy cannot fly: {error}") from error


def _table(board: "Leaderboard") -> Any:  # noqa: ANN401 - rich's
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from outrider_learning.suite.board import middle_cell

    measure = "Mission score" if board.mission else "Seen of what there was to see"
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


def _cell(told: "Result | Standing") -> "Text":
    from rich.text import Text

    score = f"{told.score:.1f}"
    return Text.assemble(score, (f"\n{told.lost} lost", "red")) if told.lost else Text(score)


def _tell_tasks(tasks: "Suite", *, json: bool) -> None:
    from outrider.cli.console import print_json, print_table

    if json:
        told = [{"name": task.name, "hard": task.hard, "env_id": task.env_id} for task in tasks]
        print_json({"tasks": told})
        return
    rows = [(task.name, task.hard, task.env_id) for task in tasks]
    headings = ("task", "what is hard", "at Gymnasium")
    print_table(headings, rows, title="The tasks of the suite", whole=("task",))
