r"""Wind acceleration and position error: filtered noise around a mean, limited by a bound. SI units.

$$ g_{k+1} = \varphi g_k + \sigma \sqrt{1 - \varphi^2}\, n_k, \quad \varphi = e^{-dt/\tau},
   \qquad w_a = clip(\bar w + g) $$

n is normal in each axis: the exact sampling of an Ornstein-Uhlenbeck process.
"""

import math
from typing import NamedTuple

from bus.messages.base import Vector
from sim.compiling.compile import compiled
from sim.models.inner_loop import Disturbance, InnerLoop
from sim.models.randomness import FIRST, GUST, OWN_POSITION, Key, cut_normal_vector
from sim.models.vehicles import clip_norm


class DisturbanceParameters(NamedTuple):
    """Parameters of a UAV's disturbances, and its inner loop."""

    loop: InnerLoop
    mean: Vector
    """Mean of the wind [m/s²]."""
    gust: float
    """Standard deviation of the wind per axis [m/s²]."""
    gust_kept: float
    """Share of a gust that remains after a tick."""
    limit: float
    """Largest acceleration of the wind [m/s²]."""
    position_error: float
    """Largest position error [m]."""
    own_kept: float
    """Share of it that remains after a tick."""
    outside: bool
    """True if a body outside the compiled tick sets the tracking error, see `sim.engine.bodies`."""


@compiled
def _drifted(
    x: float, y: float, sigma: float, kept: float, key: Key, purpose: int, tick: int
) -> tuple[float, float]:
    """Advance filtered noise with standard deviation `sigma` by one tick; tick 0 has the stationary distribution."""
    if sigma == 0.0:
        return 0.0, 0.0
    if tick == 0:
        kept = 0.0
    n_x, n_y = cut_normal_vector(sigma, math.inf, key, purpose, tick, FIRST)
    fresh = math.sqrt(1.0 - kept * kept)
    return kept * x + fresh * n_x, kept * y + fresh * n_y


@compiled
def draw_disturbance(row: DisturbanceParameters, state: Disturbance, key: Key, tick: int) -> None:
    """Draw the wind and the position error of the next tick.

    Args:
        row: Parameters.
        state: Disturbance of the UAV; changed.
        key: Key of the random numbers.
        tick: The next tick.
    """
    gust, wind, drift, error = state.gust, state.wind, state.drift, state.position_error
    gust[0], gust[1] = _drifted(gust[0], gust[1], row.gust, row.gust_kept, key, GUST, tick)
    wind[0], wind[1] = clip_norm(row.mean[0] + gust[0], row.mean[1] + gust[1], row.limit)
    drift[0], drift[1] = _drifted(
        drift[0], drift[1], 0.5 * row.position_error, row.own_kept, key, OWN_POSITION, tick
    )
    error[0], error[1] = clip_norm(drift[0], drift[1], row.position_error)
