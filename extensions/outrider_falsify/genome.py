"""Candidates as vectors of numbers in [0, 1] for the optimizer, and their decoding into scenarios."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec

from bus.messages.base import Vector
from bus.messages.links import LinkSettings
from bus.messages.scenario import Region, ScriptStep
from outrider_falsify.adversary import Tactics, cut
from outrider_falsify.limits import SearchLimits, pair, time_to_detection
from sim.models.vehicles import stopping_distance
from sim.scenario.types import Detections, LinkTable, Scenario, VehicleLinks, switching_radius

(X, Y, ANGLE, DISTANCE, _UAV_SPEED, _UAV_HEADING, _UGV_SPEED, _UGV_HEADING) = range(8)
(_DELAY, _JITTER, _LOSS, _NOISE, _COMMAND_DELAY, _BLACKOUT, _BLACKOUT_START, _BLACKOUT_GAP) = range(
    8, 16
)
_COVERED = 16
HEAD = 20
"""Parameters of start, network and covered ground; the parameters of the UGV's motion follow."""

_FAR, _FAST, _PERIOD = range(HEAD, HEAD + 3)
_TABLE = HEAD + 3

SCRIPT_STEPS = 12
SIZES = {"adversary": _TABLE + 12, "script": HEAD + 3 * SCRIPT_STEPS}
"""Number of parameters of each kind of candidate.

`adversary`: a UGV that reacts to the UAV; `script`: a sequence of velocities.
"""

_GAP = 10.0
"""Longest time between two blackouts [s]."""
_MOST_BLACKOUTS = 1000
_COVERED_MOST = 10.0
"""Largest extent of the covered ground from the UGV's start [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """Parameters of one run."""

    number: int
    kind: str
    """Row of `SIZES`."""
    vector: tuple[float, ...]
    seed: int
    """Seed of noise and losses."""


def polar(length: float, angle: float, digits: int) -> Vector:
    """Return the vector of a length and an angle [rad], with some decimal digits."""
    return cut(length * math.cos(angle), digits), cut(length * math.sin(angle), digits)


def _speed(share: float, bound: float) -> float:
    """Return a speed that is zero in half of the cases."""
    return bound * max(0.0, 2.0 * share - 1.0)


def clipped(point: Vector, size: Vector) -> Vector:
    """Return the nearest point of the area from (0, 0) to `size` [m]."""
    return min(max(point[0], 0.0), size[0]), min(max(point[1], 0.0), size[1])


def _started(scenario: Scenario, x: Sequence[float]) -> Scenario:
    """Set a start from which braking at once keeps the UGV within r_s (18).

    A law that loses sight from there is itself at fault.
    """
    uav, ugv = pair(scenario)
    width, height, r_v = scenario.area.width, scenario.area.height, scenario.visibility.radius
    p_g = cut((0.1 + 0.8 * x[X]) * width, 3), cut((0.1 + 0.8 * x[Y]) * height, 3)
    angle = 2.0 * math.pi * x[ANGLE]
    speed = _speed(x[_UAV_SPEED], uav.max_speed)
    room = switching_radius(scenario, uav, ugv) - float(
        stopping_distance(speed + ugv.max_speed, uav.max_acceleration)
    )
    distance = x[DISTANCE] * min(max(room, 0.1 * r_v), 0.98 * r_v)
    d_x, d_y = polar(distance, angle, 3)
    v_a = polar(speed, angle + 2.0 * math.pi * x[_UAV_HEADING], 4)
    v_g = polar(_speed(x[_UGV_SPEED], ugv.max_speed), angle + 2.0 * math.pi * x[_UGV_HEADING], 4)
    # the UGV is in Q, so clipping brings the UAV nearer
    p_a = clipped((round(p_g[0] + d_x, 3), round(p_g[1] + d_y, 3)), (width, height))
    uav = msgspec.structs.replace(uav, position=p_a, velocity=v_a)
    ugv = msgspec.structs.replace(ugv, position=p_g, velocity=v_g)
    return msgspec.structs.replace(scenario, uav=(uav,), ugv=(ugv,))


def covered(scenario: Scenario, x: Sequence[float]) -> Scenario:
    """Mark a rectangle around the UGV's start as covered: the rest draws the UAV outwards."""
    area, (p_x, p_y) = scenario.area, scenario.ugv[0].position
    west, east, south, north = (
        _COVERED_MOST * max(0.0, 2.0 * share - 1.0) for share in x[_COVERED : _COVERED + 4]
    )
    lower = (cut(max(0.0, p_x - west), 2), cut(max(0.0, p_y - south), 2))
    upper = (cut(min(area.width, p_x + east), 2), cut(min(area.height, p_y + north), 2))
    if min(upper[0] - lower[0], upper[1] - lower[1]) < 2.0 * area.cell:
        return scenario
    regions = (*scenario.coverage.covered, Region(lower=lower, upper=upper))
    coverage = msgspec.structs.replace(scenario.coverage, covered=regions)
    return msgspec.structs.replace(scenario, coverage=coverage)


def _blackouts(
    x: Sequence[float], longest: float, loss: float, scenario: Scenario
) -> tuple[tuple[float, float], ...]:
    """Return blackouts separated by enough time for a detection to arrive.

    Otherwise two blackouts would act as one longer blackout.
    """
    duration, dt = scenario.duration, scenario.dt
    length = cut(x[_BLACKOUT] * longest, 2)
    if length < dt:
        return ()
    start = cut(x[_BLACKOUT_START] * duration, 2)
    gap = time_to_detection(loss, scenario) + dt + x[_BLACKOUT_GAP] * _GAP
    every = length + math.ceil(gap / dt) * dt
    count = min(_MOST_BLACKOUTS, math.ceil((duration - start) / every))
    return tuple((round(start + k * every, 6), length) for k in range(count))


