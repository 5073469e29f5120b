"""filterpy's Kalman filter, without the rest of filterpy until somebody asks for it.

Its packages import every filter when they are opened, and for them `scipy.stats` and `scipy.linalg`: more processor
time than all else that a pilot loads. The filter needs neither, so the packages are entered without being opened.
"""

import sys
from importlib import import_module
from typing import Any

from sim.kernels.compile import FloatArray
from sim.kernels.lazy_packages import enter

__all__ = ["BareFilter", "KalmanFilter"]


def _log_density(*arguments: Any, **named: Any) -> float:  # noqa: ANN401 - filterpy's
    """`filterpy.stats.logpdf`, which a filter asks for its likelihood alone, loaded then."""
    density: float = import_module("filterpy.stats.stats").logpdf(*arguments, **named)
    return density


def _load() -> Any:  # noqa: ANN401 - a class that has no types
    if "filterpy" in sys.modules:
        return import_module("filterpy.kalman").KalmanFilter
    enter("filterpy")
    common, stats = enter("filterpy.common"), enter("filterpy.stats")
    enter("filterpy.kalman")
    helpers = import_module("filterpy.common.helpers")
    needed = {common: ("pretty_str", "reshape_z"), stats: ("logpdf",)}
    common.__dict__.update({name: getattr(helpers, name) for name in needed[common]})
    stats.__dict__["logpdf"] = _log_density
    found = import_module("filterpy.kalman.kalman_filter").KalmanFilter
    for package, names in needed.items():
        if "__getattr__" in package.__dict__:  # still not opened: what it was lent goes again
            for name in names:
                del package.__dict__[name]
    return found


KalmanFilter: Any = _load()
"""The class `filterpy.kalman.KalmanFilter`."""


class BareFilter(KalmanFilter):  # type: ignore[misc]
    """filterpy's filter without what nobody here asks it for: copies of every step, innovation and likelihood.

    A pilot calls it in every tick, and half of filterpy's time goes into those. What is left are filterpy's own
    operations on its own arrays in its own order, so the bits are those of its `predict` and `update`.
    """

    x: FloatArray
    P: FloatArray

    def predict(self, F: FloatArray, Q: FloatArray) -> None:
        """The state and its covariance one step on, without control and without fading memory."""
        self.x = F.dot(self.x)
        self.P = F.dot(self.P).dot(F.T) + Q

    def weigh(self) -> tuple[list[float], FloatArray]:
        """The gain K, row by row, and the covariance after it, as `update` works them out. Changes nothing.

        Neither depends on what is measured. The first two components of the state are: H picks them out, so
        products with it are read off. The 2 x 2 matrix is inverted here, as LAPACK costs half of filterpy's update.
        """
        P, R, inverse = self.P, self.R, self.SI
        s_xx, s_xy = P.item(0) + R.item(0), P.item(1) + R.item(1)
        s_yx, s_yy = P.item(4) + R.item(2), P.item(5) + R.item(3)
        scale = 1.0 / (s_xx * s_yy - s_xy * s_yx)
        inverse[0, 0], inverse[0, 1] = s_yy * scale, -s_xy * scale
        inverse[1, 0], inverse[1, 1] = -s_yx * scale, s_xx * scale
        K = P.dot(self.H.T).dot(inverse)
        I_KH = self._I - K.dot(self.H)
        return K.ravel().tolist(), I_KH.dot(P).dot(I_KH.T) + K.dot(R).dot(K.T)
