"""Registry of laws, drivers, sensors, bodies and hazards: one row each, with all that other modules need.

The names appear in messages (`Law.name`, `UgvBriefing.driver`, `Control.driver`, `Sensor.model`) and in scenarios. The
tables are in the lowest layer so that the simulator, which must not import agents, checks scenarios and operators'
requests by the same rows that vehicles, command line, page and reports use. The tables import no code: a row refers to
it as `module:name`.

`CONTRIBUTING.md` shows how to add a row.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from bus import plugins
from bus.errors import OutriderError
from bus.messages.laws import (
    CircleParameters,
    CoverageParameters,
    LawParameters,
    LogarithmicParameters,
    LookaheadParameters,
    TrackingParameters,
)
from bus.plugins import load_all
from bus.rows import BodyRow, DriverRow, HazardKindRow, LawRow, SensorRow

_Row = TypeVar("_Row", bound="LawRow | DriverRow | SensorRow | BodyRow | HazardKindRow")
_Kind = TypeVar("_Kind")
_CodeRow = TypeVar("_CodeRow", bound="LawRow | DriverRow | SensorRow | BodyRow")


class _Added(NamedTuple):
    """Origin of a row that another package added."""

    group: str
    entry: str
    """Name of the entry point."""
    table: dict[str, Any]


_ADDED: dict[LawRow | DriverRow | SensorRow | BodyRow, _Added] = {}


def _table(*rows: _Row) -> dict[str, _Row]:
    """Return the rows by name.

    Raises:
        ValueError: If two rows have the same name.
    """
    names = [row.name for row in rows]
    if len(set(names)) < len(names):
        raise ValueError(f"names {names}: two rows have the same name")
    return {row.name: row for row in rows}


def _extended(group: str, kind: type[_CodeRow], *rows: _CodeRow) -> Mapping[str, _CodeRow]:
    """Return our rows and those of other packages by name; skip invalid ones, with a warning."""
    table = _table(*rows)
    for entry, row in load_all(group, kind).items():
        fault = _fault(row, table)
        if fault:
            plugins.ignore_named(group, entry, fault)
        else:
            table[row.name] = row
            _ADDED[row] = _Added(group, entry, table)
    return MappingProxyType(table)


def _fault(row: LawRow | DriverRow | SensorRow | BodyRow, table: Mapping[str, object]) -> str:
    """Describe what is wrong with a row of another package; empty if nothing is."""
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,31}", row.name):
        return f"name = {row.name!r}: wrong form; allowed: up to 32 of a-z, 0-9 and _, the first a letter"
    if row.name in table:
        return f"name = {row.name!r}: the name is taken"
    if isinstance(row, LawRow) and not _is_subclass(row.parameters, LawParameters):
        return f"parameters = {row.parameters!r}: wrong type; allowed: a subclass of LawParameters"
    if isinstance(row, BodyRow) and not row.make:
        return "make = '': missing; allowed: module:class"
    return ""


def _is_subclass(found: object, base: type) -> bool:
    return isinstance(found, type) and issubclass(found, base)


def resolve(where: str) -> Any:  # noqa: ANN401 - whatever it is
    """Import and return the object `module:name`."""
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


def module_of(row: LawRow | DriverRow | SensorRow, *needed: str) -> Any:  # noqa: ANN401 - a module
    """Import the module of a row.

    Args:
        row: The row.
        needed: Names that the module must define.

    Raises:
        OutriderError: If another package added the row, and its module cannot be used.
    """
    if row not in _ADDED:
        return import_module(row.module)
    with plugins.foreign(row.module):
        module = import_module(row.module)
        for name in needed:
            getattr(module, name)
        return module


def maker_of(row: DriverRow | BodyRow) -> Any:  # noqa: ANN401 - a class
    """Import the class of a driver's or a body's row; see `module_of`."""
    if row not in _ADDED:
        return resolve(row.make)
    with plugins.foreign(row.make):
        return resolve(row.make)


def usable(rows: Iterable[_CodeRow], load: Callable[[_CodeRow], _Kind]) -> dict[str, _Kind]:
    """Return the code of rows by name; remove a package's row whose code fails from its table, with a warning.

    Args:
        rows: Rows of one table.
        load: Function that imports the code of a row, such as `module_of`.
    """
    found: dict[str, _Kind] = {}
    for row in tuple(rows):
        try:
            found[row.name] = load(row)
        except OutriderError as error:
            if row not in _ADDED:
                raise
            group, entry, table = _ADDED.pop(row)
            del table[row.name]
            plugins.ignore_named(group, entry, error)
    return found


LAWS = _extended(
    "laws",
    LawRow,
    LawRow(
        name="tracking",
        module="agents.laws.tracking",
        parameters=TrackingParameters,
        about="follow the UGV (15), (16)",
        needs_radius=False,
        color="#a0522d",
        mark="v",
    ),
    LawRow(
        name="coverage",
        module="agents.laws.coverage",
        parameters=CoverageParameters,
        about="cover the ground (6) to (11), without returning to the UGV",
        covers=True,
        needs_radius=False,
        keeps_sight=False,
        color="#9aa531",
        mark="<",
    ),
    LawRow(
        name="linear",
        module="agents.laws.linear",
        parameters=CoverageParameters,
        about="tracking and coverage (17), weighted linearly by distance",
        covers=True,
        color="#2a9d8f",
    ),
    LawRow(
        name="switching",
        module="agents.laws.switching",
        parameters=CoverageParameters,
        about="tracking or coverage, switched at r_s",
        covers=True,
        color="#8e5bb5",
        mark="s",
    ),
    LawRow(
        name="logarithmic",
        module="agents.laws.logarithmic",
        parameters=LogarithmicParameters,
        about="tracking and coverage, with an unbounded tracking weight towards r_s (19)",
        covers=True,
        color="#1f5fbf",
        mark="D",
    ),
    LawRow(
        name="circle",
        module="agents.laws.circle",
        parameters=CircleParameters,
        about="circle around the UGV (22) to (25)",
        color="#5b616b",
        mark="^",
    ),
    LawRow(
        name="weighted",
        module="agents.laws.weighted",
        parameters=CoverageParameters,
        about="tracking and coverage, with your own weighting (custom.weighting)",
        covers=True,
        own="weighting",
        color="#d16ba5",
    ),
    LawRow(
        name="path",
        module="agents.laws.path",
        parameters=TrackingParameters,
        about="follow your own path relative to the UGV (custom.path)",
        own="path",
        color="#4bb3c9",
    ),
    LawRow(
        name="certified",
        module="agents.laws.logarithmic",
        parameters=LogarithmicParameters,
        about="logarithmic, or your own policy (custom.uav_policy), with the safety filter",
        covers=True,
        inner="uav_policy",
        watched=True,
        color="#d39b00",
        mark="P",
    ),
    LawRow(
        name="lookahead",
        module="agents.laws.lookahead",
        parameters=LookaheadParameters,
        about="best of many trajectories over the next seconds, with the safety filter",
        covers=True,
        watched=True,
        separate=True,
        color="#c0392b",
        mark="X",
    ),
    LawRow(
        name="policy",
        about="your own policy (custom.uav_policy), without the safety filter",
        needs_radius=False,
        own="uav_policy",
        color="#6b4a8f",
        mark="*",
    ),
)
"""Laws by name, in the order of tables and reports."""
DEFAULT_LAW = "logarithmic"


TELEOP = "teleop"
"""Driver for teleoperation."""
EXTERNAL = "external"
"""Driver of a UGV that the user's own process, or external actions, control."""
DRIVERS = _extended(
    "drivers",
    DriverRow,
    DriverRow(
        name="waypoints",
        about="drive from goal to goal",
        module="agents.drivers.waypoints",
        wants="goals",
        avoids=False,
        unbounded=True,
    ),
    DriverRow(
        name="wander",
        about="drive to random points",
        module="agents.drivers.wander",
        avoids=False,
    ),
    DriverRow(
        name="script",
        about="follow timed velocities",
        module="agents.drivers.script",
        needs="script",
        avoids=False,
    ),
    DriverRow(
        name="evade",
        about="evade the UAV, using its radio messages",
        module="agents.drivers.evade",
        listens=True,
        avoids=False,
    ),
    DriverRow(
        name="navigate",
        about="drive from goal to goal around known hazards",
        module="agents.drivers.navigate",
        make="agents.drivers.compiled:NavigateDriver",
        separate=True,
        wants="goals",
        listens=True,
    ),
    DriverRow(
        name=TELEOP,
        about="follow an operator",
        make="agents.drivers.teleop:TeleopDriver",
        operated=True,
    ),
    DriverRow(name="policy", about="your own policy (custom.policy)", own="policy"),
    DriverRow(name=EXTERNAL, about="your own process", outside=True),
)
"""Drivers by name, in the order of help texts."""
DEFAULT_DRIVER = "waypoints"


