"""Runs with real processes: one trajectory in every environment, and clean ends."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from outrider.running.flying import fly
from outrider.running.run_folder import run_folder
from processes import (
    OUTRIDER,
    alive,
    child_of,
    family,
    flown_both_ways,
    flying,
    free_port,
    outrider,
    python,
    ran,
    started,
    wait_until,
)
from sim.scenario.loading import load_scenario, scenario_names, shipped_text
from tabular import words

pytestmark = pytest.mark.usefixtures("nothing_left_behind")


def _same_bits(name: str, seconds: float) -> None:
    there, here = flown_both_ways(name, f"duration={seconds}")
    assert there["ticks"] == here.ticks >= round(seconds / 0.05)
    assert there["deterministic"] is True
    names = [process["name"] for process in there["processes"]]
    assert names == ["simulator", "uav_0", "ugv_0"]
    assert len({process["pid"] for process in there["processes"]}) == 3


@pytest.mark.parametrize(
    ("name", "seconds"),
    [("escort", 50.0), ("scenario-2", 10.0)],
)
def test_three_processes_and_one_fly_the_same_bits(name: str, seconds: float) -> None:
    """Scenarios with hazards: tests/test_ground_flights.py."""
    _same_bits(name, seconds)


@pytest.mark.long
@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_flies_alike_over_three_processes(name: str) -> None:
    _same_bits(name, 100.0)


def test_two_runs_at_once_do_not_meet() -> None:
    command = [*OUTRIDER, *words("run escort --duration 40 --json --no-files")]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    runs = [subprocess.Popen(command, **pipes) for _ in range(2)]
    hashes = [json.loads(run.communicate(timeout=120)[0])["trajectory_sha256"] for run in runs]
    assert hashes[0] == hashes[1]


def test_ctrl_c_ends_all_processes_and_keeps_what_was_flown(tmp_path: Path) -> None:
    with flying("escort", "--duration", "20000", "--out", str(tmp_path), "--json") as run:
        children = family(run.pid)
        run.send_signal(signal.SIGINT)
        out, _ = run.communicate(timeout=60)
        assert run.returncode == 130
    summary = json.loads(out)
    assert 0 < summary["ticks"] < 400_000
    assert summary["complete"] is False
    rows = (tmp_path / "trajectory.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + summary["ticks"] + 1
    assert {log.name: log.read_text() for log in tmp_path.glob("logs/*")} == {}
    files = words("coverage.npy flight.png scenario.toml summary.json trajectory.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == files
    assert not any(alive(child) for child in children)
    # the flown part is the beginning of the whole run
    _, whole = fly(load_scenario("escort", overrides=[f"duration={summary['ticks'] * 0.05!r}"]), 7)
    assert whole.trajectory_sha256 == summary["trajectory_sha256"]


@pytest.mark.parametrize("name", ["long" * 25, "a#b?c d%20$e[f]{g}"])
def test_a_run_flies_whatever_its_paths_are(name: str, tmp_path, monkeypatch) -> None:
    folder = tmp_path / name
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    (tmp_path / "-x #%d.toml").write_text(shipped_text("escort"), encoding="utf-8")
    command = (*words("run --duration 1 --no-files --json --"), "-x #%d.toml")
    run = outrider(*command, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert not list(folder.iterdir())


@pytest.mark.parametrize("closed", ["0 1", "0 1 2"])
def test_a_run_does_not_need_its_standard_files(closed: str, tmp_path: Path) -> None:
    """Sockets and pipes then have other descriptors."""
    closing = " ".join(f"{number}>&-" for number in closed.split())
    run = words("run escort --duration 1 --no-picture --out")
    shell = ["sh", "-c", f'exec "$@" {closing}', "sh", *OUTRIDER, *run, tmp_path / "mine"]
    assert ran(shell, timeout=120).returncode == 0
    names = sorted(path.name for path in (tmp_path / "mine").iterdir())
    assert names == words("coverage.npy scenario.toml summary.json trajectory.csv")


def _ending(before: str) -> "subprocess.CompletedProcess[str]":
    """Run the end of a command after this code."""
    code = f"import atexit, os, signal, sys, threading, time\nfrom outrider.cli.main import main\n{before}\n"
    return python(f"{code}sys.argv = ['outrider', '--version']\nmain()\n", check=False)


def test_signal_during_exit_is_silent() -> None:
    ended = _ending("atexit.register(os.kill, os.getpid(), signal.SIGTERM)")
    assert ended.stdout.startswith("outrider ")
    assert (ended.stderr, ended.returncode) == ("", 0)


def test_output_that_cannot_be_written_at_the_end_is_a_failure() -> None:
    ended = _ending(
        "class Full:\n    def flush(self):\n        raise OSError(28, 'No space left on device')\n"
        "atexit.register(setattr, sys, 'stdout', Full())"
    )
    assert ended.returncode > 0


_OPEN = """
FILE = open("kept.csv", "w")

def policy(*seen):
    FILE.write("a row\\n")
    return 0.0, 0.0
