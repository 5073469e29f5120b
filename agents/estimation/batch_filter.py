r"""Compiled estimator of batches: the equations of `agents.estimation.estimator`, for one axis.

F, Q, R and P are $M \otimes I_2$ with M 2 x 2: x and y are independent and have equal statistics, so one covariance
serves both axes. A test compares the two filters step by step, to 1e-9 relative; they differ by rounding.

The memory of all UAVs is one array of `EstimatorRow`, shape (worlds, UAVs, 1 + depth). Row 0 is the current state. The
other rows are a ring of recent ticks, tick k in row 1 + k % depth, as they were before the measurement of that tick.
"""

import numpy as np

from agents.estimation.motion_model import KalmanParameters, bounded_scales
from agents.uav_inputs import DETECTION, TeamInputs
from agents.uav_parameters import Target
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.vehicles import State, clip_norm


class EstimatorRow:
    """State of one UAV's estimator at one tick, and the measurement of that tick."""

    tick: int
    """Tick of the row; -1: empty."""
    own_x: float
    own_y: float
    """p_a [m]."""
    measured: bool
    received: bool
    """True if a team-mate measured it."""
    z_x: float
    z_y: float
    """Measured position of the UGV [m]."""
    known: bool
    """False before the first measurement; the fields below are meaningless then."""
    x: float
    y: float
    """Position of the UGV [m]."""
    v_x: float
    v_y: float
    """Velocity of the UGV [m/s], at most v_g,max."""
    p_pp: float
    p_pv: float
    p_vv: float
    """Covariance of one axis [m², m²/s, m²/s²]."""
    age: int
    """Ticks since the newest accepted measurement."""
    rejected: int
    rejected_in_a_row: int


def estimator_rows(depth: int) -> RecordArray:
    """Return the empty memory of one UAV. Shape (1 + depth,).

    Args:
        depth: Number of ticks in the ring; 1 if no detection is delayed.

    Raises:
        ValueError: If the depth is not positive.
    """
    if depth < 1:
        raise ValueError(f"depth = {depth}: too small; allowed: at least 1")
    rows = np.zeros(1 + depth, dtype=record_type(EstimatorRow))
    rows["tick"] = -1
    return rows


@compiled
def estimate(rows: RecordArray, world: int, uav: int) -> Target:
    """Return the estimate of one UAV."""
    now = rows[world, uav, 0]
    return Target(now.known, now.x, now.y, now.v_x, now.v_y, now.p_pp, now.p_vv)


@compiled
def predict(parameters: KalmanParameters, now: EstimatorRow) -> None:
    """Predict a state over one tick and bound its covariance."""
    c = parameters
    now.age += 1
    if not now.known or not c.enabled:
        return
    before = now.p_pp
    now.x += c.dt * now.v_x
    now.y += c.dt * now.v_y
    now.p_pp = now.p_pp + 2.0 * c.dt * now.p_pv + c.dt * c.dt * now.p_vv + c.q_pp
    now.p_pv = now.p_pv + c.dt * now.p_vv + c.q_pv
    now.p_vv = now.p_vv + c.q_vv
    a, b = bounded_scales(now.p_pp, now.p_vv, before, now.age * c.dt, c.dt, c.speed, c.acceleration)
    now.p_pp, now.p_pv, now.p_vv = a * a * now.p_pp, a * b * now.p_pv, b * b * now.p_vv


@compiled
def correct(parameters: KalmanParameters, now: EstimatorRow) -> None:
    """Update by the measurement of this tick, reject it by the gate, or reinitialize from it."""
    c = parameters
    if now.known and c.enabled:
        nu_x, nu_y, s = now.z_x - now.x, now.z_y - now.y, now.p_pp + c.variance
        if (nu_x * nu_x + nu_y * nu_y) / s <= c.gate:
            k_p, k_v = now.p_pp / s, now.p_pv / s
            now.x += k_p * nu_x
            now.y += k_p * nu_y
            now.v_x, now.v_y = clip_norm(now.v_x + k_v * nu_x, now.v_y + k_v * nu_y, c.speed)
            pp, pv, m = now.p_pp, now.p_pv, 1.0 - k_p
            now.p_pp = m * m * pp + k_p * k_p * c.variance
            now.p_pv = m * (pv - k_v * pp) + k_p * k_v * c.variance
            now.p_vv = now.p_vv - 2.0 * k_v * pv + k_v * k_v * (pp + c.variance)
            now.age = now.rejected_in_a_row = 0
            return
        now.rejected += 1
        now.rejected_in_a_row += 1
        if now.rejected_in_a_row < c.max_rejections:
            return
    now.known = True
    now.x, now.y, now.v_x, now.v_y = now.z_x, now.z_y, 0.0, 0.0
    now.p_pp, now.p_pv, now.p_vv = c.variance, 0.0, c.first_variance
    now.age = now.rejected_in_a_row = 0


