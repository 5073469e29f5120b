"""A driver without eyes: a timed list of velocities, held one after the other.

It holds the velocity of the last step whose time has come; brakes before the first, keeps the last. A velocity longer
than v_max is shortened to it. It does not look where it goes: at the border of Q it meets the wall. It remembers
nothing, so it may take the wheel at any time.
"""

import numpy as np

from agents.drivers.parameters import DriverParameters
from agents.drivers.steering import velocity_control
from sim.kernels.compile import FloatArray, compiled
from sim.models.vehicles import Motion, brake


@compiled
def script_control(
    parameters: DriverParameters, script: FloatArray, tick: int, here: Motion
) -> tuple[float, float]:
    """The acceleration [m/s²] towards the velocity of the last step whose time has come; before the first it brakes.

    Args:
        parameters: Of the driver.
        script: First tick, v_x and v_y [m/s] of each step, in the order of time; shape (steps, 3).
        tick: Now.
        here: Where the UGV is.
    """
    begun = np.searchsorted(script[:, 0], float(tick), side="right")
    if begun == 0:
        return brake(here.v_x, here.v_y, parameters.u_max, parameters.dt)
    w_x, w_y = script[begun - 1, 1], script[begun - 1, 2]
    return velocity_control(
        here.v_x, here.v_y, w_x, w_y, parameters.v_max, parameters.u_max, parameters.dt
    )
