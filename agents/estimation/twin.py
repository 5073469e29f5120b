r"""The UAV's filter as compiled code, for many worlds at once: the one behaviour that stands twice.

Pilots filter with filterpy (`agents.estimation.estimator.RelativeEstimator`), whose update takes some 20 µs, more than
all else in a world's tick; batches filter with this file.

**How equal they are**: to the last bit, in every number and every count, where numpy's BLAS is OpenBLAS on a processor
with fused multiply-add, as on x86-64 with AVX2; tests hold them so, also with late, doubled and contradicting
detections. **Where they are not**: what is written here as `fma` and what is not follows that BLAS, which fuses the
products of matrices, each sum in the order of its terms, but not that of a matrix and a vector. With another BLAS, or
a kernel without fused operations, the two filters part in the last digits, and a closed loop that is flown in a batch
no longer has the bits of the same flight with pilots. Each alone stays the same bits on one machine.

F, Q and P are $M \otimes I_2$ with M 2 x 2: x and y are alike and independent, so four numbers are the covariance
of one axis and stand for both. P_pv and P_vp are kept apart, since their last bits may differ. Terms with a factor of
exactly 0 or 1 are left out.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np
from numba import types
from numba.core.typing.context import Context
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from agents.control.lookahead import Target
from agents.control.uav_tick import LOOK
from agents.estimation.motion_model import SURE, KalmanParameters, strayed_distance
from sim.kernels.compile import FloatArray, borrowing
from sim.kernels.records import RecordArray, record_type
from sim.models.vehicles import clip_norm


class Belief:
    """What is believed of the UGV; meaningless while nothing is known."""

    known: bool
    x: float
    y: float
    """Its position [m]."""
    v_x: float
    v_y: float
    """Its velocity [m/s]."""
    p_pp: float
    p_pv: float
    p_vp: float
    p_vv: float
    """The covariance of one axis [m², m²/s, m²/s, m²/s²]."""
    age: int
    """Ticks since the newest believed detection."""
    by_gate: int
    in_a_row: int
    """Detections refused by the gate, in all and in a row."""


class Past:
    """A tick that a late detection may be of."""

    own_x: float
    own_y: float
    """p_a then [m]."""
    seen: bool
    seen_x: float
    seen_y: float
    """Where the UGV was detected then [m]."""


class Counts:
    """Detections not used."""

    refused: int
    """In all, by the gate (as if all had come in order) or for the wrong time."""
    misdated: int
    """For the wrong time."""
    duplicates: int
    """Of a time that had the same one."""
    too_old: int
    """Later than the history reaches."""


class KalmanState(NamedTuple):
    """The filter of one UAV; its arrays change in place. From `kalman_state`."""

    belief: RecordArray
    """One row of `Belief`. Shape (1,)."""
    counts: RecordArray
    """One row of `Counts`. Shape (1,)."""
    past: RecordArray
    """`Past` of the last ticks, each in row tick % depth. Shape (depth,)."""
    before: RecordArray
    """Likewise the `Belief` before what was detected then was taken up."""


def kalman_state(depth: int) -> KalmanState:
    """A filter that believes nothing yet.

    Args:
        depth: Ticks that it can go back, and one: 1 where no detection comes late.

    Raises:
        ValueError: If the depth is not positive.
    """
    if depth < 1:
        raise ValueError(f"depth must be at least 1, not {depth}")
    rows = ((Belief, 1), (Counts, 1), (Past, depth), (Belief, depth))
    return KalmanState._make(np.zeros(length, dtype=record_type(row)) for row, length in rows)


@borrowing
def kalman_estimate(state: KalmanState) -> Target:
    """All that is believed of the UGV."""
    b = state.belief[0]
    return Target(b.known, b.x, b.y, b.v_x, b.v_y, b.p_pp, b.p_vv)


@borrowing
def kalman_step(
    parameters: KalmanParameters,
    state: KalmanState,
    tick: int,
    p_ax: float,
    p_ay: float,
    looks: FloatArray,
    count: int,
) -> None:
    """Move on to `tick` and take up what has arrived, as `RelativeEstimator.update`; called for every tick from 0 on.

    Args:
        parameters: Of the filter.
        state: Of the filter, changed in place.
        tick: Now, one more than at the last call.
        p_ax, p_ay: p_a now [m].
        looks: Detections, in the columns `LOOK`. Shape (rows, 3).
        count: How many rows have arrived since the last call, in this order.
    """
    belief, past = state.belief[0], state.past
    _coast(parameters, belief)
    place = tick % len(past)
    past[place].own_x, past[place].own_y, past[place].seen = p_ax, p_ay, False
    _remember(state, place)
    first = _arrange(state, tick, looks, count)
    if first <= tick:
        _run(parameters, state, first, tick)
    state.counts[0].refused = belief.by_gate + state.counts[0].misdated


@borrowing
def _arrange(state: KalmanState, tick: int, looks: FloatArray, count: int) -> int:
    """Put what has arrived into its ticks; the earliest at which something is new, or the tick after this one."""
    past, counts = state.past, state.counts[0]
    depth = len(past)
    first = tick + 1
    for k in range(count):
        taken = int(looks[k, LOOK.taken])
        if tick - taken >= depth:
            counts.too_old += 1
            continue
        if not 0 <= taken <= tick:
            counts.misdated += 1
            continue
        then = past[taken % depth]
        x, y = then.own_x - looks[k, LOOK.x], then.own_y - looks[k, LOOK.y]
        if not then.seen:
            then.seen, then.seen_x, then.seen_y = True, x, y
            first = min(first, taken)
        elif taken == tick or (then.seen_x == x and then.seen_y == y):
            counts.duplicates += 1
        else:
            counts.misdated += 1  # it was not taken then: another one was
    return first


@borrowing
def _run(parameters: KalmanParameters, state: KalmanState, first: int, tick: int) -> None:
    """Take up what was detected at `first`, and where that is past run again through all that was detected since."""
    past, place = state.past, first % len(state.past)
    if first < tick:
        state.belief[0] = state.before[place]
    belief = state.belief[0]
    _take(parameters, belief, past[place].seen_x, past[place].seen_y)
    for _ in range(first, tick):
        place = place + 1 if place + 1 < len(past) else 0
        _coast(parameters, belief)
        _remember(state, place)
        if past[place].seen:
            _take(parameters, belief, past[place].seen_x, past[place].seen_y)


@borrowing
def _remember(state: KalmanState, place: int) -> None:
    """Keep the belief before a tick's detection, where one may come late."""
    if len(state.before) > 1:
        state.before[place] = state.belief[0]


