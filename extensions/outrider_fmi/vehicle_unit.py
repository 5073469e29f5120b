"""Vehicle's pilot behind the variables of a co-simulation unit: its own observation in, its acceleration out.

Inputs exist only for quantities that the vehicle perceives itself.
"""

import math
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from agents.laws.selection import SelectedLaw
from agents.safety.levels import bounds_of, radius_at
from agents.uav import UavPilot
from agents.uav_parameters import uav_parameters
from agents.ugv import UgvPilot
from bus.errors import ScenarioError
from bus.messages.base import Message, NonNegative, Tick, Vector
from bus.messages.buildings import Building
from bus.messages.team import Request, TeamMessage
from bus.messages.vehicle import (
    Detection,
    RelativeInformation,
    Teleoperation,
    UavBriefing,
    UavCommand,
    UavObservation,
    UgvBriefing,
    UgvObservation,
)
from bus.numbers import exact
from bus.registry import DEFAULT_KINEMATICS, DRIVERS, LAWS
from bus.ticks import tick_of
from outrider_fmi.variables import (
    ACCELERATION,
    ALTITUDE,
    BUILDINGS,
    HEADING,
    OPERATOR,
    OWN_STATE,
    RADIO,
    TEAM_IN,
    TEAM_OUT,
    TWIST,
    UAV_INPUTS,
    UAV_OUTPUTS,
    VERTICAL,
    Variable,
)

_SHARE = 1e-6
"""Largest deviation of a communication step from a tick, as a share of the tick: masters accumulate rounding errors."""

_LARGEST = 1e6
"""Largest magnitude of a number on the bus."""

Values = Mapping[str, Any]
"""Values of variables by name: numbers, flags and texts."""
Outputs = dict[str, Any]
"""Values of outputs by name."""
_Decoded = TypeVar("_Decoded")


class TeamPart(Message, frozen=True, kw_only=True):
    """Input of a UAV of a team in a step: the team's fields of `UavObservation`."""

    number: Tick = 0
    charge: NonNegative | None = None
    team: tuple[TeamMessage, ...] = ()
    request: Request | None = None


class TeamCommand(Message, frozen=True, kw_only=True):
    """Output of a UAV of a team in a step: the team's fields of `UavCommand`."""

    number: Tick = 0
    team: TeamMessage | None = None


_BUILDINGS = msgspec.json.Decoder(tuple[Building, ...])
_TEAM = msgspec.json.Decoder(TeamPart)


def tick_at(time: float, size: float, dt: float) -> int:
    """Return the tick of a communication step.

    Args:
        time: Time of the communication point [s].
        size: Length of the step [s].
        dt: Length of a tick [s].

    Raises:
        ValueError: If the step is not exactly one tick.
    """
    tick = tick_of(time, dt)
    if tick < 0 or not abs(size - dt) <= _SHARE * dt:
        raise ValueError(
            f"a step of {exact(size)} s from {exact(time)} s; allowed: steps of {exact(dt)} s, the scenario's dt, "
            "from multiples of it"
        )
    return tick


def pair(values: Values, name: str) -> Vector:
    """Return the variables x and y of this name."""
    return values[f"{name}.x"], values[f"{name}.y"]


def teleoperation_of(values: Values, owner: str) -> Teleoperation:
    """Return an operator's message: a velocity, or speed and turn rate; `owner`: prefix of the variables' names."""
    name, speed = f"{owner}operator", f"{owner}operator.speed"
    if speed in values:
        turn_rate = values[f"{name}.turn_rate"]
        return Teleoperation(operator="fmi", speed=values[speed], turn_rate=turn_rate)
    return Teleoperation(operator="fmi", velocity=pair(values, f"{name}.velocity"))


def check_inputs(values: Values) -> None:
    """Check that every number fits into a message on the bus.

    Raises:
        ValueError: If an input is too large or not finite.
    """
    for name, value in values.items():
        if not isinstance(value, str) and not abs(value) <= _LARGEST:
            raise ValueError(f"{name} = {exact(value)}; allowed: numbers up to {_LARGEST:g}")


