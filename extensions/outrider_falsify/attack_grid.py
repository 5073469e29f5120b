"""The grid of attacks: all combinations of network, place, error, vehicles and broken assumptions."""

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
from outrider_falsify.lost_motions import LOSSES
from sim.models.safety import SafetyBounds

EPS = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)
"""Largest errors of a detection in the grid [m]."""

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
"""Vehicles and ticks unlike the paper's: short and long ticks.

A UGV up to 0.99 as fast as the UAV, which only a large radius can certify; fast vehicles."""


def _networks() -> Iterator[Conditions]:
    """Every network that keeps the assumptions."""
    times = (0.0, 2.0, 5.0, 10.0, 15.0)
    networks = itertools.product(
        times,
        (BLACKOUTS.periodic, BLACKOUTS.random, BLACKOUTS.when_far),
        ((0.0, False), (1.0, False), (3.0, True)),
        (0.0, 0.3, 1.0),
        (0.1, math.inf),
    )
    for dark, kind, (latency, scattered), delay, u_g in networks:
        if dark > 0.0 or kind == BLACKOUTS.periodic:
            yield Conditions(
                blackout=kind if dark else BLACKOUTS.none,
                blackout_time=dark,
                latency=latency,
                scattered=scattered,
                delay=delay,
                u_g=u_g,
            )


def _places() -> Iterator[Conditions]:
    """Walls and corners."""
    for conditions in _networks():
        if conditions.blackout in (
            BLACKOUTS.none,
            BLACKOUTS.when_far,
        ) and conditions.blackout_time in (0.0, 5.0, 10.0):
            yield from (conditions._replace(area=area) for area in AREAS[1:])
            yield conditions._replace(area=AREAS.wall, inner=INNERS.creeps)


def _disturbed() -> Iterator[Conditions]:
    """Commands and processes that now and then break A5', and commands that come early or twice."""
    for delay, area, dark, kind in itertools.product(
        (0.0, 0.3, 1.0), AREAS, (0.0, 5.0), DISTURBANCES
    ):
        conditions = Conditions(
            blackout=BLACKOUTS.when_far if dark else BLACKOUTS.none,
            blackout_time=dark,
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
    """Networks that lose motions, as often and for as long as B allows."""
    for outage, delay, kind, dark, area in itertools.product(
        (0.3, 1.0, 2.0, 5.0, 8.0),
        (0.0, 0.3, 1.0),
        LOSSES[1:],
        (0.0, 5.0),
        AREAS,
    ):
        conditions = Conditions(
            outage=outage,
            delay=delay,
            losses=kind,
            blackout=BLACKOUTS.when_far if dark else BLACKOUTS.none,
            blackout_time=dark,
            area=area,
            u_g=math.inf if kind % 2 else 0.1,
        )
        yield conditions
        if area == AREAS.wall:
            yield conditions._replace(inner=INNERS.creeps)
        if delay and area == AREAS.open:
            yield conditions._replace(jitter=True, duplicates=0.5)
            yield conditions._replace(latency=1.0, scattered=True)
    for outage, kind in itertools.product((1.0, 5.0), DISTURBANCES[1:]):
        for delay in (0.0, 0.4):
            yield Conditions(outage=outage, delay=delay, losses=ANY, disturbance=kind, silence=2.0)


def _bare() -> Iterator[Conditions]:
    """Receivers that know accelerations only."""
    for area, dark, kind in itertools.product(AREAS, (0.0, 5.0), DISTURBANCES):
        yield Conditions(
            bare=True,
            blackout=BLACKOUTS.when_far if dark else BLACKOUTS.none,
            blackout_time=dark,
            area=area,
            disturbance=kind,
            u_g=math.inf,
        )


def _moving() -> Iterator[Conditions]:
    """UAVs that move when the run begins."""
    for speed, delay, outage, area in itertools.product(
        (0.3, 1.0), (0.0, 0.3, 1.0), (0.0, 2.0), AREAS
    ):
        yield Conditions(
            start_speed=speed,
            delay=delay,
            outage=outage,
            losses=ANY if outage else LOSSES.none,
            area=area,
        )


def _windy() -> Iterator[Conditions]:
    """Wind, a wrong own position and jumps, with darkness, walls, delays and lost motions."""
    pushes = [
        Conditions(wind=wind, position_error=own, gains=gains)
        for (wind, own), gains in itertools.product(
            ((0.05, 0.0), (0.3, 0.0), (0.1, 0.2), (0.0, 0.4)), ((1.0, 2.0), (1.0, 0.4), (4.0, 3.0))
        )
    ]
    pushes += [Conditions(jumps=jumps) for jumps in (0.1, 0.5)]
    darkness = ((0.0, BLACKOUTS.none), (5.0, BLACKOUTS.when_far))
    places = itertools.product(AREAS, darkness, (0.0, 0.3), (0.0, 2.0))
    for push, (area, (dark, blackout), delay, outage) in itertools.product(pushes, places):
        yield push._replace(
            area=area,
            blackout=blackout,
            blackout_time=dark,
            delay=delay,
            outage=outage,
            losses=ANY if outage else 0,
            u_g=math.inf if area else 0.1,
        )


def grid() -> Iterator[tuple[SafetyBounds, Conditions]]:
    """All combinations of network, place, error, vehicles and broken assumptions for which there is a certificate."""
    kinds = _networks(), _places(), _disturbed(), _lossy(), _bare(), _moving(), _windy()
    for conditions in itertools.chain(*kinds):
        pushed = conditions.wind or conditions.position_error or conditions.jumps
        started = conditions.bare or conditions.start_speed
        lossy = conditions.disturbance or conditions.outage
        plain = not (conditions.area or lossy or started or pushed)
        for eps in EPS if plain else EPS[::2]:
            promise = declared(conditions, eps)
            if not math.isnan(promise.handover_radius):
                yield promise, conditions
    for bounds, area, delay, dark in itertools.product(
        _OTHER_BOUNDS, AREAS, (0.0, 0.4), (0.0, 4.0)
    ):
        conditions = Conditions(
            blackout=BLACKOUTS.periodic if dark else BLACKOUTS.none,
            blackout_time=dark,
            delay=delay,
            area=area,
            error=ERRORS.sphere,
            u_g=math.inf,
            r_v=bounds.get("r_v", PAPER_BOUNDS["r_v"]),
        )
        for eps in (0.0, 0.3):
            promise = declared(conditions, eps, **bounds)
            if not math.isnan(promise.handover_radius):
                yield promise, conditions
