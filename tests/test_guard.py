"""The safety filter: what it is by its parts, and what it does about detections and commands that go astray."""

import math

import msgspec
import numpy as np
import pytest

from agents.control.certificate import (
    BEST_EFFORT,
    CERTIFIED,
    CONTRADICTED,
    INNER,
    NO_DETECTION,
    NO_PLAN,
    OFF_COURSE,
    TOO_OLD,
    UNCERTIFIED,
    UNKNOWN_COMMANDS,
    UNSAFE_COURSE,
    drop_plan,
    is_within,
    no_plan,
    safe_control,
    step_in_area,
)
from agents.control.discs import certified_distance, keep_detection, newest_detection, no_detections
from agents.control.guard import (
    GuardState,
    begin_guard,
    forget_commands,
    guard,
    guard_state,
    note_commands,
    note_detection,
    note_position,
)
from agents.control.handover import certificate
from agents.control.promise import Declared
from agents.control.visibility import SafetyFilter, promise_of
from bus.messages import DeclaredBounds, UavBriefing
from flights import DT, PROMISED, U_A, V_A, V_G, escort, told, uav_sees
from sim.engine.batch import arrays_of
from sim.kernels.compile import FloatArray
from sim.models.vehicles import Motion, step_vehicle

TICKS = 600
LATEST = 40  # ticks that a detection is on its way at most


def declared(delay: float = 0.0, error: float | None = 0.3) -> UavBriefing:
    """The briefing of the paper's UAV, with this delay of its commands [s] and this error of its detections [m]."""
    return msgspec.structs.replace(
        told(escort("certified")), certificate=DeclaredBounds(error=error, age=1.0, delay=delay)
    )


def observed(tick, *found, time=None):
    """An observation from (20 + tick / 100, 20) at rest, with detections: when [s], and p_a - p_g [m]."""
    other = {} if time is None else {"time": time}
    looks = ((t, (x, y)) for t, x, y in found)
    return uav_sees(tick, *looks, position=(20.0 + 0.01 * tick, 20.0), **other)


def kept_by(state: GuardState) -> list[tuple[float, float, int]]:
    """The detections that a filter has kept: where [m], and in which tick."""
    return state.detections[state.detections["taken"] >= 0].tolist()


