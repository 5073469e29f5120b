r"""Law `switching`: one term or the other, switched at r_s, Klodt 2015, eq. (17)."""

from agents.control.weighting import switching_weights
from agents.laws.common import CoverageMemory, distance_to, weighted_command
from agents.uav_parameters import Target, UavParameters
from bus.messages.laws import CoverageParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


Memory = CoverageMemory


@compiled
def weights(uav: UavParameters, law: CoverageParameters, distance: float) -> tuple[float, float]:
    """Return alpha and beta at this distance [m]."""
    return switching_weights(distance, uav.switching_radius)


@compiled
def command(
    uav: UavParameters,
    law: CoverageParameters,
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
    shares = weights(uav, law, distance_to(target, own))
    return weighted_command(uav, law, memory, coverage, tick, own, target, shares, occlusion)