def degraded(scenario: Scenario, limits: SearchLimits, x: Sequence[float]) -> Scenario:
    """Apply noise and network effects; the UGV's own commands stay without delay."""
    if not limits.degraded:
        return scenario
    delay, loss = cut(x[_DELAY] * limits.delay, 3), cut(x[_LOSS] * limits.loss, 3)
    detections = LinkSettings(
        delay=delay,
        jitter=cut(x[_JITTER] * min(limits.delay - delay, 10.0), 3),
        loss=loss,
        blackouts=_blackouts(x, limits.blackout, loss, scenario),
    )
    commands = LinkSettings(delay=cut(x[_COMMAND_DELAY] * limits.command_delay, 3))
    links = LinkTable(detections=detections, commands=commands)
    if commands.delay:
        links = msgspec.structs.replace(
            links, only=(VehicleLinks(vehicle=scenario.ugv[0].name, detections=detections),)
        )
    noisy: Detections = msgspec.structs.replace(
        scenario.detections, noise=cut(x[_NOISE] * limits.noise, 4)
    )
    return msgspec.structs.replace(scenario, detections=noisy, links=links)


def _script(scenario: Scenario, x: Sequence[float]) -> tuple[ScriptStep, ...]:
    v_g, dt = scenario.ugv[0].max_speed, scenario.dt
    longest = 2.0 * scenario.ticks / SCRIPT_STEPS
    steps, tick = [], 0
    for k in range(HEAD, HEAD + 3 * SCRIPT_STEPS, 3):
        velocity = polar(v_g * min(1.0, 1.5 * x[k + 2]), 2.0 * math.pi * x[k + 1], 4)
        steps.append(ScriptStep(time=tick * dt, velocity=velocity))
        tick += max(1, round(x[k] * longest))
    return tuple(steps)


def tactics_of(vector: Sequence[float], scenario: Scenario) -> Tactics:
    """Return the tactics of an `adversary`."""
    uav, ugv = scenario.uav[0], scenario.ugv[0]
    table = tuple(
        (2.0 * math.pi * angle, ugv.max_speed * min(1.0, 1.5 * speed))
        for angle, speed in zip(vector[_TABLE::2], vector[_TABLE + 1 :: 2], strict=True)
    )
    return Tactics(
        far=(0.4 + 0.6 * vector[_FAR]) * scenario.visibility.radius,
        fast=vector[_FAST] * uav.max_speed,
        period=max(1, round((0.2 + 0.8 * vector[_PERIOD]) / scenario.dt)),
        table=table,
    )


def decode(candidate: Candidate, base: Scenario, limits: SearchLimits) -> Scenario:
    """Return the candidate's scenario.

    The script of an `adversary` is missing, because only its run can record it.
    """
    x = candidate.vector
    scenario = degraded(covered(_started(base, x), x), limits, x)
    script = (
        _script(scenario, x)
        if candidate.kind == "script"
        else (ScriptStep(time=0.0, velocity=(0.0, 0.0)),)
    )
    return with_script(msgspec.structs.replace(scenario, seed=candidate.seed), script)


def with_script(scenario: Scenario, script: Sequence[ScriptStep]) -> Scenario:
    """Return the scenario with a UGV that follows this script; steps without effect are removed."""
    kept = [
        *script[:1],
        *(later for earlier, later in pairwise(script) if later.velocity != earlier.velocity),
    ]
    ugv = msgspec.structs.replace(
        scenario.ugv[0], driver="script", script=tuple(kept), goals=(), trajectory=""
    )
    custom = msgspec.structs.replace(scenario.custom, policy="")
    return msgspec.structs.replace(scenario, ugv=(ugv,), custom=custom)


def proof_cases() -> list[list[float]]:
    """Return critical cases of the proofs as `adversary` vectors, each with the worst network.

    A row of `tables` gives the UGV's direction for a near UAV, then for a far one. Each time the UAV recedes, hardly
    moves, or approaches.
    """
    away, towards, left, right = 0.0, 0.5, 0.25, 0.75
    tables = (
        (away, away, away, away, away, away),  # flees
        (
            towards,
            towards,
            towards,
            away,
            away,
            away,
        ),  # lures the UAV, then flees beyond a distance
        (
            away,
            left,
            towards,
            away,
            away,
            towards,
        ),  # flees a receding UAV, turns towards an approaching one
        (away, away, towards, away, away, away),
        (left, left, left, away, away, away),  # circles, then flees
        (left, right, left, right, left, right),  # dodges
        (towards, towards, towards, away, left, towards),  # passes below the UAV
        (left, away, right, away, away, left),
    )
    starts = ((0.95, 0.0), (0.5, 0.0), (0.98, 1.0))  # share of the allowed distance, speed
    # covered ground: none, all around, all but one side
    grounds = (
        (0.0, 0.0, 0.0, 0.0),
        (0.7, 0.7, 0.7, 0.7),
        (1.0, 0.75, 1.0, 1.0),
    )
    cases = []
    for distance, speed in starts:
        for k, table in enumerate(tables):
            head = [0.5, 0.5, (0.37 * k) % 1.0, distance, speed, 0.0, 0.0, 0.5]
            network = [1.0, 0.0, 0.3, 1.0, 1.0, 1.0, 0.1 + 0.1 * k, 0.0]
            # stands while the UAV is near
            stands = [0.0 if speed == 0.0 and k % 2 and cell < 3 else 1.0 for cell in range(6)]
            cells = [
                number
                for angle, goes in zip(table, stands, strict=True)
                for number in (angle, goes)
            ]
            cases.append(
                [*head, *network, *grounds[k % 3], 0.5, 0.3 if k % 2 else 0.8, 0.0, *cells]
            )
    return cases
