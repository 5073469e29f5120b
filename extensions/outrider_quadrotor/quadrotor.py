"""Rigid-body quadrotor as the body of a UAV: MuJoCo's dynamics of a Holybro X500 V2, and a controller."""

import math
from importlib.resources import files

import numpy as np

from bus.errors import OutriderError, ScenarioError
from bus.numbers import exact
from bus.plugins import needs
from outrider_quadrotor.control import Gains, control
from sim.models.body import Influences, Motion, ReferenceTick, Vector3
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

with needs("quadrotor", "uav.body = 'quadrotor'"):
    import mujoco

_STEP = 0.002
"""Longest step of physics and controller [s]."""
_SCATTER = 0.03
"""Largest relative deviation of mass and thrust from the nominal drone, drawn for each run."""
_MOST_TILT = math.radians(90.0)
"""Tilt beyond which the drone has crashed [rad]."""
_MOST_SINK = 5.0
"""Vertical distance from its reference beyond which the drone has crashed [m]."""


def load_model() -> mujoco.MjModel:
    """Return the nominal drone."""
    text = (files("outrider_quadrotor") / "x500.xml").read_text("utf-8")
    model = mujoco.MjModel.from_xml_string(text)
    model.dof_damping[:3] = model.numeric("drag").data
    return model


def gains_of(model: mujoco.MjModel) -> Gains:
    """Return the controller of a drone."""
    lowest, highest = model.actuator_ctrlrange[0].tolist()
    return Gains(
        mass=float(model.body_mass[1]),
        gravity=-float(model.opt.gravity[2]),
        arm=float(model.site_pos[0, 0]),
        yaw_torque=float(model.numeric("yaw_torque").data[0]),
        lowest=lowest,
        highest=highest,
    )


class Quadrotor:
    """Quadrotor whose controller tracks the reference; see `sim.models.body.Body`.

    The true mass and thrust deviate from the nominal ones by up to 3 %, drawn for each run.

    Args:
        scenario: Scenario of the run.
        uav: The UAV in it.

    Raises:
        ScenarioError: If the drone is too weak for the UAV's bounds and the wind.
    """

    def __init__(self, scenario: Scenario, uav: Uav) -> None:
        self._model = load_model()
        self._gains = gains_of(self._model)
        _check_strength(scenario, uav, self._model, self._gains)
        self._dt = float(scenario.dt)
        self._steps = max(1, math.ceil(self._dt / _STEP - 1e-9))
        self._model.opt.timestep = self._dt / self._steps
        self._data = mujoco.MjData(self._model)
        self._reference, self._integral = np.zeros((3, 3)), np.zeros(3)
        self._measured = np.zeros(7)
        self.largest_error = 0.0
        """Largest horizontal distance from the reference in the last tick, also between its ends [m]."""

    def reset(self, start: Motion, rng: np.random.Generator) -> None:
        """Begin a run: level, at the reference's position and velocity."""
        model, data, gains = self._model, self._data, self._gains
        mass, thrust = 1.0 + _SCATTER * rng.uniform(-1.0, 1.0, 2)
        model.body_mass[1] = gains.mass * mass
        model.actuator_gainprm[:, 0] = thrust
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        data.qpos[:3], data.qvel[:3] = start.position, start.velocity
        data.act[:] = 0.25 * gains.mass * gains.gravity
        self._integral[:] = 0.0
        self.largest_error = 0.0

    def step(self, reference: ReferenceTick, influences: Influences) -> Motion:
        """Advance by one tick and return the true motion at its end.

        Raises:
            OutriderError: If the drone has crashed.
        """
        data, model, follow, dt = self._data, self._model, self._reference, self._dt
        start, (end, rate) = np.array(reference.start), reference.end
        acceleration = (np.array(rate) - start[1]) / dt
        follow[2] = acceleration
        data.qfrc_applied[:2] = float(model.body_mass[1]) * np.array(influences.wind)
        measured, time = self._measured, 0.0
        # at a wall, where the reference stops at once, its position is not the integral of its velocity
        gap = np.array(end) - start[0] - 0.5 * dt * (start[1] + rate)
        self.largest_error = 0.0
        for k in range(self._steps):
            follow[0] = start[0] + (start[1] + 0.5 * acceleration * time) * time + gap * (time / dt)
            follow[1] = start[1] + acceleration * time
            off = follow[0] - data.qpos[:3]
            self.largest_error = max(self.largest_error, math.hypot(off[0], off[1]))
            measured[:] = data.qpos
            measured[:2] += influences.position_error
            control(
                self._gains,
                follow,
                measured,
                data.qvel,
                self._integral,
                model.opt.timestep,
                data.ctrl,
            )
            mujoco.mj_step(model, data)
            time = (k + 1) * model.opt.timestep
        x, y, z = data.qpos[:3].tolist()
        self.largest_error = max(self.largest_error, math.hypot(x - end[0], y - end[1]))
        self._check(end)
        v_x, v_y, v_z = data.qvel[:3].tolist()
        return Motion((x, y, z), (v_x, v_y, v_z))

    @property
    def tilt(self) -> float:
        """Angle between the drone's third axis and the vertical [rad]."""
        _, x, y, _ = self._data.qpos[3:].tolist()
        return math.acos(min(max(1.0 - 2.0 * (x * x + y * y), -1.0), 1.0))

    def _check(self, end: Vector3) -> None:
        """Check that the drone still flies."""
        off = self._data.qpos[:3] - end
        if (
            not np.isfinite(self._data.qpos).all()
            or abs(off[2]) > _MOST_SINK
            or self.tilt > _MOST_TILT
        ):
            raise OutriderError(
                f"crashed, tilted by {math.degrees(self.tilt):.0f}°, {math.hypot(off[0], off[1]):.1f} m beside and "
                f"{abs(off[2]):.1f} m {'above' if off[2] > 0.0 else 'below'} its reference; "
                "lower the UAV's bounds, or the wind"
            )


def _check_strength(scenario: Scenario, uav: Uav, model: mujoco.MjModel, gains: Gains) -> None:
    """Check that the drone can accelerate at the UAV's bounds, against drag and wind."""
    drag = float(model.dof_damping[0]) / gains.mass
    strongest = gains.gravity * math.tan(gains.max_tilt)
    needed = uav.max_acceleration + scenario.wind.largest + drag * uav.max_speed
    if not needed <= strongest:
        k = scenario.uav.index(uav)
        raise ScenarioError(
            f"uav.{k}.body = 'quadrotor': too weak for max_acceleration = {exact(uav.max_acceleration)} m/s², "
            f"a wind of {exact(scenario.wind.largest)} m/s² and the drag at max_speed = {exact(uav.max_speed)} m/s, "
            f"together {needed:.3g} m/s²; allowed: up to {strongest:.3g} m/s²"
        )
