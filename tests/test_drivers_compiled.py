"""The compiled drivers: in a loop of compiled code each drives as its Python class does, to the bit."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from draws import a_key, a_told_key
from flights import DT, U_G, V_G

from agents.drivers.compiled import (
    COMPILED_DRIVERS,
    DRIVER_STATE,
    EVADE,
    WAYPOINTS,
    DriverParameters,
    begin_driver,
    driver_goals,
    driver_parameters,
    driver_script,
    fresh_driver_state,
    pack_driver,
    ugv_control,
    unpack_driver,
)
from agents.drivers.wander import WanderDriver
from bus.errors import ScenarioError
from bus.messages import Area, Limits, RelativeInformation, ScriptStep, UgvBriefing, UgvObservation
from bus.registry import DRIVERS, resolve
from sim.kernels.compile import FloatArray, compiled
from sim.models.randomness import WordArray, words_of
from sim.models.vehicles import step_vehicle

TICKS = 3000
HEARD = 2  # most messages of a tick
CALM, PAPERS, STRONG = (0.2, 0.02), (V_G, U_G), (2.0, 5.0)

BRIEFING = UgvBriefing(
    vehicle="ugv_0",
    dt=DT,
    area=Area(width=12.0, height=9.0, cell=0.5),
    limits=Limits(max_speed=V_G, max_acceleration=U_G),
    driver="waypoints",
    goals=((3.0, 4.0), (11.0, 1.0), (11.1, 1.0), (6.0, 8.0)),
    goal_tolerance=0.05,
    script=(
        ScriptStep(time=30.0, velocity=(-0.1, 0.05)),
        ScriptStep(time=1.0, velocity=(1e6, -1e6)),
        ScriptStep(time=30.0, velocity=(0.1, 0.2)),
        ScriptStep(time=77.05, velocity=(-1.0, 0.0)),
    ),
    key=a_told_key(7),
)


def _told(bounds: tuple[float | None, float | None] = PAPERS, **fields: Any) -> UgvBriefing:
    return msgspec.structs.replace(
        BRIEFING, limits=Limits(max_speed=bounds[0], max_acceleration=bounds[1]), **fields
    )


def _said(area: Area, *, first: int = 0) -> tuple[FloatArray, np.ndarray]:
    """Time and place of a UAV that circles, as its messages tell them tick by tick, and how many come.

    One at each fourth tick,
    now and then the same one again, and for a while none."""
    said, counts = np.zeros((TICKS, HEARD, 3)), np.zeros(TICKS, dtype=np.int64)
    for k in range(TICKS):
        time = (first + k - 1) * DT
        x, y = (
            area.width * (0.5 + 0.4 * math.cos(0.11 * time)),
            area.height * (0.6 + 0.3 * math.sin(0.17 * time)),
        )
        if k > 200 and k % 4 == 1 and not 1500 < k < 1800:
            said[k], counts[k] = (time, x, y), 2 if k % 20 == 1 else 1
    return said, counts


@compiled
def _meet_wall(p: float, v: float, size: float) -> tuple[float, float]:
    return (p, v) if 0.0 <= p <= size else (min(max(p, 0.0), size), 0.0)


@compiled
def _fly(
    parameters: DriverParameters,
    goals: FloatArray,
    script: FloatArray,
    state: FloatArray,
    said: FloatArray,
    counts: np.ndarray,
    first: int,
    rows: FloatArray,
) -> None:
    """Position, velocity and command at each tick, from the first row's position and velocity."""
    c, radio = parameters, np.zeros((HEARD, 3))
    p_x, p_y, v_x, v_y = rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3]
    for k in range(len(rows)):
        for m in range(counts[k]):
            radio[m, 0], radio[m, 1], radio[m, 2] = (
                said[k, m, 0],
                said[k, m, 1] - p_x,
                said[k, m, 2] - p_y,
            )
        tick = first + k
        u_x, u_y = ugv_control(
            parameters,
            goals,
            script,
            state,
            radio,
            counts[k],
            tick,
            tick * c.dt,
            p_x,
            p_y,
            v_x,
            v_y,
        )
        rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4], rows[k, 5] = (
            p_x,
            p_y,
            v_x,
            v_y,
            u_x,
            u_y,
        )
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(
            p_x, p_y, v_x, v_y, u_x, u_y, math.inf, math.inf, c.dt
        )
        p_x, v_x = _meet_wall(p_x, v_x, c.width)
        p_y, v_y = _meet_wall(p_y, v_y, c.height)


