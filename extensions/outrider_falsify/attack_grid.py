"""Grid of attacks: combinations of network, area, detection error, vehicle limits and broken assumptions."""

import itertools
import math
from collections.abc import Iterator

from outrider_falsify.conditions import (
    ANY,
    AREAS,
    BLACKOUTS,
    DISTURBANCES,
    ERRORS,
    INNERS,
    PAPER_BOUNDS,
    Conditions,
    declared,
)
from outrider_falsify.lost_trajectories import LOSSES
from sim.models.safety import SafetyBounds

EPS = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)
"""Largest detection errors in the grid [m]."""

_OTHER_BOUNDS = (
    {"dt": 0.02},
    {"dt": 0.2},
    {"v_g": 0.3},
    {"v_g": 0.48, "r_v": 10.0},
    {"v_g": 0.57, "r_v": 40.0},
    {"v_g": 0.594, "u_a": 4.0, "r_v": 30.0},
    {"v_a": 3.0, "u_a": 4.0, "v_g": 1.0, "dt": 0.1},
    {"v_a": 1.5, "u_a": 0.5, "v_g": 0.5, "dt": 0.02},
)
"""Vehicle limits and ticks that differ from the paper's: short and long ticks, fast vehicles.

The UGV's speed reaches 0.99 of the UAV's, which only a large radius can certify.
"""


def _networks() -> Iterator[Conditions]:
    """Yield every network that satisfies the assumptions."""
    times = (0.0, 2.0, 5.0, 10.0, 15.0)
    networks = itertools.product(
        times,
        (BLACKOUTS.periodic, BLACKOUTS.random, BLACKOUTS.when_far),
        ((0.0, False), (1.0, False), (3.0, True)),
        (0.0, 0.3, 1.0),
        (0.1, math.inf),
    )
    for blackout_time, kind, (latency, scattered), delay, u_g in networks:
        if blackout_time > 0.0 or kind == BLACKOUTS.periodic:
            yield Conditions(
                blackout=kind if blackout_time else BLACKOUTS.none,
                blackout_time=blackout_time,
                latency=latency,
                scattered=scattered,
                delay=delay,
                u_g=u_g,
            )


def _walls() -> Iterator[Conditions]:
    """Yield runs at walls and in corners."""
    for conditions in _networks():
        if conditions.blackout in (
            BLACKOUTS.none,
            BLACKOUTS.when_far,
        ) and conditions.blackout_time in (0.0, 5.0, 10.0):
            yield from (conditions._replace(area=area) for area in AREAS[1:])
            yield conditions._replace(area=AREAS.wall, inner=INNERS.creeps)


def _disturbed() -> Iterator[Conditions]:
    """Yield disturbances that occasionally break A5', and commands that arrive early or twice."""
    for delay, area, blackout_time, kind in itertools.product(
        (0.0, 0.3, 1.0), AREAS, (0.0, 5.0), DISTURBANCES
    ):
        conditions = Conditions(
            blackout=BLACKOUTS.when_far if blackout_time else BLACKOUTS.none,
            blackout_time=blackout_time,
            delay=delay,
            area=area,
            disturbance=kind,
        )
        if kind:
            yield conditions
        elif delay:
            yield conditions._replace(jitter=True)
            yield conditions._replace(jitter=True, duplicates=0.5)
            yield conditions._replace(duplicates=0.5)
            yield conditions._replace(disturbance=DISTURBANCES.silences, silence=2.0)


def _lossy() -> Iterator[Conditions]:
    """Yield networks that lose trajectories as often and as long as `max_command_interval` allows."""
    for interval, delay, kind, blackout_time, area in itertools.product(
        (0.3, 1.0, 2.0, 5.0, 8.0),
        (0.0, 0.3, 1.0),
        LOSSES[1:],
        (0.0, 5.0),
        AREAS,
    ):
        conditions = Conditions(
            max_command_interval=interval,
            delay=delay,
            losses=kind,
            blackout=BLACKOUTS.when_far if blackout_time else BLACKOUTS.none,
            blackout_time=blackout_time,
            area=area,
            u_g=math.inf if kind % 2 else 0.1,
        )
        yield conditions
        if area == AREAS.wall:
            yield conditions._replace(inner=INNERS.creeps)
        if delay and area == AREAS.open:
            yield conditions._replace(jitter=True, duplicates=0.5)
            yield conditions._replace(latency=1.0, scattered=True)
    for interval, kind in itertools.product((1.0, 5.0), DISTURBANCES[1:]):
        for delay in (0.0, 0.4):
            yield Conditions(
                max_command_interval=interval,
                delay=delay,
                losses=ANY,
                disturbance=kind,
                silence=2.0,
            )


