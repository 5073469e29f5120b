"""Entries of the environment's observations and state: name, meaning, unit, range.

Arrays, spaces, docstrings and the documentation are generated from these tables. SI units; positions are in the world
frame, relative positions are p_delta = p_a - p_g. The tables keep the information contract of `bus.messages`: a
vehicle's row holds its own state and its perception. The state's tables hold the truth, which no vehicle reads.
"""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from bus.messages.scenario import Area

_Class = TypeVar("_Class", bound=type)

Row = npt.NDArray[np.floating[Any]]
"""Row as an array, float64 or float32."""


class Entry(NamedTuple):
    """One entry of a row."""

    name: str
    meaning: str
    unit: str
    """Unit; empty for a dimensionless number."""
    low: str
    """Lower bound: 0, 1 or a name of `SYMBOLS`, with a minus sign if it is negative."""
    high: str
    """Upper bound."""


Table = tuple[Entry, ...]
"""Entries of a row, in order."""

SYMBOLS = {
    "T": "length of an episode [s]",
    "W": "width of the area [m]",
    "H": "height of the area [m]",
    "v_max": "maximum speed of the vehicle [m/s], at most D in one tick",
    "d_max": "largest observed relative position [m]: for a detection the sensor's range plus the largest noise, at "
    "most D; for an estimate D",
    "D": "diagonal of the area [m]",
    "z_max": "maximum altitude of the UAV [m]",
    "w_max": "maximum climb rate of the UAV [m/s]",
    "E": "2 C*^2 W H, more than e(t) can ever be [m^2]",
}
"""Meaning of the symbols in the ranges."""

_TIME = Entry("time", "time since the start of the episode", "s", "0", "T")
_AGE = Entry("age", "age of the newest detection; T before the first", "s", "0", "T")
_UNDERWAY = Entry("underway", "1 until the last goal is reached, else 0", "", "0", "1")


def _planar_state(whose: str) -> Table:
    """Return the entries for position and velocity of a vehicle."""
    return (
        Entry("x", f"{whose}position, x", "m", "0", "W"),
        Entry("y", f"{whose}position, y", "m", "0", "H"),
        Entry("vx", f"{whose}velocity, x", "m/s", "-v_max", "v_max"),
        Entry("vy", f"{whose}velocity, y", "m/s", "-v_max", "v_max"),
    )


UAV: Table = (
    _TIME,
    *_planar_state("own "),
    Entry("detected", "1 if a detection arrived at this tick, else 0", "", "0", "1"),
    Entry("relative_x", "detected p_a - p_g, x; 0 without a detection", "m", "-d_max", "d_max"),
    Entry("relative_y", "detected p_a - p_g, y; 0 without a detection", "m", "-d_max", "d_max"),
    _AGE,
)
"""Observation of a UAV: its own state, and the newest detection of the UGV."""

ALTITUDE: Table = (
    Entry("altitude", "own altitude above the ground", "m", "0", "z_max"),
    Entry("climb_rate", "own climb rate", "m/s", "-w_max", "w_max"),
)
"""Further entries of a UAV that has an altitude, after `UAV`; also at the end of its state."""

GRADIENT: Table = tuple(
    Entry(
        f"gradient_{axis}",
        f"u_cov of (6) at the estimate, normalized by the size of its integrand, {axis}; 0 without an estimate",
        "",
        "-1",
        "1",
    )
    for axis in "xy"
)
"""Optional entries of a UAV's observation: the direction of uncovered ground, on its own map."""


def _role(prefix: str, whose: str) -> Table:
    """Return the entries of a role."""
    return tuple(
        Entry(f"{prefix}{name}", f"1 if {whose}role is {role}, else 0", "", "0", "1")
        for name, role in (
            ("is_scout", "SCOUT"),
            ("is_relief", "RELIEF"),
            ("is_guard", "GUARD"),
            ("is_away", "AWAY"),
        )
    )


