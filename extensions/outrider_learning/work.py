"""Work of `outrider suite`."""

from typing import Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from agents.laws.policy import UavPolicy
from bus.errors import OutriderError, ScenarioError, error_with_place
from outrider.cli.console import ERR, OUT, print_json, print_table, share_progress
from outrider.cli.run_secret import secret_of
from outrider.cli.standard_files import print_text
from outrider.closed_loop.pilots import pilot_names
from outrider.running.user_code import load_policy
from outrider_learning.suite.board import (
    BASELINES,
    MISSION_BASELINES,
    Leaderboard,
    Standing,
    leaderboard,
    middle_cell,
)
from outrider_learning.suite.scoring import Entry, Result
from outrider_learning.suite.tasks import NO_ESCORT, SEEDS, SUITES, Suite, suite
from sim.env.observation import AgentObservation
from sim.input.faults import near
from sim.scenario.types import Scenario


def _tasks(name: str, only: list[str]) -> Suite:
    """Return the tasks of a suite, or some of them by name.

    Raises:
        BadParameter: If the suite is unknown.
        ScenarioError: If a task is unknown.
    """
    if name not in SUITES:
        raise typer.BadParameter(f"--suite {name}: unknown suite; allowed: {', '.join(SUITES)}")
    whole = suite(name)
    unknown = [name for name in only if name not in whole.names]
    if unknown:
        meant = near(unknown[0], whole.names)
        raise ScenarioError(
            f"--only {unknown[0]}: unknown task{meant}; allowed: {', '.join(whole.names)}"
        )
    return Suite([task for task in whole if not only or task.name in only])


def _entries(laws: list[str], policies: list[str], tasks: Suite) -> dict[str, Entry]:
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

    def __init__(self, name: str, policy: UavPolicy) -> None:
        self._name, self._policy = name, policy
        self.setup = getattr(policy, "setup", {})

    def check(self, scenario: Scenario) -> None:
        """Raise ScenarioError for a task that the policy does not support."""
        if not hasattr(self._policy, "check"):
            return
        try:
            self._policy.check(scenario)
        except ValueError as error:
            raise ScenarioError(f"--uav-policy {self._name}: {error}") from error

    def __call__(self, observation: AgentObservation) -> Any:  # noqa: ANN401 - the environment checks the action
        try:
            return self._policy(observation)
        except Exception as error:
            raise OutriderError(f"--uav-policy {self._name}: {error_with_place(error)}") from error


def score(
    name: str,
    only: list[str],
    laws: list[str],
    policies: list[str],
    settings: dict[str, Any],
    *,
    secret: str,
    seeds: int,
) -> Leaderboard:
    """Score laws and policies on the tasks of a suite.

    Args:
        name: Name of the suite.
        only: Names of the tasks; none: all.
        laws: Names of laws; without laws and policies, the baselines.
        policies: Policies as in `--uav-policy`.
        settings: Settings of the policies' environments.
        secret: Secret as in `--secret`; empty: a new one.
        seeds: Number of seeds.

    Raises:
        ScenarioError: If a name is unknown.
        OutriderError: If a policy fails.
    """
    tasks = _tasks(name, only)
    entries = _entries(laws, policies, tasks)
    kept = secret_of(secret, wanted=True)
    with share_progress("compiling, then simulating") as show:
        try:
            return leaderboard(
                entries,
                tasks=tasks,
                seeds=SEEDS[:seeds],
                secret=kept,
                on_progress=show,
                **settings,
            )
        except ScenarioError:
            raise
        except ValueError as error:
            raise OutriderError(f"a policy cannot run: {error}") from error


def print_board(board: Leaderboard, *, markdown: bool, json: bool) -> None:
    """Print a leaderboard as a table, as Markdown or as JSON."""
    if json:
        print_json(board)
        return
    if markdown:
        print_text(board.markdown())
    else:
        OUT.print(_table(board))
    console = ERR if markdown else OUT
    console.tell(f"  secret {board.secret}: pass it with --secret to reproduce the scores")


def _table(board: Leaderboard) -> Table:
    measure = "Mission score" if board.mission else "Covered share of the ground"
    measure += " [%]" + (" and mean e(t)" if board.team else "")
    title = f"{measure}, mean of {len(board.standings[0].results[0].scores)} seeds"
    table = Table(
        title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    table.add_column("task", no_wrap=True)
    for standing in board.standings:
        table.add_column(standing.entry, justify="right")
    for k, task in enumerate(board.tasks):
        cells = (_cell(standing.results[k], error=board.team) for standing in board.standings)
        table.add_row(task, *cells, end_section=k == len(board.tasks) - 1)
    table.add_row("mean", *map(_cell, board.standings), style="bold")
    table.add_row("interquartile mean", *map(middle_cell, board.standings), style="bold")
    return table


def _cell(result: Result | Standing, *, error: bool = False) -> Text:
    score = f"{result.score:.1f}"
    if error and isinstance(result, Result):
        score += f"\n{result.mean_error:.1f} m²"
    return Text.assemble(score, (f"\n{result.lost} lost", "red")) if result.lost else Text(score)


def print_tasks(name: str, only: list[str], *, json: bool) -> None:
    """Print the tasks of a suite."""
    tasks = _tasks(name, only)
    if json:
        listed = [{"name": task.name, "hard": task.hard, "env_id": task.env_id} for task in tasks]
        print_json({"tasks": listed})
        return
    rows = [(task.name, task.hard, task.env_id) for task in tasks]
    headings = ("task", "difficulty", "Gymnasium ID")
    print_table(headings, rows, title="Tasks of the suite", whole=("task",))
