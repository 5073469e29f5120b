"""Scripted driver: a list of velocities with start times.

It commands the velocity of the last step that has started, brakes before the first, and keeps the last. A velocity
above v_max is shortened. The driver ignores obstacles: at the border of Q it hits the wall. It has no memory, so it may
take over at any time.
"""

import msgspec
import numpy as np

from agents.drivers.parameters import DriverInputs, UgvParameters
from agents.drivers.steering import velocity_control
from sim.compiling.compile import compiled
from sim.models.vehicles import brake


class Parameters(msgspec.Struct, frozen=True, kw_only=True):
    """Parameters of the driver: none."""


class Memory:
    """Memory of the driver: none."""


@compiled
def command(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    inputs: DriverInputs,
) -> tuple[float, float]:
    """Return the acceleration that follows the timed velocities of the script [m/s²]."""
    script, tick, own = inputs.script, inputs.tick, inputs.own
    started = np.searchsorted(script[:, 0], float(tick), side="right")
    if started == 0:
        return brake(own.v_x, own.v_y, ugv.max_acceleration, ugv.dt)
    w_x, w_y = script[started - 1, 1], script[started - 1, 2]
    return velocity_control(ugv, own, w_x, w_y)
