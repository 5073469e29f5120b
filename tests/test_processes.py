"""Runs with real processes: one trajectory in every environment, and clean ends."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest

from bus.locator import UNIX
from outrider.running.companions import Companions
from outrider.running.flying import fly
from outrider.running.parent import Start
from outrider.running.run_folder import run_folder
from processes import (
    OUTRIDER,
    alive,
    child_of,
    family,
    flown_both_ways,
    flying,
    free_port,
    ran,
    started,
    wait_until,
)
from sim.scenario.loading import load_scenario, scenario_names, shipped_text
from staging import hosted
from tabular import words

pytestmark = pytest.mark.usefixtures("nothing_left_behind")


def test_two_runs_at_once_fly_the_bits_of_one_process() -> None:
    """One of them has no UAV. A run with hazards and a UAV: tests/test_secret.py."""
    runs = {"escort": ["duration=40.0"], "minefield": ["uav=[]", "duration=10.0"]}
    with ExitStack() as stack:
        flying_runs = {}
        for name, changes in runs.items():
            options = [word for change in changes for word in ("--set", change)]
            arguments = ("run", name, "--seed", "7", *options, "--json", "--no-files")
            flying_runs[name] = stack.enter_context(started(*arguments))
        summaries = {
            name: json.loads(run.communicate(timeout=120)[0]) for name, run in flying_runs.items()
        }
    for name, there in summaries.items():
        _, here = fly(load_scenario(name, overrides=runs[name]), 7)
        assert there["trajectory_sha256"] == here.trajectory_sha256
        assert (there["ticks"], there["deterministic"]) == (here.ticks, True)
    processes = [one for there in summaries.values() for one in there["processes"]]
    names = words("simulator uav_0 ugv_0 simulator ugv_0")
    assert [process["name"] for process in processes] == names
    assert len({process["pid"] for process in processes}) == 5


@pytest.mark.long
@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_flies_alike_over_three_processes(name: str) -> None:
    there, here = flown_both_ways(name, "duration=100.0")
    assert there["ticks"] == here.ticks >= 2000
    assert there["deterministic"] is True


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


def test_a_run_flies_in_a_hostile_folder(tmp_path) -> None:
    """Odd paths, no standard files, and modules with the names of ours and of libraries."""
    (tmp_path / "-x #%d.toml").write_text(shipped_text("escort"), encoding="utf-8")
    (tmp_path / "mine.py").write_text(_OPEN, encoding="utf-8")
    for library in ("zenoh", "msgspec", "numba", "socket", "subprocess"):
        (tmp_path / f"{library}.py").write_text("raise SystemExit('hijacked')\n", encoding="utf-8")
    for package in ("agents", "sim", "bus", "outrider"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("raise SystemExit('hijacked')\n")
    run = words("run --driver policy --set custom.policy=mine:policy --duration 1 --no-picture")
    program = Path(sys.executable).with_name("outrider")
    shell = ["sh", "-c", 'exec "$@" 0>&- 1>&- 2>&-', "sh", program, *run]
    done = ran([*shell, "--out", "flown", "--", "-x #%d.toml"], cwd=tmp_path, timeout=120)
    assert done.returncode == 0
    files = sorted(path.name for path in (tmp_path / "flown").iterdir())
    assert files == words("coverage.npy scenario.toml summary.json trajectory.csv")
    assert json.loads((tmp_path / "flown" / "summary.json").read_bytes())["ticks"] == 20
    # a file that a policy leaves open is written to its end
    assert (tmp_path / "kept.csv").read_text().count("a row") >= 20
    shutil.rmtree(tmp_path / "outrider")  # `python -m outrider` runs the folder's own
    assert ran([*OUTRIDER, "check", "./-x #%d.toml"], cwd=tmp_path).returncode == 0


@pytest.mark.parametrize("name", ["long" * 25, "a#b?c d%20$e[f]{g}"])
def test_socket_folder_is_usable_below_a_hostile_one(name, tmp_path, monkeypatch) -> None:
    (tmp_path / name).mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / name))
    with run_folder() as own, hosted(f"{UNIX}/{own}/bus.sock"):
        assert (own / "bus.sock").is_socket()
    assert not own.exists()


def test_dead_vehicle_brakes_and_is_named_by_the_run(tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="the extra [record] is not installed")
    from outrider.recording.reader import statuses  # noqa: PLC0415 - an extra

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


_KILLED = """
import os, signal, tempfile
from outrider.running.parent import read_start

signal.signal(signal.SIGTERM, signal.SIG_IGN)
read_start()
tempfile.mkdtemp()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_simulator_that_is_killed_leaves_no_temporary_file(monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    with run_folder() as folder:
        line = msgspec.json.encode(Start(folder=str(folder))) + b"\n"
        killed = subprocess.run([sys.executable, "-c", _KILLED], input=line, check=False)
        assert killed.returncode == -signal.SIGKILL


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


class StandIn:
    """Companion process that a test controls."""

    name = "map"
    ended: int | None = None

    def exit_report(self) -> str:
        return "map ended with exit code 1"


def test_companion_that_is_ready_late_still_shows_its_address() -> None:
    events: list[str] = []
    child, given = StandIn(), list[Any]()
    companions = Companions(events.append, patience=0.0)

    def start(lines: Any) -> Any:
        given.append(lines)
        return child

    companions.add(start)
    assert companions.failed_before_ready(lambda: False) is None
    companions.report()
    given[0].put(b"map of the run: http://127.0.0.1:1/\n")
    companions.report()
    companions.report()
    child.ended = 1
    companions.report()
    assert events == [
        "map is still starting; the run does not wait for it",
        "map of the run: http://127.0.0.1:1/",
        "map ended with exit code 1; the run continues without it",
    ]
