"""The table of what is measured, and the measuring."""

import statistics
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import msgspec

from bus.errors import ScenarioError
from bus.extras import check_extra, missing_of
from outrider.bench import beside, kernels, many, runs
from outrider.bench.timing import Pair

Progress = Callable[[str, float], None]


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One measurement and what it stands beside; medians over the repeats."""

    name: str
    value: float
    unit: str
    reference: str
    reference_value: float | None
    ratio: float | None
    """Median of the ratios value / reference, pair by pair; for times reference / value."""


class Layer(NamedTuple):
    """The measurement of one layer."""

    work: Callable[..., Pair]
    """Takes nothing."""
    unit: str
    """Of both numbers."""
    reference: str
    """The meaning of the second number."""
    most: int = 1_000
    """It is measured no more often than this: what takes minutes is measured once."""
    missing: str = ""
    """The words in the place of `reference` where there is no second number."""
    extra: str = ""
    """An extra without which the row is left out, unless it is asked for."""


BARE = "bare exchange among as many processes"
NO_COMPILER = "no C compiler found that builds it (cc, gcc, clang)"
WITHOUT_BRIDGE = "the same processes without the bridge"
ALONE = "its kernels alone, compiled, as many grids and threads"
ROWS: dict[str, Layer] = {
    "lockstep": Layer(runs.lockstep, "ticks/s", "bare three-process exchange"),
    "ros2_idle": Layer(beside.ros2_idle, "ticks/s", WITHOUT_BRIDGE, 3, extra="ros2"),
    "ros2_read": Layer(beside.ros2_read, "ticks/s", WITHOUT_BRIDGE, 3, extra="ros2"),
    "mavlink_read": Layer(beside.mavlink_read, "ticks/s", WITHOUT_BRIDGE, 3, extra="mavlink"),
    "run_in_process": Layer(runs.run_in_process, "ticks/s", "world_step"),
    "sweep": Layer(runs.sweep, "runs/s", "runs in one process, times cores", extra="sweep"),
    "env_step": Layer(kernels.env_step, "steps/s", "world_step"),
    "world_step": Layer(kernels.world_step, "steps/s", "its kernels alone, compiled"),
    "kernel_vs_numpy": Layer(kernels.kernel_vs_numpy, "passes/s", "plain NumPy"),
    "kernel_vs_c": Layer(
        partial(kernels.kernel_vs_c, lanes=False),
        "passes/s",
        "plain C, -O3, one running sum",
        missing=NO_COMPILER,
    ),
    "kernel_vs_c_lanes": Layer(
        partial(kernels.kernel_vs_c, lanes=True),
        "passes/s",
        "C, -O3, our eight lanes, same bits",
        missing=NO_COMPILER,
    ),
    "batch_1024": Layer(many.stepped, "steps/s", ALONE),
    "batch_1024_hazards": Layer(many.on_ground, "steps/s", ALONE),
    "batch_1024_single": Layer(many.in_single, "steps/s", "batch_1024, grids in double precision"),
    "batch_1024_rate": Layer(partial(many.stepped, rewards=many.RATE), "steps/s", ALONE),
    "batch_1024_pilots": Layer(many.pilots, "steps/s", ALONE),
    "batch_memory": Layer(many.memory, "B", "growth of a process by 1,024 worlds, each", 2),
    "memory_bandwidth": Layer(many.bandwidth, "GB/s", "one core"),
    "first_tick": Layer(runs.first_tick, "s", "with an empty compile cache", 2),
    "pairs_1": Layer(partial(runs.pairs, 1), "ticks/s", BARE),
    "pairs_5": Layer(partial(runs.pairs, 5), "ticks/s", BARE),
    "pairs_10": Layer(partial(runs.pairs, 10), "ticks/s", BARE, 2),
    "pairs_50": Layer(partial(runs.pairs, 50), "ticks/s", BARE, 1),
}
GROUPS = {"bridges": ("ros2_idle", "ros2_read", "mavlink_read")}
"""Rows that are asked for by one name."""


def _measure(name: str, repeats: int) -> Iterator[Pair]:
    layer = ROWS[name]
    for _ in range(min(repeats, layer.most)):
        yield layer.work()


def measure(only: list[str], repeats: int, *, on_progress: Progress | None = None) -> list[Row]:
    """Measure the rows.

    Args:
        only: Names of rows; none means all.
        repeats: Measurements of each; value and reference alternate.
        on_progress: Called with a row's name and the share that is done.

    Raises:
        ScenarioError: If a row does not exist, or an extra is missing that it needs.
    """
    only = [row for name in only for row in GROUPS.get(name, (name,))]
    unknown = [name for name in only if name not in ROWS]
    if unknown:
        allowed = ", ".join((*ROWS, *GROUPS))
        raise ScenarioError(f"--only {unknown[0]}: no such row; allowed: {allowed}")
    for name in only:
        if ROWS[name].extra:
            check_extra(ROWS[name].extra, what=f"--only {name}")
    rows: list[Row] = []
    names = only or [
        name for name, layer in ROWS.items() if not (layer.extra and missing_of(layer.extra))
    ]
    for done, name in enumerate(names):
        found: list[Pair] = []
        for pair in _measure(name, repeats):
            found.append(pair)
            if on_progress is not None:
                on_progress(name, (done + len(found) / min(repeats, ROWS[name].most)) / len(names))
        rows.append(_row(name, found))
    return rows


def _row(name: str, pairs: list[Pair]) -> Row:
    layer = ROWS[name]
    references = [other for _, other in pairs if other is not None]
    ratios = [
        (other / value if layer.unit == "s" else value / other) for value, other in pairs if other
    ]
    return Row(
        name=name,
        value=statistics.median(value for value, _ in pairs),
        unit=layer.unit,
        reference=layer.reference if references else layer.missing or layer.reference,
        reference_value=statistics.median(references) if references else None,
        ratio=statistics.median(ratios) if ratios else None,
    )
