"""Terminal output: results on stdout, progress and warnings on stderr."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from sim.input.faults import one_line

if TYPE_CHECKING:
    from sim.scenario.types import Scenario  # the help of a command needs no compiler


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
def flight_progress(scenario: "Scenario", waiting: str) -> Iterator[FlightProgress]:
    """Show a progress bar of one flight on stderr."""
    columns = (
        TextColumn("{task.percentage:>3.0f} %", markup=False),
        TextColumn("{task.fields[seconds]:>7.1f} s simulated", markup=False),
        TimeRemainingColumn(),
    )
    with bar(*columns, stays=True) as progress:
        task = progress.add_task(waiting, total=scenario.ticks, seconds=0.0)
        yield FlightProgress(progress, task, scenario.dt)
