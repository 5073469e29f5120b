"""Runs under the faults of real deployments: processes that are killed, frozen, disconnected, and return."""

import errno
import json
import os
import signal
import socket
import subprocess
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest

from agents import process
from agents.uav import UavPilot
from bus.errors import PeerLost
from bus.keys import BRIEFING, Role
from bus.messages.decision import NotCertified
from bus.messages.telemetry import Status
from outrider import style
from outrider.cli import scenarios
from outrider.running import launch
from outrider.running.flying import InProcess, fly, make_pilots
from processes import (
    SHORT,
    SILENT,
    alive,
    await_status,
    child_of,
    flying,
    launched,
    observing,
    wait_until,
)
from refusals import refused
from scattered import SECONDS, SECRET, scattered
from sim.engine.briefing import uav_briefing
from sim.scenario.loading import load_scenario
from sim.scenario.types import Run
from sim.server.flight import Flight
from staging import GIVEN, client_of, hosted
from tabular import words
from test_assurance import report_of

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


def test_failing_vehicle_is_restarted_but_not_forever(monkeypatch) -> None:
    """Processes that are killed before they have loaded Python, and a UAV that fails again and again in flight."""
    started: list[launch.Child] = []
    fails: set[str] = set()

    class Doomed(launch.Child):
        def __init__(self, name: str, *arguments: Any, **named: Any) -> None:
            super().__init__(name, *arguments, **named)
            started.append(self)
            if len(started) in (2, 3) or name in fails:
                self.kill()

    def on_tick(tick: int) -> None:
        if tick > 0 and not fails:
            fails.add("uav_0")
            next(child for child in reversed(started) if child.name == "uav_0").kill()

    monkeypatch.setattr(launch, "Child", Doomed)
    long = msgspec.structs.replace(SHORT, duration=1000.0, run=Run(respawn=True))
    outcome = launched(msgspec.structs.replace(SILENT, on_tick=on_tick), scenario=long)
    names = [child.name for child in started]
    assert names[:5] == words("simulator uav_0 ugv_0 uav_0 ugv_0")
    assert set(names[5:]) == {"uav_0"}
    assert outcome.fault.startswith("uav_0 (pid")
    assert "so it is not restarted" in outcome.fault
    assert outcome.summary is not None
    assert not outcome.summary.complete  # the run ends at once and does not wait
    flown = msgspec.structs.replace(SHORT, duration=outcome.summary.ticks * SHORT.dt)
    assert outcome.summary.trajectory_sha256 == fly(flown, SHORT.seed)[1].trajectory_sha256


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
        simulator = run.simulator("--join-timeout", "3")
        vehicles = run.vehicles("--join-timeout", "3")  # all start at about the same time
        run.fly_to(100)
        router.kill()
        router.wait()
        out, err = simulator.communicate(timeout=60)
        assert simulator.returncode == 1
        assert "the router has been disconnected for 3 s" in err
        assert "Traceback" not in err
        assert json.loads(out)["ticks"] > 100  # the flown part is kept
        for vehicle in vehicles:
            _, err = vehicle.communicate(timeout=60)
            assert vehicle.returncode == 1
            (line,) = err.strip().splitlines()
            assert "the router has been absent for 3 s" in line


def test_a_vehicle_missing_at_the_end_fails_the_simulator(tmp_path: Path) -> None:
    with scattered(tmp_path) as run:
        run.router()
        simulator = run.simulator(
            "--set", "run.realtime=20", "--driver", "wander", "--network", "wifi"
        )
        run.await_simulator()
        uav, _ = run.vehicles()
        run.fly_to(200)
        uav.kill()
        out, err = simulator.communicate(timeout=120)
    assert "uav_0: missing at the end of the run" in err
    assert json.loads(out)["complete"] is True
    assert simulator.returncode == 1


def test_lost_simulator_ends_a_vehicle_with_a_reason(endpoint: str) -> None:
    vehicle = GIVEN.of("uav_0")
    settings = {"connect": endpoint, "run": "run", "credential": vehicle, "join_timeout": 1.0}
    with hosted(endpoint, name="observer"), ThreadPoolExecutor(1) as threads:
        with client_of(endpoint, GIVEN.of("simulator")) as simulator:
            briefings = simulator.outbox(BRIEFING[Role.UAV], "uav_0")
            simulator.announce()
            flown = threads.submit(process.fly, vehicle.party, UavPilot, **settings)
            wait_until(lambda: briefings.wanted)
            briefings.send(uav_briefing(SHORT, "uav_0", 7))
        with refused(PeerLost, "the simulator has been absent for 1 s"):
            flown.result(60.0)


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


class Rejoining(InProcess):
    """Pilots without a bus, whose processes all rejoin in one tick, after their answers to it or before.

    The UAV claims to be uncertified at the ticks of `false`.
    """

    def __init__(
        self, flight: Flight, at: int, *, answered: bool, false: Collection[int] = ()
    ) -> None:
        self._flight, self._at, self._answered, self._false = flight, at, answered, false
        super().__init__(make_pilots(flight.scenario, flight.seed))

    def collect(self, tick: int) -> dict[str, Any]:
        if tick == self._at and not self._answered:
            self._rejoin()
        if tick == self._at + self._answered:
            self._brief(tick)
        commands = super().collect(tick)
        if tick == self._at and self._answered:
            self._rejoin()
        if tick in self._false:
            claim = report_of(False)
            commands["uav_0"] = msgspec.structs.replace(commands["uav_0"], report=claim)
        return commands

    def _rejoin(self) -> None:
        for name in self._pilots:
            self._flight.rejoin(name)

    def _brief(self, tick: int) -> None:
        self._pilots = made = make_pilots(self._flight.scenario, self._flight.seed)
        for name, pilot in made.items():
            for observation in self._flight.past(name, 0, tick, ()):
                pilot.act(observation)
            pilot.forget_commands()


@pytest.mark.parametrize("answered", [True, False])
def test_first_reports_after_a_rejoin_break_no_certificate(answered: bool) -> None:
    def flown(**changes: Any) -> Flight:
        flight = Flight(scenario, 1)
        flight.fly(Rejoining(flight, 40, answered=answered, **changes))
        return flight

    scenario = load_scenario(
        "minefield", overrides={"law.name": "certified", "duration": 4.0, "area.cell": 0.5}
    )
    flight = flown()
    counted, mission = flight.answers.assurance, flight.world.mission
    assert counted.reasons[NotCertified.UNCHECKED_PLAN] == 1
    assert counted.certificate_broken == mission.ground_certificate_broken == 0
    assert mission.guarantees["ugv_0"].certified > 60
    assert flown(false=(39, 44)).answers.assurance.certificate_broken == 2
