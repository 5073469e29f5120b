r"""The UAV's filter but for its products of matrices, compiled: pilots and batches step it alike.

The state is $(x, y, v_x, v_y)$ of the UGV in the world frame, moving at constant velocity but for random accelerations.
F, Q, R and P are $M \otimes I_2$ with M 2 x 2: x and y are alike and independent, so four numbers are the covariance
of one axis and stand for both. P_pv and P_vp are kept apart, since their last bits may differ.

The UAV knows its own position exactly, so a detection $\tilde p_\Delta$ of $p_\Delta = p_a - p_g$ measures the UGV's
position: $z = p_a - \tilde p_\Delta$. One may come late and out of order. It counts at its own time: the filter goes
back to what it believed before then, takes it up, and runs again through all that was detected since. So what it
believes depends on which detections have arrived, not on when: the same bits as if all had come in order.

In a tick: `kalman_begin` with what has arrived, then `kalman_go_on` until it is `DONE`. Where it needs the covariance
predicted, or the gain and the covariance after a detection, it says so, and whoever steps it writes them into `Step`:
pilots have them from filterpy (`agents.estimation.estimator`), batches from compiled code
(`agents.estimation.twin`).
"""

import math
from typing import NamedTuple

import numpy as np

from agents.control.lookahead import Target
from agents.control.uav_tick import LOOK
from agents.estimation.motion_model import SURE, KalmanParameters, strayed_distance
from bus.ticks import NO_TICK
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, record_type
from sim.models.vehicles import clip_norm

DONE, PREDICT, WEIGH = range(3)
"""The needs of a step: nothing; the covariance `Step.ticks` later; the gain, and the covariance after it."""

NEVER = -1
"""In place of a tick: none."""


class Belief:
    """The belief about the UGV; meaningless while nothing is known."""

    known: bool
    x: float
    y: float
    """Its position [m]."""
    v_x: float
    v_y: float
    """Its velocity [m/s], never longer than v_g,max."""
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

    tick: int
    """Its number; `NEVER`: the row is empty."""
    own_x: float
    own_y: float
    """p_a then [m]."""
    seen: bool
    seen_x: float
    seen_y: float
    """Place at which the UGV was detected then [m]."""


class Counts:
    """Detections not used but for those that the gate has refused."""

    misdated: int
    """For the wrong time."""
    duplicates: int
    """Of a time that had the same one."""
    too_old: int
    """Later than the history reaches."""


class Step:
    """The progress of a step, and the products of matrices that it goes on with, of one axis."""

    tick: int
    """The tick that the filter is called for; `NEVER` before the first."""
    before: int
    """The one that it was called for before."""
    at: int
    """The tick of the belief."""
    detected: bool
    """True if it has yet to take up what was detected then."""
    innovation: float
    """Normalized innovation squared (NIS) of the newest detection that met the gate; NaN before."""
    ticks: int
    """So many are predicted over."""
    predicted: bool
    """True if the covariance of the belief so many ticks later is there."""
    weighed: bool
    """True if the gain for a detection is there: at the tick that is predicted, or if none is at that of the belief."""
    prior_pp: float
    prior_pv: float
    prior_vp: float
    prior_vv: float
    """The predicted covariance, before its bounds."""
    k_p: float
    k_v: float
    """The gain."""
    post_pp: float
    post_pv: float
    post_vp: float
    post_vv: float
    """The covariance after a detection."""


class KalmanState(NamedTuple):
    """The filter of one UAV; its arrays change in place. From `kalman_state`."""

    belief: RecordArray
    """One row of `Belief`. Shape (1,)."""
    counts: RecordArray
    """One row of `Counts`. Shape (1,)."""
    step: RecordArray
    """One row of `Step`. Shape (1,)."""
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
    rows = ((Belief, 1), (Counts, 1), (Step, 1), (Past, depth), (Belief, depth))
    state = KalmanState._make(np.zeros(length, dtype=record_type(row)) for row, length in rows)
    state.past["tick"] = NEVER
    for name in ("tick", "before", "at"):
        state.step[name] = NEVER
    state.step["innovation"] = math.nan
    return state


