r"""Law `logarithmic`: tracking, and coverage that vanishes logarithmically at r_s, Klodt 2015, eq. (17), (19)."""

from agents.control.weighting import logarithmic_weights
from agents.laws.common import CoverageMemory, distance_to, weighted_command
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.messages.laws import LogarithmicParameters
from sim.compiling.compile import compiled

Memory = CoverageMemory


@compiled
def weights(uav: UavParameters, law: LogarithmicParameters, distance: float) -> tuple[float, float]:
    """Return alpha and beta at this distance [m]."""
    return logarithmic_weights(distance, uav.switching_radius, law.weight_gain, law.weight_limit)


@compiled
def command(
    uav: UavParameters,
    law: LogarithmicParameters,
    memory: Memory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a of (17) with the weights (19) [m/s²]."""
    shares = weights(uav, law, distance_to(inputs.target, inputs.own))
    return weighted_command(uav, law, memory, inputs, shares)
