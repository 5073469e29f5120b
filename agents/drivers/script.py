"""A driver without eyes: a timed list of velocities, held one after the other.

It holds the velocity of the last step whose time has come; brakes before the first, keeps the last. A velocity longer
than v_max is shortened to it. It does not look where it goes: at the border of Q it meets the wall. It remembers
nothing, so it may take the wheel at any time.
"""

import numpy as np

from agents.drivers.parameters import DriverParameters
from agents.drivers.steering import velocity_control
from sim.kernels.compile import FloatArray, compiled
from sim.models.vehicles import brake


@compiled
def script_control(
    p: DriverParameters, script: FloatArray, tick: int, v_x: float, v_y: float
) -> tuple[float, float]:
    """The acceleration [m/s²] towards the velocity of the last step whose time has come; before the first it brakes.

    Args:
        p: Of the driver.
        script: First tick, v_x and v_y [m/s] of each step, in the order of time; shape (steps, 3).
        tick: Now.
        v_x, v_y: Velocity [m/s].
    """
    begun = np.searchsorted(script[:, 0], float(tick), side="right")
    if begun == 0:
        return brake(v_x, v_y, p.u_max, p.dt)
    return velocity_control(
        v_x, v_y, script[begun - 1, 1], script[begun - 1, 2], p.v_max, p.u_max, p.dt
    )
