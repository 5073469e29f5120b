"""Units of FMI 3.0: exported units fly the same bits and know no more; invalid ones are refused in one line."""

import importlib
import json
import math
import sys
import zipfile
from collections.abc import Iterator, Mapping
from functools import partial
from importlib.metadata import version
from pathlib import Path

import fmpy
import msgspec
import numpy as np
import pytest
from pythonfmu3 import FmuBuilder

from agents.safety.levels import radius_at
from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.keys import Role
from bus.messages.vehicle import Teleoperation, UavCommand, UavObservation
from flights import Piloted, record, sha256
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.user_code import foreign_code
from outrider_fmi import variables
from outrider_fmi.driver import FmuPolicy
from outrider_fmi.export import export_vehicle, export_world
from outrider_fmi.vehicle_unit import TeamCommand, TeamPart, VehicleUnit
from outrider_fmi.world_unit import WorldUnit
from refusals import refused
from sim.compiling.compile import FloatArray
from sim.engine.briefing import briefing
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight

OURS = version("outrider")
DT = 0.05
HUT = "building=[{polygon=[[5.0, 5.0], [6.0, 5.0], [6.0, 6.0], [5.0, 6.0]], height=2.0}]"
SHORT = ["duration=5.0", "ugv.0.goals=[[8.0, 13.0]]"]

THEIRS = """
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64


class Wheel(Fmi3Slave):
    def __init__(self, **given):
        super().__init__(**given)
        self.v, self.u, self.t = 0.0, 0.0, 0.0
        self.register_variable(
            Float64("time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous, getter=float)
        )
        for name, causality in (("velocity.x", "input"), ("acceleration.x", "output"), ("acceleration.y", "output")):
            self.register_variable(
                Float64(name, causality=Fmi3Causality[causality], getter=lambda: self.u, setter=self.take),
                nested=False,
            )

    def take(self, value):
        self.v = value

    def do_step(self, time, size):
        if time > 0.09:
            raise RuntimeError("the wheel is off")
        self.u = (0.1 - self.v) / size
        return True
"""


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with exported units and a foreign one."""
    folder = tmp_path_factory.mktemp("units")
    flown = load_scenario("escort", overrides=SHORT)
    assert export_vehicle(flown, Role.UGV, folder / "ugv.fmu") == "ugv_0"
    assert export_vehicle(flown, Role.UAV, folder / "uav.fmu") == "uav_0"
    export_world(flown, folder / "world.fmu")
    script = folder / "wheel_of_theirs.py"  # Python identifies a unit's module by its name
    script.write_text(THEIRS)
    FmuBuilder.build_FMU(script, dest=folder)
    return folder


@pytest.fixture
def _path_as_before() -> Iterator[None]:
    """Restore Python's path, to which a unit's library adds its folder."""
    before = sys.path.copy()
    yield
    sys.path[:] = before


pytestmark = pytest.mark.usefixtures("_path_as_before")


def every_input(unit: VehicleUnit, value: float) -> dict[str, float]:
    return dict.fromkeys((one.name for one in unit.inputs), value)


def states_of(outputs: Mapping[str, FloatArray], names: tuple[str, ...]) -> FloatArray:
    """Return the states of the trajectory hash from outputs of the world's unit. Shape (ticks, vehicles, 6)."""
    here = [[f"{n}.{of}.{axis}" for of in ("position", "velocity") for axis in "xy"] for n in names]
    applied = [[f"{n}.acceleration.{axis}" for axis in "xy"] for n in names]
    before, after = (
        np.stack([np.stack([outputs[c] for c in columns], axis=-1) for columns in kind], axis=1)
        for kind in (here, applied)
    )
    return np.concatenate((before[:-1], after[1:]), axis=-1)


