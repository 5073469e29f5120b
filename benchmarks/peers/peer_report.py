"""Output of the measurements: JSON, a table with comments, and a plot."""

from itertools import groupby
from pathlib import Path

import msgspec
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from outrider import style

OURS = "outrider"
"""Runner of our environment."""
CROWDED = 0.05
"""Share of the cores used by other programs above which a measurement is invalid: waiting threads stall."""
GROUPS = {True: "with a field", False: "without a field"}


def worlds_in_words(count: int) -> str:
    """Return a count such as "1 world"."""
    return f"{count} world" if count == 1 else f"{count} worlds"


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Measurement of one variant."""

    peer: str
    """Name of the runner."""
    name: str
    variant: str
    worlds: int
    agents: int
    field: bool
    steps_per_second: float
    """World-steps a second, the median of the repeats."""
    slowest: float
    fastest: float
    version: str
    others: float | None = None
    """Share of the cores that other programs used meanwhile; None where the system does not tell."""

    @property
    def label(self) -> str:
        """Return the name of the measurement."""
        return f"{self.name} {self.variant}, {self.agents} agents"


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """Measurement that failed."""

    what: str
    reason: str


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """Results of one run."""

    date: str
    cpu: str
    cores: int
    python: str
    seconds: float
    repeats: int
    rows: list[Row]
    failures: list[Failure]

    @property
    def conditions(self) -> str:
        """Return hardware and settings of the measurement."""
        repeats = "once" if self.repeats == 1 else f"median of {self.repeats}"
        return (
            f"{self.cpu}, {self.cores} cores, Python {self.python}, {self.date}; each row {self.seconds:g} s, "
            f"{repeats}"
        )


def crowded(report: Report) -> str:
    """Return a note about rows measured beside other load; empty without any."""
    shares = [row.others for row in report.rows if row.others is not None and row.others > CROWDED]
    if not shares:
        return ""
    rows = "one row" if len(shares) == 1 else f"{len(shares)} of {len(report.rows)} rows"
    return f"Not quiet: other programs used up to {100.0 * max(shares):.0f} % of the cores during {rows}."


def write(report: Report, out: Path) -> None:
    """Write peers.json, peers.md and peers.png.

    Raises:
        OSError: If a file cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    (out / "peers.json").write_bytes(
        msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n"
    )
    (out / "peers.md").write_text(markdown(report), encoding="utf-8")
    if report.rows:
        with style.plot_style():
            style.save(draw(report), out / "peers.png")


def _ordered(report: Report, field: bool) -> list[Row]:
    """Return the rows of a group: ours first, then the peers' in order of measurement."""
    return sorted(
        (row for row in report.rows if row.field == field), key=lambda row: row.peer != OURS
    )


def markdown(report: Report) -> str:
    """Return the table in two parts, with comments on faster peers."""
    lines = ["# World-steps per second", "", f"{report.conditions}.", ""]
    if warning := crowded(report):
        lines += [f"**{warning} Measure again.**", ""]
    for field, title in GROUPS.items():
        rows = _ordered(report, field)
        if not rows:
            continue
        lines += [f"## {title.capitalize()}", ""]
        lines += [
            "| package | task | agents | worlds | world-steps/s | slowest to fastest | cores used by others | version |"
        ]
        lines += ["|---|---|--:|--:|--:|--:|--:|---|"]
        lines += [
            f"| {row.name} | {row.variant} | {row.agents} | {row.worlds} | {row.steps_per_second:,.0f} "
            f"| {row.slowest:,.0f} to {row.fastest:,.0f} | {'?' if row.others is None else f'{row.others:.0%}'} | "
            f"{row.version} |"
            for row in rows
        ]
        lines += [""]
    if report.failures:
        lines += ["## Not measured", "", "| what | why |", "|---|---|"]
        lines += [
            f"| {failure.what} | {failure.reason.replace('|', chr(92) + '|')} |"
            for failure in report.failures
        ]
        lines += [""]
    if report.rows:
        lines += ["## Where a peer is faster", ""]
        lines += [f"- {sentence}" for sentence in where_faster(report)]
        lines += [""]
    return "\n".join(lines)


