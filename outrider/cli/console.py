"""Terminal output: results on stdout, progress and warnings on stderr."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from bus.files import writing
from outrider.cli.standard_files import STANDARD_OUTPUT, print_text
from outrider.running.metrics import CERTIFICATE, LINK, MISSION, RUN, UAV, Metric
from outrider.running.summary import Summary
from sim.input.faults import one_line
from sim.scenario.types import Scenario

TextRow = tuple[str | Text, str | Text]
"""Label and value."""
LINK_SHOWN = tuple(LINK[name] for name in ("delivery_ratio", "mean_age", "max_age"))
"""Metrics of a link in a run's table."""
UAV_SHOWN = (
    "max_distance",
    "mean_distance",
    "visibility_violations",
    "mean_error",
    "estimate_rmse",
    "certified_share",
)
"""Metrics of each UAV in a run's table, if there are several UAVs."""


def printable(text: str) -> str:
    """Escape all characters that cannot be printed, except line breaks."""
    return "\n".join(one_line(line) for line in text.split("\n"))


class PlainConsole(Console):
    """Console that prints paths, names and errors literally, without markup and emoji."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False, emoji=False)
        self._name = Path("standard error") if stderr else STANDARD_OUTPUT

    def print(self, *objects: Any, **options: Any) -> None:  # noqa: ANN401 - as in `Console`
        """Print like `Console.print`; a system error names the stream."""
        with writing(self._name):
            super().print(*objects, **options)

    def tell(self, text: str | Text) -> None:
        """Print a line of any length; the terminal wraps it."""
        self.print(printable(text) if isinstance(text, str) else text, soft_wrap=True)


ERR, OUT = PlainConsole(stderr=True), PlainConsole()


def print_starting() -> None:
    """Print on a terminal that the first start takes about 30 s."""
    if ERR.is_terminal:
        ERR.tell("starting (the first start compiles for about 30 s)")


def print_json(value: object) -> None:
    """Print a JSON object on stdout."""
    print_text(msgspec.json.format(msgspec.json.encode(value), indent=2).decode() + "\n")


def print_warnings(lines: Iterable[str]) -> None:
    """Print warnings about a valid scenario; lines that differ only in numbers are merged and counted."""
    alike: dict[str, list[str]] = {}
    for line in lines:
        alike.setdefault(re.sub(r"\d+", "0", line), []).append(line)
    for first, *others in alike.values():
        more = f" (and {len(others):,} similar warnings)" if others else ""
        ERR.tell(Text.assemble(("warning:", "yellow"), f" {printable(first)}{more}"))


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str | Text]],
    *,
    title: str = "",
    right: Collection[str] = (),
    whole: Collection[str] = (),
) -> None:
    """Print a table on stdout; it has a frame if it has a title.

    Args:
        headings: Headings of the columns.
        rows: Rows, with a cell for each column.
        title: Title above the table.
        right: Right-aligned columns.
        whole: Columns whose cells are not wrapped.
    """
    table = (
        Table(title=printable(title), title_justify="left")
        if title
        else Table(box=None, pad_edge=False, header_style="bold")
    )
    for heading in headings:
        table.add_column(
            heading,
            justify="right" if heading in right else "left",
            no_wrap=heading in whole,
            overflow="ellipsis" if heading in whole else "fold",
        )
    for row in rows:
        table.add_row(*(printable(cell) if isinstance(cell, str) else cell for cell in row))
    OUT.print(table)


class FlightProgress:
    """Progress bar of simulated time."""

    def __init__(self, progress: Progress, task: TaskID, dt: float) -> None:
        self._progress, self._task, self._dt = progress, task, dt

    def show(self, tick: int) -> None:
        """Show the current tick."""
        if tick:
            self._progress.update(
                self._task, description="flying", completed=tick, seconds=tick * self._dt
            )

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        ERR.tell(Text(printable(line), style="yellow"))


def bar(*columns: ProgressColumn, stays: bool = False, width: int = 40) -> Progress:
    """Return a progress bar on stderr, with a description before it and columns after it; hidden without a terminal.

    Args:
        columns: Columns after the bar.
        stays: True: leave the bar on the screen at the end.
        width: Width of the bar [characters].
    """
    what = TextColumn("{task.description}", style="bold", markup=False)
    filled = BarColumn(bar_width=width, complete_style="blue", finished_style="blue")
    return Progress(
        *(what, filled, *columns),
        console=ERR,
        transient=not stays,
        disable=not ERR.is_terminal,
    )


def runs_bar(*, stays: bool = False, width: int = 40) -> Progress:
    """Return a progress bar for many runs, with the field `note` and the remaining time; otherwise as `bar`."""
    left = TimeRemainingColumn(compact=True, elapsed_when_finished=True)
    note = TextColumn("{task.fields[note]}", markup=False)
    return bar(note, left, stays=stays, width=width)


@contextmanager
def share_progress(what: str) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar during work that reports its current step and the share done."""
    with Progress(console=ERR, transient=True, disable=not ERR.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda step, share: progress.update(task, description=step, completed=share)


@contextmanager
def flight_progress(scenario: Scenario, waiting: str) -> Iterator[FlightProgress]:
    """Show a progress bar of one flight on stderr."""
    columns = (
        TextColumn("{task.percentage:>3.0f} %", markup=False),
        TextColumn("{task.fields[seconds]:>7.1f} s simulated", markup=False),
        TimeRemainingColumn(),
    )
    with bar(*columns, stays=True) as progress:
        task = progress.add_task(waiting, total=scenario.ticks, seconds=0.0)
        yield FlightProgress(progress, task, scenario.dt)


def _style(metric: Metric, value: object) -> str:
    """Return the color of a value: green for the metric's goal."""
    if metric.goal is None or not isinstance(value, int | float):
        return ""
    if value == metric.goal:
        return "green"
    return "red" if metric.goal == 0.0 else "yellow"


def _shown(metric: Metric, value: object) -> Text:
    return Text(metric.text(value), style=_style(metric, value))


def _metrics(table: dict[str, Metric], struct: msgspec.Struct, *left_out: str) -> Iterator[TextRow]:
    """Yield the rows of metrics with a value; guaranteed metrics only if they contradict the guarantee."""
    for metric in table.values():
        value = getattr(struct, metric.name)
        if metric.name in left_out or value is None or (metric.guaranteed and value == metric.goal):
            continue
        text = _shown(metric, value)
        yield (
            (Text(metric.label, style="red"), text + ": contradicts the guarantee")
            if metric.guaranteed
            else (metric.label, text)
        )


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in counts.items() if count)