@compiled
def kalman_estimate(state: KalmanState) -> Target:
    """All that is believed of the UGV."""
    belief = state.belief[0]
    return Target(
        belief.known, belief.x, belief.y, belief.v_x, belief.v_y, belief.p_pp, belief.p_vv
    )


@compiled
def kalman_refused(state: KalmanState) -> int:
    """Detections refused, by the gate (as if all had come in order) or for the wrong time."""
    return int(state.belief[0].by_gate + state.counts[0].misdated)


@compiled
def kalman_begin(
    state: KalmanState, tick: int, p_ax: float, p_ay: float, looks: FloatArray, count: int
) -> None:
    """Put what has arrived into its ticks, and go back to the earliest at which something is new.

    Of several detections of one tick only the first is used, also over several calls. What cannot be placed counts as
    refused: a detection of the future, or of a tick for which the filter was not called, so that p_a is not known, or
    whose time is that of no tick, or one that comes late and contradicts that of its tick.

    Args:
        state: Of the filter, changed in place.
        tick: Now, the same as in the last call or later.
        p_ax, p_ay: p_a now [m].
        looks: Detections, in the columns `LOOK`. Shape (rows, 3).
        count: How many rows have arrived since the last call, in this order.
    """
    step, past = state.step[0], state.past
    now = past[tick % len(past)]
    if step.tick != tick:
        step.before, step.tick = step.tick, tick
        now.tick, now.seen = tick, False
    now.own_x, now.own_y = p_ax, p_ay
    first = _arrange(state, tick, looks, count)
    if first < tick:
        state.belief[0] = state.before[first % len(past)]
        step.at, step.predicted, step.weighed = first, False, False
    step.detected = first == step.at


@compiled
def _arrange(state: KalmanState, tick: int, looks: FloatArray, count: int) -> int:
    """Put what has arrived into its ticks; the earliest at which something is new, or the tick after this one."""
    past, counts = state.past, state.counts[0]
    depth = len(past)
    first = tick + 1
    for k in range(count):
        taken = int(looks[k, LOOK.taken])
        if taken != NO_TICK and tick - taken >= depth:
            counts.too_old += 1
            continue
        then = past[taken % depth]
        if taken < 0 or then.tick != taken:
            counts.misdated += 1
            continue
        x, y = then.own_x - looks[k, LOOK.x], then.own_y - looks[k, LOOK.y]
        if not then.seen:
            then.seen, then.seen_x, then.seen_y = True, x, y
            first = min(first, taken)
        elif taken == tick or (then.seen_x == x and then.seen_y == y):
            counts.duplicates += 1
        else:
            counts.misdated += 1  # it was not taken then: another one was
    return first


@compiled
def kalman_go_on(parameters: KalmanParameters, state: KalmanState) -> int:
    """Go on to the tick that the filter was called for, as far as the products that there are reach.

    Returns:
        `DONE`, or what has to be in `state.step` before the next call.
    """
    step, past, belief = state.step[0], state.past, state.belief[0]
    while True:
        if step.detected:
            seen = past[step.at % len(past)]
            if not _take(parameters, state, seen.seen_x, seen.seen_y):
                return WEIGH
            step.detected = False
        if step.at == step.tick:
            return DONE
        tick = step.tick
        if step.at < step.before:  # it runs again through what is past
            tick = step.at + 1
            while past[tick % len(past)].tick != tick:
                tick += 1
        ticks = tick - step.at
        if belief.known and parameters.enabled:
            if not step.predicted or step.ticks != ticks:
                step.ticks, step.predicted, step.weighed = ticks, False, False
                return PREDICT
            _predict(parameters, belief, step)
        belief.age += ticks
        step.at, step.predicted = tick, False
        if len(state.before) > 1:
            state.before[tick % len(past)] = belief
        step.detected = past[tick % len(past)].seen


