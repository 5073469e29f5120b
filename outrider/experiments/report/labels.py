"""Names of a scenario's fields on an axis, with units."""

import math
from pathlib import PurePath
from typing import TypeGuard

_LINK = {
    "delay": ("delay", "s"),
    "jitter": ("jitter", "s"),
    "max_jitter": ("largest jitter", "s"),
    "loss": ("loss", "%"),
    "burst_length": ("length of bursts", "s"),
    "burst_interval": ("time between bursts", "s"),
    "burst_loss": ("loss in bursts", "%"),
    "blackout_length": ("length of blackouts", "s"),
    "blackout_interval": ("time between blackouts", "s"),
    "duplicates": ("duplicates", "%"),
    "reorder": ("share held back", "%"),
    "reorder_delay": ("time held back", "s"),
    "bandwidth": ("bandwidth", "1/s"),
    "trace": ("recording", ""),
}
_FIELDS = {
    "dt": ("length of a tick", "s"),
    "duration": ("duration", "s"),
    "command_timeout": ("time a command is held", "s"),
    "detections.noise": ("noise of the detections per axis", "m"),
    "detections.dropout": ("looks that fail", "%"),
    "detections.rate": ("looks", "1/s"),
    "visibility.radius": ("visibility radius r_v", "m"),
    "coverage.desired": ("desired coverage C*", ""),
    "sensor.range": ("range of the sensor", "m"),
    "area.cell": ("cell of the grid", "m"),
    "links.profile": ("profile", ""),
    "wind.gust": ("gusts of the wind per axis", "m/s²"),
    "law.parameters.speed_gain": ("speed gain k_v", ""),
    "law.parameters.weight_gain": ("weight gain k_β", ""),
    "law.parameters.circle_rate": ("rate of the circle", "rad/s"),
    "law.parameters.circle_radius": ("radius of the circle", "m"),
    "law.parameters.reference_speed": ("reference speed v_ref", "m/s"),
}
_ENDINGS = {
    "max_speed": ("largest speed", "m/s"),
    "max_acceleration": ("largest acceleration", "m/s²"),
}


def _named(field: str) -> tuple[str, str]:
    """Words and unit of a field; its own name and no unit for one that is not in the tables."""
    head, _, last = field.rpartition(".")
    link, _, kind = head.rpartition(".")
    if link == "links" and last in _LINK:
        words, unit = _LINK[last]
        return f"{words} of the {kind}", unit
    if field in _FIELDS:
        return _FIELDS[field]
    if last in _ENDINGS:
        words, unit = _ENDINGS[last]
        return f"{words}, {head}", unit
    return field, ""


def label_of(field: str) -> str:
    """Such as `delay of the detections [s]`."""
    words, unit = _named(field)
    return f"{words} [{unit}]" if unit else words


def number(value: float, digits: int = 3) -> str:
    """A number with so many digits that count, without an exponent."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def is_number(value: object) -> TypeGuard[int | float]:
    """True for a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def tick_of(field: str, value: object) -> str:
    """A value as it stands on the axis, without its unit: shares in per cent."""
    if value is None:
        return "none"
    if not is_number(value):
        text = str(value).lower() if isinstance(value, bool) else str(value)
        return PurePath(text).stem if field.endswith(".trace") else text
    return number(100.0 * value if _named(field)[1] == "%" else float(value))


def value_of(field: str, value: object) -> str:
    """A value with its unit."""
    unit = _named(field)[1] if isinstance(value, int | float) else ""
    return f"{tick_of(field, value)} {unit}".strip()
