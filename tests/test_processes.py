"""Runs with real processes: one trajectory, however it is flown, and clean ends."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bus.keys import STATUS, Party, Role
from bus.messages import Status
from bus.session import open_session
from outrider.launch import Child
from outrider.run import fly
from sim.scenario import load_scenario, scenario_names

OUTRIDER = [sys.executable, "-m", "outrider"]


def outrider(*arguments: str, timeout: float = 120.0) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([*OUTRIDER, *arguments], capture_output=True, text=True, check=False, timeout=timeout)


def run_json(*arguments: str) -> dict[str, object]:
    run = outrider("run", *arguments, "--json", "--no-files")
    assert run.returncode == 0, run.stderr
    summary: dict[str, object] = json.loads(run.stdout)
    return summary


def family(pid: int) -> list[int]:
    """Children of a process, by the kernel's own list."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    return [int(child) for child in text.split()]


def alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_until(condition, seconds: float = 30.0) -> None:
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "waited in vain"
        time.sleep(0.02)


@pytest.fixture(autouse=True)
def nothing_left_behind(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Each test has a folder for temporary things of its own, which must be empty in the end; its path is short, for sockets."""
    with tempfile.TemporaryDirectory(prefix="o-") as folder:
        monkeypatch.setenv("TMPDIR", folder)
        yield
        wait_until(lambda: not os.listdir(folder))


def wait_for_tick(run: "subprocess.Popen[str]") -> None:
    """Until the run has flown for a moment, as an observer on its bus sees it."""
    words = command_line(child_of(run, "simulator")).split()
    endpoint, name = words[words.index("--listen") + 1], words[words.index("--run") + 1]
    wait_until(lambda: Path(endpoint.removeprefix("unixsock-stream/")).exists())
    with open_session(Party(role=Role.OBSERVER, name="watcher"), name, connect=endpoint) as session:
        inbox = session.inbox(STATUS)
        limit = time.monotonic() + 60.0
        while time.monotonic() < limit:
            letter = inbox.receive(1.0)
            if letter is not None and isinstance(letter.message, Status) and letter.message.tick > 20:
                return
    raise AssertionError("the run never flew")


@contextmanager
def flying(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """A run in the background that is under way: all its children are there and it has flown for a moment."""
    run = subprocess.Popen([*OUTRIDER, "run", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        wait_until(lambda: len(family(run.pid)) == 3)
        wait_for_tick(run)
        yield run
    finally:
        if run.poll() is None:
            run.kill()
            run.wait()
        for stream in (run.stdout, run.stderr):
            if stream:
                stream.close()


def command_line(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()


def child_of(run: "subprocess.Popen[str]", what: str) -> int:
    return next(pid for pid in family(run.pid) if f" outrider {what} " in command_line(pid))


@pytest.mark.parametrize("name", scenario_names())
def test_three_processes_and_one_fly_the_same_bits(name: str) -> None:
    scenario = load_scenario(name)
    _, here = fly(scenario, scenario.seed)
    assert here.ticks >= 2000
    there = run_json(name)
    assert there["trajectory_sha256"] == here.trajectory_sha256
    assert there["ticks"] == here.ticks
    assert there["deterministic"] is True
    processes = there["processes"]
    assert isinstance(processes, list)
    assert [process["name"] for process in processes] == ["simulator", "uav_0", "ugv_0"]
    assert len({process["pid"] for process in processes}) == 3


def test_another_seed_of_a_noisy_scenario_is_another_trajectory() -> None:
    hashes = {str(run_json("escort", "--seed", str(seed), "--in-process")["trajectory_sha256"]) for seed in (1, 2, 3)}
    assert len(hashes) == 3


def test_two_runs_at_once_do_not_meet() -> None:
    runs = [
        subprocess.Popen([*OUTRIDER, "run", "escort", "--json", "--no-files"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        for _ in range(2)
    ]
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
    assert {path.name for path in tmp_path.iterdir()} == {"trajectory.csv", "flight.png", "coverage.npy", "summary.json"}
    assert not any(alive(child) for child in children)
    # what was flown is the beginning of the whole flight
    _, whole = fly(load_scenario("escort", overrides=[f"duration={summary['ticks'] * 0.05!r}"]), 7)
    assert whole.trajectory_sha256 == summary["trajectory_sha256"]


@pytest.mark.parametrize("victim", ["uav", "ugv"])
def test_a_vehicle_that_dies_ends_the_run_with_its_name(victim: str, tmp_path: Path) -> None:
    with flying("escort", "--duration", "20000", "--out", str(tmp_path), "--json") as run:
        children = family(run.pid)
        os.kill(child_of(run, victim), signal.SIGKILL)
        out, err = run.communicate(timeout=60)
        assert run.returncode == 1
    assert f"{victim}_0 (pid" in err
    assert "killed by signal 9" in err
    assert json.loads(out)["ticks"] > 0
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


def test_a_child_that_fails_leaves_its_last_words() -> None:
    child = Child("uav_0", ["uav", "--run", "a/b"])
    try:
        assert child.wait(30.0)
        assert "uav_0 (pid" in child.epitaph()
        assert "ended with exit code 2" in child.epitaph()
        assert "run = 'a/b'" in child.epitaph()
    finally:
        child.close()


def test_children_end_and_leave_nothing_when_their_parent_is_killed() -> None:
    with flying("escort", "--duration", "20000", "--no-files") as run:
        children = family(run.pid)
        run.kill()
        run.wait()
        wait_until(lambda: not any(alive(child) for child in children))


def free_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def test_processes_started_one_by_one_fly_the_same_bits() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    simulator = subprocess.Popen(
        [*OUTRIDER, "simulator", "escort", "--listen", endpoint, "--run", "mine", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    vehicles = [
        subprocess.Popen([*OUTRIDER, kind, "--connect", endpoint, "--run", "mine"], stderr=subprocess.DEVNULL)
        for kind in ("ugv", "uav")
    ]
    summary = json.loads(simulator.communicate(timeout=120)[0])
    assert [vehicle.wait(30) for vehicle in vehicles] == [0, 0]
    _, here = fly(load_scenario("escort"), 7)
    assert summary["trajectory_sha256"] == here.trajectory_sha256


def test_a_vehicle_that_never_comes_is_named() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    run = outrider("simulator", "escort", "--listen", endpoint, "--join-timeout", "1")
    assert run.returncode == 1
    assert "uav_0 and ugv_0 did not join within 1 s" in run.stderr
    assert "Traceback" not in run.stderr
