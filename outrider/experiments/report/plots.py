"""Pictures of the report: violations, margins, coverage errors and ages of information."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median, quantiles

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from outrider import style
from outrider.experiments.intervals import mean_interval
from outrider.experiments.report.labels import tick_of
from outrider.experiments.report.results import Material, Panel

_KINDS = {"detections": (style.UAV[0], "o"), "commands": (style.UGV[0], "s")}
"""Color and marker of the links."""
_UNEVEN = 6.0
"""Ratio of the range to the smallest gap, beyond which values are placed at equal distances."""
MOST_PANELS = 24
"""Largest number of panels; the tables contain all."""
_PANEL = (520, 400)
"""Size of a panel [px]."""
_HEADER, _KEY_LINE = 84, 24
"""Height of the header, and of each further line of the legend [px]."""
_KEYS_A_LINE = 6
_MOST_LETTERS = 40
"""Total length of horizontal labels below a panel; longer labels are rotated."""

Draw = Callable[[Axes, Panel, "list[float]", float], None]


def positions(panel: Panel) -> tuple[list[float], float]:
    """Return the positions of the values on the axis, and the smallest gap between two."""
    values = panel.values
    if panel.ordered and len(values) > 1:
        numbers = [float(value) for value in values]
        gap = min(b - a for a, b in pairwise(numbers))
        if gap > 0.0 and (numbers[-1] - numbers[0]) / gap <= _UNEVEN:
            return numbers, gap
    return [float(k) for k in range(len(values))], 1.0


def _dress(axes: Axes, panel: Panel, where: list[float], gap: float) -> None:
    axes.set_title(style.plain(panel.title))
    axes.set_xlabel(style.plain(panel.label))
    axes.set_xlim(where[0] - 0.6 * gap, where[-1] + 0.6 * gap)
    labels = [""]
    if panel.field:
        labels = [style.plain(tick_of(panel.field, value)) for value in panel.values]
    drawn: list[float] = []
    for k, x in enumerate(where):  # leave out labels that would overlap
        if drawn and x - drawn[-1] < (where[-1] - where[0]) / 11.0:
            labels[k] = ""
        else:
            drawn.append(x)
    crowded = not panel.ordered and sum(len(label) + 2 for label in labels) > _MOST_LETTERS
    axes.set_xticks(where, labels, rotation=20 if crowded else 0)
    axes.grid(visible=False, axis="x")


def _laws_aside(
    panel: Panel, where: list[float], gap: float
) -> Iterator[tuple[str, str, list[float]]]:
    """Yield each law, its color, and positions of its marks beside the values, so that no mark hides another."""
    for number, law in enumerate(panel.laws):
        aside = gap * 0.62 * ((number + 0.5) / len(panel.laws) - 0.5)
        yield law, style.law_color(law), [x + aside for x in where]


def _sheet(
    material: Material,
    title: str,
    label: str,
    draw: Draw,
    keys: Sequence[Line2D | Patch],
) -> Figure:
    """Draw a picture with a panel for each experiment and a common vertical axis."""
    panels = material.panels[:MOST_PANELS]
    columns = min(len(panels), 2 if len(panels) in (2, 4) else 3)
    rows = math.ceil(len(panels) / columns)
    header = _HEADER + _KEY_LINE * (math.ceil(len(keys) / _KEYS_A_LINE) - 1)
    height = _PANEL[1] * rows + header
    figure = style.new_figure(max(1040, _PANEL[0] * columns), height, header=header / height)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for k, axes in enumerate(grid.flat):
        if k >= len(panels):
            axes.set_visible(False)
            continue
        where, gap = positions(panels[k])
        draw(axes, panels[k], where, gap)
        _dress(axes, panels[k], where, gap)
        axes.yaxis.set_tick_params(labelleft=True)
        if k % columns == 0:
            axes.set_ylabel(label)
    style.heading(figure, title, 1.0 - 14.0 / height, 12.0)
    figure.legend(
        handles=list(keys),
        loc="upper left",
        ncols=min(len(keys), _KEYS_A_LINE),
        bbox_to_anchor=(0.004, 1.0 - 36.0 / height),
    )
    return figure


def _law_keys(material: Material) -> list[Line2D | Patch]:
    return [
        style.key(style.law_color(law), law, marker=style.law_mark(law), markersize=5)
        for law in material.law
    ]


def violations(material: Material) -> Figure:
    """Draw the share of runs that lost sight of the UGV, with Wilson's 95 % interval."""

    def draw(axes: Axes, panel: Panel, where: list[float], gap: float) -> None:
        for law, color, xs in _laws_aside(panel, where, gap):
            rates = [panel.cell(law, value).rate() for value in panel.values]
            found = [(x, *rate) for x, rate in zip(xs, rates, strict=True) if rate is not None]
            if not found:
                continue
            x, share, low, high = zip(*found, strict=True)
            if panel.ordered:
                axes.plot(x, share, color=color, linewidth=1.0, alpha=0.45)
            axes.plot([x, x], [low, high], color=color, linewidth=2.2, alpha=0.5)
            axes.plot(
                x,
                share,
                color=color,
                linestyle="",
                marker=style.law_mark(law),
                markersize=4.5,
                clip_on=False,
                zorder=4,
            )
        axes.set_ylim(0.0, 1.0)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))

    keys = [
        *_law_keys(material),
        style.key(style.MUTED, "95 % interval (Wilson)", linewidth=2.2, alpha=0.6),
    ]
    return _sheet(
        material, "Share of runs that lost sight of the UGV", "runs with a violation", draw, keys
    )


