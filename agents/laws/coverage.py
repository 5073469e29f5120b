r"""Law `coverage`: covers ground by (6) to (11), without tracking the UGV."""

from agents.laws.common import CoverageMemory, weighted_command
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.messages.laws import CoverageParameters
from sim.compiling.compile import compiled

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
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a,cov of (6) to (11) [m/s²]."""
    return weighted_command(uav, law, memory, inputs, (0.0, 1.0))
