"""The compiled drivers: many in a loop of compiled code drive as each alone, and what they are told."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from draws import a_told_key
from flights import DT, U_G, V_G

from agents.drivers.compiled import (
    WanderDriver,
    driver_parameters,
    driver_state,
    told_route,
)
from agents.drivers.parameters import COMPILED_DRIVERS, WAYPOINTS, DriverParameters, Route
from agents.drivers.ugv_tick import ugv_tick
from bus.errors import ScenarioError
from bus.messages import Area, Limits, RelativeInformation, ScriptStep, UgvBriefing, UgvObservation
from bus.registry import DRIVERS, resolve
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, records
from sim.models.vehicles import step_vehicle

TICKS = 3000
START = (6.0, 4.0)
HEARD = 2  # most messages of a tick
CALM, PAPERS = (0.2, 0.02), (V_G, U_G)

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


def _said(area: Area) -> tuple[FloatArray, np.ndarray]:
    """Tick and place of a UAV that circles, as its messages tell them tick by tick, and how many come.

    One at each fourth tick,
    now and then the same one again, and for a while none."""
    said, counts = np.zeros((TICKS, HEARD, 3)), np.zeros(TICKS, dtype=np.int64)
    for k in range(TICKS):
        time = (k - 1) * DT
        x, y = (
            area.width * (0.5 + 0.4 * math.cos(0.11 * time)),
            area.height * (0.6 + 0.3 * math.sin(0.17 * time)),
        )
        if k > 200 and k % 4 == 1 and not 1500 < k < 1800:
            said[k], counts[k] = (k - 1, x, y), 2 if k % 20 == 1 else 1
    return said, counts


@compiled
def _meet_wall(p: float, v: float, size: float) -> tuple[float, float]:
    return (p, v) if 0.0 <= p <= size else (min(max(p, 0.0), size), 0.0)


@compiled
def _fly(
    rows: RecordArray,
    route: Route,
    states: FloatArray,
    said: FloatArray,
    counts: np.ndarray,
    flown: FloatArray,
) -> None:
    """Position, velocity and command at each tick of many UGVs, from the first one's position and velocity."""
    radio = np.zeros((HEARD, 3))
    for world in range(len(rows)):
        c = rows[world]
        p_x, p_y, v_x, v_y = flown[world, 0, 0], flown[world, 0, 1], 0.03, -0.02
        for k in range(flown.shape[1]):
            for m in range(counts[k]):
                radio[m, 0] = said[k, m, 0]
                radio[m, 1], radio[m, 2] = said[k, m, 1] - p_x, said[k, m, 2] - p_y
            u_x, u_y = ugv_tick(c, route, states[world], radio, counts[k], k, p_x, p_y, v_x, v_y)
            row = flown[world, k]
            row[0], row[1], row[2], row[3], row[4], row[5] = p_x, p_y, v_x, v_y, u_x, u_y
            p_x, p_y, v_x, v_y, _, _ = step_vehicle(
                p_x, p_y, v_x, v_y, u_x, u_y, math.inf, math.inf, c.dt
            )
            p_x, v_x = _meet_wall(p_x, v_x, c.width)
            p_y, v_y = _meet_wall(p_y, v_y, c.height)


def _alone(name: str, told: UgvBriefing) -> FloatArray:
    """By the pilot's driver, tick by tick."""
    driver, rows = resolve(DRIVERS[name].make)(told), np.zeros((TICKS, 6))
    said, counts = _said(told.area)
    p_x, p_y, v_x, v_y = *START, 0.03, -0.02
    for k in range(TICKS):
        radio = tuple(
            RelativeInformation(
                time=at * told.dt, relative_position=(x - p_x, y - p_y), coverage_error=1.0
            )
            for at, x, y in said[k, : counts[k]].tolist()
        )
        seen = UgvObservation(
            tick=k, time=k * told.dt, position=(p_x, p_y), velocity=(v_x, v_y), radio=radio
        )
        u_x, u_y = driver.drive(seen)
        rows[k] = p_x, p_y, v_x, v_y, u_x, u_y
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(
            p_x, p_y, v_x, v_y, u_x, u_y, math.inf, math.inf, told.dt
        )
        p_x, v_x = _meet_wall(p_x, v_x, told.area.width)
        p_y, v_y = _meet_wall(p_y, v_y, told.area.height)
    return rows


def test_many_in_one_compiled_loop_drive_as_each_alone() -> None:
    keys = [a_told_key(number) for number in (3, 2**128 - 1)]
    worlds = [(name, key) for name in COMPILED_DRIVERS for key in keys]
    told = [_told(key=key) for _, key in worlds]
    rows = records(
        DriverParameters,
        [driver_parameters(one, name) for (name, _), one in zip(worlds, told, strict=True)],
    )
    states = np.stack([driver_state() for _ in worlds])
    flown = np.zeros((len(worlds), TICKS, 6))
    flown[:, 0, :2] = START
    _fly(rows, told_route(BRIEFING), states, *_said(BRIEFING.area), flown)
    for (name, key), one, found in zip(worlds, told, flown, strict=True):
        assert found.tobytes() == _alone(name, one).tobytes(), (name, key)
        assert np.ptp(found[:, 4]) > 0.0
    assert len({found.tobytes() for found in flown}) == 6  # wander and evade draw on their own keys


@pytest.mark.parametrize("bounds", [CALM, PAPERS, (None, None)], ids=str)
def test_the_wanderers_goals_keep_its_margin(bounds: tuple[float | None, float | None]) -> None:
    told = _told(bounds)
    driver, u_max = WanderDriver(told), told.limits.max_acceleration or 1e6
    speed, margin = driver.parameters.speed, driver.parameters.margin
    assert margin == pytest.approx(speed**2 / u_max + 2.0 * speed * DT, rel=1e-12)
    assert driver.goal is None
    driver.drive(UgvObservation(tick=0, time=0.0, position=(6.0, 4.0), velocity=(0.0, 0.0)))
    assert driver.goal is not None
    assert min(*driver.goal, 12.0 - driver.goal[0], 9.0 - driver.goal[1]) >= margin


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
    goals, script = told_route(told)
    assert (goals.shape, script.shape) == ((len(told.goals), 2), (len(told.script), 3))
    for array in (goals, script):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
    assert [tuple(goal) for goal in goals.tolist()] == [*told.goals]


def test_a_script_is_put_in_order_and_of_two_steps_at_one_time_the_later_stays_last() -> None:
    assert told_route(BRIEFING).script.tolist() == [
        [20, 1e6, -1e6],
        [600, -0.1, 0.05],
        [600, 0.1, 0.2],
        [1541, -1.0, 0.0],
    ]


def test_a_radio_message_of_no_tick_is_not_used() -> None:
    drivers = [resolve(DRIVERS["evade"].make)(BRIEFING) for _ in range(2)]
    for tick in range(40):
        said = [0.05 * (tick + 0.4)] if tick == 20 else []
        radio = tuple(
            RelativeInformation(time=time, relative_position=(1.0, 0.5), coverage_error=1.0)
            for time in said
        )
        seen = UgvObservation(tick=tick, time=tick * DT, position=START, velocity=(0.0, 0.0))
        heard = msgspec.structs.replace(seen, radio=radio)
        assert drivers[0].drive(seen) == drivers[1].drive(heard)
