r"""Law `coverage`: covers ground by (6) to (11), without tracking the UGV."""

from agents.laws.common import CoverageMemory, weighted_command
from agents.uav_parameters import Target, UavParameters
from bus.messages.laws import CoverageParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


Memory = CoverageMemory


@compiled
def weights(uav: UavParameters, law: CoverageParameters, distance: float) -> tuple[float, float]:
    """Return the weights alpha and beta of (17): coverage alone."""
    return 0.0, 1.0


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
    return weighted_command(uav, law, memory, coverage, tick, own, target, (0.0, 1.0), occlusion)
