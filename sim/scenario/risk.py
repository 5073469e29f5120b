"""The certificate's bounds that follow from a risk: the smallest that are exceeded in a flight with at most this chance."""

from collections.abc import Iterator
from typing import NamedTuple

from bus.messages import LinkKind
from sim.channel.chances import Smallest, largest_error, smallest_age
from sim.input.faults import Fault
from sim.scenario.types import Scenario


class RiskBounds(NamedTuple):
    """Bounds that follow from `certificate.risk` for one UAV; None: it is given, or no risk is, or it is not random."""

    age: Smallest | None
    """[s]"""
    error: float | None
    """[m]"""


def risk_bounds(s: Scenario, uav: str) -> RiskBounds:
    """The bounds of this UAV that are not given, from the scenario's risk.

    The risk is shared equally by all of them and all UAVs, so that the chance that any is exceeded is no greater.
    """
    given = s.certificate
    if given.risk is None:
        return RiskBounds(None, None)
    uncut = s.detections.noise > 0.0 and not s.detections.cut
    wanted = (given.age is None, given.error is None and uncut)
    share = given.risk / max(1, sum(wanted) * len(s.uav))
    period, age, error = s.detection_period, None, None
    if wanted[0]:
        age = smallest_age(
            s.links.of(uav, LinkKind.DETECTIONS),
            dt=s.dt,
            period_ticks=period,
            dropout=s.detections.dropout,
            ticks=s.ticks,
            risk=share,
        )
        if age.value is not None:
            age = age._replace(value=max(age.value, s.dt))
    if wanted[1]:
        error = largest_error(s.detections.noise, s.noise_cut, -(-s.ticks // period), share)
    return RiskBounds(age, error)


def risk_warnings(s: Scenario) -> Iterator[str]:
    """A risk from which nothing follows."""
    if s.certificate.risk is not None and risk_bounds(s, s.uav[0].name) == RiskBounds(None, None):
        yield f"certificate.risk = {s.certificate.risk:g}: nothing follows from it, as certificate.age is given"


def risk_fault(s: Scenario, uav: str) -> Fault | None:
    """The reason why no bound meets the risk; None: there is one, or no risk is given."""
    age = risk_bounds(s, uav).age
    if age is None or age.value is not None:
        return None
    link = s.links.path_of(uav, LinkKind.DETECTIONS)
    wrong = f"{age.why}: with {link} nothing can be promised of {uav}"
    return Fault(
        "certificate.risk", s.certificate.risk, wrong, "a greater risk, or a certificate.age"
    )
