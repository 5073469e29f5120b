"""Bounded numbers and texts, and the base class of every message."""

import math
from collections.abc import Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""A component of a position [m], a velocity [m/s] or an acceleration [m/s²]."""


NonNegative = Annotated[float, Meta(ge=0.0, le=1e12)]


Positive = Annotated[float, Meta(gt=0.0, le=1e12)]


Tick = Annotated[int, Meta(ge=0, le=2**53)]


MAX_SEED = 2**53 - 1
"""Largest seed of a run."""


Seed = Annotated[int, Meta(ge=0, le=MAX_SEED)]


Name = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,31}$(?!\n)")]


LONGEST_TEXT = 500
"""Maximum length of a text [characters]."""


Text = Annotated[str, Meta(max_length=LONGEST_TEXT)]


Line = Annotated[str, Meta(max_length=LONGEST_TEXT, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$(?!\n)")]
"""Text without control characters."""


PilotKey = Annotated[str, Meta(pattern=r"^[0-9a-f]{32}$(?!\n)")]
"""128-bit key as a string: JSON in some languages is exact only for integers up to 53 bits."""


Vector = tuple[Coordinate, Coordinate]


Covariance = tuple[NonNegative, Coordinate, NonNegative]
"""Entries xx, xy and yy of a symmetric 2 x 2 matrix [m²]."""


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of all messages."""


_SHARE_OF_START = 0.6
"""Share of a shortened text that its start gets; its end, with what is allowed or helps, gets the rest."""
_MOST_LINES = 50
"""Largest number of lines in a list of texts for observers."""


def fitted(text: str, length: int = LONGEST_TEXT) -> str:
    """Return a text that fits a `Text`: an ellipsis replaces whole words in the middle of a longer one.

    Characters without an encoding, as in file names, become question marks.
    """
    text = text.encode(errors="replace").decode()
    if len(text) <= length:
        return text
    room = length - len(" … ")
    first = round(_SHARE_OF_START * room)
    start, end = text[: first + 1], text[first - room - 1 :]
    start = start[:first] if " " not in start else start.rpartition(" ")[0]
    end = end[1:] if " " not in end else end.partition(" ")[2]
    return f"{start.rstrip()} … {end.lstrip()}"


def fitted_lines(lines: Sequence[str]) -> tuple[str, ...]:
    """Return lines that fit a list of texts for observers; the last line counts those left out."""
    shown = tuple(fitted(line) for line in lines[:_MOST_LINES])
    return shown if len(lines) <= _MOST_LINES else (*shown, f"… and {len(lines) - len(shown)} more")


def or_infinite(bound: float | None) -> float:
    """Return a bound of a message as a number; None becomes infinity."""
    return math.inf if bound is None else float(bound)


def or_none(bound: float) -> float | None:
    """Return a bound in the form of a message; infinity becomes None."""
    return None if math.isinf(bound) else bound


Share = Annotated[float, Meta(ge=0.0, le=1.0)]


Seconds = Annotated[float, Meta(ge=0.0, le=1e6)]


Ticks = Annotated[int, Meta(ge=0, le=1_000_000)]


Place = Annotated[int, Meta(ge=0, le=1_000_000)]
