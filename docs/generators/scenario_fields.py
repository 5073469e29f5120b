"""Reference of the scenario file, generated from its types."""

from collections.abc import Iterator

import msgspec
from msgspec import inspect as types
from structs import Field, cell, fields, structs, text_of, words

from bus.registry import LAWS
from sim.scenario.loading import load_scenario, scenario_names
from sim.scenario.types import Scenario


def tables() -> str:
    """Return a section for each table of the file, the top level first."""
    sections = [_section(name, struct) for name, struct in _walk("", Scenario)]
    return "\n\n".join((*sections, _law_parameters()))


def _law_parameters() -> str:
    """Return the parameters of all laws in one table."""
    laws: dict[str, list[str]] = {}
    rows: dict[str, Field] = {}
    for law in LAWS.values():
        for field in fields(law.parameters):
            laws.setdefault(field.name, []).append(f"`{law.name}`")
            rows.setdefault(field.name, field)
    lines = ["| field | laws | type | default | description |", "|---|---|---|---|---|"]
    for name, field in rows.items():
        default = "" if field.default == "null" else f"`{field.default}`"
        cells = cell(words(field.type)), default, cell(field.text)
        lines.append(f"| `{name}` | {', '.join(laws[name])} | {' | '.join(cells)} |")
    return "### `[law.parameters]`\n\n" + "\n".join(lines)


def shipped() -> str:
    """Return the table of the shipped scenarios."""
    rows = ["| name | law | duration | title |", "|---|---|--:|---|"]
    for name in scenario_names():
        one = load_scenario(name)
        rows.append(f"| `{one.name}` | `{one.law.name}` | {one.duration:g} s | {cell(one.title)} |")
    return "\n".join(rows)


def _walk(name: str, struct: type[msgspec.Struct]) -> Iterator[tuple[str, type[msgspec.Struct]]]:
    """Yield a table and the tables inside it, each kind once per table."""
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
    rows = ["| field | type | default | description |", "|---|---|---|---|"]
    first_at: dict[type, str] = {}
    for field in fields(struct):
        inner = next(structs(field.type), None)
        type_ = words(field.type, null="omitted")
        if inner is not None:
            table = _named(name, field.name, field.type)
            first = first_at.setdefault(inner, table)
            type_ = f"`{table}`, " + ("below" if first == table else f"as `{first}`")
        default = f"`{field.default}`" if field.default not in ("", "none") else field.default
        rows.append(f"| `{field.name}` | {cell(type_)} | {cell(default)} | {cell(field.text)} |")
    heading = f"`{name}`" if name else "Top level"
    return f"### {heading}\n\n{text_of(struct)}\n\n" + "\n".join(rows)
