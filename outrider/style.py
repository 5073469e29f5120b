"""The one visual language of every picture: colours, fonts, axes, and how a figure is made and saved.

Blue flies, orange drives, red is the limit of sight: solid where it must not be crossed (r_v), dashed where only
tracking acts (r_s). Drawn with matplotlib's objects on Agg; nothing here touches pyplot or leaves a setting behind.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from bus.registry import LAWS

UAV = ("#1f5fbf", "#5aa9e6", "#173b7a", "#7d8fe0")
"""Blues of the UAVs, in name order; from the first again after the last."""
UGV = ("#e8740c", "#f2a65a", "#a8500a", "#f6c453")
"""Oranges of the UGVs, alike."""
LIMIT = "#cf2a3c"
"""r_v, r_s, and whatever goes wrong."""
GOOD = "#2e8b57"
INK = "#22262d"
MUTED = "#727985"
RULE = "#e6e8ec"
GAIN = {"low": "#8fbdee", "high": "#2f74d0", "bounded": "#12305f"}
"""Shades of the gain k_v: low, high, and high with bounded input."""
COVERED = LinearSegmentedColormap.from_list("covered", ["#fafafa", "#d9e8de", "#86bb9f"])
"""From unseen ground to covered ground."""

DASHED = (0, (4, 2.5))
DPI = 140
_LOOK: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "mathtext.fontset": "dejavusans",
    "text.color": INK,
    "axes.edgecolor": "#b9bec6",
    "axes.labelcolor": INK,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "grid.color": RULE,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.5,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.6,
    "agg.path.chunksize": 20000,
}


@contextmanager
def look() -> Iterator[None]:
    """While it is open, new artists look like ours, whatever the user's own settings are.

    Afterwards all is as before.
    """
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_LOOK)  # type: ignore[arg-type]
        yield


def new_figure(width: int, height: int, *, header: float = 0.0) -> Figure:
    """An empty figure.

    Args:
        width: [px].
        height: [px].
        header: Share of the height that is kept free at the top.
    """
    figure = Figure(
        figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white", layout="constrained"
    )
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0.008, 0.01, 0.984, 0.98 - header), w_pad=0.06, h_pad=0.06)  # type: ignore[call-arg]
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the figure as PNG; the same figure gives the same bytes."""
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": None})


def color(colors: tuple[str, ...], index: int) -> str:
    """The colour of the vehicle with this index."""
    return colors[index % len(colors)]


def law_color(law: str) -> str:
    """The colour of a law, wherever laws are compared; a recording's own law may be none of ours."""
    return LAWS[law].color if law in LAWS else INK


def law_mark(law: str) -> str:
    """The mark of a law's points."""
    return LAWS[law].mark if law in LAWS else "o"


def over_time(axes: Axes, end: float, label: str) -> None:
    """Dress axes with time to the right, from 0 to `end` [s], and a quantity that starts at 0."""
    axes.set_xlim(0.0, end)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    axes.margins(y=0.08)


def ground(axes: Axes, width: float, height: float) -> None:
    """Dress axes that show the ground [m]."""
    axes.set_aspect("equal")
    axes.set_xlim(0.0, width)
    axes.set_ylim(0.0, height)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(visible=False)
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)


def ring(
    axes: Axes,
    center: tuple[float, float],
    radius: float,
    *,
    color: str = LIMIT,
    dashed: bool = False,
    width: float = 1.5,
) -> None:
    """A circle on the ground."""
    line = DASHED if dashed else "-"
    axes.add_patch(
        Circle(
            center, radius, fill=False, edgecolor=color, linewidth=width, linestyle=line, zorder=5
        )
    )


def limits_of_sight(axes: Axes, r_v: float | None, r_s: float | None) -> None:
    """The radii as lines over time, named at the right end; without one that is None."""
    for radius, name, line in ((r_v, "$r_v$", "-"), (r_s, "$r_s$", DASHED)):
        if radius is not None:
            axes.axhline(radius, color=LIMIT, linewidth=1.3, linestyle=line, zorder=1.5)
            axes.text(
                1.012, radius, name, color=LIMIT, va="center", transform=axes.get_yaxis_transform()
            )


def coverage_bar(figure: Figure, image: AxesImage, axes: Axes | Sequence[Axes]) -> None:
    """What the colours of the ground mean."""
    bar = figure.colorbar(image, ax=axes, shrink=0.7, aspect=32, pad=0.015)
    bar.set_label("coverage C/C*")
    bar.outline.set_visible(False)


def legend_above(axes: Axes) -> None:
    """A legend in one line, to the right of the title."""
    legend = axes.legend(
        loc="lower right", bbox_to_anchor=(1.01, 0.95), ncols=4, markerscale=4.0, columnspacing=1.2
    )
    legend.set_in_layout(False)


def panel(axes: Axes, letter: str, title: str) -> None:
    """The title of a sub-figure, with its letter."""
    axes.set_title(rf"$\mathbf{{({letter})}}$  {title}")


def key(color: str, label: str, **line: Any) -> Line2D:  # noqa: ANN401 - matplotlib's own keywords
    """An entry of a legend."""
    return Line2D([], [], color=color, label=label, **line)


def vehicle_keys(uavs: int = 1, ugvs: int = 1) -> list[Line2D]:
    """The entries of a legend for the tracks and goals of so many vehicles."""
    mark = {"markeredgecolor": "white", "markersize": 7}
    return [
        key(UAV[0], "UAV" if uavs == 1 else f"{uavs} UAVs", marker="o", **mark),
        key(UGV[0], "UGV" if ugvs == 1 else f"{ugvs} UGVs", marker="s", linewidth=2.2, **mark),
        key(UGV[0], "goal", marker="x", linestyle="", markeredgewidth=1.8),
    ]
