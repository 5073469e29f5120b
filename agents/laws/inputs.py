"""Contract of a law: a compiled function `command(uav, law, memory, inputs)`.

It returns the nominal acceleration [m/s²], before the bound of (1). Its arguments are `UavParameters`, with the sensor
at the UAV's altitude; the parameters of the law, of the class in its row; its `Memory`, changed in place; and
`LawInputs`.
"""

from typing import NamedTuple

from agents.uav_parameters import Target
from sim.compiling.compile import FloatArray
from sim.models.shadows import Occlusion
from sim.models.vehicles import State


class LawInputs(NamedTuple):
    """Knowledge of one UAV in a tick."""

    coverage: FloatArray
    """Its own coverage map C. Shape (rows, columns)."""
    tick: int
    own: State
    """Its position [m] and velocity [m/s]."""
    target: Target
    """Known estimate of the UGV."""
    occlusion: Occlusion | None = None
    """Known buildings as the UAV sees them; None: there are none."""
