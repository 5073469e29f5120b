"""Reading of TOML text and raw values into structs; each fault is reported in one line."""

import datetime
import re
import tomllib
from collections.abc import Iterator
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from bus.errors import ScenarioError
from bus.registry import HAZARDS
from sim.input.faults import Fault, near, one_line, short

Typed = TypeVar("Typed", bound=msgspec.Struct)

_BETWEEN_KEYS = re.compile(r"[=,{}\[\]\n]")
_MOST_PARTS = 64
_LARGEST_NUMBER = 1e12
_KINDS = {
    "float": "a number",
    "int": "a whole number",
    "bool | int | float": "a number, or true or false",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}
"""Names of msgspec's types for users."""
_NEEDED = {
    "uav": "one table [[uav]] or more",
    "ugv": "one table [[ugv]] or more",
    "kind": ", ".join(HAZARDS),
    "count": "a whole number",
    "radius": "[smallest, largest] in m",
    "polygon": "[[x, y], [x, y], [x, y], ...] in m",
    "block": "[smallest, largest] in m",
    "street": "a number in m",
    "building_field.height": "[smallest, largest] in m",
    "height": "a number in m",
}
"""Allowed values of required fields that are not points, by name; before that, by table and name."""
_GIVEN: tuple[tuple[tuple[type, ...], str], ...] = (
    ((bool,), "a truth value"),
    ((int, float), "a number"),
    ((str,), "text"),
    ((list, tuple), "a list"),
    ((dict,), "a table"),
    ((datetime.date, datetime.time), "a date or time"),
    ((type(None),), "no value"),
)
"""Kinds of given values, in words; the first that fits."""
_MEANT = {
    "escorts": "the name of one UGV, as each UAV escorts one",
    "driver": "the name of one driver",
    "model": "the name of one model",
}
"""Allowed values of fields whose type alone would not say what is meant."""
_NAME_RULE = "lower-case letters, digits and '_', starting with a letter, at most 32"


def parse_toml(text: str, *, file: str) -> dict[str, Any]:
    """Return the values of a TOML text.

    Raises:
        ScenarioError: If it is not TOML.
    """
    # tomllib takes hours for a key of a million parts
    if any(piece.count(".") >= _MOST_PARTS for piece in _BETWEEN_KEYS.split(text)):
        raise ScenarioError(
            f"{file}: a key of more than {_MOST_PARTS} parts; allowed: the fields of a scenario"
        )
    try:
        return tomllib.loads(text)
    # a ValueError of another kind: a number of more than 4300 digits
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{file}: not TOML: {short(str(error))}; allowed: TOML 1.0") from error


def _as_python(value: object) -> object:
    """Convert NumPy's numbers and arrays."""
    tolist = getattr(value, "tolist", None)
    if tolist is None:
        raise TypeError(f"{type(value).__name__} is not a number, text, list or table")
    plain: object = tolist()
    return plain


def as_raw(value: object, *, file: str) -> Any:  # noqa: ANN401 - as TOML would have given it
    """Convert a Python value to plain TOML values: a copy, without structs and NumPy types.

    Raises:
        ScenarioError: If it contains a value without a TOML equivalent.
    """
    try:
        return msgspec.to_builtins(value, enc_hook=_as_python, str_keys=True)
    except (TypeError, RecursionError) as error:
        raise ScenarioError(
            f"{file}: {one_line(str(error))}; allowed: numbers, text, lists and tables"
        ) from error


def typed(raw: object, kind: type[Typed], *, file: str, every: bool = False) -> Typed:
    """Convert raw values to a struct.

    Args:
        raw: Values as TOML gives them.
        kind: Type of the struct.
        file: Name of the file for error messages.
        every: True: report every fault, not the first one only.

    Raises:
        ScenarioError: For an unknown key, or a value of a wrong type or out of bounds.
    """
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        lines = {_fault(str(error), raw, kind).line(file): True}
        if every and isinstance(raw, dict):
            lines |= {_fault(one, raw, kind).line(file): True for one in _messages(raw, kind)}
        raise ScenarioError(*lines) from error


def type_fault(raw: object, kind: type[msgspec.Struct]) -> Fault | None:
    """Return the fault of the first invalid value; None if all are valid."""
    try:
        msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        return _fault(str(error), raw, kind)
    return None


