"""From a TOML text and the changes on a command line to typed values; whatever is wrong becomes one line."""

import functools
import re
import tomllib
from collections.abc import Iterator
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from bus.errors import ScenarioError
from bus.registry import HAZARDS
from sim.input.faults import Fault, near, one_line, short, shown

Typed = TypeVar("Typed", bound=msgspec.Struct)

_TOML_FAULT = re.compile(
    r"(?P<wrong>.*) \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)",
    re.DOTALL,
)
_COMMENT = re.compile(r"^[ \t]*#.*$", re.MULTILINE)
_BETWEEN_KEYS = re.compile(r"[=,{}\[\]\n]")
_DEEPEST = 64
_LARGEST_NUMBER = 1e12
_WHERE = re.compile(r"(?P<text>.*) - at `\$(?P<path>[^`]*)`", re.DOTALL)
_EXPECTED = re.compile(
    r"Expected `(?P<kind>\w+)(?: \| null)?`(?: (?P<rule>[^,].*?))?(?:, got (?P<got>\S+))?",
    re.DOTALL,
)
_MISSING = re.compile(r"Object missing required field `(?P<field>\w+)`")
_KINDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}
_NEEDED = {
    "uav": "one table [[uav]] or more",
    "ugv": "one table [[ugv]] or more",
    "kind": ", ".join(HAZARDS),
    "count": "a whole number",
    "radius": "[smallest, largest] in m",
}
_NAME_RULE = "lower-case letters, digits and '_', a letter first, 32 at most"
_SET_EXAMPLE = "key=value, such as detections.noise=0.2 or uav.0.max_speed=0.5"


def parse_toml(text: str, *, file: str) -> dict[str, Any]:
    """The text's values.

    Raises:
        ScenarioError: If it is no TOML, with the line.
    """
    # tomllib takes hours over a key of a million parts
    pieces = _BETWEEN_KEYS.split(_COMMENT.sub("", text))
    if any(piece.count(".") >= _DEEPEST for piece in pieces):
        raise ScenarioError(
            f"{file}: a key of more than {_DEEPEST} parts; allowed: the fields of a scenario"
        )
    try:
        return tomllib.loads(text)
    # a ValueError of another kind: a number of more than 4300 digits
    except (ValueError, RecursionError) as error:
        raise ScenarioError(_toml_line(str(error), text, file)) from error


def _toml_line(message: str, text: str, file: str) -> str:
    """Tomllib's words in ours: the line as the field, its text as the value."""
    found = _TOML_FAULT.fullmatch(message)
    if found is None:
        return f"{file}: not TOML: {short(message)}; allowed: TOML 1.0"
    lines = text.replace("\r\n", "\n").rstrip("\n").split("\n")
    line = int(found["line"] or len(lines))
    place = f"at column {found['column']}" if found["column"] else "at the end"
    wrong = f"not TOML: {short(found['wrong'])} {place}"
    return Fault(f"line {line}", "\n".join(lines[line - 1 : line]), wrong, "TOML 1.0").line(file)


def parse_override(change: str, *, file: str) -> tuple[str, object]:
    """Key and value of a `--set key=value`; the value as TOML writes it, or else plain text.

    Raises:
        ScenarioError: If it is not of that form.
    """
    key, separator, text = change.partition("=")
    if not separator or not all(key.strip().split(".")):
        raise Fault("--set", change, "not of the form key=value", _SET_EXAMPLE).error(file)
    text = text.strip()
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return key.strip(), text
    return key.strip(), parsed["value"] if parsed.keys() == {"value"} else text


def apply_override(raw: dict[str, Any], key: str, value: object, *, file: str) -> None:
    """Put one value into the raw tables, in place; tables on the way are made where they are missing.

    Args:
        raw: As TOML gives it.
        key: A dotted path; entries of a list count from 0, and `uav.*` is all entries of the list `uav`.
        value: What to put there.
        file: For the error.

    Raises:
        ScenarioError: If the path leads through a value, or beside a list's entries.
    """
    name, star, field = key.partition(".*.")
    entries = raw.get(name)
    if star and entries and isinstance(entries, list):
        for k in range(len(entries)):
            apply_override(raw, f"{name}.{k}.{field}", value, file=file)
        return
    *way, last = key.split(".")
    table: Any = raw
    try:
        for depth, part in enumerate(way):
            place = _place(table, part, here=".".join(way[:depth]))
            table = table.setdefault(place, {}) if isinstance(table, dict) else table[place]
        table[_place(table, last, here=".".join(way))] = value
    except LookupError as found:
        wrong, allowed = found.args
        raise Fault(key, value, wrong, allowed).error(file) from None


