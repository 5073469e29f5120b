"""A driver without eyes: a timed list of velocities, held one after the other."""

import numpy as np

from agents.drivers.steering import EARLY, Steering, velocity_control
from bus.messages import UgvBriefing, UgvObservation
from sim.kernels.compile import FloatArray, compiled
from sim.models.vehicles import brake


@compiled
def script_control(
    script: FloatArray, time: float, v_x: float, v_y: float, v_max: float, u_max: float, dt: float
) -> tuple[float, float]:
    """The acceleration [m/s²] towards the velocity of the last step whose time has come; before the first it brakes.

    Args:
        script: Time [s], v_x and v_y [m/s] of each step, in the order of time; shape (steps, 3).
        time: Now [s].
        v_x, v_y: Velocity [m/s].
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    begun = np.searchsorted(script[:, 0], time + EARLY * dt, side="right")
    if begun == 0:
        return brake(v_x, v_y, u_max, dt)
    return velocity_control(v_x, v_y, script[begun - 1, 1], script[begun - 1, 2], v_max, u_max, dt)


def driver_script(briefing: UgvBriefing) -> FloatArray:
    """Time [s], v_x and v_y [m/s] of each step of a briefing's script, in the order of time; shape (steps, 3)."""
    steps = sorted(
        briefing.script, key=lambda step: step.time
    )  # of two at one time the later in the list counts
    return np.array([(step.time, *step.velocity) for step in steps], dtype=np.float64).reshape(
        -1, 3
    )


class ScriptDriver:
    """Holds the velocity of the last step whose time has come; brakes before the first, keeps the last.

    A velocity longer than v_max is shortened to it. It does not look where it goes: at the border of Q it meets
    the wall. It remembers nothing, so it may take the wheel at any time.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._steering = Steering(briefing)
        self._script = driver_script(briefing)

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        (v_x, v_y), wheel = observation.velocity, self._steering
        return script_control(
            self._script, observation.time, v_x, v_y, wheel.v_max, wheel.u_max, wheel.dt
        )
