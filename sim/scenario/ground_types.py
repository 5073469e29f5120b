"""Tables of a scenario for the ground and what stands on it, and for the altitude above it."""

from typing import Annotated

from msgspec import Meta

from bus.messages.base import Name, NonNegative, Positive, Share
from bus.messages.buildings import Height
from bus.messages.ground import SpeedShare, kept_share
from bus.registry import ALTITUDE_LAWS, TOUCHES
from sim.scenario.base import Table

MOST_HAZARDS = 10_000
Side = Annotated[float, Meta(ge=0.1, le=1e6)]
"""Side of a building [m]."""


class Ground(Table, frozen=True, kw_only=True):
    """Tiles and sensors of the ground; without effect if there are no hazards."""

    tile: Positive = 0.5
    """Side of a tile [m]."""
    rate: Positive = 4.0
    """Ground scans of each UAV per second [1/s]; the period must be a whole number of ticks."""
    miss: Share = 0.0
    """Probability that a tile with a hazard is detected as clear."""
    false_alarm: Share = 0.0
    """Probability that a clear tile is detected as blocked."""
    sensing_range: NonNegative = 0.75
    """Range of a UGV's own sensor, which is exact [m]."""
    touch: Name = TOUCHES[0]
    """Effect of a blocking hazard on a UGV that touches it: `stuck`, or `damage` without a stop. A building always
    stops it.
    """
    map_update_rate: NonNegative = 4.0
    """Blocks of 8 x 8 tiles that a UAV sends to its UGV per second [1/s]."""


class HazardField(Table, frozen=True, kw_only=True):
    """Discs at random positions, new with each seed; they never block the last path from a UGV's start to its goals."""

    kind: Name
    """Kind of the hazards, a row of `bus.registry.HAZARDS`."""
    count: Annotated[int, Meta(ge=1, le=MOST_HAZARDS)]
    """Number of hazards."""
    radius: tuple[Positive, Positive]
    """Smallest and largest radius [m]."""
    speed_share: SpeedShare | None = None
    """Share of its maximum speed that a vehicle keeps on a rough hazard; default: 0.4."""
    clearance: NonNegative = 1.0
    """Smallest distance from the starts and goals of all UGVs [m]."""

    @property
    def kept_share(self) -> float:
        """Return the share of its maximum speed that a vehicle keeps on these hazards."""
        return kept_share(self.kind, self.speed_share)


class Buildings(Table, frozen=True, kw_only=True):
    """Map of the buildings."""

    known: bool = True
    """Brief the vehicles on the buildings; UAVs on those at given positions only, as blocks of a field stay clear of
    the UGVs' goals, which no UAV may know. UAVs with an altitude discover the rest.
    """


class BuildingField(Table, frozen=True, kw_only=True):
    """Rows of rectangular buildings between streets, new with each seed; every UGV's route to its goals stays open."""

    block: tuple[Side, Side]
    """Smallest and largest side of a building [m]."""
    street: Positive
    """Width of the streets [m]; the distance to `[[building]]` and blocking hazards is not smaller."""
    height: tuple[Height, Height]
    """Smallest and largest height [m]."""
    share: Share = 0.8
    """Share of the blocks that are built; the others stay free."""
    clearance: NonNegative = 1.0
    """Smallest distance from all UAVs' starts, and from all UGVs' starts and goals [m]. A block that is closer stays
    free. At least 1.5 tiles more than the largest `building_clearance`; 3 tiles if the buildings are unknown.
    """


class AltitudeLaw(Table, frozen=True, kw_only=True):
    """Altitude of the UAVs that have one."""

    law: Name = ALTITUDE_LAWS[0]
    """Altitude law: `fixed` (the initial altitude), `certified` or `best`."""
