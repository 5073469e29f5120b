"""Tiles of the ground, and the map of it that radio messages and telemetry carry."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Place, Positive, Tick, Vector
from bus.registry import HAZARDS

TILE_LETTERS = "?.~#*"
"""Names of the states of a tile in messages: not seen, clear, rough, blocked, and clear with a find on it."""


BLOCK_SIDE = 8
"""Tiles along each side of a `MapUpdate`."""


MOST_BLOCKS = 4
"""Blocks that one command carries at most."""


MOST_CORNERS = 128
"""Corners of a route that one command carries at most: what turns more often is shown up to there."""


class TileReport(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A tile of the ground as a vehicle's own sensor sees it; in JSON an array of these fields, in this order."""

    column: Place
    row: Place
    """The tile from x = column * tile and y = row * tile [m] on."""
    state: Annotated[str, Meta(pattern=r"^[.~#*]$(?!\n)")]
    """One of `TILE_LETTERS`."""


class MapUpdate(Message, frozen=True, kw_only=True):
    """A UAV's radio message of the ground to its UGV: the states of a block of tiles, as its sensor has told them."""

    column: Place
    row: Place
    """Of the block: that of its first tile divided by `BLOCK_SIDE`."""
    tiles: Annotated[str, Meta(pattern=r"^[?.~#*]{64}$(?!\n)")]
    """The state of each tile, of `TILE_LETTERS`, row by row from the least y on; beyond the area they are not seen."""


class UavGround(Message, frozen=True, kw_only=True):
    """A UAV's sensor of hazards, as its briefing tells."""

    tile: Positive
    """Width of a tile [m]."""
    map_update_rate: NonNegative
    """Blocks that it radios to its UGV in a second [1/s]."""


class UgvGround(Message, frozen=True, kw_only=True):
    """A UGV's sensor of the ground and its caution, as its briefing tells."""

    tile: Positive
    """Width of a tile [m]."""
    sensing_range: NonNegative
    """Range of its own sensor [m]: it sees each tile that has a point so near."""
    caution: Name
    """Its caution on ground that it does not know: one of `bus.registry.CAUTIONS`."""
    delay: NonNegative = 0.0
    """From the tick that a command answers to the one in which it acts [s]."""
    rough_speed_share: Annotated[float, Meta(gt=0.0, le=1.0)]
    """Of its largest speed that it has at least on rough ground."""
    executes_trajectories: bool = False
    """True if its receiver flies the motions that commands carry: a command acts in its own tick or not at all, and the
    vehicle brakes where none does."""


SpeedShare = Annotated[float, Meta(gt=0.0, le=1.0)]
DEFAULT_SHARE = 0.4
"""Share of its maximum speed that a vehicle keeps on rough ground where none is given."""
MOST_POLYGON_CORNERS = 1000
SAME_CORNER = 1e-3 + 1e-9
"""Corners of a polygon that are no farther apart than a millimetre, but for rounding, are one [m]."""


def kept_share(kind: str, share: float | None) -> float:
    """Return the share of its maximum speed that a vehicle keeps on a hazard; `share`: as given for a rough one."""
    if not HAZARDS[kind].slows:
        return 1.0
    return DEFAULT_SHARE if share is None else share


class Hazard(Message, frozen=True, kw_only=True):
    """A disc or a polygon of ground that a vehicle should know of; no vehicle is told of it."""

    kind: Name
    """A row of `bus.registry.HAZARDS`: `block`, not to be touched; `rough`, to be driven slowly; `find`, to find."""
    center: Vector | None = None
    """Of a disc [m]."""
    radius: Positive | None = None
    """Of a disc [m]."""
    polygon: Annotated[tuple[Vector, ...], Meta(max_length=MOST_POLYGON_CORNERS)] = ()
    """Instead of a disc: its corners in order round it, either way [m]. Its sides do not meet but at corners."""
    speed_share: SpeedShare | None = None
    """If it is rough: of its largest speed that a vehicle keeps on it; by default 0.4."""

    @property
    def corners(self) -> tuple[Vector, ...]:
        """Corners of the polygon without those within `SAME_CORNER` of the one before, the last and first too [m]."""
        corners: list[Vector] = []
        for corner in self.polygon:
            if not corners or math.dist(corner, corners[-1]) > SAME_CORNER:
                corners.append(corner)
        while len(corners) > 1 and math.dist(corners[0], corners[-1]) <= SAME_CORNER:
            corners.pop()
        return tuple(corners)

    @property
    def kept_share(self) -> float:
        """Share of its maximum speed that a vehicle keeps on it."""
        return kept_share(self.kind, self.speed_share)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Lower and upper corner of the rectangle around the polygon, or twice the center of the disc [m]."""
        x, y = zip(*(self.polygon or (self.center or (0.0, 0.0),)), strict=True)
        return (min(x), min(y)), (max(x), max(y))

    @property
    def middle(self) -> Vector:
        """Center of the disc, or of the rectangle around the polygon [m]."""
        low, high = self.bounds
        return 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])


class GroundMap(Message, frozen=True, kw_only=True):
    """The ground for observers: its hazards as they truly are, and what the UGVs know of it."""

    tick: Tick
    columns: Annotated[int, Meta(ge=1)]
    rows: Annotated[int, Meta(ge=1)]
    tile: Positive
    """Width of a tile [m]."""
    tiles: bytes
    """Each tile as the UGVs know it, all together, row by row from y = 0 (base64 in JSON).

    Its place in `TILE_LETTERS`; 5 where a UAV has seen it and has not told it yet.
    """
    states: bytes
    """Of each hazard: 0, no UGV knows of it, or nobody has found it; 1, one does; 2, one has hit it."""
    routes: dict[Name, tuple[Vector, ...]] = {}
    """The way that each UGV plans to its goal, by its corners [m], from where it is; no vehicle is told."""
    hazards: tuple[Hazard, ...] = ()
    """In a recording only in a flight's first map: they stay where they are."""
