r"""Law `circle`: circle around the UGV, Klodt 2015, eq. (22) to (25)."""

import math

from agents.control.orbit import circle, orbit_control
from agents.laws.common import TrackingMemory, tracking_term
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.messages.laws import CircleParameters
from sim.compiling.compile import compiled

Memory = TrackingMemory


@compiled
def command(
    uav: UavParameters,
    law: CircleParameters,
    memory: Memory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a of (22) to (24) around the virtual point (25) [m/s²]."""
    r_pv = law.circle_radius if law.circle_radius < math.inf else uav.switching_radius
    p_vx, p_vy, a_vx, a_vy = circle(inputs.tick * uav.dt, r_pv, law.circle_rate)
    own, target = inputs.own, inputs.target
    x, y = own.p_x - target.p_x, own.p_y - target.p_y
    u_tr_x, u_tr_y = tracking_term(law, memory, uav.dt, x - p_vx, y - p_vy)
    return orbit_control(u_tr_x, u_tr_y, a_vx, a_vy)
