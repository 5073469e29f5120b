"""Output on the terminal: results on stdout, everything on the way on stderr."""

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
"""A label and a value."""
LINK_SHOWN = tuple(LINK[name] for name in ("delivery_ratio", "mean_age", "max_age"))
"""Metrics of a link that the table of a run shows."""
UAV_SHOWN = (
    "max_distance",
    "mean_distance",
    "visibility_violations",
    "mean_error",
    "estimate_rmse",
    "certified_share",
)
"""Metrics of each UAV that the table of a run shows, where there are several."""


def printable(text: str) -> str:
    """Return a text in which everything but line breaks is escaped that does not print."""
    return "\n".join(one_line(line) for line in text.split("\n"))


class PlainConsole(Console):
    """A console on which nothing that comes from outside (paths, names, errors) is markup or an emoji."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False, emoji=False)
        self._name = Path("standard error") if stderr else STANDARD_OUTPUT

    def print(self, *objects: Any, **options: Any) -> None:  # noqa: ANN401 - as of `Console`
        """Print as `Console.print`; an error of the system names the stream."""
        with writing(self._name):
            super().print(*objects, **options)

    def tell(self, text: str | Text) -> None:
        """Print a line, however long: where it is too long for the window, the terminal breaks it."""
        self.print(printable(text) if isinstance(text, str) else text, soft_wrap=True)


ERR, OUT = PlainConsole(stderr=True), PlainConsole()


def tell_starting() -> None:
    """Say on a terminal that the first start takes its time."""
    if ERR.is_terminal:
        ERR.tell("starting (the first start compiles for some 30 s)")


def print_json(value: object) -> None:
    """One JSON object on stdout."""
    print_text(msgspec.json.format(msgspec.json.encode(value), indent=2).decode() + "\n")


def print_warnings(lines: Iterable[str]) -> None:
    """Prints warnings of what can be flown but will not do what one may expect.

    Lines that differ in numbers alone are one, with their count.
    """
    alike: dict[str, list[str]] = {}
    for line in lines:
        alike.setdefault(re.sub(r"\d+", "0", line), []).append(line)
    for first, *others in alike.values():
        more = f" (and {len(others):,} more like it)" if others else ""
        ERR.tell(Text.assemble(("warning:", "yellow"), f" {printable(first)}{more}"))


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str | Text]],
    *,
    title: str = "",
    right: Collection[str] = (),
    whole: Collection[str] = (),
) -> None:
    """A table on stdout; it has lines if it has a title.

    Args:
        headings: Of its columns.
        rows: A cell for each of them.
        title: Above it.
        right: The columns of numbers.
        whole: Those that are never broken.
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
    """A bar that fills with simulated time."""

    def __init__(self, progress: Progress, task: TaskID, dt: float) -> None:
        self._progress, self._task, self._dt = progress, task, dt

    def show(self, tick: int) -> None:
        """The flight has come to this tick."""
        if tick:
            self._progress.update(
                self._task, description="flying", completed=tick, seconds=tick * self._dt
            )

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        ERR.tell(Text(printable(line), style="yellow"))


def bar(*told: ProgressColumn, stays: bool = False, width: int = 40) -> Progress:
    """A bar on stderr, if that is a terminal: what is done, how much of it, and what is told behind it.

    Args:
        told: The columns behind it.
        stays: Whether it is left there in the end.
        width: Of the bar [characters].
    """
    what = TextColumn("{task.description}", style="bold", markup=False)
    filled = BarColumn(bar_width=width, complete_style="blue", finished_style="blue")
    return Progress(
        *(what, filled, *told),
        console=ERR,
        transient=not stays,
        disable=not ERR.is_terminal,
    )


def runs_bar(*, stays: bool = False, width: int = 40) -> Progress:
    """A bar for many runs, with the field `note` and the time left behind it; otherwise as `bar`."""
    left = TimeRemainingColumn(compact=True, elapsed_when_finished=True)
    note = TextColumn("{task.fields[note]}", markup=False)
    return bar(note, left, stays=stays, width=width)