def _buildings(text: str) -> tuple[Building, ...]:
    """Return the buildings in a text, which may be empty.

    Raises:
        ValueError: If the text has another form.
    """
    return _decoded(_BUILDINGS, "buildings", text) if text else ()


def _decoded(decoder: msgspec.json.Decoder[_Decoded], name: str, text: str) -> _Decoded:
    """Return the content of a text variable.

    Raises:
        ValueError: If the text has another form.
    """
    try:
        return decoder.decode(text)
    except msgspec.DecodeError as error:
        raise ValueError(
            f"{name} = {text[:80]!r}: {error}; allowed: JSON as the description of the variable says"
        ) from error


def check_exportable(briefing: UavBriefing | UgvBriefing) -> None:
    """Check that the variables of a unit cover everything that the vehicle needs.

    Raises:
        ScenarioError: If they do not.
    """
    vehicle = briefing.vehicle
    town = isinstance(briefing, UavBriefing) and briefing.max_building_height is not None
    if briefing.ground is not None and not town:
        raise ScenarioError(
            f"{vehicle}: perceives hazards, but units have no variables for tiles; allowed: UAVs among buildings, and "
            "scenarios without [[hazard]], [[hazard_field]], [[building]] and [[building_field]]"
        )
    if isinstance(briefing, UavBriefing):
        SelectedLaw(briefing, briefing.law, uav_parameters(briefing))
        bounds = bounds_of(briefing)
        needed = bounds.delay_ticks > 0 or bounds.interval_ticks > 1
        if briefing.team is not None and needed:
            raise ScenarioError(
                f"{vehicle}: a guard's commands carry trajectories, but units have no variables; allowed: "
                "certificate.max_command_delay = 0 and certificate.max_command_interval = dt"
            )
        if LAWS[briefing.law.name].watched and needed:
            raise ScenarioError(
                f"{vehicle}: law.name = {briefing.law.name!r}: its commands carry trajectories, but units have "
                "no variables; allowed: certificate.max_command_delay = 0 and certificate.max_command_interval = dt"
            )
        if LAWS[briefing.law.name].own:
            raise ScenarioError(
                f"{vehicle}: the law {briefing.law.name!r} needs user code, which a unit does not contain; "
                "allowed: other laws"
            )
    elif not DRIVERS[briefing.driver].provided:
        raise ScenarioError(
            f"{vehicle}: the driver {briefing.driver!r} is user code, which a unit does not contain; allowed: "
            f"{', '.join(row.name for row in DRIVERS.values() if row.provided)}"
        )


