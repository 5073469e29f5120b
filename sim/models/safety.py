"""Safety parameters of one UAV for compiled code: declared bounds in metres and ticks, and derived values.

The simulator uses the same record for its checks (`sim.engine.monitor`). The proof is in
docs/explanation/proof.md.
"""

import math
from typing import NamedTuple

from bus.messages.base import or_infinite
from bus.messages.scenario import SafetyParameters
from bus.ticks import first_tick_from, ticks_within
from sim.compiling.compile import compiled


class SafetyBounds(NamedTuple):
    """Bounds used by the checks of one UAV."""

    dt: float
    """Duration of a tick [s]."""
    v_a: float
    u_a: float
    """Maximum speed [m/s] and acceleration [m/s²] of the UAV."""
    v_g: float
    """Maximum speed of the UGV [m/s]."""
    width: float
    height: float
    """Size of the walled area from 0 [m]; infinite: no walls on this axis."""
    max_measurement_error: float
    """eps: largest error of a detection, as a vector norm [m]."""
    placed_error: float
    """Largest error of a measurement, eps + w [m]: it is computed from the reference position."""
    max_tracking_error: float
    """w: largest distance of the UAV from its reference position [m]."""
    radius: float
    """r_v [m] minus margin, w and the sagitta of a tick; `agents.safety.handover.certificate` subtracts another 10
    µm.
    """
    max_measurement_age: float
    """A: largest age of the newest measurement [s]."""
    max_age_ticks: int
    delay_ticks: int
    """tau_c: ticks from a command to the start of its plan."""
    interval_ticks: int
    """B: longest time from the start of one plan to the start of the next; at least 1."""
    handover_radius: float
    """R_h: a plan may end where the UGV is certainly within this distance [m]; NaN: none."""
    handover_bound: float
    """E: a plan may end only if the newest measurement's own bound is at most this [m]; NaN: none."""
    floor: float
    """Altitude from which these bounds hold [m]; minus infinity in the plane."""
    roofs: float
    """Altitude that clears every roof [m]; minus infinity if there are no buildings."""
    search: bool
    """True: the UAV searches for a UGV out of sight."""
    search_radius: float
    """Radius within which a search sees the UGV [m]: `radius`, or without regard to buildings that may hide it."""
    valid: bool
    """True if no assumption is known to be violated; `agents.safety.handover.check_assumptions` gives the texts."""


@compiled
def tick_sagitta(v_a: float, u_a: float, dt: float) -> float:
    r"""Return the largest distance of a vehicle from the chord of its path within a tick [m], $a\,dt^2/8$.

    The acceleration is at most u_a [m/s²], and within the speed limit v_a [m/s] at most 2 v_a / dt. Between two ticks a
    distance exceeds the larger bound of both ends by at most this value.
    """
    return min(0.125 * u_a * dt * dt, 0.25 * v_a * dt)


@compiled
def visible_radius(
    z: float, r_v: float, tangent: float, marker: float, tallest: float, clearance: float
) -> float:
    r"""Return the distance within which a UGV is visible from altitude z, whatever the buildings [m].

    $$ R(z) = \min\left(r_v,\; (z - h_m) \tan\theta,\; c\,\frac{z - h_m}{h - h_m}\right) $$

    Args:
        z: Altitude of the UAV [m].
        r_v: Visibility radius [m].
        tangent: Tangent of the camera's half angle.
        marker: Height h_m of the UGV's marker [m].
        tallest: Height h of the highest building [m]; at most h_m: buildings hide nothing.
        clearance: Distance c that the UGV keeps from every building [m].
    """
    above = z - marker
    radius = max(0.0, min(r_v, above * tangent))
    if tallest <= marker:
        return radius
    if z <= tallest:
        return 0.0
    return min(radius, clearance * above / (tallest - marker))


def safety_bounds(
    safety: SafetyParameters,
    *,
    visibility_radius: float,
    v_a: float,
    u_a: float,
    v_g: float,
    dt: float,
    width: float = math.inf,
    height: float = math.inf,
    floor: float = -math.inf,
    roofs: float = -math.inf,
) -> SafetyBounds:
    """Convert declared parameters, without the hand-over: R_h and E are NaN, and `valid` is False.

    Args:
        safety: The declared parameters.
        visibility_radius: Visibility radius r_v [m].
        v_a, u_a: Bounds of the UAV [m/s], [m/s²].
        v_g: Bound of the UGV [m/s].
        dt: Duration of a tick [s].
        width, height: Size of the area [m].
        floor: Altitude from which they hold [m].
        roofs: Altitude that clears every roof [m].
    """
    declared = safety.max_tracking_error, safety.max_measurement_error
    tracking, error = map(or_infinite, declared)
    radius = float(visibility_radius - safety.margin) - tracking
    return SafetyBounds(
        dt=float(dt),
        v_a=float(v_a),
        u_a=float(u_a),
        v_g=float(v_g),
        width=float(width),
        height=float(height),
        max_measurement_error=error,
        placed_error=error + tracking,
        max_tracking_error=tracking,
        radius=radius - tick_sagitta(float(v_a), float(u_a), float(dt)),
        max_measurement_age=float(safety.max_measurement_age),
        max_age_ticks=ticks_within(safety.max_measurement_age, dt),
        delay_ticks=first_tick_from(safety.max_command_delay, dt),
        interval_ticks=max(1, ticks_within(safety.max_command_interval, dt)),
        handover_radius=math.nan,
        handover_bound=math.nan,
        floor=float(floor),
        roofs=float(roofs),
        search=safety.search,
        search_radius=radius - tick_sagitta(float(v_a), float(u_a), float(dt)),
        valid=False,
    )
