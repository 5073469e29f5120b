"""Results of sweeps, arranged for a report: panels with the runs of each law at each value."""

import logging
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from bus.errors import ScenarioError
from bus.registry import LAWS
from outrider.experiments.intervals import wilson_interval
from outrider.experiments.report.labels import is_number, label_of, value_of
from outrider.experiments.sweep.folder import SweepHead, read_head, read_results

_LOG = logging.getLogger("outrider.report")


@dataclass(slots=True)
class Cell:
    """All runs of one law at one value."""

    rows: list[dict[str, Any]] = field(default_factory=list)

    @property
    def flown(self) -> list[dict[str, Any]]:
        """Runs that did not fail."""
        return [row for row in self.rows if row["error"] is None]

    @property
    def failed(self) -> int:
        """Number of runs that failed."""
        return len(self.rows) - len(self.flown)

    @property
    def violated(self) -> int:
        """Number of runs that lost sight of the UGV."""
        return sum(row["violated"] for row in self.flown)

    @property
    def certified(self) -> list[dict[str, Any]]:
        """Runs in which sight was certified at every tick."""
        return [row for row in self.flown if row["certified_share"] == 1.0]

    def rate(self) -> tuple[float, float, float] | None:
        """Return the share of runs that lost sight of the UGV, with its 95 % interval; None without runs."""
        runs = len(self.flown)
        return (self.violated / runs, *wilson_interval(self.violated, runs)) if runs else None

    def numbers(self, column: str) -> list[float]:
        """Return the finite numbers of a column."""
        # A sweep of an older version may lack a column.
        found = [row.get(column) for row in self.flown]
        return [value for value in found if value is not None and math.isfinite(value)]