def _messages(raw: dict[str, Any], kind: type[msgspec.Struct], where: str = "$") -> Iterator[str]:
    """Yield msgspec's message for each invalid field of a table at `where`; msgspec itself stops at the first one."""
    at = f" - at `{where}`" if where != "$" else ""
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind)}
    yield from (f"Object contains unknown field `{name}`{at}" for name in raw if name not in fields)
    for name, field in fields.items():
        if name not in raw:
            if field.required:
                yield f"Object missing required field `{name}`{at}"
            continue
        value, table, found = raw[name], _table(field.type), False
        parts = enumerate(value) if isinstance(value, list) else [(None, value)]
        for k, part in parts:
            if table is not None and isinstance(part, dict):
                inside = f"{where}.{name}" if k is None else f"{where}.{name}[{k}]"
                for message in _messages(part, table, inside):
                    found = True
                    yield message
        if not found:
            try:
                msgspec.convert(value, field.type)
            except msgspec.ValidationError as error:
                text, _, rest = str(error).partition(" - at `$")
                yield f"{text} - at `{where}.{name}{rest or '`'}"


def _table(kind: object) -> type[msgspec.Struct] | None:
    """Return the struct of a field's table, or of a list's tables; None: the field holds none."""
    info = inspect.type_info(kind)
    if isinstance(info, inspect.VarTupleType):
        info = info.item_type
    if isinstance(info, inspect.UnionType):  # a table that may be missing
        info = next((one for one in info.types if isinstance(one, inspect.StructType)), info)
    return info.cls if isinstance(info, inspect.StructType) else None


def _fault(message: str, raw: Any, kind: type[msgspec.Struct]) -> Fault:  # noqa: ANN401 - any value
    """Convert an error of msgspec: `Expected X, got Y - at $.uav[0].max_speed`."""
    text, _, where = message.rpartition(" - at `$.") if message.endswith("`") else ("", "", "")
    path = where.rstrip("`").replace("[", ".").replace("]", "").split(".") if text else []
    path = [part for part in path if part]
    for part in path:
        raw = raw[int(part)] if isinstance(raw, list | tuple) else raw[part]
    text, location = text or message, ".".join(path)
    if text.startswith("Object "):
        key = text.partition("`")[2].removesuffix("`")
        field = f"{location}.{key}" if location else key
        if "missing" in text:
            needed = _NEEDED.get(f"{path[0]}.{key}" if path else key, _NEEDED.get(key))
            return Fault(field, None, "missing", needed or "[x, y] in m")
        fields = _fields(kind, path)
        meant = near(key, fields)
        if not meant and "parameters" in fields:
            meant = f", did you mean '{location}.parameters.{key}'?"
        return Fault(field, raw[key], f"unknown field{meant}", ", ".join(fields))
    if where.endswith("[...]`"):  # msgspec does not name the entry of a table
        entry = next(name for name, value in raw.items() if not _is_number(value))
        location, raw = f"{location}.{entry}", raw[entry]
    return Fault(location, raw, *_wrong_and_allowed(text, location, raw))


def _fields(kind: type[msgspec.Struct], path: list[str]) -> list[str]:
    """Return the field names of the struct at this path."""
    info = inspect.type_info(kind)
    for part in path:
        if isinstance(info, inspect.VarTupleType):
            info = info.item_type
        elif isinstance(info, inspect.StructType):
            info = next(field.type for field in info.fields if field.encode_name == part)
        if isinstance(info, inspect.UnionType):  # a table that may be missing
            info = next((one for one in info.types if hasattr(one, "fields")), info)
    return [field.encode_name for field in info.fields] if hasattr(info, "fields") else []


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= _LARGEST_NUMBER


def _kind_of(value: object) -> str:
    """Return the kind of a value in words."""
    return next((name for kinds, name in _GIVEN if isinstance(value, kinds)), "another type")


def _wrong_and_allowed(text: str, field: str, value: object) -> tuple[str, str]:
    """Convert `Expected X rule, got Y`."""
    if not text.startswith("Expected `"):
        return text.lower(), "a number that a float can hold"
    expected, _, got = text.removeprefix("Expected `").partition(", got ")
    name, _, rule = expected.partition("`")
    name = name.removesuffix(" | null")
    kind = _KINDS.get(name, name)
    if "matching" in rule:
        return "not a name", _NAME_RULE
    if name == "array" and got == "`object`":
        return "a single table", f"a list, in TOML [[{field}]]"
    if not got.startswith("`"):
        return "out of bounds", f"{kind}{rule}"
    if name == "int" and isinstance(value, float):
        return "not whole", f"{kind}{rule}"
    return _kind_of(value), _MEANT.get(field.rpartition(".")[2], f"{kind}{rule}")
