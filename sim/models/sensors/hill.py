"""Sensor `hill` of the paper."""

from sim.compiling.compile import compiled


@compiled
def quality(rho2: float, peak: float, sensing_range: float) -> float:
    r"""Return the sensor quality $S_a$ [1/s], Klodt 2015, eq. (2).

    $$ S_a = \frac{M_a}{r^4}(\rho^2 - r^2)^2 \text{ inside r, } 0 \text{ outside} $$

    Args:
        rho2: Squared distance from the UAV [m²].
        peak: M_a, the quality directly below the UAV [1/s].
        sensing_range: Range r of the sensor [m].
    """
    s = rho2 / (sensing_range * sensing_range)
    rest = 1.0 - s if s < 1.0 else 0.0
    return peak * rest * rest


@compiled
def slope(rho2: float, peak: float, sensing_range: float) -> float:
    r"""Return $dS_a/d\rho^2$ [1/(s m²)]; arguments as in `quality`."""
    scale = 1.0 / (sensing_range * sensing_range)
    s = rho2 * scale
    rest = 1.0 - s if s < 1.0 else 0.0
    return -2.0 * peak * scale * rest
