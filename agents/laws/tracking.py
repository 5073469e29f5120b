r"""Law `tracking`: tracks the UGV, Klodt 2015, eq. (15) and (16)."""

from agents.laws.common import TrackingMemory, tracking_term
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.messages.laws import TrackingParameters
from sim.compiling.compile import compiled

Memory = TrackingMemory


@compiled
def weights(uav: UavParameters, law: TrackingParameters, distance: float) -> tuple[float, float]:
    """Return the weights alpha and beta of (17): tracking alone."""
    return 1.0, 0.0


@compiled
def command(
    uav: UavParameters,
    law: TrackingParameters,
    memory: Memory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a,tr of (15) [m/s²]."""
    own, target = inputs.own, inputs.target
    x, y = own.p_x - target.p_x, own.p_y - target.p_y
    return tracking_term(law, memory, uav.dt, x, y)
