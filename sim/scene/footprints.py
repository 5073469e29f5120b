"""Footprints of buildings: places for labels."""

import numpy as np

from bus.messages.base import Vector
from bus.messages.buildings import Building

_SAMPLES, _CENTERING = 9, 0.05
"""Points along each axis that are candidates for a label, and the weight of their distance from the middle."""


def label_point(building: Building) -> Vector:
    """Return a point of the footprint far from its walls, for a label [m]: the best one of a grid, near the middle."""
    corners, ((left, low), (right, high)) = np.array(building.corners), building.bounds
    x, y = np.meshgrid(np.linspace(left, right, _SAMPLES), np.linspace(low, high, _SAMPLES))
    a_x, a_y = (part[:, None, None] for part in corners.T)
    b_x, b_y = (part[:, None, None] for part in np.roll(corners, -1, axis=0).T)
    d_x, d_y = b_x - a_x, b_y - a_y
    share = (((x - a_x) * d_x + (y - a_y) * d_y) / (d_x**2 + d_y**2)).clip(0.0, 1.0)
    depth = np.hypot(x - a_x - share * d_x, y - a_y - share * d_y).min(axis=0)
    crossed = (a_y > y) != (b_y > y)
    right_of = d_x * (y - a_y) / np.where(d_y == 0.0, 1.0, d_y) + a_x
    inside = (crossed & (x < right_of)).sum(axis=0) % 2 == 1
    off = np.hypot(x - 0.5 * (left + right), y - 0.5 * (low + high))
    best = np.where(inside, depth - _CENTERING * off, -np.inf).argmax()
    return float(x.flat[best]), float(y.flat[best])