def margins(material: Material) -> Figure:
    """Draw the distribution of r_v minus the largest distance: range, interquartile range and median of the runs."""
    everything = [margin for cell in material.cells for margin in cell.numbers("margin")]
    highest = max([*everything, 0.5])
    # beyond r_v, the distance matters little
    lowest = max(min([*everything, 0.0]), -highest) - 0.1 * highest

    def draw(axes: Axes, panel: Panel, where: list[float], gap: float) -> None:
        axes.axhline(0.0, color=style.LIMIT, linewidth=1.3, zorder=1.5)
        axes.set_ylim(lowest, 1.08 * highest)
        width = 2.0 + 16.0 / (len(panel.laws) * len(panel.values))
        for law, color, xs in _laws_aside(panel, where, gap):
            for x, value in zip(xs, panel.values, strict=True):
                found = panel.cell(law, value).numbers("margin")
                if not found:
                    continue
                low, high = (
                    (found[0], found[0])
                    if len(found) == 1
                    else quantiles(found, n=4, method="inclusive")[::2]
                )
                axes.plot([x, x], [min(found), max(found)], color=color, linewidth=1.0)
                axes.plot(
                    [x, x],
                    [low, high],
                    color=color,
                    linewidth=width,
                    alpha=0.75,
                    solid_capstyle="butt",
                )
                axes.plot(
                    x,
                    median(found),
                    "o",
                    color="white",
                    markeredgecolor=color,
                    markersize=3.6,
                    zorder=4,
                )
                if min(found) < lowest:
                    axes.plot(x, lowest, "v", color=color, markersize=5.0, zorder=4, clip_on=False)

    bar = [style.key(style.law_color(law), law, linewidth=5, alpha=0.75) for law in material.law]
    keys = [
        *bar,
        style.key(
            style.MUTED, "median", marker="o", markerfacecolor="white", markersize=4, linestyle=""
        ),
        style.key(style.MUTED, "interquartile range", linewidth=5, alpha=0.6),
        style.key(style.MUTED, "all runs", linewidth=1.0),
        style.key(style.LIMIT, "below: out of sight"),
        style.key(style.MUTED, "below the picture", marker="v", markersize=5, linestyle=""),
    ]
    return _sheet(material, "Smallest margin of a run", "margin [m]", draw, keys)


def _band(
    axes: Axes, panel: Panel, xs: list[float], found: list[list[float]], color: str, mark: str
) -> None:
    """Draw means with their 95 % interval, as a band for ordered values and as bars otherwise.

    Values without numbers are left out.
    """
    points = [(x, *mean_interval(numbers)) for x, numbers in zip(xs, found, strict=True) if numbers]
    if not points:
        return
    x, mean, low, high = zip(*points, strict=True)
    if len(points) > 1 and panel.ordered:
        axes.fill_between(x, low, high, color=color, alpha=0.18, linewidth=0.0)
        axes.plot(x, mean, color=color, marker=mark, markersize=4.0, clip_on=False)
        return
    axes.vlines(x, low, high, color=color, linewidth=2.2, alpha=0.5)
    axes.plot(x, mean, color=color, marker=mark, markersize=4.0, linestyle="", clip_on=False)


