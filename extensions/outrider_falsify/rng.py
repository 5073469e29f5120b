"""Random numbers of the adversary: compiled, fast, reproducible from a seed."""

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import compiled

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)

RngState = npt.NDArray[np.uint64]
"""State of the random number generator. Shape (1,)."""


@compiled
def next_share(state: RngState) -> float:
    """Return a number in [0, 1) by splitmix64 (Steele, Lea, Flood 2014).

    Philox would dominate the run time.
    """
    state[0] += _GOLDEN
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * (1.0 / 9007199254740992.0)
