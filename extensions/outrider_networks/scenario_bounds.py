"""Exceedance probabilities of a scenario's declared bounds, and the bounds that a risk allows."""

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
    error_exceedance,
    outage_exceedance,
    smallest_age,
    smallest_error,
    smallest_outage,
)
from sim.engine.briefing import command_delay, safety_parameters
from sim.input.faults import Fault
from sim.scenario.types import Scenario

NEARLY_CERTAIN = 0.999
"""Probability within a run above which text says that it is certain."""


class Exceedance(msgspec.Struct, frozen=True, kw_only=True):
    """Probabilities within one run of a scenario; None: not known."""

    scenario: str
    exceedance_probability: dict[str, float | None]
    """By `vehicle/bound`: the probability that a declared bound is exceeded, or an upper bound of it."""
    loss_probability: float | None
    """Upper bound of the probability that certified visibility is lost; None: another assumption may be broken."""
    notes: list[str]
    """Why a value is an upper bound, or not known."""


class Bounds(msgspec.Struct, frozen=True, kw_only=True):
    """Bounds that are exceeded in a run with at most a given probability."""

    scenario: str
    risk: float
    set: dict[str, float]
    """By field of the scenario."""
    notes: list[str]
    """Why a bound is larger than needed."""


def exceedance(scenario: Scenario) -> Exceedance:
    """Return the probabilities that a run exceeds the bounds on which the law `certified` relies.

    Certified visibility is lost with at most the sum of these probabilities, where everything else that the theorem
    assumes holds for certain.

    Raises:
        ScenarioError: If no UAV relies on bounds.
    """
    _check_law(scenario)
    found: dict[str, Probability] = {}
    for uav in scenario.uav:
        bounds, name = safety_parameters(scenario, uav.name), uav.name
        found[f"{name}/max_measurement_age"] = age_exceedance(
            **_detections(scenario, name), age=bounds.max_measurement_age
        )
        found[f"{name}/max_command_interval"] = outage_exceedance(
            **_commands(scenario, name), outage=bounds.max_command_interval
        )
        if bounds.max_measurement_error is not None:
            error = error_exceedance(*_errors(scenario), bounds.max_measurement_error)
            found[f"{name}/max_measurement_error"] = error
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
    """Return the smallest bounds that are together exceeded in a run with at most the probability `risk`.

    The risk is shared equally by all bounds of all UAVs; of each bound the largest of all UAVs is returned. The error
    is among them only if the noise has no cut.

    Raises:
        ScenarioError: If there is no UAV, or no bound meets the risk.
    """
    if not scenario.uav:
        raise ScenarioError(
            f"{scenario.name}: uav = []: no UAV relies on bounds; allowed: one or more"
        )
    sigma, cut, count = _errors(scenario)
    uncut = sigma > 0.0 and math.isinf(cut)
    share = risk / ((3 if uncut else 2) * len(scenario.uav))
    values: dict[str, float] = {}
    notes: list[str] = []
    for uav in scenario.uav:
        age = smallest_age(**_detections(scenario, uav.name), risk=share)
        outage = smallest_outage(**_commands(scenario, uav.name), risk=share)
        for name, kind, found in (
            ("max_measurement_age", LinkKind.DETECTIONS, age),
            ("max_command_interval", LinkKind.COMMANDS, outage),
        ):
            value = _value(scenario, uav.name, kind, found, risk)
            field = f"certificate.{name}"
            values[field] = max(values.get(field, scenario.dt), value)
            notes += [f"{uav.name}/{name}: {found.why}"] if found.why else []
    if uncut:
        values["certificate.max_measurement_error"] = smallest_error(sigma, cut, count, share)
    return Bounds(scenario=scenario.name, risk=risk, set=values, notes=notes)


def _check_law(scenario: Scenario) -> None:
    law = LAWS[scenario.law.name]
    if not scenario.uav or not law.watched:
        names = ", ".join(name for name, row in LAWS.items() if row.watched)
        wrong = "no UAV relies on declared bounds"
        raise Fault("law.name", scenario.law.name, wrong, f"{names}, and a UAV").error(
            scenario.name
        )


def _value(scenario: Scenario, uav: str, kind: LinkKind, found: Smallest, risk: float) -> float:
    if found.value is None:
        link = scenario.links.path_of(uav, kind)
        wrong = f"{found.why}: no bound is known for {link} of {uav}"
        raise Fault("--risk", risk, wrong, "a greater risk, or other links").error(scenario.name)
    return found.value


def _detections(scenario: Scenario, uav: str) -> dict[str, Any]:
    """Return the arguments that describe a UAV's detections."""
    return {
        "settings": scenario.links.of(uav, LinkKind.DETECTIONS),
        "dt": scenario.dt,
        "period_ticks": scenario.detection_period,
        "dropout": scenario.detections.dropout,
        "ticks": scenario.ticks,
        "traces": scenario.links.traces,
    }


def _commands(scenario: Scenario, uav: str) -> dict[str, Any]:
    """Return the arguments that describe a UAV's commands."""
    return {
        "settings": scenario.links.of(uav, LinkKind.COMMANDS),
        "dt": scenario.dt,
        "delay_ticks": first_tick_from(command_delay(scenario, uav), scenario.dt),
        "repeats": MOST_CARRIED,
        "ticks": scenario.ticks,
        "traces": scenario.links.traces,
    }


def _errors(scenario: Scenario) -> tuple[float, float, int]:
    """Return standard deviation [m], cut and number of a run's detections."""
    count = -(-scenario.ticks // scenario.detection_period)
    return scenario.detections.noise, scenario.detections.truncation, count


def in_runs(probability: float) -> str:
    """Return an upper bound of a probability within a run as text."""
    if probability == 0.0:
        return "in no run"
    if probability < 1e-12:
        return "in less than 1 of 10^12 runs"
    if probability <= 0.01:
        runs = math.floor(1.0 / probability)
        digits = 10 ** max(0, len(str(runs)) - 2)
        return f"in at most 1 of {runs // digits * digits:,} runs"
    if probability < NEARLY_CERTAIN:
        return f"in at most {math.ceil(1000.0 * probability)} of 1,000 runs"
    return "perhaps in every run"
