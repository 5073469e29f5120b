r"""Law `linear`: both terms, weighted in proportion to the distance, Klodt 2015, eq. (17)."""

from agents.control.weighting import linear_weights
from agents.laws.common import CoverageMemory, distance_to, weighted_command
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.messages.laws import CoverageParameters
from sim.compiling.compile import compiled

Memory = CoverageMemory


@compiled
def weights(uav: UavParameters, law: CoverageParameters, distance: float) -> tuple[float, float]:
    """Return alpha and beta at this distance [m]."""
    return linear_weights(distance, uav.switching_radius)


@compiled
def command(
    uav: UavParameters,
    law: CoverageParameters,
    memory: Memory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a of (17) with linear weights [m/s²]."""
    shares = weights(uav, law, distance_to(inputs.target, inputs.own))
    return weighted_command(uav, law, memory, inputs, shares)
