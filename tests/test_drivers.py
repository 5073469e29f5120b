"""Drivers of the UGV: each keeps its bounds for any input, and its own properties."""

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agents.drivers.compiled import (
    CompiledDriver,
    NavigateDriver,
)
from agents.drivers.parameters import driver_parameters
from agents.drivers.policy import PolicyDriver
from agents.drivers.teleop import TeleopDriver
from agents.ugv import Driver
from bus.errors import ScenarioError
from bus.messages.ground import MapUpdate, UgvGround
from bus.messages.scenario import Area, Limits, ScriptStep
from bus.messages.vehicle import (
    RelativeInformation,
    Teleoperation,
    UgvBriefing,
    UgvCommand,
    UgvObservation,
)
from flights import DT, R_V, U_G, V_A, V_G, distances, ugv_briefing
from outrider.running.flying import fly
from properties import PROPERTY
from seeded import key_text
from sim.models.ground import CLEAR, tile_states
from sim.models.kinematics import (
    DIFFERENTIAL,
    Kinematics,
    UgvState,
    signed_speed,
    step_ugv,
    wrapped,
)
from sim.models.vehicles import step_vehicle
from sim.scenario.loading import load_scenario

Point = tuple[float, float]
Messages = Callable[[int, Point], dict[str, Any]]
"""The messages to a UGV at a tick and position: fields of its observation."""

MIDDLE = (10.0, 10.0)
COMPILED = {
    name: partial(CompiledDriver, name=name) for name in ("waypoints", "wander", "script", "evade")
}
wander, script, evade = (COMPILED[name] for name in ("wander", "script", "evade"))


def _goal(driver: CompiledDriver) -> Point | None:
    """Return the random goal of a wanderer."""
    memory = driver.memory
    return tuple(memory["goal"].tolist()) if memory["has_goal"] else None


SCRIPT = (ScriptStep(time=1.0, velocity=(1e6, -1e6)), ScriptStep(time=7.0, velocity=(-0.1, 0.05)))


def _briefing(
    *, v_max: float = V_G, u_max: float = U_G, side: float = 20.0, key: int = 7, **fields: Any
) -> UgvBriefing:
    speed, acceleration = (None if math.isinf(bound) else bound for bound in (v_max, u_max))
    return ugv_briefing(
        area=Area(width=side, height=side, cell=0.5),
        limits=Limits(max_speed=speed, max_acceleration=acceleration),
        key=key_text(key),
        **{"script": SCRIPT} | fields,
    )


def _wild(observation: UgvObservation, _context: UgvBriefing) -> list[float]:
    """Return arbitrarily large accelerations."""
    size = 10.0 ** (observation.tick % 300)
    return [size * math.cos(observation.tick), -size * math.sin(7 * observation.tick)]


GROUND = UgvGround(tile=0.5, sensing_range=0.75, caution="cautious", rough_speed_share=0.4)


def _on_clear_ground(briefed: UgvBriefing) -> NavigateDriver:
    driver = NavigateDriver(msgspec.structs.replace(briefed, ground=GROUND))
    driver.ground.tiles[:] = CLEAR
    return driver


DRIVERS: dict[str, Callable[[UgvBriefing], Driver]] = COMPILED | {
    "navigate": _on_clear_ground,
    "teleop": TeleopDriver,
    "policy": partial(PolicyDriver, policy=_wild, name="tests:_wild"),
}


def _observe(tick, state, received, dt=DT):
    own = {"position": (state[0], state[1]), "velocity": (state[2], state[3])}
    return UgvObservation(tick=tick, time=tick * dt, **own, **received)


def _drive(
    driver, count, *, start=MIDDLE, velocity=(0.0, 0.0), begin=0, dt=DT, receives=lambda *_: {}
):
    """Return position, velocity and command at each tick, limited only by the driver, and its observations."""
    state, rows, seen = (*start, *velocity), [], []
    for tick in range(begin, begin + count):
        seen.append(_observe(tick, state, receives(tick, state[:2]), dt))
        u = driver.drive(seen[-1])
        rows.append((*state, *u))
        *state, _, _ = step_vehicle(*state, *u, math.inf, math.inf, dt)
    rows.append((*state, 0.0, 0.0))
    return np.array(rows), seen


