"""Network budget of a scenario: tolerance of its vehicles, needs of its links, and how much worse links may be."""

import functools
import math
from collections.abc import Callable
from typing import Any

import msgspec

from agents.safety.handover import certified_radius
from agents.safety.levels import bounds_of
from bus.errors import ScenarioError
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.vehicle import MOST_CARRIED
from bus.numbers import exact
from bus.ticks import first_tick_from
from outrider.running.assumptions import how_certifiable
from outrider.running.network_budget import BoundRow, Budget, LinkRow
from outrider.running.tolerance import Tolerance, largest, tolerances
from outrider_networks.probabilities import (
    keeps_age,
    keeps_command_interval,
    smallest_age,
    smallest_command_interval,
)
from outrider_networks.scenario_bounds import check_filtered, commands_of, detections_of
from sim.channel.description import longest_delay
from sim.engine.briefing import uav_briefing
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

_MOST = {"loss": 0.999, "delay": 30.0}
"""Largest values that are tried, of a burst and a blackout the duration of the run [s].

With more loss, hardly a first message arrives; a link has no greater delay.
"""
_PRECISION = 0.01
"""Relative precision of a link's property."""
_BETWEEN = 10.0
"""Mean time between bursts, where the link has none [s]."""


class _Limits(msgspec.Struct, frozen=True):
    """Bounds that a link must keep."""

    time: float
    """Age of the newest detection, or time between two plans [s]."""
    delay: float
    """Delay of a command [s]."""


def check_risk(risk: float) -> None:
    """Check a probability.

    Raises:
        ScenarioError: If it is not between 0 and 1.
    """
    if not 0.0 < risk < 1.0:
        raise ScenarioError(f"--risk {exact(risk)}: out of range; allowed: above 0 and below 1")


def budget(
    scenario: Scenario,
    risk: float,
    on_progress: Callable[[str, float], object] = lambda _step, _share: None,
) -> Budget:
    """Return the network budget of a scenario.

    Each link may exceed its bound with the probability `risk` within a run; each property of a link is varied alone.

    Args:
        scenario: The scenario.
        risk: Probability, between 0 and 1.
        on_progress: Called with what is computed next, and the share that is done.

    Raises:
        ScenarioError: If no UAV relies on bounds.
    """
    check_filtered(scenario)
    bounds, links, radii = list[BoundRow](), list[LinkRow](), dict[str, float | None]()
    notes = set[str]()
    uavs = list(filter(scenario.filters, scenario.uav))
    for k, uav in enumerate(uavs):

        def step(what: str, share: float, k: int = k) -> None:
            on_progress(what, (k + share) / len(uavs))

        step(f"{uav.name}: bounds", 0.0)
        of_uav = tolerances(scenario, uav)
        declared = bounds_of(uav_briefing(scenario, uav.name, scenario.seed))
        radii[uav.name] = certified_radius(declared) if declared.valid else None
        bounds += [_bound_row(scenario, uav, one, risk, notes) for one in of_uav]
        links += _link_rows(scenario, uav, of_uav, risk, step)
    return Budget(
        scenario=scenario.name,
        risk=risk,
        certifiable=how_certifiable(scenario),
        r_cert=radii,
        bounds=bounds,
        links=links,
        notes=sorted(notes),
    )


def _bound_row(
    scenario: Scenario, uav: Uav, tolerance: Tolerance, risk: float, notes: set[str]
) -> BoundRow:
    """Return the row of one bound; what it notes about the links is added to `notes`."""
    field, needed = tolerance.bound.field, None
    if field == "max_measurement_age":
        found = smallest_age(**detections_of(scenario, uav.name), risk=risk)
    elif field == "max_command_interval":
        found = smallest_command_interval(**commands_of(scenario, uav.name), risk=risk)
    else:
        found = None
    if found is not None:
        needed = found.value
        if found.why:
            notes.add(f"{uav.name}/{field}: {found.why}")
    elif field == "max_command_delay":
        settings = scenario.links.of(uav.name, LinkKind.COMMANDS)
        needed = longest_delay(settings, scenario.links.traces)
    return BoundRow(
        uav=uav.name,
        bound=field,
        symbol=tolerance.bound.symbol,
        unit=tolerance.bound.unit,
        declared=tolerance.declared,
        needed=needed if needed is None or math.isfinite(needed) else None,
        largest=tolerance.largest,
        r_cert=tolerance.radius,
    )


