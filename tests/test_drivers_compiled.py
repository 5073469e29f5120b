"""The compiled drivers: what they are told. What they drive is in `test_drivers` and `test_closed_loop`."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from flights import DT, U_G, V_G, told_ugv

from agents.drivers.compiled import CompiledDriver, driver_parameters, told_route
from agents.drivers.parameters import COMPILED_DRIVERS, WAYPOINTS
from bus.errors import ScenarioError
from bus.messages import (
    Area,
    Limits,
    RelativeInformation,
    ScriptStep,
    UgvBriefing,
    UgvGround,
    UgvObservation,
)
from bus.registry import DRIVERS, resolve

CALM, PAPERS = (0.2, 0.02), (V_G, U_G)

BRIEFING = told_ugv(
    area=Area(width=12.0, height=9.0, cell=0.5),
    goals=((3.0, 4.0), (11.0, 1.0), (11.1, 1.0), (6.0, 8.0)),
    script=(
        ScriptStep(time=30.0, velocity=(-0.1, 0.05)),
        ScriptStep(time=1.0, velocity=(1e6, -1e6)),
        ScriptStep(time=30.0, velocity=(0.1, 0.2)),
        ScriptStep(time=77.05, velocity=(-1.0, 0.0)),
    ),
)


def _told(bounds: tuple[float | None, float | None] = PAPERS, **fields: Any) -> UgvBriefing:
    return msgspec.structs.replace(
        BRIEFING, limits=Limits(max_speed=bounds[0], max_acceleration=bounds[1]), **fields
    )


@pytest.mark.parametrize("bounds", [CALM, PAPERS, (None, None)], ids=str)
def test_the_wanderers_goals_keep_its_margin(bounds: tuple[float | None, float | None]) -> None:
    told = _told(bounds)
    driver, u_max = CompiledDriver(told, "wander"), told.limits.max_acceleration or 1e6
    speed, margin = driver.parameters.speed, driver.parameters.margin
    assert margin == pytest.approx(speed**2 / u_max + 2.0 * speed * DT, rel=1e-12)
    assert driver.goal is None
    driver.drive(UgvObservation(tick=0, time=0.0, position=(6.0, 4.0), velocity=(0.0, 0.0)))
    assert min(*driver.goal, 12.0 - driver.goal[0], 9.0 - driver.goal[1]) >= margin


# parameters


def test_every_driver_of_ours_but_the_operators_has_a_compiled_form() -> None:
    ours = {row.name for row in DRIVERS.values() if row.make and not row.operated}
    assert COMPILED_DRIVERS.keys() == ours


@pytest.mark.parametrize("name", ["teleop", "policy", "external", "nobody", ""])
def test_a_driver_without_a_compiled_form_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(
        ScenarioError,
        match=rf"^driver = '{name}': has no compiled form; allowed: waypoints, wander, script, evade, navigate$",
    ):
        driver_parameters(BRIEFING, name)


def test_an_area_of_too_many_tiles_is_refused_in_one_line() -> None:
    ground = UgvGround(tile=0.5, bumper=0.75, caution="cautious", share=0.4)
    wide = _told(area=Area(width=1e6, height=9.0, cell=0.5), ground=ground)
    with pytest.raises(
        ScenarioError,
        match=r"^ground.tile = 0.5: makes 3.6e\+07 tiles of the area; at most 1,000,000$",
    ):
        resolve(DRIVERS["navigate"].make)(wide)


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
    drivers = [CompiledDriver(BRIEFING, "evade") for _ in range(2)]
    for tick in range(40):
        said = [0.05 * (tick + 0.4)] if tick == 20 else []
        radio = tuple(
            RelativeInformation(time=time, relative_position=(1.0, 0.5), coverage_error=1.0)
            for time in said
        )
        seen = UgvObservation(tick=tick, time=tick * DT, position=(6.0, 4.0), velocity=(0.0, 0.0))
        received = msgspec.structs.replace(seen, radio=radio)
        assert drivers[0].drive(seen) == drivers[1].drive(received)
