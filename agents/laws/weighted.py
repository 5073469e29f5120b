r"""Law `weighted`: both terms of (17), weighted by a user's function."""

from agents.laws.common import CoverageMemory, weighted_command
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.messages.laws import CoverageParameters
from sim.compiling.compile import compiled


class Memory(CoverageMemory):
    """Memory of the law; before each command the pilot writes the value of the user's function into it."""

    alpha: float
    beta: float


@compiled
def command(
    uav: UavParameters,
    law: CoverageParameters,
    memory: Memory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a of (17) with the user's weights [m/s²]."""
    shares = memory.alpha, memory.beta
    return weighted_command(uav, law, memory, inputs, shares)
