"""The package in examples/plugin, installed beside Outrider: its command, policy, pilot and sink work."""

import json
import os
import subprocess
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from processes import OUTRIDER, PIPES, free_port, outrider

PLUGIN = Path(__file__).parents[1] / "examples" / "plugin"


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """Return an environment in which the package is installed as by `pip install`."""
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = tmp_path / "site" / f"outrider_hover-{project['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    groups = project["entry-points"].items()
    lines = [
        f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in one.items()) for group, one in groups
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    path = os.pathsep.join((str(info.parent), str(PLUGIN), os.environ.get("PYTHONPATH", "")))
    return os.environ | {"PYTHONPATH": path}


def test_its_command_is_listed_and_has_its_help(installed: dict[str, str]) -> None:
    listed = outrider("--help", env=installed).stdout
    assert "Fly a UAV that hovers over its UGV." in listed
    assert "Example: outrider hover" in outrider("hover", "--help", env=installed).stdout


def test_its_policy_drives(installed: dict[str, str]) -> None:
    words = ("run", "escort", "--in-process", "--duration", "2", "--no-files", "--json")
    driven = outrider(*words, "--driver", "gain:0.3", env=installed, timeout=300.0)
    assert driven.returncode == 0, driven.stderr
    plain = json.loads(outrider(*words, timeout=300.0).stdout)
    assert json.loads(driven.stdout)["trajectory_sha256"] != plain["trajectory_sha256"]
    wrong = outrider(*words, "--driver", "gain:fast", env=installed)
    assert (wrong.returncode, "allowed: gain:0.3" in wrong.stderr) == (2, True)
    assert outrider(*words, "--driver", "gain:0.3").returncode == 2


@contextmanager
def process(*arguments: str, env: dict[str, str]) -> Iterator[Any]:
    with subprocess.Popen([*OUTRIDER, *arguments], **PIPES, env=env) as one:
        try:
            yield one
        finally:
            one.kill()


def test_its_pilot_flies_and_its_sink_records(installed: dict[str, str], tmp_path: Path) -> None:
    connect = ("--connect", f"tcp/127.0.0.1:{free_port()}")
    track = tmp_path / "track.csv"
    with ExitStack() as stack:

        def join(*arguments: str) -> Any:
            return stack.enter_context(process(*arguments, env=installed))

        run = join("simulator", "escort", "--duration", "1", "--listen", connect[1], "--json")
        recorder = join("record", str(track), "--format", "csv", *connect)
        assert "waiting for the run" in recorder.stderr.readline()
        pilots = [join("hover", *connect), join("ugv", *connect)]
        out, err = run.communicate(timeout=120)
        assert run.returncode == 0, err
        assert [pilot.wait(60) for pilot in pilots] == [0, 0]
        assert recorder.wait(60) == 0
    assert json.loads(out)["ticks"] == 20
    rows = [line.split(",") for line in track.read_text(encoding="utf-8").splitlines()]
    assert rows[0] == ["time", "vehicle", "x", "y"]
    assert {row[1] for row in rows[1:]} == {"uav_0", "ugv_0"}
    again = outrider("record", str(track), "--format", "csv", *connect, env=installed)
    assert (again.returncode, "exists already" in again.stderr) == (2, True)
