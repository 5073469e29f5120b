"""Laws, drivers, sensors and hazards: one row each, with all that others need to know of them.

Their names are words of the messages (`Law.name`, `UgvBriefing.driver`, `Control.driver`, `Sensor.model`) and of
scenarios, so their tables stand here, below everybody, as the table of keys and the columns of observations do: the
simulator, which may import no agent, checks scenarios and operators' requests by the same rows by which a vehicle
chooses its code and by which command line, page, reports and pictures list and draw. No name is copied and none is
handed through. Nothing is imported either: what is code, a row names as `module:name`.

`CONTRIBUTING.md` shows how to add a row, and `tests/test_extending.py` does what it says.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Any, TypeVar

_Row = TypeVar("_Row", bound="LawRow | DriverRow | SensorRow | HazardKindRow")


def _table(*rows: _Row) -> Mapping[str, _Row]:
    """The rows by name.

    Raises:
        ValueError: If two rows have the same name or code.
    """
    names, codes = [row.name for row in rows], [row.code for row in rows if row.code is not None]
    for kind, given in (("name", names), ("code", codes)):
        if len(set(given)) < len(given):
            raise ValueError(f"{kind}s {given}: two rows have the same {kind}")
    return MappingProxyType({row.name: row for row in rows})


def resolve(where: str) -> Any:  # noqa: ANN401 - whatever it is
    """The object that `module:name` names."""
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawRow:
    """A law of the UAVs. Its mathematics is the branch with its code in `agents.control.laws`."""

    name: str
    code: int
    """Of its branch in compiled code; never used again for another law."""
    about: str
    """One line, for help texts."""
    covers: bool = False
    """True if it steers by the coverage gradient, and so by v_ref of (10)."""
    needs_radius: bool = True
    """True if it needs a positive switching radius r_s (18)."""
    keeps_sight: bool = True
    """True if it ever turns back to the UGV."""
    own: str = ""
    """The field of `[custom]` that names the function of the user's own which it needs."""
    inner: str = ""
    """The field of `[custom]` whose policy flies in its place inside the safety filter, where one is named."""
    watched: bool = False
    """True if the safety filter stands behind it."""
    color: str
    """Of its lines in pictures and tables."""
    mark: str = "o"
    """Of its points, as matplotlib names it."""

    @property
    def compared(self) -> bool:
        """True if it flies in every comparison: it keeps sight and needs nothing of the user's own."""
        return self.keeps_sight and not self.own


LAWS = _table(
    LawRow(
        name="tracking",
        code=0,
        about="follow the UGV (15), (16)",
        needs_radius=False,
        color="#a0522d",
        mark="v",
    ),
    LawRow(
        name="coverage",
        code=1,
        about="see ground (6) to (11), and never turn back",
        covers=True,
        needs_radius=False,
        keeps_sight=False,
        color="#9aa531",
        mark="<",
    ),
    LawRow(
        name="linear",
        code=2,
        about="both (17), weighted in proportion to the distance",
        covers=True,
        color="#2a9d8f",
    ),
    LawRow(
        name="switching",
        code=3,
        about="one or the other, switched at r_s",
        covers=True,
        color="#8e5bb5",
        mark="s",
    ),
    LawRow(
        name="logarithmic",
        code=4,
        about="both, tracking unbounded towards r_s (19)",
        covers=True,
        color="#1f5fbf",
        mark="D",
    ),
    LawRow(
        name="circle", code=5, about="circle round the UGV (22) to (25)", color="#5b616b", mark="^"
    ),
    LawRow(
        name="weighted",
        code=6,
        about="both, by a weighting of your own (--weighting)",
        covers=True,
        own="weighting",
        color="#d16ba5",
    ),
    LawRow(
        name="path",
        code=7,
        about="a path of your own beside the UGV (--path)",
        own="path",
        color="#4bb3c9",
    ),
    LawRow(
        name="certified",
        code=8,
        about="logarithmic, or a policy of your own (--uav-policy), with the safety filter behind it",
        covers=True,
        inner="uav_policy",
        watched=True,
        color="#d39b00",
        mark="P",
    ),
    LawRow(
        name="lookahead",
        code=9,
        about="the best of many motions for the next seconds, with the safety filter behind it",
        covers=True,
        watched=True,
        color="#c0392b",
        mark="X",
    ),
    LawRow(
        name="policy",
        code=10,
        about="a policy of your own (--uav-policy) alone, without the safety filter",
        needs_radius=False,
        own="uav_policy",
        color="#6b4a8f",
        mark="*",
    ),
)
"""The laws by name, in the order in which tables and reports list them."""
DEFAULT_LAW = "logarithmic"


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverRow:
    """A driver of the UGVs."""

    name: str
    about: str
    """One line, for help texts."""
    make: str = ""
    """The class, made from a `UgvBriefing`, with a code from the name too; empty where it is not ours to make."""
    code: int | None = None
    """Of its branch in `agents.drivers.ugv_tick`; None: it flies in no batch of worlds."""
    needs: str = ""
    """The field of `[[ugv]]` without which it cannot drive."""
    wants: str = ""
    """The field of `[[ugv]]` without which it stands still."""
    listens: bool = False
    """True if it uses what the UAV radios."""
    avoids: bool = True
    """False if it drives where it wants, whatever hazards are there."""
    unbounded: bool = False
    """True if it drives without a bound where the UGV has none; the others assume a large one."""
    operated: bool = False
    """True if it does what an operator says."""
    own: str = ""
    """The field of `[custom]` that names what drives."""
    outside: bool = False
    """True if it is a process of the user's own, from start to end."""