@borrowing
def _coast(parameters: KalmanParameters, b: Belief) -> None:
    """Grow older by one tick without a detection."""
    if not b.known:
        return
    b.age += 1
    if not parameters.enabled:
        return
    c = parameters
    b.x += c.dt * b.v_x
    b.y += c.dt * b.v_y
    pp, pv, vp, vv = _predicted(c, b)
    if c.speed < math.inf:
        strayed = strayed_distance(elapsed=b.age * c.dt, speed=c.speed, acceleration=c.acceleration)
        most = math.sqrt(b.p_pp) + c.speed * c.dt
        pp, pv, vp, vv = _bounded(SURE * strayed, most, c.speed, pp, pv, vp, vv)
    b.p_pp, b.p_pv, b.p_vp, b.p_vv = pp, pv, vp, vv


def _fma(
    _context: Context, _a: types.Type, _b: types.Type, _c: types.Type
) -> tuple[Signature, Callable[..., object]]:
    """LLVM's own instruction for a · b + c, rounded once; numba has no function for it."""
    signature = types.float64(types.float64, types.float64, types.float64)
    return signature, lambda _context, builder, _signature, arguments: builder.fma(*arguments)


fma = cast("Callable[[float, float, float], float]", intrinsic(_fma))


@borrowing
def _predicted(c: KalmanParameters, b: Belief) -> tuple[float, float, float, float]:
    r"""The covariance of one axis a tick later: $F P F^T + Q$."""
    dt, vp, vv = c.dt, b.p_vp, b.p_vv
    a_pp, a_pv = fma(dt, vp, b.p_pp), fma(dt, vv, b.p_pv)
    return fma(a_pv, dt, a_pp) + c.q_pp, a_pv + c.q_pv, fma(vv, dt, vp) + c.q_pv, vv + c.q_vv


