"""Changes to a scenario's raw tables by dotted keys, as in `--set`."""

import tomllib
from typing import Any

from sim.input.faults import Fault, short, shown

_SET_EXAMPLE = "key=value, such as detections.noise=0.2 or uav.0.max_speed=0.5"


_COUNT = "count"
"""Last part of the key that keeps the first entries of a list."""


def parse_override(change: str, *, file: str) -> tuple[str, object]:
    """Return key and value of a `--set key=value`; a value that is not TOML is plain text.

    Raises:
        ScenarioError: If it does not have this form.
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
    """Set one value in the raw tables, in place; missing tables on its path are created.

    Args:
        raw: Scenario as read from TOML; changed.
        key: Dotted path; entries of a list count from 0, and `uav.*` means all entries of the list `uav`. `uav.count`
            keeps the first entries of this list.
        value: New value.
        file: Name of the file for error messages.

    Raises:
        ScenarioError: If the path leads through a value, or to a missing entry of a list.
    """
    name, star, field = key.partition(".*.")
    entries = raw.get(name)
    if star and entries and isinstance(entries, list):
        for k in range(len(entries)):
            apply_override(raw, f"{name}.{k}.{field}", value, file=file)
        return
    name, _, field = key.rpartition(".")
    entries = raw.get(name)
    if field == _COUNT and isinstance(entries, list):
        _keep_first(entries, key, value, file=file)
        return
    *path, last = key.split(".")
    table: Any = raw
    try:
        for depth, part in enumerate(path):
            entry = _key_or_index(table, part, path=".".join(path[:depth]))
            table = table.setdefault(entry, {}) if isinstance(table, dict) else table[entry]
        table[_key_or_index(table, last, path=".".join(path))] = value
    except LookupError as found:
        wrong, allowed = found.args
        raise Fault(key, value, wrong, allowed).error(file) from None


def _keep_first(entries: list[Any], key: str, value: object, *, file: str) -> None:
    """Keep the first entries of a list, in place."""
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= len(entries):
        raise Fault(
            key, value, "not a number of the entries to keep", f"1 to {len(entries)}"
        ).error(file)
    del entries[value:]


def _key_or_index(table: object, part: str, *, path: str) -> str | int:
    """Return the key or index for a part of a path; raise LookupError(wrong, allowed) if there is none."""
    if isinstance(table, dict):
        return part
    if not isinstance(table, list):
        raise LookupError(
            f"{short(path)} = {shown(table)} is not a table", f"a value for {short(path)} itself"
        )
    entries = [str(index) for index in range(len(table))]
    if not entries:
        raise LookupError(f"{path} has no entries", f"a value for {path} itself")
    if part not in entries:
        ends = dict.fromkeys((f"{path}.0", f"{path}.{entries[-1]}"))
        raise LookupError(f"{path} has no entry {shown(part)}", " to ".join(ends))
    return entries.index(part)