def errors(material: Material) -> Figure:
    """Draw the coverage error e(t), eq. (4), averaged over time and runs."""
    means = [fmean(found) for cell in material.cells if (found := cell.numbers("mean_error"))]
    top = 1.25 * max([*means, 1.0])

    def draw(axes: Axes, panel: Panel, where: list[float], gap: float) -> None:
        for law, color, xs in _laws_aside(panel, where, gap):
            found = [panel.cell(law, value).numbers("mean_error") for value in panel.values]
            _band(axes, panel, where if panel.ordered else xs, found, color, style.law_mark(law))
        axes.set_ylim(0.0, top)

    keys = [
        *_law_keys(material),
        Patch(color=style.MUTED, alpha=0.25, linewidth=0, label="95 % interval of the mean"),
    ]
    return _sheet(
        material,
        "Coverage error around the UGV, mean over the run",
        "mean e(t) [m²]",
        draw,
        keys,
    )


def ages(material: Material) -> Figure | None:
    """Draw the age of information of the links over all laws; None if no run has recorded it."""
    cells = material.cells
    kinds = {
        kind: style_of
        for kind, style_of in _KINDS.items()
        if any(cell.numbers(f"{kind}_mean_age") for cell in cells)
    }
    if not kinds:
        return None
    top = 1.2 * max(
        1.0, *(age for cell in cells for kind in kinds for age in cell.numbers(f"{kind}_max_age"))
    )

    def draw(axes: Axes, panel: Panel, where: list[float], gap: float) -> None:
        for number, (kind, (color, mark)) in enumerate(kinds.items()):
            aside = 0.0 if panel.ordered else 0.3 * gap * (number - 0.5)
            places = [x + aside for x in where]
            means, most = (
                [panel.numbers(value, f"{kind}_{column}") for value in panel.values]
                for column in ("mean_age", "max_age")
            )
            _band(axes, panel, places, means, color, mark)
            points = [(x, max(ages)) for x, ages in zip(places, most, strict=True) if ages]
            joined = panel.ordered and len(points) > 1
            axes.plot(
                *zip(*points, strict=True),
                color=color,
                linewidth=1.2,
                linestyle=":" if joined else "",
                marker="" if joined else "_",
            )
        axes.set_yscale("symlog", linthresh=0.1, linscale=0.4)
        axes.set_yticks([0.0, 0.1, 1.0, 10.0, 100.0], ["0", "0.1", "1", "10", "100"])
        axes.set_ylim(0.0, top)
        axes.minorticks_off()

    keys: list[Line2D | Patch] = [
        *(
            style.key(color, kind, marker=mark, markersize=4)
            for kind, (color, mark) in kinds.items()
        ),
        style.key(style.MUTED, "mean"),
        style.key(style.MUTED, "oldest of all runs", linestyle=":"),
    ]
    return _sheet(
        material,
        "Age of information: age of the newest message delivered",
        "age [s]",
        draw,
        keys,
    )


CAPTIONS = {
    "violations": "Share of the runs in which the distance reached r_v at least once. Marks: measured share; bars: "
    "Wilson's 95 % interval. Marks are placed beside their value, so that no mark hides another.",
    "margins": "Margin to r_v of the runs. Thin line: range of all runs; thick bar: interquartile range; white "
    "dot: median. Below the red line the UGV was out of sight. A triangle marks values below the picture.",
    "errors": "e(t) of equation (4), averaged over the run; low is good. Band: 95 % interval of the mean over the "
    "seeds.",
    "ages": "Age of the newest detection received by the UAV's computer, and of the newest command received by the "
    "actuators. Solid: mean over time and runs; dotted: largest age in any run. There are no detections out of sight: "
    "if the UGV is lost for good, the age grows to the end of the run.",
}


def draw_all(material: Material, out: Path) -> dict[str, Path]:
    """Draw all pictures of a report.

    Args:
        material: Results of the report.
        out: Folder for the pictures.

    Returns:
        The picture files by name.

    Raises:
        OSError: If a picture cannot be written.
    """
    drawn: dict[str, Path] = {}
    for name, draw in (
        ("violations", violations),
        ("margins", margins),
        ("errors", errors),
        ("ages", ages),
    ):
        with style.plot_style():
            figure = draw(material)
            path = out / f"{name}.png"
            if figure is None:
                path.unlink(missing_ok=True)  # of an earlier report
                continue
            style.save(figure, path)
        drawn[name] = path
    return drawn
