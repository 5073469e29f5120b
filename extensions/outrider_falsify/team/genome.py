"""Attacks on a team as vectors of numbers in [0, 1], and their decoding into scenarios and tactics."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from bus.messages.links import LinkSettings
from bus.messages.scenario import ScriptStep
from outrider_falsify.adversary import cut
from outrider_falsify.genome import (
    ANGLE,
    DISTANCE,
    SIZES,
    Candidate,
    X,
    Y,
    clipped,
    covered,
    degraded,
    polar,
    with_script,
)
from outrider_falsify.limits import SearchLimits
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

PAIR = SIZES["adversary"]
"""Number of parameters of start, network and UGV; the parameters of the attack follow."""
(_TROUBLE, _DELAY, _JITTER, _LOSS, _DUPLICATES, _REORDER, _REORDER_DELAY) = range(PAIR, PAIR + 7)
(
    _KILL_NEW,
    _KILL_OLD,
    _KILL_AT_LEASH,
    _KILL_AT_REQUEST,
    _KILL_ANY,
    _ABSENCE,
    _REQUESTS,
    _DARK_NEW,
    _DARK_AT_LEASH,
    _DARK_AT_REQUEST,
    _DARK_LENGTH,
    _FLEES,
    _SPREAD,
    _ARC,
) = range(PAIR + 7, PAIR + 21)
TEAM_SIZES = {"team": PAIR + 21}
"""Number of parameters of an attack on a team."""

_LATEST = 2.0
"""Largest delay, jitter and extra delay of a message between UAVs [s]."""
_LONGEST = 80.0
"""Longest absence of a process, and longest blackout of the link between the UAVs [s]."""


class TeamTactics(NamedTuple):
    """Tactics of the adversary; probabilities for each event of the kind, or for each tick."""

    kill_new: float
    """The process of a UAV ends in the tick in which it accepts."""
    kill_old: float
    """The process of the former guard ends in that tick."""
    kill_at_leash: float
    """The process of the newest guard ends while a scout is at the end of its leash."""
    kill_at_request: float
    """The process of a UAV ends when a guard asks it for relief."""
    kill_any: float
    absence: int
    """Longest absence of a process [ticks]."""
    requests: float
    """A message asks a team-mate for relief without need."""
    dark_new: float
    """A blackout of the link between the UAVs starts when a UAV accepts."""
    dark_at_leash: float
    dark_at_request: float
    dark: int
    """Longest blackout [ticks]."""
    flees: float
    """Above 0.5, the UGV reacts to the farthest UAV, else to the newest guard."""


def _probability(share: float) -> float:
    """Return a probability that is zero in half of the cases."""
    return max(0.0, 2.0 * share - 1.0)


def team_tactics(vector: Sequence[float], scenario: Scenario) -> TeamTactics:
    """Return the tactics of an attack."""
    x, dt = vector, scenario.dt
    return TeamTactics(
        kill_new=_probability(x[_KILL_NEW]),
        kill_old=_probability(x[_KILL_OLD]),
        kill_at_leash=0.1 * _probability(x[_KILL_AT_LEASH]),
        kill_at_request=_probability(x[_KILL_AT_REQUEST]),
        kill_any=0.01 * _probability(x[_KILL_ANY]),
        absence=1 + round(x[_ABSENCE] ** 2 * _LONGEST / dt),
        requests=0.2 * _probability(x[_REQUESTS]),
        dark_new=_probability(x[_DARK_NEW]),
        dark_at_leash=0.1 * _probability(x[_DARK_AT_LEASH]),
        dark_at_request=_probability(x[_DARK_AT_REQUEST]),
        dark=1 + round(x[_DARK_LENGTH] ** 2 * _LONGEST / dt),
        flees=x[_FLEES],
    )


def _team_link(x: Sequence[float]) -> LinkSettings:
    """Return the link between the UAVs, which is perfect in half of the cases; the guarantee assumes nothing of it."""
    trouble = _probability(x[_TROUBLE])
    if trouble == 0.0:
        return LinkSettings()
    return LinkSettings(
        delay=cut(trouble * x[_DELAY] * _LATEST, 3),
        jitter=cut(trouble * x[_JITTER] * _LATEST, 3),
        loss=cut(trouble * x[_LOSS] * 0.95, 3),
        duplicates=cut(trouble * x[_DUPLICATES] * 0.5, 3),
        reorder=cut(trouble * x[_REORDER] * 0.5, 3),
        reorder_delay=cut(0.001 + x[_REORDER_DELAY] * _LATEST, 3),  # above 0 in any case
    )


def _started(scenario: Scenario, x: Sequence[float]) -> Scenario:
    """Set a start at rest: the first UAV in sight of the UGV, the others around it up to the end of their leash.

    UAVs at their base stay there.
    """
    width, height = scenario.area.width, scenario.area.height
    p_g = cut((0.1 + 0.8 * x[X]) * width, 3), cut((0.1 + 0.8 * x[Y]) * height, 3)
    near, n = (0.1 + 0.6 * x[DISTANCE]) * scenario.visibility.radius, len(scenario.uav)
    far = scenario.team.scout_range if scenario.team and scenario.team.scout_range else near

    def start(k: int, uav: Uav) -> Uav:
        if uav.base == uav.position:
            return uav
        distance = near if k == 0 else near + x[_SPREAD] * max(0.0, far - near)
        d_x, d_y = polar(distance, 2.0 * math.pi * (x[ANGLE] + x[_ARC] * k / n), 3)
        p_a = clipped((round(p_g[0] + d_x, 3), round(p_g[1] + d_y, 3)), (width, height))
        return msgspec.structs.replace(uav, position=p_a, velocity=(0.0, 0.0))

    ugv = msgspec.structs.replace(scenario.ugv[0], position=p_g, velocity=(0.0, 0.0))
    uavs = tuple(start(k, uav) for k, uav in enumerate(scenario.uav))
    return msgspec.structs.replace(scenario, uav=uavs, ugv=(ugv,))


def decode_team(candidate: Candidate, base: Scenario, limits: SearchLimits) -> Scenario:
    """Return the scenario of an attack; the UGV's script is missing, because only its run can record it."""
    x = candidate.vector
    scenario = degraded(covered(_started(base, x), x), limits, x)
    links = msgspec.structs.replace(scenario.links, team=_team_link(x))
    scenario = msgspec.structs.replace(scenario, seed=candidate.seed, links=links)
    return with_script(scenario, (ScriptStep(time=0.0, velocity=(0.0, 0.0)),))


