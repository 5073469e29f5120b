"""The information contract, layers one and two: types and imports. These tests try to break it."""

import re
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest

from bus import keys
from bus.keys import KEYS, Role
from bus.messages.base import Message
from bus.messages.scenario import Law
from bus.messages.vehicle import (
    RelativeInformation,
    UavBriefing,
    UavCommand,
    UavObservation,
    UgvBriefing,
    UgvCommand,
    UgvObservation,
)
from fields import fields_within
from processes import loaded_by, ran
from tabular import words

ROOT = Path(__file__).resolve().parent.parent


TO_UAV = [key.message for key in KEYS if Role.UAV in key.readers]
TO_UGV = [key.message for key in KEYS if Role.UGV in key.readers]


def fields_of(messages_to: list[type]) -> set[str]:
    return set().union(*map(fields_within, messages_to))


def test_uav_receives_exactly_these_fields() -> None:
    """The certificate relies on its own detections, commands, actuators and inner loop."""
    known = """
        tick time position velocity detections relative_position over episode committed_trajectory
        limits target_limits max_speed max_acceleration
        area width height cell sensor model peak range desired_coverage covered lower upper
        detector noise truncation period estimator enabled gate max_rejections acceleration_share
        safety max_measurement_error max_measurement_age max_command_delay margin
        max_command_interval max_tracking_error command_timeout
        ground tile map_update_rate tile_reports column row state
        origin latitude longitude altitude
        initial_altitude min_altitude max_altitude max_climb_rate max_vertical_acceleration
        vertical_clearance climb_rate camera half_angle reference_altitude
        buildings polygon marker_height building_clearance max_building_height
        vehicle dt visibility_radius law key past more"""
    assert fields_of(TO_UAV) == {*words(known), *fields_within(Law)}


def test_ugv_receives_exactly_these_fields() -> None:
    known = """
        tick time position velocity radio relative_position coverage_error over episode
        operator driver goal goals goal_tolerance script command_timeout key past more
        ground tile sensing_range caution delay rough_speed_share executes_trajectories
        buildings polygon building_clearance only_buildings
        tile_reports column row state map_updates tiles committed_trajectory
        vehicle dt area width height cell limits max_speed max_acceleration"""
    assert fields_of(TO_UGV) == {*words(known)}


def test_briefed_past_is_the_vehicles_own_observations() -> None:
    for briefing_type, seen in (
        (UavBriefing, UavObservation),
        (UgvBriefing, UgvObservation),
    ):
        assert get_args(get_type_hints(briefing_type)["past"]) == (seen, ...)
        assert get_type_hints(briefing_type)["more"] is bool


@pytest.mark.parametrize("kind", TO_UAV)
def test_no_message_to_the_uav_names_goal_path_input_or_plan(kind: type[Message]) -> None:
    forbidden = words(
        "goal goals waypoints driver acceleration command input plan truth seed secret vehicles"
    )
    assert fields_within(kind).isdisjoint(forbidden)


@pytest.mark.parametrize("kind", TO_UGV)
def test_ugv_messages_hide_velocity_input_and_law_of_the_uav(kind):
    forbidden = words(
        "law acceleration command estimate detections detector truth seed secret vehicles"
    )
    assert fields_within(kind).isdisjoint(forbidden)
    nested = fields_within(RelativeInformation)
    assert nested == {"time", "relative_position", "coverage_error"}


def test_uav_radio_has_no_velocity_and_no_input() -> None:
    radio = get_type_hints(UavCommand)["radio"]
    assert fields_within(radio) == {"time", "relative_position", "coverage_error"}
    assert "radio" not in UgvCommand.__struct_fields__
    blocks = get_type_hints(UavCommand)["map_updates"]
    assert fields_within(blocks) == {"column", "row", "tiles"}


def test_observation_with_another_vehicles_velocity_is_refused() -> None:
    smuggled = (
        b'{"tick":1,"time":0.05,"position":[1.0,1.0],"velocity":[0.0,0.0],'
        b'"detections":[{"time":0.05,"relative_position":[1.0,0.0],"velocity":[0.1,0.0]}]}'
    )
    with pytest.raises(msgspec.ValidationError, match="unknown field `velocity`"):
        msgspec.json.decode(smuggled, type=UavObservation)


def test_planned_route_reaches_the_simulator_and_no_vehicle() -> None:
    assert "route" in UgvCommand.__struct_fields__
    carrying = [key for key in KEYS if {"route", "routes"} & fields_within(key.message)]
    assert {role for key in carrying for role in key.readers} == {
        Role.SIMULATOR,
        Role.OBSERVER,
        Role.OPERATOR,
    }
    for kind in (*TO_UAV, *TO_UGV):
        assert fields_within(kind).isdisjoint({"route", "routes"})
    smuggled = (
        b'{"tick":1,"time":0.05,"position":[1.0,1.0],"velocity":[0.0,0.0],"route":[[2.0,2.0]]}'
    )
    with pytest.raises(msgspec.ValidationError, match="unknown field `route`"):
        msgspec.json.decode(smuggled, type=UavObservation)


