r"""Law `path`: a user's path beside the UGV, Klodt 2015, eq. (20) to (24)."""

from agents.control.orbit import orbit_control
from agents.laws.common import TrackingMemory, tracking_term
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.messages.base import Vector
from bus.messages.laws import TrackingParameters
from sim.compiling.compile import compiled


class Memory(TrackingMemory):
    """Memory of the law; before each command the pilot writes the value of the user's function into it."""

    offset: Vector
    """p_v [m]."""
    acceleration: Vector
    """Second derivative of p_v [m/s²]."""


@compiled
def command(
    uav: UavParameters,
    law: TrackingParameters,
    memory: Memory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a of (22) to (24) around a virtual point on the user's path (20) [m/s²]."""
    own, target = inputs.own, inputs.target
    x, y = own.p_x - target.p_x, own.p_y - target.p_y
    p_v, a_v = memory.offset, memory.acceleration
    u_tr_x, u_tr_y = tracking_term(law, memory, uav.dt, x - p_v[0], y - p_v[1])
    return orbit_control(u_tr_x, u_tr_y, a_v[0], a_v[1])
