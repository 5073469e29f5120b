"""The registry: every row can be flown."""

from importlib import import_module
from typing import get_args

import msgspec
import numpy as np
import pytest

from agents.drivers.dispatch import CODES
from bus.keys import KEYS, Key
from bus.messages.links import LinkKind
from bus.messages.scenario import ScriptStep
from bus.profiles import PROFILES
from bus.registry import (
    DEFAULT_DRIVER,
    DEFAULT_LAW,
    DEFAULT_SENSOR,
    DRIVERS,
    LAWS,
    SENSORS,
    TELEOP,
    _table,
    resolve,
)
from bus.rows import LawRow
from outrider.cli import options
from outrider.running.flying import fly
from sim.models.sensor import SensorParameters, sensor_quality, sensor_slope
from sim.scenario.loading import load_scenario
from sim.scenario.types import Custom, LinkTable, Ugv, VehicleLinks

TRACKS: dict[str, bytes] = {}
"""Track of the UGV by driver."""


def test_two_rows_of_one_name_are_refused() -> None:
    one = LAWS["linear"]
    with pytest.raises(ValueError, match="the same name"):
        _table(one, LawRow(name=one.name, about="", color="#000000"))


def test_the_defaults_are_rows() -> None:
    assert DEFAULT_LAW in LAWS
    assert DEFAULT_SENSOR in SENSORS
    assert {DEFAULT_DRIVER, TELEOP} <= set(DRIVERS)
    assert [row.name for row in DRIVERS.values() if row.operated] == [TELEOP]


@pytest.mark.parametrize("name", CODES)
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
    code, h = tuple(SENSORS).index(name), 1e-6
    sensor = SensorParameters(code, 1.0, 5.0)
    rise = (sensor_quality(sensor, 4.0 + h) - sensor_quality(sensor, 4.0 - h)) / (2.0 * h)
    assert rise == pytest.approx(sensor_slope(sensor, 4.0), rel=1e-6)
    others = set(range(len(SENSORS))) - {code}
    assert all(
        sensor_quality(sensor, 4.0) != sensor_quality(sensor._replace(model=other), 4.0)
        for other in others
    )


@pytest.mark.parametrize(
    "where",
    [f"{row.module}:command" for row in LAWS.values() if row.module]
    + [f"{row.module}:command" for row in DRIVERS.values() if row.module]
    + [row.make for row in DRIVERS.values() if row.make],
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