anywhere = st.floats(-1e6, 1e6, allow_nan=False)
anything = st.tuples(anywhere, anywhere)
goals = st.none() | anything | st.just(MIDDLE)
drives = st.builds(
    Teleoperation, operator=st.just("somebody"), velocity=st.none() | anything, goal=goals
)
places = st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 20.0))
relatives = st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0)) | anything
radios = st.builds(
    RelativeInformation,
    time=st.floats(0.0, 30.0) | st.floats(0.0, 1e12),
    relative_position=relatives,
    coverage_error=st.just(1.0),
)
received_at_once = st.fixed_dictionaries(
    {
        "operator": st.lists(drives, max_size=2).map(tuple),
        "radio": st.lists(radios, max_size=2).map(tuple),
    }
)
receptions = st.dictionaries(st.integers(0, 59), received_at_once, max_size=25)
speeds = st.sampled_from((0.05, V_G, 1.0, 5.0))
accelerations = st.sampled_from((0.05, U_G, 1.0, 10.0, math.inf))
steps = st.sampled_from((0.02, DT, 0.2))
headings = st.tuples(st.floats(0.0, 1.0), st.floats(0.0, math.tau))


def _velocity(heading: tuple[float, float], v_max: float) -> Point:
    return heading[0] * v_max * math.cos(heading[1]), heading[0] * v_max * math.sin(heading[1])


@pytest.mark.parametrize("name", DRIVERS)
@given(receptions, places, headings, st.integers(0, 100_000), speeds, accelerations, steps)
@settings(PROPERTY, max_examples=60)
def test_drivers_keep_the_bounds_whatever_they_observe(
    name, received, start, heading, begin, v_max, u_max, dt
) -> None:
    driver = DRIVERS[name](_briefing(v_max=v_max, u_max=u_max, dt=dt))
    initial = {"start": start, "velocity": _velocity(heading, v_max), "begin": begin, "dt": dt}
    rows, _ = _drive(driver, 60, **initial, receives=lambda tick, _: received.get(tick - begin, {}))
    assert np.isfinite(rows).all()
    assert np.hypot(rows[:, 4], rows[:, 5]).max() <= u_max * (1.0 + 1e-12)
    assert np.hypot(rows[:, 2], rows[:, 3]).max() <= v_max * (1.0 + 1e-12)


@pytest.mark.parametrize("name", [name for name in DRIVERS if name != "waypoints"])
@given(receptions, st.sampled_from((V_G, math.inf)))
@settings(PROPERTY, max_examples=30)
def test_unbounded_ugv_gets_commands_a_message_can_hold(name, received, v_max):
    driver = DRIVERS[name](_briefing(v_max=v_max, u_max=math.inf))
    for tick in range(60):
        seen = _observe(tick, (*MIDDLE, 0.1, -0.1), received.get(tick, {}))
        command = UgvCommand(tick=tick, acceleration=driver.drive(seen))
        assert msgspec.json.decode(msgspec.json.encode(command), type=UgvCommand) == command


@pytest.mark.parametrize("name", DRIVERS)
@given(receptions, st.integers(0, 1000))
@settings(PROPERTY, max_examples=20)
def test_driver_briefed_with_its_past_gives_the_same_bits(name, received, begin):
    briefed = _briefing(v_max=1.0, u_max=0.5)
    first, other, again = (DRIVERS[name](briefed) for _ in range(3))
    rows, seen = _drive(
        first, 150, begin=begin, receives=lambda tick, _: received.get((tick - begin) % 60, {})
    )
    for row, observation in zip(rows, seen, strict=False):
        elsewhere = _observe(observation.tick, (1.0, 19.0, -0.3, 0.3), {})
        other.drive(elsewhere)  # another vehicle of the same process
        assert again.drive(observation) == (row[4], row[5])


# parameters


