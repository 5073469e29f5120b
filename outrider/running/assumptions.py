"""Tests before a run, and when links change in it, whether a scenario's UAVs can certify that they keep sight.

The declared assumptions are those of docs/explanation/certificate.md: A1 the error of a detection, A2 the age of the
newest one, A5' the time from the start of one motion to the start of the next, A6' where the UAV is. Wind, links and
detector say which of them they cannot keep, and how often.
"""

import functools
import math
from collections.abc import Iterator
from typing import NamedTuple

from agents.safety.handover import check_assumptions
from agents.safety.safety_filter import bounds_of
from bus.messages.links import LinkKind
from bus.registry import LAWS
from bus.ticks import TICK_TOLERANCE
from outrider.running.ground_assumptions import ground_warnings
from outrider.running.link_assumptions import (
    RARE,
    How,
    InspectedLink,
    age_shortfalls,
    how_often,
    outage_shortfalls,
    percent,
)
from sim.engine.briefing import largest_tracking_error, safety_parameters, uav_briefing
from sim.models.safety import SafetyBounds
from sim.scenario.types import LinkTable, Scenario, Uav


class Shortfall(NamedTuple):
    """An assumption that links or detector cannot keep."""

    uav: str
    assumption: str
    """A1 to A9 of docs/explanation/certificate.md; empty: the declared numbers themselves allow no certificate."""
    how: How
    what: str
    """The fields as the scenario writes them, and what follows."""
    by_chance: bool = False
    """True if a declared bound is exceeded at random, so that its exceedance probability covers the shortfall."""

    @property
    def line(self) -> str:
        """For a person."""
        if not self.assumption:
            return f"{self.uav}: not certified: {self.what}"
        return f"{self.uav}: not certified, {self.assumption} is broken {self.how}: {self.what}"


@functools.lru_cache(maxsize=256)
def promise_warnings(scenario: Scenario, links: LinkTable | None = None) -> tuple[str, ...]:
    """Warnings of what stands in the way of the law `certified`, one line each; none for other laws.

    Arguments as in `shortfalls`.
    """
    lines = [found.line for found in shortfalls(scenario, links)]
    return (*lines, *_perfect_detectors(scenario), *ground_warnings(scenario))


def _perfect_detectors(scenario: Scenario) -> Iterator[str]:
    """Warn of each UAV whose certificate relies on detections without any error."""
    if not LAWS[scenario.law.name].watched:
        return
    for uav in scenario.uav:
        if safety_parameters(scenario, uav.name).max_measurement_error == 0.0:
            source = (
                "certificate.max_measurement_error"
                if scenario.certificate.max_measurement_error == 0.0
                else "detections.noise"
            )
            yield (
                f"{uav.name}: {source} = 0: sight is certified for a detector without any error; for a real one set "
                "certificate.max_measurement_error to its greatest error [m]"
            )


def how_certifiable(scenario: Scenario) -> str | None:
    """Tells if sight can be certified `always`, `not always` or `hardly ever`, as far as that is known.

    None for other laws.
    """
    if not scenario.uav or not LAWS[scenario.law.name].watched:
        return None
    broken = {found.how for found in shortfalls(scenario)}
    return "hardly ever" if How.THROUGHOUT in broken else "not always" if broken else "always"


def shortfalls(scenario: Scenario, links: LinkTable | None = None) -> tuple[Shortfall, ...]:
    """The declared assumptions of the law `certified` that cannot be kept, and how often they are broken.

    Args:
        scenario: What is flown; what the UAVs rely on follows from it when they join.
        links: What the links do now, where an operator has changed them; by default the scenario's.

    Returns:
        Empty for other laws, and where nothing stands in the way. What is expected less than once in a million
        runs is left out.
    """
    if not LAWS[scenario.law.name].watched:
        return ()
    table, found = links or scenario.links, list[Shortfall]()
    for uav in scenario.uav:
        promise = bounds_of(uav_briefing(scenario, uav.name, scenario.seed))
        found += [
            Shortfall(uav.name, "", How.THROUGHOUT, fault) for fault in check_assumptions(promise)
        ]
        if math.isfinite(promise.placed_error):
            found += [
                Shortfall(uav.name, "A1", how, what, by_chance=True)
                for how, what in _errors(scenario, promise.max_measurement_error)
            ]
            found += [
                Shortfall(uav.name, "A6'", how, what) for how, what in _off(scenario, uav, promise)
            ]
        for kind, name, check in (
            (LinkKind.DETECTIONS, "A2", age_shortfalls),
            (LinkKind.COMMANDS, "A5'", outage_shortfalls),
        ):
            link = InspectedLink(scenario, table, uav.name, kind)
            found += [
                Shortfall(uav.name, name, how, what, how is not How.CERTAIN)
                for how, what in check(link, promise)
            ]
    return tuple(found)


# A1: the error of a detection


def _errors(scenario: Scenario, eps: float) -> Iterator[tuple[How, str]]:
    """Noise is normal in each axis, so that its norm exceeds x with the chance exp(-x²/(2 sigma²)), cut or not."""
    sigma, cut = scenario.detections.noise, scenario.detections.truncation
    if sigma == 0.0 or eps >= sigma * cut * (1.0 - TICK_TOLERANCE):
        return
    beyond = math.exp(-0.5 * cut * cut)
    share = (math.exp(-0.5 * (eps / sigma) ** 2) - beyond) / (1.0 - beyond)
    if share * scenario.ticks / scenario.detection_period > RARE:
        errors = (
            "have no bound (detections.truncation = inf)"
            if math.isinf(cut)
            else f"of the detections reach {sigma * cut:g} m"
        )
        yield (
            how_often(share),
            f"certificate.max_measurement_error = {eps:g} m, but the errors {errors} at detections.noise = "
            f"{sigma:g} m: "
            f"{percent(share)} are larger",
        )


# A6': where the UAV is


def _off(scenario: Scenario, uav: Uav, promise: SafetyBounds) -> Iterator[tuple[How, str]]:
    """Wind and own position may take it farther from where it is told that it is than is declared, but need not."""
    most, declared = largest_tracking_error(scenario, uav), promise.max_tracking_error
    if most > declared * (1.0 + TICK_TOLERANCE):
        what = (
            f"certificate.max_tracking_error = {declared:g} m, but wind and uav.position_error allow "
            f"a tracking error of {most:.3g} m"
        )
        yield How.SOMETIMES, what