def where_faster(report: Report) -> list[str]:
    """Return sentences about peers faster than any of ours, for each number of worlds."""
    sentences: list[str] = []
    for worlds in sorted({row.worlds for row in report.rows}):
        compared = [row for row in report.rows if row.worlds == worlds]
        ours = [row for row in compared if row.peer == OURS]
        peers = [row for row in compared if row.peer != OURS]
        at = f"At {worlds_in_words(worlds)}"
        if not peers or not ours:
            sentences.append(
                f"{at} there is no {'peer' if ours else 'row of ours'} to compare with."
            )
            continue
        faster = [sentence for row in peers if (sentence := _faster(row, ours))]
        sentences += [f"{at} {sentence}" for sentence in faster] or [
            f"{at} no peer is faster than ours."
        ]
    return sentences


def _faster(row: Row, ours: list[Row]) -> str:
    """Return our rows that this peer beats, with the ratios; empty without any."""
    beaten = [
        f"{_times(row.steps_per_second / own.steps_per_second)} as fast as {own.name} {own.variant}"
        + (", within the spread of the repeats" if row.slowest <= own.fastest else "")
        for own in ours
        if row.steps_per_second > own.steps_per_second
    ]
    if not beaten:
        return ""
    rest = "" if row.field else ", without a field"
    return f"{row.label}{rest}, is {' and '.join(beaten)}."


def _times(ratio: float) -> str:
    digits = 2 if ratio < 1.1 else 1 if ratio < 10.0 else 0
    return f"{ratio:.{digits}f} times"


def draw(report: Report) -> Figure:
    """Plot a dot for each row on a logarithmic axis, with its number; ours in the UAV's blue."""
    groups = [(title, rows) for field, title in GROUPS.items() if (rows := _ordered(report, field))]
    figure = style.new_figure(1400, round(230 + 36 * (len(report.rows) + 1.5 * len(groups))))
    axes = figure.add_subplot()
    axes.set_xscale("log")
    y, ticks = 0.0, []
    for title, rows in groups:
        _at_left(axes, y, title.capitalize(), weight="bold")
        y += 1.0
        for _, block in groupby(rows, key=lambda row: row.label):
            for n, row in enumerate(block):
                _draw_row(axes, row, y, named=n == 0)
                ticks.append((y, worlds_in_words(row.worlds)))
                y += 1.0
        y += 0.5
    _dress(axes, report, ticks, y)
    return figure


def _at_left(axes: Axes, y: float, text: str, **font: str) -> None:
    """Write a text left of the number of worlds."""
    offset = {
        "xycoords": axes.get_yaxis_transform(),
        "xytext": (-76, 0),
        "textcoords": "offset points",
    }
    axes.annotate(text, (0.0, y), ha="right", va="center_baseline", **offset, **font)


def _draw_row(axes: Axes, row: Row, y: float, *, named: bool) -> None:
    color, ink = (style.UAV[0], style.UAV[0]) if row.peer == OURS else (style.MUTED, style.INK)
    axes.plot((row.slowest, row.fastest), (y, y), color=color, linewidth=2.4, alpha=0.45)
    axes.plot(
        row.steps_per_second,
        y,
        "o",
        color=color,
        markersize=6.5,
        markeredgecolor="white",
        markeredgewidth=0.8,
    )
    number = axes.annotate(
        f"{row.steps_per_second:,.0f}",
        (row.fastest, y),
        (7, 0),
        textcoords="offset points",
        color=ink,
    )
    covering = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}  # no line through a number
    number.set(va="center_baseline", bbox=covering)
    if named:
        _at_left(axes, y, row.label, color=ink)


def _dress(axes: Axes, report: Report, ticks: list[tuple[float, str]], end: float) -> None:
    slowest = min(row.slowest for row in report.rows)
    fastest = max(row.fastest for row in report.rows)
    axes.set_xlim(slowest / 2.0, fastest * 5.0)  # room for the last number
    axes.set_ylim(end - 0.5, -0.8)
    axes.xaxis.set_major_locator(LogLocator(10.0))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(which="minor", bottom=False)
    axes.set_yticks([y for y, _ in ticks], [words for _, words in ticks], va="center_baseline")
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(
        "world-steps per second, logarithmic"
        + ("; bar: range of the repeats" if report.repeats > 1 else "")
    )
    heading = "Speed of the environment on a CPU: Outrider and packages with other tasks"
    axes.figure.suptitle(heading, x=0.014, ha="left", weight="bold", size=11.0)
    below = "\n".join(filter(None, (report.conditions, crowded(report))))
    axes.figure.supxlabel(below, x=0.014, ha="left", size=8.0, color=style.MUTED)
