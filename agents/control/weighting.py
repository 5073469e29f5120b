"""Weighting of tracking against coverage: (17), the three weightings of section V, and a user's weighting."""

import math
from collections.abc import Callable

from bus.errors import ScenarioError
from bus.numbers import exact
from sim.compiling.compile import compiled

_SAMPLES = 2000
"""Number of distances up to r_s at which a user's weighting is checked."""

Weighting = Callable[[float, float], tuple[float, float]]
"""User's weighting: maps the distance [m] and r_s [m] to alpha and beta."""


@compiled
def combine(
    alpha: float, beta: float, u_tr_x: float, u_tr_y: float, u_cov_x: float, u_cov_y: float
) -> tuple[float, float]:
    r"""Return the combined control law [m/s²], Klodt 2015, eq. (17).

    $$ u_a = \alpha(\|p_\Delta\|)\, u_{a,tr} + \beta(\|p_\Delta\|)\, u_{a,cov} $$
    """
    return alpha * u_tr_x + beta * u_cov_x, alpha * u_tr_y + beta * u_cov_y


@compiled
def linear_weights(distance: float, r_s: float) -> tuple[float, float]:
    r"""Return the linear weights $\alpha_1, \beta_1$: $\alpha_1 = \|p_\Delta\|/r_s$ inside r_s, 1 outside.

    $\beta_1 = 1 - \alpha_1$.
    """
    alpha = distance / r_s if distance < r_s else 1.0
    return alpha, 1.0 - alpha


@compiled
def switching_weights(distance: float, r_s: float) -> tuple[float, float]:
    r"""Return the switching weights $\alpha_2, \beta_2$: $\alpha_2 = 0$ inside r_s, 1 outside.

    $\beta_2 = 1 - \alpha_2$.
    """
    alpha = 0.0 if distance < r_s else 1.0
    return alpha, 1.0 - alpha


@compiled
def logarithmic_weights(
    distance: float, r_s: float, k_beta: float, limit: float
) -> tuple[float, float]:
    r"""Return the logarithmic weights $\alpha_3, \beta_3$, Klodt 2015, eq. (19).

    $$ \alpha_3 = 1, \quad \beta_3 = -k_\beta \log(\|p_\Delta\|/r_s) \text{ inside } r_s, \quad 0 \text{ outside} $$

    Args:
        distance: Distance between the vehicles [m].
        r_s: Switching radius (18) [m].
        k_beta: Gain.
        limit: Largest beta (footnote 2 of the paper: near 0 the logarithm is unbounded).
    """
    if distance >= r_s:
        return 1.0, 0.0
    if distance <= 0.0:
        return 1.0, limit
    return 1.0, min(-k_beta * math.log(distance / r_s), limit)


def check_weighting(weighting: Weighting, r_s: float) -> None:
    """Check a user's weighting against Proposition 2 of the paper, at many distances up to 3 r_s.

    Sampling proves nothing between the samples.

    Args:
        weighting: Weighting to check.
        r_s: Switching radius (18) [m].

    Raises:
        ScenarioError: If alpha or beta is not a finite number >= 0, or alpha = 1, beta = 0 fails at a distance
            >= r_s. The message names the distance.
    """
    for index in range(3 * _SAMPLES + 1):
        distance = r_s * (index / _SAMPLES)
        try:
            alpha, beta = weighting(distance, r_s)
            fine = math.isfinite(alpha) and math.isfinite(beta) and alpha >= 0.0 and beta >= 0.0
        except (TypeError, ValueError, ArithmeticError) as error:
            raise ScenarioError(
                f"weighting at a distance of {distance:.6g} m: {error}; it must return alpha and beta"
            ) from error
        if not fine:
            raise ScenarioError(
                f"weighting at a distance of {distance:.6g} m: alpha = {exact(alpha)}, beta = {exact(beta)}; "
                "allowed: finite numbers, not negative (Proposition 2)"
            )
        if distance >= r_s and (alpha, beta) != (1.0, 0.0):
            raise ScenarioError(
                f"weighting at a distance of {distance:.6g} m >= r_s = {r_s:.6g} m: alpha = {exact(alpha)}, "
                f"beta = {exact(beta)}; Proposition 2 asks for alpha = 1, beta = 0 there"
            )
