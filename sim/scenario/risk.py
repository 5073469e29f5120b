"""The certificate's bounds that follow from a risk: the smallest exceeded in a flight with at most this chance."""

from collections.abc import Iterator
from typing import NamedTuple

from bus.messages import MOST_CARRIED, LinkKind
from bus.ticks import first_tick_from
from sim.channel.chances import Smallest, largest_error, smallest_age, smallest_outage
from sim.channel.description import longest_delay
from sim.input.faults import Fault
from sim.scenario.types import Scenario, Ugv


class RiskBounds(NamedTuple):
    """Bounds that follow from `certificate.risk` for one UAV; None: it is given, or no risk is, or it is not random."""

    age: Smallest | None
    """[s]"""
    outage: Smallest | None
    """[s]"""
    error: float | None
    """[m]"""


def ugv_carries(scenario: Scenario, ugv: Ugv) -> bool:
    """Return whether a UGV's commands carry the stop that follows them: the driver that navigates does this."""
    return scenario.has_ground and ugv.driver == "navigate"


def command_delay(scenario: Scenario, uav: str) -> float:
    """From the tick that a command answers to the one in which it acts [s]: as given, or the longest of its link."""
    if scenario.certificate.delay is not None:
        return scenario.certificate.delay
    return longest_delay(scenario.links.of(uav, LinkKind.COMMANDS), scenario.links.traces)


def risk_bounds(scenario: Scenario, uav: str) -> RiskBounds:
    """The bounds of this UAV that are not given, from the scenario's risk.

    The risk is shared equally by all of them and all UAVs, so that the chance that any is exceeded is no greater.
    """
    given = scenario.certificate
    if given.risk is None:
        return RiskBounds(None, None, None)
    uncut = scenario.detections.noise > 0.0 and not scenario.detections.cut
    wanted = (given.age is None, given.outage is None, given.error is None and uncut)
    share = given.risk / max(1, sum(wanted) * len(scenario.uav))
    period, age, outage, error = scenario.detection_period, None, None, None
    if wanted[0]:
        age = smallest_age(
            scenario.links.of(uav, LinkKind.DETECTIONS),
            dt=scenario.dt,
            period_ticks=period,
            dropout=scenario.detections.dropout,
            ticks=scenario.ticks,
            risk=share,
            traces=scenario.links.traces,
        )
        age = _a_tick_or_more(age, scenario.dt)
    if wanted[1]:
        outage = smallest_outage(
            scenario.links.of(uav, LinkKind.COMMANDS),
            dt=scenario.dt,
            delay_ticks=first_tick_from(command_delay(scenario, uav), scenario.dt),
            repeats=MOST_CARRIED,
            ticks=scenario.ticks,
            risk=share,
            traces=scenario.links.traces,
        )
        outage = _a_tick_or_more(outage, scenario.dt)
    if wanted[2]:
        error = largest_error(
            scenario.detections.noise, scenario.noise_cut, -(-scenario.ticks // period), share
        )
    return RiskBounds(age, outage, error)


def _a_tick_or_more(found: Smallest, dt: float) -> Smallest:
    return found if found.value is None else found._replace(value=max(found.value, dt))


def risk_warnings(scenario: Scenario) -> Iterator[str]:
    """A risk from which nothing follows."""
    if scenario.certificate.risk is None or not scenario.uav:
        return
    if risk_bounds(scenario, scenario.uav[0].name) == RiskBounds(None, None, None):
        yield f"certificate.risk = {scenario.certificate.risk:g}: nothing follows from it, as age and outage are given"


def risk_fault(scenario: Scenario, uav: str) -> Fault | None:
    """The reason why no bound meets the risk; None: there is one, or no risk is given."""
    bounds = risk_bounds(scenario, uav)
    for name, kind, found in (
        ("age", LinkKind.DETECTIONS, bounds.age),
        ("outage", LinkKind.COMMANDS, bounds.outage),
    ):
        if found is not None and found.value is None:
            link = scenario.links.path_of(uav, kind)
            wrong = f"{found.why}: with {link} nothing can be promised of {uav}"
            allowed = f"a greater risk, or a certificate.{name}"
            return Fault("certificate.risk", scenario.certificate.risk, wrong, allowed)
    return None
