"""The information contract, layers one and two: types and imports. These tests try to break it."""

import json
import re
import shutil
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest

from bus import keys
from bus.keys import KEYS, Role
from bus.messages.vehicle import (
    UavBriefing,
    UavCommand,
    UavObservation,
    UgvBriefing,
    UgvCommand,
    UgvObservation,
)
from fields import fields_within
from processes import loaded_by, python, ran
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
        max_command_interval max_tracking_error search command_timeout
        ground tile map_update_rate tile_reports column row state
        origin latitude longitude altitude
        initial_altitude min_altitude max_altitude max_climb_rate max_vertical_acceleration
        vertical_clearance climb_rate camera half_angle reference_altitude
        buildings polygon marker_height guaranteed_clearance max_building_height
        vehicle dt visibility_radius law name parameters key past more
        team mates guards silence scout_range separation
        sender number role certified measured measurement blocks cells
        endurance charge_time base charge asks request has_robot"""
    assert fields_of(TO_UAV) == {*words(known)}


def test_ugv_receives_exactly_these_fields() -> None:
    known = """
        tick time position velocity radio relative_position coverage_error over episode
        operator driver goal goals goal_tolerance script command_timeout key past more
        ground tile sensing_range caution delay rough_speed_share executes_trajectories
        buildings polygon building_clearance tile_clearance only_buildings
        tile_reports column row state map_updates tiles committed_trajectory
        kinematics track max_curvature heading speed turn_rate
        vehicle dt area width height cell limits max_speed max_acceleration"""
    assert fields_of(TO_UGV) == {*words(known)}


def test_briefed_past_is_the_vehicles_own_observations() -> None:
    for briefing, seen in ((UavBriefing, UavObservation), (UgvBriefing, UgvObservation)):
        assert get_args(get_type_hints(briefing)["past"]) == (seen, ...)


def test_uav_radio_has_no_velocity_and_no_input() -> None:
    for kind in (UavCommand, UgvObservation):
        radio = get_type_hints(kind)["radio"]
        assert fields_within(radio) == {"time", "relative_position", "coverage_error"}
    assert "radio" not in UgvCommand.__struct_fields__
    blocks = get_type_hints(UavCommand)["map_updates"]
    assert fields_within(blocks) == {"column", "row", "tiles"}


@pytest.mark.parametrize(
    ("field", "smuggled"),
    [
        ("velocity", b'"detections":[{"time":0,"relative_position":[1,0],"velocity":[0.1,0]}]'),
        ("route", b'"route":[[2.0,2.0]]'),
    ],
)
def test_observation_with_an_unknown_field_is_refused(field: str, smuggled: bytes) -> None:
    known = b'"tick":1,"time":0.05,"position":[1.0,1.0],"velocity":[0.0,0.0],'
    with pytest.raises(msgspec.ValidationError, match=f"unknown field `{field}`"):
        msgspec.json.decode(b"{" + known + smuggled + b"}", type=UavObservation)


def test_planned_route_reaches_the_simulator_and_no_vehicle() -> None:
    assert "route" in UgvCommand.__struct_fields__
    carrying = [key for key in KEYS if {"route", "routes"} & fields_within(key.message)]
    readers = {role for key in carrying for role in key.readers}
    assert readers == {Role.SIMULATOR, Role.OBSERVER, Role.OPERATOR}


MODELS = """
    altitude buildings camera endurance field grid ground hazards kinematics polygons randomness safety sensor sensors
    sensors.hill sensors.plateau shadows trajectories vehicles"""
ON_BOARD = {
    *(f"sim.models.{name}" for name in words(MODELS)),
    *(f"sim.compiling.{name}" for name in words("cache compile dispatch lanes records")),
}
"""All modules of the simulator on board of a vehicle."""
ROOMS = {"sim.models", "sim.compiling"}
"""The packages of these modules."""


def test_import_contract_covers_all_simulator_modules() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (contract,) = (c for c in contracts if c.get("source_modules") == ["agents"])
    sources = {*(ROOT / "sim").glob("[!_]*")} - {ROOT / "sim" / "py.typed"}
    parts = {
        path for room in ("models", "compiling") for path in (ROOT / "sim" / room).glob("[!_]*")
    }
    rooms = {f"sim.{path.stem}" for path in sources} - ROOMS
    modules = {f"sim.{path.parent.name}.{path.stem}" for path in parts}
    assert {*contract["forbidden_modules"]} == rooms | (modules - ON_BOARD) | {"outrider"}


def test_import_contracts_hold_and_catch_a_forbidden_import(tmp_path: Path) -> None:
    pytest.importorskip("importlinter", reason="a development tool")
    lint = [Path(sys.executable).with_name("lint-imports"), "--no-cache"]
    ours = ran(lint, cwd=ROOT)
    assert ours.returncode == 0, ours.stdout + ours.stderr
    for package in ("agents", "sim", "bus", "outrider"):
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    with (tmp_path / "agents" / "uav.py").open("a", encoding="utf-8") as spy:
        spy.write("\nfrom sim.world import World\n")
    environment = {"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin:/bin"}
    caught = ran(lint, cwd=tmp_path, env=environment)
    assert caught.returncode == 1
    assert "agents.uav -> sim.world" in caught.stdout


REFUSES_FUNCTIONS = {"sim.input", "sim.input.faults"}
"""Modules that refuse invalid user code in one line."""
OF_MESSAGES = {"sim.scene", "sim.models.sight"} | {
    f"sim.scene.{name}" for name in ("altitude", "colors", "footprints", "model", "prism")
}
"""Modules that convert messages to ROS 2: types of a scene, but no world."""


PROGRAMS = (
    (
        "agents.uav, agents.ugv, outrider.cli.main, outrider.cli.pilots, "
        "outrider.running.user_code, outrider.running.parent",
        REFUSES_FUNCTIONS,
    ),
    (
        "agents.uav, outrider_mavlink.command, outrider_mavlink.opening, outrider_mavlink.flying",
        REFUSES_FUNCTIONS,
    ),
    ("outrider_ros2.command, outrider_ros2.flying", OF_MESSAGES | REFUSES_FUNCTIONS),
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


LAYERS = ("bus", "sim", "agents", "outrider")
"""The packages of the core: each may load those before it."""
LOADS = """
import json, pkgutil, sys
from importlib import import_module

for layer in sys.argv[1:]:
    for module in pkgutil.walk_packages(import_module(layer).__path__, layer + "."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
if layer == "sim":
    from sim.scenario.loading import load_scenario, scenario_names
    for name in scenario_names():
        load_scenario(name)
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""
"""Imports all modules of packages; after those of the simulator, it loads all shipped scenarios."""


@pytest.mark.parametrize("layer", LAYERS[:-1])
def test_a_package_never_loads_a_later_one(layer: str) -> None:
    """Neither when its modules are imported nor when a scenario is loaded and checked."""
    loaded = set(json.loads(python(LOADS, layer).stdout))
    assert layer in loaded
    assert not loaded & set(LAYERS[LAYERS.index(layer) + 1 :])


def test_every_key_has_one_writer_and_other_readers() -> None:
    assert len({(key.topic, key.vehicle) for key in KEYS}) == len(KEYS)
    for key in KEYS:
        assert key.readers
        assert key.writer not in key.readers
    assert set(keys.BRIEFING) == set(keys.OBSERVATION) == set(keys.COMMAND) == {Role.UAV, Role.UGV}