@compiled
def insert(rows: RecordArray, row: tuple[int, int], tick: int, detection: FloatArray) -> int:
    """Store a detection at its tick and return that tick, or the next tick if the detection is unusable.

    Args:
        rows: Memory of all UAVs.
        row: World and UAV.
        tick: Current tick.
        detection: Detection, in the columns `DETECTION`. Shape (3,).
    """
    world, uav = row
    depth, taken = rows.shape[2] - 1, int(detection[DETECTION.taken])
    if taken < 0 or taken > tick or tick - taken >= depth:
        return tick + 1
    entry = rows[world, uav, 1 + taken % depth]
    if entry.tick != taken or (entry.measured and not entry.received):
        return tick + 1
    entry.measured, entry.received = True, False
    entry.z_x, entry.z_y = (
        entry.own_x - detection[DETECTION.x],
        entry.own_y - detection[DETECTION.y],
    )
    return taken


@compiled
def _insert_received(
    rows: RecordArray, row: tuple[int, int], tick: int, messages: TeamInputs | None
) -> int:
    """Store the measurements of team-mates for ticks without one; return the first such tick, or the next tick.

    Args:
        rows, row, tick: As in `insert`.
        messages: Messages of the team-mates; None: there are no teams.
    """
    if messages is None:
        return tick + 1
    world, uav = row
    depth, first = rows.shape[2] - 1, tick + 1
    for n in range(messages.messages.shape[0]):
        message = messages.messages[n]
        taken = message.measured
        if taken < 0 or taken > tick or tick - taken >= depth:
            continue
        entry = rows[world, uav, 1 + taken % depth]
        if entry.tick == taken and not entry.measured:
            entry.measured = entry.received = True
            entry.z_x, entry.z_y = message.g_x, message.g_y
            first = min(first, taken)
    return first


@compiled
def update(
    parameters: KalmanParameters,
    rows: RecordArray,
    row: tuple[int, int],
    tick: int,
    own: State,
    detections: FloatArray,
    count: int,
    messages: TeamInputs | None = None,
) -> None:
    """Advance to the next tick and use the detections that have arrived, each at its own tick.

    Args:
        parameters: Parameters of the filter.
        rows: Memory of all UAVs, changed in place.
        row: World and UAV.
        tick: Current tick; the function must be called for every tick from 0 on.
        own: Current state of the UAV.
        detections: Detections, in the columns `DETECTION`. Shape (rows, 3).
        count: Number of valid rows of `detections`.
        messages: Messages of team-mates, whose measurements are used for ticks without an own detection; None: there
            are no teams.
    """
    world, uav = row
    depth, now = rows.shape[2] - 1, rows[world, uav, 0]
    predict(parameters, now)
    now.tick, now.own_x, now.own_y, now.measured = tick, own.p_x, own.p_y, False
    now.received = False
    rows[world, uav, 1 + tick % depth] = now
    first = tick + 1
    for k in range(count):
        first = min(first, insert(rows, row, tick, detections[k]))
    first = min(first, _insert_received(rows, row, tick, messages))
    for k in range(first, tick + 1):
        entry = rows[world, uav, 1 + k % depth]
        if k == first:
            rows[world, uav, 0] = entry
        else:  # the state comes from the previous tick, the measurement from the ring
            predict(parameters, now)
            now.tick, now.own_x, now.own_y = k, entry.own_x, entry.own_y
            now.measured, now.z_x, now.z_y = entry.measured, entry.z_x, entry.z_y
            now.received = entry.received
            rows[world, uav, 1 + k % depth] = now
        if now.measured:
            correct(parameters, now)
