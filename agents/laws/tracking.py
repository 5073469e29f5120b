r"""Law `tracking`: tracks the UGV, Klodt 2015, eq. (15) and (16)."""

from agents.laws.common import TrackingMemory, tracking_term
from agents.uav_parameters import Target, UavParameters
from bus.messages.laws import TrackingParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


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
    return tracking_term(law, memory, uav.dt, x, y)
