r"""Altitude laws: the vertical acceleration of a UAV that has an altitude. Beyond Klodt 2015.

`fixed` holds the initial altitude, `certified` the lowest altitude whose certificate holds, and `best` the certified
altitude from which the sensor gains most on the ground around the UAV.
"""

import math
from typing import NamedTuple

from sim.compiling.compile import FloatArray, compiled
from sim.compiling.lanes import LANES
from sim.models.altitude import clip
from sim.models.camera import CameraParameters, sensor_at
from sim.models.field import density, penalty_slope
from sim.models.grid import disc_chords
from sim.models.sensor import SensorParameters, sensor_quality
from sim.models.shadows import Occlusion, cast_shadow
from sim.models.vehicles import speed_to_stop_within

ABOVE_FLOOR = 0.05
"""Height above the lowest certified altitude that the laws keep [m]."""
CANDIDATES = 8
"""Altitudes that the law `best` compares."""
PERIOD = 1.0
"""Time between two comparisons [s]."""


@compiled
def climb_to(
    z: float, rate: float, goal: float, max_rate: float, max_acceleration: float, dt: float
) -> float:
    """Return the vertical acceleration that flies to an altitude and stays there [m/s²].

    Args:
        z, rate: Altitude [m] and climb rate [m/s].
        goal: Altitude to reach [m].
        max_rate, max_acceleration: Vertical bounds [m/s], [m/s²].
        dt: Duration of a tick [s].
    """
    climb = goal - z
    speed = min(max_rate, speed_to_stop_within(abs(climb), max_acceleration, dt), abs(climb) / dt)
    return clip((math.copysign(speed, climb) - rate) / dt, max_acceleration)


@compiled
def expected_gain(
    coverage: FloatArray,
    own: tuple[float, float],
    target: tuple[float, float],
    r_o: float,
    desired: float,
    sensor: SensorParameters,
    cell: float,
    occlusion: Occlusion | None = None,
) -> float:
    r"""Return the rate at which a sensor here lowers e(t) of (4) [m²/s].

    $$ \int_{Q_r} h'(C^* - C)\, S_a\, \phi\, dq $$

    Args:
        coverage: C on the grid.
        own, target: Position of the UAV, and estimated position of the UGV [m].
        r_o, desired, sensor, cell, occlusion: As in `sim.models.field.coverage_gradient`.
    """
    rows, columns = coverage.shape
    first_row, chords = disc_chords(own[0], own[1], sensor.sensing_range, cell, rows, columns)
    if occlusion is not None:
        shadow = cast_shadow(
            occlusion, own[0], own[1], sensor.sensing_range, cell, first_row, chords
        )
    total = 0.0
    for n in range(chords.shape[1]):
        j, first, end = first_row + n, chords[0, n], chords[1, n]
        y = (j + 0.5) * cell
        d_y, g_y = y - own[1], y - target[1]
        for i in range(first, end):
            x = (i + 0.5) * cell
            d_x, g_x = x - own[0], x - target[0]
            quality = sensor_quality(sensor, d_x * d_x + d_y * d_y)
            lack = penalty_slope(desired - coverage[j, i])
            gain = lack * quality * density(g_x * g_x + g_y * g_y, r_o)
            if occlusion is not None:
                gain = gain if shadow.winding[n, LANES + i - first] <= 0 else 0.0
            total += gain
    return total * cell * cell


class MapWeights(NamedTuple):
    """Weights of the cells of a map, and their size."""

    r_o: float
    """Radius of the density [m]."""
    desired: float
    """Desired coverage C*."""
    cell: float
    """Width of a cell [m]."""


@compiled
def best_altitude(
    coverage: FloatArray,
    own: tuple[float, float],
    target: tuple[float, float],
    weights: MapWeights,
    sensor: SensorParameters,
    camera: CameraParameters,
    bounds: tuple[float, float],
    occlusion: Occlusion | None = None,
) -> float:
    """Return the altitude with the largest expected gain; the lowest of equal ones [m].

    Args:
        coverage, own, target: As in `expected_gain`.
        weights: Weights of the map's cells.
        sensor: The sensor at the reference altitude.
        camera: The camera.
        bounds: Lowest and highest altitude to compare [m].
        occlusion: Known buildings; None: there are none.
    """
    lowest, highest = bounds
    found, most = lowest, -1.0
    for k in range(CANDIDATES):
        z = lowest + (highest - lowest) * k / (CANDIDATES - 1)
        seeing = sensor_at(sensor, camera, z)
        if occlusion is None:
            gain = expected_gain(
                coverage, own, target, weights.r_o, weights.desired, seeing, weights.cell
            )
        else:
            seen = Occlusion(occlusion.buildings, occlusion.corners, occlusion.known, z)
            gain = expected_gain(
                coverage, own, target, weights.r_o, weights.desired, seeing, weights.cell, seen
            )
        if gain > most * (1.0 + 1e-9):
            found, most = z, gain
    return found
