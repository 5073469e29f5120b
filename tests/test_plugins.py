"""Packages beside Outrider: the one in CONTRIBUTING.md, whose law, driver and sensor fly, and examples/plugin."""

import configparser
import json
import os
import re
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus import plugins
from bus.policies import policy_kinds
from bus.rows import LawRow
from processes import free_port, python, started
from tabular import words

ROOT = Path(__file__).resolve().parent.parent
PLUGIN = ROOT / "examples" / "plugin"
GUIDE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = dict(
    re.findall(r"```(?:python|toml)\n# (my_package/\S+|pyproject.toml)\n(.*?)```", GUIDE, re.DOTALL)
)
"""The files of the guide's package by name."""
SCENARIO = """
duration = 2.0
[area]
width = 20.0
height = 20.0
cell = 0.5
[sensor]
model = "cone"
[detections]
noise = 0.0
[law]
name = "cautious"
[law.parameters]
power = 0.7
[[uav]]
position = [10.0, 11.0]
[[ugv]]
position = [10.0, 10.0]
driver = "zigzag"
"""
FLIGHTS = """
import json, sys
import outrider
from outrider.running.flying import fly

def flown(*changes):
    return fly(outrider.load_scenario(sys.argv[1], overrides=changes), 3)

changes = [
    (), ("law.parameters.power=0.2",), ("law.name=linear",), ("ugv.0.driver=waypoints",), ("sensor.model=hill",)
]
flight, summary = flown()
print(json.dumps({
    "hashes": [flown(*change)[1].trajectory_sha256 for change in changes],
    "positions": flight.world.position.tolist(),
}))
"""
REFUSALS = """
import json, sys
import outrider
from bus.errors import ScenarioError

def refused(change):
    try:
        outrider.load_scenario(sys.argv[1], overrides=[change])
    except ScenarioError as error:
        return str(error)

print(json.dumps({"refused": [refused(change) for change in sys.argv[2:]]}))
"""
BATCH = """
import json, sys
import outrider
from outrider.closed_loop.closed_loop import ClosedLoop

loop = ClosedLoop(outrider.load_scenario(sys.argv[1]), 1)
loop.begin([3])
loop.fly()
print(json.dumps({"positions": loop.state.batch.vehicles["position"][0].tolist()}))
"""


def install(folder: Path, text: str) -> Path:
    """Write what `pip install` tells the interpreter about the package of a pyproject.toml."""
    project = tomllib.loads(text)["project"]
    name = project.get("name", "my-package")
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", "utf-8")
    points = configparser.ConfigParser()
    points.read_dict(project["entry-points"])
    with (info / "entry_points.txt").open("w", encoding="utf-8") as file:
        points.write(file)
    return folder


def installed_guide(folder: Path, points: str = BLOCKS["pyproject.toml"]) -> Path:
    """Install the guide's package with its entry points into a folder."""
    (folder / "my_package").mkdir(parents=True)
    (folder / "my_package" / "__init__.py").touch()
    for name, text in BLOCKS.items():
        if name != "pyproject.toml":
            (folder / name).write_text(text, encoding="utf-8")
    return install(folder, points)


def with_package(folder: Path, **more: str) -> dict[str, str]:
    path = os.pathsep.join((str(folder), str(PLUGIN), str(ROOT), os.environ.get("PYTHONPATH", "")))
    return os.environ | {"PYTHONPATH": path} | more


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with both installed packages and a scenario that needs the guide's: all is compiled once."""
    folder = installed_guide(tmp_path_factory.mktemp("installed"))
    install(folder, (PLUGIN / "pyproject.toml").read_text(encoding="utf-8"))
    (folder / "plugged.toml").write_text(SCENARIO, encoding="utf-8")
    return folder


REFUSED = {
    "law.name=cautios": "did you mean 'cautious'?",
    "law.parameters.powr=1": "law.parameters.powr = 1: unknown parameter, did you mean 'power'?",
    "law.parameters.power=x": 'law.parameters.power = "x": text; allowed: a number',
    "ugv.0.driver=zigzg": "did you mean 'zigzag'?",
    "sensor.model=con": "did you mean 'cone'?",
}