def test_world_unit_outputs_the_bits_of_the_run(units: Path) -> None:
    flown = load_scenario("escort", overrides=SHORT)
    flight, summary = fly(flown, flown.seed)
    outputs = fmpy.simulate_fmu(
        str(units / "world.fmu"), stop_time=flown.duration, output_interval=DT
    )
    assert sha256(states_of(outputs, flight.world.names)) == summary.trajectory_sha256
    escorts = flight.recorder.escorts[:, 0]
    assert (outputs["uav_0.distance"] == escorts[:, 0]).all()
    assert (outputs["uav_0.coverage_error"] == escorts[:, 1]).all()
    assert (outputs["uav_0.certified"][1:] == escorts[:-1, 6]).all()
    assert outputs["uav_0.certified"].any()
    assert not outputs["uav_0.lost"].any()


def test_world_unit_reports_lost_sight_over_degraded_links() -> None:
    changes = [
        "duration=30.0",
        "law.name=tracking",
        "visibility.radius=1.3",
        "links.profile=wifi-poor",
    ]
    changes += ["ugv.0.max_speed=0.55", "uav.0.velocity=[-0.4, 0.0]", "law.parameters.b_c=-0.1"]
    flown = load_scenario("escort", overrides=changes)
    _, summary = fly(flown, 4)
    unit = WorldUnit(flown, 4)
    rows = [unit.start(), *(unit.step(tick * DT, DT, {}) for tick in range(flown.ticks))]
    lost = sum(row["uav_0.lost"] for row in rows)
    assert lost == summary.visibility_violations > 0
    outputs = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    assert sha256(states_of(outputs, ("uav_0", "ugv_0"))) == summary.trajectory_sha256


def test_an_operator_of_the_worlds_unit_is_one_of_the_run() -> None:
    flown = load_scenario("escort", overrides=["duration=2.0", "ugv.0.driver=teleop"])
    flight, wanted = Flight(flown, 3), (0.0, 0.1)
    exchange = InProcess(make_pilots(flown, 3))
    unit = WorldUnit(flown, 3)
    assert [one.name for one in unit.inputs if not one.unit] == ["ugv_0.operator.new"]
    for tick in range(flown.ticks):
        flight.teleoperate("ugv_0", Teleoperation(operator="anybody", velocity=wanted))
        flight.fly_tick(exchange)
        values = {"ugv_0.operator.new": True, "ugv_0.operator.velocity.x": wanted[0]}
        outputs = unit.step(tick * DT, DT, values | {"ugv_0.operator.velocity.y": wanted[1]})
    k = flight.world.names.index("ugv_0")
    assert (outputs["ugv_0.velocity.x"], outputs["ugv_0.velocity.y"]) == tuple(
        flight.world.velocity[k]
    )
    assert outputs["ugv_0.velocity.y"] > 0.05


def test_a_steering_ugvs_units_know_its_heading_and_its_operators_twist() -> None:
    """The UGV's unit, moved by the world's, answers as the pilot in the world's."""
    steers = ("ugv.0.kinematics=ackermann", "ugv.0.max_curvature=1.5", "ugv.0.heading=1.0")
    flown = load_scenario("escort", overrides=["duration=2.0", "ugv.0.driver=teleop", *steers])
    unit = WorldUnit(flown, 3)
    own = VehicleUnit(briefing(flown, "ugv_0", 3))
    outputs = unit.start()
    names = [one.name for one in own.inputs]
    assert names == [
        *(one.name for one in variables.OWN_STATE),
        "heading",
        *(one.name for one in variables.TWIST),
    ]
    for tick in range(flown.ticks):
        drive = {"operator.new": True, "operator.speed": 0.15, "operator.turn_rate": 0.2}
        seen = {name: outputs[f"ugv_0.{name}"] for name in names if name not in drive}
        answer = own.step(tick * DT, DT, seen | drive)
        outputs = unit.step(tick * DT, DT, {f"ugv_0.{name}": v for name, v in drive.items()})
        for axis in "xy":
            applied = outputs[f"ugv_0.acceleration.{axis}"]
            assert answer[f"acceleration.{axis}"] == pytest.approx(applied, abs=1e-12)
    assert outputs["ugv_0.heading"] > 1.1


