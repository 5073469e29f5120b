"""A law, a driver and a sensor of another package, as in CONTRIBUTING.md, fly in every environment."""

import json
import os
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from processes import python

# on one worker: all is compiled once
pytestmark = pytest.mark.xdist_group("plugins")
ROOT = Path(__file__).resolve().parent.parent
GUIDE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = dict(
    re.findall(r"```(?:python|toml)\n# (my_package/\S+|pyproject.toml)\n(.*?)```", GUIDE, re.DOTALL)
)
"""The files of the package by name."""
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
import numpy as np
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
BATCH = """
import json, sys
import outrider
from outrider.envs.closed_loop import ClosedLoop

loop = ClosedLoop(outrider.load_scenario(sys.argv[1]), 1)
loop.begin([3])
loop.fly()
print(json.dumps({"positions": loop.state.batch.vehicles["position"][0].tolist()}))
"""


def install(folder: Path, points: str = BLOCKS["pyproject.toml"]) -> Path:
    """Install the guide's package with its entry points into a folder."""
    (folder / "my_package").mkdir(parents=True)
    (folder / "my_package" / "__init__.py").touch()
    for name, text in BLOCKS.items():
        if name != "pyproject.toml":
            (folder / name).write_text(text, encoding="utf-8")
    info = folder / "my_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n", "utf-8"
    )
    groups = tomllib.loads(points)["project"]["entry-points"]
    lines = [
        line
        for group, named in groups.items()
        for line in (f"[{group}]", *(f"{name} = {where}" for name, where in named.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines), "utf-8")
    return folder


def with_package(folder: Path, **more: str) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))} | more


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a folder with the installed package and a scenario that needs it."""
    folder = install(tmp_path_factory.mktemp("installed"))
    (folder / "plugged.toml").write_text(SCENARIO, encoding="utf-8")
    return folder


def answer(package: Path, code: str) -> dict[str, Any]:
    """Return the JSON output of a program that uses the package and the scenario."""
    done = python(code, str(package / "plugged.toml"), env=with_package(package), cwd=package)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def flights(package: Path) -> dict[str, Any]:
    """Return runs in one process."""
    return answer(package, FLIGHTS)


def test_law_driver_and_sensor_of_a_package_fly_in_one_process(flights: dict[str, Any]) -> None:
    assert len(set(flights["hashes"])) == 5
    assert np.abs(np.subtract(flights["positions"], [[10.0, 11.0], [10.0, 10.0]])).min() > 1e-3


def test_they_fly_alike_in_a_batch(package: Path, flights: dict[str, Any]) -> None:
    apart = np.subtract(answer(package, BATCH)["positions"], flights["positions"])
    assert np.abs(apart).max() < 1e-6


def test_they_fly_the_same_bits_in_processes_of_their_own(package, flights) -> None:
    code = "import sys; sys.argv[0] = 'outrider'; from outrider.cli.main import run_command_line as r; sys.exit(r())"
    words = ("run", str(package / "plugged.toml"), "--seed", "3", "--json", "--no-files")
    done = python(code, *words, env=with_package(package), cwd=package)
    assert json.loads(done.stdout)["trajectory_sha256"] == flights["hashes"][0]


REFUSED = {
    "law.name=cautios": "did you mean 'cautious'?",
    "law.parameters.powr=1": "law.parameters.powr = 1: unknown parameter, did you mean 'power'?",
    "law.parameters.power=x": 'law.parameters.power = "x": not a number',
    "ugv.0.driver=zigzg": "did you mean 'zigzag'?",
    "sensor.model=con": "did you mean 'cone'?",
}


def test_check_knows_them(package: Path) -> None:
    code = (
        "import sys\nfrom outrider.cli.main import run_command_line\n_, file, *changes = sys.argv\n"
        "for change in changes:\n"
        "    sys.argv = ['outrider', 'check', file, '--set', change]\n"
        "    assert run_command_line() == 2\n"
    )
    own = {"env": with_package(package, COLUMNS="300"), "cwd": package}
    lines = python(code, str(package / "plugged.toml"), *REFUSED, **own).stderr.splitlines()
    assert len(lines) == len(REFUSED)
    assert all(phrase in line for phrase, line in zip(REFUSED.values(), lines, strict=True)), lines


@pytest.mark.parametrize(
    ("points", "phrase"),
    [
        ({"outrider.laws": {"gone": "my_package.rows:GONE"}}, "outrider.laws: 'gone' of my-package is ignored: module"),
        ({"outrider.laws": {"cone": "my_package.rows:CONE"}}, "is ignored: my_package.rows:CONE is not a LawRow"),
    ],
    ids=["nothing there", "another kind"],
)  # fmt: skip
def test_an_entry_point_that_names_no_row_is_ignored(tmp_path, points, phrase) -> None:
    group, named = next(iter(points.items()))
    ((name, where),) = named.items()
    text = f'[project.entry-points."{group}"]\n{name} = "{where}"\n'
    done = python(
        "import bus.registry", check=False, env=with_package(install(tmp_path / "p", text))
    )
    assert phrase in done.stderr


def test_compile_cache_depends_on_plugin_files_and_names(tmp_path: Path) -> None:
    folder, own = install(tmp_path / "installed"), {"OUTRIDER_CACHE": str(tmp_path / "cache")}
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
