r"""Sensor `plateau` with nearly constant quality: $S_a = M_a (1 - \rho^4/r^4)^2$ inside r, 0 outside."""

from sim.compiling.compile import compiled


@compiled
def quality(rho2: float, peak: float, sensing_range: float) -> float:
    r"""Return the sensor quality $S_a$ [1/s]; arguments as in `sim.models.sensors.hill.quality`."""
    s = rho2 / (sensing_range * sensing_range)
    s = s * s
    rest = 1.0 - s if s < 1.0 else 0.0
    return peak * rest * rest


@compiled
def slope(rho2: float, peak: float, sensing_range: float) -> float:
    r"""Return $dS_a/d\rho^2$ [1/(s m²)]; arguments as in `quality`."""
    scale = 1.0 / (sensing_range * sensing_range)
    s = rho2 * scale
    rest = 1.0 - s * s if s < 1.0 else 0.0
    return -4.0 * peak * scale * s * rest