@compiled
def _fly_batch(
    table: FloatArray,
    keys: WordArray,
    goals: FloatArray,
    script: FloatArray,
    state: FloatArray,
    said: FloatArray,
    counts: np.ndarray,
    first: int,
    rows: FloatArray,
) -> None:
    """Many worlds, one after the other with one and the same state array."""
    for world in range(len(table)):
        begin_driver(state)
        _fly(
            unpack_driver(table[world], (keys[world, 0], keys[world, 1])),
            goals,
            script,
            state,
            said,
            counts,
            first,
            rows[world],
        )


def _rows(start: tuple[float, float]) -> FloatArray:
    rows = np.zeros((TICKS, 6))
    rows[0, :4] = (*start, 0.03, -0.02)
    return rows


def _flown(name: str, told: UgvBriefing, start: tuple[float, float], first: int = 0) -> FloatArray:
    """By the Python class."""
    driver, rows, (said, counts) = (
        resolve(DRIVERS[name].make)(told),
        _rows(start),
        _said(told.area, first=first),
    )
    p_x, p_y, v_x, v_y = rows[0, :4].tolist()
    for k in range(TICKS):
        radio = tuple(
            RelativeInformation(time=time, relative_position=(x - p_x, y - p_y), coverage_error=1.0)
            for time, x, y in said[k, : counts[k]].tolist()
        )
        tick = first + k
        seen = UgvObservation(
            tick=tick, time=tick * told.dt, position=(p_x, p_y), velocity=(v_x, v_y), radio=radio
        )
        u_x, u_y = driver.drive(seen)
        rows[k] = p_x, p_y, v_x, v_y, u_x, u_y
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(
            p_x, p_y, v_x, v_y, u_x, u_y, math.inf, math.inf, told.dt
        )
        p_x, v_x = _meet_wall(p_x, v_x, told.area.width)
        p_y, v_y = _meet_wall(p_y, v_y, told.area.height)
    return rows


@pytest.mark.parametrize("name", COMPILED_DRIVERS)
@pytest.mark.parametrize(
    "bounds", [CALM, PAPERS, STRONG, (None, 1.0), (0.5, None), (None, None)], ids=str
)
@pytest.mark.parametrize(
    ("start", "first", "key"),
    [((6.0, 4.0), 0, 7), ((0.1, 8.9), 12345, 2**128 - 1)],
    ids=["middle", "corner"],
)
def test_in_a_compiled_loop_it_drives_as_the_python_class_does(
    name: str,
    bounds: tuple[float | None, float | None],
    start: tuple[float, float],
    first: int,
    key: int,
) -> None:
    told = _told(bounds, key=a_told_key(key))
    rows, state = _rows(start), fresh_driver_state()
    _fly(
        driver_parameters(told, name),
        driver_goals(told),
        driver_script(told),
        state,
        *_said(told.area, first=first),
        first,
        rows,
    )
    assert rows.tobytes() == _flown(name, told, start, first).tobytes()
    assert np.ptp(rows[:, 4]) > 0.0


@pytest.mark.parametrize("name", COMPILED_DRIVERS)
def test_without_goals_or_script_too(name: str) -> None:
    told, rows = _told(goals=(), script=()), _rows((6.0, 4.0))
    state = fresh_driver_state()
    _fly(
        driver_parameters(told, name),
        driver_goals(told),
        driver_script(told),
        state,
        *_said(told.area),
        0,
        rows,
    )
    assert rows.tobytes() == _flown(name, told, (6.0, 4.0)).tobytes()


def test_many_worlds_in_one_compiled_loop_drive_as_each_alone() -> None:
    keys = [a_told_key(number) for number in (3, 2**128 - 1, 123456789)]
    worlds = [(name, key) for name in COMPILED_DRIVERS for key in keys]
    table = np.array([pack_driver(driver_parameters(BRIEFING, name)) for name, _ in worlds])
    rows = np.array([_rows((6.0, 4.0)) for _ in worlds])
    said, counts = _said(BRIEFING.area)
    told = np.array([words_of(key) for _, key in worlds])
    _fly_batch(
        table,
        told,
        driver_goals(BRIEFING),
        driver_script(BRIEFING),
        np.full(DRIVER_STATE, 9.0),
        said,
        counts,
        0,
        rows,
    )
    for (name, key), flown in zip(worlds, rows, strict=True):
        assert flown.tobytes() == _flown(name, _told(key=key), (6.0, 4.0)).tobytes(), (name, key)
    assert (
        len({flown.tobytes() for flown in rows}) == 8
    )  # wander and evade have random numbers of their own


