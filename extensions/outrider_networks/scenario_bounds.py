"""Exceedance probabilities of a scenario's declared bounds, and the bounds for a given risk."""

import math
from typing import Any

import msgspec

from bus.errors import ScenarioError
from bus.messages.links import LinkKind
from bus.messages.vehicle import MOST_CARRIED
from bus.registry import LAWS
from bus.ticks import first_tick_from
from outrider.running.assumptions import shortfalls
from outrider_networks.link_runs import Probability
from outrider_networks.probabilities import (
    Smallest,
    age_exceedance,
    command_interval_exceedance,
    error_exceedance,
    smallest_age,
    smallest_command_interval,
    smallest_error,
)
from sim.input.faults import Fault
from sim.scenario.safety import command_delay, largest_noise, safety_parameters
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

NEARLY_CERTAIN = 0.999
"""Probability within a run above which text calls it certain."""


class Exceedance(msgspec.Struct, frozen=True, kw_only=True):
    """Probabilities within one run of a scenario; None if unknown."""

    scenario: str
    exceedance_probability: dict[str, float | None]
    """Probability of exceeding each declared bound, or an upper bound of it, by `vehicle/bound`."""
    loss_probability: float | None
    """Upper bound of the probability of losing certified visibility; None if other assumptions may break."""
    notes: list[str]
    """Reasons why a value is an upper bound or unknown."""


class Bounds(msgspec.Struct, frozen=True, kw_only=True):
    """Bounds that a run exceeds with at most a given probability."""

    scenario: str
    risk: float
    set: dict[str, float]
    """Bounds by field of the scenario."""
    notes: list[str]
    """Reasons why a bound is larger than needed."""


def exceedance(scenario: Scenario) -> Exceedance:
    """Return the probabilities that a run exceeds the bounds on which the law `certified` relies.

    If the theorem's other assumptions hold for certain, certified visibility is lost with at most the sum of these
    probabilities.

    Raises:
        ScenarioError: If no UAV relies on bounds.
    """
    check_filtered(scenario)
    found: dict[str, Probability] = {}
    for uav in scenario.uav:
        bounds, name = safety_parameters(scenario, uav.name), uav.name
        found[f"{name}/max_measurement_age"] = age_exceedance(
            **detections_of(scenario, name), age=bounds.max_measurement_age
        )
        found[f"{name}/max_command_interval"] = command_interval_exceedance(
            **commands_of(scenario, name), max_command_interval=bounds.max_command_interval
        )
        if bounds.max_measurement_error is not None:
            error = error_exceedance(*_errors(scenario, uav), bounds.max_measurement_error)
            why = "" if error.value == 0.0 else _largest_noise_note(uav)
            found[f"{name}/max_measurement_error"] = error._replace(why=why)
    values = {name: one.value for name, one in found.items()}
    known = [value for value in values.values() if value is not None]
    certain = len(known) == len(values) and all(one.by_chance for one in shortfalls(scenario))
    return Exceedance(
        scenario=scenario.name,
        exceedance_probability=values,
        loss_probability=min(1.0, sum(known)) if certain else None,
        notes=[f"{name}: {one.why}" for name, one in found.items() if one.why],
    )


