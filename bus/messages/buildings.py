"""Buildings, the camera of a UAV, and its vertical bounds."""

import math
from typing import Annotated

from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Positive, Vector
from bus.messages.ground import bounding_box, distinct_corners
from bus.registry import ALTITUDE_LAWS

MOST_BUILDINGS = 1000
"""Maximum number of buildings in a run."""
MOST_BUILDING_CORNERS = 100
"""Maximum number of corners of a building."""

Altitude = Annotated[float, Meta(ge=0.0, le=1e5)]
Height = Annotated[float, Meta(gt=0.0, le=1e5)]


class Building(Message, frozen=True, kw_only=True):
    """Building with a flat roof: it blocks UGVs, hides what is behind it, and limits the flight over it."""

    polygon: Annotated[tuple[Vector, ...], Meta(max_length=MOST_BUILDING_CORNERS)]
    """Corners of its footprint [m], a simple polygon in either order."""
    height: Height
    """Height of its roof above the ground [m]."""

    @property
    def corners(self) -> tuple[Vector, ...]:
        """Return the corners of the footprint, see `distinct_corners` [m]."""
        return distinct_corners(self.polygon)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Return the lower and upper corner of the footprint's bounding box [m]."""
        return bounding_box(self.polygon or ((0.0, 0.0),))


class Camera(Message, frozen=True, kw_only=True):
    """Camera of a UAV with an altitude; it looks straight down."""

    half_angle: Annotated[float, Meta(gt=0.0, lt=0.5 * math.pi)] = 0.785
    """Half of its opening angle, θ [rad]: at the altitude z it sees the ground within z tan θ."""
    reference_altitude: Height = 10.0
    """Altitude z_0 to which the parameters of the sensor refer [m]."""


class AltitudeLimits(Message, frozen=True, kw_only=True):
    """Initial altitude, vertical bounds and altitude law of a UAV."""

    initial_altitude: Altitude
    """Initial altitude above the ground [m]."""
    min_altitude: Altitude = 1.0
    """Lowest altitude [m]."""
    max_altitude: Altitude = 120.0
    """Highest altitude [m]."""
    max_climb_rate: Positive = 1.0
    """Largest rate of climb and of descent [m/s]."""
    max_vertical_acceleration: Positive = 1.0
    """Largest vertical acceleration [m/s²]."""
    vertical_clearance: NonNegative = 1.0
    """Smallest height above the roof of a building while over it [m]."""
    law: Name = ALTITUDE_LAWS[0]
    """Altitude law, one of `bus.registry.ALTITUDE_LAWS`."""
