"""Variables of units: name, unit and description. Each one corresponds to a field that its party may read or write."""

from typing import NamedTuple


class Variable(NamedTuple):
    """Variable of a unit."""

    name: str
    unit: str
    """Unit; empty for a flag or a text."""
    about: str
    text: bool = False
    """True for a text."""

    @property
    def initial(self) -> float | str:
        """Return the value before the first step."""
        return "" if self.text else 0.0 if self.unit else False


def _plane(name: str, unit: str, about: str) -> tuple[Variable, ...]:
    """Return two variables, x to the east and y to the north."""
    return (
        Variable(f"{name}.x", unit, f"{about}, east"),
        Variable(f"{name}.y", unit, f"{about}, north"),
    )


OWN_STATE = _plane("position", "m", "Own position") + _plane("velocity", "m/s", "Own velocity")
HEADING = (Variable("heading", "rad", "Heading, from east to north"),)
"""Heading of a UGV that steers."""
ALTITUDE = (
    Variable("altitude", "m", "Altitude above the ground"),
    Variable("climb_rate", "m/s", "Climb rate"),
)
DETECTION = (
    Variable("detection.new", "", "True at a step with a new detection"),
    Variable("detection.time", "s", "Time of the detection: a tick times the step size"),
    *_plane("detection", "m", "UAV relative to UGV as detected, with noise"),
)
BUILDINGS = (
    Variable(
        "buildings",
        "",
        "Buildings discovered in this step, as JSON like `UavObservation.buildings`; empty: none",
        text=True,
    ),
)
TEAM_IN = (
    Variable(
        "team",
        "",
        "Fields `number`, `charge`, `team` and `request` of `UavObservation` as a JSON object; empty: none",
        text=True,
    ),
)
TEAM_OUT = (
    Variable("role", "", "Role in its team", text=True),
    Variable(
        "team_command", "", "Fields `number` and `team` of `UavCommand` as a JSON object", text=True
    ),
)
RADIO = (
    Variable("radio.new", "", "True at a step with a message from the UAV to its UGV"),
    Variable("radio.time", "s", "Time of the estimate: a tick times the step size"),
    *_plane("radio", "m", "UAV relative to UGV, the UAV's estimate"),
    Variable("radio.coverage_error", "m2", "e(t) on the UAV's own map"),
)
OPERATOR = (
    Variable("operator.new", "", "True at a step with a new message of the operator"),
    *_plane("operator.velocity", "m/s", "Velocity commanded by the operator"),
)
TWIST = (
    OPERATOR[0],
    Variable("operator.speed", "m/s", "Speed commanded by the operator, negative in reverse"),
    Variable("operator.turn_rate", "rad/s", "Turn rate commanded by the operator, to the left"),
)
"""Instead of `OPERATOR`, of a UGV that steers."""
GOAL = (
    Variable("underway", "", "True until the last goal is reached"),
    Variable("goal.x", "m", "Goal, east; the last one stays after arrival"),
    Variable("goal.y", "m", "Goal, north"),
)
ACCELERATION = _plane("acceleration", "m/s2", "Commanded acceleration from this step on")
VERTICAL = (
    Variable("vertical_acceleration", "m/s2", "Commanded vertical acceleration from this step on"),
)
ESCORT = (
    Variable("certified", "", "True if visibility is certified from this step on"),
    Variable(
        "margin",
        "m",
        "Visibility radius at its altitude minus the certified distance; -inf if unknown",
    ),
    Variable("estimate.valid", "", "True once the UGV has been detected"),
    *_plane("estimate", "m", "Position of the UGV, the UAV's estimate"),
)

TRUE_STATE = (
    *_plane("position", "m", "True position"),
    *_plane("velocity", "m/s", "True velocity"),
    *_plane("acceleration", "m/s2", "Acceleration applied in the previous step"),
)
TRUE_ESCORT = (
    Variable("distance", "m", "True distance from its UGV"),
    Variable("coverage_error", "m2", "e(t) of (4)"),
    Variable("certified", "", "True if visibility was certified at the previous tick"),
    Variable("lost", "", "True if its UGV is out of sight"),
)

UAV_INPUTS = OWN_STATE + DETECTION
UAV_OUTPUTS = ACCELERATION + ESCORT + RADIO
"""Outputs of a UAV's pilot."""
DRIVER_INPUTS = OWN_STATE + HEADING + GOAL + RADIO
"""Allowed inputs of a unit that drives a UGV; its outputs are `ACCELERATION`."""


def of(owner: str, variables: tuple[Variable, ...]) -> tuple[Variable, ...]:
    """Return the variables of a vehicle in a unit with several vehicles."""
    return tuple(one._replace(name=f"{owner}.{one.name}") for one in variables)
