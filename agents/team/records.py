"""Constants and memory of a UAV's part in its team."""

import math
from typing import NamedTuple

import numpy as np

from agents.uav_inputs import ByteArray
from bus.messages.team import BLOCK_CELLS, Request, Role
from bus.messages.vehicle import UavBriefing
from bus.ticks import NO_TICK, team_ticks, ticks_within
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray, code, record_type, records
from sim.models.endurance import CERTIFYING, EnduranceParameters, farthest_in_area

SCOUT, RELIEF, GUARD, AWAY = map(code, Role)
CALL, RELIEVE = map(code, Request)
"""Codes of an operator's requests: come and guard; be relieved."""


class TeamParameters(NamedTuple):
    """Constants of one UAV in its team."""

    row: int
    """Row of the UAV in its team."""
    mates: int
    """UAVs of its team, itself included."""
    guards: int
    """g: number of guards."""
    silence_ticks: int
    """S: ticks after which a scout returns."""
    period: int
    """Ticks between two of its messages."""
    scout_range: float
    """Largest distance of a scout from the newest known position of the UGV [m]."""
    v_a: float
    u_a: float
    """Bounds of the UAV [m/s], [m/s²]."""
    v_g: float
    """Maximum speed of the UGV [m/s]."""
    sight: float
    """Twice the visibility radius r_v [m]."""
    farthest: float
    """Largest distance from its base within the area [m]."""
    relief_time: float
    """Time from a request for relief to the acceptance, apart from the flight [s]."""
    endurance: EnduranceParameters
    """Its endurance."""


class Mate:
    """Record of what a UAV has heard from one UAV of its team; its own row is empty."""

    number: int
    """Largest number; 0: none."""
    tick: int
    """Tick of the newest message; NO_TICK: none."""
    guard_tick: int
    """Tick of the newest message as a certified guard; NO_TICK: none."""
    role: int
    """Code of its `Role` in the newest message."""
    charge: float
    """Flight time that it had left [s]."""
    x: float
    y: float
    """Position in the newest message [m]."""


class OwnRole:
    """A UAV's own part in its team."""

    role: int
    """Code of a `Role`."""
    number: int
    """Its number; it is stored when a command with it arrives."""
    withdrawn: int
    """Largest number with which it has accepted in a command that may not have been sent; 0: none."""
    unsent: bool
    """True if its last commands may not have been sent."""
    filtered: bool
    """True while its commands pass the safety filter."""
    certified: bool
    """True if the last decision of the filter was certified."""
    since: int
    """First tick; NO_TICK before it."""
    asked_tick: int
    """Tick of the newest request to relieve a guard; NO_TICK: none."""
    called: bool
    """True while it relieves a guard that has asked it, or follows an operator's call."""
    awaited: bool
    """True from an operator's call until its charge lasts for a relief."""
    leaving: bool
    """True for a guard that is to be relieved at an operator's request."""
    asks: int
    """Row of the team-mate that it asks for relief; -1: none."""
    charge: float
    """Flight time left [s]; infinite: unlimited."""
    spare: float
    """Flight time left beyond the flight to the base and the reserve [s]."""
    lead: float
    """Time that a relief needs to reach the UGV and be certified, and that the way back may grow by meanwhile [s]."""
    home: bool
    """True if it is at rest at its base."""
    own_tick: int
    own_x: float
    own_y: float
    """Newest own measurement of the UGV: tick, NO_TICK: none; position [m]."""
    known_tick: int
    known_x: float
    known_y: float
    """Newest measurement of the team, own or received."""


class TeamMemory(NamedTuple):
    """Memory of one UAV in its team, changed in place."""

    own: RecordArray
    """`OwnRole`. Shape (1,)."""
    mates: RecordArray
    """`Mate`. Shape (UAVs of the team,)."""
    track: FloatArray
    """Own position in recent ticks [m]: tick k in row k % depth, as tick, x, y. Shape (depth, 3)."""
    heard: ByteArray
    """Largest coverage received from each UAV, a byte per cell. Shape (UAVs of the team, rows, columns)."""
    sent: ByteArray
    """Own coverage as sent last. Shape (rows, columns)."""
    sent_tick: IntArray
    """Tick in which each block was sent last; -1: never. Shape (block rows, block columns)."""
    repeats: IntArray
    """Remaining transmissions of each block as news. Shape (block rows, block columns)."""
    coverage: FloatArray
    """Coverage as the law sees it: the team's, with ground nearer to a team-mate covered. Shape (rows, columns)."""


def team_parameters(briefing: UavBriefing) -> RecordArray | None:
    """Return the constants of a UAV in its team, shape (1,); None: it has no team."""
    team = briefing.team
    if team is None or team.scout_range is None:
        return None
    given, (v_a, u_a) = briefing.endurance, briefing.limits.numbers
    parameters = TeamParameters(
        row=briefing.mates.index(briefing.vehicle),
        mates=len(briefing.mates),
        guards=team.guards,
        silence_ticks=ticks_within(team.silence, briefing.dt),
        period=team_ticks(briefing.dt),
        scout_range=float(team.scout_range),
        v_a=v_a,
        u_a=u_a,
        v_g=briefing.target_limits.numbers[0],
        sight=2.0 * briefing.visibility_radius,
        farthest=0.0 if given is None else farthest_in_area(given.base, briefing.area),
        relief_time=CERTIFYING + 2.0 * team.silence,
        endurance=EnduranceParameters(math.inf, 1.0, 0.0, 0.0)
        if given is None
        else EnduranceParameters(given.endurance, given.charge_time, *given.base),
    )
    return records(TeamParameters, [parameters])


def team_memory(briefing: UavBriefing, coverage: FloatArray, most: int = 0) -> TeamMemory | None:
    """Return the memory of a UAV that joins its team; None: it has no team.

    Args:
        briefing: Briefing of the UAV.
        coverage: Its own map at the start. Shape (rows, columns).
        most: Least number of rows for team-mates; those beyond its team stay empty.
    """
    if briefing.team is None:
        return None
    rows, columns = coverage.shape
    blocks = (-(-rows // BLOCK_CELLS), -(-columns // BLOCK_CELLS))
    own = np.zeros(1, record_type(OwnRole))
    own["role"], own["asks"] = RELIEF, -1
    for name in ("since", "asked_tick", "own_tick", "known_tick"):
        own[name] = NO_TICK
    mates = np.zeros(max(most, len(briefing.mates)), record_type(Mate))
    mates["tick"] = mates["guard_tick"] = NO_TICK
    depth = ticks_within(briefing.team.silence, briefing.dt) + 1
    return TeamMemory(
        own=own,
        mates=mates,
        track=np.full((depth, 3), float(NO_TICK)),
        heard=np.zeros((len(mates), rows, columns), np.uint8),
        sent=np.minimum(255.0 * coverage / briefing.desired_coverage, 255.0).astype(np.uint8),
        sent_tick=np.full(blocks, -1, np.int64),
        repeats=np.zeros(blocks, np.int64),
        coverage=coverage.copy(),
    )
