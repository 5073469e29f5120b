"""The attack on the certificate.

It finds nothing where the theorem holds, and it breaks every configuration known to be wrong.
"""

import math

import numpy as np
import pytest

from flights import R_S, R_V
from outrider_falsify.attack import attack
from outrider_falsify.attack_grid import grid
from outrider_falsify.conditions import (
    ANY,
    AREAS,
    BLACKOUTS,
    DISTURBANCES,
    ERRORS,
    GUARDS,
    INNERS,
    UGVS,
    Conditions,
    declared,
    spec_radius,
)
from outrider_falsify.tick_distance import largest_in_tick
from sim.compiling.records import RecordArray
from sim.models.safety import SafetyBounds

OUTWARD, SPHERE = INNERS.outward, ERRORS.sphere
FLEES, STRAIGHT = UGVS.flees, UGVS.straight
PERIODIC, WHEN_FAR, RANDOM = BLACKOUTS.periodic, BLACKOUTS.when_far, BLACKOUTS.random
SMALL, CORNER = AREAS.small, AREAS.corner
CONDITIONS = {
    "undegraded": (Conditions(), 0.3),
    "turns on the spot": (Conditions(inner=OUTWARD, ugv=FLEES, u_g=math.inf), 0.0),
    "errors of 1.5 m": (Conditions(error=SPHERE), 1.5),
    "alternating errors": (Conditions(error=ERRORS.alternating), 0.9),
    "blackouts of 15 s": (Conditions(blackout=PERIODIC, blackout_time=15.0), 0.3),
    "blackouts when it is far": (Conditions(blackout=WHEN_FAR, blackout_time=8.0), 0.9),
    "overtaking detections": (Conditions(latency=3.0, scattered=True), 0.3),
    "late commands": (Conditions(delay=1.0), 0.3),
    "all at once": (
        Conditions(blackout=RANDOM, blackout_time=5.0, latency=1.0, scattered=True, delay=0.5),
        0.6,
    ),
    "errors of norm eps, straight at v_g": (
        Conditions(inner=0, ugv=STRAIGHT, error=SPHERE, u_g=math.inf),
        0.3,
    ),
    "a corner": (Conditions(area=CORNER, blackout=3, blackout_time=5.0), 0.3),
    "a small room": (Conditions(area=SMALL, delay=0.3), 0.3),
    "commands that come twice": (Conditions(area=SMALL, delay=0.3, duplicates=0.5), 0.0),
    "commands that come early": (Conditions(delay=0.5, jitter=True), 0.3),
    "bare accelerations": (Conditions(bare=True), 0.3),
}
"""Conditions within the assumptions, and eps [m]."""


RUNS, DURATION = 30, 100.0


def flown(conditions: Conditions, eps: float, **numbers: float) -> RecordArray:
    return attack(declared(conditions, eps, **numbers), conditions, 7, 0, RUNS, DURATION)


@pytest.mark.parametrize("name", CONDITIONS)
def test_valid_assumptions_keep_sight_close_to_the_bound(name) -> None:
    """Distances close to the bound show that the attack is strong."""
    conditions, eps = CONDITIONS[name]
    bounds = declared(conditions, eps)
    assert not math.isnan(bounds.handover_radius)
    rows = flown(conditions, eps)
    assert 0.98 * R_V < rows["max_distance"].max() < R_V
    assert rows["max_certified"].max() < R_V  # also between ticks
    assert rows["max_excess"].max() <= 1e-9
    assert not any(rows[name].any() for name in ("uncertified", "certified_lost", "broken"))
    assert rows["max_age"].max() <= bounds.max_measurement_age + 1e-9
    assert 0.0 < rows["overridden"].mean() < 0.6


LOST = {
    "the paper's switching law": (Conditions(law=GUARDS.paper, radius=R_S), 0.0),
    "the paper's, late commands": (Conditions(law=GUARDS.paper, radius=R_S, delay=0.5), 0.0),
    "tracking (15), errors of 0.9 m": (Conditions(law=GUARDS.switch_tracking), 0.9),
    "to the best detection": (
        Conditions(law=GUARDS.switch_best, blackout=1, blackout_time=8.0),
        0.9,
    ),
}
"""Certificates that the specification found to be wrong."""


@pytest.mark.parametrize("name", LOST)
def test_wrong_parameters_lose_sight(name: str) -> None:
    conditions, eps = LOST[name]
    if conditions.law != GUARDS.paper:
        conditions = conditions._replace(radius=spec_radius(declared(conditions, eps)))
    assert flown(conditions, eps)["max_distance"].max() > R_V + 0.01


def test_the_radius_needs_its_term_for_late_commands() -> None:
    conditions = Conditions(law=GUARDS.switch_servo, delay=1.0)
    bounds = declared(conditions, 0.3)
    largest = []
    for with_latency in (True, False):
        tried = conditions._replace(radius=spec_radius(bounds, with_latency=with_latency))
        largest.append(flown(tried, 0.3)["max_distance"].max())
    assert largest[0] < R_V < R_V + 0.5 < largest[1]


