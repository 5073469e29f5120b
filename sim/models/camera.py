r"""Downward camera as the sensor of a UAV: range, quality, visibility radius and noise at a height z.

The camera sees a cone of half-angle $\theta$ around the vertical. Its parameters are given at a reference height z_0.
"""

import math
from typing import NamedTuple

from sim.compiling.compile import compiled
from sim.models.sensor import SensorParameters


class CameraParameters(NamedTuple):
    """Parameters of a camera; compiled code also accepts a record with these fields."""

    tangent: float
    """Tangent of the half-angle θ of the field of view, for which 0 < θ < 90°."""
    reference_height: float
    """z_0, the height at which M_a and σ_0 are given [m]."""
    marker_height: float
    """h_m, the height of the UGV's marker above the ground [m]."""


@compiled
def range_at(sensing_range: float, tangent: float, z: float) -> float:
    r"""Return the range on the ground, $r(z) = \min(r, z \tan\theta)$ [m].

    Args:
        sensing_range: Range r at a great height [m].
        tangent: $\tan\theta$.
        z: Height of the camera above the ground [m].
    """
    return min(sensing_range, z * tangent)


@compiled
def peak_at(peak: float, reference_height: float, z: float) -> float:
    r"""Return the quality directly below the camera, $M_a(z) = M_a (z_0 / z)^2$ [1/s].

    A cell of the ground covers a share of the picture that falls with the square of the height.

    Args:
        peak: Quality M_a at the height z_0 [1/s].
        reference_height: Height z_0 [m].
        z: Height of the camera above the ground [m], above 0.
    """
    ratio = reference_height / z
    return peak * (ratio * ratio)


@compiled
def visibility_radius_at(r_v: float, tangent: float, marker_height: float, z: float) -> float:
    r"""Return the visibility radius [m].

    $$ r_v(z) = \max(0, \min(r_v, (z - h_m) \tan\theta)) $$

    Args:
        r_v: Visibility radius at a great height [m].
        tangent: $\tan\theta$.
        marker_height: Height h_m of the UGV's marker [m].
        z: Height of the camera above the ground [m].
    """
    return max(0.0, min(r_v, (z - marker_height) * tangent))


@compiled
def noise_at(sigma: float, reference_height: float, distance: float, z: float) -> float:
    r"""Return the standard deviation of a detection per axis [m].

    $$ \sigma(d, z) = \sigma_0 \sqrt{d^2 + z^2} / z_0 $$

    Args:
        sigma: Standard deviation σ_0 directly below the camera at the height z_0 [m].
        reference_height: Height z_0 [m].
        distance: Horizontal distance d of the UGV [m].
        z: Height of the camera above the ground [m].
    """
    return sigma * (math.sqrt(distance * distance + z * z) / reference_height)


@compiled
def sensor_at(sensor: SensorParameters, camera: CameraParameters, z: float) -> SensorParameters:
    """Return the parameters of the UAV's sensor (2) at a height.

    Args:
        sensor: The sensor: range r at a great height, quality M_a at the height z_0.
        camera: The camera.
        z: Height of the camera above the ground [m], above 0.
    """
    return SensorParameters(
        sensor.model,
        peak_at(sensor.peak, camera.reference_height, z),
        range_at(sensor.sensing_range, camera.tangent, z),
    )