def test_pilot_key_does_not_reveal_the_seed_of_the_run() -> None:
    from sim.engine.briefing import briefing
    from sim.scenario.loading import load_scenario

    scenario = load_scenario("escort")
    for seed in (0, 1, 2**53 - 1):
        for vehicle in scenario.vehicles:
            text = msgspec.json.encode(briefing(scenario, vehicle.name, seed)).decode()
            assert f'"key":{seed},' not in text
            assert "seed" not in text
            assert "secret" not in text


ON_BOARD = {
    "sim.models.altitude",
    "sim.models.vehicles",
    "sim.models.buildings",
    "sim.models.camera",
    "sim.models.field",
    "sim.models.grid",
    "sim.models.ground",
    "sim.models.hazards",
    "sim.models.motion",
    "sim.models.polygons",
    "sim.models.randomness",
    "sim.models.safety",
    "sim.models.sensor",
    "sim.models.sensors",
    "sim.models.sensors.hill",
    "sim.models.sensors.plateau",
    "sim.models.shadows",
    "sim.compiling.compile",
    "sim.compiling.dispatch",
    "sim.compiling.lanes",
    "sim.compiling.records",
}
"""All modules of the simulator on board of a vehicle."""


def test_import_contract_covers_all_simulator_modules() -> None:
    import tomllib

    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]["contracts"]
    forbidden = next(
        set(c["forbidden_modules"]) for c in contracts if c.get("source_modules") == ["agents"]
    )
    rooms = {f"sim.{path.stem}" for path in (ROOT / "sim").glob("[!_]*.py")} | {
        f"sim.{path.parent.name}" for path in (ROOT / "sim").glob("*/__init__.py")
    }
    shared = {"sim.models", "sim.compiling"}
    not_on_board = {
        f"{room}.{path.stem}"
        for room in shared
        for path in (ROOT / room.replace(".", "/")).glob("[!_]*.py")
    } - ON_BOARD
    assert forbidden == (rooms - shared) | not_on_board | {"outrider"}


@pytest.fixture
def _needs_linter() -> None:
    """The contracts check the sources; they need a development tool."""
    pytest.importorskip("importlinter", reason="a development tool")


LINT = [Path(sys.executable).with_name("lint-imports"), "--no-cache"]


@pytest.mark.usefixtures("_needs_linter")
def test_the_import_contracts_hold() -> None:
    run = ran(LINT, cwd=ROOT)
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.usefixtures("_needs_linter")
def test_import_contracts_catch_an_agent_reading_the_world(tmp_path: Path) -> None:
    import shutil

    for package in ("agents", "sim", "bus", "outrider"):
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    spy = tmp_path / "agents" / "uav.py"
    spy.write_text(
        spy.read_text(encoding="utf-8") + "\nfrom sim.world import World\n", encoding="utf-8"
    )
    environment = {"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin:/bin"}
    run = ran(LINT, cwd=tmp_path, env=environment)
    assert run.returncode == 1
    assert "agents.uav -> sim.world" in run.stdout


ROOMS = {"sim.models", "sim.compiling"}
REFUSES_FUNCTIONS = {"sim.input", "sim.input.faults"}
"""Modules that refuse invalid user code in one line."""
OF_MESSAGES = {"sim.scene"} | {
    f"sim.scene.{name}" for name in ("altitude", "colors", "footprints", "model", "prism")
}
"""Modules that convert messages to ROS 2: types of a scene, but no world."""


PROGRAMS = (
    (
        "agents.uav, agents.ugv, outrider.cli.main, outrider.cli.pilots, "
        "outrider.running.user_code, outrider.running.parent",
        REFUSES_FUNCTIONS,
    ),
    ("agents.uav, outrider_mavlink.command, outrider_mavlink.offboard", set()),
    ("outrider_ros2.command, outrider_ros2.ros_pilot", OF_MESSAGES),
    ("agents.ugv, outrider.cli.pilots, outrider_fmi.driver, outrider_fmi.slave", REFUSES_FUNCTIONS),
)
"""Modules of the programs on board: our pilots, setpoints of MAVLink, a node of ROS 2, a unit of FMI."""


def test_vehicle_process_loads_neither_world_nor_scenario() -> None:
    for modules, more in PROGRAMS:
        if all(map(find_spec, re.findall(r"outrider_\w+", modules))):  # its extension is installed
            all_loaded = loaded_by(f"agents.process, {modules}")
            loaded = {name for name in all_loaded if name.startswith("sim.")}
            assert loaded, modules
            assert loaded <= ON_BOARD | ROOMS | more, modules


def test_no_other_distribution_installs_our_package_names() -> None:
    from importlib.metadata import packages_distributions

    owners = packages_distributions()
    for package in ("agents", "sim", "bus"):
        others = [name for name in owners.get(package, []) if name != "outrider"]
        assert not others, (
            f"the distribution {others[0]} installs a package `{package}` too, so one hides the other "
            "(openai-agents does, for one): uninstall it from this environment"
        )


def test_every_key_has_one_writer_and_other_readers() -> None:
    assert len({(key.topic, key.vehicle) for key in KEYS}) == len(KEYS)
    for key in KEYS:
        assert key.readers
        assert key.writer not in key.readers
    assert set(keys.BRIEFING) == set(keys.OBSERVATION) == set(keys.COMMAND) == {Role.UAV, Role.UGV}
