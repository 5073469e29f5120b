"""The reference of a scenario's file, from its types."""

from collections.abc import Iterator

import msgspec
from msgspec import inspect as types
from structs import Field, cell, fields, structs, text_of, words

from bus.law_parameters import parameters_class
from bus.registry import LAWS
from sim.scenario.loading import load_scenario, scenario_names
from sim.scenario.types import Scenario


def tables() -> str:
    """A section for each table of the file, the top level first."""
    sections = [_section(name, struct) for name, struct in _walk("", Scenario)]
    return "\n\n".join((*sections, _law_parameters()))


def _law_parameters() -> str:
    """The parameters of all laws in one table."""
    laws: dict[str, list[str]] = {}
    rows: dict[str, Field] = {}
    for name in LAWS:
        parameters = parameters_class(name)
        for field in () if parameters is None else fields(parameters):
            laws.setdefault(field.name, []).append(f"`{name}`")
            rows.setdefault(field.name, field)
    lines = ["| field | laws | type | default | what |", "|---|---|---|---|---|"]
    for name, field in rows.items():
        default = "" if field.default == "null" else f"`{field.default}`"
        told = cell(words(field.type)), default, cell(field.text)
        lines.append(f"| `{name}` | {', '.join(laws[name])} | {' | '.join(told)} |")
    return "### `[law.parameters]`\n\n" + "\n".join(lines)


def shipped() -> str:
    """The shipped scenarios."""
    rows = ["| name | law | time | what it is |", "|---|---|--:|---|"]
    for name in scenario_names():
        one = load_scenario(name)
        rows.append(f"| `{one.name}` | `{one.law.name}` | {one.duration:g} s | {cell(one.title)} |")
    return "\n".join(rows)


def _walk(name: str, struct: type[msgspec.Struct]) -> Iterator[tuple[str, type[msgspec.Struct]]]:
    """The tables below one, each as often as it is of another kind."""
    yield name, struct
    seen: set[type] = set()
    for field in fields(struct):
        for inner in structs(field.type):
            if inner not in seen:
                seen.add(inner)
                yield from _walk(_named(name, field.name, field.type), inner)


def _named(name: str, field: str, type_: types.Type) -> str:
    path = f"{name.strip('[]')}.{field}".strip(".")
    return f"[[{path}]]" if isinstance(type_, types.VarTupleType) else f"[{path}]"


def _section(name: str, struct: type[msgspec.Struct]) -> str:
    rows = ["| field | type | default | what |", "|---|---|---|---|"]
    told_at: dict[type, str] = {}
    for field in fields(struct):
        inner = next(structs(field.type), None)
        told = words(field.type, null="left out")
        if inner is not None:
            table = _named(name, field.name, field.type)
            first = told_at.setdefault(inner, table)
            told = f"`{table}`, " + ("below" if first == table else f"as `{first}`")
        default = f"`{field.default}`" if field.default not in ("", "none") else field.default
        rows.append(f"| `{field.name}` | {cell(told)} | {cell(default)} | {cell(field.text)} |")
    heading = f"`{name}`" if name else "The top of the file"
    return f"### {heading}\n\n{text_of(struct)}\n\n" + "\n".join(rows)