@dataclass(slots=True, kw_only=True)
class Panel:
    """Effect of one field on each law, with all other fields fixed."""

    title: str
    field: str
    """Varied field; empty: none."""
    values: list[Any]
    """Values of the field, in increasing order."""
    laws: list[str]
    cells: dict[tuple[str, Any], Cell]

    @property
    def label(self) -> str:
        """Label of the axis."""
        return label_of(self.field) if self.field else ""

    @property
    def ordered(self) -> bool:
        """True if all values are numbers."""
        return all(map(is_number, self.values))

    def cell(self, law: str, value: object) -> Cell:
        """Return the runs of a law at a value, possibly none."""
        return self.cells.get((law, value), Cell())

    def numbers(self, value: object, column: str) -> list[float]:
        """Return the finite numbers of a column at a value, over all laws."""
        return [number for law in self.laws for number in self.cell(law, value).numbers(column)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """Content of a report."""

    folders: tuple[Path, ...]
    heads: tuple[SweepHead, ...]
    panels: tuple[Panel, ...]
    rows: int
    failed: int
    missing: int
    """Number of runs that are not flown yet."""
    law: tuple[str, ...]
    """Laws of all panels, in the order of the laws' table."""

    @property
    def cells(self) -> list[Cell]:
        """Cells of all panels."""
        return [cell for panel in self.panels for cell in panel.cells.values()]


@dataclass(slots=True, kw_only=True)
class _Block:
    """Block of one or several folders, with its rows."""

    name: str
    vary: dict[str, None]
    rows: list[dict[str, Any]]
    folder: Path
    """First folder."""
    apart: str = ""
    """Suffix that distinguishes it from other blocks of the same name."""


def _ordered_laws(laws: set[str]) -> list[str]:
    table = {name: k for k, name in enumerate(LAWS)}
    return sorted(laws, key=lambda law: (table.get(law, len(table)), law))


def _rising(values: Sequence[Any]) -> list[Any]:
    """Return each value once: increasing numbers, then all other values in their order."""
    once = list(dict.fromkeys(values))
    numbers = [value for value in once if is_number(value)]
    return sorted(numbers) + [value for value in once if value not in numbers]


def _read(folder: Path, on_notice: Callable[[str], None]) -> tuple[SweepHead, list[dict[str, Any]]]:
    head = read_head(folder)
    if head is None:
        raise ScenarioError(
            f"{folder}: not a folder of a sweep; allowed: a folder made by `outrider sweep`"
        )
    results = read_results(folder, head.columns, on_notice)
    return head, [
        dict(zip(results, row, strict=True)) for row in zip(*results.values(), strict=True)
    ]


def _identity(row: dict[str, Any], vary: Sequence[str]) -> tuple[Any, ...]:
    return (row["law"], row["seed"], *(row[name] for name in vary))


def _join(into: _Block, rows: list[dict[str, Any]]) -> bool:
    """Add the rows of another folder; return false, without adding, if a run has different results in both."""
    vary = list(into.vary)
    known = {_identity(row, vary): row for row in into.rows}
    new = []
    for row in rows:
        same = known.get(_identity(row, vary))
        if same is None:
            new.append(row)
        elif same["trajectory_sha256"] != row["trajectory_sha256"]:
            return False
    into.rows += new
    return True


class _Folder(NamedTuple):
    """Results of one sweep."""

    path: Path
    head: SweepHead
    rows: list[dict[str, Any]]


def _blocks(found: Sequence[_Folder]) -> list[_Block]:
    """Return the blocks of all folders; blocks with equal fields are merged, such as blocks with different laws."""
    blocks: dict[bytes, list[_Block]] = defaultdict(list)
    for folder, head, rows in found:
        for block in head.sweep.block:
            mine = [row for row in rows if row["block"] == block.name]
            key = msgspec.json.encode(
                (block.name, sorted(block.vary), head.sweep.scenario, head.sweep.set, block.set),
                order="sorted",
            )
            if not any(_join(other, mine) for other in blocks[key]):
                vary = dict.fromkeys(block.vary)
                blocks[key].append(_Block(name=block.name, vary=vary, rows=mine, folder=folder))
    merged = [block for alike in blocks.values() for block in alike]
    names = [block.name for block in merged]
    for one in merged:
        if names.count(one.name) > 1:
            one.apart = f" ({one.folder})"
    return merged


def _panels_of(block: _Block) -> Iterator[Panel]:
    """Yield a panel for each combination of fields; the field with the most values is the axis."""
    values = {name: _rising([row[name] for row in block.rows]) for name in block.vary}
    axis = max(values, key=lambda name: len(values[name]), default="")
    others = [name for name in values if name != axis]
    title = (
        label_of(axis).partition(" [")[0]
        if block.name == ", ".join(block.vary) and not others
        else block.name
    )
    parts: dict[tuple[Any, ...], list[dict[str, Any]]] = defaultdict(list)
    for row in block.rows:
        parts[tuple(row[name] for name in others)].append(row)
    for fixed, rows in parts.items():
        at = ", ".join(
            f"{label_of(name).partition(' [')[0]} {value_of(name, value)}"
            for name, value in zip(others, fixed, strict=True)
        )
        cells: dict[tuple[str, Any], Cell] = defaultdict(Cell)
        for row in rows:
            cells[row["law"], row[axis] if axis else None].rows.append(row)
        yield Panel(
            title=f"{at or title}{block.apart}",
            field=axis,
            values=_rising([row[axis] for row in rows]) if axis else [None],
            laws=_ordered_laws({row["law"] for row in rows}),
            cells=dict(cells),
        )


def read_material(
    folders: Sequence[Path], on_notice: Callable[[str], None] = _LOG.warning
) -> Material:
    """Read the results of sweeps, finished or not.

    Args:
        folders: One folder or more; experiments that they share are merged.
        on_notice: Called with one line for the user, if a row is skipped.

    Raises:
        ScenarioError: If a folder does not belong to a sweep, has no rows yet, or is damaged.
    """
    found = [_Folder(folder, *_read(folder, on_notice)) for folder in dict.fromkeys(folders)]
    for folder, _, rows in found:
        if not rows:
            raise ScenarioError(f"{folder}: no results yet; resume the sweep")
    panels = [panel for block in _blocks(found) for panel in _panels_of(block)]
    everything = [row for _, _, rows in found for row in rows]
    return Material(
        folders=tuple(folder for folder, _, _ in found),
        heads=tuple(head for _, head, _ in found),
        panels=tuple(panels),
        rows=len(everything),
        failed=sum(row["error"] is not None for row in everything),
        missing=sum(head.runs - len(rows) for _, head, rows in found),
        law=tuple(_ordered_laws({law for panel in panels for law in panel.laws})),
    )
