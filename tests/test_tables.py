"""The registry: every row has an implementation."""

from importlib import import_module

import msgspec
import numpy as np
import pytest

from agents.drivers.dispatch import CODES
from bus.keys import KEYS, Key
from bus.messages.scenario import ScriptStep
from bus.registry import (
    SENSORS,
)
from outrider.running.flying import fly
from sim.models.sensor import SensorParameters, sensor_quality, sensor_slope
from sim.scenario.loading import load_scenario

TRACKS: dict[str, bytes] = {}
"""Track of the UGV by driver."""


@pytest.mark.parametrize("name", CODES)
def test_every_compiled_driver_drives_differently(name: str) -> None:
    """A row without its branch would drive like another one."""
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


def test_every_key_is_in_the_table_of_keys() -> None:
    rows = {name: row for name, row in vars(import_module("bus.keys")).items() if type(row) is Key}
    assert sorted(rows.values(), key=repr) == sorted(KEYS, key=repr)
