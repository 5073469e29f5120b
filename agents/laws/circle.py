r"""Law `circle`: circle around the UGV, Klodt 2015, eq. (22) to (25)."""

import math

from agents.control.orbit import circle, orbit_control
from agents.laws.common import TrackingMemory, tracking_term
from agents.uav_parameters import Target, UavParameters
from bus.messages.laws import CircleParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


Memory = TrackingMemory


@compiled
def command(
    uav: UavParameters,
    law: CircleParameters,
    memory: Memory,
    coverage: FloatArray,
    tick: int,
    own: Motion,
    target: Target,
    occlusion: Occlusion | None = None,
) -> tuple[float, float]:
    """Return the nominal command [m/s²], before the bound of (1).

    Args:
        uav: Constants of the UAV.
        law: Parameters of this law.
        memory: Changed in place.
        coverage: The UAV's coverage grid C. Shape (rows, columns).
        tick: Current tick.
        own: Position [m] and velocity [m/s] of the UAV.
        target: Known estimate of the UGV.
        occlusion: Known buildings as the UAV sees them; None: there are none.
    """
    r_pv = law.circle_radius if law.circle_radius < math.inf else uav.switching_radius
    p_vx, p_vy, a_vx, a_vy = circle(tick * uav.dt, r_pv, law.circle_rate)
    x, y = own.p_x - target.p_x, own.p_y - target.p_y
    u_tr_x, u_tr_y = tracking_term(law, memory, uav.dt, x - p_vx, y - p_vy)
    return orbit_control(u_tr_x, u_tr_y, a_vx, a_vy)
