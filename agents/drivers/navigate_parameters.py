"""Parameters of the driver `navigate`."""

import msgspec

from agents.drivers.parameters import UgvParameters
from bus.messages.vehicle import UgvBriefing
from bus.registry import BOLD

_PLAN_PERIOD = 0.2
"""Shortest time between two plans [s]."""
PLAN_TILES = 8192
"""Greatest number of tiles that it settles in a tick when it plans: no tick takes much longer."""


class NavigateParameters(UgvParameters, frozen=True, kw_only=True):
    """Parameters of the driver `navigate` and of its UGV."""

    tile: float
    """Side of a tile of the ground [m]."""
    bold: int
    """1: it trusts its bumper on ground that nobody has seen; 0: it is cautious."""
    rough_share: float
    """Least share of its maximum speed on rough ground."""
    plan_ticks: int
    """Least time between two plans, if the goal is the same and the UGV has not left the old one [ticks]."""
    plan_tiles: int
    """Greatest number of tiles that planning settles in a tick."""


def navigate_parameters(ugv: UgvParameters, briefing: UgvBriefing) -> NavigateParameters:
    """Return the parameters of the driver of the UGV that is briefed."""
    ground = briefing.ground
    return NavigateParameters(
        **msgspec.structs.asdict(ugv),
        tile=0.0 if ground is None else ground.tile,
        bold=int(ground is not None and ground.caution == BOLD),
        rough_share=1.0 if ground is None else ground.rough_speed_share,
        plan_ticks=max(1, round(_PLAN_PERIOD / ugv.dt)),
        plan_tiles=PLAN_TILES,
    )
