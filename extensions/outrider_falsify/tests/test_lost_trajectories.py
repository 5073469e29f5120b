"""Attacks by lost trajectories: no violation where A5' holds, and wrong configurations are caught."""

import math

import pytest

from outrider_falsify.attack import attack
from outrider_falsify.conditions import DISTURBANCES, Conditions, declared
from outrider_falsify.lost_trajectories import LOSSES

COMBINATIONS = [
    (interval, delay, kind)
    for interval in (1.0, 5.0)
    for delay in (0.0, 0.3)
    for kind in LOSSES[1:]
]


@pytest.mark.parametrize(("interval", "delay", "kind"), COMBINATIONS)
def test_no_certified_run_loses_sight_by_lost_trajectories(interval, delay, kind) -> None:
    blackouts = {"blackout": 3, "blackout_time": 4.0, "u_g": math.inf, "jitter": delay > 0.0}
    conditions = Conditions(max_command_interval=interval, delay=delay, losses=kind, **blackouts)
    rows = attack(declared(conditions, 0.3), conditions, 5, 0, 4, 100.0)
    assert rows["max_distance"].max() < conditions.r_v
    assert rows["certified_lost"].sum() == rows["broken"].sum() == 0
    assert rows["uncertified"].max() == 0.0


def test_handover_uses_the_flown_trajectory_not_a_lost_one() -> None:
    conditions = Conditions(
        blackout=3,
        blackout_time=5.0,
        max_command_interval=2.0,
        losses=-1,
        ugv=-1,
        inner=-1,
        error=-1,
    )
    found = attack(declared(conditions, 0.9), conditions, 1, 0, 400, 100.0)
    assert not found["broken"].any()


def test_undeclared_command_gaps_lose_sight_and_are_reported() -> None:
    conditions = Conditions(
        max_command_interval=8.0, inner=0, ugv=0, losses=LOSSES.whenever_it_may, u_g=math.inf
    )
    bounds = declared(conditions._replace(max_command_interval=0.5), 0.3)
    rows = attack(bounds, conditions, 5, 0, 20, 200.0)
    assert rows["max_distance"].max() > conditions.r_v
    assert rows["uncertified"].min() > 0.1
    assert rows["certified_lost"].sum() == rows["broken"].sum() == 0


def test_attack_catches_trajectories_checked_for_too_short_a_gap() -> None:
    """Declare a long command interval with the radii of a short one, that is, without the waiting time."""
    conditions = Conditions(
        max_command_interval=8.0, losses=LOSSES.whenever_it_may, inner=0, ugv=0, u_g=math.inf
    )
    short = declared(conditions._replace(max_command_interval=0.05), 0.3)
    wait = 7.95 * short.v_g  # which the checks subtract again
    wrong = short._replace(
        handover_radius=short.handover_radius + wait,
        handover_bound=short.handover_bound + wait,
        interval_ticks=160,
    )
    rows = attack(wrong, conditions, 5, 0, 20, 200.0)
    assert rows["max_distance"].max() > conditions.r_v
    assert rows["broken"].sum() > 0


def test_command_gaps_yet_to_come_break_no_certificate() -> None:
    """Drop a plan when the committed one is so old that the next chain arrives too late."""
    conditions = Conditions(
        max_command_interval=0.65,
        delay=0.5,
        losses=LOSSES.random,
        disturbance=DISTURBANCES.single_losses,
        blackout=2,
        blackout_time=4.0,
    )
    found = attack(declared(conditions, 0.0), conditions, 1, 0, 100, 100.0)
    assert found["uncertified"].max() > 0.05
    assert found["certified_lost"].sum() == found["broken"].sum() == 0