def _link_rows(
    scenario: Scenario,
    uav: Uav,
    of_uav: tuple[Tolerance, ...],
    risk: float,
    on_progress: Callable[[str, float], object],
) -> list[LinkRow]:
    """Return the rows of a UAV's two links."""
    declared = {one.bound.field: one.declared for one in of_uav}
    most = {one.bound.field: one.largest for one in of_uav}
    rows = list[LinkRow]()
    for kind, field in (
        (LinkKind.DETECTIONS, "max_measurement_age"),
        (LinkKind.COMMANDS, "max_command_interval"),
    ):
        delays = [one["max_command_delay"] for one in (declared, most)]
        limits = [
            None if time is None or delay is None else _Limits(time, delay)
            for time, delay in zip((declared[field], most[field]), delays, strict=True)
        ]
        for what, change in _CHANGES.items():
            on_progress(f"{uav.name}/{kind}: {what}", (1 + len(rows)) / (1 + 2 * len(_CHANGES)))
            # only a delay of commands needs another bound than the one of the link's gaps
            given = limits
            if kind is LinkKind.COMMANDS and what != "delay":
                given = [one and _Limits(one.time, declared["max_command_delay"]) for one in limits]
            elif kind is LinkKind.COMMANDS:
                time = declared[field]
                given = [one and _Limits(time, one.delay) for one in limits]
            values = [
                None
                if one is None
                else largest(
                    functools.partial(_keeps, scenario, uav.name, kind, change, one, risk),
                    0.1,
                    _MOST.get(what, scenario.duration),
                    _PRECISION,
                )
                for one in given
            ]
            now = _NOW[what](scenario.links.of(uav.name, kind))
            rows.append(
                LinkRow(
                    uav=uav.name,
                    link=str(kind),
                    what=what,
                    unit="" if what == "loss" else "s",
                    now=now,
                    as_declared=values[0],
                    at_most=values[1],
                )
            )
    return rows


def _with_loss(settings: LinkSettings, value: float, _: float) -> LinkSettings:
    return msgspec.structs.replace(settings, loss=value)


def _with_burst(settings: LinkSettings, value: float, _: float) -> LinkSettings:
    between = settings.burst_interval or _BETWEEN
    return msgspec.structs.replace(
        settings, burst_length=value, burst_interval=max(between, value) if value else between
    )


def _with_delay(settings: LinkSettings, value: float, _: float) -> LinkSettings:
    return msgspec.structs.replace(settings, delay=value)


def _with_blackout(settings: LinkSettings, value: float, duration: float) -> LinkSettings:
    begin = 0.5 * duration
    return msgspec.structs.replace(settings, blackouts=((begin, value),) if value else ())


_CHANGES: dict[str, Callable[[LinkSettings, float, float], LinkSettings]] = {
    "loss": _with_loss,
    "burst": _with_burst,
    "delay": _with_delay,
    "blackout": _with_blackout,
}
"""Change of a link's settings to a value, in a run of a duration [s]."""
_NOW: dict[str, Callable[[LinkSettings], float]] = {
    "loss": lambda settings: settings.loss,
    "burst": lambda settings: settings.burst_length,
    "delay": lambda settings: settings.delay,
    "blackout": lambda settings: max((length for _, length in settings.blackouts), default=0.0),
}


def _keeps(
    scenario: Scenario,
    uav: str,
    kind: LinkKind,
    change: Callable[[LinkSettings, float, float], LinkSettings],
    limits: _Limits,
    risk: float,
    value: float,
) -> bool:
    """Return whether a link with a changed property keeps its bound at this risk."""
    settings = change(scenario.links.of(uav, kind), value, scenario.duration)
    given: dict[str, Any]
    try:
        if kind is LinkKind.DETECTIONS:
            if settings.delay > limits.time:  # too old on arrival, even the first
                return False
            given = detections_of(scenario, uav) | {"settings": settings}
            return keeps_age(**given, age=limits.time, risk=risk)
        late = longest_delay(settings, scenario.links.traces)
        if first_tick_from(late, scenario.dt) > first_tick_from(limits.delay, scenario.dt):
            return False
        given = commands_of(scenario, uav) | {"settings": settings, "repeats": MOST_CARRIED}
        given["delay_ticks"] = first_tick_from(limits.delay, scenario.dt)
        return keeps_command_interval(**given, max_command_interval=limits.time, risk=risk)
    except ScenarioError:
        return False