def answer(package: Path, code: str) -> dict[str, Any]:
    """Return the JSON output of a program that uses the package and the scenario."""
    file, env = str(package / "plugged.toml"), with_package(package)
    done = python(code, file, *REFUSED, env=env, cwd=package)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def flights(package: Path) -> dict[str, Any]:
    """Return runs in one process."""
    return answer(package, FLIGHTS)


@pytest.mark.long
def test_law_driver_and_sensor_of_a_package_fly_in_one_process(flights: dict[str, Any]) -> None:
    assert len(set(flights["hashes"])) == 5
    assert np.abs(np.subtract(flights["positions"], [[10.0, 11.0], [10.0, 10.0]])).min() > 1e-3


@pytest.mark.long
def test_they_fly_alike_in_a_batch(package: Path, flights: dict[str, Any]) -> None:
    apart = np.subtract(answer(package, BATCH)["positions"], flights["positions"])
    assert np.abs(apart).max() < 1e-6


@pytest.mark.long
def test_they_fly_the_same_bits_in_processes_of_their_own(package, flights) -> None:
    code = "import sys; sys.argv[0] = 'outrider'; from outrider.cli.main import run_command_line as r; sys.exit(r())"
    words = ("run", str(package / "plugged.toml"), "--seed", "3", "--json", "--no-files")
    done = python(code, *words, env=with_package(package), cwd=package)
    assert json.loads(done.stdout)["trajectory_sha256"] == flights["hashes"][0]


def test_its_names_and_parameters_are_checked(package: Path) -> None:
    refused = answer(package, REFUSALS)["refused"]
    for phrase, line in zip(REFUSED.values(), refused, strict=True):
        assert phrase in line


def test_an_entry_point_that_names_no_row_is_ignored(tmp_path, monkeypatch, capsys) -> None:
    text = (
        '[project.entry-points."outrider.laws"]\n'
        'gone = "my_package.rows:GONE"\ncone = "my_package.rows:CONE"\n'
    )
    monkeypatch.syspath_prepend(installed_guide(tmp_path, text))
    assert not {"gone", "cone"} & plugins.load_all("laws", LawRow).keys()
    errors = capsys.readouterr().err
    assert "outrider.laws: 'gone' of my-package is ignored: module" in errors
    assert "is ignored: my_package.rows:CONE is not a LawRow" in errors