@pytest.mark.parametrize("name", ["teleop", "external", "nobody"])
def test_a_driver_without_a_compiled_form_is_refused_in_one_line(name: str) -> None:
    allowed = "waypoints, wander, script, evade, navigate"
    phrase = rf"^driver = '{name}': has no compiled form; allowed: {allowed}$"
    with pytest.raises(ScenarioError, match=phrase):
        driver_parameters(_briefing(), name)


def test_an_area_of_too_many_tiles_is_refused_in_one_line() -> None:
    phrase = r"^ground.tile = 0.5: divides .* 36,000,000 tiles; allowed: at most 1,000,000$"
    with pytest.raises(ScenarioError, match=phrase):
        NavigateDriver(ugv_briefing(area=Area(width=1e6, height=9.0, cell=0.5), ground=GROUND))


def test_map_updates_are_recorded_row_by_row() -> None:
    driver, letters = NavigateDriver(_briefing(ground=GROUND)), ".#~." * 16
    update = MapUpdate(column=1, row=2, tiles="#" + letters[1:])
    driver.drive(_observe(0, (*MIDDLE, 0.0, 0.0), {"map_updates": (update,)}))
    expected = np.zeros_like(driver.ground.tiles)
    expected[16:24, 8:16] = tile_states(update.tiles).reshape(8, 8)
    np.testing.assert_array_equal(driver.ground.tiles, expected)


# teleop

FULL = Teleoperation(operator="somebody", velocity=(V_G, 0.0))


def _once(*messages: Teleoperation, at: int = 0) -> Messages:
    """Return the messages of an operator at one tick."""
    return lambda tick, _: {"operator": messages} if tick == at else {}


def _ticks_to_rest(v_max: float, u_max: float, dt: float) -> int:
    return math.ceil(v_max / (u_max * dt) - 1e-9) + 1


timeouts = st.sampled_from((0.0, 0.4, 1.0))


@given(st.lists(drives, min_size=1, max_size=3), headings, speeds, accelerations, steps, timeouts)
@settings(PROPERTY)
def test_ugv_stops_when_the_operator_falls_silent(
    messages, heading, v_max, u_max, dt, timeout
) -> None:
    driver = TeleopDriver(_briefing(v_max=v_max, u_max=u_max, dt=dt, command_timeout=timeout))
    still = 1 + round(timeout / dt) + _ticks_to_rest(v_max, u_max, dt)
    moving = {"velocity": _velocity(heading, v_max), "dt": dt}
    rows, _ = _drive(driver, still + 50, **moving, receives=_once(*messages))
    assert np.abs(rows[still:, 2:4]).max() <= 1e-12 * v_max
    assert np.ptp(rows[still:, :2], axis=0).max() <= 1e-9


def test_teleoperation_expires_at_the_exact_tick() -> None:
    for since in range(60):  # tick * dt rounds differently at each tick
        driver = TeleopDriver(_briefing(command_timeout=0.5))
        receives = _once(FULL, at=since)
        rows, _ = _drive(driver, 20, velocity=(0.1, 0.0), begin=since, receives=receives)
        assert (rows[:11, 4] > 0.0).all()
        assert rows[11, 4] == pytest.approx(-U_G, rel=1e-9)


@given(drives, drives)
@settings(PROPERTY)
def test_newest_teleoperation_counts(old: Teleoperation, new: Teleoperation) -> None:
    both, one = TeleopDriver(_briefing()), TeleopDriver(_briefing())
    for tick in range(3):
        state = (*MIDDLE, 0.05, 0.1)
        first = both.drive(_observe(tick, state, {"operator": (old, new)} if tick == 0 else {}))
        assert first == one.drive(_observe(tick, state, {"operator": (new,)} if tick == 0 else {}))


@given(anything)
@settings(PROPERTY)
def test_excessive_velocity_is_clipped_in_its_direction(wanted: Point) -> None:
    message = Teleoperation(operator="somebody", velocity=wanted)
    rows, _ = _drive(
        TeleopDriver(_briefing()), 100, receives=lambda tick, _: {"operator": (message,)}
    )
    scale = min(1.0, V_G / max(math.hypot(*wanted), 1e-300))
    assert rows[-1, 2:4] == pytest.approx((wanted[0] * scale, wanted[1] * scale), abs=1e-12)


