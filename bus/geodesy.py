"""Conversion between scenario coordinates and latitude and longitude, with a flat Earth tangent at the origin."""

import math

import numpy as np
import numpy.typing as npt

from bus.messages.scenario import Origin

_EQUATOR = 6378137.0
"""Semi-major axis of WGS 84 [m]."""
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_2 = _FLATTENING * (2.0 - _FLATTENING)

FloatArray = npt.NDArray[np.float64]


def _metres_per_radian(origin: Origin) -> tuple[float, float]:
    """Return the lengths of a radian of longitude and of latitude at the origin [m]."""
    phi = math.radians(origin.latitude)
    w_2 = 1.0 - _ECCENTRICITY_2 * math.sin(phi) ** 2
    across = _EQUATOR / math.sqrt(w_2)
    along = across * (1.0 - _ECCENTRICITY_2) / w_2
    return (across + origin.altitude) * math.cos(phi), along + origin.altitude


def geodetic(
    origin: Origin, east: float, north: float, up: float = 0.0
) -> tuple[float, float, float]:
    r"""Return the geodetic position of a point in the area.

    $$ \phi = \phi_0 + \frac{y}{M + h_0}, \quad \lambda = \lambda_0 + \frac{x}{(N + h_0) \cos \phi_0} $$

    M and N are the ellipsoid's radii of curvature at the origin, along the meridian and across it. The error of the
    flat Earth grows with the square of the distance: less than 1 mm at 40 m, a few decimeters at 1 km.

    Args:
        origin: Geodetic position of the area's lower left corner.
        east, north: Scenario coordinates x and y [m].
        up: Height above the ground [m].

    Returns:
        Latitude [deg], longitude in [-180, 180) [deg], and altitude [m].
    """
    per_longitude, per_latitude = _metres_per_radian(origin)
    latitude = origin.latitude + math.degrees(north / per_latitude)
    turned = math.degrees(east / per_longitude)
    longitude = (origin.longitude + turned + 180.0) % 360.0 - 180.0
    return latitude, longitude, origin.altitude + up


def local(origin: Origin, latitude: FloatArray, longitude: FloatArray) -> FloatArray:
    """Return the scenario coordinates of geodetic positions, the inverse of `geodetic`.

    Args:
        origin: Geodetic position of the area's lower left corner.
        latitude, longitude: Positions [deg]; a longitude is taken on the origin's side of the antimeridian. Shape
            (points,).

    Returns:
        Coordinates x (east) and y (north) [m]. Shape (points, 2).
    """
    per_longitude, per_latitude = _metres_per_radian(origin)
    turned = (longitude - origin.longitude + 180.0) % 360.0 - 180.0
    return np.column_stack(
        [
            np.radians(turned) * per_longitude,
            np.radians(latitude - origin.latitude) * per_latitude,
        ]
    )