def test_world_unit_loses_sight_where_a_low_run_does() -> None:
    changes = ["uav.0.initial_altitude=4.0", "law.name=coverage", "duration=25.0"]
    flown = load_scenario("escort", overrides=changes)
    flight, summary = fly(flown, 4)
    unit = WorldUnit(flown, 4)
    rows = [unit.start(), *(unit.step(tick * DT, DT, {}) for tick in range(flown.ticks))]
    lost = [row["uav_0.lost"] for row in rows]
    assert sum(lost) == summary.visibility_violations
    near = [row["uav_0.distance"] < flown.visibility.radius for row in rows]
    assert any(gone and within for gone, within in zip(lost, near, strict=True))
    assert [row["uav_0.altitude"] for row in rows] == flight.recorder.heights[:, 0, 0].tolist()


@pytest.mark.parametrize(
    ("scenario", "changes"),
    [
        ("escort", ()),
        (
            "escort",
            ("uav.0.initial_altitude=14.0", "altitude.law=best", "detections.noise=0.05"),
        ),
        ("town", ("building_field=[]", HUT, "buildings.known=false", "ugv.0.building_clearance=1")),
        ("scouts", ()),
    ],
    ids=["plane", "space", "town", "team"],
)
def test_the_pilots_unit_answers_what_the_runs_pilot_answers(
    scenario: str, changes: tuple[str, ...]
) -> None:
    lossy = ["duration=10.0", "links.detections.loss=0.2", *changes]
    flown = load_scenario(scenario, overrides=lossy)
    own_briefing = briefing(flown, "uav_0", 5)
    unit = VehicleUnit(own_briefing)
    certified, radioed, discovered = 0, 0, 0
    pilots = make_pilots(flown, 5)

    def visible(altitude: float | None) -> float:
        return flown.visibility.radius if altitude is None else radius_at(own_briefing, altitude)

    def both(seen: UavObservation) -> UavCommand:
        nonlocal certified, radioed, discovered
        command = pilots["uav_0"].act(seen)
        (detection,) = seen.detections or (None,)
        values = every_input(unit, 0.0)
        values |= zip(("position.x", "position.y"), seen.position, strict=True)
        values |= zip(("velocity.x", "velocity.y"), seen.velocity, strict=True)
        if changes:
            values |= {"altitude": seen.altitude or 0.0, "climb_rate": seen.climb_rate}
        if seen.buildings:
            discovered += len(seen.buildings)
            values |= {"buildings": msgspec.json.encode(seen.buildings).decode()}
        if seen.team:
            part = TeamPart(number=seen.number, charge=seen.charge, team=seen.team)
            values |= {"team": msgspec.json.encode(part).decode()}
        if detection is not None:
            values |= {"detection.new": True, "detection.time": detection.time}
            values |= zip(("detection.x", "detection.y"), detection.relative_position, strict=True)
        got = unit.step(seen.tick * DT, DT, values)
        assert (got["acceleration.x"], got["acceleration.y"]) == command.acceleration
        assert got.get("vertical_acceleration", 0.0) == command.vertical_acceleration
        report = command.report
        assert got["estimate.valid"] == (report is not None)
        decision = None if report is None else report.decision
        if decision is not None and decision.certified_distance is not None:
            assert got["certified"] == decision.certified
            assert got["margin"] == visible(seen.altitude) - decision.certified_distance
            assert (got["estimate.x"], got["estimate.y"]) == report.estimate
            certified += got["certified"]
        if scenario == "scouts":
            sent = msgspec.json.decode(got["team_command"], type=TeamCommand)
            assert (sent.number, sent.team) == (command.number, command.team)
            assert got["role"] == ("" if report is None or report.role is None else report.role)
        assert got["radio.new"] == bool(command.radio)
        radioed += bool(command.radio)
        return command

    Flight(flown, 5).fly(Piloted(pilots, "uav_0", both))
    assert certified > 100
    assert radioed > 10
    assert (discovered > 0) == (scenario == "town")


