"""Plan of a sweep: a checked scenario for every point, and a number for every run."""

import hashlib
import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from itertools import product
from typing import Any

import msgspec

from bus.errors import ScenarioError
from bus.registry import DRIVERS
from outrider.experiments.sweep.columns import FIRST, RESULTS
from outrider.experiments.sweep.definition import Block, Sweep
from outrider.running.own_functions import check_own_functions
from outrider.running.user_code import check_code
from sim.input.faults import one_line
from sim.scenario.checks import check_no_robot, scenario_warnings
from sim.scenario.laws import law_title
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

MOST_RUNS = 1_000_000
"""Largest number of runs of a sweep and of rows of its table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPoint:
    """Law and combination of values, flown with every seed."""

    block: str
    law: str
    fields: dict[str, Any]
    """Value of each field that the sweep varies in any block; None if the scenario has no such value."""
    scenario: Scenario


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """Plan of a sweep. Run r is point r // seeds with seed number r % seeds."""

    sweep: Sweep
    points: tuple[SweepPoint, ...]
    columns: dict[str, str]
    """Columns of the table with their Parquet types, in order."""
    version: str
    """Version of Outrider."""
    digest: str
    """Hash of all points and seeds: sweeps with equal hashes fly equal runs."""
    warnings: tuple[str, ...]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.points) * self.sweep.seeds

    def seed_of(self, run: int) -> int:
        """Return the seed of a run."""
        return self.sweep.first_seed + run % self.sweep.seeds

    def head(self, run: int) -> dict[str, Any]:
        """Return the columns of a run that are known before the run."""
        point = self.points[run // self.sweep.seeds]
        named = {"run": run, "block": point.block, "law": point.law, "seed": self.seed_of(run)}
        return {**named, "scenario": point.scenario.name, "version": self.version, **point.fields}


def _value_at(raw: object, path: str, given: object) -> object:
    """Return a field of a scenario in plain tables; for a field that scenarios do not store, the value given."""
    for part in path.split("."):
        if isinstance(raw, dict):
            raw = raw.get(part)
        elif isinstance(raw, list | tuple) and part.isdigit() and int(part) < len(raw):
            raw = raw[int(part)]
        else:
            return given
    return given if raw is None else raw


def _kind(values: list[object]) -> str:
    """Return the Parquet type of some values: text for lists, tables and mixed types."""
    if all(isinstance(value, bool) for value in values):
        return "bool"
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return "double"
    return "string"


def _as_column(value: object, kind: str) -> object:
    if value is None or kind == "bool":
        return value
    if isinstance(value, bool):
        return str(value).lower() if kind == "string" else value
    if kind == "double":
        return float(value) if isinstance(value, int | float) else None
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()


def _loaded(
    sweep: Sweep, on_progress: Callable[[int, int], None]
) -> Iterator[tuple[Block, dict[str, Any], Scenario]]:
    """Yield the block, varied values and scenario of every point, in order."""
    laws: tuple[str | None, ...] = sweep.laws or (None,)
    wanted = [
        (block, law, dict(zip(block.vary, values, strict=True)))
        for block in sweep.block
        for law in laws
        for values in product(*block.vary.values())
    ]
    for number, (block, law, values) in enumerate(wanted):
        on_progress(number, len(wanted))
        changes = {**sweep.set, **block.set, **values}
        scenario = load_scenario(sweep.scenario, overrides=changes, law=law)
        outside = next((ugv.driver for ugv in scenario.ugv if DRIVERS[ugv.driver].outside), None)
        if outside is not None:
            wrong = f"the driver {outside!r} is another process; allowed: drivers of Outrider"
            raise ScenarioError(f"{one_line(sweep.scenario)}: {wrong}")
        check_no_robot(scenario)
        if law is not None and not scenario.uav:
            wrong = f"laws = {list(sweep.laws or ())}: the scenario has no UAV"
            raise ScenarioError(f"{one_line(sweep.scenario)}: {wrong}; allowed: none")
        yield block, values, scenario


def _count(sweep: Sweep) -> int:
    """Return the number of points."""
    laws = len(sweep.laws or (None,))
    return laws * sum(math.prod(map(len, block.vary.values())) for block in sweep.block)


def lay_out(
    sweep: Sweep,
    *,
    named: Collection[str] = (),
    allow_code: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> SweepPlan:
    """Load and check every point of a sweep before the first run.

    Args:
        sweep: Checked sweep.
        named: Fields set by the user, not by a file.
        allow_code: True: load code that a file names.
        on_progress: Called with the numbers of loaded and of all points.

    Raises:
        ScenarioError: If a point cannot be flown; the message is one line.
    """
    varied: dict[str, list[object]] = {}
    for block in sweep.block:
        for field, values in block.vary.items():
            varied.setdefault(field, []).extend(values)
    kinds = {field: _kind(values) for field, values in varied.items()}
    runs = sweep.seeds * _count(sweep)
    if runs > MOST_RUNS:
        raise ScenarioError(
            f"{one_line(sweep.scenario)}: {runs:,} runs; allowed: {MOST_RUNS:,} at most in one sweep"
        )
    points: list[SweepPoint] = []
    warnings: dict[str, None] = {}
    for block, values, scenario in _loaded(sweep, on_progress):
        raw = msgspec.to_builtins(scenario)
        fields = {
            field: _as_column(_value_at(raw, field, values.get(field)), kind)
            for field, kind in kinds.items()
        }
        points.append(
            SweepPoint(block=block.name, law=law_title(scenario), fields=fields, scenario=scenario)
        )
        warnings |= dict.fromkeys(scenario_warnings(scenario))
        check_code(scenario, named, source=sweep.scenario, allowed=allow_code)
        warnings |= dict.fromkeys(check_own_functions(scenario))
    known = [(point.block, point.law, point.fields, point.scenario) for point in points]
    everything = msgspec.msgpack.encode((sweep.seeds, sweep.first_seed, known))
    return SweepPlan(
        sweep=sweep,
        points=tuple(points),
        columns={**FIRST, **kinds, **RESULTS},
        version=version("outrider"),
        digest=hashlib.sha256(everything).hexdigest(),
        warnings=tuple(warnings),
    )
