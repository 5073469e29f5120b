"""Resolved scenarios: one TOML file that loads as the same scenario, to the last bit."""

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import msgspec

from sim.input.faults import toml_value
from sim.input.reading import typed
from sim.scenario.checks import check_scenario
from sim.scenario.types import Scenario

_WIDTH = 100


def as_toml(scenario: Scenario, comments: Iterable[str] = ()) -> str:
    """Return the text of a file with all fields of a scenario.

    Args:
        scenario: Checked scenario. Traces are written with their content, trajectories as scripts.
        comments: Lines at the head of the file.
    """
    lines = [f"# {' '.join(line.split())}" for line in comments]
    lines += _table(msgspec.to_builtins(scenario), ())
    return "\n".join(lines) + "\n"


def read_resolved(file: Path) -> Scenario:
    """Return the scenario of a file written by `as_toml`; it refers to no other files.

    Raises:
        ScenarioError: If it is not such a file.
        OSError: If it cannot be read.
    """
    return resolved(file.read_text(encoding="utf-8"), str(file))


def resolved(text: str, source: str = "scenario") -> Scenario:
    """Return the scenario of a text of `as_toml`; `source` is its name in errors.

    Raises:
        ScenarioError: If it is not such a text.
    """
    return check_scenario(typed(tomllib.loads(text), Scenario, file=source), source=source)


def _table(fields: Mapping[str, object], path: tuple[str, ...]) -> Iterator[str]:
    """Yield the lines of a table: its values first, then its subtables. Fields with None (the default) are omitted."""
    tables: list[tuple[str, str, dict[str, object]]] = []
    for key, value in fields.items():
        if isinstance(value, dict):
            tables.append(("[{}]", key, value))
        elif isinstance(value, list | tuple) and value and isinstance(value[0], dict):
            tables += [("[[{}]]", key, row) for row in value]
        elif value is not None:
            yield f"{key} = {_value(value)}"
    for head, key, table in tables:
        yield f"\n{head.format('.'.join((*path, key)))}"
        yield from _table(table, (*path, key))


def _value(value: object) -> str:
    flat = toml_value(value)
    if len(flat) <= _WIDTH or not isinstance(value, list | tuple):
        return flat
    return "[\n{}]".format("".join(f"    {_value(part)},\n" for part in value))
