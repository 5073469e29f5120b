"""Faults of a scenario, in one line each: the field, its value, what is wrong, what is allowed."""

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
    """The text with everything escaped that does not print: line breaks, control characters, lone surrogates."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text
    )


def toml_value(value: object, depth: float = math.inf) -> str:
    """A value as TOML writes it, on one line; what lies deeper than so many levels is left out."""
    if depth < 0:
        return "..."
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int) and value.bit_length() > _LONGEST_INT_BITS:
        return hex(value)  # Python refuses to write very long numbers in decimals
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(part, depth - 1) for part in value)}]"
    if isinstance(value, dict):
        entries = (f"{key} = {toml_value(part, depth - 1)}" for key, part in value.items())
        return f"{{{', '.join(entries)}}}"
    return str(value)


def short(text: str) -> str:
    """The text on one line and not too long."""
    line = one_line(text)
    return line if len(line) <= _LONGEST_VALUE else f"{line[: _LONGEST_VALUE - 3]}..."


def shown(value: object) -> str:
    """A value as TOML writes it, on one line and not too long."""
    return short(toml_value(value, _DEEPEST_VALUE))


def near(word: str, known: Sequence[str]) -> str:
    """The known word that was probably meant, as a question; empty where none is near."""
    found = get_close_matches(word, known, n=1)
    return f", did you mean {found[0]!r}?" if found else ""


class Fault(NamedTuple):
    """A reason to refuse a scenario."""

    field: str
    """Such as `uav.0.max_speed`."""
    value: object
    """None: it has none."""
    wrong: str
    allowed: str

    def line(self, file: str) -> str:
        """`FILE: field = VALUE: what is wrong; allowed: what is allowed`."""
        value = "" if self.value is None else f" = {shown(self.value)}"
        return one_line(
            f"{file}: {short(self.field)}{value}: {self.wrong}; allowed: {self.allowed}"
        )

    def error(self, file: str) -> ScenarioError:
        """The exception to raise."""
        return ScenarioError(self.line(file))


def unknown_name(field: str, name: str, known: Iterable[str]) -> Iterator[Fault]:
    """The fault of a name that is none of those that are known."""
    names = tuple(known)
    if name not in names:
        yield Fault(field, name, f"unknown{near(name, names)}", ", ".join(names))


def is_whole(number: float, tolerance: float) -> bool:
    """Tells whether a number is a whole one, 1 or more, but for rounding."""
    return math.isfinite(number) and round(number) >= 1 and abs(number - round(number)) <= tolerance
