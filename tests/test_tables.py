"""Tables of names that stand in two packages because one may not import the other: each is held equal to its twin."""

from typing import get_args

from agents.control.laws import LAWS
from agents.control.orbit import largest_circle_rate
from agents.control.visibility import switching_radius
from agents.drivers.table import DRIVERS
from outrider.cli import options
from outrider.running.user_code import SAVED
from sim.channel.profiles import PROFILES
from sim.models.field import SENSORS
from sim.scenario import checks
from sim.scenario.types import load_scenario


def test_a_scenario_may_name_every_law_driver_and_sensor_that_there_is_and_no_other() -> None:
    assert tuple(LAWS) == checks.LAW_NAMES
    assert (*DRIVERS, "policy", "external") == checks.DRIVER_NAMES
    assert tuple(SENSORS) == checks.SENSOR_NAMES
    assert tuple(SAVED) == checks.SAVED_POLICIES


def test_every_table_gives_each_row_a_code_of_its_own() -> None:
    assert len(set(LAWS.values())) == len(LAWS)
    assert len(set(SENSORS.values())) == len(SENSORS)


def test_the_command_line_tells_every_law_and_driver() -> None:
    law, driver, network, policy = (
        get_args(option)[1].help
        for option in (options.LawName, options.DriverName, options.NetworkName, options.PolicyName)
    )
    assert all(name in network for name in PROFILES)
    assert all(f"{name}:" in policy for name in checks.SAVED_POLICIES)
    assert all(name in law for name in LAWS)
    assert all(name in driver for name in checks.DRIVER_NAMES)


def test_the_circle_warning_names_the_bound_of_the_law() -> None:
    scenario = load_scenario("circle-too-fast")
    uav, ugv = scenario.uav[0], scenario.ugv[0]
    r_s = switching_radius(
        scenario.visibility.radius, uav.max_speed, ugv.max_speed, uav.max_acceleration
    )
    bound = largest_circle_rate(r_s, uav.max_speed, ugv.max_speed, uav.max_acceleration)
    (line,) = checks.scenario_warnings(scenario)
    assert f"{bound:.4f} rad/s" in line