def flown(seed: int, delay: float) -> tuple[SafetyFilter, FloatArray, FloatArray, FloatArray]:
    """A flight with a `SafetyFilter`.

    Late, lost and overtaking detections, some with too large an error, and missed ticks.

    Returns:
        The filter; what came in: the tick, p, v and the command that is wanted, (rows, 7); the detections that
        arrived: the
        row in which, the tick taken, p_delta, (found, 4); and what came out as `guard` gives it, (rows, 5).
    """
    rng = np.random.default_rng(seed)
    watch = SafetyFilter(declared(delay))
    pending = [(0.0, 0.0)] * round(delay / DT)
    p, v, g = (20.0, 20.0), (0.0, 0.0), np.array([20.5, 20.0])
    wanted, course = (0.0, 0.0), np.zeros(2)
    underway: list[tuple[int, int, float, float]] = []
    inputs, arrived, outputs = [], [], []
    command = (0.0, 0.0)
    for tick in range(TICKS):
        if tick % 50 == 0:
            a, b = rng.uniform(0.0, 2.0 * math.pi, 2)
            wanted = (0.3 * math.cos(a), 0.3 * math.sin(a))
            course = V_G * np.array([math.cos(b), math.sin(b)])
        if rng.random() < 0.8:
            error = rng.uniform(-0.2, 0.2, 2) * (1.0 if tick < TICKS // 2 else 3.0)
            x, y = (np.array(p) - g + error).tolist()
            underway.append((tick + int(rng.integers(0, LATEST)), tick, x, y))
        if not 150 <= tick < 155:
            now = [one for one in underway if one[0] <= tick]
            underway = [one for one in underway if one[0] > tick]
            looks = ((taken * DT, (x, y)) for _, taken, x, y in now)
            arrived += [(len(inputs), taken, x, y) for _, taken, x, y in now]
            seen = uav_sees(tick, *looks, position=p, velocity=v)
            inputs.append((tick, *p, *v, *wanted))
            watch.see(seen)
            verdict = watch.filter(seen, wanted)
            command = verdict.acceleration
            codes = {reason: code for code, reason in UNCERTIFIED.items()}
            code = codes.get(verdict.reason, CERTIFIED)
            outputs.append((*command, verdict.intervened, code, verdict.distance))
        pending.append(command)
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(*p, *v, *pending.pop(0), V_A, U_A, DT)
        p, v, g = (p_x, p_y), (v_x, v_y), g + DT * course
    return watch, np.array(inputs), np.array(arrived), np.array(outputs)


@pytest.mark.parametrize("delay", [0.0, 3 * DT])
def test_the_filter_is_what_its_parts_are_one_after_the_other(delay: float) -> None:
    """Written out in plain Python.

    A dictionary of own positions, a list of commands under way, the whole course each time.
    """
    watch, inputs, arrived, wanted = flown(seed=5, delay=delay)
    assert len(np.unique(wanted[:, 3])) >= 3  # certified, without a detection, contradicted
    assert 0 < wanted[:, 2].sum() < len(wanted)
    c = watch.promise
    kept, plan, contradicted = no_detections(), no_plan(), False
    positions: dict[int, tuple[float, float]] = {}
    pending, known, safe, last, expected = [(0.0, 0.0)] * round(delay / DT), 100, False, -1, None
    for k, (at, p_x, p_y, v_x, v_y, u_x, u_y) in enumerate(inputs.tolist()):
        tick = int(at)
        positions[tick] = (p_x, p_y)
        for _, taken, x, y in arrived[arrived[:, 0] == k].tolist():
            if taken in positions:
                here = zip(positions[taken], (x, y), strict=True)
                z_x, z_y = (min(max(own - far, 0.0), 40.0) for own, far in here)
                contradicted |= not keep_detection(c, kept, z_x, z_y, int(taken), tick, p_x, p_y)
        on_course = True
        if tick != last + 1:
            missed = pending[-1:] * int(tick - last - 1)
            pending, known, safe = (pending + missed)[-len(pending) :] if pending else [], 0, False
            drop_plan(plan)
        elif expected is not None and expected != (p_x, p_y, v_x, v_y):
            on_course, known, safe = False, 0, False
            drop_plan(plan)
        course = [Motion(p_x, p_y, v_x, v_y)]
        for command in pending:
            course.append(step_in_area(c, course[-1], *command)[0])
        a_x, a_y, acts = safe_control(c, kept, plan, tick + len(pending), course[-1], u_x, u_y)
        if acts == BEST_EFFORT:
            safe = False
        elif not safe:
            safe = all(
                is_within(c, kept, plan, tick + j, x, y, 0.0) for j, (x, y, *_) in enumerate(course)
            )
        newest = newest_detection(kept)
        checks = {
            NO_DETECTION: newest < 0,
            TOO_OLD: newest >= 0 and (tick - kept["taken"][newest]) * DT > c.age + 1e-9,
            CONTRADICTED: contradicted,
            NO_PLAN: acts == BEST_EFFORT,
            OFF_COURSE: not on_course,
            UNKNOWN_COMMANDS: known < len(pending),
            UNSAFE_COURSE: not safe,
        }
        code = next((code for code, fails in checks.items() if fails), CERTIFIED)
        expected = step_in_area(c, course[0], *[*pending, (a_x, a_y)][0])[0]
        pending, known, last = [*pending, (a_x, a_y)][1:] if pending else [], known + 1, tick
        distance = certified_distance(c, kept, tick, p_x, p_y)
        assert wanted[k].tolist() == [a_x, a_y, acts != INNER, code, distance]


@pytest.mark.parametrize("delay", [0.0, 3 * DT])
def test_a_memory_that_begins_again_is_as_fresh_as_a_new_one(delay: float) -> None:
    promise = promise_of(declared(delay))
    fresh, used = guard_state(promise.delay_ticks, 8), guard_state(promise.delay_ticks, 8)
    assert used.course.shape == (round(delay / DT) + 1,)
    verdict = guard(promise, used, 0, Motion(20.0, 20.0, 0.1, 0.0), 0.1, 0.0)
    assert verdict[2:] == (BEST_EFFORT, NO_DETECTION, math.inf)
    parts = arrays_of(used)
    for part in parts:
        part[:] = np.array(-5).astype(part.dtype)
    begin_guard(used)
    assert [part.tobytes() for part in parts] == [part.tobytes() for part in arrays_of(fresh)]
    assert [part.dtype for part in parts] == [part.dtype for part in arrays_of(fresh)]


def test_a_track_has_room_for_a_tick() -> None:
    with pytest.raises(ValueError, match="at least 1, not 0"):
        guard_state(1, 0)


@pytest.mark.parametrize("taken", [-1, -8, 0, 3, 4, 10, 12, 19])
def test_a_detection_of_a_tick_that_was_not_noted_is_ignored(taken: int) -> None:
    """Before the start, missed, later than now, or so long ago that another tick has its place in the track of 8."""
    promise = promise_of(declared())
    state = guard_state(promise.delay_ticks, 8)
    for tick in (0, 1, 2, 3, 5, 6, 7, 8, 11):  # 8 and 11 take the places of 0 and 3
        note_position(state, tick, 20.0 + tick, 20.0)
    before = [part.tobytes() for part in arrays_of(state)]
    note_detection(promise, state, taken, 11, 0.5, 0.0, 31.0, 20.0)
    assert [part.tobytes() for part in arrays_of(state)] == before
    note_detection(promise, state, 7, 11, 0.5, 0.0, 31.0, 20.0)
    assert kept_by(state) == [(26.5, 20.0, 7)]


def test_a_process_that_was_away_ignores_what_was_taken_meanwhile() -> None:
    watch = SafetyFilter(declared())
    for tick in (0, 1, 2, 7, 8):
        watch.see(observed(tick))
    watch.see(observed(9, *((tick * DT, 0.0, 1.0) for tick in (3, 4, 5, 6))))
    assert kept_by(watch.state) == []
    watch.see(observed(10, (2 * DT, 0.0, 1.0)))
    assert watch.state.detections["taken"].max() == 2


def test_a_detection_of_no_tick_or_of_the_future_is_not_used() -> None:
    watch = SafetyFilter(declared())
    for tick in range(6):
        watch.see(observed(tick))
    watch.see(observed(6, (3.4 * DT, 0.0, 1.0), (1e12, 0.0, 1.0), (7 * DT, 0.0, 1.0)))
    assert kept_by(watch.state) == []
    watch.see(observed(7, (sum([DT] * 3), 0.0, 1.0)))  # a sum of ticks, 0.15000000000000002 s
    assert kept_by(watch.state) == [(20.03, 19.0, 3)]


def test_where_the_ugv_was_detected_is_clipped_into_the_area() -> None:
    promise = promise_of(declared())
    state = guard_state(promise.delay_ticks, 8)
    note_position(state, 0, 0.2, promise.height - 0.1)
    note_detection(promise, state, 0, 0, 0.3, -0.3, 0.2, promise.height - 0.1)
    assert kept_by(state) == [(0.0, promise.height, 0)]


def test_a_contradiction_is_remembered_until_the_filter_begins_again() -> None:
    promise = promise_of(declared())
    state = guard_state(promise.delay_ticks, 8)
    for tick in range(2):
        note_position(state, tick, 20.0, 20.0)
        note_detection(promise, state, tick, tick, 2.0 * tick, 0.0, 20.0, 20.0)
        assert state.flags["contradicted"] == tick
    note_detection(promise, state, 1, 1, 2.0, 0.0, 20.0, 20.0)
    assert state.flags["contradicted"] == 1
    begin_guard(state)
    assert state.flags["contradicted"] == 0


def test_where_there_are_no_walls_a_detection_stays_where_it_is() -> None:
    promise = certificate(Declared(**PROMISED, eps=0.3, age=1.0))
    state = guard_state(promise.delay_ticks, 8)
    note_position(state, 0, -7.0, 3.0)
    note_detection(promise, state, 0, 0, 1.0, 5.0, -7.0, 3.0)
    assert kept_by(state) == [(-8.0, -2.0, 0)]


class Vehicle:
    """A UAV that does what its filter says after a delay, and the codes of its ticks."""

    def __init__(self, delay: float, *, begin: int = 0, width: float = 40.0) -> None:
        declared = Declared(**PROMISED, eps=0.0, age=1.0, delay=delay, width=width, height=width)
        self.promise = certificate(declared)
        self.memory = guard_state(self.promise.delay_ticks, 8)
        self.state, self.tick = Motion(20.0, 20.0, 0.0, 0.0), begin
        self.pending = [(0.0, 0.0)] * round(delay / DT)
        self.g = (20.0, 20.0)

    def fly(self, wanted: tuple[float, float], *, lose: bool = False, filtered: bool = True) -> int:
        """One tick; whether its command is lost; the code."""
        p_x, p_y, _, _ = self.state
        note_position(self.memory, self.tick, p_x, p_y)
        seen = (p_x - self.g[0], p_y - self.g[1])
        note_detection(self.promise, self.memory, self.tick, self.tick, *seen, p_x, p_y)
        code = CERTIFIED
        if filtered:
            *command, _, code, _ = guard(self.promise, self.memory, self.tick, self.state, *wanted)
        else:
            command = wanted
        self.pending.append(
            self.pending[-1] if lose and self.pending else (0.0, 0.0) if lose else tuple(command)
        )
        self.state, _ = step_in_area(self.promise, self.state, *self.pending.pop(0))
        self.tick += 1
        return code


OUT, BACK = (U_A, 0.0), (-U_A, 0.0)


@pytest.mark.parametrize("delay", [0.0, 0.5])
def test_after_a_lost_command_nothing_is_certified_until_all_under_way_were_sent_since(delay):
    uav, d = Vehicle(delay), round(delay / DT)
    for _ in range(10):
        assert uav.fly(OUT) == CERTIFIED
    codes = [uav.fly(BACK if k % 2 else OUT, lose=k == 3) for k in range(3 * d + 10)]
    told = 3 + d + 1  # the tick after the one in which it should have acted
    assert codes[:told] == [CERTIFIED] * told
    assert codes[told] == OFF_COURSE
    assert codes[told + 1 : told + max(1, d)] == [UNKNOWN_COMMANDS] * max(0, d - 1)
    assert set(codes[told + max(1, d) :]) == {CERTIFIED}


def test_commands_under_way_that_lead_out_of_sight_are_not_certified_though_a_plan_brings_back():
    """Only the state at t + tau_c was looked at once, and 4.895 m were certified."""
    uav, seen = Vehicle(1.0), set()
    for k in range(400):
        x = uav.state[0]
        inner = BACK if x - uav.g[0] > 4.6 else OUT
        lost = 0 < k < 250 and k % 40 < 15
        distance = math.hypot(x - uav.g[0], uav.state[1] - uav.g[1])
        code = uav.fly(inner, lose=lost)
        seen.add(code)
        assert code != CERTIFIED or distance < 4.75
    assert {OFF_COURSE, UNKNOWN_COMMANDS} <= seen


@pytest.mark.parametrize("noted", [False, True])
def test_a_filter_that_begins_in_flight_waits_until_it_knows_what_is_under_way(noted: bool) -> None:
    """A law changed from `coverage` to `certified` once made a filter that believed that nothing was under way."""
    uav, sent = Vehicle(0.5), []
    for _ in range(25):
        sent.append(OUT)
        uav.fly(OUT, filtered=False)
    begin_guard(uav.memory)
    if noted:
        note_commands(uav.memory, np.array(sent[-30:]))
    codes = [uav.fly(OUT) for _ in range(40)]
    assert codes[0] == UNKNOWN_COMMANDS
    assert codes.count(OFF_COURSE) == (0 if noted else 10)
    first = codes.index(CERTIFIED)
    assert first == (10 if noted else 20)
    assert set(codes[first:]) == {CERTIFIED}


def test_commands_that_may_not_have_been_sent_are_not_relied_on() -> None:
    uav = Vehicle(0.3)
    for _ in range(10):
        assert uav.fly(OUT) == CERTIFIED
    forget_commands(uav.memory)
    assert [uav.fly(OUT) for _ in range(8)] == [UNKNOWN_COMMANDS] * 6 + [CERTIFIED] * 2


def test_a_course_that_leads_out_of_sight_says_so() -> None:
    """At rest 4.7 m away and certified as nothing moves; a UGV that was 0.1 m nearer all along leaves no such room."""
    uav = Vehicle(0.5)
    uav.state = Motion(24.6, 20.0, 0.3, 0.0)
    uav.pending = [OUT] * 4 + [BACK] * 6
    begin_guard(uav.memory)
    note_commands(uav.memory, np.array(uav.pending))
    uav.tick = 50
    forget_commands(uav.memory)
    codes = [uav.fly(BACK) for _ in range(60)]
    assert UNSAFE_COURSE in codes or NO_PLAN in codes
    assert codes[-1] == CERTIFIED


def test_a_course_knows_the_walls() -> None:
    """The vehicle stops at a wall; a filter that did not know would find it off its course."""
    uav = Vehicle(0.5, width=21.0)
    codes = {uav.fly((U_A, 0.1)) for _ in range(300)}
    assert codes == {CERTIFIED}
    assert uav.state[0] == 21.0
