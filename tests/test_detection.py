"""Detections: their probability and their noise."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from properties import PROPERTY
from seeded import a_key
from sim.models.detection import detect, detection_chance

R_V, R = 4.75, 5.0
ATTEMPTS = 4000


def _attempts(distance, dropout, sigma=0.0, cut=3.0, seed=1):
    place, keys = (0.6 * distance, -0.8 * distance), (a_key(seed, 1), a_key(seed, 2))
    return [detect(*place, R_V, R, dropout, sigma, cut, *keys, tick) for tick in range(ATTEMPTS)]


@given(st.floats(0.0, 10.0) | st.sampled_from((R_V, R)), st.floats(0.0, 1.0))
@settings(PROPERTY)
def test_detection_chance_falls_from_one_at_r_v_to_zero_at_r(distance, dropout):
    """Between r_v and R the detection rate falls linearly."""
    wanted = (1.0 - dropout) * min(max((R - distance) / (R - R_V), 0.0), 1.0)
    assert detection_chance(distance, R_V, R, dropout) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(
    ("distance", "dropout"),
    [(4.749999, 0.0), (5.000001, 0.0), (4.875, 0.0), (4.8, 0.3), (4.6, 0.5), (2.0, 1.0)],
)
def test_detections_are_as_frequent_as_their_chance(distance, dropout):
    wanted = detection_chance(distance, R_V, R, dropout)
    share = sum(found for found, _, _ in _attempts(distance, dropout)) / ATTEMPTS
    spread = math.sqrt(max(wanted * (1.0 - wanted), 1e-12) / ATTEMPTS)
    assert share == pytest.approx(wanted, abs=4.0 * spread)


def test_failed_detection_has_no_position() -> None:
    assert np.array_equal(_attempts(6.0, dropout=0.0)[0], (False, math.nan, math.nan), True)


def test_detection_without_noise_is_exact() -> None:
    assert all((x, y) == (0.6 * 3.0, -0.8 * 3.0) for _, x, y in _attempts(3.0, dropout=0.0))


@pytest.mark.parametrize("cut", [1.0, 3.0, math.inf])
def test_detection_noise_is_unbiased_and_truncated(cut: float) -> None:
    sigma = 0.2
    noise = np.array(
        [(x - 1.8, y + 2.4) for _, x, y in _attempts(3.0, dropout=0.0, sigma=sigma, cut=cut)]
    )
    h = 0.5 * cut * cut
    variance = sigma**2 * (1.0 - (h / math.expm1(h) if h < 700.0 else 0.0))
    assert np.hypot(*noise.T).max() <= cut * sigma + 1e-14
    assert noise.mean(axis=0) == pytest.approx([0.0, 0.0], abs=4.0 * sigma / math.sqrt(ATTEMPTS))
    assert noise.var(axis=0) == pytest.approx(
        [variance, variance], rel=4.0 * math.sqrt(2.0 / ATTEMPTS)
    )


def test_noise_and_dropouts_are_drawn_apart() -> None:
    kept = [attempt for attempt in _attempts(3.0, dropout=0.5, sigma=0.2) if attempt[0]]
    whole = _attempts(3.0, dropout=0.0, sigma=0.2)
    assert 0 < len(kept) < len(whole)
    assert set(kept) < set(whole)


def test_detection_noise_depends_on_its_own_key_alone() -> None:
    detections = {
        detect(1.0, 1.0, R_V, R, 0.0, 0.2, 3.0, a_key(n), a_key(m), 7)
        for n in range(5)
        for m in range(4)
    }
    assert len(detections) == 5