def _place(table: object, part: str, *, here: str) -> str | int:
    """The key or index that a part of a path means in a table or list; LookupError, saying why, where it means none."""
    if isinstance(table, dict):
        return part
    if not isinstance(table, list):
        raise LookupError(
            f"{short(here)} = {shown(table)} is no table", f"a value for {short(here)} itself"
        )
    entries = [str(index) for index in range(len(table))]
    if not entries:
        raise LookupError(f"{here} has no entries", f"a value for {here} itself")
    if part not in entries:
        ends = dict.fromkeys((f"{here}.0", f"{here}.{entries[-1]}"))
        raise LookupError(f"{here} has no entry {shown(part)}", " to ".join(ends))
    return entries.index(part)


def unknown_keys(raw: object, kind: inspect.Type, path: str = "") -> Iterator[Fault]:
    """Keys that the type of this value does not know, at any depth."""
    if isinstance(kind, inspect.StructType) and isinstance(raw, dict):
        fields = {field.encode_name: field.type for field in kind.fields}
        for key, value in raw.items():
            if key not in fields:
                meant = near(key, list(fields))
                if not meant and "parameters" in fields:
                    meant = f", did you mean '{path}parameters.{key}'?"
                yield Fault(
                    f"{path}{key}",
                    value,
                    f"no such field{meant}",
                    ", ".join(fields),
                )
            else:
                yield from unknown_keys(value, fields[key], f"{path}{key}.")
    elif isinstance(kind, inspect.VarTupleType) and isinstance(raw, list):
        for index, value in enumerate(raw):
            yield from unknown_keys(value, kind.item_type, f"{path}{index}.")


def _as_python(value: object) -> object:
    """NumPy's numbers and arrays as Python's."""
    tolist = getattr(value, "tolist", None)
    if tolist is None:
        raise TypeError(f"{type(value).__name__} is no number, text, list or table")
    plain: object = tolist()
    return plain


def as_raw(value: object, *, file: str) -> Any:  # noqa: ANN401 - as TOML would have given it
    """A value made in Python as TOML would have given it: a copy, without structs and NumPy's types.

    Raises:
        ScenarioError: If there is something in it that TOML does not know.
    """
    try:
        return msgspec.to_builtins(value, enc_hook=_as_python, str_keys=True)
    except (TypeError, RecursionError) as error:
        raise ScenarioError(
            f"{file}: {one_line(str(error))}; allowed: numbers, text, lists and tables"
        ) from error


# It takes 1 ms, and each candidate of a search has several links to read.
_type_info = functools.cache(inspect.type_info)


def typed(raw: object, kind: type[Typed], *, file: str) -> Typed:
    """The raw values as a struct.

    Raises:
        ScenarioError: At the first unknown key, else at the first value of a wrong type or out of its bounds.
    """
    for unknown in unknown_keys(raw, _type_info(kind)):
        raise unknown.error(file)
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        raise _type_fault(str(error), raw).error(file) from error


def type_fault(raw: object, kind: type[msgspec.Struct]) -> Fault | None:
    """Return the first value of a wrong type or out of its bounds; None if all values fit."""
    try:
        msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        return _type_fault(str(error), raw)
    return None


def _type_fault(message: str, raw: object) -> Fault:
    """Msgspec's words in ours: `Expected X, got Y - at $.uav[0].max_speed`, after `unknown_keys` has found nothing."""
    found = _WHERE.fullmatch(message)
    text, where = (found["text"], found["path"]) if found else (message, "")
    path = re.findall(r"\w+", where)
    missing = _MISSING.fullmatch(text)
    if missing:
        name = missing["field"]
        return Fault(".".join([*path, name]), None, "missing", _NEEDED.get(name, "[x, y] in m"))
    for part in path:
        raw = raw[int(part)] if isinstance(raw, list | tuple) else raw[part]  # type: ignore[index]
    if where.endswith("[...]") and isinstance(raw, dict):
        name, raw = next((name, value) for name, value in raw.items() if not _is_number(value))
        path.append(name)
    return Fault(".".join(path), raw, *_expectation(text, path))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= _LARGEST_NUMBER


def _expectation(text: str, path: list[str]) -> tuple[str, str]:
    """Says what is wrong and what is allowed."""
    if text.startswith("Expected `bool | int | float`"):
        return "not a number", "a number, or true or false"
    found = _EXPECTED.fullmatch(text)
    if found is None:
        return text[0].lower() + text[1:], "a number that a float can hold"
    kind, got = _KINDS.get(found["kind"], found["kind"]), (found["got"] or "").strip("`")
    rule = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):g}", found["rule"] or "")
    if rule.startswith("matching"):
        return "no name", _NAME_RULE
    if (found["kind"], got) == ("array", "object"):
        return "a single table", f"a list, in TOML [[{'.'.join(path)}]]"
    if got.isdigit():
        return f"{got} entries", f"{kind} {rule}"
    return (f"not {kind}" if got else "out of bounds"), f"{kind} {rule}".strip()