@pytest.mark.parametrize("speed", [0.2, -0.2])
def test_a_differential_drive_slows_down_to_drive_the_wanted_curve(speed: float) -> None:
    """The wheels are too slow for this speed and this turn rate together: 0.2 + 0.5 * 0.4 * 1.0 m/s."""
    driver = TeleopDriver(_briefing(u_max=1.0, kinematics="differential", track=0.4))
    message = Teleoperation(operator="somebody", speed=speed, turn_rate=1.0)
    cart, state = Kinematics(DIFFERENTIAL, track=0.4), UgvState(*MIDDLE, 0.0, 0.0, 0.0)
    for tick in range(40):
        seen = _observe(tick, state[:4], {"operator": (message,), "heading": state.heading})
        before, state = (
            state,
            step_ugv(cart, state, *driver.drive(seen), (V_G, 1.0), V_G, DT),
        )
    assert signed_speed(state) == pytest.approx(0.5 * speed)
    assert wrapped(state.heading - before.heading) / DT == pytest.approx(0.5)


@given(places)
@settings(PROPERTY, max_examples=20)
def test_a_living_operators_goal_is_reached_and_stood_on(goal: Point) -> None:
    message = Teleoperation(operator="somebody", goal=goal)
    receives = lambda tick, _: {"operator": (message,)} if tick % 8 == 0 else {}  # noqa: E731
    rows, _ = _drive(TeleopDriver(_briefing(v_max=1.0, u_max=0.5)), 600, receives=receives)
    assert rows[-1, :2] == pytest.approx(goal, abs=1e-3)


def test_missing_operator_and_empty_teleoperation_both_brake() -> None:
    for messages in ((), (Teleoperation(operator="somebody"),)):
        receives = _once(*messages)
        rows, _ = _drive(TeleopDriver(_briefing()), 80, velocity=(V_G, 0.0), receives=receives)
        assert np.abs(rows[-30:, 2:4]).max() <= 1e-15
        assert rows[-1, 0] - MIDDLE[0] == pytest.approx(V_G**2 / (2.0 * U_G), abs=V_G * DT)


# script


def _script(*steps: tuple[float, Point], **fields: Any) -> CompiledDriver:
    return script(
        _briefing(script=tuple(ScriptStep(time=time, velocity=v) for time, v in steps), **fields)
    )


def test_script_brakes_before_its_first_step_and_holds_its_last() -> None:
    rows, _ = _drive(_script((3.0, (0.0, 0.1)), (6.0, (0.1, 0.0))), 400, velocity=(V_G, 0.0))
    assert rows[41:60, 2:4] == pytest.approx(0.0, abs=1e-15)
    assert rows[60, 5] == pytest.approx(U_G)
    assert rows[100, 2:4] == pytest.approx((0.0, 0.1))
    assert rows[119, 4] == pytest.approx(0.0, abs=1e-12)
    assert rows[120, 4] > 0.05
    assert rows[-1, 2:4] == pytest.approx((0.1, 0.0))


@pytest.mark.parametrize("dt", [0.02, DT, 0.03])
def test_a_step_begins_at_the_first_tick_of_its_time(dt: float) -> None:
    for tick in range(1, 400):
        # as computed, and as written by a person, which may be a bit later
        for time in (tick * dt, round(tick * dt, 9)):
            driver = _script((time, (V_G, 0.0)), dt=dt)
            seen = (_observe(k, (*MIDDLE, 0.0, 0.0), {}, dt) for k in (tick - 1, tick))
            before, after = map(driver.drive, seen)
            assert before == (0.0, 0.0)
            assert after[0] > 0.0


@given(st.lists(st.tuples(st.floats(0.0, 10.0), anything), max_size=5), st.integers(0, 300))
@settings(PROPERTY)
def test_script_started_late_is_at_its_scheduled_step(steps, tick):
    late, whole = _script(*steps), _script(*steps)
    for k in range(tick):
        whole.drive(_observe(k, (*MIDDLE, 0.0, 0.0), {}))
    now = _observe(tick, (*MIDDLE, 0.1, 0.1), {})
    assert late.drive(now) == whole.drive(now)