class VehicleUnit:
    """Vehicle's pilot, called with values of variables.

    Args:
        briefing: Briefing of the vehicle.

    Raises:
        ScenarioError: If the vehicle needs more than a unit has.
    """

    def __init__(self, briefing: UavBriefing | UgvBriefing) -> None:
        check_exportable(briefing)
        self.dt = briefing.dt
        """Length of a communication step [s]."""
        self.duration = 200.0 * briefing.dt
        """Default duration of a simulation [s]; a pilot does not know the duration of its run."""
        self._pilot: UavPilot | UgvPilot
        if isinstance(briefing, UavBriefing):
            self._pilot = UavPilot(briefing)
            climbs = briefing.altitude is not None
            discovers = briefing.max_building_height is not None
            self.inputs: tuple[Variable, ...] = UAV_INPUTS + ALTITUDE * climbs
            teamed = briefing.team is not None
            self.inputs += BUILDINGS * discovers + TEAM_IN * teamed
            self.outputs: tuple[Variable, ...] = UAV_OUTPUTS + VERTICAL * climbs
            self.outputs += TEAM_OUT * teamed
            content = f"the UAV's pilot, law {briefing.law.name}"
        else:
            row = DRIVERS[briefing.driver]
            self._pilot = UgvPilot(briefing)
            steers = briefing.kinematics != DEFAULT_KINEMATICS
            operator = TWIST if steers else OPERATOR
            self.inputs = OWN_STATE + HEADING * steers + RADIO * row.listens
            self.inputs += operator * row.operated
            self.outputs = ACCELERATION
            content = f"the UGV's driver, {briefing.driver}"
        self._briefing = briefing
        self.about = f"{briefing.vehicle} of an Outrider scenario: {content}"
        """Description for the importing tool."""

    def start(self) -> Outputs:
        """Return the outputs before the first step."""
        values: dict[str, Any] = {one.name: one.initial for one in self.outputs}
        return values | ({"margin": -math.inf} if "margin" in values else {})

    def step(self, time: float, size: float, values: Values) -> Outputs:
        """Return the outputs from this time on.

        Args:
            time: Time of the communication point [s].
            size: Length of the communication step [s], the vehicle's tick.
            values: Values of the inputs.

        Raises:
            ValueError: If the step is not a tick, or an input is invalid.
        """
        tick = tick_at(time, size, self.dt)
        check_inputs(values)
        own = {
            "tick": tick,
            "time": tick * self.dt,
            "position": pair(values, "position"),
            "velocity": pair(values, "velocity"),
        }
        if isinstance(self._pilot, UavPilot):
            return self._fly(self._pilot, own, values)
        return self._drive(self._pilot, own, values)

    def _fly(self, pilot: UavPilot, own: dict[str, Any], values: Values) -> Outputs:
        detections: tuple[Detection, ...] = ()
        if values["detection.new"]:
            relative = pair(values, "detection")
            detections = (Detection(time=values["detection.time"], relative_position=relative),)
        if "altitude" in values:
            own |= {"altitude": values["altitude"], "climb_rate": values["climb_rate"]}
        if values.get("team"):
            own |= msgspec.structs.asdict(_decoded(_TEAM, "team", values["team"]))
        seen = UavObservation(
            **own, detections=detections, buildings=_buildings(values.get("buildings", ""))
        )
        return self._outputs(pilot.act(seen), seen.altitude)

    def _outputs(self, command: UavCommand, altitude: float | None) -> Outputs:
        outputs = self.start()
        outputs["acceleration.x"], outputs["acceleration.y"] = command.acceleration
        if altitude is not None:
            outputs["vertical_acceleration"] = command.vertical_acceleration
        report = command.report
        if report is not None:
            outputs["estimate.valid"] = True
            outputs["estimate.x"], outputs["estimate.y"] = report.estimate
            decision = report.decision
            outputs["certified"] = decision is not None and decision.certified
            if decision is not None and decision.certified_distance is not None:
                outputs["margin"] = self._visible(altitude) - decision.certified_distance
        if "role" in outputs:
            outputs["role"] = "" if report is None or report.role is None else report.role.value
            sent = TeamCommand(number=command.number, team=command.team)
            outputs["team_command"] = msgspec.json.encode(sent).decode()
        for message in command.radio:
            outputs["radio.new"], outputs["radio.time"] = True, message.time
            outputs["radio.x"], outputs["radio.y"] = message.relative_position
            outputs["radio.coverage_error"] = message.coverage_error
        return outputs

    def _visible(self, altitude: float | None) -> float:
        """Return the distance within which the UGV is visible [m]."""
        briefing = self._briefing
        if not isinstance(briefing, UavBriefing) or altitude is None:
            return briefing.visibility_radius if isinstance(briefing, UavBriefing) else 0.0
        return radius_at(briefing, altitude)

    def _drive(self, pilot: UgvPilot, own: dict[str, Any], values: Values) -> Outputs:
        radio: tuple[RelativeInformation, ...] = ()
        operator: tuple[Teleoperation, ...] = ()
        if values.get("radio.new"):
            message = RelativeInformation(
                time=values["radio.time"],
                relative_position=pair(values, "radio"),
                coverage_error=values["radio.coverage_error"],
            )
            radio = (message,)
        if values.get("operator.new"):
            operator = (teleoperation_of(values, ""),)
        heading = values.get("heading")
        command = pilot.act(UgvObservation(**own, heading=heading, radio=radio, operator=operator))
        return dict(zip(("acceleration.x", "acceleration.y"), command.acceleration, strict=True))
