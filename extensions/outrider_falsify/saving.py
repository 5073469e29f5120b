"""A scenario as TOML that loads as the same scenario, to the last bit."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from bus.messages import LinkKind
from sim.input.faults import toml_value
from sim.scenario.types import LinkTable, Scenario

_WIDTH = 120


def _value(value: object) -> str:
    flat = toml_value(value)
    if len(flat) <= _WIDTH or not isinstance(value, list | tuple):
        return flat
    return "[\n{}]".format("".join(f"    {_value(part)},\n" for part in value))


def _links(links: LinkTable) -> Iterator[str]:
    kinds = [str(kind) for kind in LinkKind]
    for kind in kinds:
        settings = getattr(links, kind).unlike()
        if settings:
            yield from _table(f"[links.{kind}]", settings)
    for own in links.only:
        yield f'[[links.only]]\nvehicle = "{own.vehicle}"'
        for kind in kinds:  # fields that are not written are as everybody's
            differs = getattr(own, kind).unlike(getattr(links, kind))
            if differs:
                yield f"{kind} = {_value(differs)}"
        yield ""


def _table(head: str, fields: dict[str, Any]) -> Iterator[str]:
    yield head
    yield from (f"{key} = {_value(value)}" for key, value in fields.items() if value is not None)
    yield ""


def as_toml(scenario: Scenario, comments: list[str]) -> str:
    """The scenario's text; all is written out but links that do nothing.

    Args:
        scenario: Checked.
        comments: Lines at its head.
    """
    plain: dict[str, Any] = msgspec.to_builtins(scenario)
    links = plain.pop("links")
    tables = {key: plain.pop(key) for key, value in [*plain.items()] if isinstance(value, dict)}
    vehicles = {key: plain.pop(key) for key in ("uav", "ugv")}
    lines = [f"# {' '.join(line.split())}" for line in comments]
    lines += _table("", plain)
    for name, table in tables.items():
        lines += _table(f"[{name}]", table)
    if links:
        lines += _links(scenario.links)
    for name, rows in vehicles.items():
        for row in rows:
            lines += _table(f"[[{name}]]", row)
    return "\n".join(lines)


def free_path(law: str) -> Path:
    """A file that is not there yet."""
    path, taken = Path(f"counterexample-{law}.toml"), 1
    while path.exists():
        taken += 1
        path = Path(f"counterexample-{law}-{taken}.toml")
    return path
