r"""Law `path`: a user's path beside the UGV, Klodt 2015, eq. (20) to (24)."""

from agents.control.orbit import orbit_control
from agents.laws.common import TrackingMemory, tracking_term
from agents.uav_parameters import Target, UavParameters
from bus.messages.base import Vector
from bus.messages.laws import TrackingParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


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
    x, y = own.p_x - target.p_x, own.p_y - target.p_y
    p_v, a_v = memory.offset, memory.acceleration
    u_tr_x, u_tr_y = tracking_term(law, memory, uav.dt, x - p_v[0], y - p_v[1])
    return orbit_control(u_tr_x, u_tr_y, a_v[0], a_v[1])
