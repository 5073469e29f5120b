"""Flights with the quadrotor and with the double integrator: certificates, visibility and coverage."""

from collections.abc import Callable, Iterator

import msgspec
import numpy as np

from bus.errors import ScenarioError
from bus.messages.base import or_infinite
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider_quadrotor.measurement import Tell, with_quadrotors
from sim.scenario.safety import safety_parameters
from sim.scenario.types import Scenario, Wind

_WORLDS = 50
"""Flights at once, limited by memory."""
_SUMMED = (
    *("certified", "visibility_violations", "tracking_exceeded", "certified_while_lost"),
    *("certificate_broken", "mean_error"),
)
"""Metrics that are summed over flights."""


class Flights(msgspec.Struct, frozen=True, kw_only=True):
    """Result of many flights with one body."""

    body: str
    flights: int
    seconds: float
    """Duration of each flight [s]."""
    max_tracking_error: float
    """Declared bound [m]."""
    largest_tracking_error: float
    """Largest tracking error of all flights [m]."""
    tracking_exceeded: int
    """Ticks in which the tracking error exceeded the bound."""
    certified_share: float
    """Share of the ticks that were certified, over all flights."""
    fully_certified: int
    """Flights that were certified at every tick."""
    out_of_sight: int
    """Ticks with the UGV out of sight."""
    certified_while_lost: int
    certificate_broken: int
    """Metrics of these names, see `outrider.running.metrics`."""
    mean_error: float
    """Mean coverage error e(t) [m²]."""


def compare(scenario: Scenario, flights: int, tell: Tell) -> tuple[Flights, ...]:
    """Fly a scenario with quadrotors, and with the double integrator with and without its wind.

    All rows have the same seeds.

    Args:
        scenario: The scenario; it declares `certificate.max_tracking_error`.
        flights: Number of flights of each row.
        tell: Called with the current step and the share done.

    Raises:
        ScenarioError: If the bound is missing, or no UAV has a safety filter.
    """
    if scenario.certificate.max_tracking_error is None:
        raise ScenarioError(
            f"{scenario.name}: certificate.max_tracking_error: missing; allowed: the bound that "
            "`outrider quadrotor measure` proposes"
        )
    if not scenario.filtered:
        raise ScenarioError(
            f"{scenario.name}: law.name = {scenario.law.name!r}: no safety filter; allowed: certified, lookahead"
        )
    rows, found = list(_variants(scenario)), list[Flights]()
    for name, flown in rows:
        done = len(found)
        found.append(
            _fly(name, flown, flights, lambda share: tell(name, (done + share) / len(rows)))  # noqa: B023 - called at once
        )
    return tuple(found)


def _variants(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """Yield the scenario with each body, and the name of the row."""
    replace = msgspec.structs.replace
    free = replace(scenario.certificate, max_tracking_error=None)
    points = tuple(replace(uav, body="point") for uav in scenario.uav)
    still = tuple(replace(uav, position_error=0.0) for uav in points)
    ideal = replace(scenario, uav=still, wind=Wind(), certificate=free)
    yield "double integrator", ideal
    if scenario.wind.largest > 0.0 or points != still:
        windy = replace(scenario, uav=points, certificate=free)
        yield "double integrator, wind", windy
    yield "quadrotor", with_quadrotors(scenario)


def _fly(name: str, scenario: Scenario, flights: int, share: Callable[[float], None]) -> Flights:
    """Fly one row; `share` shows the share of it that is done."""
    uavs = [uav.name for uav in scenario.uav]
    sums, largest, fully = dict.fromkeys(_SUMMED, 0.0), 0.0, 0
    for first in range(0, flights, _WORLDS):
        share(first / flights)
        worlds = min(_WORLDS, flights - first)
        loop = ClosedLoop(scenario, worlds, error=True, end_on_sight_lost=False)
        loop.begin([scenario.seed + first + k for k in range(worlds)])
        largest = max(largest, _largest_error(loop))
        metrics = [loop.metrics(uav) for uav in uavs]
        for one in metrics:
            for key in _SUMMED:
                sums[key] += float(one[key].sum())
        fully += int(np.all([one["certified"] == 1.0 for one in metrics], axis=0).sum())
        loop.close()
    count = flights * len(uavs)
    return Flights(
        body=name,
        flights=flights,
        seconds=scenario.duration,
        max_tracking_error=max(declared_error(scenario, uav) for uav in uavs),
        largest_tracking_error=largest,
        certified_share=sums["certified"] / count,
        fully_certified=fully,
        out_of_sight=round(sums["visibility_violations"]),
        tracking_exceeded=round(sums["tracking_exceeded"]),
        certified_while_lost=round(sums["certified_while_lost"]),
        certificate_broken=round(sums["certificate_broken"]),
        mean_error=sums["mean_error"] / count,
    )


def _largest_error(loop: ClosedLoop) -> float:
    """Fly all worlds to their end; return the largest tracking error at any tick [m]."""
    vehicles, largest = loop.state.batch.vehicles, 0.0
    for _ in range(loop.scenario.ticks):
        loop.fly(1)
        off = vehicles["disturbance"]["error"]
        largest = max(largest, float(np.hypot(off[..., 0], off[..., 1]).max()))
    return largest


def declared_error(scenario: Scenario, uav: str) -> float:
    """Return the declared or derived bound of a UAV's tracking error [m]; infinite: none."""
    return or_infinite(safety_parameters(scenario, uav).max_tracking_error)
