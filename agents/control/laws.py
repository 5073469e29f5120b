"""The laws a UAV can fly, put together from the equations: one compiled function for all of them.

It chooses by the code of a law's row in `bus.registry`, as compiled functions that are handed over would not be kept
in the cache: a new law is a branch in `weights`, in `uav_control` where it is more than a weighting, or in
`agents.control.uav_tick.uav_tick` where it needs more of the UGV than a place.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple, TypeVar

import numpy as np

from agents.control.coverage import (
    border_distance,
    coverage_control,
    is_zero_gradient,
    keep_off_border,
    single_integrator_command,
    symmetry_breaker,
    velocity_error,
)
from agents.control.orbit import circle, orbit_control
from agents.control.tracking import tracking_output, tracking_step
from agents.control.visibility import bounds_of, switching_radius
from agents.control.weighting import combine, linear_weights, logarithmic_weights, switching_weights
from bus.errors import ScenarioError
from bus.messages import Law, UavBriefing, or_infinite
from bus.registry import LAWS, SENSORS, LawRow, SensorRow
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, record_type
from sim.models.field import coverage_gradient, is_uncovered, nearest_uncovered
from sim.models.randomness import FIRST, START_DIRECTION, uniform, words_of
from sim.models.vehicles import Motion, norm, raw_switching_radius

TRACKING = LAWS["tracking"].code
COVERAGE = LAWS["coverage"].code
LINEAR = LAWS["linear"].code
SWITCHING = LAWS["switching"].code
LOGARITHMIC = LAWS["logarithmic"].code
CIRCLE = LAWS["circle"].code
WEIGHTED = LAWS["weighted"].code
PATH = LAWS["path"].code
CERTIFIED = LAWS["certified"].code
LOOKAHEAD = LAWS["lookahead"].code
POLICY = LAWS["policy"].code
WATCHED = frozenset(row.code for row in LAWS.values() if row.watched)
"""Codes of the laws that the safety filter stands behind."""

_ON_THE_SPOT = 1e-9
"""Nearer than this [m] a point gives no direction."""


class LawParameters(NamedTuple):
    """The numbers of a law: SI units, infinite where there is no bound."""

    law: int
    dt: float
    width: float
    height: float
    cell: float
    u_max: float
    r_s: float
    r_o: float
    sensor: int
    peak: float
    reach: float
    desired: float
    k_v: float
    v_ref: float
    k_beta: float
    beta_limit: float
    a_c: float
    b_c: float
    c_c: float
    d_c: float
    r_pv: float
    omega: float
    margin: float
    horizon: float
    candidates: int
    v_g: float
    room: float
    """Distance that the UGV may have where a detection has the largest declared error; `lookahead` keeps within it."""
    key_0: np.uint64
    key_1: np.uint64
    """The UAV's own random numbers."""


class LawState(NamedTuple):
    """The state of a law, a row of an array of one; all 0 at first. `lookahead` has a memory of its own."""

    x_cx: float
    x_cy: float
    """x_c of (15)."""
    held: int
    """1 if it holds a point of (7)."""
    q_x: float
    q_y: float
    """That point [m]."""


class OwnTerms(NamedTuple):
    """The answer of a function of the user's own at this tick.

    The weights, or the virtual point and its second derivative.
    """

    alpha: float = 1.0
    beta: float = 0.0
    p_vx: float = 0.0
    p_vy: float = 0.0
    a_vx: float = 0.0
    a_vy: float = 0.0


_Row = TypeVar("_Row", LawRow, SensorRow)


def _row(table: Mapping[str, _Row], name: str, field: str) -> _Row:
    try:
        return table[name]
    except KeyError:
        raise ScenarioError(f"{field} = {name!r}: unknown; allowed: {', '.join(table)}") from None


def _room(briefing: UavBriefing) -> float:
    """r_v of the safety filter less the largest error of a detection, as far as one is declared [m]."""
    promise = bounds_of(briefing)
    room = promise.radius - promise.placed_error
    return float(room) if math.isfinite(room) else float(briefing.visibility_radius)


