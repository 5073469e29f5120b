"""Limits of a search for noise and network, and the base scenario of every candidate."""

import math
from dataclasses import dataclass

import msgspec

from agents.safety.handover import check_assumptions
from agents.safety.levels import bounds_of
from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from bus.numbers import above, exact
from bus.registry import LAWS
from sim.engine.briefing import uav_briefing
from sim.scenario.safety import largest_error, safety_parameters
from sim.scenario.types import DEFAULT_AGE, Certificate, LinkTable, Scenario
from sim.scenario.vehicle_types import Uav, Ugv

_NEVER = 1e-9
"""Probability below which a sequence of lost detections is neglected."""
_ROUNDING = 1e-6
"""Tolerance for rounding a delay to whole ticks [ticks]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchLimits:
    """Largest noise and network effects of a candidate; all zero: undegraded."""

    delay: float = 0.0
    """Largest delay of a detection, jitter included [s]."""
    loss: float = 0.0
    """Share of lost detections, each lost independently."""
    blackout: float = 0.0
    """Length of each blackout of the detections [s]."""
    noise: float = 0.0
    """Standard deviation per axis [m]; truncated as the scenario specifies."""
    command_delay: float = 0.0
    """Delay of the UAV's commands [s]."""

    @property
    def degraded(self) -> bool:
        """Return true if any limit is above zero."""
        return any((self.delay, self.loss, self.blackout, self.noise, self.command_delay))


def needed_age(limits: SearchLimits, scenario: Scenario) -> float:
    """Return the bound A [s] on the newest detection's age within these limits.

    A loss sequence with a probability below 10⁻⁹ is neglected.
    """
    return (
        limits.delay
        + limits.blackout
        + time_to_detection(limits.loss, scenario)
        + 2.0 * scenario.dt
    )


def needed_command_timeout(limits: SearchLimits, scenario: Scenario) -> float:
    """Return the scenario's `command_timeout` [s], or the largest command delay in whole ticks if greater."""
    latest = math.ceil(limits.command_delay / scenario.dt - _ROUNDING) * scenario.dt
    return max(scenario.command_timeout, latest)


def time_to_detection(loss: float, scenario: Scenario) -> float:
    """Return the time [s] within which a detection arrives, except with a probability of 10⁻⁹."""
    detections = 1.0 if loss == 0.0 else math.ceil(math.log(_NEVER) / math.log(loss))
    return detections * scenario.detection_period * scenario.dt


def pair(scenario: Scenario) -> tuple[Uav, Ugv]:
    """Return the only UAV and the only UGV.

    Raises:
        ScenarioError: If there are more vehicles, or a speed is unlimited.
    """
    if len(scenario.uav) != 1 or len(scenario.ugv) != 1:
        raise ScenarioError(
            f"{scenario.name}: {len(scenario.uav)} UAVs and {len(scenario.ugv)} UGVs; allowed: one of each"
        )
    uav, ugv = scenario.uav[0], scenario.ugv[0]
    for name, bound in (("uav.0", uav.max_speed), ("ugv.0", ugv.max_speed)):
        if not math.isfinite(bound):
            raise ScenarioError(
                f"{scenario.name}: {name}.max_speed = {bound}: unlimited; allowed: finite numbers above 0"
            )
    return uav, ugv


def _worst_error(scenario: Scenario, limits: SearchLimits) -> float:
    """Return the largest error of a detection within these limits [m]."""
    detections = msgspec.structs.replace(scenario.detections, noise=limits.noise)
    noisy = msgspec.structs.replace(scenario, detections=detections)
    return largest_error(noisy, scenario.uav[0])


def base_of(scenario: Scenario, limits: SearchLimits) -> Scenario:
    """Return the scenario from which every candidate starts.

    Declared bounds of the detections are kept; undeclared ones are set to cover these limits. An undeclared command
    delay follows the candidate's link, because the declared delay must be exact. `command_timeout` is raised to the
    largest command delay, because a vehicle brakes if its commands arrive too old.

    Raises:
        ScenarioError: If the scenario has more than one pair, or nothing can be certified within these limits.
    """
    pair(scenario)
    base = declared_base(scenario, limits)
    if LAWS[base.law.name].watched:
        check_bounds(base, limits)
    return base


def declared_base(scenario: Scenario, limits: SearchLimits) -> Scenario:
    """Return the scenario with bounds that cover these limits and undegraded links; see `base_of`."""
    detections = msgspec.structs.replace(scenario.detections, noise=limits.noise, dropout=0.0)
    given = scenario.certificate
    worst = _worst_error(scenario, limits)
    parameters = safety_parameters(scenario, scenario.uav[0].name)
    as_usual = given in (Certificate(), Certificate(max_measurement_age=DEFAULT_AGE))
    certificate = msgspec.structs.replace(
        given,
        max_measurement_error=given.max_measurement_error
        if given.max_measurement_error is not None or math.isinf(worst)
        else worst,
        max_measurement_age=max(parameters.max_measurement_age, needed_age(limits, scenario))
        if as_usual
        else parameters.max_measurement_age,
    )
    return msgspec.structs.replace(
        scenario,
        detections=detections,
        links=LinkTable(),
        certificate=certificate,
        command_timeout=needed_command_timeout(limits, scenario),
    )


def check_bounds(base: Scenario, limits: SearchLimits) -> None:
    """Check that a filter can certify within these limits.

    Raises:
        ScenarioError: If it cannot.
    """
    delay = LinkSettings(delay=limits.command_delay)
    latest = msgspec.structs.replace(
        base, links=msgspec.structs.replace(base.links, commands=delay)
    )
    faults = check_assumptions(bounds_of(uav_briefing(latest, base.uav[0].name, 0)))
    if faults:
        allowed = "narrower limits (--limit), or [certificate] in the scenario"
        raise ScenarioError(
            f"{base.name}: nothing can be certified within these limits: {faults[0]}; allowed: {allowed}"
        )


def beyond_declared(base: Scenario, limits: SearchLimits) -> tuple[str, ...]:
    """Return a warning for each limit that exceeds a bound declared to the safety filter."""
    if not (LAWS[base.law.name].watched or base.team is not None):
        return ()
    given = base.certificate
    error = _worst_error(base, limits)
    rows = (
        (
            "max_measurement_age",
            needed_age(limits, base),
            safety_parameters(base, base.uav[0].name).max_measurement_age,
            "s",
        ),
        (
            "max_measurement_error",
            error,
            math.inf if given.max_measurement_error is None else given.max_measurement_error,
            "m",
        ),
        (
            "max_command_delay",
            limits.command_delay,
            math.inf if given.max_command_delay is None else given.max_command_delay,
            "s",
        ),
    )
    return tuple(
        f"certificate.{name} = {exact(bound)} {unit}: below the search limit of {above(most, bound)} {unit}; "
        "runs beyond the declared bound break an assumption and count as uncertified"
        for name, most, bound, unit in rows
        if most > bound + 1e-9
    )