def _dicts(summary: Summary) -> Iterator[TextRow]:
    """Yield the rows of counts by reason, UGV, link, vehicle and process."""
    for why, count in summary.uncertified.items():
        yield "not certified", f"{count} ticks: {why.text}"
    for name, guarantee in (summary.mission.guarantees if summary.mission else {}).items():
        for reason, count in guarantee.uncertified.items():
            yield f"{name} not certified", f"{count} ticks: {reason}"
    for name, status in summary.links.items():
        if status.degraded and status.sent:
            parts = [f"{row.label} {row.text(getattr(status, row.name))}" for row in LINK_SHOWN]
            parts += [f"lost: {_counts(status.lost)}"] if any(status.lost.values()) else []
            yield f"link {name}", ", ".join(parts)
    for name, counts in summary.faults.items():
        yield f"faults of {name}", _counts(counts)
    if summary.telemetry_faults:
        yield "not sent to observers", _counts(summary.telemetry_faults)
    if summary.processes:
        yield "processes", ", ".join(f"{one.name} ({one.pid})" for one in summary.processes)


def _rows(summary: Summary) -> Iterator[TextRow]:
    """Yield all rows of the table."""
    cut = "" if summary.complete else " (cut short)"
    yield "flown", f"{summary.ticks * summary.dt:.2f} s in {summary.ticks} ticks{cut}"
    hidden = ["ticks", "complete", "deterministic", "trajectory_sha256"]
    hidden += [] if summary.realtime is not None else ["realtime_factor", "late_ticks"]
    hidden += [] if summary.law is not None else ["visibility_radius"]
    yield from _metrics(RUN, summary, *hidden)
    if summary.law is not None:
        yield from _metrics(UAV, summary)
    yield from _metrics(CERTIFICATE, summary)
    if (mission := summary.mission) is not None:
        yield from _metrics(MISSION, mission, *([] if mission.finds else ["finds", "found"]))
    for change in summary.changes:
        yield f"operator at {change.tick * summary.dt:.2f} s", change.control.in_words()
    yield from _dicts(summary)


def _print_uavs(summary: Summary) -> None:
    """Print a table with a row for each UAV."""
    shown = [(UAV | CERTIFICATE)[name] for name in UAV_SHOWN]
    rows: list[list[str | Text]] = [
        [name, *(_shown_number(metric, getattr(metrics, metric.name)) for metric in shown)]
        for name, metrics in summary.uavs.items()
    ]
    headings = [metric.heading for metric in shown]
    print_table(("UAV", *headings), rows, right=headings)


def _shown_number(metric: Metric, value: float | None) -> Text:
    return Text("-" if value is None else metric.number(value), style=_style(metric, value))


def print_summary(summary: Summary, files: list[Path]) -> None:
    """Print the summary of a run as a table, and the names of its files."""
    law = "no UAV" if summary.law is None else f"law {summary.law}"
    table = Table(
        title=f"{printable(summary.scenario)}, {law}, seed {summary.seed}",
        title_justify="left",
        show_header=False,
    )
    table.add_column(style="bold")
    table.add_column(justify="right")
    for row in _rows(summary):
        table.add_row(*(printable(cell) if isinstance(cell, str) else cell for cell in row))
    OUT.print(table)
    if len(summary.uavs) > 1:
        _print_uavs(summary)
    OUT.tell(f"  trajectory_sha256 {summary.trajectory_sha256}")
    if summary.secret:
        OUT.tell(f"  secret {summary.secret}: reproduces this run together with the seed")
    for file in files:
        OUT.tell(f"  {file}")
