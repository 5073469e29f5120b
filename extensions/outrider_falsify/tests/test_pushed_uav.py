"""Attacks with wind and position errors: no violation within w, and too small a w is caught."""

import math

import pytest

from outrider_falsify.attack import attack
from outrider_falsify.conditions import ANY, Conditions, declared

PUSHED = [
    (Conditions(wind=0.3), {"wind": 0.1}),
    (Conditions(position_error=0.4), {"position_error": 0.1}),
    (Conditions(wind=0.1, gains=(1.0, 0.4), blackout=3, blackout_time=5.0), {"wind": 0.02}),
    (Conditions(jumps=0.5, delay=0.3, area=2, u_g=math.inf), {"jumps": 0.2}),
    (Conditions(wind=0.3, max_command_interval=2.0, losses=ANY, area=1), {"wind": 0.1}),
]


@pytest.mark.parametrize("conditions", [conditions for conditions, _ in PUSHED])
def test_no_certified_run_loses_sight_by_wind_or_position_error(conditions) -> None:
    found = attack(declared(conditions, 0.3), conditions, 1, 0, 40, 60.0)
    assert not found["certified_lost"].any()
    assert not found["broken"].any()
    assert found["max_excess"].max() <= 1e-9
    assert found["uncertified"].mean() < 0.1


@pytest.mark.parametrize(("conditions", "less"), PUSHED)
def test_attack_catches_too_small_a_declared_tracking_error(conditions, less) -> None:
    bounds = declared(conditions._replace(**less), 0.0)
    found = attack(bounds, conditions, 1, 0, 40, 60.0)
    assert found["max_excess"].max() > 0.01
    assert found["certified_lost"].any() or found["broken"].any()
