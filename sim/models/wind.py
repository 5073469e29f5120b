r"""Wind as an acceleration, and the drift of an own position: filtered noise around a mean, cut at a bound. SI units.

$$ g_{k+1} = \varphi g_k + \sigma \sqrt{1 - \varphi^2}\, n_k, \quad \varphi = e^{-dt/\tau},
   \qquad w_a = clip(\bar w + g) $$

n is normal in each axis: the exact sampling of an Ornstein-Uhlenbeck process.
"""

import math
from typing import NamedTuple

from sim.compiling.compile import compiled
from sim.models.inner_loop import TrackingRecord
from sim.models.randomness import FIRST, GUST, OWN_POSITION, Key, cut_normal_vector
from sim.models.vehicles import clip_norm


class DisturbanceRow(NamedTuple):
    """The columns of a table: what acts on each UAV beside its commands, and its inner loop."""

    position_gain: float
    velocity_gain: float
    reserve: float
    """As in `sim.models.inner_loop.InnerLoop`."""
    mean_x: float
    mean_y: float
    """Of the wind [m/s²]."""
    gust: float
    """Standard deviation of the wind per axis [m/s²]."""
    gust_kept: float
    """Share of a gust that is left after a tick."""
    limit: float
    """Largest acceleration of the wind [m/s²]."""
    own_error: float
    """Largest error of the own position [m]."""
    own_kept: float
    """Share of it that is left after a tick."""


@compiled
def _drifted(
    x: float, y: float, sigma: float, kept: float, key: Key, purpose: int, tick: int
) -> tuple[float, float]:
    """Filtered noise of standard deviation `sigma` one tick on; at tick 0 it begins as it goes on."""
    if sigma == 0.0:
        return 0.0, 0.0
    if tick == 0:
        kept = 0.0
    n_x, n_y = cut_normal_vector(sigma, math.inf, key, purpose, tick, FIRST)
    fresh = math.sqrt(1.0 - kept * kept)
    return kept * x + fresh * n_x, kept * y + fresh * n_y


@compiled
def draw_disturbance(row: DisturbanceRow, state: TrackingRecord, key: Key, tick: int) -> None:
    """Draw the wind of the coming tick, and the error of the own position in it.

    Args:
        row: Parameters.
        state: Changed.
        key: Of the draws.
        tick: The coming one.
    """
    state.gust_x, state.gust_y = _drifted(
        state.gust_x, state.gust_y, row.gust, row.gust_kept, key, GUST, tick
    )
    state.wind_x, state.wind_y = clip_norm(
        row.mean_x + state.gust_x, row.mean_y + state.gust_y, row.limit
    )
    state.drift_x, state.drift_y = _drifted(
        state.drift_x, state.drift_y, 0.5 * row.own_error, row.own_kept, key, OWN_POSITION, tick
    )
    state.own_x, state.own_y = clip_norm(state.drift_x, state.drift_y, row.own_error)