TEAM: Table = (
    *_role("", "the own "),
    Entry("charge", "share of the endurance that is left; 1 if it is unlimited", "", "0", "1"),
    Entry("measured", "1 after the team's first measurement of the UGV, else 0", "", "0", "1"),
    Entry("measured_x", "own position minus the UGV's newest measured one, x", "m", "-D", "D"),
    Entry("measured_y", "own position minus the UGV's newest measured one, y", "m", "-D", "D"),
    Entry("measured_age", "age of this measurement; T before the first", "s", "0", "T"),
)
"""Further entries of a UAV of a team, at the end."""

MATE: Table = (
    Entry("mate_heard", "1 after the team-mate's first message, else 0", "", "0", "1"),
    Entry("mate_x", "own position minus the team-mate's in its newest message, x", "m", "-D", "D"),
    Entry("mate_y", "own position minus the team-mate's in its newest message, y", "m", "-D", "D"),
    *_role("mate_", "the team-mate's "),
    Entry("mate_age", "age of its newest message; T before the first", "s", "0", "T"),
)
"""Entries for each team-mate, in name order, after `TEAM`; the names end in its number, from `mate_heard_0` on."""


def team_table(mates: int) -> Table:
    """Return the entries of a UAV in a team of this number of UAVs; none for 0."""
    others = tuple(
        entry._replace(name=f"{entry.name}_{k}") for k in range(mates - 1) for entry in MATE
    )
    return (TEAM if mates else ()) + others


TEAM_STATE: Table = TEAM[:5]
"""Further entries of the true state of a UAV of a team: role and charge."""

OMITTED: Mapping[str, tuple[str, ...]] = {"time": ("time",), "position": ("x", "y")}
"""Entries of a UAV's row that can be left out, by the name of the part."""

UGV: Table = (
    _TIME,
    *_planar_state("own "),
    _UNDERWAY,
    Entry("goal_x", "goal, x; the last goal remains when reached; 0 without goals", "m", "0", "W"),
    Entry("goal_y", "goal, y; the last goal remains when reached; 0 without goals", "m", "0", "H"),
)
"""Observation of a UGV: its own state, and its own goal."""

HEADING: Table = (
    Entry("heading_x", "own heading, x: its cosine", "", "-1", "1"),
    Entry("heading_y", "own heading, y: its sine", "", "-1", "1"),
)
"""Further entries of a UGV that steers, after `UGV`; also at the end of its state."""


def ugv_table(*, steers: bool) -> Table:
    """Return the entries of a UGV's row; `steers`: it moves along its heading only."""
    return UGV + HEADING if steers else UGV


STATE: Table = (
    _TIME,
    Entry("covered", "share of the area with C >= C*", "", "0", "1"),
    Entry("seen", "mean of min(C / C*, 1) over the area", "", "0", "1"),
)
"""Entries of the state that belong to no single vehicle; they come first."""

UAV_STATE: Table = (
    *_planar_state(""),
    Entry("distance", "true distance from its UGV", "m", "0", "D"),
    Entry("coverage_error", "e(t) of (4) with the true p_g", "m^2", "0", "E"),
    _AGE,
)
"""True state of one UAV and its UGV."""

UGV_STATE: Table = (
    *_planar_state(""),
    _UNDERWAY,
    Entry("goal_x", "goal, x", "m", "0", "W"),
    Entry("goal_y", "goal, y", "m", "0", "H"),
)
"""True state of one UGV."""


def names(table: Table) -> tuple[str, ...]:
    """Return the names of the entries, in order."""
    return tuple(entry.name for entry in table)


def by_name(table: Table, rows: npt.ArrayLike) -> dict[str, Any]:
    """Return the entries of rows by name; views if the rows are an array.

    Args:
        table: The entries.
        rows: Shape (..., entries).
    """
    return dict(zip(names(table), np.moveaxis(np.asarray(rows), -1, 0), strict=True))


