"""Each observation array once: index, name, meaning, unit, range. Environment, wrappers and documentation read it here.

A row is a `NamedTuple` whose fields, in order, are the array's entries; behind each stands its `Field`. SI units;
positions are in the world frame, relative positions are p_delta = p_a - p_g. The rows keep the information contract of
`bus.messages`: a vehicle's row holds its own state and what it perceives. The rows of the state hold the truth, and no
vehicle reads them.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
import numpy.typing as npt

from bus.messages import Detection, UavObservation, UgvObservation

Row = npt.NDArray[np.floating[Any]]
"""A row as an array, float64 or float32."""


class Field(NamedTuple):
    """One entry of an array."""

    meaning: str
    unit: str
    """Empty where it has none."""
    low: str
    """Least value: 0, 1 or a name of `SYMBOLS`, with a minus where it is negative."""
    high: str
    """Largest value."""


SYMBOLS = {
    "T": "length of an episode [s]",
    "W": "width of the area [m]",
    "H": "height of the area [m]",
    "v_max": "largest speed of the vehicle [m/s]",
    "d_max": "longest relative position that a detection can have [m]: the sensor's range, plus the noise up to "
    "its cut",
    "D": "diagonal of the area [m]",
    "E": "2 C*^2 W H, more than e(t) can ever be [m^2]",
}
"""The meaning of the names in the ranges. A bound that a scenario leaves open is infinite."""


class UavRow(NamedTuple):
    """A UAV's observation: its own state, and its detector's last look at the UGV."""

    time: Annotated[float, Field("time since the start of the episode", "s", "0", "T")]
    x: Annotated[float, Field("own position, x", "m", "0", "W")]
    y: Annotated[float, Field("own position, y", "m", "0", "H")]
    vx: Annotated[float, Field("own velocity, x", "m/s", "-v_max", "v_max")]
    vy: Annotated[float, Field("own velocity, y", "m/s", "-v_max", "v_max")]
    detected: Annotated[
        float, Field("1 where a detection has come at this tick, else 0", "", "0", "1")
    ]
    relative_x: Annotated[
        float, Field("detected p_a - p_g, x; 0 where none has come", "m", "-d_max", "d_max")
    ]
    relative_y: Annotated[
        float, Field("detected p_a - p_g, y; 0 where none has come", "m", "-d_max", "d_max")
    ]
    age: Annotated[
        float, Field("time since the newest detection was taken; T before the first", "s", "0", "T")
    ]


class GradientCue(NamedTuple):
    """Two more entries that a UAV's row may end with: where it would see most that is new, as far as it knows."""

    gradient_x: Annotated[
        float,
        Field(
            "u_cov of (6) at the estimate, over the size of its integrand, x; 0 without one",
            "",
            "-1",
            "1",
        ),
    ]
    gradient_y: Annotated[
        float,
        Field(
            "u_cov of (6) at the estimate, over the size of its integrand, y; 0 without one",
            "",
            "-1",
            "1",
        ),
    ]


class UgvRow(NamedTuple):
    """A UGV's observation: its own state, and its own goal."""

    time: Annotated[float, Field("time since the start of the episode", "s", "0", "T")]
    x: Annotated[float, Field("own position, x", "m", "0", "W")]
    y: Annotated[float, Field("own position, y", "m", "0", "H")]
    vx: Annotated[float, Field("own velocity, x", "m/s", "-v_max", "v_max")]
    vy: Annotated[float, Field("own velocity, y", "m/s", "-v_max", "v_max")]
    underway: Annotated[float, Field("1 while a goal is still to be reached, else 0", "", "0", "1")]
    goal_x: Annotated[
        float, Field("goal, x; the last one stays when reached; 0 without goals", "m", "0", "W")
    ]
    goal_y: Annotated[
        float, Field("goal, y; the last one stays when reached; 0 without goals", "m", "0", "H")
    ]


