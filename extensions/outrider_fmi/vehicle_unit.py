"""A vehicle's pilot behind the variables of a co-simulation unit: its own observation in, its acceleration out.

There is an input for what the vehicle perceives itself and for nothing else.
"""

import math
from collections.abc import Mapping
from typing import Any

from agents.laws.selection import SelectedLaw
from agents.safety.safety_filter import bounds_of
from agents.uav import UavPilot
from agents.uav_parameters import uav_parameters
from agents.ugv import UgvPilot
from bus.errors import ScenarioError
from bus.messages.base import Vector
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
from bus.registry import DRIVERS, LAWS
from bus.ticks import tick_of
from outrider_fmi.variables import (
    ACCELERATION,
    OPERATOR,
    OWN_STATE,
    RADIO,
    UAV_INPUTS,
    UAV_OUTPUTS,
    Variable,
)

_SHARE = 1e-6
"""By so much of a tick a communication step may differ from it: masters add up their times."""

_LARGEST = 1e6
"""Of a number on the bus."""

Values = Mapping[str, float]
"""The values of variables, by name; a flag's is true or false."""


def tick_at(time: float, size: float, dt: float) -> int:
    """The tick of a communication step.

    Args:
        time: Of the communication point [s].
        size: Of the step [s].
        dt: Length of a tick [s].

    Raises:
        ValueError: If it is not exactly a tick.
    """
    tick = tick_of(time, dt)
    if tick < 0 or not abs(size - dt) <= _SHARE * dt:
        raise ValueError(
            f"a step of {size:g} s from {time:g} s; allowed: steps of {dt:g} s, the scenario's dt, "
            "from whole multiples of it"
        )
    return tick


def pair(values: Values, name: str) -> Vector:
    """The variables x and y of this name."""
    return values[f"{name}.x"], values[f"{name}.y"]


def check_inputs(values: Values) -> None:
    """Refuse an input that no message on the bus could carry.

    Raises:
        ValueError: If there is one.
    """
    for name, value in values.items():
        if not abs(value) <= _LARGEST:
            raise ValueError(f"{name} = {value:g}; allowed: numbers up to {_LARGEST:g}")


def check_exportable(briefing: UavBriefing | UgvBriefing) -> None:
    """Refuse a vehicle that needs more than the variables of a unit.

    Raises:
        ScenarioError: If it does.
    """
    vehicle = briefing.vehicle
    if briefing.ground is not None:
        raise ScenarioError(
            f"{vehicle}: perceives hazards, for whose tiles a unit has no variables; allowed: scenarios without "
            "[[hazard]] and [[hazard_field]]"
        )
    if isinstance(briefing, UavBriefing):
        SelectedLaw(briefing, briefing.law, uav_parameters(briefing))
        promise = bounds_of(briefing)
        needed = promise.delay_ticks > 0 or promise.interval_ticks > 1
        if LAWS[briefing.law.name].watched and needed:
            raise ScenarioError(
                f"{vehicle}: law.name = {briefing.law.name!r}: its commands carry motions, for which a unit has no "
                "variables; allowed: certificate.max_command_delay = 0 and certificate.max_command_interval = dt"
            )
        if LAWS[briefing.law.name].own:
            raise ScenarioError(
                f"{vehicle}: the law {briefing.law.name!r} needs a function of your own, which a unit does not carry; "
                "allowed: other laws"
            )
    elif not DRIVERS[briefing.driver].provided:
        raise ScenarioError(
            f"{vehicle}: the driver {briefing.driver!r} is code of your own, which a unit does not carry; allowed: "
            f"{', '.join(row.name for row in DRIVERS.values() if row.provided)}"
        )


class VehicleUnit:
    """A vehicle's pilot, asked by values of variables.

    Args:
        briefing: The one that the vehicle would be told.

    Raises:
        ScenarioError: If the vehicle needs more than a unit has.
    """

    def __init__(self, briefing: UavBriefing | UgvBriefing) -> None:
        check_exportable(briefing)
        self.dt = briefing.dt
        """Of a communication step [s]."""
        self.duration = 200.0 * briefing.dt
        """Of a simulation by default [s]: a pilot does not know how long the run will be."""
        self._pilot: UavPilot | UgvPilot
        if isinstance(briefing, UavBriefing):
            self._pilot = UavPilot(briefing)
            self.inputs: tuple[Variable, ...] = UAV_INPUTS
            self.outputs: tuple[Variable, ...] = UAV_OUTPUTS
            who = f"the UAV's pilot, law {briefing.law.name}"
        else:
            row = DRIVERS[briefing.driver]
            self._pilot = UgvPilot(briefing)
            self.inputs = OWN_STATE + RADIO * row.listens + OPERATOR * row.operated
            self.outputs = ACCELERATION
            who = f"the UGV's driver, {briefing.driver}"
        self._visible = briefing.visibility_radius if isinstance(briefing, UavBriefing) else 0.0
        self.about = f"{briefing.vehicle} of an Outrider scenario: {who}"
        """Description for whoever imports it."""

    def start(self) -> dict[str, float]:
        """The outputs before the first step."""
        values = {one.name: 0.0 if one.unit else False for one in self.outputs}
        return values | ({"margin": -math.inf} if "margin" in values else {})

    def step(self, time: float, size: float, values: Values) -> dict[str, float]:
        """The outputs from a time on.

        Args:
            time: Of the communication point [s].
            size: Of the communication step [s]; the vehicle's tick.
            values: Of the inputs.

        Raises:
            ValueError: If the times are not those of ticks, or an input is not what it may be.
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

    def _fly(self, pilot: UavPilot, own: dict[str, Any], values: Values) -> dict[str, float]:
        looks: tuple[Detection, ...] = ()
        if values["detection.new"]:
            relative = pair(values, "detection")
            looks = (Detection(time=values["detection.time"], relative_position=relative),)
        return self._told(pilot.act(UavObservation(**own, detections=looks)))

    def _told(self, command: UavCommand) -> dict[str, float]:
        told = self.start()
        told["acceleration.x"], told["acceleration.y"] = command.acceleration
        report = command.report
        if report is not None:
            told["estimate.valid"] = True
            told["estimate.x"], told["estimate.y"] = report.estimate
            decision = report.decision
            told["certified"] = decision is not None and decision.certified
            if decision is not None and decision.certified_distance is not None:
                told["margin"] = self._visible - decision.certified_distance
        for message in command.radio:
            told["radio.new"], told["radio.time"] = True, message.time
            told["radio.x"], told["radio.y"] = message.relative_position
            told["radio.coverage_error"] = message.coverage_error
        return told

    def _drive(self, pilot: UgvPilot, own: dict[str, Any], values: Values) -> dict[str, float]:
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
            wanted = pair(values, "operator.velocity")
            operator = (Teleoperation(operator="fmi", velocity=wanted),)
        command = pilot.act(UgvObservation(**own, radio=radio, operator=operator))
        return dict(zip(("acceleration.x", "acceleration.y"), command.acceleration, strict=True))
