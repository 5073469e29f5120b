"""Heights of buildings in OpenStreetMap's and Overture's properties."""

import math
import re
from collections.abc import Mapping

STOREY = 3.0
"""Height of a storey [m]."""
HIGHEST = 1000.0
"""Largest height that is taken for a real one [m]."""
_FOOT, _INCH = 0.3048, 0.0254
_NUMBER = r"(\d+(?:[.,]\d+)?)"
_METRES = re.compile(rf"{_NUMBER}\s*(?:m|metres?|meters?)?")
_FEET = re.compile(rf"{_NUMBER}\s*(?:'|ft|feet|foot)(?:\s*{_NUMBER}\s*(?:\"|''|in))?")
_HEIGHTS = ("height", "building:height")
_LEVELS = ("building:levels", "num_floors")


def height_of(properties: Mapping[str, object]) -> tuple[float | None, str]:
    """Return the height of a building, and where it is from.

    Args:
        properties: Properties of its feature.

    Returns:
        Its height [m]; None: none is given. The source: `height`, `levels`, `unreadable` or `missing`.
    """
    unreadable = False
    for names, metres in ((_HEIGHTS, 1.0), (_LEVELS, STOREY)):
        for name in names:
            value = properties.get(name)
            if value is None or value == "":
                continue
            number = _number(value)
            if number is not None and metres != 1.0:
                number = metres * (number + _roof_levels(properties))
            if number is not None and 0.0 < number <= HIGHEST:
                return number, "height" if metres == 1.0 else "levels"
            unreadable = True
    return None, "unreadable" if unreadable else "missing"


def _roof_levels(properties: Mapping[str, object]) -> float:
    """Return the storeys inside the roof, which `building:levels` does not count."""
    number = _number(properties.get("roof:levels"))
    return number if number is not None and 0.0 < number <= 10.0 else 0.0


def _number(value: object) -> float | None:
    """Return a number in metres, or of storeys; None: the value is no finite number."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        number = float(value) if abs(value) < 1e9 else math.inf
        return number if math.isfinite(number) else None
    if not isinstance(value, str):
        return None
    text = value.strip().lower()
    if found := _METRES.fullmatch(text):
        return float(found[1].replace(",", "."))
    if found := _FEET.fullmatch(text):
        inches = float((found[2] or "0").replace(",", "."))
        return _FOOT * float(found[1].replace(",", ".")) + _INCH * inches
    return None