def test_a_unit_has_what_its_vehicle_may_know_and_nothing_else(units: Path) -> None:
    own = {f"{of}.{axis}" for of in ("position", "velocity") for axis in "xy"}
    allowed = {
        "uav": own | {f"detection.{part}" for part in ("new", "time", "x", "y")},
        "ugv": own,
        "world": set(),
    }
    for name, inputs in allowed.items():
        described = fmpy.read_model_description(str(units / f"{name}.fmu"), validate=True)
        names_by_causality: dict[str, set[str]] = {
            one.causality: set() for one in described.modelVariables
        }
        for one in described.modelVariables:
            names_by_causality[one.causality].add(one.name)
            assert one.description
            assert one.type == "Boolean" or one.unit
        assert names_by_causality.get("input", set()) == inputs
        assert set(names_by_causality) <= {
            "input",
            "output",
            "independent",
        }  # no parameters to tune
    flown = load_scenario("escort", overrides=SHORT)
    for role in ("uav", "ugv"):
        with zipfile.ZipFile(units / f"{role}.fmu") as file:
            carried = {
                one
                for one in file.namelist()
                if one.startswith("resources/") and one.count("/") == 1
            }
            words = json.loads(file.read(f"resources/{role}-briefing.json"))
        assert carried == {
            f"resources/{one}"
            for one in (
                "slavemodule.txt",
                "outrider_unit.py",
                "version.txt",
                f"{role}-briefing.json",
            )
        }
        assert words["key"] == briefing(flown, f"{role}_0", flown.seed).key
        assert not {"seed", "secret"} & words.keys()
        if role == "uav":
            assert not {"goals", "driver", "script"} & words.keys()


@pytest.mark.parametrize("where", ["run", "environment"])
def test_an_exported_driver_drives_to_the_same_bits(units: Path, where: str) -> None:
    ugv = f'ugv.0.driver="fmu:{units / "ugv.fmu"}"'
    own, theirs = (load_scenario("escort", overrides=[*SHORT, *more]) for more in ((), (ugv,)))
    assert theirs.ugv[0].driver == "policy"
    _, expected = fly(own, own.seed)
    if where == "run":
        assert fly(theirs, theirs.seed)[1].trajectory_sha256 == expected.trajectory_sha256
        assert len(sys.path) == len(set(sys.path))
        return
    env = parallel_env(theirs)
    rows = record(env, pilots(env), env.reset(seed=theirs.seed)[0])
    assert sha256(rows) == expected.trajectory_sha256


def test_a_driver_that_hears_the_uav_drives_as_a_unit(tmp_path: Path) -> None:
    own = load_scenario("escort", overrides=["duration=5.0", "ugv.0.driver=evade"])
    export_vehicle(own, Role.UGV, tmp_path / "evade.fmu")
    driver = f"ugv.0.driver=fmu:{tmp_path / 'evade.fmu'}"
    theirs = load_scenario("escort", overrides=["duration=5.0", driver])
    assert fly(own, own.seed)[1].trajectory_sha256 == fly(theirs, own.seed)[1].trajectory_sha256


def test_foreign_unit_drives_and_its_crash_is_one_line(units: Path) -> None:
    driver = f"ugv.0.driver=fmu:{units / 'Wheel.fmu'}"
    flown = load_scenario("escort", overrides=[*SHORT, "duration=0.1", driver])
    flight, _ = fly(flown, 0)
    assert flight.world.velocity[1, 0] > 0.0
    flown = load_scenario("escort", overrides=[*SHORT, driver])
    with refused(ScenarioError, r"Wheel.fmu': tick 2: .*the wheel is off"):
        fly(flown, 0)


