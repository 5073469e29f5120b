"""Parameters of the driver `navigate`."""

import msgspec

from agents.drivers.parameters import UgvParameters
from bus.messages.vehicle import UgvBriefing
from bus.registry import BOLD

_PLAN_PERIOD = 0.2
"""Shortest time between two plans [s]."""
PLAN_TILES = 8192
"""Largest number of tiles that planning settles in a tick, to bound the duration of a tick."""


class NavigateParameters(UgvParameters, frozen=True, kw_only=True):
    """Parameters of the driver `navigate` and of its UGV."""

    tile: float
    """Side of a tile of the ground [m]."""
    bold: int
    """1 if the UGV trusts its own sensor on unseen ground; 0 if it is cautious."""
    rough_share: float
    """Least share of the maximum speed on rough ground."""
    plan_ticks: int
    """Least time between two plans, for the same goal and a UGV that is still on its path [ticks]."""
    plan_tiles: int
    """Largest number of tiles that planning settles in a tick."""


def navigate_parameters(ugv: UgvParameters, briefing: UgvBriefing) -> NavigateParameters:
    """Return the parameters of the driver from a UGV's briefing."""
    ground = briefing.ground
    return NavigateParameters(
        **msgspec.structs.asdict(ugv),
        tile=0.0 if ground is None else ground.tile,
        bold=int(ground is not None and ground.caution == BOLD),
        rough_share=1.0 if ground is None else ground.rough_speed_share,
        plan_ticks=max(1, round(_PLAN_PERIOD / ugv.dt)),
        plan_tiles=PLAN_TILES,
    )
