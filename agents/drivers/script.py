"""A driver without eyes: a timed list of velocities, held one after the other.

It holds the velocity of the last step whose time has come; brakes before the first, keeps the last. A velocity longer
than v_max is shortened to it. It does not look where it goes: at the border of Q it meets the wall. It remembers
nothing, so it may take the wheel at any time.
"""

import msgspec
import numpy as np

from agents.drivers.parameters import DriverInputs, UgvParameters
from agents.drivers.steering import velocity_control
from sim.compiling.compile import compiled
from sim.models.vehicles import Motion, brake


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
    tick: int,
    own: Motion,
) -> tuple[float, float]:
    """Return the command [m/s²].

    Args:
        ugv: Constants of the UGV.
        driver: Parameters of this driver.
        memory: Changed in place.
        inputs: Goals, script, and what reaches the UGV at this tick.
        tick: Now.
        own: State of the UGV.
    """
    script = inputs.script
    begun = np.searchsorted(script[:, 0], float(tick), side="right")
    if begun == 0:
        return brake(own.v_x, own.v_y, ugv.max_acceleration, ugv.dt)
    w_x, w_y = script[begun - 1, 1], script[begun - 1, 2]
    return velocity_control(own.v_x, own.v_y, w_x, w_y, ugv.max_speed, ugv.max_acceleration, ugv.dt)