def bounds_for(scenario: Scenario, risk: float) -> Bounds:
    """Return the smallest bounds that a run exceeds with at most the total probability `risk`.

    All bounds of all UAVs share the risk equally; each result is the largest over the UAVs. The error is included only
    if the noise is not truncated.

    Raises:
        ScenarioError: If there is no UAV, or no bound meets the risk.
    """
    if not scenario.uav:
        raise ScenarioError(
            f"{scenario.name}: uav = []: no UAV to compute bounds for; allowed: one or more"
        )
    noisy = scenario.detections.noise > 0.0
    untruncated = noisy and math.isinf(scenario.detections.truncation)
    share = risk / ((3 if untruncated else 2) * len(scenario.uav))
    values: dict[str, float] = {}
    notes: list[str] = []
    for uav in scenario.uav:
        age = smallest_age(**detections_of(scenario, uav.name), risk=share)
        interval = smallest_command_interval(**commands_of(scenario, uav.name), risk=share)
        for name, kind, found in (
            ("max_measurement_age", LinkKind.DETECTIONS, age),
            ("max_command_interval", LinkKind.COMMANDS, interval),
        ):
            value = _value(scenario, uav.name, kind, found, risk)
            field = f"certificate.{name}"
            values[field] = max(values.get(field, scenario.dt), value)
            notes += [f"{uav.name}/{name}: {found.why}"] if found.why else []
    if untruncated:
        errors = [smallest_error(*_errors(scenario, uav), share) for uav in scenario.uav]
        values["certificate.max_measurement_error"] = max(errors)
        notes += [
            f"{uav.name}/max_measurement_error: {note}"
            for uav in scenario.uav
            if (note := _largest_noise_note(uav))
        ]
    return Bounds(scenario=scenario.name, risk=risk, set=values, notes=notes)


def check_filtered(scenario: Scenario) -> None:
    """Check that a UAV relies on declared bounds.

    Raises:
        ScenarioError: If none does.
    """
    if not any(map(scenario.filters, scenario.uav)):
        names = ", ".join(name for name, row in LAWS.items() if row.watched)
        wrong = "no UAV relies on declared bounds"
        raise Fault("law.name", scenario.law.name, wrong, f"{names}, and a UAV").error(
            scenario.name
        )


def _value(scenario: Scenario, uav: str, kind: LinkKind, found: Smallest, risk: float) -> float:
    if found.value is None:
        link = scenario.links.path_of(uav, kind)
        wrong = f"no bound for {link} of {uav}: {found.why}"
        raise Fault("--risk", risk, wrong, "a greater risk, or other links").error(scenario.name)
    return found.value


def detections_of(scenario: Scenario, uav: str) -> dict[str, Any]:
    """Return the arguments that describe a UAV's detections."""
    return {
        "settings": scenario.links.of(uav, LinkKind.DETECTIONS),
        "dt": scenario.dt,
        "period_ticks": scenario.detection_period,
        "dropout": scenario.detections.dropout,
        "ticks": scenario.ticks,
        "traces": scenario.links.traces,
    }


def commands_of(scenario: Scenario, uav: str) -> dict[str, Any]:
    """Return the arguments that describe a UAV's commands."""
    return {
        "settings": scenario.links.of(uav, LinkKind.COMMANDS),
        "dt": scenario.dt,
        "delay_ticks": first_tick_from(command_delay(scenario, uav), scenario.dt),
        "repeats": MOST_CARRIED,
        "ticks": scenario.ticks,
        "traces": scenario.links.traces,
    }


def _errors(scenario: Scenario, uav: Uav) -> tuple[float, float, int]:
    """Return largest standard deviation [m], truncation and number of a UAV's detections in a run."""
    count = -(-scenario.ticks // scenario.detection_period)
    return largest_noise(scenario, uav), scenario.detections.truncation, count


def _largest_noise_note(uav: Uav) -> str:
    """Return why a bound of the error is larger than needed; empty in the plane."""
    if uav.initial_altitude is None:
        return ""
    return "noise grows with the slant range, and the largest is assumed for all detections"


def in_runs(probability: float) -> str:
    """Return an upper bound of a probability within a run as text."""
    if probability == 0.0:
        return "with probability 0"
    if probability < 1e-12:
        return "in less than 1 of 10^12 runs"
    if probability <= 0.01:
        runs = math.floor(1.0 / probability)
        digits = 10 ** max(0, len(str(runs)) - 2)
        return f"in at most 1 of {runs // digits * digits:,} runs"
    if probability < NEARLY_CERTAIN:
        return f"in at most {math.ceil(1000.0 * probability)} of 1,000 runs"
    return "with a probability of up to 100 %"
