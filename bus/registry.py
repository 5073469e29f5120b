"""Laws, drivers, sensors and hazards: one row each, with all that others need to know of them.

Their names are words of the messages (`Law.name`, `UgvBriefing.driver`, `Control.driver`, `Sensor.model`) and of
scenarios, so their tables stand here, below everybody, as the table of keys and the columns of observations do: the
simulator, which may import no agent, checks scenarios and operators' requests by the same rows by which a vehicle
chooses its code and by which command line, page, reports and pictures list and draw. No name is copied and none is
handed through. Nothing is imported either: what is code, a row names as `module:name`.

`CONTRIBUTING.md` shows how to add a row.
"""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, TypeVar

from bus.plugins import load_all
from bus.rows import DriverRow, HazardKindRow, LawRow, SensorRow

_Row = TypeVar("_Row", bound="LawRow | DriverRow | SensorRow | HazardKindRow")


def _table(*rows: _Row) -> Mapping[str, _Row]:
    """The rows by name.

    Raises:
        ValueError: If two rows have the same name.
    """
    names = [row.name for row in rows]
    if len(set(names)) < len(names):
        raise ValueError(f"names {names}: two rows have the same name")
    return MappingProxyType({row.name: row for row in rows})


def resolve(where: str) -> Any:  # noqa: ANN401 - whatever it is
    """The object that `module:name` names."""
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


LAWS = _table(
    LawRow(
        name="tracking",
        module="agents.laws.tracking",
        about="follow the UGV (15), (16)",
        needs_radius=False,
        color="#a0522d",
        mark="v",
    ),
    LawRow(
        name="coverage",
        module="agents.laws.coverage",
        about="see ground (6) to (11), and never turn back",
        covers=True,
        needs_radius=False,
        keeps_sight=False,
        color="#9aa531",
        mark="<",
    ),
    LawRow(
        name="linear",
        module="agents.laws.linear",
        about="both (17), weighted in proportion to the distance",
        covers=True,
        color="#2a9d8f",
    ),
    LawRow(
        name="switching",
        module="agents.laws.switching",
        about="one or the other, switched at r_s",
        covers=True,
        color="#8e5bb5",
        mark="s",
    ),
    LawRow(
        name="logarithmic",
        module="agents.laws.logarithmic",
        about="both, tracking unbounded towards r_s (19)",
        covers=True,
        color="#1f5fbf",
        mark="D",
    ),
    LawRow(
        name="circle",
        module="agents.laws.circle",
        about="circle round the UGV (22) to (25)",
        color="#5b616b",
        mark="^",
    ),
    LawRow(
        name="weighted",
        module="agents.laws.weighted",
        about="both, by a weighting of your own (custom.weighting)",
        covers=True,
        own="weighting",
        color="#d16ba5",
    ),
    LawRow(
        name="path",
        module="agents.laws.path",
        about="a path of your own beside the UGV (custom.path)",
        own="path",
        color="#4bb3c9",
    ),
    LawRow(
        name="certified",
        module="agents.laws.logarithmic",
        about="logarithmic, or a policy of your own (custom.uav_policy), with the safety filter behind it",
        covers=True,
        inner="uav_policy",
        watched=True,
        color="#d39b00",
        mark="P",
    ),
    LawRow(
        name="lookahead",
        module="agents.laws.lookahead",
        about="the best of many motions for the next seconds, with the safety filter behind it",
        covers=True,
        watched=True,
        separate=True,
        color="#c0392b",
        mark="X",
    ),
    LawRow(
        name="policy",
        about="a policy of your own (custom.uav_policy) alone, without the safety filter",
        needs_radius=False,
        own="uav_policy",
        color="#6b4a8f",
        mark="*",
    ),
    *load_all("laws", LawRow).values(),
)
"""The laws by name, in the order in which tables and reports list them."""
DEFAULT_LAW = "logarithmic"


TELEOP = "teleop"
"""The driver that an operator takes the wheel with."""
DRIVERS = _table(
    DriverRow(
        name="waypoints",
        about="from goal to goal",
        module="agents.drivers.waypoints",
        wants="goals",
        avoids=False,
        unbounded=True,
    ),
    DriverRow(
        name="wander",
        about="to random points",
        module="agents.drivers.wander",
        avoids=False,
    ),
    DriverRow(
        name="script",
        about="timed velocities",
        module="agents.drivers.script",
        needs="script",
        avoids=False,
    ),
    DriverRow(
        name="evade",
        about="away from the UAV, by what it radios",
        module="agents.drivers.evade",
        listens=True,
        avoids=False,
    ),
    DriverRow(
        name="navigate",
        about="from goal to goal over the ground as it is told and seen",
        module="agents.drivers.navigate",
        make="agents.drivers.compiled:NavigateDriver",
        separate=True,
        wants="goals",
        listens=True,
    ),
    DriverRow(
        name=TELEOP,
        about="an operator",
        make="agents.drivers.teleop:TeleopDriver",
        operated=True,
    ),
    DriverRow(name="policy", about="a policy of your own (custom.policy)", own="policy"),
    DriverRow(name="external", about="a process of your own", outside=True),
    *load_all("drivers", DriverRow).values(),
)
"""The drivers by name, in the order in which help texts list them."""
DEFAULT_DRIVER = "waypoints"


SENSORS = _table(
    SensorRow(name="hill", module="sim.models.sensors.hill", about="the paper's (2)"),
    SensorRow(
        name="plateau",
        module="sim.models.sensors.plateau",
        about="sees well over most of its disc",
    ),
    *load_all("sensors", SensorRow).values(),
)
"""The sensors by name."""
DEFAULT_SENSOR = "hill"


HAZARDS = _table(
    HazardKindRow(name="rough", code=2, about="ground to be driven slowly", slows=True),
    HazardKindRow(name="block", code=3, about="not to be touched", drivable=False),
    HazardKindRow(name="find", code=4, about="a thing to be found"),
)
"""The kinds of hazards by name."""
TOUCHES = ("stuck", "damage")
"""Effects on a vehicle of touching a blocking hazard: it stays there, or it drives on and the touch is counted."""
BOLD = "bold"
CAUTIONS = ("cautious", BOLD)
"""Cautions of a UGV towards ground that nobody has seen: only as fast as it can stop before it, or on."""


def described(rows: Mapping[str, LawRow] | Mapping[str, DriverRow]) -> str:
    """The rows as one text for a command's help: each name with its line."""
    return "; ".join(f"{row.name}: {row.about}" for row in rows.values())
