"""Conversion from scenario coordinates to latitude and longitude, with a flat Earth tangent at the origin."""

import math

from bus.messages.scenario import Origin

_EQUATOR = 6378137.0
"""Semi-major axis of WGS 84 [m]."""
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_2 = _FLATTENING * (2.0 - _FLATTENING)


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
    phi = math.radians(origin.latitude)
    w_2 = 1.0 - _ECCENTRICITY_2 * math.sin(phi) ** 2
    across = _EQUATOR / math.sqrt(w_2)
    along = across * (1.0 - _ECCENTRICITY_2) / w_2
    latitude = origin.latitude + math.degrees(north / (along + origin.altitude))
    turned = math.degrees(east / ((across + origin.altitude) * math.cos(phi)))
    longitude = (origin.longitude + turned + 180.0) % 360.0 - 180.0
    return latitude, longitude, origin.altitude + up