TELEOP = "teleop"
"""The driver that an operator takes the wheel with."""
DRIVERS = _table(
    DriverRow(
        name="waypoints",
        about="from goal to goal",
        make="agents.drivers.compiled:CompiledDriver",
        code=0,
        wants="goals",
        avoids=False,
        unbounded=True,
    ),
    DriverRow(
        name="wander",
        about="to random points",
        make="agents.drivers.compiled:CompiledDriver",
        code=1,
        avoids=False,
    ),
    DriverRow(
        name="script",
        about="timed velocities",
        make="agents.drivers.compiled:CompiledDriver",
        code=2,
        needs="script",
        avoids=False,
    ),
    DriverRow(
        name="evade",
        about="away from the UAV, by what it radios",
        make="agents.drivers.compiled:CompiledDriver",
        code=3,
        listens=True,
        avoids=False,
    ),
    DriverRow(
        name="navigate",
        about="from goal to goal over the ground as it is told and seen",
        make="agents.drivers.compiled:NavigateDriver",
        code=4,
        wants="goals",
        listens=True,
    ),
    DriverRow(
        name=TELEOP,
        about="an operator",
        make="agents.drivers.teleop:TeleopDriver",
        operated=True,
    ),
    DriverRow(name="policy", about="a policy of your own (--policy)", own="policy"),
    DriverRow(name="external", about="a process of your own", outside=True),
)
"""The drivers by name, in the order in which help texts list them."""
DEFAULT_DRIVER = "waypoints"


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRow:
    """A sensor of the ground. Its quality and slope are the branches with its code in `sim.models.field`."""

    name: str
    code: int
    """Of its branches in compiled code."""
    about: str
    """One line, for help texts."""


SENSORS = _table(
    SensorRow(name="hill", code=0, about="the paper's (2)"),
    SensorRow(name="plateau", code=1, about="sees well over most of its disc"),
)
"""The sensors by name."""
DEFAULT_SENSOR = "hill"


@dataclass(frozen=True, slots=True, kw_only=True)
class HazardKindRow:
    """A kind of hazards on the ground. What is one to a vehicle is in `sim.models.ground`."""

    name: str
    code: int
    """State of a tile that one touches: 0 is a tile that nobody has seen, 1 a clear one."""
    about: str
    """One line, for help texts."""
    drivable: bool = True
    """False if a vehicle that touches it is stuck or damaged."""
    slows: bool = False
    """True if a vehicle keeps only a share of its largest speed on it."""


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