def team_cases() -> list[list[float]]:
    """Return critical attacks: each kind of event alone, with a fleeing UGV, over a perfect and a bad link."""
    quiet = (
        [0.5] * 4 + [0.0] * 12 + [0.9] * 4
    )  # no network effects; covered ground around the start
    away = [0.5, 0.3, 0.2] + [0.0, 1.0] * 6  # the UGV flees
    attacks = (
        {_REQUESTS: 1.0},
        {_REQUESTS: 1.0, _KILL_NEW: 0.8, _ABSENCE: 0.4},
        {_REQUESTS: 1.0, _KILL_OLD: 1.0, _ABSENCE: 0.2},
        {_REQUESTS: 1.0, _DARK_NEW: 1.0, _DARK_LENGTH: 0.6, _KILL_ANY: 0.7},
        {_KILL_AT_LEASH: 1.0, _ABSENCE: 1.0, _FLEES: 1.0},
        {_DARK_AT_LEASH: 1.0, _DARK_LENGTH: 1.0, _FLEES: 1.0},
        {_KILL_AT_LEASH: 1.0, _DARK_AT_LEASH: 1.0, _DARK_LENGTH: 1.0, _ABSENCE: 1.0, _FLEES: 1.0},
        {_KILL_AT_REQUEST: 1.0, _DARK_AT_REQUEST: 0.8, _DARK_LENGTH: 0.5, _ABSENCE: 1.0},
    )
    cases = []
    for trouble in (0.0, 0.9):
        for attack in attacks:
            case = [*quiet, *away, trouble, *([0.7] * 6), *([0.0] * 12), 1.0, 0.0]
            for place, value in attack.items():
                case[place] = value
            cases.append(case)
    return cases
