"""filterpy's Kalman filter, without the rest of filterpy until somebody asks for it.

Its packages import every filter when they are opened, and for them `scipy.stats` and `scipy.linalg`: more processor
time than all else that a pilot loads. The filter needs neither, so the packages are entered without being opened.
"""

from typing import Any

import numpy as np

from sim.kernels.compile import FloatArray

__all__ = ["AxisFilter", "KalmanFilter"]

import struct

_write_matrix = struct.Struct("4d").pack_into


from filterpy.kalman import KalmanFilter as KF

KalmanFilter: Any = KF


class AxisFilter(KalmanFilter):  # type: ignore[misc]
    """filterpy's filter of one axis, for its products of matrices: position and velocity, of which H picks the first.

    A pilot asks for them in every tick, and half of filterpy's time goes into what nobody here needs: copies of every
    step, innovation and likelihood. What is left are filterpy's own operations in their order, so the bits are those of
    its `predict` and `update`. The state itself is kept elsewhere: no product here depends on it.

    Args:
        variance: R: of a detection [m²].
        P, P_prior, P_post: The covariance of the axis, the predicted one, and the one after a detection. Shape (2, 2).
        K: The gain. Shape (2, 1). But for `P` they are written into, in place.
    """

    def __init__(
        self,
        *,
        variance: float,
        P: FloatArray,
        P_prior: FloatArray,
        P_post: FloatArray,
        K: FloatArray,
    ) -> None:
        super().__init__(dim_x=2, dim_z=1)
        self.P, self.P_prior, self.P_post, self.K = P, P_prior, P_post, K
        self.R, self._variance = np.array([[variance]]), variance
        self._I_KH = np.eye(2)
        self._I_KH_T = self._I_KH.T
        self._half, self._whole, self._KRK = np.empty((3, 2, 2))  # of products on the way

    def predict(self, F: FloatArray, Q: FloatArray) -> None:
        """`P_prior` from `P`: the covariance one step on, without control and without fading memory."""
        np.add(F.dot(self.P, self._half).dot(F.T, self._whole), Q, self.P_prior)

    def weigh(self, P: FloatArray) -> None:
        """`K` and `P_post` from this covariance, as `update` works them out: neither depends on what is measured.

        H picks the position out, so products with it are read off, and those with a column by a row are four numbers.
        1 / S is rounded as in the inverse of the 2 x 2 matrix S of both axes.
        """
        p_pp, R = P.item(0), self._variance
        S = p_pp + R
        inverse = S * (1.0 / (S * S))
        k_p, k_v = p_pp * inverse, P.item(2) * inverse
        K, I_KH, kr_p, kr_v = self.K, self._I_KH, k_p * R, k_v * R
        K[0, 0], K[1, 0], I_KH[0, 0], I_KH[1, 0] = k_p, k_v, 1.0 - k_p, 0.0 - k_v
        _write_matrix(self._KRK, 0, kr_p * k_p, kr_p * k_v, kr_v * k_p, kr_v * k_v)
        left = I_KH.dot(P, self._half).dot(self._I_KH_T, self._whole)
        np.add(left, self._KRK, self.P_post)
