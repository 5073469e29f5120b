"""Learning curve of a policy's file, beside the laws on the same runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evaluation import CASES, VALIDATION_SEEDS, fly_law

from outrider.style import INK, law_color, new_figure, plot_style, save
from outrider_learning.mlp import load_policy


def draw_curve(
    policy: str | Path,
    picture: str | Path,
    *,
    laws: Sequence[str] = ("circle", "linear", "logarithmic"),
) -> None:
    """Plot the decrease of e(t) on the validation runs during training.

    Args:
        policy: File of `examples/train_uav.py`.
        picture: PNG to write.
        laws: Laws plotted for comparison.

    Raises:
        ValueError: If the file is missing, or is not a policy with a learning curve.
    """
    _, recipe = load_policy(policy)
    curve = [(float(decisions), float(error)) for decisions, _, error in recipe.get("curve", ())]
    if not curve:
        raise ValueError(f"policy {str(policy)!r}: its recipe has no learning curve")
    levels = {
        law: float(fly_law(CASES["wander"], law, VALIDATION_SEEDS)["mean_error"].mean())
        for law in laws
    }
    million = [decisions / 1e6 for decisions, _ in curve]
    errors = [error for _, error in curve]
    top = 1.08 * max(*errors, *levels.values())
    with plot_style():
        figure = new_figure(980, 560)
        axes = figure.add_subplot()
        for law, level in levels.items():
            axes.axhline(level, color=law_color(law), linewidth=1.3, linestyle="--")
        axes.plot(million, errors, color=INK, marker="o", markersize=3.5, clip_on=False, zorder=3)
        ends = levels | {"learned": errors[-1]}
        for (name, _), height in zip(_by_level(ends), _spread(ends, 0.045 * top), strict=True):
            style: dict[str, Any] = {
                "xycoords": axes.get_yaxis_transform(),
                "va": "center",
                "annotation_clip": False,
            }
            axes.annotate(name, (1.015, height), color=law_color(name), **style)
        axes.set_xlim(0.0, million[-1] or 1.0)
        axes.set_ylim(0.0, top)
        axes.set_xlabel(
            f"training decisions [million], one per {recipe['repeat'] * recipe['dt']:g} s"
        )
        axes.set_ylabel("mean e(t) [m²]")
        axes.set_title(
            f"Uncovered ground in {len(VALIDATION_SEEDS)} validation runs, UGV wandering"
        )
        save(figure, Path(picture))


def _by_level(levels: Mapping[str, float]) -> list[tuple[str, float]]:
    return sorted(levels.items(), key=lambda one: one[1])


def _spread(levels: Mapping[str, float], apart: float) -> list[float]:
    """Return heights of the labels, the lowest first, without overlap."""
    heights: list[float] = []
    for _, level in _by_level(levels):
        heights.append(max(level, heights[-1] + apart) if heights else level)
    return heights
