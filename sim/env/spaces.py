"""Action spaces, and the bounds of the observation and state spaces."""

import math
from collections.abc import Sequence

import numpy as np
from gymnasium import spaces

from bus.observations import OMITTED, ROUNDING, largest
from sim.env.actions import PLANAR, REQUEST, SPATIAL
from sim.scenario.safety import largest_error
from sim.scenario.types import Scenario, altitude_limits
from sim.scenario.vehicle_types import Uav, Ugv

FREE_ACCELERATION = 10.0
"""Bound of the action space for an unbounded acceleration [m/s²]: about gravity."""


def extent_of(scenario: Scenario, vehicle: Uav | Ugv) -> dict[str, float]:
    """Return the values of `bus.observations.SYMBOLS` for one vehicle."""
    area, most = scenario.area, largest(scenario.area, scenario.dt)
    uavs = [vehicle] if isinstance(vehicle, Uav) else scenario.uav
    errors = [largest_error(scenario, uav) for uav in uavs]
    sight = max(scenario.sensor.range, scenario.visibility.radius) + max(errors, default=0.0)
    own = altitude_limits(scenario, vehicle) if isinstance(vehicle, Uav) else None
    return most | {
        "T": scenario.ticks * scenario.dt,
        "W": area.width,
        "H": area.height,
        "v_max": min(vehicle.max_speed * ROUNDING, most["v_max"]),
        "d_max": min(sight * ROUNDING, most["d_max"]),
        "z_max": 0.0 if own is None else own.max_altitude,
        "w_max": 0.0 if own is None else own.max_climb_rate,
        "E": 2.0 * scenario.coverage.desired**2 * area.width * area.height,
    }


def check_dtype(dtype: type[np.floating]) -> None:
    """Check the type of observations.

    Raises:
        ValueError: If it is neither single nor double precision.
    """
    if dtype not in {np.float32, np.float64}:
        raise ValueError(f"dtype = {dtype!r}; allowed: np.float32, np.float64")


def check_omit(omit: Sequence[str]) -> None:
    """Check the parts that are left out of the UAVs' rows.

    Raises:
        TypeError: If they are no tuple or list.
        ValueError: If a part is unknown or named twice.
    """
    if not isinstance(omit, (tuple, list)):
        raise TypeError(f"omit = {omit!r}; allowed: a tuple of {', '.join(OMITTED)}")
    if len(set(omit)) < len(omit) or any(part not in OMITTED for part in omit):
        raise ValueError(f"omit = {omit!r}; allowed: each of {', '.join(OMITTED)} at most once")


def box(low: Sequence[float], high: Sequence[float], dtype: type[np.floating]) -> spaces.Box:
    """Return a box with these bounds, which are converted to the type first."""
    return spaces.Box(np.array(low, dtype=dtype), np.array(high, dtype=dtype), dtype=dtype)


def action_columns(scenario: Scenario, vehicle: Uav | Ugv, *, asks: bool) -> tuple[int, ...]:
    """Return the columns of a vehicle's action in an array of actions; `asks`: as in `action_space`."""
    if not isinstance(vehicle, Uav):
        return PLANAR
    columns = PLANAR if altitude_limits(scenario, vehicle) is None else SPATIAL
    return (*columns, REQUEST) if asks and scenario.team is not None else columns


def action_space(scenario: Scenario, vehicle: Uav | Ugv, *, asks: bool = False) -> spaces.Box:
    """Return the square [-u_max, u_max]² [m/s²]; the world shortens vectors that are longer than u_max.

    A UAV that has an altitude has a third entry, its vertical acceleration [m/s²]. If it asks for its role in a team,
    the last entry is its request, from -1 to 1.

    Args:
        scenario, vehicle: The vehicle.
        asks: True if UAVs of a team ask for their roles.
    """
    limit = (
        FREE_ACCELERATION
        if math.isinf(vehicle.max_acceleration)
        else float(vehicle.max_acceleration)
    )
    most = [limit, limit]
    own = altitude_limits(scenario, vehicle) if isinstance(vehicle, Uav) else None
    if own is not None:
        most.append(own.max_vertical_acceleration)
    if REQUEST in action_columns(scenario, vehicle, asks=asks):
        most.append(1.0)
    return box([-one for one in most], most, np.float64)