@pytest.mark.parametrize("bounds", [CALM, PAPERS, (None, None)], ids=str)
def test_the_wanderers_goals_are_those_that_the_class_tells(
    bounds: tuple[float | None, float | None],
) -> None:
    told = _told(bounds)
    driver, parameters = WanderDriver(told), driver_parameters(told, "wander")
    assert (parameters.speed, parameters.margin) == (driver.speed, driver.margin)
    u_max = told.limits.max_acceleration or 1e6
    assert driver.margin == pytest.approx(
        driver.speed**2 / u_max + 2.0 * driver.speed * DT, rel=1e-12
    )
    assert driver.goal is None
    driver.drive(UgvObservation(tick=0, time=0.0, position=(6.0, 4.0), velocity=(0.0, 0.0)))
    assert driver.goal is not None
    assert min(*driver.goal, 12.0 - driver.goal[0], 9.0 - driver.goal[1]) >= driver.margin


def test_a_state_that_is_begun_anew_is_a_fresh_one() -> None:
    state = fresh_driver_state()
    assert state.shape == (DRIVER_STATE,)
    _fly(
        driver_parameters(BRIEFING, "evade"),
        driver_goals(BRIEFING),
        driver_script(BRIEFING),
        state,
        *_said(BRIEFING.area),
        0,
        _rows((6.0, 4.0)),
    )
    assert state.tobytes() != fresh_driver_state().tobytes()
    begin_driver(state)
    assert state.tobytes() == fresh_driver_state().tobytes()


# parameters


def test_every_driver_of_ours_but_the_operators_has_a_compiled_form() -> None:
    ours = {row.name for row in DRIVERS.values() if row.make and not row.operated}
    assert COMPILED_DRIVERS.keys() == ours


@pytest.mark.parametrize("name", ["teleop", "policy", "external", "nobody", ""])
def test_a_driver_without_a_compiled_form_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(
        ScenarioError,
        match=rf"^driver = '{name}': has no compiled form; allowed: waypoints, wander, script, evade$",
    ):
        driver_parameters(BRIEFING, name)


@pytest.mark.parametrize("name", COMPILED_DRIVERS)
@pytest.mark.parametrize("bounds", [PAPERS, (None, None), (1, 2)], ids=str)
def test_parameters_are_plain_numbers_and_survive_a_row_of_a_table(
    name: str, bounds: tuple[float | None, float | None]
) -> None:
    parameters = driver_parameters(_told(bounds), name)
    kinds = [int, *[float] * (len(parameters) - 2), tuple]
    assert parameters.driver == COMPILED_DRIVERS[name]
    assert [type(number) for number in parameters] == kinds
    row = pack_driver(parameters)
    assert (row.dtype, row.shape) == (np.float64, (len(parameters) - 1,))
    for key in (parameters.key, a_key(5)):
        again = unpack_driver(row, key)
        assert again == parameters._replace(key=key)
        assert type(again) is DriverParameters
        assert [type(number) for number in again] == kinds


def test_each_number_of_a_row_comes_back_to_its_own_field() -> None:
    numbers = DriverParameters(
        *(EVADE, *(0.5 + place for place in range(len(DriverParameters._fields) - 2)), a_key(9))
    )
    assert unpack_driver(pack_driver(numbers), a_key(9)) == numbers


def test_only_the_papers_driver_knows_no_bound() -> None:
    for name, code in COMPILED_DRIVERS.items():
        parameters = driver_parameters(_told((None, None)), name)
        assert (parameters.v_max, parameters.u_max) == (
            (math.inf, math.inf) if code == WAYPOINTS else (1e6, 1e6)
        )


@pytest.mark.parametrize(
    "change",
    [{}, {"goals": (), "script": ()}, {"goals": ((1, 2),)}],
    ids=["some", "none", "integers"],
)
def test_goals_and_script_are_arrays_that_compiled_code_takes(change: dict[str, Any]) -> None:
    told = _told(**change)
    goals, script = driver_goals(told), driver_script(told)
    assert (goals.shape, script.shape) == ((len(told.goals), 2), (len(told.script), 3))
    for array in (goals, script):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
    assert [tuple(goal) for goal in goals.tolist()] == [*told.goals]


def test_a_script_is_put_in_order_and_of_two_steps_at_one_time_the_later_stays_last() -> None:
    assert driver_script(BRIEFING).tolist() == [
        [1.0, 1e6, -1e6],
        [30.0, -0.1, 0.05],
        [30.0, 0.1, 0.2],
        [77.05, -1.0, 0.0],
    ]
