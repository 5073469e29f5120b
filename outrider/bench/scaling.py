"""The speed of many worlds over their number, the grid and the vehicles: numbers, and a picture of them."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from outrider.bench.many import RATE, WORLDS, stepped
from outrider.bench.pairs import many_pairs
from outrider.style import DASHED, INK, MUTED, UAV, UGV, look, new_figure, panel, save
from sim.kernels.threads import cores
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

COUNTS = (1, 4, 16, 64, 256, 1024, 4096)
"""Worlds."""
CELLS = (0.5, 0.25, 0.125)
"""Width of a cell [m]."""
PAIRS = (1, 2, 4, 8)
_BYTES = 2e9
"""No point needs more memory than this."""
_MODES = {"full": None, "rate": RATE}


class ScalingPoint(msgspec.Struct, frozen=True, kw_only=True):
    """One measurement."""

    panel: str
    """The varied quantity: worlds, cells or pairs."""
    value: float
    """Its value: a number, or the width of a cell [m]."""
    mode: str
    """`full`: e(t) at every tick; `rate`: only how far it falls."""
    worlds: int
    world_steps_per_second: float


class _Case(NamedTuple):
    panel: str
    value: float
    scenario: Scenario
    worlds: int


def _grid(cell: float) -> Scenario:
    scenario = load_scenario("escort")
    return msgspec.structs.replace(scenario, area=msgspec.structs.replace(scenario.area, cell=cell))


def _fitting(scenario: Scenario, worlds: int) -> int:
    """So many worlds, or as many as there is memory for: each UAV of several has a map of its own."""
    maps = 1 + (len(scenario.uav) if len(scenario.uav) > 1 else 0)
    area = scenario.area
    cells = round(area.width / area.cell) * round(area.height / area.cell)
    return min(worlds, int(_BYTES / (8.0 * maps * cells)))


def _cases(most: int) -> Iterator[_Case]:
    escort, usual = load_scenario("escort"), min(WORLDS, most)
    for count in COUNTS:
        if count <= most:
            yield _Case("worlds", count, escort, count)
    for cell in CELLS:
        grid = _grid(cell)
        yield _Case("cells", cell, grid, _fitting(grid, usual))
    for count in PAIRS:
        many = many_pairs(count, seconds=160.0)
        yield _Case("pairs", count, many, _fitting(many, usual))


def measure_scaling(
    *,
    seconds: float = 1.0,
    most: int = COUNTS[-1],
    on_progress: Callable[[str, float], None] = lambda _what, _share: None,
) -> list[ScalingPoint]:
    """World-steps a second over the number of worlds, the grid and the vehicles, on all cores; the best of three.

    Args:
        seconds: How long each of the three takes, about [s].
        most: No more worlds than this.
        on_progress: Called with what is measured and the share that is done.
    """
    points: list[ScalingPoint] = []
    jobs = [(case, mode) for case in _cases(most) for mode in _MODES]
    for done, (case, mode) in enumerate(jobs):
        settings: dict[str, Any] = {"rewards": _MODES[mode], "worlds": case.worlds, "limit": False}
        guess = stepped(case.scenario, steps=5, **settings)[0]
        steps = max(3, round(seconds * guess / case.worlds))
        found = max(stepped(case.scenario, steps=steps, **settings)[0] for _ in range(3))
        points.append(
            ScalingPoint(
                panel=case.panel,
                value=case.value,
                mode=mode,
                worlds=case.worlds,
                world_steps_per_second=round(found, 1),
            )
        )
        on_progress(f"{case.panel} {case.value:g} {mode}", (done + 1) / len(jobs))
    return points


def _curves(
    axes: Axes,
    points: list[ScalingPoint],
    name: str,
    *,
    x: Callable[[float], float] = float,
    ticks: dict[float, str],
) -> None:
    for mode, colour, label in (
        ("rate", UAV[0], "only the fall of e(t)"),
        ("full", UGV[0], "e(t) at every tick"),
    ):
        here = [
            (x(p.value), p.world_steps_per_second)
            for p in points
            if p.panel == name and p.mode == mode
        ]
        across, up = zip(*here, strict=True)
        axes.plot(
            across,
            up,
            color=colour,
            marker="o",
            markersize=5.0,
            markeredgecolor="white",
            label=label,
            zorder=3,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(list(ticks), list(ticks.values()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.yaxis.set_minor_locator(NullLocator())


def _guide(
    axes: Axes,
    points: list[ScalingPoint],
    name: str,
    label: str,
    *,
    ticks: dict[float, str],
    power: float,
) -> None:
    """A line through the first point with the whole error.

    What the speed would be if all that is varied cost the same.
    """
    here = [p for p in points if p.panel == name and p.mode == "full"]
    speeds = [here[0].world_steps_per_second * (p.value / here[0].value) ** power for p in here]
    axes.plot(
        list(ticks)[: len(here)], speeds, color=MUTED, linestyle=DASHED, linewidth=1.0, label=label
    )


def draw_scaling(points: list[ScalingPoint], path: Path, *, on: str) -> None:
    """Three panels: over worlds, cells and vehicles.

    Args:
        points: What was measured.
        path: The PNG.
        on: What it was measured on, in words.
    """
    with look():
        figure = new_figure(1680, 700, header=0.13)
        axes = figure.subplots(1, 3, sharey=True)
        counts = sorted({int(p.value) for p in points if p.panel == "worlds"})
        _curves(axes[0], points, "worlds", ticks={float(count): f"{count:,}" for count in counts})
        axes[0].set_xlabel("worlds")
        axes[0].set_ylabel("world-steps per second [1/s]")
        side = load_scenario("escort").area.width
        sizes = {float(round(side / cell)): f"{round(side / cell)}²\n{cell:g} m" for cell in CELLS}
        _curves(axes[1], points, "cells", x=lambda cell: float(round(side / cell)), ticks=sizes)
        _guide(axes[1], points, "cells", "inverse to the cells", ticks=sizes, power=2.0)
        axes[1].set_xlabel("cells of the grid, and their width [m]")
        numbers_of_pairs = {float(count): str(count) for count in PAIRS}
        _curves(axes[2], points, "pairs", ticks=numbers_of_pairs)
        _guide(axes[2], points, "pairs", "inverse to the pairs", ticks=numbers_of_pairs, power=-1.0)
        axes[2].set_xlabel("pairs of UAV and UGV in a world")
        for one, letter, name, title in zip(
            axes, "abc", ("worlds", "cells", "pairs"), ("worlds", "grid", "vehicles"), strict=True
        ):
            numbers = {p.worlds for p in points if p.panel == name}
            told = (
                f"{max(numbers):,} worlds"
                if len(numbers) == 1
                else f"{min(numbers):,} to {max(numbers):,} worlds"
            )
            panel(one, letter, title if name == "worlds" else f"{title}, {told}")
        axes[0].legend(loc="lower right")
        for one in axes[1:]:
            one.legend(handles=one.lines[-1:], loc="lower left")
        axes[0].set_ylim(bottom=0.8 * min(p.world_steps_per_second for p in points))
        figure.text(
            0.012,
            0.962,
            "Speed of many worlds",
            fontsize=12.0,
            fontweight="bold",
            color=INK,
            va="center",
        )
        told = "coverage, gradient, Kalman filter, drivers, rewards and observations at every tick of every world"
        figure.text(0.012, 0.908, f"{on}; {told}", fontsize=9.0, color=MUTED, va="center")
        save(figure, path)


def make_scaling(path: Path, **settings: Any) -> list[ScalingPoint]:  # noqa: ANN401 - those of measure_scaling
    """Measure, and write the picture and, beside it, the numbers as JSON.

    Args:
        path: The PNG.
        settings: Of `measure_scaling`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    points = measure_scaling(**settings)
    told = {"cores": cores(), "points": points}
    path.with_suffix(".json").write_bytes(
        msgspec.json.format(msgspec.json.encode(told), indent=1) + b"\n"
    )
    draw_scaling(points, path, on=f"escort, {cores()} cores")
    return points
