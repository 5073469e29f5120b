"""Axis labels of a scenario's fields, with units."""

import math
from pathlib import PurePath
from typing import TypeGuard

_LINK = {
    "delay": ("delay", "s"),
    "jitter": ("jitter", "s"),
    "max_jitter": ("largest jitter", "s"),
    "jitter_time": ("correlation time of the jitter", "s"),
    "loss": ("loss", "%"),
    "burst_length": ("burst length", "s"),
    "burst_interval": ("burst interval", "s"),
    "burst_loss": ("loss in bursts", "%"),
    "blackout_length": ("blackout length", "s"),
    "blackout_interval": ("blackout interval", "s"),
    "duplicates": ("duplicates", "%"),
    "reorder": ("reordering", "%"),
    "reorder_delay": ("reordering delay", "s"),
    "bandwidth": ("bandwidth", "1/s"),
    "trace": ("recording", ""),
}
_FIELDS = {
    "dt": ("tick length", "s"),
    "duration": ("duration", "s"),
    "command_timeout": ("command timeout", "s"),
    "detections.noise": ("detection noise per axis", "m"),
    "detections.dropout": ("missed detections", "%"),
    "detections.rate": ("detection rate", "1/s"),
    "visibility.radius": ("visibility radius r_v", "m"),
    "coverage.desired": ("desired coverage C*", ""),
    "sensor.range": ("sensor range", "m"),
    "area.cell": ("cell size", "m"),
    "links.profile": ("network profile", ""),
    "wind.gust": ("wind gusts per axis", "m/s²"),
    "law.parameters.speed_gain": ("speed gain k_v", ""),
    "law.parameters.weight_gain": ("weight gain k_β", ""),
    "law.parameters.circle_rate": ("circle rate", "rad/s"),
    "law.parameters.circle_radius": ("circle radius", "m"),
    "law.parameters.reference_speed": ("reference speed v_ref", "m/s"),
}
_ENDINGS = {
    "max_speed": ("largest speed", "m/s"),
    "max_acceleration": ("largest acceleration", "m/s²"),
}


def _named(field: str) -> tuple[str, str]:
    """Return label and unit of a field; its name without unit if it is not in the tables."""
    head, _, last = field.rpartition(".")
    link, _, kind = head.rpartition(".")
    if link == "links" and last in _LINK:
        label, unit = _LINK[last]
        return f"{label} of the {kind}", unit
    if field in _FIELDS:
        return _FIELDS[field]
    if last in _ENDINGS:
        label, unit = _ENDINGS[last]
        return f"{label}, {head}", unit
    return field, ""


def label_of(field: str) -> str:
    """Return the label of a field with its unit, such as `delay of the detections [s]`."""
    label, unit = _named(field)
    return f"{label} [{unit}]" if unit else label


def number(value: float, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, without exponent."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def is_number(value: object) -> TypeGuard[int | float]:
    """Return true for a number; a bool is not a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def tick_of(field: str, value: object) -> str:
    """Return the text of a value on the axis, without unit; shares in per cent."""
    if value is None:
        return "none"
    if not is_number(value):
        text = str(value).lower() if isinstance(value, bool) else str(value)
        return PurePath(text).stem if field.endswith(".trace") else text
    return number(100.0 * value if _named(field)[1] == "%" else float(value))


def value_of(field: str, value: object) -> str:
    """Return the text of a value with its unit."""
    unit = _named(field)[1] if isinstance(value, int | float) else ""
    return f"{tick_of(field, value)} {unit}".strip()
