"""A sweep laid out: every point of it a scenario that can be flown, every run a number."""

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
from outrider.running.user_code import check_code, check_own_functions
from sim.input.faults import one_line
from sim.scenario.checks import scenario_warnings
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

MOST_RUNS = 1_000_000
"""Runs of a sweep at most, and rows of its table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPoint:
    """One law at one combination of values; flown with every seed."""

    block: str
    law: str
    fields: dict[str, Any]
    """The value here of each field that the sweep varies anywhere; None where the scenario has no such value."""
    scenario: Scenario


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """All of a sweep. Run number r is point r // seeds with seed number r % seeds."""

    sweep: Sweep
    points: tuple[SweepPoint, ...]
    columns: dict[str, str]
    """Of the table: their names and Parquet types, in order."""
    version: str
    """Of Outrider."""
    digest: str
    """Of every point and seed: two sweeps with the same one fly the same runs."""
    warnings: tuple[str, ...]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.points) * self.sweep.seeds

    def seed_of(self, run: int) -> int:
        """The seed of a run."""
        return self.sweep.first_seed + run % self.sweep.seeds

    def head(self, run: int) -> dict[str, Any]:
        """The columns of a run that are known before it is flown."""
        point = self.points[run // self.sweep.seeds]
        named = {"run": run, "block": point.block, "law": point.law, "seed": self.seed_of(run)}
        return {**named, "scenario": point.scenario.name, "version": self.version, **point.fields}


def _value_at(raw: object, path: str, given: object) -> object:
    """A field of a scenario in plain tables; of one that no scenario keeps, as of a profile, what it was given."""
    for part in path.split("."):
        if isinstance(raw, dict):
            raw = raw.get(part)
        elif isinstance(raw, list | tuple) and part.isdigit() and int(part) < len(raw):
            raw = raw[int(part)]
        else:
            return given
    return given if raw is None else raw


def _kind(values: list[object]) -> str:
    """The Parquet type that holds these values; text where they are of several kinds, lists or tables."""
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
    sweep: Sweep, told: Callable[[int, int], None]
) -> Iterator[tuple[Block, dict[str, Any], Scenario]]:
    """The scenario of every point, in order, with what the sweep varies in it."""
    laws: tuple[str | None, ...] = sweep.laws or (None,)
    wanted = [
        (block, law, dict(zip(block.vary, values, strict=True)))
        for block in sweep.block
        for law in laws
        for values in product(*block.vary.values())
    ]
    for number, (block, law, values) in enumerate(wanted):
        told(number, len(wanted))
        named = {} if law is None else {"law.name": law}
        scenario = load_scenario(
            sweep.scenario, overrides={**sweep.set, **block.set, **named, **values}
        )
        outside = next((ugv.driver for ugv in scenario.ugv if DRIVERS[ugv.driver].outside), None)
        if outside is not None:
            wrong = f"the driver {outside!r} is another process; a sweep has none"
            raise ScenarioError(f"{one_line(sweep.scenario)}: {wrong}")
        if law is not None and not scenario.uav:
            wrong = f"laws = {list(sweep.laws or ())}: there is no UAV that could fly them"
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
    told: Callable[[int, int], None] = lambda _done, _of: None,
) -> SweepPlan:
    """Load every point of a sweep: what cannot be flown shows before anything is.

    Args:
        sweep: Checked.
        named: Fields that the user has set, and no file.
        allow_code: Whether the code that a file names is loaded.
        told: Is told how many points are loaded, and how many there are.

    Raises:
        ScenarioError: If a point is impossible; one line.
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
    for block, values, scenario in _loaded(sweep, told):
        raw = msgspec.to_builtins(scenario)
        fields = {
            field: _as_column(_value_at(raw, field, values.get(field)), kind)
            for field, kind in kinds.items()
        }
        points.append(
            SweepPoint(block=block.name, law=scenario.law.name, fields=fields, scenario=scenario)
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
