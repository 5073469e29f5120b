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
    """Tile observed by a vehicle's own sensor. In JSON: an array of these fields, in this order."""

    column: Place
    row: Place
    """Tile index: the tile's lower left corner is (column * tile, row * tile) [m]."""
    state: Annotated[str, Meta(pattern=r"^[.~#*]$(?!\n)")]
    """State of the tile, one of `TILE_LETTERS`."""


class MapUpdate(Message, frozen=True, kw_only=True):
    """Radio message from a UAV to its UGV: the states of a block of ground tiles, as its sensor reported them."""

    column: Place
    row: Place
    """Block index: column and row of the block's first tile, divided by `BLOCK_SIDE`."""
    tiles: Annotated[str, Meta(pattern=r"^[?.~#*]{64}$(?!\n)")]
    """State of each tile, a letter of `TILE_LETTERS`, row by row from the smallest y; tiles outside the area are
    unknown.
    """


class UavGround(Message, frozen=True, kw_only=True):
    """The UAV's hazard sensor, as given in its briefing."""

    tile: Positive
    """Width of a tile [m]."""
    map_update_rate: NonNegative
    """Map updates that the UAV radios to its UGV per second [1/s]."""


class UgvGround(Message, frozen=True, kw_only=True):
    """The UGV's ground sensor and its caution, as given in its briefing."""

    tile: Positive
    """Width of a tile [m]."""
    sensing_range: NonNegative
    """Range of the UGV's own sensor [m]: it observes every tile with a point within this distance."""
    caution: Name
    """Caution on unknown ground: one of `bus.registry.CAUTIONS`."""
    delay: NonNegative = 0.0
    """Time from the tick that a command answers to the tick in which it takes effect [s]."""
    rough_speed_share: Annotated[float, Meta(gt=0.0, le=1.0)]
    """Smallest share of its maximum speed that the UGV keeps on rough ground."""
    executes_trajectories: bool = False
    """True if the receiver executes the backup trajectories of commands. A command then takes effect in its own tick or
    not at all, and the vehicle brakes if none does.
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


class Hazard(Message, frozen=True, kw_only=True):
    """Disc or polygon of hazardous ground. The simulator sends it to no vehicle: vehicles must detect it."""

    kind: Name
    """Row of `bus.registry.HAZARDS`: `block` (do not touch), `rough` (drive slowly) or `find` (an object to find)."""
    center: Vector | None = None
    """Center of a disc [m]."""
    radius: Positive | None = None
    """Radius of a disc [m]."""
    polygon: Annotated[tuple[Vector, ...], Meta(max_length=MOST_POLYGON_CORNERS)] = ()
    """Corners of a polygon in order, clockwise or counterclockwise [m]; an alternative to a disc. Its sides meet only
    at corners.
    """
    speed_share: SpeedShare | None = None
    """Share of its maximum speed that a vehicle keeps on rough ground; 0.4 by default."""

    def __post_init__(self) -> None:
        """Merge consecutive corners closer than `SAME_CORNER`, including the last and the first."""
        corners: list[Vector] = []
        for corner in self.polygon:
            if not corners or math.dist(corner, corners[-1]) > SAME_CORNER:
                corners.append(corner)
        while len(corners) > 1 and math.dist(corners[0], corners[-1]) <= SAME_CORNER:
            corners.pop()
        msgspec.structs.force_setattr(self, "polygon", tuple(corners))

    @property
    def kept_share(self) -> float:
        """Return the share of its maximum speed that a vehicle keeps on the hazard."""
        return kept_share(self.kind, self.speed_share)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Return the lower and upper corner of the polygon's bounding box, or the center of the disc twice [m]."""
        x, y = zip(*(self.polygon or (self.center or (0.0, 0.0),)), strict=True)
        return (min(x), min(y)), (max(x), max(y))

    @property
    def middle(self) -> Vector:
        """Return the center of the disc, or of the polygon's bounding box [m]."""
        low, high = self.bounds
        return 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])


class GroundMap(Message, frozen=True, kw_only=True):
    """Ground for observers: the true hazards, and the UGVs' knowledge of them."""

    tick: Tick
    columns: Annotated[int, Meta(ge=1)]
    rows: Annotated[int, Meta(ge=1)]
    tile: Positive
    """Width of a tile [m]."""
    tiles: bytes
    """Combined knowledge of all UGVs, one byte per tile, row by row from y = 0 (base64 in JSON).

    Each byte is an index into `TILE_LETTERS`; 5: observed by a UAV, but not yet sent.
    """
    states: bytes
    """State of each hazard: 0, unknown to all UGVs, or not yet found; 1, known or found; 2, hit by a UGV."""
    routes: dict[Name, tuple[Vector, ...]] = {}
    """Planned route of each UGV to its goal: its corners, from the UGV's position on [m]. Sent to no vehicle."""
    hazards: tuple[Hazard, ...] = ()
    """True hazards. A recording holds them only in the first map of a run, because they do not move."""
