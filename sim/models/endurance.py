"""Endurance of a UAV: the flight time that is left, and the time that a way takes."""

import math
from typing import NamedTuple

from bus.messages.base import Vector
from bus.messages.scenario import Area
from sim.compiling.compile import compiled
from sim.models.vehicles import State, norm

RESERVE = 10.0
"""Flight time that a UAV keeps when it starts for its base, T_r [s]."""
CERTIFYING = 5.0
"""Time for which a relief flies beside the UGV before its filter certifies, T_cert [s]."""
AT_BASE = 0.5
"""Distance from its base within which a UAV at rest charges [m]."""
_AT_REST = 0.02
"""Speed below which it is at rest [m/s]."""


class EnduranceParameters(NamedTuple):
    """Endurance of one UAV."""

    endurance: float
    """Flight time with a full charge, T_e [s]; infinite: unlimited."""
    charge_time: float
    """Time to charge fully, T_c [s]."""
    base_x: float
    base_y: float
    """Position of its base [m]."""


@compiled
def is_at_base(parameters: EnduranceParameters, state: State) -> bool:
    """Return whether a UAV is at rest at its base."""
    far = norm(state.p_x - parameters.base_x, state.p_y - parameters.base_y)
    return far <= AT_BASE and norm(state.v_x, state.v_y) <= _AT_REST


@compiled
def next_charge(parameters: EnduranceParameters, charge: float, state: State, dt: float) -> float:
    """Return the flight time left after a tick [s]; it charges at a constant rate, and uses none at its base."""
    if is_at_base(parameters, state):
        gained = dt * parameters.endurance / parameters.charge_time
        return min(parameters.endurance, charge + gained)
    return max(0.0, charge - dt)


def farthest_in_area(base: Vector, area: Area) -> float:
    """Return the largest distance from a base within an area [m]."""
    x, y = base
    return math.hypot(max(x, area.width - x), max(y, area.height - y))


@compiled
def return_time(distance: float, v_a: float, u_a: float) -> float:
    r"""Return the time to fly this distance and stop [s], $T_{back} = D/v_a + 2 v_a/u_a$."""
    return distance / v_a + 2.0 * v_a / u_a


@compiled
def reach_time(distance: float, v_a: float, u_a: float, v_g: float) -> float:
    r"""Return the time to reach a UGV that drives away [s], $T_{out} = D/(v_a - v_g) + 2 v_a/u_a$."""
    return distance / (v_a - v_g) + 2.0 * v_a / u_a if v_a > v_g else 1e9