@pytest.mark.parametrize(
    ("unit", "old", "new", "line"),
    [
        ("Wheel", 'fmiVersion="3.0"', 'fmiVersion="2.0"', "of FMI 2.0; allowed: FMI 3.0"),
        (
            "Wheel",
            'name="velocity.x"',
            'name="ugv_velocity"',
            "has an input 'ugv_velocity'.*allowed: .*goal.x",
        ),
        ("Wheel", 'name="acceleration.y"', 'name="brake"', r"has no output 'acceleration\.y'"),
        ("Wheel", "<CoSimulation", "<ModelExchange", "not for co-simulation"),
        ("Wheel", "binaries/x86_64-linux", "", r"made for x86_64-windows; this one is \S+-\S+"),
        ("Wheel", "modelDescription.xml", "", "not an FMU"),
        ("Wheel", "<fmiModelDescription", "<nonsense", "not an FMU"),
        ("ugv", OURS, "0.0.1", r"cannot be started: .*a unit of outrider 0\.0\.1"),
    ],
)
def test_a_unit_that_cannot_drive_is_refused_in_one_line(units, tmp_path, unit, old, new, line):
    """Refuse a unit with another description or version, or with missing files."""
    file = tmp_path / "bad.fmu"
    with zipfile.ZipFile(units / f"{unit}.fmu") as whole, zipfile.ZipFile(file, "w") as changed:
        for name in whole.namelist():
            data = whole.read(name)
            if name.endswith((".xml", "version.txt")):
                data = data.decode("utf-8").replace(old, new).encode()
            if not name.startswith(old):
                changed.writestr(name, data)
    with refused(ScenarioError, f"^here: ({line})"):
        FmuPolicy(str(file), "here")


def test_invalid_or_missing_unit_is_reported_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.fmu").write_text("hello")
    for name, line in (("text.fmu", "not an FMU"), ("none.fmu", "no such file"), ("", "no such")):
        with pytest.raises(ScenarioError, match=f"^here: {line}"):
            FmuPolicy(str(tmp_path / name), "here")


def test_one_unit_drives_a_run_and_loads_only_on_request(units: Path) -> None:
    named = f"fmu:{units / 'ugv.fmu'}"
    flown = load_scenario("escort", overrides={"ugv.0.driver": named})
    assert foreign_code(flown) == foreign_code(flown, ["seed=3"]) != ()
    assert foreign_code(flown, [f'ugv.0.driver="{named}"']) == ()
    with pytest.raises(ScenarioError, match=r"ugv\.0\.driver = .*another.*one policy per run"):
        load_scenario("escort", overrides={"ugv.0.driver": named, "custom.policy": "mine:drive"})


@pytest.mark.parametrize(
    ("time", "size", "line"),
    [
        (0.0, 0.1, "a step of 0.1 s from 0 s; allowed: steps of 0.05 s"),
        (0.02, DT, "from 0.02 s; allowed: steps of 0.05 s"),
        (math.nan, DT, "from nan s"),
        (0.0, math.nan, "a step of nan s"),
        (0.1, DT, r"a step from 0\.1 s; allowed: the next one, from 0 s"),
    ],
)
def test_a_step_that_is_no_tick_is_refused(time: float, size: float, line: str) -> None:
    unit = WorldUnit(load_scenario("escort", overrides=["duration=0.1"]), 0)
    with pytest.raises(ValueError, match=line):
        unit.step(time, size, {})


def test_unit_refuses_steps_after_the_end_and_invalid_numbers() -> None:
    unit = WorldUnit(load_scenario("escort", overrides=["duration=0.1"]), 0)
    for tick in range(2):
        unit.step(tick * DT, DT, {})
    with pytest.raises(ValueError, match=r"the run ends at 0\.1 s"):
        unit.step(0.1, DT, {})
    driver = VehicleUnit(briefing(load_scenario("escort"), "ugv_0", 0))
    values = every_input(driver, 0.0)
    for bad in (math.nan, math.inf, -1e7):
        with pytest.raises(ValueError, match=r"velocity\.x = .*; allowed: numbers up to 1e\+06"):
            driver.step(0.0, DT, values | {"velocity.x": bad})