@contextmanager
def share_progress(what: str) -> Iterator[Callable[[str, float], None]]:
    """A bar for work that tells what it does and which share of it all is done; gone afterwards."""
    with Progress(console=ERR, transient=True, disable=not ERR.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda told, share: progress.update(task, description=told, completed=share)


@contextmanager
def flight_progress(scenario: Scenario, waiting: str) -> Iterator[FlightProgress]:
    """A progress bar for one flight, on stderr."""
    columns = (
        TextColumn("{task.percentage:>3.0f} %", markup=False),
        TextColumn("{task.fields[seconds]:>7.1f} s simulated", markup=False),
        TimeRemainingColumn(),
    )
    with bar(*columns, stays=True) as progress:
        task = progress.add_task(waiting, total=scenario.ticks, seconds=0.0)
        yield FlightProgress(progress, task, scenario.dt)


def _style(metric: Metric, value: object) -> str:
    """Return the color of a value: green if it is as it should be."""
    if metric.goal is None or not isinstance(value, int | float):
        return ""
    if value == metric.goal:
        return "green"
    return "red" if metric.goal == 0.0 else "yellow"


def _shown(metric: Metric, value: object) -> Text:
    return Text(metric.text(value), style=_style(metric, value))


def _metrics(table: dict[str, Metric], struct: msgspec.Struct, *left_out: str) -> Iterator[TextRow]:
    """Rows of a table's metrics that exist; of those that are guaranteed only what contradicts that."""
    for metric in table.values():
        value = getattr(struct, metric.name)
        if metric.name in left_out or value is None or (metric.guaranteed and value == metric.goal):
            continue
        text = _shown(metric, value)
        yield (
            (Text(metric.label, style="red"), text + ": the certificate is wrong")
            if (metric.guaranteed)
            else (metric.label, text)
        )


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in counts.items() if count)


def _dicts(summary: Summary) -> Iterator[TextRow]:
    """Rows of what is counted by reason, UGV, link, vehicle or process."""
    for why, count in summary.uncertified.items():
        yield "not certified", f"{count} ticks: {why.text}"
    for name, told in (summary.mission.guarantees if summary.mission else {}).items():
        for reason, count in told.uncertified.items():
            yield f"{name} not certified", f"{count} ticks: {reason}"
    for name, status in summary.links.items():
        if status.degraded and status.sent:
            parts = [f"{row.label} {row.text(getattr(status, row.name))}" for row in LINK_SHOWN]
            parts += [f"lost: {_counts(status.lost)}"] if any(status.lost.values()) else []
            yield f"link {name}", ", ".join(parts)
    for name, counts in summary.faults.items():
        yield f"faults of {name}", _counts(counts)
    if summary.processes:
        yield "processes", ", ".join(f"{one.name} ({one.pid})" for one in summary.processes)


def _rows(summary: Summary) -> Iterator[TextRow]:
    """All rows of the table."""
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
    """Print a row for each UAV."""
    shown = [(UAV | CERTIFICATE)[name] for name in UAV_SHOWN]
    rows: list[list[str | Text]] = [
        [name, *(_shown_number(metric, getattr(told, metric.name)) for metric in shown)]
        for name, told in summary.uavs.items()
    ]
    headings = [metric.heading for metric in shown]
    print_table(("UAV", *headings), rows, right=headings)


def _shown_number(metric: Metric, value: float | None) -> Text:
    return Text("-" if value is None else metric.number(value), style=_style(metric, value))


def print_summary(summary: Summary, files: list[Path]) -> None:
    """The table that a run ends with."""
    told = "no UAV" if summary.law is None else f"law {summary.law}"
    table = Table(
        title=f"{printable(summary.scenario)}, {told}, seed {summary.seed}",
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
        OUT.tell(f"  secret {summary.secret}: with it and the seed the same flight again")
    for file in files:
        OUT.tell(f"  {file}")
