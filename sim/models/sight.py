"""Judgement of sight, Klodt 2015, eq. (5), with the radius that holds at a tick.

This radius is r_v in the plane, r_v(z) at an altitude, and 0 while a building hides the UGV.
"""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def is_lost(distance: npt.ArrayLike, radius: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return whether a UGV is out of sight.

    Args:
        distance: Distance of UAV and UGV [m].
        radius: Distance within which the UGV is visible [m].
    """
    lost: npt.NDArray[np.bool_] = np.asarray(distance) >= np.asarray(radius)
    return lost


def sight_margin(distance: npt.ArrayLike, radius: npt.ArrayLike) -> FloatArray:
    """Return the distance by which a UGV may still recede before it is out of sight [m]; arguments as of `is_lost`.

    It is positive exactly if the UGV is in sight, and 0 while a building hides it.
    """
    away, within = np.asarray(distance), np.asarray(radius)
    margin: FloatArray = np.where(within > 0.0, within - away, 0.0)
    return margin