HAZARD = 'hazard=[{kind="block",center=[30,30],radius=0.2}]'


@pytest.mark.parametrize(
    ("what", "changes", "line"),
    [
        ("uav", [HAZARD], "uav_0: perceives hazards"),
        ("ugv", [HAZARD], "ugv_0: perceives hazards"),
        (
            "uav",
            ["law.name=certified", "certificate.max_command_interval=0.5"],
            "uav_0: law.name = 'certified'",
        ),
        (
            "uav",
            ["law.name=certified", "certificate.max_command_delay=0.1"],
            "uav_0: law.name = 'certified'",
        ),
        ("uav", ["team={}", "certificate.max_command_delay=0.1"], "uav_0: a guard's commands"),
        ("uav", ["law.name=path", "custom.path=a:b"], "uav_0: the law 'path'"),
        ("ugv", ["ugv.0.driver=external"], "ugv_0: the driver 'external'.*allowed: waypoints"),
        ("ugv", ["ugv.0.driver=fmu:x.fmu"], "ugv_0: the driver 'policy'"),
        (
            "world",
            ["ugv.0.driver=fmu:x.fmu"],
            "custom.policy = 'fmu:x.fmu': a unit does not contain",
        ),
        ("world", ["ugv.0.driver=external"], "ugv_0: the driver 'external'"),
        ("uav", ["name=elsewhere", "uav=[]"], "elsewhere: has no uav to export"),
    ],
)
def test_impossible_unit_is_refused_before_it_is_built(tmp_path, what, changes, line):
    flown: Scenario = load_scenario("escort", overrides=changes)
    export = export_world if what == "world" else partial(export_vehicle, role=Role(what))
    with pytest.raises(ScenarioError, match=f"^{line}"):
        export(flown, out=tmp_path / "unit.fmu")
    assert not list(tmp_path.iterdir())


def test_the_law_of_a_pilots_unit_is_the_scenarios() -> None:
    own_briefing = briefing(load_scenario("escort", overrides=["law.name=logarithmic"]), "uav_0", 0)
    unit = VehicleUnit(own_briefing)
    assert isinstance(unit._pilot, UavPilot)
    assert unit._pilot.filter is None
    values = every_input(unit, 1.0)
    got = unit.step(0.0, DT, values | {"detection.time": 0.0})
    assert (got["certified"], got["margin"]) == (False, -math.inf)


def test_a_unit_that_unpacks_to_much_is_refused(tmp_path: Path) -> None:
    with (
        zipfile.ZipFile(tmp_path / "big.fmu", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("modelDescription.xml", "w", force_zip64=True) as file,
    ):
        for _ in range(257):
            file.write(bytes(1 << 20))
    with pytest.raises(ScenarioError, match="unpacks to 257 MiB; allowed: 256 MiB"):
        FmuPolicy(str(tmp_path / "big.fmu"), "policy")


def test_the_group_without_a_command_prints_its_help(command) -> None:
    made = command("fmu")
    assert made.returncode == 2
    assert "Usage: outrider fmu" in made.stderr.splitlines()[0]
    assert "Commands:" in made.stderr.splitlines()


def test_every_variable_is_documented_with_its_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "docs" / "generators")
    generator = importlib.import_module("fmi_variables")
    text = generator.pilots() + generator.world() + generator.driver()
    tables = [rows for rows in vars(variables).values() if isinstance(rows, tuple)]
    assert len(tables) >= 8
    for one in {one for rows in tables for one in rows}:
        unit = f"Float64, {one.unit}" if one.unit else "String" if one.text else "Boolean"
        assert f"{one.name}` | {unit} | {one.about} |" in text
