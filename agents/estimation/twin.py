r"""The filter's products of matrices as compiled code, for many worlds at once: the one behaviour that stands twice.

Pilots have them from filterpy (`agents.estimation.kalman`), which takes some microseconds, as much as all else in a
world's tick; batches have them from this file. All else of the filter is one (`agents.estimation.filtering`).

**How equal they are**: to the last bit, where numpy's BLAS is OpenBLAS on a processor with fused multiply-add, as on
x86-64 with AVX2; tests hold them so, also with late, doubled and contradicting detections. **Where they are not**: what
is written here as `fma` and what is not follows that BLAS, which fuses the products of matrices, each sum in the order
of its terms. With another BLAS, or a kernel without fused operations, the two part in the last digits, and a closed
loop that is flown in a batch no longer has the bits of the same flight with pilots. Each alone stays the same bits on
one machine.

Terms with a factor of exactly 0 or 1 are left out.
"""

from collections.abc import Callable
from typing import cast

from numba import types
from numba.core.typing.context import Context
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from agents.estimation.filtering import (
    DONE,
    PREDICT,
    Belief,
    KalmanState,
    Step,
    kalman_begin,
    kalman_go_on,
)
from agents.estimation.motion_model import KalmanParameters
from sim.kernels.compile import FloatArray, compiled


@compiled
def kalman_step(
    parameters: KalmanParameters,
    state: KalmanState,
    tick: int,
    p_ax: float,
    p_ay: float,
    looks: FloatArray,
    count: int,
) -> None:
    """Move on to `tick` and take up what has arrived; called for every tick from 0 on.

    Args:
        parameters: Of the filter.
        state, tick, p_ax, p_ay, looks, count: As in `kalman_begin`.
    """
    kalman_begin(state, tick, p_ax, p_ay, looks, count)
    needs = kalman_go_on(parameters, state)
    while needs != DONE:
        if needs == PREDICT:
            _predict(parameters, state.belief[0], state.step[0])
        else:
            _weigh(parameters.variance, state.belief[0], state.step[0])
        needs = kalman_go_on(parameters, state)


def _fma(
    _context: Context, _a: types.Type, _b: types.Type, _c: types.Type
) -> tuple[Signature, Callable[..., object]]:
    """LLVM's own instruction for a · b + c, rounded once; numba has no function for it."""
    signature = types.float64(types.float64, types.float64, types.float64)
    return signature, lambda _context, builder, _signature, arguments: builder.fma(*arguments)


fma = cast("Callable[[float, float, float], float]", intrinsic(_fma))


@compiled
def _predict(parameters: KalmanParameters, belief: Belief, step: Step) -> None:
    r"""The covariance of one axis a tick later: $F P F^T + Q$."""
    dt, vp, vv = parameters.dt, belief.p_vp, belief.p_vv
    a_pp, a_pv = fma(dt, vp, belief.p_pp), fma(dt, vv, belief.p_pv)
    step.prior_pp, step.prior_pv = fma(a_pv, dt, a_pp) + parameters.q_pp, a_pv + parameters.q_pv
    step.prior_vp, step.prior_vv = fma(vv, dt, vp) + parameters.q_pv, vv + parameters.q_vv
    step.predicted = True


@compiled
def _weigh(variance: float, belief: Belief, step: Step) -> None:
    r"""Gain of one axis, and its covariance after a detection, $(I - KH) P (I - KH)^T + K R K^T$."""
    pp, pv, vp, vv = belief.p_pp, belief.p_pv, belief.p_vp, belief.p_vv
    s = pp + variance
    inverse = s * (1.0 / (s * s))
    k_p, k_v = pp * inverse, vp * inverse
    m_p, m_v = 1.0 - k_p, 0.0 - k_v
    a_pp, a_pv = m_p * pp, m_p * pv
    a_vp, a_vv = m_v * pp + vp, m_v * pv + vv
    kr_p, kr_v = k_p * variance, k_v * variance
    step.k_p, step.k_v = k_p, k_v
    step.post_pp = a_pp * m_p + kr_p * k_p
    step.post_pv = a_pp * m_v + a_pv + kr_p * k_v
    step.post_vp = a_vp * m_p + kr_v * k_p
    step.post_vv = a_vp * m_v + a_vv + kr_v * k_v
    step.weighed = True
