r"""UAV sensor (2) as a record, and its quality and slope.

A sensor consists of the quality $S(\rho^2)$, its slope $dS/d\rho^2$ and a range: a file in `sim.models.sensors`, and a
row of `bus.registry.SENSORS`.
"""

from typing import NamedTuple

from bus.messages.scenario import Sensor
from bus.registry import SENSORS, module_of, usable
from sim.compiling.compile import compiled
from sim.compiling.dispatch import choice

_MODULES = usable(SENSORS.values(), lambda row: module_of(row, "quality", "slope"))
_quality = choice([sensor.quality for sensor in _MODULES.values()])
_slope = choice([sensor.slope for sensor in _MODULES.values()])


class SensorParameters(NamedTuple):
    """Parameters of a sensor; compiled code also accepts a record with these fields."""

    model: int
    """Index of its row in `SENSORS`."""
    peak: float
    """M_a, the quality directly below the UAV [1/s]."""
    sensing_range: float
    """Range r [m]."""


def sensor_parameters(sensor: Sensor) -> SensorParameters:
    """Return the parameters of a registered sensor."""
    return SensorParameters(
        tuple(SENSORS).index(sensor.model), float(sensor.peak), float(sensor.range)
    )


@compiled
def sensor_quality(sensor: SensorParameters, rho2: float) -> float:
    r"""Return the sensor quality $S_a$ at squared distance $\rho^2$ [m²] from the UAV [1/s]."""
    quality: float = _quality(sensor.model, (rho2, sensor.peak, sensor.sensing_range))
    return quality


@compiled
def sensor_slope(sensor: SensorParameters, rho2: float) -> float:
    r"""Return the slope $dS_a/d\rho^2$ [1/(s m²)] of the sensor quality, used in (6)."""
    slope: float = _slope(sensor.model, (rho2, sensor.peak, sensor.sensing_range))
    return slope
