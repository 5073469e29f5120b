"""Style of all figures: making and saving, axes over time, legends, colors of laws.

Colors of vehicles and limits, fonts and the map are defined by the scene (`sim.scene`).
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from bus.files import writing
from bus.registry import LAWS
from sim.input.faults import one_line
from sim.scene.colors import GOOD, INK, LIMIT, MUTED, UAV, UGV, color
from sim.scene.drawing import COVERAGE, DASHED, DPI, key, plot_style

__all__ = [
    "COVERAGE",
    "DASHED",
    "GOOD",
    "INK",
    "LIMIT",
    "MUTED",
    "UAV",
    "UGV",
    "color",
    "key",
    "plot_style",
]
"""Public names, including names of the scene's style."""

GAIN = {"low": "#8fbdee", "high": "#2f74d0", "bounded": "#12305f"}
"""Shades of the gain k_v: low, high, and high with bounded input."""
_DASHES: tuple[Any, ...] = ("-", (0, (6, 1.5)), (0, (1.5, 1.5)), (0, (6, 1.5, 1.5, 1.5)))
_NAME = 0.11
"""Share of the axis below which the names of two radii would overlap."""
_LEGEND_WIDTH, _KEY_WIDTH = 56, 7
"""Width of a legend, and of a key without its name [letters]."""


def new_figure(width: int, height: int, *, header: float = 0.0) -> Figure:
    """Return an empty figure.

    Args:
        width: Width [px].
        height: Height [px].
        header: Share of the height reserved at the top.
    """
    figure = Figure(
        figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white", layout="constrained"
    )
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0.008, 0.01, 0.984, 0.98 - header), w_pad=0.06, h_pad=0.06)  # type: ignore[call-arg]
    return figure


def heading(figure: Figure, text: str, y: float, size: float, *, math: bool = True) -> None:
    """Set the title of a figure, at its upper left.

    Args:
        figure: The figure.
        text: Title.
        y: Height of its upper edge, as a share of the figure.
        size: Size of the letters [points].
        math: Draw text between dollar signs as mathematics.
    """
    figure.suptitle(
        text, x=0.012, y=y, ha="left", va="top", fontsize=size, fontweight="bold", parse_math=math
    )


def texts(figure: Figure) -> list[str]:
    """Return the words of a figure: its title, and the titles, labels and legends of its axes."""
    found, legends = [figure.get_suptitle()], list(figure.legends)
    for axes in (one for one in figure.axes if one.get_visible()):
        found += [axes.get_title(side) for side in ("left", "center", "right")]
        found += [axes.get_xlabel(), axes.get_ylabel()]
        legends += [legend] if (legend := axes.get_legend()) else []
    found += [entry.get_text() for legend in legends for entry in legend.get_texts()]
    return [text for text in found if text]


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, with its words as the description; equal figures give equal bytes."""
    FigureCanvasAgg(figure)
    words = {"Software": None, "Description": json.dumps(texts(figure))}
    with writing(path):
        figure.savefig(path, format="png", metadata=words)


def law_color(law: str) -> str:
    """Return the color of a law in comparisons; a default for a law unknown to Outrider."""
    return LAWS[law].color if law in LAWS else INK


def law_mark(law: str) -> str:
    """Return the marker of a law's points."""
    return LAWS[law].mark if law in LAWS else "o"


def line(k: int) -> dict[str, Any]:
    """Return color and dashes of a UAV's line in charts; after the last color, the dashes change."""
    return {"color": color(UAV, k), "linestyle": _DASHES[k // len(UAV) % len(_DASHES)]}


def over_time(axes: Axes, end: float, label: str) -> None:
    """Set up axes with time from 0 to `end` [s] and a quantity that starts at 0; call it after plotting."""
    axes.set_xlim(0.0, end)
    highest = float(axes.dataLim.y1)
    axes.set_ylim(0.0, 1.08 * highest if math.isfinite(highest) and highest > 0.0 else 1.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)


def limits_of_sight(axes: Axes, r_v: float | None, r_s: float | None) -> None:
    """Draw the radii [m] as lines over time, with their names; None: not drawn.

    Call it when the limits of the axes are set.
    """
    for radius, dashes in ((r_v, "-"), (r_s, DASHED)):
        if radius is not None:
            axes.axhline(radius, color=LIMIT, linewidth=1.3, linestyle=dashes, zorder=1.5)
    name_limits(axes, r_v, r_s)


def name_limits(axes: Axes, r_v: float | None, r_s: float | None, *, outer: str = "$r_v$") -> None:
    """Write the names of the radii at the right of the axes, one above the other where they are close.

    Args:
        axes: Axes over time, with their limits set.
        r_v: Visibility radius at the end [m]; None: no name.
        r_s: Switching radius [m]; None: no name.
        outer: Name of r_v.
    """
    low, high = axes.get_ylim()
    apart = r_v is None or r_s is None or abs(r_v - r_s) > _NAME * (high - low)
    upper, lower = ("bottom", "top") if (r_v or 0.0) >= (r_s or 0.0) else ("top", "bottom")
    for radius, name, place in ((r_v, outer, upper), (r_s, "$r_s$", lower)):
        if radius is not None:
            axes.text(
                1.012,
                radius,
                name,
                color=LIMIT,
                va="center" if apart else place,
                transform=axes.get_yaxis_transform(),
            )


def coverage_bar(figure: Figure, image: AxesImage, axes: Axes | Sequence[Axes]) -> None:
    """Draw the color bar of the coverage."""
    bar = figure.colorbar(image, ax=axes, shrink=0.7, aspect=32, pad=0.015)
    bar.set_label("coverage C/C*")
    bar.outline.set_visible(False)


def legend_above(axes: Axes) -> None:
    """Draw a legend with up to five entries per line between the axes and their title."""
    names = axes.get_legend_handles_labels()[1]
    columns = max(1, min(5, _LEGEND_WIDTH // (max(map(len, names)) + _KEY_WIDTH)))
    legend = axes.legend(
        loc="lower left",
        bbox_to_anchor=(-0.012, 1.0),
        borderaxespad=0.1,
        ncols=columns,
        markerscale=4.0,
        columnspacing=1.2,
        labelspacing=0.2,
    )
    legend.set_in_layout(False)
    axes.set_title(axes.get_title(loc="left"), pad=8.0 + 13.0 * math.ceil(len(names) / columns))


def panel(axes: Axes, letter: str, title: str) -> None:
    """Set the title of a sub-figure, with its letter."""
    axes.set_title(rf"$\mathbf{{({letter})}}$  {title}")


def plain(text: str) -> str:
    """Return the text of a user for a picture, on one line and without math."""
    return one_line(text).replace("$", r"\$")
