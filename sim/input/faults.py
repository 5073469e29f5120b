"""Faults of a scenario in one line: the field, its value, what is wrong, what is allowed."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from typing import NamedTuple

from bus.errors import ScenarioError

_LONGEST_VALUE = 80
_DEEPEST_VALUE = 4
_LONGEST_INT_BITS = 256


def one_line(text: str) -> str:
    """Return the text with all unprintable characters escaped: line breaks, control characters, lone surrogates."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text
    )


def toml_value(value: object, depth: float = math.inf) -> str:
    """Return a value in TOML notation, on one line; levels below `depth` are omitted."""
    if depth < 0:
        return "..."
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int) and value.bit_length() > _LONGEST_INT_BITS:
        return hex(value)  # Python does not print very long integers in decimal
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(part, depth - 1) for part in value)}]"
    if isinstance(value, dict):
        entries = (f"{key} = {toml_value(part, depth - 1)}" for key, part in value.items())
        return f"{{{', '.join(entries)}}}"
    return str(value)


def short(text: str) -> str:
    """Return the text on one line, shortened if necessary."""
    line = one_line(text)
    return line if len(line) <= _LONGEST_VALUE else f"{line[: _LONGEST_VALUE - 3]}..."


def shown(value: object) -> str:
    """Return a value in TOML notation, on one line, shortened if necessary."""
    return short(toml_value(value, _DEEPEST_VALUE))


def near(word: str, known: Sequence[str]) -> str:
    """Return a suggestion for a misspelled name, as a question; empty if no known name is similar."""
    found = get_close_matches(word, known, n=1)
    return f", did you mean {found[0]!r}?" if found else ""


class Fault(NamedTuple):
    """Reason to reject a scenario."""

    field: str
    """Path of the field, such as `uav.0.max_speed`."""
    value: object
    """Value of the field; None: no value."""
    wrong: str
    allowed: str

    def line(self, file: str) -> str:
        """Return `FILE: field = VALUE: what is wrong; allowed: what is allowed`."""
        value = "" if self.value is None else f" = {shown(self.value)}"
        return one_line(
            f"{file}: {short(self.field)}{value}: {self.wrong}; allowed: {self.allowed}"
        )

    def error(self, file: str) -> ScenarioError:
        """Return the exception to raise."""
        return ScenarioError(self.line(file))


def unknown_name(field: str, name: str, known: Iterable[str]) -> Iterator[Fault]:
    """Yield a fault if a name is unknown."""
    names = tuple(known)
    if name not in names:
        yield Fault(field, name, f"unknown{near(name, names)}", ", ".join(names))


def is_whole(number: float, tolerance: float) -> bool:
    """Return whether a number is a positive integer, within the tolerance."""
    return math.isfinite(number) and round(number) >= 1 and abs(number - round(number)) <= tolerance