# wander


@given(st.integers(0, 2**53 - 1), speeds, accelerations, steps, st.sampled_from((2.0, 20.0)))
@settings(PROPERTY, max_examples=40)
def test_a_wanderer_never_comes_to_the_border(key, v_max, u_max, dt, side):
    driver = wander(_briefing(key=key, v_max=v_max, u_max=u_max, dt=dt, side=side))
    rows, _ = _drive(driver, 1500, start=(side / 2, side / 2), dt=dt)
    assert rows[:, :2].min() > 0.0
    assert rows[:, :2].max() < side


@given(st.integers(0, 2**53 - 1))
@settings(PROPERTY, max_examples=10)
def test_a_wanderer_reaches_one_goal_after_the_other(key: int) -> None:
    driver = wander(_briefing(key=key, v_max=1.0, u_max=0.5))
    goals: list[Point | None] = []

    def record_goal(_tick: int, _place: Point) -> dict[str, Any]:
        goals.append(_goal(driver))
        return {}

    rows, _ = _drive(driver, 6000, receives=record_goal)
    assert np.hypot(rows[:, 2], rows[:, 3]).max() == pytest.approx(1.0, rel=1e-9)
    changes = [_tick for _tick, (a, b) in enumerate(pairwise(goals)) if a != b]
    assert len(changes) > 10
    for _tick in changes[1:]:
        goal = goals[_tick]
        assert math.dist(rows[_tick, :2], goal) < 0.05
        assert min(*goal, 20.0 - goal[0], 20.0 - goal[1]) >= driver.parameters.margin


def test_wander_keys_give_other_paths_over_the_whole_area() -> None:
    goals = []
    for key in range(400):
        driver = wander(_briefing(key=key))
        driver.drive(_observe(0, (*MIDDLE, 0.0, 0.0), {}))
        goals.append(_goal(driver))
    places = np.array(goals)
    assert len(set(goals)) == 400
    assert places.min(axis=0) == pytest.approx((0.5, 0.5), abs=0.5)
    assert places.max(axis=0) == pytest.approx((19.5, 19.5), abs=0.5)
    assert abs(np.corrcoef(places.T)[0, 1]) < 0.2


# evade


def _shadowed(place: Callable[[float], Point]) -> Messages:
    """Return radio messages of a UAV on a known trajectory, five per second and a tick late."""

    def receives(tick: int, at: Point) -> dict[str, Any]:
        if tick % 4 != 1:
            return {}
        time = (tick - 1) * DT
        x, y = place(time)
        here = {"time": time, "relative_position": (x - at[0], y - at[1])}
        return {"radio": (RelativeInformation(**here, coverage_error=1.0),)}

    return receives


@pytest.mark.parametrize(("start", "speed"), [(9.0, -0.6), (7.0, 0.6)], ids=["leaves", "comes"])
def test_evader_reverses_only_while_the_uav_approaches_fast(start: float, speed: float) -> None:
    receives = _shadowed(lambda t: (start + speed * t, 10.0))
    rows, _ = _drive(evade(_briefing()), 160, receives=receives)  # before its first sharp turn
    if speed < 0.0:
        assert rows[-1, 2:4] == pytest.approx((V_G, 0.0), abs=1e-3)
    else:
        assert rows[15, 2] > 0.02  # no information about the UAV's speed yet
        assert rows[130:, 2].max() < -0.95 * V_G


def test_evader_accounts_for_its_movement_since_the_message() -> None:
    commands, velocity = [], np.array((0.1, -0.1))
    for age in (0, 8):
        before = MIDDLE - age * DT * velocity
        place = tuple(((11.0, 10.5) - before).tolist())
        sent = RelativeInformation(
            time=(20 - age) * DT, relative_position=place, coverage_error=1.0
        )
        observation = _observe(20, (*MIDDLE, *velocity.tolist()), {"radio": (sent,)})
        commands.append(evade(_briefing()).drive(observation))
    assert commands[0] == pytest.approx(commands[1], abs=1e-12)


