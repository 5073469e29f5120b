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
from agents.control.uav_tick import LOOK_X, LOOK_Y, TAKEN
from agents.estimation.estimator import RelativeEstimator
from agents.estimation.motion_model import (
    acceleration_deviation,
    motion,
    strayed_distance,
    supposed_acceleration,
)
from bus.messages import Detector, Estimator, Limits
from sim.kernels.compile import FloatArray, borrowing
from sim.models.vehicles import clip_norm

_SURE = 1.0 / math.sqrt(
    8.0
)  # as the pilot's: least deviation of the position per metre that the UGV may have strayed

KNOWN, X, Y, V_X, V_Y, P_PP, P_PV, P_VP, P_VV, AGE, _BY_GATE, _IN_A_ROW = range(12)
"""Of `KalmanState.numbers`, what is believed: whether anything is (1.0), the UGV's position [m] and velocity [m/s], the
covariance of one axis [m², m²/s, m²/s²], and the ticks since the newest believed detection; then refusals by the
gate, in all and in a row. Meaningless while nothing is known."""

_BELIEF = 12  # numbers that a late detection takes back

REFUSED, MISDATED, DUPLICATES, TOO_OLD = range(_BELIEF, _BELIEF + 4)
"""Of `KalmanState.numbers`, detections not used.

Refused in all, by the gate (as if all had come in order) or for the wrong
time; those of the wrong time; those of a time that had the same one; those that came later than the history reaches."""

NUMBERS = _BELIEF + 4
"""The length of a filter's state."""

_OWN_X, _OWN_Y, _SEEN, _SEEN_X, _SEEN_Y, _BEFORE = range(
    6
)  # columns of the history; the belief from _BEFORE on

COLUMNS = _BEFORE + _BELIEF
"""The number of values that a filter keeps of each tick."""


class KalmanParameters(NamedTuple):
    """The numbers of one UAV's filter; from `kalman_parameters`."""

    dt: float
    """Length of a tick [s]."""
    variance: float
    """R: of a detection, per axis [m²]."""
    first_variance: float
    """Of the first velocity, per axis [m²/s²]."""
    q_pp: float
    """Q of one tick: position [m²]."""
    q_pv: float
    """Position and velocity [m²/s]."""
    q_vv: float
    """Velocity [m²/s²]."""
    speed: float
    """Largest speed of the UGV, v_g,max [m/s]; infinite where it is not known."""
    acceleration: float
    """The supposed acceleration of the UGV [m/s²]."""
    gate: float
    """Largest normalized innovation squared that is believed."""
    patience: int
    """Detections refused in a row after which the filter starts anew."""
    enabled: bool
    """False: the newest detection is taken as it is and held."""


class KalmanState(NamedTuple):
    """The filter of one UAV; its arrays change in place. From `kalman_state`."""

    numbers: FloatArray
    """Its belief and its counters, see the named places. Shape (NUMBERS,)."""
    history: FloatArray
    """The last ticks, each in row tick % depth: p_a, what was detected then, the belief before it.

    Shape (depth, COLUMNS).
    """


def kalman_parameters(
    *, detector: Detector, target: Limits, dt: float, settings: Estimator
) -> KalmanParameters:
    """The numbers of the filter, from what the pilot's is made of.

    Args:
        detector: The UAV's detector.
        target: The UGV's bounds.
        dt: Length of a tick [s].
        settings: Gate, patience, manoeuvre, and whether to filter at all.

    Raises:
        ValueError: If dt is not positive and finite.
    """
    first = RelativeEstimator(detector=detector, target=target, dt=dt, settings=settings).covariance
    deviation = acceleration_deviation(target=target, manoeuvre=settings.manoeuvre, dt=dt)
    _, Q = motion(ticks=1, dt=dt, deviation=deviation)
    return KalmanParameters(
        dt=float(dt),
        variance=first.item(0, 0),
        first_variance=first.item(2, 2),
        q_pp=Q.item(0, 0),
        q_pv=Q.item(0, 2),
        q_vv=Q.item(2, 2),
        speed=math.inf if target.max_speed is None else float(target.max_speed),
        acceleration=float(
            supposed_acceleration(target=target, manoeuvre=settings.manoeuvre, dt=dt)
        ),
        gate=float(settings.gate),
        patience=settings.patience,
        enabled=settings.enabled,
    )


