"""The JSON Schema of a scenario's file, made from its types and from the documentation of their fields."""

import ast
import inspect
from functools import cache
from typing import Any

import msgspec

from bus import messages
from bus.messages import LinkKind
from sim.channel.profiles import PROFILES
from sim.scenario import types
from sim.scenario.types import Scenario

_PLACE = "#/$defs/{name}"


@cache
def field_docs() -> dict[str, dict[str, str]]:
    """The documentation of each field of each table, by the table's class; an empty text where it has none."""
    found: dict[str, dict[str, str]] = {}
    for module in (messages, types):
        for node in ast.parse(inspect.getsource(module)).body:
            if isinstance(node, ast.ClassDef):
                found[node.name] = _docs_of(node)
    return found


def _docs_of(table: ast.ClassDef) -> dict[str, str]:
    docs: dict[str, str] = {}
    for statement, after in zip(table.body, [*table.body[1:], None], strict=True):
        if not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)):
            continue
        told = (
            after.value.value
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            else ""
        )
        docs[statement.target.id] = " ".join(str(told).split())
    return docs


def scenario_schema() -> dict[str, Any]:
    """The schema, JSON Schema 2020-12: types, bounds, defaults, and each field's documentation."""
    schema = msgspec.json.schema(Scenario)
    for name, table in schema["$defs"].items():
        docs = field_docs().get(name, {})
        for field, told in table.get("properties", {}).items():
            if docs.get(field):
                told["description"] = docs[field]
    profile = {
        "enum": sorted(PROFILES),
        "description": "The profile that these settings start from.",
    }
    tables = schema["$defs"]
    for name in ("LinkTable", "VehicleLinks", "LinkSettings"):
        tables[name]["properties"]["profile"] = profile
    for name in ("LinkTable", "VehicleLinks"):
        for kind in LinkKind:
            tables[name]["properties"][str(kind)].pop("default", None)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Scenario of Outrider",
        **schema,
    }


def schema_text() -> str:
    """The schema as a text that ends with a line break."""
    return msgspec.json.format(msgspec.json.encode(scenario_schema()), indent=2).decode() + "\n"
