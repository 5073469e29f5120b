"""Table of a run's summary in the terminal."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
from rich.table import Table
from rich.text import Text

from outrider.cli.console import OUT, print_table, printable
from outrider.running.metrics import CERTIFICATE, LINK, MISSION, RUN, TEAM, UAV, Metric
from outrider.running.summary import Summary

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
    if summary.team is not None:
        yield from _metrics(TEAM, summary.team)
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
