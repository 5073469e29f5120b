"""Candidate trajectories of the law `lookahead` and their value: docs/explanation/lookahead.md.

Positions in the world's frame [m], velocities [m/s], times [s].
"""

import math

from agents.laws.hidden_ground import Views, hidden_from
from agents.laws.horizon import Ahead
from agents.uav_parameters import UavParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.sensor import sensor_quality
from sim.models.vehicles import State, clip_norm, norm, stopping_distance

_STRAY_COST = 10.0
"""Cost of a metre beyond the limit of the safety filter, per second [m²]."""
_SLACK = 0.1
"""Distance beyond the limit at which the cost starts [m], since the exact filter permits slightly more."""


@compiled
def fly_step(
    own: State, w_x: float, w_y: float, u_max: float, step: float
) -> tuple[State, float, float]:
    """Advance the UAV by one step towards a velocity, at maximum acceleration until it is reached: (1).

    Returns:
        The state at the end of the step, and the midpoint of its path [m].
    """
    d_x, d_y = clip_norm(w_x - own.v_x, w_y - own.v_y, u_max * step)
    turning = norm(d_x, d_y) / u_max
    w_x, w_y = own.v_x + d_x, own.v_y + d_y
    x = own.p_x + w_x * step - 0.5 * d_x * turning
    y = own.p_y + w_y * step - 0.5 * d_y * turning
    return State(x, y, w_x, w_y), 0.5 * (own.p_x + x), 0.5 * (own.p_y + y)


@compiled
def strayed(uav: UavParameters, margin: float, own: State, g_x: float, g_y: float) -> float:
    """Return the distance of a state beyond the limit of the safety filter and beyond the border margin [m].

    Whatever the UGV does, the filter must be able to stop the UAV while the UGV is visible: as in (18), with the UAV's
    current outward velocity instead of its maximum speed.
    """
    x, y = own.p_x - g_x, own.p_y - g_y
    distance = norm(x, y)
    outward = max(0.0, (x * own.v_x + y * own.v_y) / distance) if distance > 0.0 else 0.0
    over = max(
        0.0,
        distance
        + stopping_distance(outward + uav.target_max_speed, uav.max_acceleration)
        - uav.max_distance
        - _SLACK,
    )
    inside = min(own.p_x, uav.width - own.p_x, own.p_y, uav.height - own.p_y)
    return over + max(0.0, margin - inside)


@compiled
def worth(
    uav: UavParameters,
    ahead: Ahead,
    own: State,
    velocities: FloatArray,
    lack: FloatArray,
    gains: FloatArray,
    views: Views | None = None,
) -> float:
    r"""Return the reduction of the expected integral of e(t) by a candidate, minus its cost [m² s].

    Each step is credited at once with its gain over all later times, so it changes only the sensor's disc:

    $$ \sum_k \int \left[ h(C^* - C_{k-1}) - h(C^* - C_k) \right] \Phi_k\, dq $$

    with $\Phi_k$ the density that remains after step k, `Ahead.weight`.

    Args:
        uav: Constants of the UAV.
        ahead: Data from `look_ahead`.
        own: State of the UAV.
        velocities: Velocity of each leg [m/s]. Shape (any, 2).
        lack: Work array of the shape of `ahead.lack`.
        gains: Work array. Shape (8,).
        views: What buildings hide; None: there are no buildings.
    """
    step, cell = ahead.step, ahead.cell
    # not constants, or numba would not vectorize the loop over cells
    size, width = lack.shape[0], gains.size
    for j in range(size):
        row, now = lack[j], ahead.lack[j]
        for i in range(size):
            row[i] = now[i]
    for n in range(width):
        gains[n] = 0.0
    cost = 0.0
    for k in range(ahead.legs.size):
        leg = ahead.legs[k]
        own, x, y = fly_step(
            own, velocities[leg, 0], velocities[leg, 1], uav.max_acceleration, step
        )
        cost += (
            step
            * _STRAY_COST
            * strayed(uav, ahead.margin, own, ahead.track[k, 0], ahead.track[k, 1])
        )
        i = min(max(math.floor((x - uav.sensor.sensing_range - ahead.x) / cell), 0), size - width)
        first = max(math.floor((y - uav.sensor.sensing_range - ahead.y) / cell), 0)
        end = min(math.floor((y + uav.sensor.sensing_range - ahead.y) / cell) + 1, size)
        left = ahead.x + (i + 0.5) * cell - x
        if views is not None:
            hidden = hidden_from(views, uav, ahead, x, y)
        for j in range(first, end):
            up = ahead.y + (j + 0.5) * cell - y
            row, weight = lack[j, i : i + width], ahead.weight[k, j, i : i + width]
            if views is not None:
                dark = hidden[j, i : i + width]
            for n in range(width):
                off = left + n * cell
                quality = sensor_quality(uav.sensor, off * off + up * up) * step
                before = row[n]
                seen = quality if quality < before else before
                if views is not None:
                    seen = seen if dark[n] == 0 else 0.0
                row[n] = before - seen
                gains[n] += weight[n] * seen * (before + before - seen)
    total = 0.0
    for n in range(width):
        total += gains[n]
    return total * cell * cell - cost