class UavState(NamedTuple):
    """The truth of one UAV and its escort."""

    x: Annotated[float, Field("position, x", "m", "0", "W")]
    y: Annotated[float, Field("position, y", "m", "0", "H")]
    vx: Annotated[float, Field("velocity, x", "m/s", "-v_max", "v_max")]
    vy: Annotated[float, Field("velocity, y", "m/s", "-v_max", "v_max")]
    distance: Annotated[float, Field("true distance from its UGV", "m", "0", "D")]
    coverage_error: Annotated[float, Field("e(t) of (4) with the true p_g", "m^2", "0", "E")]
    age: Annotated[
        float, Field("time since the newest detection was taken; T before the first", "s", "0", "T")
    ]


class UgvState(NamedTuple):
    """The truth of one UGV."""

    x: Annotated[float, Field("position, x", "m", "0", "W")]
    y: Annotated[float, Field("position, y", "m", "0", "H")]
    vx: Annotated[float, Field("velocity, x", "m/s", "-v_max", "v_max")]
    vy: Annotated[float, Field("velocity, y", "m/s", "-v_max", "v_max")]
    underway: Annotated[float, Field("1 while a goal is still to be reached, else 0", "", "0", "1")]
    goal_x: Annotated[float, Field("goal, x", "m", "0", "W")]
    goal_y: Annotated[float, Field("goal, y", "m", "0", "H")]


class CommonState(NamedTuple):
    """Facts of no single vehicle, at the head of the state."""

    time: Annotated[float, Field("time since the start of the episode", "s", "0", "T")]
    covered: Annotated[float, Field("share of the area with C >= C*", "", "0", "1")]
    seen: Annotated[float, Field("mean of min(C / C*, 1) over the area", "", "0", "1")]


RowType = type[UavRow | GradientCue | UgvRow | UavState | UgvState | CommonState]


def fields(row: RowType) -> dict[str, Field]:
    """The entries of a row by name, in order."""
    hints = get_type_hints(row, include_extras=True)
    return {name: hints[name].__metadata__[0] for name in row._fields}


def _value(symbol: str, extent: Mapping[str, float]) -> float:
    if symbol.startswith("-"):
        return -_value(symbol[1:], extent)
    return float(symbol) if symbol in {"0", "1"} else extent[symbol]


def bounds(row: RowType, extent: Mapping[str, float]) -> tuple[list[float], list[float]]:
    """Least and largest values of a row.

    Args:
        row: Which row.
        extent: The values of `SYMBOLS` that it needs.
    """
    entries = fields(row).values()
    return [_value(entry.low, extent) for entry in entries], [
        _value(entry.high, extent) for entry in entries
    ]


def table(row: RowType) -> str:
    """The row as a Markdown table: index, name, meaning, unit, range."""
    lines = ["| index | name | meaning | unit | range |", "|---|---|---|---|---|"]
    for index, (name, field) in enumerate(fields(row).items()):
        lines.append(
            f"| {index} | `{name}` | {field.meaning} | {field.unit or '-'} | {field.low} … {field.high} |"
        )
    return "\n".join(lines)


def state_names(vehicles: Iterable[tuple[str, RowType]]) -> list[str]:
    """The names of the state's entries: the common ones, then each vehicle's in name order, as `uav_0.x`."""
    return [
        *CommonState._fields,
        *(f"{name}.{field}" for name, row in vehicles for field in row._fields),
    ]


def uav_observation(row: Row, *, dt: float) -> UavObservation:
    """A UAV's row as the message that its pilot reads over the bus.

    Args:
        row: As `UavRow`.
        dt: Length of a tick [s].
    """
    entries = UavRow._make(row.tolist())
    tick = round(entries.time / dt)
    taken = tick - round(entries.age / dt)
    found = Detection(time=taken * dt, relative_position=(entries.relative_x, entries.relative_y))
    return UavObservation(
        tick=tick,
        time=tick * dt,
        position=(entries.x, entries.y),
        velocity=(entries.vx, entries.vy),
        detections=(found,) if entries.detected else (),
    )


def ugv_observation(row: Row, *, dt: float) -> UgvObservation:
    """A UGV's row as the message that its pilot reads over the bus; arguments as `uav_observation`."""
    entries = UgvRow._make(row.tolist())
    tick = round(entries.time / dt)
    return UgvObservation(
        tick=tick,
        time=tick * dt,
        position=(entries.x, entries.y),
        velocity=(entries.vx, entries.vy),
    )