def kalman_state(depth: int) -> KalmanState:
    """A filter that believes nothing yet.

    Args:
        depth: Ticks that it can go back, and one: 1 where no detection comes late.

    Raises:
        ValueError: If the depth is not positive.
    """
    if depth < 1:
        raise ValueError(f"depth must be at least 1, not {depth}")
    return KalmanState(numbers=np.zeros(NUMBERS), history=np.zeros((depth, COLUMNS)))


@borrowing
def kalman_estimate(state: KalmanState) -> Target:
    """All that is believed of the UGV."""
    n = state.numbers
    return Target(n[KNOWN] != 0.0, n[X], n[Y], n[V_X], n[V_Y], n[P_PP], n[P_VV])


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
        looks: Detections, see the named columns. Shape (rows, 3).
        count: How many rows have arrived since the last call, in this order.
    """
    numbers, history = state.numbers, state.history
    _coast(parameters=parameters, numbers=numbers)
    place = tick % len(history)
    history[place, _OWN_X], history[place, _OWN_Y], history[place, _SEEN] = p_ax, p_ay, 0.0
    _remember(numbers=numbers, history=history, place=place)
    first = _arrange(numbers=numbers, history=history, tick=tick, looks=looks, count=count)
    if first <= tick:
        _run(parameters=parameters, numbers=numbers, history=history, first=first, tick=tick)
    numbers[REFUSED] = numbers[_BY_GATE] + numbers[MISDATED]


@borrowing
def _arrange(
    numbers: FloatArray, history: FloatArray, tick: int, looks: FloatArray, count: int
) -> int:
    """Put what has arrived into its ticks; the earliest at which something is new, or the tick after this one."""
    depth = len(history)
    first = tick + 1
    for k in range(count):
        taken = int(looks[k, TAKEN])
        if tick - taken >= depth:
            numbers[TOO_OLD] += 1.0
            continue
        if not 0 <= taken <= tick:
            numbers[MISDATED] += 1.0
            continue
        place = taken % depth
        x, y = (
            history[place, _OWN_X] - looks[k, LOOK_X],
            history[place, _OWN_Y] - looks[k, LOOK_Y],
        )
        if history[place, _SEEN] == 0.0:
            history[place, _SEEN], history[place, _SEEN_X], history[place, _SEEN_Y] = 1.0, x, y
            first = min(first, taken)
        elif taken == tick or (history[place, _SEEN_X] == x and history[place, _SEEN_Y] == y):
            numbers[DUPLICATES] += 1.0
        else:
            numbers[MISDATED] += 1.0  # it was not taken then: another one was
    return first


@borrowing
def _run(
    parameters: KalmanParameters, numbers: FloatArray, history: FloatArray, first: int, tick: int
) -> None:
    """Take up what was detected at `first`, and where that is past run again through all that was detected since."""
    place = first % len(history)
    if first < tick:
        for k in range(_BELIEF):
            numbers[k] = history[place, _BEFORE + k]
    _take(
        parameters=parameters, numbers=numbers, x=history[place, _SEEN_X], y=history[place, _SEEN_Y]
    )
    for _ in range(first, tick):
        place = place + 1 if place + 1 < len(history) else 0
        _coast(parameters=parameters, numbers=numbers)
        _remember(numbers=numbers, history=history, place=place)
        if history[place, _SEEN] != 0.0:
            _take(
                parameters=parameters,
                numbers=numbers,
                x=history[place, _SEEN_X],
                y=history[place, _SEEN_Y],
            )


@borrowing
def _remember(numbers: FloatArray, history: FloatArray, place: int) -> None:
    """Keep the belief before a tick's detection, where one may come late."""
    if len(history) > 1:
        for k in range(_BELIEF):
            history[place, _BEFORE + k] = numbers[k]