BROKEN = {
    "raises/__init__.py": "raise RuntimeError('no luck')",
    "exits/__init__.py": "import sys; sys.exit()",
    "rows.py": """
from bus.rows import DriverRow, LawRow, SensorRow
TAKEN = LawRow(name="tracking", about="a built-in name", color="#000000")
SPACED = DriverRow(name="two words", about="")
UNTYPED = DriverRow(name="untyped", about=None)
RAISES = LawRow(name="late", module="late", about="", color="#000000")
LACKS = SensorRow(name="lacks", module="rows", about="")
""",
    "parts.py": "from bus.roles import Roles; ROLES = Roles(parties=None, grants=None)",
    "links.py": """
from bus.messages.links import LinkSettings
TAKEN = {"fast": LinkSettings(), "wifi": LinkSettings()}
NUMBER = {"slow": 3}
OUT = {"slow": LinkSettings(delay=-1.0)}
""",
    "late.py": "from sim.compiling.compile import compiled; raise LookupError('no table')",
}
BROKEN_POINTS = """
[project]
name = "broken"
[project.entry-points."outrider.commands"]
raises = "raises.command:command"
exits = "exits.command:command"
run = "rows:run"
"--help" = "rows:run"
[project.entry-points."outrider.laws"]
taken = "rows:TAKEN"
dashed = "my-module:ROW"
exits = "exits:ROW"
late = "rows:RAISES"
[project.entry-points."outrider.drivers"]
spaced = "rows:SPACED"
untyped = "rows:UNTYPED"
[project.entry-points."outrider.sensors"]
lacks = "rows:LACKS"
[project.entry-points."outrider.policies"]
raises = "raises:KIND"
[project.entry-points."outrider.profiles"]
taken = "links:TAKEN"
number = "links:NUMBER"
out = "links:OUT"
[project.entry-points."outrider.roles"]
roles = "parts:ROLES"
"""
IGNORED = """
commands 'raises' RuntimeError: no luck | commands 'exits' SystemExit | commands 'run' Outrider has a command
commands '--help' not a command's name | laws 'taken' name = 'tracking': the name is taken
laws 'dashed' 'my-module:ROW' has a wrong form | laws 'exits' SystemExit | drivers 'spaced' name = 'two words'
laws 'late' late: LookupError: no table | drivers 'untyped' rows:UNTYPED has about = None | sensors 'lacks' rows:
policies 'raises' RuntimeError: no luck | roles 'roles' 'NoneType' object
profiles 'taken' ValueError: profile 'wifi': the name is taken
profiles 'number' ValueError: profile 'slow': is not a LinkSettings
profiles 'out' ValueError: profile 'slow': Expected `float` >= 0.0
"""
"""Group and name of each broken entry point, and the key phrase of the reason."""
USES = """
import agents.laws.dispatch, agents.drivers.dispatch, sim.models.sensor
from bus.policies import policy_kinds
from bus.profiles import PROFILES, SHIPPED
from bus.registry import DRIVERS, LAWS, SENSORS
from bus.roles import extension_roles
assert not {"late"} & LAWS.keys() and not {"untyped"} & DRIVERS.keys() and not {"lacks"} & SENSORS.keys()
assert LAWS["tracking"].module and PROFILES == SHIPPED
assert "roles" not in extension_roles() and "raises" not in policy_kinds("uav")
import sys
sys.argv = ["outrider", "--help"]
from outrider.cli.main import main
main()
"""


def test_what_is_broken_in_a_package_is_ignored(tmp_path: Path) -> None:
    install(tmp_path, BROKEN_POINTS)
    for name, text in BROKEN.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    unnamed = tmp_path / "unnamed-1.0.dist-info"
    unnamed.mkdir()
    (unnamed / "entry_points.txt").write_bytes(b"[outrider.laws]\n\xff = a:b\n")
    done = python(USES, env=with_package(tmp_path))
    assert "Usage: outrider" in done.stdout
    assert "raises" not in done.stdout
    lines = done.stderr.splitlines()
    assert sum("the metadata of a package without a name is ignored" in line for line in lines) == 1
    expected = [
        one.split(maxsplit=2) for one in IGNORED.replace("\n", "|").split("|") if one.strip()
    ]
    for group, name, why in expected:
        start = f"outrider: outrider.{group}: {name} of broken is ignored: {why.strip()}"
        assert sum(line.startswith(start) for line in lines) == 1, (start, lines)
    assert len(lines) == len(expected) + 1


def test_compile_cache_depends_on_plugin_files_and_names(tmp_path: Path) -> None:
    folder, own = (
        installed_guide(tmp_path / "installed"),
        {"OUTRIDER_CACHE": str(tmp_path / "cache")},
    )
    code = "from sim.compiling.compile import cache_folder; print(cache_folder().name)"

    def cache() -> str:
        return python(code, env=with_package(folder, **own)).stdout

    first = cache()
    assert cache() == first
    law = folder / "my_package" / "cautious.py"
    law.write_text(law.read_text("utf-8").replace("1.0) **", "2.0) **"), "utf-8")
    second = cache()
    points = folder / "my_package-1.0.dist-info" / "entry_points.txt"
    points.write_text(points.read_text("utf-8").split("[outrider.sensors]")[0], "utf-8")
    third, without = cache(), python(code, env=os.environ | own).stdout
    assert len({first, second, third, without}) == 4


