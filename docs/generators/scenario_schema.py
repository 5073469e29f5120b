"""JSON Schema of the scenario file, from its types and the documentation of their fields.

`make reference` writes it to sim/scenario/scenario.schema.json, which the package ships.
"""

import ast
import functools
import inspect
import itertools
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec

from bus.messages import links, scenario
from bus.messages.links import LinkKind
from bus.profiles import SHIPPED
from bus.registry import LAWS
from sim.scenario import types, vehicle_types
from sim.scenario.types import Scenario

FILE = Path(types.__file__).with_name("scenario.schema.json")


def field_docs(struct: type[msgspec.Struct]) -> dict[str, str]:
    """Return the documentation of each field of a struct, fields of its bases first."""
    found: dict[str, str] = {}
    for cls in reversed(struct.__mro__):
        if cls is msgspec.Struct or not issubclass(cls, msgspec.Struct):
            continue
        body = _classes(inspect.getmodule(cls))[cls.__name__].body
        for before, after in itertools.pairwise(body):
            if (
                isinstance(before, ast.AnnAssign)
                and isinstance(before.target, ast.Name)
                and isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
            ):
                found[before.target.id] = " ".join(str(after.value.value).split())
    return found


@functools.cache
def _classes(module: ModuleType | None) -> dict[str, ast.ClassDef]:
    """Return the classes of a module in source order."""
    written = ast.parse(inspect.getsource(module)).body if module is not None else []
    return {one.name: one for one in written if isinstance(one, ast.ClassDef)}


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema 2020-12: types, limits, defaults, and each field's documentation."""
    schema = msgspec.json.schema(Scenario)
    tables = schema["$defs"]
    for name, table in tables.items():
        struct = next(
            vars(m)[name] for m in (types, vehicle_types, scenario, links) if name in vars(m)
        )
        docs = field_docs(struct) if "properties" in table else {}
        for field, entry in docs.items():
            table["properties"][field]["description"] = entry
    for name in ("Law", "OwnLaw"):
        tables[name]["properties"]["parameters"]["properties"] = law_parameters_schema()
    driver = tables["Ugv"]["properties"]["driver"]
    driver["pattern"] = f"{driver['pattern']}|^[a-z0-9_-]+:."
    file_or_package = {"type": "string", "pattern": r"^[a-z][a-z0-9_-]*$|\.[tT][oO][mM][lL](:.+)?$"}
    profile = {
        "anyOf": [{"enum": sorted(SHIPPED)}, file_or_package],
        "description": "Profile on which these settings are based.",
    }
    for name in ("LinkTable", "VehicleLinks", "LinkSettings"):
        tables[name]["properties"]["profile"] = profile
    for name in ("LinkTable", "VehicleLinks"):
        for kind in LinkKind:
            tables[name]["properties"][str(kind)].pop("default", None)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Outrider scenario",
        **schema,
    }


def law_parameters_schema() -> dict[str, Any]:
    """Return the parameters of all laws by name; a name has the same meaning in every law."""
    found: dict[str, Any] = {}
    for law in LAWS.values():
        parameters = law.parameters
        (table,) = msgspec.json.schema(parameters)["$defs"].values()
        docs = field_docs(parameters)
        for field, entry in table["properties"].items():
            default = (
                {} if entry.get("default") in (None, math.inf) else {"default": entry["default"]}
            )
            kept = {key: value for key, value in entry.items() if key != "default"}
            found[field] = kept | default | {"description": docs[field]}
    return found


def schema_text() -> str:
    """Return the schema as text with a final line break."""
    return msgspec.json.format(msgspec.json.encode(scenario_schema()), indent=2).decode() + "\n"