def _accelerations_only() -> Iterator[Conditions]:
    """Yield receivers that accept accelerations only."""
    for area, blackout_time, kind in itertools.product(AREAS, (0.0, 5.0), DISTURBANCES):
        yield Conditions(
            bare=True,
            blackout=BLACKOUTS.when_far if blackout_time else BLACKOUTS.none,
            blackout_time=blackout_time,
            area=area,
            disturbance=kind,
            u_g=math.inf,
        )


def _moving() -> Iterator[Conditions]:
    """Yield UAVs that move at the start."""
    for speed, delay, interval, area in itertools.product(
        (0.3, 1.0), (0.0, 0.3, 1.0), (0.0, 2.0), AREAS
    ):
        yield Conditions(
            start_speed=speed,
            delay=delay,
            max_command_interval=interval,
            losses=ANY if interval else LOSSES.none,
            area=area,
        )


def _windy() -> Iterator[Conditions]:
    """Yield wind, position errors and jumps combined with blackouts, walls, delays and lost trajectories."""
    pushes = [
        Conditions(wind=wind, position_error=own, gains=gains)
        for (wind, own), gains in itertools.product(
            ((0.05, 0.0), (0.3, 0.0), (0.1, 0.2), (0.0, 0.4)), ((1.0, 2.0), (1.0, 0.4), (4.0, 3.0))
        )
    ]
    pushes += [Conditions(jumps=jumps) for jumps in (0.1, 0.5)]
    darkness = ((0.0, BLACKOUTS.none), (5.0, BLACKOUTS.when_far))
    settings = itertools.product(AREAS, darkness, (0.0, 0.3), (0.0, 2.0))
    for push, (area, (blackout_time, blackout), delay, interval) in itertools.product(
        pushes, settings
    ):
        yield push._replace(
            area=area,
            blackout=blackout,
            blackout_time=blackout_time,
            delay=delay,
            max_command_interval=interval,
            losses=ANY if interval else 0,
            u_g=math.inf if area else 0.1,
        )


def grid() -> Iterator[tuple[SafetyBounds, Conditions]]:
    """Yield every combination for which a certificate exists, with its declared changes."""
    kinds = (
        _networks(),
        _walls(),
        _disturbed(),
        _lossy(),
        _accelerations_only(),
        _moving(),
        _windy(),
    )
    for conditions in itertools.chain(*kinds):
        pushed = conditions.wind or conditions.position_error or conditions.jumps
        started = conditions.bare or conditions.start_speed
        lossy = conditions.disturbance or conditions.max_command_interval
        plain = not (conditions.area or lossy or started or pushed)
        for eps in EPS if plain else EPS[::2]:
            bounds = declared(conditions, eps)
            if not math.isnan(bounds.handover_radius):
                yield bounds, conditions
    for changes, area, delay, blackout_time in itertools.product(
        _OTHER_BOUNDS, AREAS, (0.0, 0.4), (0.0, 4.0)
    ):
        conditions = Conditions(
            blackout=BLACKOUTS.periodic if blackout_time else BLACKOUTS.none,
            blackout_time=blackout_time,
            delay=delay,
            area=area,
            error=ERRORS.sphere,
            u_g=math.inf,
            r_v=changes.get("r_v", PAPER_BOUNDS["r_v"]),
        )
        for eps in (0.0, 0.3):
            bounds = declared(conditions, eps, **changes)
            if not math.isnan(bounds.handover_radius):
                yield bounds, conditions
