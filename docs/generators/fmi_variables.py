"""Tables of the variables of FMI units."""

from structs import cell

from outrider_fmi.variables import (
    ACCELERATION,
    ALTITUDE,
    BUILDINGS,
    DRIVER_INPUTS,
    HEADING,
    OPERATOR,
    OWN_STATE,
    RADIO,
    TEAM_IN,
    TEAM_OUT,
    TRUE_ESCORT,
    TRUE_STATE,
    TWIST,
    UAV_INPUTS,
    UAV_OUTPUTS,
    VERTICAL,
    Variable,
    of,
)

Rows = tuple[tuple[str, tuple[Variable, ...]], ...]
PILOTS: Rows = (
    ("`uav`: in", UAV_INPUTS),
    ("`uav`: in, with an altitude", ALTITUDE),
    ("`uav`: in, in scenarios with buildings", BUILDINGS),
    ("`uav`: in, in a team", TEAM_IN),
    ("`uav`: out", UAV_OUTPUTS),
    ("`uav`: out, with an altitude", VERTICAL),
    ("`uav`: out, in a team", TEAM_OUT),
    ("`ugv`: in", OWN_STATE),
    ("`ugv`: in, if it steers", HEADING),
    ("`ugv`: in, for drivers with radio (`evade`, `navigate`)", RADIO),
    ("`ugv`: in, for the driver `teleop`", OPERATOR),
    ("`ugv`: in, for the driver `teleop`, if it steers", TWIST),
    ("`ugv`: out", ACCELERATION),
)
WORLD: Rows = (
    ("`world`: out, of each vehicle", of("<vehicle>", TRUE_STATE)),
    ("`world`: out, of each UAV", of("<uav>", TRUE_ESCORT)),
    ("`world`: out, of each UAV with an altitude", of("<uav>", ALTITUDE)),
    ("`world`: out, of each UGV that steers", of("<ugv>", HEADING)),
    ("`world`: in, of each UGV with the driver `teleop`", of("<ugv>", OPERATOR)),
    ("`world`: in, of each UGV with this driver that steers", of("<ugv>", TWIST)),
)
DRIVER: Rows = (("in", DRIVER_INPUTS), ("out", ACCELERATION))


def _table(rows: Rows) -> str:
    lines = ["| group | variable | type, unit | description |", "|---|---|---|---|"]
    for who, variables in rows:
        for k, one in enumerate(variables):
            kind = "String" if one.text else "Boolean"
            unit = f"Float64, {one.unit}" if one.unit else kind
            lines.append(f"| {who if k == 0 else ''} | `{one.name}` | {unit} | {cell(one.about)} |")
    return "\n".join(lines)


def pilots() -> str:
    """Return the table of the units of vehicles."""
    return _table(PILOTS)


def world() -> str:
    """Return the table of the unit of a whole flight."""
    return _table(WORLD)


def driver() -> str:
    """Return the table of a unit that drives a UGV."""
    return _table(DRIVER)
