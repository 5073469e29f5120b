"""Tiles of the ground, and the map of it that radio messages and telemetry carry."""

from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Place, Positive, Tick, Vector

TILE_LETTERS = "?.~#*"
"""Names of the states of a tile in messages: not seen, clear, rough, blocked, and clear with a find on it."""


BLOCK_SIDE = 8
"""Tiles along each side of a `GroundBlock`."""


MOST_BLOCKS = 4
"""Blocks that one command carries at most."""


MOST_CORNERS = 128
"""Corners of a route that one command carries at most: what turns more often is shown up to there."""


class SeenTile(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A tile of the ground as a vehicle's own sensor sees it; in JSON an array of these fields, in this order."""

    column: Place
    row: Place
    """The tile from x = column * tile and y = row * tile [m] on."""
    state: Annotated[str, Meta(pattern=r"^[.~#*]$(?!\n)")]
    """One of `TILE_LETTERS`."""


class GroundBlock(Message, frozen=True, kw_only=True):
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
    telling: NonNegative
    """Blocks that it radios to its UGV in a second [1/s]."""


class UgvGround(Message, frozen=True, kw_only=True):
    """A UGV's sensor of the ground and its caution, as its briefing tells."""

    tile: Positive
    """Width of a tile [m]."""
    bumper: NonNegative
    """Range of its own sensor [m]: it sees each tile that has a point so near."""
    caution: Name
    """Its caution on ground that it does not know: one of `bus.registry.CAUTIONS`."""
    delay: NonNegative = 0.0
    """From the tick that a command answers to the one in which it acts [s]."""
    share: Annotated[float, Meta(gt=0.0, le=1.0)]
    """Of its largest speed that it has at least on rough ground."""
    carries: bool = False
    """True if its receiver flies the motions that commands carry: a command acts in its own tick or not at all, and the
    vehicle brakes where none does."""


class HazardOutline(Message, frozen=True, kw_only=True):
    """A hazard as it truly lies on the ground, a disc or a polygon."""

    kind: Name
    """A row of `bus.registry.HAZARDS`."""
    center: Vector = (0.0, 0.0)
    radius: NonNegative = 0.0
    """Of the disc [m]; 0: it is a polygon."""
    corners: tuple[Vector, ...] = ()
    """Of the polygon, in order round it [m]."""


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
    hazards: tuple[HazardOutline, ...] = ()
    """In a recording only in a flight's first map: they stay where they are."""
