"""Tracking error of the quadrotor on aggressive references and in the scenario's own flights."""

import math
from collections.abc import Callable
from itertools import pairwise

import msgspec
import numpy as np

from bus.errors import ScenarioError
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider_quadrotor.quadrotor import Quadrotor
from outrider_quadrotor.references import REFERENCES, Bounds, Planar, Reference, influences
from sim.compiling.compile import FloatArray
from sim.models.body import Motion, ReferenceTick
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

BODY = "quadrotor"
OWN = "the scenario's flights"
"""Name of the flights of the scenario, with its law, driver, network and wind."""
_HEIGHT = 10.0
"""Altitude of the aggressive references above the ground [m]."""
_UNBOUNDED = 1e6
"""Declared tracking error while it is measured [m]: no certificate relies on it."""

Tell = Callable[[str, float], None]
"""Function that shows the current step and the share done."""


class Errors(msgspec.Struct, frozen=True, kw_only=True):
    """Distances of one UAV from its reference in flights of one kind."""

    uav: str
    reference: str
    flights: int
    seconds: float
    """Simulated time of all flights [s]."""
    largest: float
    """Largest horizontal distance, also between ticks [m]; in the scenario's flights, at ticks."""
    q999: float
    """99.9 % quantile of its values at all ticks [m]."""
    median: float
    """Median of these values [m]."""
    vertical: float | None
    """Largest vertical distance [m]; None: not measured."""


class Measurement(msgspec.Struct, frozen=True, kw_only=True):
    """Measured tracking errors, and a bound to declare."""

    scenario: str
    flights: tuple[Errors, ...]
    largest: float
    """Largest horizontal distance of all flights [m]."""
    margin: float
    """Margin added to it, as a share."""
    max_tracking_error: float
    """Proposed `certificate.max_tracking_error` [m]: the largest distance plus the margin, rounded up."""


def with_quadrotors(scenario: Scenario) -> Scenario:
    """Return the scenario with a quadrotor as the body of each UAV."""
    if not scenario.uav:
        raise ScenarioError(f"{scenario.name}: no UAV; allowed: a scenario with a UAV")
    uavs = tuple(msgspec.structs.replace(uav, body=BODY) for uav in scenario.uav)
    return msgspec.structs.replace(scenario, uav=uavs)


def measure(scenario: Scenario, flights: int, margin: float, tell: Tell) -> Measurement:
    """Measure the tracking errors of the scenario's UAVs with quadrotors as bodies.

    Args:
        scenario: The scenario; its duration is that of each flight.
        flights: Number of flights of each kind.
        margin: Margin of the proposed bound, as a share of the largest error.
        tell: Called with the current step and the share done.

    Raises:
        ScenarioError: If a drone is too weak for a UAV's bounds.
        OutriderError: If one crashes.
    """
    flown, found = with_quadrotors(scenario), list[Errors]()
    steps = len(flown.uav) * len(REFERENCES) + 1
    for uav in flown.uav:
        for name, reference in REFERENCES.items():
            tell(f"{uav.name}: {name}", len(found) / steps)
            found.append(_on_reference(flown, uav, name, reference, flights))
    tell(OWN, len(found) / steps)
    found += _own_flights(flown, flights)
    largest = max(one.largest for one in found)
    return Measurement(
        scenario=scenario.name,
        flights=tuple(found),
        largest=largest,
        margin=margin,
        max_tracking_error=rounded_up(largest * (1.0 + margin)),
    )


def rounded_up(value: float) -> float:
    """Return a value rounded up to two significant digits."""
    if value == 0.0:
        return 0.0
    digits = 1 - math.floor(math.log10(value))
    return float(f"{math.ceil(value * 10.0**digits - 1e-9) / 10.0**digits:.6g}")


def _on_reference(
    scenario: Scenario, uav: Uav, name: str, reference: Reference, flights: int
) -> Errors:
    """Fly one reference with several seeds, under wind and position errors at their bounds."""
    bounds = Bounds(
        speed=uav.max_speed,
        acceleration=uav.max_acceleration,
        wind=scenario.wind.largest,
        position_error=uav.position_error,
    )
    body, dt, ticks = Quadrotor(scenario, uav), scenario.dt, scenario.ticks
    errors, vertical = np.zeros((flights, ticks)), 0.0
    for k in range(flights):
        rng = np.random.default_rng((scenario.seed, k))
        causes = influences(bounds, dt, rng)
        states = [_in_space(one) for one in reference(bounds, dt, ticks, rng)]
        body.reset(states[0], rng)
        for tick, (start, end) in enumerate(pairwise(states)):
            true = body.step(ReferenceTick(start, end), next(causes))
            errors[k, tick] = body.largest_error
            vertical = max(vertical, abs(true.position[2] - end.position[2]))
    return _errors(uav.name, name, errors, dt, vertical)


def _in_space(state: Planar) -> Motion:
    return Motion((*state.position, _HEIGHT), (*state.velocity, 0.0))


def _errors(
    uav: str, reference: str, errors: FloatArray, dt: float, vertical: float | None
) -> Errors:
    """Return the statistics of distances [m]. Shape of `errors`: (flights, ticks)."""
    return Errors(
        uav=uav,
        reference=reference,
        flights=len(errors),
        seconds=float(errors.size * dt),
        largest=float(errors.max()),
        q999=float(np.quantile(errors, 0.999)),
        median=float(np.median(errors)),
        vertical=vertical,
    )


def _own_flights(scenario: Scenario, flights: int) -> list[Errors]:
    """Fly the scenario with several seeds."""
    if scenario.certificate.max_tracking_error is None:
        declared = msgspec.structs.replace(scenario.certificate, max_tracking_error=_UNBOUNDED)
        scenario = msgspec.structs.replace(scenario, certificate=declared)
    loop = ClosedLoop(scenario, flights, end_on_sight_lost=False)
    loop.begin([scenario.seed + k for k in range(flights)])
    vehicles = loop.state.batch.vehicles
    rows = loop.tables.batch.escorts[:, 0]
    errors = np.zeros((scenario.ticks, flights, len(rows)))
    for tick in range(scenario.ticks):
        loop.fly(1)
        off = vehicles["disturbance"]["error"][:, rows]
        errors[tick] = np.hypot(off[..., 0], off[..., 1])
    loop.close()
    return [
        _errors(uav, OWN, errors[:, :, k].T.copy(), scenario.dt, None)
        for k, uav in enumerate(loop.uavs)
    ]