def without(table: Table, omit: Iterable[str]) -> Table:
    """Return the table without the parts of `OMITTED` that are named."""
    left_out = [name for part in omit for name in OMITTED[part]]
    return tuple(entry for entry in table if entry.name not in left_out)


def record_type(table: Table) -> np.dtype[np.void]:
    """Return the dtype of a structured array whose records are rows; `as_rows` returns them as plain numbers."""
    return np.dtype([(entry.name, np.float64) for entry in table], align=True)


def as_rows(records: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """Return a view of records as rows, from shape (...) to (..., entries)."""
    return records.view(np.float64).reshape(*records.shape, -1)


def bounds(table: Table, extent: Mapping[str, float]) -> tuple[list[float], list[float]]:
    """Return the lower and upper bounds of a row.

    Args:
        table: The entries.
        extent: Values of `SYMBOLS`.
    """
    values = {"0": 0.0, "1": 1.0, **extent}

    def value(symbol: str) -> float:
        return -values[symbol[1:]] if symbol.startswith("-") else values[symbol]

    return [value(entry.low) for entry in table], [value(entry.high) for entry in table]


ROUNDING = 1.0 + 2.0**-50
"""Factor on a bound of a vector's length: rounding may let components exceed the length."""


def clipped(table: Table, row: Row, area: Area, dt: float) -> Row:
    """Return a row with clipped velocity and relative position, as in every observation.

    Only values without information change: relative positions beyond the area's diagonal (a diverged estimate,
    unlimited noise), and speeds at which an unlimited vehicle crosses the area in one tick.

    Args:
        table: The entries.
        row: Shape (entries,).
        area: Area Q.
        dt: Duration of a tick [s].
    """
    unlimited = dict.fromkeys(SYMBOLS, math.inf)
    return np.clip(row, *bounds(table, unlimited | largest(area, dt)))


def largest(area: Area, dt: float) -> dict[str, float]:
    """Return the values of `D`, and of `d_max` and `v_max` if nothing else bounds them.

    Args:
        area: Area Q.
        dt: Duration of a tick [s].
    """
    diagonal = math.hypot(area.width, area.height) * ROUNDING
    return {"D": diagonal, "d_max": diagonal, "v_max": diagonal / dt}


def markdown(table: Table) -> str:
    """Return the table in Markdown: index, name, meaning, unit, range."""
    lines = ["| index | name | meaning | unit | range |", "|---|---|---|---|---|"]
    for index, (name, meaning, unit, low, high) in enumerate(table):
        lines.append(f"| {index} | `{name}` | {meaning} | {unit or '-'} | {low} … {high} |")
    return "\n".join(lines)


TABLES = {
    "uav_observation": UAV,
    "altitude_observation": ALTITUDE,
    "gradient_observation": GRADIENT,
    "team_observation": TEAM,
    "mate_observation": MATE,
    "ugv_observation": UGV,
    "heading_observation": HEADING,
    "common_state": STATE,
    "uav_state": UAV_STATE,
    "ugv_state": UGV_STATE,
}
"""Tables by their marks in the documentation."""


def with_tables(tables: Mapping[str, Table]) -> Callable[[_Class], _Class]:
    """Return a decorator that appends tables, each below its title, to a class's docstring, for `help`."""

    def decorate(cls: _Class) -> _Class:
        if cls.__doc__ is not None:  # python -OO removes it
            parts = (f"{title}:\n\n{markdown(table)}" for title, table in tables.items())
            cls.__doc__ = "\n\n".join((inspect.cleandoc(cls.__doc__), *parts))
        return cls

    return decorate


def state_names(vehicles: Iterable[tuple[str, Table]]) -> list[str]:
    """Return the names of the state's entries: first the common ones, then each vehicle's, such as `uav_0.x`."""
    return [
        *names(STATE),
        *(f"{name}.{entry}" for name, table in vehicles for entry in names(table)),
    ]
