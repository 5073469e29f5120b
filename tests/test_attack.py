"""The attack on the certificate: it finds nothing where the theorem holds, and what is known to be wrong does not survive it."""

import math

import numpy as np
import pytest
from flights import R_S, R_V

from outrider import attack as a
from sim.compile import FloatArray

CONDITIONS = {
    "undegraded": (a.Conditions(), 0.3),
    "turns on the spot": (a.Conditions(inner=a.INNERS.index("outward"), ugv=a.UGVS.index("flees"), u_g=math.inf), 0.0),
    "errors of 1.5 m": (a.Conditions(error=a.ERRORS.index("sphere")), 1.5),
    "alternating errors": (a.Conditions(error=a.ERRORS.index("alternating")), 0.9),
    "blackouts of 15 s": (a.Conditions(blackout=a.BLACKOUTS.index("periodic"), blackout_time=15.0), 0.3),
    "blackouts when it is far": (a.Conditions(blackout=a.BLACKOUTS.index("when_far"), blackout_time=8.0), 0.9),
    "overtaking detections": (a.Conditions(latency=3.0, scattered=True), 0.3),
    "late commands": (a.Conditions(delay=1.0), 0.3),
    "all at once": (
        a.Conditions(blackout=a.BLACKOUTS.index("random"), blackout_time=5.0, latency=1.0, scattered=True, delay=0.5),
        0.6,
    ),
}
"""Within the assumptions: conditions, and eps [m]."""

RUNS, DURATION = 60, 100.0


def flown(conditions: a.Conditions, eps: float, **numbers: float) -> FloatArray:
    return a.attack(a.declared(conditions, eps, **numbers), conditions, 7, 0, RUNS, DURATION)


@pytest.mark.parametrize("name", CONDITIONS)
def test_where_the_assumptions_hold_nobody_is_lost(name: str) -> None:
    conditions, eps = CONDITIONS[name]
    promise = a.declared(conditions, eps)
    assert not math.isnan(promise.handover)
    rows = flown(conditions, eps)
    assert rows[:, a.MAX_DISTANCE].max() < R_V
    assert rows[:, a.MAX_EXCESS].max() <= 1e-9
    assert rows[:, a.UNCERTIFIED].max() == 0.0
    assert rows[:, a.MAX_AGE].max() <= promise.age + 1e-9


@pytest.mark.parametrize("name", CONDITIONS)
def test_the_certificate_is_approached(name: str) -> None:
    """One that nobody comes near would be worth little."""
    conditions, eps = CONDITIONS[name]
    rows = flown(conditions, eps)
    assert rows[:, a.MAX_DISTANCE].max() > 0.98 * R_V
    assert 0.0 < rows[:, a.INTERVENED].mean() < 0.6


LOST = {
    "the paper's switching law": (a.Conditions(law=a.PAPER, radius=R_S), 0.0),
    "the paper's, late commands": (a.Conditions(law=a.PAPER, radius=R_S, delay=0.5), 0.0),
    "tracking (15), errors of 0.9 m": (a.Conditions(law=a.SWITCH_TRACKING), 0.9),
    "to the best detection": (a.Conditions(law=a.SWITCH_BEST, blackout=1, blackout_time=8.0), 0.9),
}
"""What the specification found to be wrong."""


@pytest.mark.parametrize("name", LOST)
def test_what_is_wrong_loses_sight(name: str) -> None:
    conditions, eps = LOST[name]
    if conditions.law != a.PAPER:
        conditions = conditions._replace(radius=a.spec_radius(a.declared(conditions, eps)))
    assert flown(conditions, eps)[:, a.MAX_DISTANCE].max() > R_V + 0.01


def test_the_radius_needs_its_term_for_late_commands() -> None:
    conditions = a.Conditions(law=a.SWITCH_SERVO, delay=1.0)
    promise = a.declared(conditions, 0.3)
    largest = []
    for with_latency in (True, False):
        tried = conditions._replace(radius=a.spec_radius(promise, with_latency=with_latency))
        largest.append(flown(tried, 0.3)[:, a.MAX_DISTANCE].max())
    assert largest[0] < R_V < R_V + 0.5 < largest[1]


def test_errors_larger_than_declared_break_the_bound_and_are_noticed() -> None:
    conditions = a.Conditions(error=a.ERRORS.index("hides"), error_share=2.0)
    assert flown(conditions, 0.3)[:, a.MAX_EXCESS].max() > 0.25
    conditions = a.Conditions(error=a.ERRORS.index("sphere"), error_share=2.0)
    assert flown(conditions, 0.3)[:, a.UNCERTIFIED].min() > 0.9


def test_a_command_that_is_not_waited_for_is_noticed() -> None:
    """Jitter and loss are outside the theorem: such ticks are not certified, and a margin is needed."""
    for conditions, margin in ((a.Conditions(delay=0.5, jitter=True), 0.6), (a.Conditions(loss=0.5), 0.6)):
        rows = flown(conditions, 0.3)
        assert rows[:, a.MAX_DISTANCE].max() > R_V
        assert rows[:, a.UNCERTIFIED].min() > 0.0
        assert flown(conditions, 0.3, margin=margin)[:, a.MAX_DISTANCE].max() < R_V


def test_any_run_can_be_flown_again_alone() -> None:
    conditions, eps = CONDITIONS["all at once"]
    promise = a.declared(conditions, eps)
    rows = a.attack(promise, conditions, 7, 0, 4, 30.0)
    assert np.array_equal(a.attack(promise, conditions, 7, 3, 1, 30.0)[0], rows[3])
    assert not np.array_equal(a.attack(promise, conditions, 8, 3, 1, 30.0)[0], rows[3])


def test_the_grid_holds_only_what_is_within_the_assumptions() -> None:
    first = next(iter(a.campaign(1, duration=1.0)))
    assert first.runs == 1
    assert first.violations == 0
    assert not math.isnan(first.promise.handover)