@borrowing
def _bounded(
    least: float, most: float, speed: float, pp: float, pv: float, vp: float, vv: float
) -> tuple[float, float, float, float]:
    """The covariance of one axis with its standard deviations in bounds.

    The position's [m], and the velocity's up to v_g,max.
    """
    position, velocity = math.sqrt(pp), math.sqrt(vv)
    if least <= position <= most and not velocity > speed:
        return pp, pv, vp, vv
    p, v = min(max(least, position), most) / position, min(1.0, speed / velocity)
    return pp * (p * p), pv * (p * v), vp * (v * p), vv * (v * v)


@borrowing
def _weighed(variance: float, b: Belief) -> tuple[float, float, float, float, float, float]:
    r"""Gain of one axis, and its covariance after a detection, $(I - KH) P (I - KH)^T + K R K^T$."""
    pp, pv, vp, vv = b.p_pp, b.p_pv, b.p_vp, b.p_vv
    s = pp + variance
    inverse = s * (1.0 / (s * s))
    k_p, k_v = pp * inverse, vp * inverse
    m_p, m_v = 1.0 - k_p, 0.0 - k_v
    a_pp, a_pv = m_p * pp, m_p * pv
    a_vp, a_vv = m_v * pp + vp, m_v * pv + vv
    kr_p, kr_v = k_p * variance, k_v * variance
    return (
        k_p,
        k_v,
        a_pp * m_p + kr_p * k_p,
        a_pp * m_v + a_pv + kr_p * k_v,
        a_vp * m_p + kr_v * k_p,
        a_vp * m_v + a_vv + kr_v * k_v,
    )


@borrowing
def _take(parameters: KalmanParameters, b: Belief, x: float, y: float) -> None:
    """Believe or refuse a detection of the UGV at (x, y) [m]."""
    if not parameters.enabled or not b.known:
        _start(parameters, b, x, y)
        return
    nu_x, nu_y = x - b.x, y - b.y
    s = b.p_pp + parameters.variance
    if (s * nu_x * nu_x + s * nu_y * nu_y) / (s * s) <= parameters.gate:
        _correct(parameters, b, nu_x, nu_y)
        return
    b.by_gate += 1
    b.in_a_row += 1
    if b.in_a_row >= parameters.patience:
        _start(parameters, b, x, y)


@borrowing
def _start(parameters: KalmanParameters, b: Belief, x: float, y: float) -> None:
    """Know nothing but one detection at (x, y) [m]."""
    b.known = True
    b.x, b.y, b.v_x, b.v_y = x, y, 0.0, 0.0
    b.p_pp, b.p_pv, b.p_vp, b.p_vv = parameters.variance, 0.0, 0.0, parameters.first_variance
    b.age = b.in_a_row = 0


@borrowing
def _correct(parameters: KalmanParameters, b: Belief, nu_x: float, nu_y: float) -> None:
    """Believe a detection that is (nu_x, nu_y) [m] from where the UGV was thought to be."""
    k_p, k_v, pp, pv, vp, vv = _weighed(parameters.variance, b)
    b.x += k_p * nu_x
    b.y += k_p * nu_y
    b.v_x, b.v_y = clip_norm(x=b.v_x + k_v * nu_x, y=b.v_y + k_v * nu_y, limit=parameters.speed)
    b.p_pp, b.p_pv, b.p_vp, b.p_vv = pp, pv, vp, vv
    b.age = b.in_a_row = 0