@borrowing
def _coast(parameters: KalmanParameters, numbers: FloatArray) -> None:
    """Grow older by one tick without a detection."""
    if numbers[KNOWN] == 0.0:
        return
    numbers[AGE] += 1.0
    if not parameters.enabled:
        return
    c = parameters
    numbers[X] += c.dt * numbers[V_X]
    numbers[Y] += c.dt * numbers[V_Y]
    before = numbers[P_PP]
    pp, pv, vp, vv = _predicted(
        dt=c.dt,
        q_pp=c.q_pp,
        q_pv=c.q_pv,
        q_vv=c.q_vv,
        pp=before,
        pv=numbers[P_PV],
        vp=numbers[P_VP],
        vv=numbers[P_VV],
    )
    if c.speed < math.inf:
        strayed = strayed_distance(
            elapsed=numbers[AGE] * c.dt, speed=c.speed, acceleration=c.acceleration
        )
        most = math.sqrt(before) + c.speed * c.dt
        pp, pv, vp, vv = _bounded(
            least=_SURE * strayed, most=most, speed=c.speed, pp=pp, pv=pv, vp=vp, vv=vv
        )
    numbers[P_PP], numbers[P_PV], numbers[P_VP], numbers[P_VV] = pp, pv, vp, vv


def _fma(
    _context: Context, _a: types.Type, _b: types.Type, _c: types.Type
) -> tuple[Signature, Callable[..., object]]:
    """LLVM's own instruction for a · b + c, rounded once; numba has no function for it."""
    signature = types.float64(types.float64, types.float64, types.float64)
    return signature, lambda _context, builder, _signature, arguments: builder.fma(*arguments)


fma = cast("Callable[[float, float, float], float]", intrinsic(_fma))


@borrowing
def _predicted(
    dt: float, q_pp: float, q_pv: float, q_vv: float, pp: float, pv: float, vp: float, vv: float
) -> tuple[float, float, float, float]:
    r"""The covariance of one axis a tick later: $F P F^T + Q$."""
    a_pp, a_pv = fma(dt, vp, pp), fma(dt, vv, pv)
    return fma(a_pv, dt, a_pp) + q_pp, a_pv + q_pv, fma(vv, dt, vp) + q_pv, vv + q_vv


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
def _weighed(
    variance: float, pp: float, pv: float, vp: float, vv: float
) -> tuple[float, float, float, float, float, float]:
    r"""Gain of one axis, and its covariance after a detection, $(I - KH) P (I - KH)^T + K R K^T$."""
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
def _take(parameters: KalmanParameters, numbers: FloatArray, x: float, y: float) -> None:
    """Believe or refuse a detection of the UGV at (x, y) [m]."""
    if not parameters.enabled or numbers[KNOWN] == 0.0:
        _start(parameters=parameters, numbers=numbers, x=x, y=y)
        return
    nu_x, nu_y = x - numbers[X], y - numbers[Y]
    s = numbers[P_PP] + parameters.variance
    if (s * nu_x * nu_x + s * nu_y * nu_y) / (s * s) <= parameters.gate:
        _correct(parameters=parameters, numbers=numbers, nu_x=nu_x, nu_y=nu_y)
        return
    numbers[_BY_GATE] += 1.0
    numbers[_IN_A_ROW] += 1.0
    if numbers[_IN_A_ROW] >= parameters.patience:
        _start(parameters=parameters, numbers=numbers, x=x, y=y)


@borrowing
def _start(parameters: KalmanParameters, numbers: FloatArray, x: float, y: float) -> None:
    """Know nothing but one detection at (x, y) [m]."""
    numbers[KNOWN] = 1.0
    numbers[X], numbers[Y], numbers[V_X], numbers[V_Y] = x, y, 0.0, 0.0
    numbers[P_PP], numbers[P_PV], numbers[P_VP], numbers[P_VV] = (
        parameters.variance,
        0.0,
        0.0,
        parameters.first_variance,
    )
    numbers[AGE] = numbers[_IN_A_ROW] = 0.0


@borrowing
def _correct(parameters: KalmanParameters, numbers: FloatArray, nu_x: float, nu_y: float) -> None:
    """Believe a detection that is (nu_x, nu_y) [m] from where the UGV was thought to be."""
    k_p, k_v, pp, pv, vp, vv = _weighed(
        variance=parameters.variance,
        pp=numbers[P_PP],
        pv=numbers[P_PV],
        vp=numbers[P_VP],
        vv=numbers[P_VV],
    )
    numbers[X] += k_p * nu_x
    numbers[Y] += k_p * nu_y
    numbers[V_X], numbers[V_Y] = clip_norm(
        x=numbers[V_X] + k_v * nu_x, y=numbers[V_Y] + k_v * nu_y, limit=parameters.speed
    )
    numbers[P_PP], numbers[P_PV], numbers[P_VP], numbers[P_VV] = pp, pv, vp, vv
    numbers[AGE] = numbers[_IN_A_ROW] = 0.0
