"""Attack on the safety filter of a UAV that dives and climbs over the worst town."""

import math
from typing import Any

import pytest

from outrider_falsify import attacks
from outrider_falsify.attack import attack
from outrider_falsify.conditions import AREAS, BLACKOUTS, DISTURBANCES, Conditions, declared
from outrider_falsify.heights import FLIGHTS, Town, certifiable, over_town
from outrider_falsify.lost_trajectories import LOSSES
from outrider_falsify.pool import Workers
from outrider_falsify.search import Budget

# Compiled once more for altitudes; another adversary is in tests/test_altitude_env.py.
pytestmark = pytest.mark.long
NARROW, WIDE = 0, 9
"""Rows of `FLIGHTS`: an agile UAV with a narrow and a wide camera."""
FLIGHTS_OF = {
    "perfect": (Conditions(), 0.3, NARROW),
    "delayed and lossy": (
        Conditions(delay=0.2, max_command_interval=1.0, losses=LOSSES[1]),
        0.3,
        WIDE,
    ),
    "late detections": (
        Conditions(
            delay=0.3, latency=3.0, scattered=True, blackout=BLACKOUTS.when_far, blackout_time=2.0
        ),
        0.0,
        WIDE,
    ),
    "a process that leaves": (
        Conditions(delay=0.3, disturbance=DISTURBANCES.rejoins, area=AREAS.corner),
        0.6,
        NARROW,
    ),
    "bare accelerations": (
        Conditions(bare=True, disturbance=DISTURBANCES.single_losses, u_g=math.inf),
        0.6,
        NARROW,
    ),
    "starts moving": (Conditions(start_speed=0.3, area=AREAS.corner), 0.6, WIDE),
}
"""Conditions, largest detection error [m], and row of `FLIGHTS`."""


def attacked(name: str, runs: int, town: Town | None = None) -> tuple[float, float]:
    """Return the certified ticks out of sight, and the broken certificates, of all runs.

    Args:
        name: Row of `FLIGHTS_OF`.
        runs: Number of runs.
        town: Town by which sight is judged; None: the one that the filter assumes.
    """
    conditions, eps, flight = FLIGHTS_OF[name]
    bounds = declared(conditions, eps)
    assert certifiable(bounds, conditions, flight)
    scenario, heights = over_town(bounds, conditions, flight)
    assert heights.levels["valid"].all()
    heights = heights._replace(town=town or heights.town)
    found = attack(bounds, conditions, 3, 0, runs, 60.0, (scenario, heights))
    return float(found["certified_lost"].sum()), float(found["broken"].sum())


@pytest.mark.parametrize("name", FLIGHTS_OF)
def test_no_certified_tick_is_out_of_sight_at_any_altitude(name: str) -> None:
    assert attacked(name, 60) == (0.0, 0.0)


def test_buildings_nearer_than_declared_are_noticed() -> None:
    """The attack is strong enough to find a filter that assumes too much."""
    _, half_angle, (tallest, clearance, marker) = FLIGHTS[NARROW]
    town = Town(4.75, math.tan(half_angle), marker, tallest, clearance - 0.2)
    lost, _ = attacked("perfect", 60, town)
    assert lost > 0.0


def test_search_over_towns_finds_nothing_and_its_run_reflies() -> None:
    tally = attacks.AttackTally()
    with Workers(1, attacks.warm) as workers:
        attacks.run_attack(
            workers, Budget(40, None, lambda: False), tally, duration=20.0, altitude=True
        )
    assert (tally.runs, tally.violations, tally.broken) == (40, 0, 0)
    assert tally.worst is not None
    namespace: dict[str, Any] = {}
    statements, _, expression = attacks.again(tally.worst, 1).rpartition("; ")
    exec(statements, namespace)  # noqa: S102
    row = eval(expression, namespace)  # noqa: S307
    assert row["max_certified"] == tally.worst.worst_distance
