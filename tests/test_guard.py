"""The safety filter as compiled functions over plain arrays: in a compiled loop they give what `SafetyFilter` gives."""

import math
from typing import Any

import msgspec
import numba
import numpy as np
import pytest
from flights import DT, U_A, V_A, V_G, escort, told

from agents.control.certificate import (
    BEST_EFFORT,
    CERTIFIED,
    INNER,
    NO_DETECTION,
    UNCERTIFIED,
    no_plan,
    safe_control,
    state_ahead,
    uncertified_reason,
)
from agents.control.discs import certified_distance, keep_detection, no_detections
from agents.control.guard import (
    GuardState,
    begin_guard,
    guard,
    guard_state,
    note_detection,
    note_position,
    pack_promise,
    unpack_promise,
)
from agents.control.handover import Promise, certificate
from agents.control.visibility import SafetyFilter, promise_of
from bus.messages import Certificate, Detection, UavBriefing, UavObservation
from sim.compile import FloatArray
from sim.vehicles import step_vehicle

TICKS, WORLDS, DEPTH = 600, 2, 2400
LATEST = 40  # ticks that a detection is on its way at most


def declared(delay: float = 0.0, error: float | None = 0.3) -> UavBriefing:
    """What the paper's UAV is told, with this delay of its commands [s] and this error of its detections [m]."""
    return msgspec.structs.replace(told(escort("certified")), certificate=Certificate(error=error, age=1.0, delay=delay))


def observed(tick: int, *found: tuple[float, float, float], time: float | None = None) -> UavObservation:
    """An observation from (20 + tick / 100, 20) at rest, with detections: when [s], and p_a - p_g [m]."""
    return UavObservation(
        tick=tick,
        time=tick * DT if time is None else time,
        position=(20.0 + 0.01 * tick, 20.0),
        velocity=(0.0, 0.0),
        detections=tuple(Detection(time=t, relative_position=(x, y)) for t, x, y in found),
    )