# The package in examples/plugin


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install the package for this process; the kinds of policies are cached."""
    install(tmp_path, (PLUGIN / "pyproject.toml").read_text(encoding="utf-8"))
    for folder in (PLUGIN, tmp_path):
        monkeypatch.syspath_prepend(folder)
    policy_kinds.cache_clear()
    yield
    policy_kinds.cache_clear()


@pytest.mark.usefixtures("plugin")
def test_its_command_is_listed_and_its_policy_drives(command) -> None:
    run = words("run escort --in-process --duration 2 --no-files --json")
    plain = json.loads(command(*run).stdout)
    assert "Fly a UAV that hovers over its UGV." in command("--help").stdout
    assert "Example: outrider hover" in command("hover", "--help").stdout
    driven = command(*run, "--driver", "gain:0.3")
    assert driven.returncode == 0, driven.stderr
    assert json.loads(driven.stdout)["trajectory_sha256"] != plain["trajectory_sha256"]
    wrong = command(*run, "--driver", "gain:fast")
    assert (wrong.returncode, "allowed: gain:0.3" in wrong.stderr) == (2, True)


def test_its_network_profile_is_known_by_name(package: Path) -> None:
    refused = answer(
        package, REFUSALS.replace("sys.argv[2:]", "['links.profile=mes', 'links.profile=mesh']")
    )
    line, accepted = refused["refused"]
    assert "unknown profile, did you mean 'mesh'?" in line
    assert accepted is None


@pytest.mark.long
@pytest.mark.parametrize(("pilot", "law"), [("uav", "cautious"), ("hover", "external")])
def test_all_that_packages_add_flies_and_is_recorded(
    pilot, law, package, tmp_path, monkeypatch
) -> None:
    """Law, driver and sensor of the guide's package; pilot and sink of the example."""
    monkeypatch.setenv("PYTHONPATH", with_package(package)["PYTHONPATH"])
    connect = ("--connect", f"tcp/127.0.0.1:{free_port()}")
    track = tmp_path / "track.csv"
    with ExitStack() as stack:

        def join(*arguments: str) -> Any:
            return stack.enter_context(started(*arguments))

        run = join("simulator", str(package / "plugged.toml"), "--listen", connect[1], "--json")
        recorder = join("record", str(track), "--format", "csv", *connect)
        assert "waiting for the run" in recorder.stderr.readline()
        pilots = [join(pilot, *connect), join("ugv", *connect)]
        out, err = run.communicate(timeout=240)
        assert run.returncode == 0, err
        assert [process.wait(60) for process in pilots] == [0, 0]
        assert recorder.wait(60) == 0
    summary = json.loads(out)
    assert (summary["ticks"], summary["law"], summary["deterministic"]) == (40, law, True)
    rows = [line.split(",") for line in track.read_text(encoding="utf-8").splitlines()]
    assert rows[0] == ["time", "vehicle", "x", "y"]
    last = {name: (float(x), float(y)) for _, name, x, y in rows[1:]}
    starts = {"uav_0": (10.0, 11.0), "ugv_0": (10.0, 10.0)}
    assert last.keys() == starts.keys()
    for name, start in starts.items():
        assert pilot == "hover" or np.abs(np.subtract(last[name], start)).min() > 1e-3


SUBCOMMANDS = """
[project]
name = "additions"
[project.entry-points."outrider.commands"]
"scenarios.greet" = "greeting:greet"
"scenarios.absent" = "greeting:absent"
"scenarios.show" = "greeting:greet"
"run.twice" = "greeting:greet"
"""


def test_a_package_adds_a_subcommand_to_a_group_of_the_core(tmp_path: Path) -> None:
    install(tmp_path, SUBCOMMANDS)
    greeting = "def greet(name: str) -> None:\n    print(f'hello {name}')\n"
    (tmp_path / "greeting.py").write_text(greeting, encoding="utf-8")

    def called(*words: str) -> tuple[str, str]:
        done = python(
            "from outrider.cli.main import main; main()", *words, env=with_package(tmp_path)
        )
        return done.stdout, done.stderr

    output, errors = called("scenarios", "greet", "town")
    assert output == "hello town\n"
    assert "'scenarios.absent' of additions is ignored" in errors
    assert "'scenarios.show' of additions is ignored: Outrider has a command" in errors
    assert "certified" in called("scenarios", "show", "escort")[0]
    output, errors = called("--help")
    assert "greet" not in output
    assert "twice" not in output
