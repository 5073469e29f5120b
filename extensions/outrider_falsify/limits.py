"""Within what is searched: what noise and network may do, and the scenario that every candidate starts from."""

import math
from dataclasses import dataclass

import msgspec

from agents.safety.handover import check_assumptions
from agents.safety.safety_filter import bounds_of
from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from bus.registry import LAWS
from sim.engine.briefing import safety_parameters, uav_briefing
from sim.scenario.types import DEFAULT_AGE, Certificate, LinkTable, Scenario, Uav, Ugv

_NEVER = 1e-9
"""Losses in a row that are rarer than this share of all looks are not reckoned with."""
_ROUNDING = 1e-6
"""Of a tick: a delay that is so little above a whole number of them counts as that number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchLimits:
    """The most that a candidate may ask of noise and network; all zero: undegraded."""

    delay: float = 0.0
    """From a look to its arrival, jitter and all [s]."""
    loss: float = 0.0
    """Share of looks that are lost, each on its own."""
    blackout: float = 0.0
    """Of the detections, each [s]."""
    noise: float = 0.0
    """Standard deviation per axis [m]; cut as the scenario says."""
    command_delay: float = 0.0
    """Of the UAV's commands [s]."""

    @property
    def degraded(self) -> bool:
        """True if anything is allowed."""
        return any((self.delay, self.loss, self.blackout, self.noise, self.command_delay))


def needed_age(limits: SearchLimits, scenario: Scenario) -> float:
    """The age A [s] that the newest detection stays below within these limits, but for one loss in 10⁹."""
    return (
        limits.delay + limits.blackout + looks_until_seen(limits.loss, scenario) + 2.0 * scenario.dt
    )


def needed_hold(limits: SearchLimits, scenario: Scenario) -> float:
    """The scenario's `command_timeout` [s], or the latest command's delay in whole ticks where that is more."""
    latest = math.ceil(limits.command_delay / scenario.dt - _ROUNDING) * scenario.dt
    return max(scenario.command_timeout, latest)


def looks_until_seen(loss: float, scenario: Scenario) -> float:
    """Time [s] within which a look gets through when this share is lost, but for one case in a thousand million."""
    looks = 1.0 if loss == 0.0 else math.ceil(math.log(_NEVER) / math.log(loss))
    return looks * scenario.detection_period * scenario.dt


def pair(scenario: Scenario) -> tuple[Uav, Ugv]:
    """The one UAV and the one UGV.

    Raises:
        ScenarioError: If there are more, or a speed has no bound.
    """
    if len(scenario.uav) != 1 or len(scenario.ugv) != 1:
        raise ScenarioError(
            f"{scenario.name}: has {len(scenario.uav)} UAVs and {len(scenario.ugv)} UGVs; allowed: one of each"
        )
    uav, ugv = scenario.uav[0], scenario.ugv[0]
    for name, bound in (("uav.0", uav.max_speed), ("ugv.0", ugv.max_speed)):
        if not math.isfinite(bound):
            raise ScenarioError(
                f"{scenario.name}: {name}.max_speed = {bound}: a search needs a bound; allowed: numbers above 0"
            )
    return uav, ugv


def base_of(scenario: Scenario, limits: SearchLimits) -> Scenario:
    """The scenario that every candidate starts from.

    What the scenario declares of its detections for the law `certified` is kept; what it leaves open is declared as
    these limits need it. The delay of the commands must be what is declared, not less: left open, it is that of the
    candidate's link. Where that delay may exceed `command_timeout`, `command_timeout` is raised with it: a vehicle
    whose commands are too old when they arrive only brakes.

    Raises:
        ScenarioError: If the scenario has more than one pair, or within these limits nothing can be certified.
    """
    pair(scenario)
    detections = msgspec.structs.replace(scenario.detections, noise=limits.noise, dropout=0.0)
    given = scenario.certificate
    worst = limits.noise * scenario.detections.truncation if limits.noise else 0.0
    told = safety_parameters(scenario, scenario.uav[0].name)
    as_usual = given in (Certificate(), Certificate(max_measurement_age=DEFAULT_AGE))
    certificate = msgspec.structs.replace(
        given,
        max_measurement_error=given.max_measurement_error
        if given.max_measurement_error is not None or math.isinf(worst)
        else worst,
        max_measurement_age=max(told.max_measurement_age, needed_age(limits, scenario))
        if as_usual
        else told.max_measurement_age,
    )
    base = msgspec.structs.replace(
        scenario,
        detections=detections,
        links=LinkTable(),
        certificate=certificate,
        command_timeout=needed_hold(limits, scenario),
    )
    if LAWS[base.law.name].watched:
        _check_promise(base, limits)
    return base


def _check_promise(base: Scenario, limits: SearchLimits) -> None:
    delay = LinkSettings(delay=limits.command_delay)
    latest = msgspec.structs.replace(
        base, links=msgspec.structs.replace(base.links, commands=delay)
    )
    faults = check_assumptions(bounds_of(uav_briefing(latest, base.uav[0].name, 0)))
    if faults:
        allowed = "narrower limits (--limit), or a certificate in the scenario"
        raise ScenarioError(
            f"{base.name}: nothing can be certified within these limits: {faults[0]}; allowed: {allowed}"
        )


def beyond_declared(base: Scenario, limits: SearchLimits) -> tuple[str, ...]:
    """In what these limits go beyond what is declared to the law `certified`, a line each."""
    if not LAWS[base.law.name].watched:
        return ()
    given = base.certificate
    error = limits.noise * base.detections.truncation if limits.noise else 0.0
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
        f"certificate.{name} = {bound:g} {unit}, but the limits of the search allow {most:g} {unit}: "
        "runs that go beyond it break an assumption and count as not certified"
        for name, most, bound, unit in rows
        if most > bound + 1e-9
    )
