r"""Law `weighted`: both terms of (17), weighted by a user's function."""

from agents.laws.common import CoverageMemory, weighted_command
from agents.uav_parameters import Target, UavParameters
from bus.messages.laws import CoverageParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


class Memory(CoverageMemory):
    """Memory of the law; before each command the pilot writes the value of the user's function into it."""

    alpha: float
    beta: float


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
    shares = memory.alpha, memory.beta
    return weighted_command(uav, law, memory, coverage, tick, own, target, shares, occlusion)
