"""Ground tiles, and the maps of them in radio messages and telemetry."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Place, Positive, Tick, Vector
from bus.registry import HAZARDS

TILE_LETTERS = "?.~#*"
"""Letters for the states of a tile in messages: unknown, clear, rough, blocked, and clear with a find."""


BLOCK_SIDE = 8
"""Tiles per side of a `MapUpdate`."""


MOST_BLOCKS = 4
"""Maximum number of map updates in one command."""


MOST_CORNERS = 128
"""Maximum number of route corners in one command; a longer route is truncated."""


class TileReport(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Report of one tile by a vehicle's own sensor; in JSON an array of these fields, in this order."""

    column: Place
    """Column: the tile starts at x = column * tile [m]."""
    row: Place
    """Row: the tile starts at y = row * tile [m]."""
    state: Annotated[str, Meta(pattern=r"^[.~#*]$(?!\n)")]
    """State, one of `TILE_LETTERS`."""


class MapUpdate(Message, frozen=True, kw_only=True):
    """Block of a UAV's ground map, sent to its UGV by radio."""

    column: Place
    """Column of the block: column of its first tile divided by `BLOCK_SIDE`."""
    row: Place
    """Row of the block: row of its first tile divided by `BLOCK_SIDE`."""
    tiles: Annotated[str, Meta(pattern=r"^[?.~#*]{64}$(?!\n)")]
    """State of each tile, of `TILE_LETTERS`, row by row by increasing y; unknown outside the area."""


class UavGround(Message, frozen=True, kw_only=True):
    """Hazard sensor of a UAV."""

    tile: Positive
    """Side of a tile [m]."""
    map_update_rate: NonNegative
    """Blocks sent to the UGV per second [1/s]."""


class UgvGround(Message, frozen=True, kw_only=True):
    """Ground sensor and caution of a UGV."""

    tile: Positive
    """Side of a tile [m]."""
    sensing_range: NonNegative
    """Range of its own sensor [m]; a tile is sensed if any of its points lies within it."""
    caution: Name
    """Caution on unknown ground, one of `bus.registry.CAUTIONS`."""
    delay: NonNegative = 0.0
    """Time from the tick that a command answers to its effect [s]."""
    building_clearance: NonNegative = 0.0
    """Smallest distance from every building that it declares to keep [m]; 0: none."""
    tile_clearance: NonNegative = 0.0
    """The same from every tile that it does not know to be drivable, where an unknown building may be [m]."""
    only_buildings: bool = False
    """True if the map of buildings is complete: there are no other hazards."""
    rough_speed_share: Annotated[float, Meta(gt=0.0, le=1.0)]
    """Smallest share of its maximum speed that it keeps on rough ground."""
    executes_trajectories: bool = False
    """True if its receiver executes backup trajectories: a command takes effect in its own tick or never, and the
    vehicle brakes without one.
    """


SpeedShare = Annotated[float, Meta(gt=0.0, le=1.0)]
DEFAULT_SHARE = 0.4
"""Default share of its maximum speed that a vehicle keeps on rough ground."""
MOST_POLYGON_CORNERS = 1000
SAME_CORNER = 1e-3 + 1e-9
"""Distance up to which two corners of a polygon count as one [m]: a millimetre plus rounding."""


def kept_share(kind: str, share: float | None) -> float:
    """Return the share of its maximum speed that a vehicle keeps on a hazard.

    `share` is the given value for rough ground, or None.
    """
    if not HAZARDS[kind].slows:
        return 1.0
    return DEFAULT_SHARE if share is None else share


def distinct_corners(polygon: tuple[Vector, ...]) -> tuple[Vector, ...]:
    """Return the corners of a polygon without those within `SAME_CORNER` of the one before, the last and first too."""
    corners: list[Vector] = []
    for corner in polygon:
        if not corners or math.dist(corner, corners[-1]) > SAME_CORNER:
            corners.append(corner)
    while len(corners) > 1 and math.dist(corners[0], corners[-1]) <= SAME_CORNER:
        corners.pop()
    return tuple(corners)


def bounding_box(points: tuple[Vector, ...]) -> tuple[Vector, Vector]:
    """Return the lower and upper corner of the bounding box of points [m]."""
    x, y = zip(*points, strict=True)
    return (min(x), min(y)), (max(x), max(y))


class Hazard(Message, frozen=True, kw_only=True):
    """Disc or polygon of hazardous ground; no vehicle receives it."""

    kind: Name
    """Kind, a row of `bus.registry.HAZARDS`: `block` (do not touch), `rough` (drive slowly) or `find` (an object to
    find).
    """
    center: Vector | None = None
    """Centre of a disc [m]."""
    radius: Positive | None = None
    """Radius of a disc [m]."""
    polygon: Annotated[tuple[Vector, ...], Meta(max_length=MOST_POLYGON_CORNERS)] = ()
    """Corners of a simple polygon in either order [m], instead of a disc."""
    speed_share: SpeedShare | None = None
    """Share of its maximum speed that a vehicle keeps on a rough hazard; default: 0.4."""

    @property
    def corners(self) -> tuple[Vector, ...]:
        """Return the corners of the polygon, see `distinct_corners` [m]."""
        return distinct_corners(self.polygon)

    @property
    def kept_share(self) -> float:
        """Return the share of its maximum speed that a vehicle keeps on the hazard."""
        return kept_share(self.kind, self.speed_share)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Return the lower and upper corner of the polygon's bounding box, or the center of the disc twice [m]."""
        return bounding_box(self.polygon or (self.center or (0.0, 0.0),))

    @property
    def middle(self) -> Vector:
        """Return the center of the disc, or of the polygon's bounding box [m]."""
        low, high = self.bounds
        return 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])


class GroundMap(Message, frozen=True, kw_only=True):
    """Ground for observers: the true hazards and the UGVs' knowledge of them."""

    tick: Tick
    """Number of the tick."""
    columns: Annotated[int, Meta(ge=1)]
    """Tiles along x."""
    rows: Annotated[int, Meta(ge=1)]
    """Tiles along y."""
    tile: Positive
    """Side of a tile [m]."""
    tiles: bytes
    """State of each tile as all UGVs together know it, row by row from y = 0 (base64 in JSON): an index of
    `TILE_LETTERS`; 5: detected by a UAV but not yet reported.
    """
    states: bytes
    """State of each hazard: 0 unknown to every UGV, or not found; 1 known; 2 hit."""
    routes: dict[Name, tuple[Vector, ...]] = {}
    """Planned path of each UGV, by its corners [m]; no vehicle receives it."""
    hazards: tuple[Hazard, ...] = ()
    """True hazards; in a recording only in the first map of a flight, as they do not move."""
    first_building: Annotated[int, Meta(ge=0)] = 0
    """Row of the first building among the hazards; the others follow, in the order of `Geometry.buildings`."""
    end_building: Annotated[int, Meta(ge=0)] = 0
    """Row after the last building."""

    @property
    def building_rows(self) -> range:
        """Return the rows of the buildings among the hazards."""
        return range(self.first_building, self.end_building)
