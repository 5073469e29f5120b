"""The registry: every row can be flown."""

from importlib import import_module
from typing import get_args

import msgspec
import numpy as np
import pytest

from agents.control.laws import OwnTerms, weights
from agents.drivers.parameters import COMPILED_DRIVERS
from bus.keys import KEYS, Key
from bus.messages import LinkKind, ScriptStep
from bus.profiles import PROFILES
from bus.registry import (
    DEFAULT_DRIVER,
    DEFAULT_LAW,
    DEFAULT_SENSOR,
    DRIVERS,
    LAWS,
    SENSORS,
    TELEOP,
    LawRow,
    _table,
    resolve,
)
from flights import escort, parameters
from outrider.cli import options
from outrider.running.flying import fly
from sim.models.field import sensor_quality, sensor_slope
from sim.scenario.loading import load_scenario
from sim.scenario.types import Custom, LinkTable, Ugv, VehicleLinks

TRACKS: dict[str, bytes] = {}
"""Track of the UGV by driver."""


def test_two_rows_of_one_name_or_code_are_refused() -> None:
    one, other = LAWS["linear"], LAWS["switching"]
    with pytest.raises(ValueError, match="the same name"):
        _table(one, LawRow(name=one.name, code=99, about="", color="#000000"))
    with pytest.raises(ValueError, match="the same code"):
        _table(one, LawRow(name="new", code=other.code, about="", color="#000000"), other)


def test_the_defaults_are_rows() -> None:
    assert DEFAULT_LAW in LAWS
    assert DEFAULT_SENSOR in SENSORS
    assert {DEFAULT_DRIVER, TELEOP} <= set(DRIVERS)
    assert [row.name for row in DRIVERS.values() if row.operated] == [TELEOP]


@pytest.mark.parametrize("name", LAWS)
def test_every_law_has_its_branch(name: str) -> None:
    alpha, beta = weights(parameters(escort(name)), OwnTerms(), 1.0)
    assert np.isfinite([alpha, beta]).all()
    assert LAWS[name].covers or beta == 0.0


def test_a_row_without_its_branch_flies_no_other_law() -> None:
    missing = parameters(escort("linear"))._replace(law=1 + max(row.code for row in LAWS.values()))
    assert np.isnan(weights(missing, OwnTerms(), 1.0)).all()


@pytest.mark.parametrize("name", COMPILED_DRIVERS)
def test_every_compiled_driver_drives_differently(name: str) -> None:
    """A row without its branch would drive as another one."""
    scenario = load_scenario("escort", overrides=["duration=8.0"])
    ugv = msgspec.structs.replace(
        scenario.ugv[0], driver=name, script=(ScriptStep(time=0.0, velocity=(0.05, 0.1)),)
    )
    flight, _ = fly(msgspec.structs.replace(scenario, ugv=(ugv,)), 3)
    track = flight.recorder.states[:, 1, :2].tobytes()
    assert np.hypot(*flight.world.velocity[1]) > 0.0
    TRACKS[name] = track
    alike = {one for one, other in TRACKS.items() if other == track}
    assert alike <= {name} | (
        {"navigate", "waypoints"} if name in ("navigate", "waypoints") else set()
    )


@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_has_its_branches(name: str) -> None:
    code, h = SENSORS[name].code, 1e-6
    rise = (sensor_quality(code, 4.0 + h, 1.0, 5.0) - sensor_quality(code, 4.0 - h, 1.0, 5.0)) / (
        2.0 * h
    )
    assert rise == pytest.approx(sensor_slope(code, 4.0, 1.0, 5.0), rel=1e-6)
    others = {row.code for row in SENSORS.values()} - {code}
    assert all(
        sensor_quality(code, 4.0, 1.0, 5.0) != sensor_quality(other, 4.0, 1.0, 5.0)
        for other in others
    )


@pytest.mark.parametrize(
    "where",
    [row.make for row in DRIVERS.values() if row.make],
)
def test_every_row_names_code_that_is_there(where: str) -> None:
    assert callable(resolve(where))


def test_every_field_that_a_row_names_is_one() -> None:
    own = {row.own for row in (*LAWS.values(), *DRIVERS.values()) if row.own}
    tasks = {task for row in DRIVERS.values() for task in (row.needs, row.wants) if task}
    assert own == set(Custom.__struct_fields__)
    assert tasks <= set(Ugv.__struct_fields__)


def test_every_key_is_in_the_table_of_keys() -> None:
    rows = {name: row for name, row in vars(import_module("bus.keys")).items() if type(row) is Key}
    assert sorted(rows.values(), key=repr) == sorted(KEYS, key=repr)


def test_every_kind_of_link_has_its_field_in_a_scenario() -> None:
    kinds = {str(kind) for kind in LinkKind}
    assert kinds | {"only", "traces"} == set(LinkTable.__struct_fields__)
    assert kinds | {"vehicle"} == set(VehicleLinks.__struct_fields__)


def test_the_command_line_tells_every_law_driver_and_profile_with_its_line() -> None:
    law, driver, network = (
        get_args(option)[1].help
        for option in (options.LawName, options.DriverName, options.NetworkName)
    )
    assert all(name in network for name in PROFILES)
    assert all(f"{row.name}: {row.about}" in law for row in LAWS.values())
    assert all(f"{row.name}: {row.about}" in driver for row in DRIVERS.values())