def flown(seed: int, delay: float) -> tuple[SafetyFilter, FloatArray, FloatArray, FloatArray]:
    """A flight with a `SafetyFilter`: late, lost and overtaking detections, some with too large an error, and missed ticks.

    Returns:
        The filter; what came in: the tick, p, v and the command that is wanted, (rows, 7); the detections that arrived: the
        row in which, the tick taken, p_delta, (found, 4); and what came out as `guard` gives it, (rows, 5).
    """
    rng = np.random.default_rng(seed)
    watch = SafetyFilter(declared(delay))
    pending = [(0.0, 0.0)] * round(delay / DT)
    p, v, g, wanted, course = (20.0, 20.0), (0.0, 0.0), np.array([20.5, 20.0]), (0.0, 0.0), np.zeros(2)
    underway: list[tuple[int, int, float, float]] = []
    inputs, arrived, outputs = [], [], []
    command = (0.0, 0.0)
    for tick in range(TICKS):
        if tick % 50 == 0:
            a, b = rng.uniform(0.0, 2.0 * math.pi, 2)
            wanted, course = (0.3 * math.cos(a), 0.3 * math.sin(a)), V_G * np.array([math.cos(b), math.sin(b)])
        if rng.random() < 0.8:
            x, y = (np.array(p) - g + rng.uniform(-0.2, 0.2, 2) * (1.0 if tick < TICKS // 2 else 3.0)).tolist()
            underway.append((tick + int(rng.integers(0, LATEST)), tick, x, y))
        if not 150 <= tick < 155:
            now = [one for one in underway if one[0] <= tick]
            underway = [one for one in underway if one[0] > tick]
            looks = tuple(Detection(time=taken * DT, relative_position=(x, y)) for _, taken, x, y in now)
            arrived += [(len(inputs), taken, x, y) for _, taken, x, y in now]
            seen = UavObservation(tick=tick, time=tick * DT, position=p, velocity=v, detections=looks)
            inputs.append((tick, *p, *v, *wanted))
            watch.see(seen)
            verdict = watch.filter(seen, wanted)
            command = verdict.acceleration
            code = next((code for code, reason in UNCERTIFIED.items() if reason == verdict.reason), CERTIFIED)
            outputs.append((*command, verdict.intervened, code, verdict.distance))
        pending.append(command)
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(*p, *v, *pending.pop(0), V_A, U_A, DT)
        p, v, g = (p_x, p_y), (v_x, v_y), g + DT * course
    return watch, np.array(inputs), np.array(arrived), np.array(outputs)


@numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
def fly_all(rows: FloatArray, states: GuardState, inputs: FloatArray, arrived: FloatArray, counts: Any, out: FloatArray) -> None:
    """All worlds' filters in one compiled loop: each with its row of numbers and its slice of the arrays."""
    for i in range(rows.shape[0]):
        c = unpack_promise(rows[i])
        state = GuardState(
            states.detections[i], states.plan[i], states.pending[i], states.track[i], states.track_ticks[i], states.flags[i]
        )
        begin_guard(state)
        n = 0
        for k in range(inputs.shape[1]):
            tick = int(inputs[i, k, 0])
            _, p_x, p_y, v_x, v_y, u_x, u_y = inputs[i, k]
            note_position(state, tick, p_x, p_y)
            while n < counts[i] and arrived[i, n, 0] == k:
                note_detection(c, state, int(arrived[i, n, 1]), tick, arrived[i, n, 2], arrived[i, n, 3], p_x, p_y)
                n += 1
            u_x, u_y, acts, code, distance = guard(c, state, tick, p_x, p_y, v_x, v_y, u_x, u_y)
            out[i, k, 0], out[i, k, 1], out[i, k, 2], out[i, k, 3], out[i, k, 4] = u_x, u_y, acts != INNER, code, distance


@pytest.mark.parametrize("delay", [0.0, 3 * DT])
def test_many_worlds_in_a_compiled_loop_give_what_the_filter_gives(delay: float) -> None:
    flights = [flown(seed, delay) for seed in range(WORLDS)]
    rows = np.array([pack_promise(watch.promise) for watch, *_ in flights])
    one = guard_state(flights[0][0].promise, DEPTH)
    states = GuardState(*(np.full((WORLDS, *part.shape), 7, part.dtype) for part in one))  # `begin_guard` must clear them
    counts = np.array([len(arrived) for _, _, arrived, _ in flights])
    arrived = np.zeros((WORLDS, counts.max(), 4))
    for i, flight in enumerate(flights):
        arrived[i, : counts[i]] = flight[2]
    inputs, wanted = (np.array([flight[k] for flight in flights]) for k in (1, 3))
    out = np.empty_like(wanted)
    fly_all(rows, states, inputs, arrived, counts, out)
    assert out.tobytes() == wanted.tobytes()
    assert len(np.unique(wanted[:, :, 3])) >= 3  # certified, without a detection, contradicted
    assert 0 < wanted[:, :, 2].sum() < wanted[:, :, 2].size
    for i, (watch, *_) in enumerate(flights):
        for part, own in zip(states, watch._state, strict=True):
            assert part[i].tobytes() == own.tobytes()


@pytest.mark.parametrize("delay", [0.0, 3 * DT])
def test_the_filter_is_what_its_parts_are_one_after_the_other(delay: float) -> None:
    """Written out in plain Python: a dictionary of own positions, a list of commands on their way."""
    watch, inputs, arrived, wanted = flown(seed=5, delay=delay)
    c = watch.promise
    kept, plan, contradicted = no_detections(), no_plan(), False
    positions: dict[int, tuple[float, float]] = {}
    pending = [(0.0, 0.0)] * round(delay / DT)
    for k, (tick, p_x, p_y, v_x, v_y, u_x, u_y) in enumerate(inputs.tolist()):
        positions[tick], t = (p_x, p_y), tick * DT
        for _, taken, x, y in arrived[arrived[:, 0] == k].tolist():
            if taken in positions:
                z_x, z_y = (min(max(own - far, 0.0), 40.0) for own, far in zip(positions[taken], (x, y), strict=True))
                contradicted |= not keep_detection(kept, z_x, z_y, taken * DT, t, p_x, p_y, c.eps, c.v_g)
        ahead = state_ahead(np.array(pending).reshape(-1, 2), p_x, p_y, v_x, v_y, c.v_a, c.u_a, DT)
        a_x, a_y, acts = safe_control(c, kept, plan, t + c.delay, *ahead, u_x, u_y)
        pending = [*pending, (a_x, a_y)][1:] if pending else []
        code = uncertified_reason(c, kept, plan, t, contradicted, acts)
        distance = certified_distance(p_x, p_y, t, kept, c.eps, c.v_g)
        assert wanted[k].tolist() == [a_x, a_y, acts != INNER, code, distance]


@pytest.mark.parametrize("delay", [0.0, 3 * DT])
def test_a_memory_that_begins_again_is_as_fresh_as_a_new_one(delay: float) -> None:
    promise = promise_of(declared(delay))
    fresh, used = guard_state(promise, 8), guard_state(promise, 8)
    assert used.pending.shape == (round(delay / DT), 2)
    assert guard(promise, used, 0, 20.0, 20.0, 0.1, 0.0, 0.1, 0.0)[2:] == (BEST_EFFORT, NO_DETECTION, math.inf)
    for part in used:
        part.fill(-5)
    begin_guard(used)
    assert [part.tobytes() for part in used] == [part.tobytes() for part in fresh]
    assert [part.dtype for part in used] == [part.dtype for part in fresh]


def test_a_track_has_room_for_a_tick() -> None:
    with pytest.raises(ValueError, match="at least 1, not 0"):
        guard_state(promise_of(declared()), 0)


@pytest.mark.parametrize("taken", [-1, -8, 0, 3, 4, 10, 12, 19])
def test_a_detection_of_a_tick_that_was_not_noted_is_ignored(taken: int) -> None:
    """Before the start, missed, later than now, or so long ago that another tick has its place in the track of 8."""
    promise = promise_of(declared())
    state = guard_state(promise, 8)
    for tick in (0, 1, 2, 3, 5, 6, 7, 8, 11):  # 8 and 11 take the places of 0 and 3
        note_position(state, tick, 20.0 + tick, 20.0)
    before = [part.tobytes() for part in state]
    note_detection(promise, state, taken, 11, 0.5, 0.0, 31.0, 20.0)
    assert [part.tobytes() for part in state] == before
    note_detection(promise, state, 7, 11, 0.5, 0.0, 31.0, 20.0)
    assert state.detections[np.isfinite(state.detections[:, 2])].tolist() == [[26.5, 20.0, 7 * DT]]


def test_a_process_that_was_away_ignores_what_was_taken_meanwhile() -> None:
    watch = SafetyFilter(declared())
    for tick in (0, 1, 2, 7, 8):
        watch.see(observed(tick))
    watch.see(observed(9, *((tick * DT, 0.0, 1.0) for tick in (3, 4, 5, 6))))
    assert np.isinf(watch._state.detections[:, 2]).all()
    watch.see(observed(10, (2 * DT, 0.0, 1.0)))
    assert watch._state.detections[:, 2].max() == 2 * DT


def test_a_detection_that_claims_another_moment_counts_for_the_nearest_tick() -> None:
    watch = SafetyFilter(declared())
    for tick in range(6):
        watch.see(observed(tick))
    watch.see(observed(6, (3.4 * DT, 0.0, 1.0), (1e12, 0.0, 1.0), (7 * DT, 0.0, 1.0)))
    assert watch._state.detections[np.isfinite(watch._state.detections[:, 2])].tolist() == [[20.03, 19.0, 3 * DT]]


def test_where_the_ugv_was_detected_is_clipped_into_the_area() -> None:
    promise = promise_of(declared())
    state = guard_state(promise, 8)
    note_position(state, 0, 0.2, promise.height - 0.1)
    note_detection(promise, state, 0, 0, 0.3, -0.3, 0.2, promise.height - 0.1)
    assert state.detections[np.isfinite(state.detections[:, 2])].tolist() == [[0.0, promise.height, 0.0]]


def test_a_contradiction_is_remembered_until_the_filter_begins_again() -> None:
    promise = promise_of(declared())
    state = guard_state(promise, 8)
    for tick in range(2):
        note_position(state, tick, 20.0, 20.0)
        note_detection(promise, state, tick, tick, 2.0 * tick, 0.0, 20.0, 20.0)
        assert state.flags.tolist() == [tick]
    note_detection(promise, state, 1, 1, 2.0, 0.0, 20.0, 20.0)
    assert state.flags.tolist() == [1]
    begin_guard(state)
    assert state.flags.tolist() == [0]


@pytest.mark.parametrize("error", [0.3, None])
def test_a_promise_comes_back_from_its_row(error: float | None) -> None:
    for promise in (promise_of(declared(0.15, error)), certificate(r_v=5, v_a=1, u_a=1, v_g=0, dt=0.1, eps=0, age=2)):
        row = pack_promise(promise)
        assert (row.dtype, row.shape) == (np.float64, (len(Promise._fields),))
        back = unpack_promise(row)
        assert type(back) is Promise
        assert np.array(back).tobytes() == np.array(promise, dtype=np.float64).tobytes()
    assert unpack_promise(np.arange(12.0)) == Promise(*range(12))
