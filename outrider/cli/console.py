"""Output on the terminal: results on stdout, everything on the way on stderr."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
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
from bus.messages import LinkStatus
from outrider.cli.standard_files import STANDARD_OUTPUT, print_text
from outrider.running.summary import Summary
from sim.input.faults import one_line
from sim.scenario.types import Scenario


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


def _meters(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f} m"


def _link(status: LinkStatus) -> str:
    lost = ", ".join(f"{cause} {count}" for cause, count in status.lost.items() if count)
    ratio = "-" if status.delivery_ratio is None else f"{100.0 * status.delivery_ratio:.1f} %"
    age = (
        "-"
        if status.mean_age is None
        else f"{status.mean_age:.2f} s (at most {status.max_age:.2f} s)"
    )
    return f"{ratio} of {status.sent} arrived, age {age}" + (f"; lost: {lost}" if lost else "")


def _mission(summary: Summary) -> Iterator[tuple[str | Text, str | Text]]:
    """Rows about the UGVs' way through ground with hazards."""
    still = f", stood still for {summary.still_time:.1f} s"
    if summary.mission_time is not None:
        yield "at the goals", Text(f"after {summary.mission_time:.1f} s", style="green") + still
    else:
        yield "at the goals", Text("not yet", style="yellow") + still
    hit, near = summary.hazards_hit or 0, summary.near_misses or 0
    yield (
        "hazards hit",
        Text.assemble((f"{hit}", "red" if hit else "green"), f", nearly hit {near}"),
    )
    way = f"{summary.hazards_on_way}, known in time {summary.warned}"
    if summary.warned_before is not None:
        way += f", {summary.warned_before:.1f} s before in the mean"
    yield "hazards on the way", way
    if summary.seen_ahead is not None:
        yield "way seen ahead", f"{100.0 * summary.seen_ahead:.0f} %"
    for name, told in summary.guarantees.items():
        if told.ticks:
            yield (
                f"{name} on known ground",
                Text.assemble(
                    f"certified {100.0 * told.certified / told.ticks:.2f} % of the ticks, left it in ",
                    (
                        f"{told.entered_unknown_tile}",
                        "red" if told.entered_unknown_tile else "green",
                    ),
                    f", broken {told.certificate_broken} times" if told.certificate_broken else "",
                ),
            )
    if summary.finds:
        yield "found", f"{summary.found} of {summary.finds}"


def _escort(summary: Summary) -> Iterator[tuple[str, str | Text]]:
    """Rows about the UAVs."""
    lost = summary.visibility_violations
    yield (
        "UGV in sight (5)",
        Text("nothing was flown", style="yellow")
        if not summary.ticks
        else Text(f"lost in {lost} ticks", style="red")
        if lost
        else Text("always", style="green"),
    )
    farthest = _meters(summary.max_distance)
    yield "largest distance", f"{farthest} of r_v = {summary.visibility_radius:g} m"
    yield "mean distance", _meters(summary.mean_distance)
    r_s = _meters(summary.switching_radius)
    yield "switching radius r_s (18)", f"{r_s}, reached {summary.crossings} times"
    errors = summary.initial_error, summary.mean_error, summary.final_error
    start, mean, end = ("-" if one is None else f"{one:.1f}" for one in errors)
    yield "coverage error e (4)", f"start {start}, mean {mean}, end {end} m²"
    yield "RMS error of the estimate", _meters(summary.estimate_rmse)
    yield "RMS error of the detections", _meters(summary.detection_rmse)


def _certificate(summary: Summary) -> Iterator[tuple[str, str | Text]]:
    """Rows about what was certified, and what it stands on."""
    if summary.certified_share is not None:
        share = f"{100.0 * summary.certified_share:.2f} % of the ticks"
        acted = f", filter acted in {100.0 * (summary.intervened_share or 0.0):.1f} %"
        yield "sight certified", _judged(share, summary.certified_share == 1.0) + acted
    if summary.longest_outage is not None and summary.declared_outage is not None:
        longest, most = summary.longest_outage, summary.declared_outage
        waited = _judged(f"{longest:.2f} s", longest <= most) + f", declared {most:g} s"
        yield "longest wait for a motion", waited
    if summary.tracking_error is not None:
        off, bound = f"{summary.tracking_error:.3f} m", summary.declared_tracking
        farthest = Text(f"{off} from where it is told")
        if bound is not None:
            farthest = _judged(off, summary.tracking_error <= bound) + f", declared {bound:.3f} m"
        yield "farthest off by the wind", farthest


def _judged(text: str, good: bool) -> Text:
    return Text.assemble((text, "green" if good else "yellow"))


def _rows(summary: Summary) -> Iterator[tuple[str | Text, str | Text]]:
    """All rows of the table."""
    cut = "" if summary.complete else " (cut short)"
    yield "flown", f"{summary.ticks * summary.dt:.2f} s in {summary.ticks} ticks{cut}"
    yield "speed", f"{summary.ticks_per_second:,.0f} ticks/s"
    if summary.law is not None:
        yield from _escort(summary)
    if summary.realtime is not None:
        kept = f"{summary.realtime_factor:.3f} of {summary.realtime:g}"
        yield "real time", f"{kept}, {summary.late_ticks} ticks late"
    for change in summary.changes:
        yield f"operator at {change.tick * summary.dt:.2f} s", change.control.in_words()
    yield from _certificate(summary)
    if summary.hazards_hit is not None:
        yield from _mission(summary)
    for what, wrong in (
        ("certified while lost", f"{summary.certified_while_lost} ticks"),
        (
            "certificate broken",
            f"{summary.certificate_broken} times, although all assumptions held",
        ),
    ):
        if getattr(summary, what.replace(" ", "_")):
            told = f"{wrong}: the certificate is wrong"
            yield Text(what, style="red"), Text(told, style="red")
    for reason, count in summary.uncertified.items():
        yield "not certified", f"{count} ticks: {reason}"
    for name, status in summary.links.items():
        if status.degraded:
            yield f"link {name}", _link(status)
    for name, counts in summary.faults.items():
        yield f"faults of {name}", ", ".join(f"{cause} {count}" for cause, count in counts.items())
    if summary.processes:
        yield "processes", ", ".join(f"{one.name} ({one.pid})" for one in summary.processes)


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
    OUT.tell(f"  trajectory_sha256 {summary.trajectory_sha256}")
    if summary.secret:
        OUT.tell(f"  secret {summary.secret}: with it and the seed the same flight again")
    for file in files:
        OUT.tell(f"  {file}")
