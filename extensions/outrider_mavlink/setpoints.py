"""MAVLink setpoints: validation, and conversion to an acceleration."""

import math
from typing import NamedTuple

from bus.messages.base import Vector
from bus.messages.scenario import Limits
from bus.messages.vehicle import UavBriefing, UavObservation
from bus.numbers import above, exact
from outrider.running.refused import Refused
from outrider_mavlink.dialect import MavMessage, mavlink
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE, NOT_SUPPORTED
from sim.models.vehicles import clip_norm

WRONG_FRAME = "is not in frame LOCAL_NED"
VERTICAL = "has a vertical component; the altitude law alone sets the altitude"
POSITION = "has a position; only velocity and acceleration are supported"

_POSITION = 0b000_000_011
_VELOCITY, _UP_VELOCITY = 0b000_011_000, 0b000_100_000
_ACCELERATION, _UP_ACCELERATION = 0b011_000_000, 0b100_000_000
_FORCE = 1 << 9
_NORM_TOLERANCE = 1e-6
"""Relative tolerance of a setpoint's norm, for rounding to 32 bits."""
_VERTICAL_TOLERANCE = 1e-3
"""Largest vertical velocity [m/s] or acceleration [m/s²] treated as zero."""
_UNBOUNDED = 1e6
"""Substitute for a missing bound; messages of the bus carry no larger numbers."""


class Setpoint(NamedTuple):
    """Commanded velocity, acceleration, or both, in scenario coordinates."""

    velocity: Vector | None
    """Velocity [m/s]; None: not commanded."""
    acceleration: Vector | None
    """Acceleration [m/s²]; None: not commanded."""


REST = Setpoint((0.0, 0.0), None)
"""Setpoint of a UAV at rest."""


def bounds(limits: Limits) -> Vector:
    """Return maximum speed [m/s] and acceleration [m/s²]."""
    v, u = limits.max_speed, limits.max_acceleration
    return (_UNBOUNDED if v is None else v), (_UNBOUNDED if u is None else u)


def _check_vertical(ignored: bool, up: float, what: str) -> None:
    if not ignored and not abs(up) <= _VERTICAL_TOLERANCE:  # rejects NaN too
        raise Refused(VERTICAL, f"{what} of {up:g} down")


def _vector(north: float, east: float, bound: float, what: str) -> Vector:
    size = math.hypot(north, east)
    if not math.isfinite(size):
        raise Refused(NOT_FINITE, what)
    if size > bound * (1.0 + _NORM_TOLERANCE):
        raise Refused(
            BEYOND_BOUNDS, f"{what} of {above(size, bound, 3)} (allowed: up to {exact(bound)})"
        )
    return east, north


def read_setpoint(message: MavMessage, limits: Limits) -> Setpoint:
    """Return the setpoint in a SET_POSITION_TARGET_LOCAL_NED, according to its type mask.

    Yaw is ignored, since vehicles have no heading.

    Args:
        message: MAVLink message.
        limits: Bounds of the UAV.

    Raises:
        Refused: If the setpoint is invalid or exceeds the bounds, with the cause.
    """
    if message.get_type() != "SET_POSITION_TARGET_LOCAL_NED":
        raise Refused(NOT_SUPPORTED, message.get_type())
    if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
        raise Refused(WRONG_FRAME, f"a setpoint in frame {message.coordinate_frame}")
    mask, (v_max, u_max) = message.type_mask, bounds(limits)
    if mask & _POSITION != _POSITION:
        raise Refused(POSITION, "a setpoint")
    velocity = acceleration = None
    if mask & _VELOCITY == 0:
        _check_vertical(bool(mask & _UP_VELOCITY), message.vz, "a velocity")
        velocity = _vector(message.vx, message.vy, v_max, "a velocity")
    if mask & _ACCELERATION == 0:
        _check_vertical(bool(mask & _UP_ACCELERATION), message.afz, "an acceleration")
        acceleration = _vector(message.afx, message.afy, u_max, "an acceleration")
    halves = {mask & _VELOCITY, mask & _ACCELERATION} - {0, _VELOCITY, _ACCELERATION}
    force = mask & _FORCE and acceleration is not None
    if halves or force or (velocity is None and acceleration is None):
        raise Refused(NOT_SUPPORTED, f"a type mask of {mask:#06x}")
    return Setpoint(velocity, acceleration)


def setpoint_control(
    setpoint: Setpoint, observation: UavObservation, briefing: UavBriefing
) -> Vector:
    r"""Return the acceleration [m/s²] that tracks a setpoint, within the UAV's bound.

    $$ u = clip_{u_{max}}(a + k (v^* - v)), \quad k = \frac{1}{dt + e \, d} $$

    Without a command delay d, the UAV reaches the velocity as soon as the bound permits. With a delay, it does not
    overshoot.

    Args:
        setpoint: Commanded velocity and acceleration.
        observation: Position and velocity of the UAV.
        briefing: Bounds, tick duration and command delay of the UAV.
    """
    u_x, u_y = (0.0, 0.0) if setpoint.acceleration is None else setpoint.acceleration
    if setpoint.velocity is not None:
        gain = 1.0 / (briefing.dt + math.e * briefing.safety.max_command_delay)
        (w_x, w_y), (v_x, v_y) = setpoint.velocity, observation.velocity
        u_x, u_y = u_x + gain * (w_x - v_x), u_y + gain * (w_y - v_y)
    _, u_max = bounds(briefing.limits)
    clipped: Vector = clip_norm(u_x, u_y, u_max)
    return clipped