def test_undeclared_errors_break_the_bound_and_are_detected() -> None:
    conditions = Conditions(error=ERRORS.hides, error_share=2.0)
    assert flown(conditions, 0.3)["max_excess"].max() > 0.25
    conditions = Conditions(error=SPHERE, error_share=2.0)
    found = flown(conditions, 0.3)
    assert found["uncertified"].min() > 0.9
    assert (
        found["broken"].max() == 0.0
    )  # measurements that contradict the errors break no certificate


DISTURBED = {
    **{
        f"{name}, {delay:g} s late": Conditions(
            disturbance=k, delay=delay, blackout=3, blackout_time=4.0
        )
        for k, name in enumerate(DISTURBANCES._fields)
        for delay in (0.0, 1.0)
        if k
    },
    "silences in a corner": Conditions(
        disturbance=2, silence=2.0, command_timeout=4.0, delay=0.3, area=CORNER
    ),
}
"""Conditions that break A5', and the rest within the assumptions."""


@pytest.mark.parametrize("name", DISTURBED)
def test_attack_on_commands_certifies_no_lost_tick(name: str) -> None:
    rows = flown(DISTURBED[name], 0.3)
    assert not any(rows[name].any() for name in ("certified_lost", "broken"))
    assert rows["max_certified"].max() < R_V
    assert rows["uncertified"].mean() > 0.0
    assert rows["uncertified"].min() < 1.0


def test_trajectories_arriving_too_late_lose_sight() -> None:
    rows = flown(Conditions(disturbance=DISTURBANCES.late), 0.3)
    assert rows["max_distance"].max() > R_V


@pytest.mark.parametrize("delay", [0.0, 1.0])
def test_uav_that_starts_moving_keeps_its_certificate(delay: float) -> None:
    rows = flown(Conditions(start_speed=1.0, delay=delay), 0.3)
    assert not any(rows[name].any() for name in ("certified_lost", "broken"))
    assert rows["max_certified"].max() < R_V
    assert rows["uncertified"].max() < 3.0 * (delay + 0.05) / DURATION


def test_attack_catches_a_filter_with_too_large_a_radius() -> None:
    """Check the counters with a safety filter whose radius is too large."""
    bounds = declared(Conditions(), 0.0)
    assert flown_with(bounds._replace(radius=4.9, handover_radius=4.85))["certified_lost"].sum() > 0
    assert flown_with(bounds._replace(handover_radius=4.74))["broken"].sum() > 0


def flown_with(bounds: SafetyBounds) -> RecordArray:
    return attack(bounds, Conditions(u_g=math.inf), 7, 0, RUNS, DURATION)


@pytest.mark.parametrize("seed", range(20))
def test_the_largest_distance_within_a_tick_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(50):
        r, v, w = rng.normal(size=(3, 2)) * np.array([[0.05], [1.0], [1.0]])
        s = np.linspace(0.0, 0.2, 4001)[:, None]
        far = np.hypot(*(r + v * s + (w - v) / 0.2 * s**2 / 2).T).max()
        found = largest_in_tick(*r, *v, *w, 0.2)
        assert far - 1e-12 <= found <= far + 1e-7


def test_residual_velocities_at_a_wall_break_no_certificate() -> None:
    """Start within nanometres of a wall, where a contact removes velocity from a plan.

    Only the first tick of a UAV that starts on the wall and moves into it may be uncertified.
    """
    conditions = Conditions(
        area=AREAS.wall, inner=INNERS.creeps, max_command_interval=1.0, losses=ANY, delay=0.3
    )
    rows = attack(declared(conditions, 0.0), conditions, 11, 0, 200, DURATION)
    assert not any(rows[name].any() for name in ("certified_lost", "broken"))
    at_first = attack(declared(conditions, 0.0), conditions, 11, 0, 200, 0.0)["uncertified"]
    ticks = DURATION / declared(conditions, 0.0).dt + 1
    assert rows["uncertified"] * ticks == pytest.approx(at_first)
    assert at_first.sum() < 60


def test_any_run_can_be_flown_again_alone() -> None:
    conditions, eps = CONDITIONS["all at once"]
    bounds = declared(conditions, eps)
    rows = attack(bounds, conditions, 7, 0, 4, 30.0)
    assert attack(bounds, conditions, 7, 3, 1, 30.0)[0] == rows[3]
    assert attack(bounds, conditions, 8, 3, 1, 30.0)[0] != rows[3]


def test_grid_is_certifiable_and_has_every_area_and_disturbance() -> None:
    combinations = list(grid())
    assert not any(math.isnan(bounds.handover_radius) for bounds, _ in combinations)
    assert {conditions.area for _, conditions in combinations} == set(AREAS)
    assert {conditions.disturbance for _, conditions in combinations} == set(DISTURBANCES)
