"""Runs under the faults of real deployments: processes that are killed, frozen, disconnected, and return."""

import errno
import json
import os
import signal
import socket
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest

from bus.messages.telemetry import Status
from outrider import style
from outrider.cli import scenarios
from outrider.running import launch
from outrider.running.flying import fly
from processes import (
    SHORT,
    alive,
    await_status,
    child_of,
    flying,
    launched,
    observing,
    python,
)
from scattered import SECONDS, SECRET, scattered
from sim.scenario.loading import load_scenario
from sim.scenario.types import Run
from tabular import words

pytestmark = pytest.mark.usefixtures("nothing_left_behind")
WHOLE = load_scenario("escort", overrides=[f"duration={SECONDS}"])
QUIET = ("escort", "--duration", str(SECONDS), "--no-files", "--json")


@cache
def undisturbed(secret: str = "") -> str:
    """Return the hash of that run without faults."""
    return fly(WHOLE, 7, secret=secret)[1].trajectory_sha256


def finished(run: "subprocess.Popen[str]", seconds: float = 90.0) -> tuple[dict[str, object], str]:
    """Return summary and standard error of a run that has ended."""
    out, err = run.communicate(timeout=seconds)
    assert run.returncode == 0, err
    return json.loads(out), err


def ended(vehicle: "subprocess.Popen[str]", why: str) -> None:
    """Wait until a vehicle's process has ended by itself, with one line as the reason."""
    _, err = vehicle.communicate(timeout=60)
    assert vehicle.returncode == 1
    assert why in err
    assert len(err.strip().splitlines()) == 1


def test_respawn_after_a_kill_and_a_freeze_changes_no_bit() -> None:
    with flying(*QUIET, "--respawn") as run:
        before, frozen = child_of(run, "uav"), child_of(run, "ugv")
        os.kill(frozen, signal.SIGSTOP)
        os.kill(before, signal.SIGKILL)
        with observing(run) as session:
            await_status(session, lambda status: status.vehicles["ugv_0"].lost == 1)
        os.kill(frozen, signal.SIGCONT)
        summary, err = finished(run)
    assert summary["trajectory_sha256"] == undisturbed()
    assert summary["deterministic"] is True
    assert summary["faults"]["uav_0"] == {"lost": 1, "joined again": 1}
    assert "uav_0 disconnected at tick" in err
    assert "uav_0 rejoined at tick" in err
    assert not alive(before)


def answered(status: Status) -> int:
    """Return the number of ticks with a new command of the UAV."""
    return status.tick - status.vehicles["uav_0"].missing_commands


def test_absent_vehicle_brakes_in_real_time_and_resumes():
    endless = ("escort", "--duration", "100000", "--no-files", "--json")
    with flying(*endless, "--realtime", "20", "--respawn") as run:
        with observing(run) as session:
            await_status(session, lambda status: status.tick > 0)  # it observes the current ticks
            os.kill(child_of(run, "uav"), signal.SIGKILL)
            absent = await_status(session, lambda status: status.vehicles["uav_0"].lost == 1)
            back = await_status(session, lambda status: status.vehicles["uav_0"].rejoined == 1)
            flies = answered(back) + 100
            later = await_status(session, lambda status: answered(status) > flies)
        run.send_signal(signal.SIGINT)
        summary = json.loads(run.communicate(timeout=60)[0])
    assert absent.target_factor == 20.0
    assert back.tick > absent.tick  # no tick waited
    assert later.vehicles["uav_0"].missing_commands >= 10
    faults = summary["faults"]
    assert isinstance(faults, dict)
    assert faults["uav_0"]["lost"] == faults["uav_0"]["joined again"] == 1
    assert summary["realtime"] == 20.0


def test_repeatedly_failing_vehicle_is_not_restarted_forever(tmp_path: Path) -> None:
    (tmp_path / "deadly.py").write_text(
        "import os\n\ndef weighting(distance, r_s):\n"
        "    if 'OUTRIDER_DIES' in os.environ and distance > 2.0 and distance < r_s:\n        os._exit(3)\n"
        "    return (1.0, 0.0) if distance >= r_s else (0.5, 0.5)\n",
        encoding="utf-8",
    )
    code = (
        "import sys\nfrom outrider.cli import main\nimport outrider.running.user_code as own\n"
        "own.check_own_functions = lambda scenario: ()\nsys.argv[0] = 'outrider'\nmain.main()\n"
    )
    arguments = words(
        "run --law weighted --set custom.weighting=deadly:weighting --respawn --no-files --json"
    )
    settings = {"cwd": tmp_path, "env": os.environ | {"OUTRIDER_DIES": "1"}, "timeout": 150}
    run = python(code, *arguments, check=False, **settings)
    assert run.returncode == 1
    assert "uav_0 (pid" in run.stderr
    assert "ended with exit code 3" in run.stderr
    assert "is not restarted" in run.stderr
    assert "did not reconnect" not in run.stderr  # the run ends at once and does not wait
    assert json.loads(run.stdout)["complete"] is False


