"""Runs with real processes: one trajectory in every environment, and clean ends."""

import json
import os
import signal
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


def test_two_runs_at_once_fly_the_bits_of_one_process() -> None:
    """Scenarios with hazards: tests/test_ground_flights.py."""
    arguments = words("run escort --duration 40 --json --no-files")
    with started(*arguments) as one, started(*arguments) as other:
        summaries = [json.loads(run.communicate(timeout=120)[0]) for run in (one, other)]
    _, here = fly(load_scenario("escort", overrides=["duration=40.0"]), 7)
    for there in summaries:
        assert there["trajectory_sha256"] == here.trajectory_sha256
        assert (there["ticks"], there["deterministic"]) == (800, True)
        names = [process["name"] for process in there["processes"]]
        assert names == ["simulator", "uav_0", "ugv_0"]
    assert len({process["pid"] for there in summaries for process in there["processes"]}) == 6


@pytest.mark.long
@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_flies_alike_over_three_processes(name: str) -> None:
    _same_bits(name, 100.0)


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


_OPEN = """
FILE = open("kept.csv", "w")

def policy(*seen):
    FILE.write("a row\\n")
    return 0.05, 0.0
"""


SCRIPT = [Path(sys.executable).with_name("outrider")]


@pytest.mark.parametrize(
    ("name", "closed", "program"),
    [("long" * 25, "0 1 2", OUTRIDER), ("a#b?c d%20$e[f]{g}", "0 1", SCRIPT)],
    ids=["long", "odd"],
)
def test_a_run_flies_in_a_hostile_folder(name, closed, program, tmp_path, monkeypatch) -> None:
    """Odd paths, no standard files, and modules with the names of ours and of libraries."""
    monkeypatch.setenv("TMPDIR", str(tmp_path / name))
    (tmp_path / name).mkdir()
    (tmp_path / "-x #%d.toml").write_text(shipped_text("escort"), encoding="utf-8")
    (tmp_path / "mine.py").write_text(_OPEN, encoding="utf-8")
    for library in ("zenoh", "msgspec", "numba", "socket", "subprocess"):
        (tmp_path / f"{library}.py").write_text("raise SystemExit('hijacked')\n", encoding="utf-8")
    # `python -m outrider` runs the folder's own outrider, if it has one
    for package in ("agents", "sim", "bus", "outrider")[: 3 + (program is SCRIPT)]:
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("raise SystemExit('hijacked')\n")
    run = words("run --driver policy --set custom.policy=mine:policy --duration 1 --no-picture")
    closing = " ".join(f"{number}>&-" for number in closed.split())
    shell = ["sh", "-c", f'exec "$@" {closing}', "sh", *program, *run]
    done = ran([*shell, "--out", "flown", "--", "-x #%d.toml"], cwd=tmp_path, timeout=120)
    assert done.returncode == 0, done.stderr
    files = sorted(path.name for path in (tmp_path / "flown").iterdir())
    assert files == words("coverage.npy scenario.toml summary.json trajectory.csv")
    assert json.loads((tmp_path / "flown" / "summary.json").read_bytes())["ticks"] == 20
    # a file that a policy leaves open is written to its end
    assert (tmp_path / "kept.csv").read_text().count("a row") >= 20
    assert not list((tmp_path / name).iterdir())


def test_signal_during_exit_is_silent() -> None:
    code = (
        "import atexit, os, signal, sys\nfrom outrider.cli.main import main\n"
        "atexit.register(os.kill, os.getpid(), signal.SIGTERM)\n"
        "sys.argv = ['outrider', '--version']\nmain()\n"
    )
    ended = python(code, check=False)
    assert ended.stdout.startswith("outrider ")
    assert (ended.stderr, ended.returncode) == ("", 0)


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


def test_a_vehicle_that_never_comes_is_named(command) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    run = command("simulator", "escort", "--listen", endpoint, "--join-timeout", "0.2")
    assert run.returncode == 1
    assert "uav_0 and ugv_0 did not join within 0.2 s" in run.stderr
    assert "Traceback" not in run.stderr


def test_the_next_start_removes_what_a_killed_run_left(monkeypatch) -> None:
    """A killed run may leave its folder before it has started any process."""
    folder = Path(os.environ["TMPDIR"])
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    (folder / "outrider-killed").mkdir(mode=0o700)
    (folder / "outrider-killed" / ".lock").touch()
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
