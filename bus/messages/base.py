"""Bounded numbers and texts, and the base class of every message."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""A component of a position [m], a velocity [m/s] or an acceleration [m/s²]."""


NonNegative = Annotated[float, Meta(ge=0.0, le=1e12)]


Positive = Annotated[float, Meta(gt=0.0, le=1e12)]


Tick = Annotated[int, Meta(ge=0, le=2**53)]


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