def test_a_vehicle_killed_before_the_first_tick_is_started_again(monkeypatch):
    class Doomed(launch.Child):
        started: ClassVar[list[str]] = []

        def __init__(self, name: str, *arguments: Any, **named: Any) -> None:
            super().__init__(name, *arguments, **named)
            if name != "simulator" and name not in self.started:
                self.kill()  # before it has loaded Python
            self.started.append(name)

    monkeypatch.setattr(launch, "Child", Doomed)
    scenario = msgspec.structs.replace(SHORT, run=Run(respawn=True))
    outcome = launched(scenario=scenario)
    assert outcome.summary is not None
    flown = fly(SHORT, SHORT.seed)[1].trajectory_sha256
    assert outcome.summary.trajectory_sha256 == flown
    assert not outcome.fault
    assert Doomed.started == ["simulator", "uav_0", "ugv_0", "uav_0", "ugv_0"]


def test_simulator_and_router_that_return_change_no_bit(tmp_path: Path) -> None:
    """The restarted router is for this run alone, and ends with it."""
    with scattered(tmp_path) as run:
        router = run.router()
        simulator = run.simulator()
        vehicles = run.vehicles()
        run.fly_to(500)
        simulator.kill()
        simulator.wait()
        simulator = run.simulator()  # its run begins again
        run.fly_to(500)
        router.kill()
        router.wait()
        again = run.router("--once")
        summary, err = finished(simulator)
        assert [process.wait(30.0) for process in (*vehicles, again)] == [0, 0, 0]
    assert summary["trajectory_sha256"] == undisturbed(SECRET)
    assert summary["deterministic"] is True
    assert "router reconnected" in err  # it may have been absent too briefly to be noticed


def test_lost_router_ends_every_process_with_a_reason(tmp_path: Path) -> None:
    with scattered(tmp_path) as run:
        router = run.router()
        simulator = run.simulator("--join-timeout", "5")
        vehicles = run.vehicles("--join-timeout", "5")  # all start at about the same time
        run.fly_to(100)
        router.kill()
        router.wait()
        out, err = simulator.communicate(timeout=60)
        assert simulator.returncode == 1
        assert "the router has been disconnected for 5 s" in err
        assert "Traceback" not in err
        assert json.loads(out)["ticks"] > 100  # the flown part is kept
        for vehicle in vehicles:
            ended(vehicle, "the router has been absent for 5 s")


def test_lost_simulator_ends_vehicles_with_a_reason(tmp_path: Path) -> None:
    with scattered(tmp_path) as run:
        run.router()
        simulator = run.simulator()
        run.await_simulator()
        vehicles = run.vehicles("--join-timeout", "2")
        run.fly_to(100)
        simulator.kill()
        for vehicle in vehicles:
            ended(vehicle, "the simulator has been absent for 2 s")


def test_a_port_in_use_is_named(command) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        run = command("router", "--listen", endpoint)
    assert run.returncode == 1
    assert f"cannot listen on {endpoint}: " in run.stderr
    assert "Address already in use" in run.stderr
    assert "Traceback" not in run.stderr


def test_full_disk_loses_the_file_but_not_the_result(tmp_path: Path, command) -> None:
    """/dev/full fails every write like a full disk."""
    for name in ("trajectory.csv", "flight.png"):
        (tmp_path / name).symlink_to("/dev/full")
    run = command("run", "--in-process", "--duration", "20", "--out", tmp_path, "--json")
    assert run.returncode == 1
    assert "No space left on device" in run.stderr
    assert "trajectory.csv" in run.stderr
    assert "Traceback" not in run.stderr
    summary = json.loads(run.stdout)
    assert summary["ticks"] == 400
    kept = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert kept["trajectory_sha256"] == summary["trajectory_sha256"]
    assert (tmp_path / "coverage.npy").stat().st_size > 100_000


def test_a_summary_that_cannot_be_written_is_printed(tmp_path, command, monkeypatch) -> None:
    def full(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr("outrider.view.output.write_whole", full)
    words_ = ("run", "escort", "--duration", "1", "--in-process", "--json", "--out", tmp_path)
    flown = command(*words_)
    assert flown.returncode == 1
    assert json.loads(flown.stdout)["ticks"] == 20
    (line,) = flown.stderr.splitlines()
    assert "summary.json: No space left on device" in line


def test_files_with_a_secret_are_new_files_of_their_owner(tmp_path, command) -> None:
    pytest.importorskip("foxglove", reason="the extra [record] is not installed")
    secret = "0123456789abcdef" * 4
    old = {name: tmp_path / name for name in ("summary.json", "run.mcap")}
    readers = {}
    for name, path in old.items():
        path.write_text("old")
        readers[name] = path.open("rb")
    flown = command(
        *("run", "escort", "--duration", "1", "--in-process", "--secret", secret),
        *("--out", tmp_path, "--record", old["run.mcap"]),
    )
    assert flown.returncode == 0, flown.stderr
    for name, path in old.items():
        assert readers[name].read() == b"old"
        readers[name].close()
        assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("written", ["figure-1.png", "mine.toml"])
def test_a_full_disk_names_the_file_that_could_not_be_written(tmp_path: Path, written) -> None:
    """Neither the system nor the writing library names the file."""
    full = tmp_path / written
    full.symlink_to("/dev/full")
    writers: dict[str, Callable[[], object]] = {
        "figure-1.png": lambda: style.save(style.new_figure(200, 200), full),
        "mine.toml": lambda: scenarios.new(full, force=True, schema=False),
    }
    with pytest.raises(OSError, match="No space left") as error:
        writers[written]()
    assert error.value.filename == str(full)
