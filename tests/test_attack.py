"""The attack on the certificate.

It finds nothing where the theorem holds, and what is known to be wrong does not survive it.
"""

import math

import numpy as np
import pytest
from flights import R_S, R_V

from outrider.experiments.falsify import attack as a
from sim.kernels.compile import FloatArray

OUTWARD, SPHERE = a.INNERS.index("outward"), a.ERRORS.index("sphere")
FLEES, STRAIGHT = a.UGVS.index("flees"), a.UGVS.index("straight")
PERIODIC, WHEN_FAR, RANDOM = map(a.BLACKOUTS.index, ("periodic", "when_far", "random"))
SMALL, CORNER = a.AREAS.index("small"), a.AREAS.index("corner")
CONDITIONS = {
    "undegraded": (a.Conditions(), 0.3),
    "turns on the spot": (a.Conditions(inner=OUTWARD, ugv=FLEES, u_g=math.inf), 0.0),
    "errors of 1.5 m": (a.Conditions(error=SPHERE), 1.5),
    "alternating errors": (a.Conditions(error=a.ERRORS.index("alternating")), 0.9),
    "blackouts of 15 s": (a.Conditions(blackout=PERIODIC, blackout_time=15.0), 0.3),
    "blackouts when it is far": (a.Conditions(blackout=WHEN_FAR, blackout_time=8.0), 0.9),
    "overtaking detections": (a.Conditions(latency=3.0, scattered=True), 0.3),
    "late commands": (a.Conditions(delay=1.0), 0.3),
    "all at once": (
        a.Conditions(blackout=RANDOM, blackout_time=5.0, latency=1.0, scattered=True, delay=0.5),
        0.6,
    ),
    "errors of norm eps, straight at v_g": (
        a.Conditions(inner=0, ugv=STRAIGHT, error=SPHERE, u_g=math.inf),
        0.3,
    ),
    "a corner": (a.Conditions(area=CORNER, blackout=3, blackout_time=5.0), 0.3),
    "a small room": (a.Conditions(area=SMALL, delay=0.3), 0.3),
    "commands that come twice": (a.Conditions(area=SMALL, delay=0.3, duplicates=0.5), 0.0),
}
"""Within the assumptions: conditions, and eps [m]."""


RUNS, DURATION = 60, 100.0


def flown(conditions: a.Conditions, eps: float, **numbers: float) -> FloatArray:
    return a.attack(a.declared(conditions, eps, **numbers), conditions, 7, 0, RUNS, DURATION)


@pytest.mark.parametrize("name", CONDITIONS)
def test_where_the_assumptions_hold_nobody_is_lost_and_the_certificate_is_approached(name) -> None:
    """One that nobody comes near would be worth little."""
    conditions, eps = CONDITIONS[name]
    promise = a.declared(conditions, eps)
    assert not math.isnan(promise.handover)
    rows = flown(conditions, eps)
    assert 0.98 * R_V < rows[:, a.MAX_DISTANCE].max() < R_V
    assert rows[:, a.MAX_CERTIFIED].max() < R_V  # between ticks too
    assert rows[:, a.MAX_EXCESS].max() <= 1e-9
    assert not rows[:, [a.UNCERTIFIED, a.CERTIFIED_LOST, a.BROKEN]].any()
    assert rows[:, a.MAX_AGE].max() <= promise.age + 1e-9
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
    conditions = a.Conditions(error=SPHERE, error_share=2.0)
    assert flown(conditions, 0.3)[:, a.UNCERTIFIED].min() > 0.9


DISTURBED = {
    "jitter": a.Conditions(delay=0.5, jitter=True),
    "jitter and duplicates": a.Conditions(delay=0.3, jitter=True, duplicates=0.5, area=SMALL),
    **{
        f"{name}, {delay:g} s late": a.Conditions(
            disturbance=k, delay=delay, blackout=3, blackout_time=4.0
        )
        for k, name in enumerate(a.DISTURBANCES)
        for delay in (0.0, 1.0)
        if k
    },
    "silences in a corner": a.Conditions(
        disturbance=2, silence=2.0, hold=4.0, delay=0.3, area=CORNER
    ),
}
"""What breaks A5, and the rest within the assumptions."""


@pytest.mark.parametrize("name", DISTURBED)
def test_no_tick_is_certified_while_sight_is_lost_whatever_becomes_of_commands(name: str) -> None:
    rows = flown(DISTURBED[name], 0.3)
    assert not rows[:, [a.CERTIFIED_LOST, a.BROKEN]].any()
    assert rows[:, a.MAX_CERTIFIED].max() < R_V
    assert rows[:, a.UNCERTIFIED].mean() > 0.0
    assert rows[:, a.UNCERTIFIED].min() < 1.0


def test_commands_that_do_not_act_lose_sight_without_a_margin() -> None:
    for conditions in (
        DISTURBED["jitter"],
        a.Conditions(disturbance=a.DISTURBANCES.index("silences")),
    ):
        rows = flown(conditions, 0.3)
        assert rows[:, a.MAX_DISTANCE].max() > R_V
        assert flown(conditions, 0.3, margin=0.6)[:, a.MAX_DISTANCE].max() < R_V


def test_a_filter_that_certifies_what_it_should_not_is_caught() -> None:
    """The counters count: a filter that believes in too large a radius."""
    promise = a.declared(a.Conditions(), 0.0)
    assert flown_with(promise._replace(r_v=4.9, handover=4.85))[:, a.CERTIFIED_LOST].sum() > 0
    assert flown_with(promise._replace(handover=4.74))[:, a.BROKEN].sum() > 0


def flown_with(promise: a.Promise) -> FloatArray:
    return a.attack(promise, a.Conditions(u_g=math.inf), 7, 0, RUNS, DURATION)


@pytest.mark.parametrize("seed", range(20))
def test_the_largest_distance_within_a_tick_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(50):
        r, v, w = rng.normal(size=(3, 2)) * np.array([[0.05], [1.0], [1.0]])
        s = np.linspace(0.0, 0.2, 4001)[:, None]
        far = np.hypot(*(r + v * s + (w - v) / 0.2 * s**2 / 2).T).max()
        found = a.largest_in_tick(*r, *v, *w, 0.2)
        assert far - 1e-12 <= found <= far + 1e-7


def test_any_run_can_be_flown_again_alone() -> None:
    conditions, eps = CONDITIONS["all at once"]
    promise = a.declared(conditions, eps)
    rows = a.attack(promise, conditions, 7, 0, 4, 30.0)
    assert np.array_equal(a.attack(promise, conditions, 7, 3, 1, 30.0)[0], rows[3])
    assert not np.array_equal(a.attack(promise, conditions, 8, 3, 1, 30.0)[0], rows[3])


def test_the_grid_holds_only_what_has_a_certificate_and_every_place_and_disturbance() -> None:
    grid = list(a.grid())
    assert not any(math.isnan(promise.handover) for promise, _ in grid)
    assert {conditions.area for _, conditions in grid} == set(range(len(a.AREAS)))
    assert {conditions.disturbance for _, conditions in grid} == set(range(len(a.DISTURBANCES)))
