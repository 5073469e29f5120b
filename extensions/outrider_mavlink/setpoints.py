"""Setpoints of MAVLink's: read, refused where they are wrong, and turned into an acceleration."""

import math
from typing import NamedTuple

from bus.messages.base import Vector
from bus.messages.scenario import Limits
from bus.messages.vehicle import UavBriefing, UavObservation
from outrider.running.refused import Refused
from outrider_mavlink.dialect import MavMessage, mavlink
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE, NOT_SUPPORTED
from sim.models.vehicles import clip_norm

WRONG_FRAME = "has another frame than LOCAL_NED"
VERTICAL = "goes up or down, and the run is flat"
POSITION = "has a position, and only velocity and acceleration are flown"

_POSITION = 0b000_000_011
_VELOCITY, _UP_VELOCITY = 0b000_011_000, 0b000_100_000
_ACCELERATION, _UP_ACCELERATION = 0b011_000_000, 0b100_000_000
_FORCE = 1 << 9
_ROUNDING = 1e-6
"""So much longer, as a share, a setpoint may be by the rounding of its 32 bits."""
_LEVEL = 1e-3
"""A velocity [m/s] or acceleration [m/s²] up or down that is none."""
_UNBOUNDED = 1e6
"""In place of a bound that there is not, as the messages of the bus carry no larger numbers."""


class Setpoint(NamedTuple):
    """A velocity that is wanted, an acceleration, or both, in the scenario's coordinates."""

    velocity: Vector | None
    """[m/s]"""
    acceleration: Vector | None
    """[m/s²]"""


REST = Setpoint((0.0, 0.0), None)
"""Of a UAV that is to stay where it is."""


def bounds(limits: Limits) -> Vector:
    """Largest speed [m/s] and acceleration [m/s²]."""
    v, u = limits.max_speed, limits.max_acceleration
    return (_UNBOUNDED if v is None else v), (_UNBOUNDED if u is None else u)


def _level(ignored: bool, up: float, what: str) -> None:
    if not ignored and not abs(up) <= _LEVEL:  # NaN is none either
        raise Refused(VERTICAL, f"{what} of {up:g} down")


def _vector(north: float, east: float, bound: float, what: str) -> Vector:
    size = math.hypot(north, east)
    if not math.isfinite(size):
        raise Refused(NOT_FINITE, what)
    if size > bound * (1.0 + _ROUNDING):
        raise Refused(BEYOND_BOUNDS, f"{what} of {size:.3g} with at most {bound:g}")
    return east, north


def read_setpoint(message: MavMessage, limits: Limits) -> Setpoint:
    """The setpoint of a SET_POSITION_TARGET_LOCAL_NED, by its type mask. Yaw is ignored: there is none.

    Args:
        message: MAVLink's.
        limits: Bounds of the UAV, which are not to be exceeded.

    Raises:
        Refused: If it is none that can be flown, with the cause.
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
        _level(bool(mask & _UP_VELOCITY), message.vz, "a velocity")
        velocity = _vector(message.vx, message.vy, v_max, "a velocity")
    if mask & _ACCELERATION == 0:
        _level(bool(mask & _UP_ACCELERATION), message.afz, "an acceleration")
        acceleration = _vector(message.afx, message.afy, u_max, "an acceleration")
    halves = {mask & _VELOCITY, mask & _ACCELERATION} - {0, _VELOCITY, _ACCELERATION}
    force = mask & _FORCE and acceleration is not None
    if halves or force or (velocity is None and acceleration is None):
        raise Refused(NOT_SUPPORTED, f"a type mask of {mask:#06x}")
    return Setpoint(velocity, acceleration)


def setpoint_control(
    setpoint: Setpoint, observation: UavObservation, briefing: UavBriefing
) -> Vector:
    r"""The acceleration [m/s²] that flies a setpoint, within the UAV's bound.

    $$ u = clip_{u_{max}}(a + k (v^* - v)), \quad k = \frac{1}{dt + e \, d} $$

    Without a delay d of commands the velocity is reached as soon as the bound lets it, with one without overshoot.

    Args:
        setpoint: What is wanted.
        observation: Where the UAV is, and how fast.
        briefing: Its bounds, the length of a tick and the delay of its commands.
    """
    u_x, u_y = (0.0, 0.0) if setpoint.acceleration is None else setpoint.acceleration
    if setpoint.velocity is not None:
        gain = 1.0 / (briefing.dt + math.e * briefing.safety.max_command_delay)
        (w_x, w_y), (v_x, v_y) = setpoint.velocity, observation.velocity
        u_x, u_y = u_x + gain * (w_x - v_x), u_y + gain * (w_y - v_y)
    _, u_max = bounds(briefing.limits)
    clipped: Vector = clip_norm(u_x, u_y, u_max)
    return clipped