SENSORS = _extended(
    "sensors",
    SensorRow,
    SensorRow(name="hill", module="sim.models.sensors.hill", about="the paper's (2)"),
    SensorRow(
        name="plateau",
        module="sim.models.sensors.plateau",
        about="nearly constant quality over most of its disc",
    ),
)
"""Sensors by name."""
DEFAULT_SENSOR = "hill"


BODIES = _extended(
    "bodies",
    BodyRow,
    BodyRow(name="point", about="point mass with a linear inner loop (uav.tracking)"),
    BodyRow(
        name="reported",
        about="robot whose process reports its true state",
        make="sim.models.reported:Reported",
        reported=True,
    ),
)
"""Bodies of UAVs by name."""
DEFAULT_BODY = "point"


HAZARDS: Mapping[str, HazardKindRow] = _table(
    HazardKindRow(name="rough", code=2, about="ground to drive over slowly", slows=True),
    HazardKindRow(name="block", code=3, about="obstacle, not to be touched", drivable=False),
    HazardKindRow(name="find", code=4, about="object to find"),
)
"""Kinds of hazards by name."""
TOUCHES = ("stuck", "damage")
"""Effects of touching a blocking hazard: the vehicle is stuck, or drives on and the touch is counted."""
BOLD = "bold"
CAUTIONS = ("cautious", BOLD)
"""Cautions of a UGV on unknown ground: drive only as fast as it can stop before it, or drive on."""
DEFAULT_KINEMATICS = "point"
KINEMATICS = (DEFAULT_KINEMATICS, "differential", "ackermann")
"""Kinematics of a UGV: in any direction, or along its heading; see `sim.models.kinematics`."""
ALTITUDE_LAWS = ("fixed", "certified", "best")
"""Laws of a UAV's altitude: it stays at the initial one, or the law selects it."""


def described(rows: Mapping[str, LawRow] | Mapping[str, DriverRow]) -> str:
    """Return the rows as one text for help: each name with its description."""
    return "; ".join(f"{row.name}: {row.about}" for row in rows.values())