def law_parameters(briefing: UavBriefing, law: Law) -> LawParameters:
    """The numbers of one law for one UAV.

    Raises:
        ScenarioError: If the law or the sensor is unknown, the law has no branch, or the UAV is too weak for r_s.
    """
    key_0, key_1 = words_of(briefing.key)
    own, v_g = briefing.limits, or_infinite(briefing.target_limits.max_speed)
    v_a, u_a = or_infinite(own.max_speed), or_infinite(own.max_acceleration)
    row = _row(LAWS, law.name, "law.name")
    v_ref = law.reference_speed if law.reference_speed is not None else v_a
    radius = switching_radius if row.needs_radius else raw_switching_radius
    r_s = float(radius(briefing.visibility_radius, v_a, v_g, u_a))
    parameters = LawParameters(
        law=row.code,
        dt=float(briefing.dt),
        width=float(briefing.area.width),
        height=float(briefing.area.height),
        cell=float(briefing.area.cell),
        u_max=u_a,
        r_s=r_s,
        r_o=float(briefing.visibility_radius + briefing.sensor.range),
        sensor=_row(SENSORS, briefing.sensor.model, "sensor.model").code,
        peak=float(briefing.sensor.peak),
        reach=float(briefing.sensor.range),
        desired=float(briefing.desired_coverage),
        k_v=float(law.speed_gain),
        v_ref=float(v_ref),
        k_beta=float(law.weight_gain),
        beta_limit=float(law.weight_limit),
        a_c=float(law.a_c),
        b_c=float(law.b_c),
        c_c=float(law.c_c),
        d_c=float(law.d_c),
        r_pv=float(law.circle_radius if law.circle_radius is not None else r_s),
        omega=float(law.circle_rate),
        margin=float(border_distance(v_a if math.isfinite(v_a) else v_ref, u_a, briefing.dt)),
        horizon=float(law.horizon),
        candidates=law.candidates,
        v_g=v_g,
        room=_room(briefing),
        key_0=key_0,
        key_1=key_1,
    )
    if math.isnan(weights(parameters, OwnTerms(), 1.0)[0]):
        raise ScenarioError(
            f"law.name = {law.name!r}: has a row in bus.registry, but no branch in "
            f"{__name__}.weights"
        )
    return parameters


def initial_state() -> RecordArray:
    """The state of a law that has not flown yet: `LawState`. Shape (1,)."""
    return np.zeros(1, record_type(LawState))


@compiled
def way_to_uncovered(
    law: LawParameters,
    coverage: FloatArray,
    state: RecordArray,
    tick: int,
    p_ax: float,
    p_ay: float,
    p_gx: float,
    p_gy: float,
) -> tuple[bool, float, float]:
    """The symmetry breaker (7) with its point held until it is covered or leaves the support of the density.

    Returns:
        True if anything is uncovered at all, and the direction.
    """
    key = law.key_0, law.key_1
    own = state[0]
    held = own.held != 0 and is_uncovered(
        coverage, own.q_x, own.q_y, p_gx, p_gy, law.r_o, law.desired, law.cell
    )
    if not held:
        held, own.q_x, own.q_y = nearest_uncovered(
            coverage, p_ax, p_ay, p_gx, p_gy, law.r_o, law.desired, law.cell, key, tick
        )
        own.held = 1 if held else 0
    if not held:
        return False, 0.0, 0.0
    u_x, u_y = symmetry_breaker(own.q_x, own.q_y, p_ax, p_ay, 1.0)
    if norm(u_x, u_y) < _ON_THE_SPOT:
        # Deviation: (10) would divide by zero right over the point. Any direction is as good: draw one.
        angle = 2.0 * math.pi * uniform(key, START_DIRECTION, tick, FIRST)
        u_x, u_y = math.cos(angle), math.sin(angle)
    return True, u_x, u_y


