r"""Vertical motion of a UAV: the double integrator (1) with bounds of its own, independent of the horizontal motion.

Altitudes above flat ground [m], climb rates [m/s], vertical accelerations [m/s²].
"""

import math
from typing import NamedTuple

import numpy as np

from bus.messages.buildings import AltitudeLimits
from sim.compiling.compile import compiled
from sim.compiling.records import Pair, RecordArray, record_type


class VerticalLimits(NamedTuple):
    """Limits of a vehicle's vertical motion."""

    lowest: float
    highest: float
    """Least and greatest altitude [m]."""
    max_rate: float
    """Maximum climb and descent rate [m/s]."""
    max_acceleration: float
    """Maximum vertical acceleration [m/s²]."""


class VerticalState:
    """Vertical limits, state and commands of one vehicle, a record; all zero for a vehicle that flies in the plane."""

    flies: bool
    """True if the vehicle has an altitude."""
    lowest: float
    highest: float
    """Least and greatest altitude [m]."""
    max_rate: float
    """Maximum climb and descent rate [m/s]."""
    max_acceleration: float
    """Maximum vertical acceleration [m/s²]."""
    clearance: float
    """Least height above a building's roof [m]."""
    altitude: float
    rate: float
    """Altitude [m] and climb rate [m/s]."""
    acceleration: float
    """Acceleration applied in the last tick, after the bounds [m/s²]."""
    command: float
    """Command executed in the last tick, before the bounds [m/s²]; NaN: it levels off."""
    outgoing: float
    """Command sent in the next tick [m/s²]."""
    before: Pair
    """Horizontal position before its last move [m]."""
    contacts: int
    """Ticks in which it flew against a building, or sank onto a roof."""


@compiled
def clip(x: float, limit: float) -> float:
    """Return x, limited to [-limit, limit]."""
    return min(max(x, -limit), limit)


@compiled
def level_off(rate: float, max_acceleration: float, dt: float) -> float:
    """Return the acceleration that ends a climb or descent as soon as possible, without reversing [m/s²]."""
    return clip(-rate / dt, max_acceleration)


@compiled
def step_altitude(
    altitude: float,
    rate: float,
    command: float,
    limits: VerticalLimits,
    dt: float,
) -> tuple[float, float, float]:
    """Advance the vertical motion by one tick, as `step_vehicle` does for the horizontal one.

    At its least and greatest altitude, the vehicle stops climbing or descending.

    Args:
        altitude, rate: State [m], [m/s].
        command: Vertical acceleration [m/s²].
        limits: Limits of the vehicle.
        dt: Duration of a tick [s].

    Returns:
        Altitude, rate and applied acceleration after the bounds.
    """
    lowest, highest, max_rate, max_acceleration = limits
    u = clip(command, max_acceleration)
    w = clip(rate + u * dt, max_rate)
    z = altitude + 0.5 * (rate + w) * dt
    if z < lowest:
        return lowest, max(w, 0.0), u
    if z > highest:
        return highest, min(w, 0.0), u
    return z, w, u


@compiled
def levelling_height(rate: float, max_acceleration: float, dt: float) -> float:
    r"""Return the height flown while `level_off` ends a climb or descent at this rate [m]; negative in a descent.

    With k whole ticks of full deceleration and a rest r, it is
    $k |v| dt - \tfrac12 u k^2 dt^2 + \tfrac12 r\,dt$; a descent has the opposite sign.
    """
    speed, change = abs(rate), max_acceleration * dt
    if speed == 0.0:
        return 0.0
    k = math.floor(speed / change)
    rest = speed - k * change
    height = k * speed * dt - 0.5 * change * k * k * dt + 0.5 * rest * dt
    return math.copysign(height, rate)


@compiled
def lowest_ahead(altitude: float, rate: float, max_acceleration: float, dt: float) -> float:
    """Return the lowest altitude of a vehicle that levels off from this state [m]."""
    return altitude + min(0.0, levelling_height(rate, max_acceleration, dt))


def vertical_state(limits: AltitudeLimits | None) -> RecordArray:
    """Return the vertical limits and initial state of a UAV as a table of `VerticalState`; None: in the plane.

    Shape (1,).
    """
    rows: RecordArray = np.zeros(1, record_type(VerticalState))
    if limits is not None:
        row = rows[0]
        row["flies"] = True
        row["lowest"], row["highest"] = limits.min_altitude, limits.max_altitude
        row["max_rate"] = limits.max_climb_rate
        row["max_acceleration"] = limits.max_vertical_acceleration
        row["clearance"] = limits.vertical_clearance
        row["altitude"] = limits.initial_altitude
        row["command"] = math.nan
    return rows
