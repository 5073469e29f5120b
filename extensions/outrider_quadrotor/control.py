r"""Position and attitude control of a quadrotor, compiled. SI units.

$$ a = a_r + k_p e_p + k_d e_v + k_i \int e_p, \quad f = m \lVert a + g e_3\rVert, \quad
   \tau = -k_R e_R - k_\omega \omega $$

The body's third axis is turned into the direction of $a + g e_3$, limited to a maximum tilt; the yaw angle stays 0.
$e_R = \tfrac12 (R_d^T R - R^T R_d)^\vee$ is the attitude error of Lee, Leok and McClamroch, *Geometric Tracking Control
of a Quadrotor UAV on SE(3)* (CDC 2010).
"""

import math
from typing import NamedTuple

from sim.compiling.compile import FloatArray, compiled
from sim.models.body import Vector3


class Gains(NamedTuple):
    """Gains and limits of the controller, which knows the nominal drone."""

    mass: float
    """Nominal mass [kg]."""
    gravity: float
    """Gravity [m/s²]."""
    arm: float
    """Distance of a rotor from the axes of roll and pitch [m]."""
    yaw_torque: float
    """Torque about the vertical axis per thrust [m]."""
    lowest: float
    highest: float
    """Smallest and largest thrust of a rotor [N]."""
    position: float = 5.26
    velocity: float = 2.63
    integral: float = 0.44
    """Horizontal gains k_p [1/s²], k_d [1/s], k_i [1/s³] from errors to acceleration."""
    vertical_position: float = 15.4
    vertical_velocity: float = 3.51
    vertical_integral: float = 0.44
    """The same gains of the vertical motion."""
    most_integral: float = 1.5
    """Largest acceleration of the integral part, per axis [m/s²]."""
    attitude: float = 2.136
    """Gain k_R from attitude error to torque about roll and pitch [N m]."""
    rate: float = 0.305
    """Gain k_omega from angular rate to torque about roll and pitch [N m s]."""
    yaw: float = 1.831
    yaw_rate: float = 0.183
    """The same gains about the vertical axis [N m], [N m s]."""
    max_tilt: float = math.radians(45.0)
    """Largest commanded tilt [rad]."""


@compiled
def control(
    gains: Gains,
    reference: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    integral: FloatArray,
    dt: float,
    thrusts: FloatArray,
) -> None:
    """Write the thrust of each rotor.

    Args:
        gains: Gains and limits.
        reference: Position [m], velocity [m/s] and acceleration [m/s²]. Shape (3, 3).
        position: Measured position [m], then the attitude as a quaternion w, x, y, z. Shape (7,).
        velocity: Velocity [m/s], then the angular rate in the body's axes [rad/s]. Shape (6,).
        integral: Integral part of the acceleration [m/s²]; changed. Shape (3,).
        dt: Time since the last call [s].
        thrusts: Thrust of each rotor [N]: front right, back right, back left, front left; written. Shape (4,).
    """
    a_x, a_y, a_z = 0.0, 0.0, 0.0
    k_p, k_d, k_i = gains.position, gains.velocity, gains.integral
    for axis in range(3):
        if axis == 2:
            k_p, k_d, k_i = (
                gains.vertical_position,
                gains.vertical_velocity,
                gains.vertical_integral,
            )
        off = reference[0, axis] - position[axis]
        total = integral[axis] + k_i * off * dt
        integral[axis] = min(max(total, -gains.most_integral), gains.most_integral)
        u = reference[2, axis] + integral[axis] + k_p * off
        u += k_d * (reference[1, axis] - velocity[axis])
        if axis == 0:
            a_x = u
        elif axis == 1:
            a_y = u
        else:
            a_z = max(u + gains.gravity, 0.2 * gains.gravity)
    level = math.sqrt(a_x * a_x + a_y * a_y)
    most = a_z * math.tan(gains.max_tilt)
    if level > most:
        a_x, a_y = a_x * most / level, a_y * most / level
    size = math.sqrt(a_x * a_x + a_y * a_y + a_z * a_z)
    _allocate(gains, (a_x / size, a_y / size, a_z / size), size, position, velocity, thrusts)


@compiled
def _allocate(
    gains: Gains,
    up: Vector3,
    size: float,
    position: FloatArray,
    velocity: FloatArray,
    thrusts: FloatArray,
) -> None:
    """Write the thrusts that turn the body's third axis into `up` and accelerate it by `size` [m/s²] along itself."""
    w, x, y, z = position[3], position[4], position[5], position[6]
    # columns of the body's rotation matrix
    b1 = (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
    b2 = (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x))
    b3 = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
    # the desired axes: the second one is normal to `up` and to the first axis of the world
    n = math.sqrt(up[1] * up[1] + up[2] * up[2])
    d2 = (0.0, up[2] / n, -up[1] / n)
    d1 = (
        d2[1] * up[2] - d2[2] * up[1],
        d2[2] * up[0] - d2[0] * up[2],
        d2[0] * up[1] - d2[1] * up[0],
    )
    e_x = 0.5 * (_dot(up, b2) - _dot(d2, b3))
    e_y = 0.5 * (_dot(d1, b3) - _dot(up, b1))
    e_z = 0.5 * (_dot(d2, b1) - _dot(d1, b2))
    t_x = -gains.attitude * e_x - gains.rate * velocity[3]
    t_y = -gains.attitude * e_y - gains.rate * velocity[4]
    t_z = -gains.yaw * e_z - gains.yaw_rate * velocity[5]
    each = 0.25 * gains.mass * size * max(_dot(up, b3), 0.0)
    roll, pitch, yaw = 0.25 * t_x / gains.arm, 0.25 * t_y / gains.arm, 0.25 * t_z / gains.yaw_torque
    # yaw has the least authority: it may take what roll and pitch leave of a quarter of the thrust
    yaw = min(max(yaw, -0.25 * each), 0.25 * each)
    thrusts[0] = each - roll - pitch + yaw
    thrusts[1] = each - roll + pitch - yaw
    thrusts[2] = each + roll + pitch + yaw
    thrusts[3] = each + roll - pitch - yaw
    for rotor in range(4):
        thrusts[rotor] = min(max(thrusts[rotor], gains.lowest), gains.highest)


@compiled
def _dot(a: Vector3, b: Vector3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