@compiled
def coverage_term(
    law: LawParameters,
    coverage: FloatArray,
    state: RecordArray,
    tick: int,
    here: Motion,
    p_gx: float,
    p_gy: float,
) -> tuple[float, float]:
    """Section III as a whole, u_a,cov [m/s²]: (6), (7) where that is zero, (8), (10), (11), the border of Q."""
    p_ax, p_ay, v_ax, v_ay = here
    u_cov_x, u_cov_y, size = coverage_gradient(
        coverage,
        p_ax,
        p_ay,
        p_gx,
        p_gy,
        law.r_o,
        law.desired,
        law.sensor,
        law.peak,
        law.reach,
        law.cell,
    )
    uncovered, other_x, other_y = True, 0.0, 0.0
    if is_zero_gradient(u_cov_x, u_cov_y, size):
        uncovered, other_x, other_y = way_to_uncovered(
            law, coverage, state, tick, p_ax, p_ay, p_gx, p_gy
        )
    u_si_x, u_si_y = single_integrator_command(u_cov_x, u_cov_y, size, other_x, other_y)
    e_x, e_y = velocity_error(u_si_x, u_si_y, law.v_ref, v_ax, v_ay, uncovered)
    u_x, u_y = coverage_control(e_x, e_y, law.k_v)
    return keep_off_border(u_x, u_y, here, law.k_v, law.width, law.height, law.margin, law.dt)


@compiled
def weights(law: LawParameters, own: OwnTerms, distance: float) -> tuple[float, float]:
    """Alpha and beta of the law at this distance [m]."""
    if law.law == LINEAR:
        return linear_weights(distance, law.r_s)
    if law.law == SWITCHING:
        return switching_weights(distance, law.r_s)
    if law.law == LOGARITHMIC or law.law == CERTIFIED:
        return logarithmic_weights(distance, law.r_s, law.k_beta, law.beta_limit)
    if law.law == WEIGHTED:
        return own.alpha, own.beta
    if law.law == COVERAGE:
        return 0.0, 1.0
    if law.law == TRACKING or law.law == CIRCLE or law.law == PATH or law.law == LOOKAHEAD:
        return 1.0, 0.0
    if law.law == POLICY:  # the pilot asks it instead
        return 1.0, 0.0
    return math.nan, math.nan  # a row without its branch


@compiled
def uav_control(
    law: LawParameters,
    own: OwnTerms,
    coverage: FloatArray,
    state: RecordArray,
    tick: int,
    here: Motion,
    p_gx: float,
    p_gy: float,
) -> tuple[float, float]:
    """The UAV's command [m/s²] under any law, before the bound of (1).

    Args:
        law: Its parameters.
        own: The answer of the user's function at this tick, for the laws `weighted` and `path`.
        coverage: The UAV's own map, up to now.
        state: `LawState`, changed in place. Shape (1,).
        tick: Now.
        here: Where the UAV is.
        p_gx, p_gy: Where it believes the UGV to be [m].
    """
    x, y = here.p_x - p_gx, here.p_y - p_gy
    distance = norm(x, y)
    orbiting = law.law == CIRCLE or law.law == PATH
    p_vx, p_vy, a_vx, a_vy = own.p_vx, own.p_vy, own.a_vx, own.a_vy
    if law.law == CIRCLE:
        p_vx, p_vy, a_vx, a_vy = circle(tick * law.dt, law.r_pv, law.omega)
    if orbiting:
        x, y = x - p_vx, y - p_vy
    m = state[0]
    u_tr_x, u_tr_y = tracking_output(m.x_cx, m.x_cy, x, y, law.c_c, law.d_c)
    m.x_cx, m.x_cy = tracking_step(m.x_cx, m.x_cy, x, y, law.a_c, law.b_c, law.dt)
    if orbiting:
        return orbit_control(u_tr_x, u_tr_y, a_vx, a_vy)
    if law.law == TRACKING:
        return u_tr_x, u_tr_y
    u_cov_x, u_cov_y = coverage_term(law, coverage, state, tick, here, p_gx, p_gy)
    alpha, beta = weights(law, own, distance)
    return combine(alpha, beta, u_tr_x, u_tr_y, u_cov_x, u_cov_y)