"""


def test_a_file_that_a_policy_leaves_open_is_written_out(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(_OPEN)
    changes = words("ugv.0.driver=policy custom.policy=mine:policy")
    options = [word for change in changes for word in ("--set", change)]
    command = ["run", "escort", "--duration", "1", "--no-files", *options]
    run = outrider(*command, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "kept.csv").read_text().count("a row") >= 20


def test_dead_vehicle_brakes_and_is_named_by_the_run(tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="the extra [record] is not installed")
    from outrider.recording.reader import statuses

    recorded = tmp_path / "run.mcap"
    options = ["escort", *words("--duration 100 --no-picture --json --out"), str(tmp_path)]
    options += ["--record", str(recorded)]
    with flying(*options) as run:
        children = family(run.pid)
        os.kill(child_of(run, "ugv"), signal.SIGKILL)
        out, err = run.communicate(timeout=60)
        assert run.returncode == 1
    assert "ugv_0 (pid" in err
    assert "killed by signal 9" in err
    summary = json.loads(out)
    assert summary["ticks"] == 2_000
    assert summary["complete"] is True
    assert summary["deterministic"] is False
    assert summary["faults"]["ugv_0"]["lost"] == 1
    assert [*statuses(recorded)][-1].vehicles["ugv_0"].lost == 1
    assert (tmp_path / "trajectory.csv").stat().st_size > 0
    assert not any(alive(child) for child in children)


def test_a_simulator_that_dies_ends_the_run_with_its_name() -> None:
    with flying("escort", "--duration", "20000", "--no-files") as run:
        children = family(run.pid)
        os.kill(child_of(run, "simulator"), signal.SIGKILL)
        _, err = run.communicate(timeout=60)
        assert run.returncode == 1
    assert "simulator (pid" in err
    assert "killed by signal 9" in err
    assert not any(alive(child) for child in children)


def test_a_killed_run_leaves_no_process_and_no_credentials() -> None:
    with flying("escort", "--duration", "20000", "--no-files") as run:
        children, folder = family(run.pid), Path(os.environ["TMPDIR"])
        files = sorted(folder.glob("outrider-*/*.json"))
        assert [path.name for path in files] == ["observer.json", "operator.json"]
        assert [path.stat().st_mode & 0o777 for path in files] == [0o600] * 2
        run.kill()
        run.wait()
        wait_until(lambda: not any(alive(child) for child in children))
        wait_until(lambda: not list(folder.iterdir()))


def test_a_vehicle_that_never_comes_is_named() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    run = outrider("simulator", "escort", "--listen", endpoint, "--join-timeout", "0.2")
    assert run.returncode == 1
    assert "uav_0 and ugv_0 did not join within 0.2 s" in run.stderr
    assert "Traceback" not in run.stderr


def test_files_in_the_working_folder_shadow_no_module(tmp_path: Path) -> None:
    for name in ("zenoh", "msgspec", "numba", "socket", "subprocess"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('hijacked')\n", encoding="utf-8")
    hostile = 'raise SystemExit(f"hijacked by {__name__}")\n'
    mine = "def policy(observation, briefing):\n    return (0.05, 0.0)\n"
    (tmp_path / "mine.py").write_text(mine, encoding="utf-8")
    checked = outrider("check", "escort", cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    for name in ("agents", "sim", "bus", "outrider"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(hostile, encoding="utf-8")
    # `python -m outrider` runs the folder's own outrider, if it has one
    script = Path(sys.executable).with_name("outrider")
    arguments = words(
        "run --driver policy --set custom.policy=mine:policy --duration 1 --no-files --json"
    )
    run = ran([script, *arguments], cwd=tmp_path, timeout=120)
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["ticks"] == 20


def test_the_next_start_removes_what_a_killed_run_left(monkeypatch) -> None:
    """A killed run may leave its folder before it has started any process."""
    folder = Path(os.environ["TMPDIR"])
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with started("run", "escort", "--duration", "1", "--no-files") as run:
        wait_until(lambda: list(folder.glob("outrider-*/.lock")))
        run.kill()
        run.wait()
    with run_folder() as own:
        assert list(folder.glob("outrider-*/.lock")) == [own / ".lock"]
        with run_folder() as other:  # a live run keeps its folder
            assert own.exists()
            assert other != own


def test_a_run_over_many_processes_is_refused(here: Path, command) -> None:
    uavs = "".join(f"[[uav]]\nescorts='ugv_{k}'\nposition=[{1 + k}.0, 9.0]\n" for k in range(25))
    ugvs = "".join(f"[[ugv]]\nposition=[{1 + k}.0, 8.0]\n" for k in range(25))
    (here / "many.toml").write_text(f"duration=1.0\n[law]\nname='linear'\n{uavs}{ugvs}")
    refused = command("run", "many.toml")
    assert refused.returncode == 2
    assert "needs 51 processes; allowed: 20" in refused.stderr
    assert list(here.iterdir()) == [here / "many.toml"]