def test_message_time_between_ticks_is_ignored() -> None:
    near = _shadowed(lambda t: (11.0, 10.0))

    def with_more(tick: int, at: Point) -> dict[str, Any]:
        wrong = RelativeInformation(
            time=(tick + 0.5) * DT, relative_position=(0.0, 3.0), coverage_error=1.0
        )
        return {"radio": (wrong, *near(tick, at).get("radio", ()), wrong)}

    plain, _ = _drive(evade(_briefing()), 200, receives=near)
    disturbed, _ = _drive(evade(_briefing()), 200, receives=with_more)
    assert disturbed.tobytes() == plain.tobytes()


def test_it_turns_off_sharply_now_and_then_when_its_key_says() -> None:
    turns, receives = [], _shadowed(lambda t: (499.0, 500.0))
    for key in (1, 2, 3):
        driver = evade(_briefing(key=key, side=1000.0))
        rows, _ = _drive(driver, 2000, start=(500.0, 500.0), receives=receives)
        size = np.hypot(*rows[:-1, 4:6].T)
        turns.append(np.flatnonzero((size[:-1] < 0.02) & (size[1:] > 0.09)).tolist())
        assert 5 <= len(turns[-1]) <= 15
    assert turns[0] != turns[1] != turns[2] != turns[0]


sides, stops = st.sampled_from((4.0, 20.0)), st.sampled_from((0.05, U_G, 1.0, 10.0))
SLIDING = ((8.5, 16.0), (0.0, 0.0), 1.0, 0.05, 7, 20.0)  # it still drives at the wall


@given(places, headings, speeds, stops, st.integers(0, 2**53 - 1), sides)
@example(*SLIDING)
@settings(PROPERTY, max_examples=40)
def test_it_neither_runs_into_the_border_nor_gets_stuck_there(
    uav: Point, circling: tuple[float, float], v_max: float, u_max: float, key: int, side: float
) -> None:
    driver = evade(_briefing(v_max=v_max, u_max=u_max, key=key, side=side))
    share, phase = circling
    speed = wander(_briefing(v_max=v_max, u_max=u_max, side=side)).parameters.speed
    x, y = uav[0] * side / 20.0, uav[1] * side / 20.0
    receives = _shadowed(
        lambda t: (x + share * math.cos(phase + 0.5 * t), y + share * math.sin(phase + 0.5 * t))
    )
    rows, _ = _drive(driver, 2500, start=(side / 2, side / 2), receives=receives)
    assert rows[:, :2].min() >= 0.0
    assert rows[:, :2].max() <= side
    lasting = min(2500, math.ceil(20.0 * speed / u_max / DT) + 200)
    pace = np.hypot(rows[:, 2], rows[:, 3])
    assert min(pace[k : k + lasting].max() for k in range(0, 2501 - lasting, 50)) > 0.5 * speed


def test_evader_wanders_while_the_uav_is_silent() -> None:
    receives = _shadowed(lambda t: (9.0, 10.0))
    evader, wanderer = evade(_briefing()), wander(_briefing())
    for tick in range(300):
        state = (*MIDDLE, 0.05, 0.0)
        received = receives(tick, MIDDLE) if 100 <= tick < 150 else {}
        alone = wanderer.drive(_observe(tick, state, {}))
        same = evader.drive(_observe(tick, state, received)) == alone
        assert same == (tick < 101 or tick > 149 + 100)  # exactly five seconds


@pytest.mark.parametrize("law", ["logarithmic"])
def test_evader_gets_further_away_and_exceeds_r_v_by_one_tick(law: str) -> None:
    clear = {"law.name": law, "detections.noise": 0.0, "detections.dropout": 0.0}
    papers, evading = (
        distances(fly(load_scenario("escort", overrides=clear | {"ugv.0.driver": driver}), 7)[0])
        for driver in ("waypoints", "evade")
    )
    # (18) is continuous in time, but r_s is crossed between two ticks
    assert papers.max() < evading.max() < R_V + (V_A + V_G) * DT