@compiled
def _set_covariance(belief: Belief, pp: float, pv: float, vp: float, vv: float) -> None:
    belief.p_pp, belief.p_pv, belief.p_vp, belief.p_vv = pp, pv, vp, vv


@compiled
def _predict(parameters: KalmanParameters, belief: Belief, step: Step) -> None:
    """Take on what is predicted, with the standard deviations of an axis in bounds.

    The position's [m] never grows faster than at v_g,max, and is at least what the UGV may have strayed; the velocity's
    is at most v_g,max.
    """
    belief.x += step.ticks * parameters.dt * belief.v_x
    belief.y += step.ticks * parameters.dt * belief.v_y
    most = math.sqrt(belief.p_pp) + parameters.speed * step.ticks * parameters.dt
    _set_covariance(belief, step.prior_pp, step.prior_pv, step.prior_vp, step.prior_vv)
    if not parameters.speed < math.inf:
        return
    elapsed = (belief.age + step.ticks) * parameters.dt
    least = SURE * strayed_distance(
        elapsed=elapsed, speed=parameters.speed, acceleration=parameters.acceleration
    )
    position, velocity = math.sqrt(belief.p_pp), math.sqrt(belief.p_vv)
    if least <= position <= most and not velocity > parameters.speed:
        return
    p, v = min(max(least, position), most) / position, min(1.0, parameters.speed / velocity)
    pp, pv, vp, vv = belief.p_pp, belief.p_pv, belief.p_vp, belief.p_vv
    _set_covariance(belief, pp * (p * p), pv * (p * v), vp * (v * p), vv * (v * v))
    step.weighed = False  # it was for another covariance


@compiled
def _take(parameters: KalmanParameters, state: KalmanState, x: float, y: float) -> bool:
    r"""Believe or refuse a detection of the UGV at (x, y) [m].

    It is believed if $\nu^T S^{-1} \nu$ is within the gate, $\nu = z - H\hat x$, $S = H P H^T + R$.

    Returns:
        False if that needs the gain, which is not there; then the belief has not changed.
    """
    belief, step = state.belief[0], state.step[0]
    if not parameters.enabled or not belief.known:
        _start(parameters, belief, step, x, y)
        return True
    nu_x, nu_y = x - belief.x, y - belief.y
    s = belief.p_pp + parameters.variance
    squared = (s * nu_x * nu_x + s * nu_y * nu_y) / (s * s)
    if squared <= parameters.gate:
        # a gain that was worked ahead is for the tick that is predicted
        if step.predicted or not step.weighed:
            step.predicted = step.weighed = False
            return False
        _correct(parameters, belief, step, nu_x, nu_y)
    else:
        belief.by_gate += 1
        belief.in_a_row += 1
        if belief.in_a_row >= parameters.patience:
            _start(parameters, belief, step, x, y)
    step.innovation = squared
    return True


@compiled
def _start(parameters: KalmanParameters, belief: Belief, step: Step, x: float, y: float) -> None:
    """Know nothing but one detection at (x, y) [m]."""
    belief.known = True
    belief.x, belief.y, belief.v_x, belief.v_y = x, y, 0.0, 0.0
    _set_covariance(belief, parameters.variance, 0.0, 0.0, parameters.first_variance)
    belief.age = belief.in_a_row = 0
    step.predicted = step.weighed = False


@compiled
def _correct(
    parameters: KalmanParameters, belief: Belief, step: Step, nu_x: float, nu_y: float
) -> None:
    """Believe a detection that is (nu_x, nu_y) [m] from where the UGV was thought to be."""
    belief.x += step.k_p * nu_x
    belief.y += step.k_p * nu_y
    belief.v_x, belief.v_y = clip_norm(
        x=belief.v_x + step.k_v * nu_x, y=belief.v_y + step.k_v * nu_y, limit=parameters.speed
    )
    _set_covariance(belief, step.post_pp, step.post_pv, step.post_vp, step.post_vv)
    belief.age = belief.in_a_row = 0
    step.predicted = step.weighed = False
