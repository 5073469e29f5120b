"""Messages between the UAVs of a team: those that escort the same UGV.

A team is one observer with several bodies: a message contains what its sender has sensed, never a velocity, input or
goal of the UGV. No UGV and no other team receives it.
"""

from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Place, Positive, Tick, Vector

MOST_UAVS = 16
"""Maximum number of UAVs in a team."""
BLOCK_CELLS = 8
"""Side of a coverage block [cells]."""
MOST_COVERAGE_BLOCKS = 4
"""Maximum number of coverage blocks in a message."""


class Role(StrEnum):
    """Role of a UAV in its team."""

    SCOUT = "SCOUT"
    """It flies its law within `scout_range` of the UGV, without the safety filter; with an endurance, it waits at its
    base.
    """
    RELIEF = "RELIEF"
    """It flies to the UGV, to become a guard."""
    GUARD = "GUARD"
    """It keeps the UGV in sight: its commands pass the safety filter."""
    AWAY = "AWAY"
    """It flies to its base, or charges there."""


class Request(StrEnum):
    """Request of an operator to a UAV of a team; it has the effect of a team-mate's or of a low charge."""

    GUARD = "GUARD"
    """Come and guard: the UAV becomes RELIEF, as if a guard had asked it; away, once its charge lasts for a relief."""
    RELIEF = "RELIEF"
    """Be relieved: a guard asks a team-mate for relief until it is released, as with a low charge."""


class Team(Message, frozen=True, kw_only=True):
    """Cooperation of the UAVs that escort the same UGV."""

    guards: Annotated[int, Meta(ge=1, le=MOST_UAVS)] = 1
    """Number of guards g; a team of g guards tolerates the loss of g - 1."""
    silence: Positive = 2.0
    """Time without a certified guard's message, or without a measurement, after which a scout returns, S [s]."""
    scout_range: Positive | None = None
    """Largest distance of a scout from the newest known position of the UGV [m]; default: the largest from which it
    certainly returns in time.
    """
    separation: NonNegative = 2.0
    """Smallest distance between the altitude bands of any two UAVs [m]; without altitudes it has no effect."""


class Endurance(Message, frozen=True, kw_only=True):
    """Endurance of a UAV, and where it charges."""

    endurance: Positive
    """Flight time with a full charge, T_e [s]."""
    charge_time: Positive
    """Time to charge fully at its base, T_c [s]."""
    base: Vector
    """Position of its base [m]."""


class CoverageBlock(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Part of a UAV's own coverage: 8 x 8 cells, a byte each. In JSON an array of these fields, in this order."""

    column: Place
    """Column of the block in the grid of blocks."""
    row: Place
    """Row of the block."""
    cells: Annotated[bytes, Meta(min_length=BLOCK_CELLS**2, max_length=BLOCK_CELLS**2)]
    """⌊255 min(C / C*, 1)⌋ of its own contribution to each cell, row by row from y = 0 (base64 in JSON)."""


class TeamMessage(Message, frozen=True, kw_only=True):
    """Message of a UAV to the other UAVs of its team."""

    sender: Name
    """Name of the UAV."""
    tick: Tick
    """Tick of the observation that its command answers."""
    number: Tick = 0
    """Its stored number; 0: it has never guarded."""
    role: Role
    """Its role."""
    certified: bool = False
    """True if its safety filter certifies sight, as a guard's."""
    position: Vector
    """Its reference position [m]."""
    measured: Tick | None = None
    """Tick of its newest own measurement of the UGV; None: none yet."""
    measurement: Vector = (0.0, 0.0)
    """Measured position of the UGV at that tick [m]."""
    charge: NonNegative | None = None
    """Flight time that it has left [s]; None: unlimited."""
    asks: Name | None = None
    """Team-mate that it asks for relief."""
    blocks: Annotated[tuple[CoverageBlock, ...], Meta(max_length=MOST_COVERAGE_BLOCKS)] = ()
    """Parts of its own coverage."""
