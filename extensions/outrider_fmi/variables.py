"""The variables of units, each once: name, unit and meaning. There is one for what its party perceives or may say."""

from typing import NamedTuple


class Variable(NamedTuple):
    """A variable of a unit."""

    name: str
    unit: str
    """Empty: it is a flag."""
    about: str


def _plane(name: str, unit: str, about: str) -> tuple[Variable, ...]:
    """Two variables, x to the east and y to the north."""
    return (
        Variable(f"{name}.x", unit, f"{about}, east"),
        Variable(f"{name}.y", unit, f"{about}, north"),
    )


OWN_STATE = _plane("position", "m", "Own position") + _plane("velocity", "m/s", "Own velocity")
DETECTION = (
    Variable("detection.new", "", "True at a step to which a detection has come"),
    Variable("detection.time", "s", "When it was taken: a tick times the step size"),
    *_plane("detection", "m", "UAV relative to UGV as detected, with noise"),
)
RADIO = (
    Variable("radio.new", "", "True at a step with a message from the UAV to its UGV"),
    Variable("radio.time", "s", "When it was estimated: a tick times the step size"),
    *_plane("radio", "m", "UAV relative to UGV as the UAV estimates it"),
    Variable("radio.coverage_error", "m2", "e(t) on the UAV's own map"),
)
OPERATOR = (
    Variable("operator.new", "", "True at a step to which a word of the operator has come"),
    *_plane("operator.velocity", "m/s", "Velocity that the operator wants"),
)
GOAL = (
    Variable("underway", "", "True while a goal is still to be reached"),
    Variable("goal.x", "m", "Goal, east; the last one stays when reached"),
    Variable("goal.y", "m", "Goal, north"),
)
ACCELERATION = _plane("acceleration", "m/s2", "Commanded acceleration from this step on")
ESCORT = (
    Variable("certified", "", "True if sight is certified to be kept from here on"),
    Variable("margin", "m", "Visibility radius less the farthest that the UGV may be; or -inf"),
    Variable("estimate.valid", "", "True once the UGV has been detected"),
    *_plane("estimate", "m", "Place at which the UAV believes its UGV to be"),
)

TRUE_STATE = (
    *_plane("position", "m", "True position"),
    *_plane("velocity", "m/s", "True velocity"),
    *_plane("acceleration", "m/s2", "Acceleration applied in the step before"),
)
TRUE_ESCORT = (
    Variable("distance", "m", "True distance from its UGV"),
    Variable("coverage_error", "m2", "e(t) of (4)"),
    Variable("certified", "", "True if it certified at the tick before to keep sight"),
    Variable("lost", "", "True if its UGV is out of sight"),
)

UAV_INPUTS = OWN_STATE + DETECTION
UAV_OUTPUTS = ACCELERATION + ESCORT + RADIO
"""Of a UAV's pilot."""
DRIVER_INPUTS = OWN_STATE + GOAL + RADIO
"""The inputs that a unit which drives a UGV may have; its outputs are `ACCELERATION`."""


def of(owner: str, variables: tuple[Variable, ...]) -> tuple[Variable, ...]:
    """The variables of a vehicle, in a unit that has several."""
    return tuple(one._replace(name=f"{owner}.{one.name}") for one in variables)
