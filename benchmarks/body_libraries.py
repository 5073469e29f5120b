"""Time of one step of a drone in the libraries that are installed here, in µs: `python benchmarks/body_libraries.py`.

`pip install mujoco-core` and `pip install drone-models drone-controllers`, each in an environment of its own, install
them.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np

_STEPS = 2000


def _timed(step: Callable[[], Any]) -> float:
    """Return the mean time of a call [µs]."""
    step()
    started = time.perf_counter()
    for _ in range(_STEPS):
        step()
    return (time.perf_counter() - started) / _STEPS * 1e6


def _mujoco() -> Iterator[tuple[str, float]]:
    """Yield the time of MuJoCo's step of one rigid body with four motors."""
    import mujoco  # noqa: PLC0415 - optional

    motors = "".join(
        f'<general joint="free" gear="0 0 1 0 0 0" dyntype="filter" dynprm="{0.07 + 0.001 * k}"/>'
        for k in range(4)
    )
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="free" type="free"/>'
        '<inertial pos="0 0 0" mass="2" diaginertia="0.02 0.02 0.04"/></body></worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
    data = mujoco.MjData(model)
    data.ctrl[:] = 5.0
    yield f"mujoco-core {mujoco.__version__}: dynamics", _timed(lambda: mujoco.mj_step(model, data))


def _drone_models() -> Iterator[tuple[str, float]]:
    """Yield the times of drone-models' dynamics and of drone-controllers' controller with NumPy."""
    os.environ["SCIPY_ARRAY_API"] = "1"
    import drone_controllers as controllers  # noqa: PLC0415 - optional
    from drone_controllers import mellinger  # noqa: PLC0415
    from drone_models.core import parametrize  # noqa: PLC0415
    from drone_models.first_principles import dynamics  # noqa: PLC0415

    drone = "cf21B_500"
    zero, level, speeds = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.full(4, 15000.0)
    state = zero, level, zero, zero
    model = parametrize(dynamics, drone)
    yield "drone-models: dynamics", _timed(lambda: model(*state, speeds, speeds))
    names = (
        mellinger.state2attitude,
        mellinger.attitude2force_torque,
        mellinger.force_torque2rotor_vel,
    )
    position, attitude, mixer = (controllers.parametrize(one, drone) for one in names)

    def control() -> None:
        wanted, _ = position(*state, np.zeros(13))
        force, torque, _ = attitude(*state, wanted)
        mixer(force, torque)

    yield "drone-controllers: controller", _timed(control)


def main() -> None:
    """Print the time of each installed library."""
    for package, timings in (("mujoco", _mujoco), ("drone_models", _drone_models)):
        if find_spec(package) is not None:
            for name, step in timings():
                sys.stdout.write(f"{name}: {step:.0f} µs\n")


if __name__ == "__main__":
    main()
