"""The secret of a run: its creation, its readers, and the same bits for the same secret."""

import json
import re
import signal
import stat
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("mcap", reason="the extra [record] is not installed")

from bus.credentials import write_credentials
from bus.errors import ScenarioError
from bus.keys import KEYS
from bus.messages.control import Action, Control
from fields import fields_within
from flights import degraded, record
from outrider.cli.run_secret import secret_of
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.envs.vector import OutriderVectorEnv
from outrider.recording.reader import flight_of
from outrider.recording.refly import refly
from outrider.running.flying import fly, run
from processes import command_line, family, flying
from refusals import refused
from sim.engine.briefing import briefing
from sim.scenario.loading import load_scenario
from staging import GIVEN, Vehicle, stage

SECRET = bytes(range(100, 116)).hex()
SHORT = load_scenario("escort", overrides=["duration=5.0"])
VARIABLE = "OUTRIDER_SECRET"


# readers


def test_no_message_on_the_bus_has_a_field_for_it() -> None:
    for key in KEYS:
        assert fields_within(key.message)
        assert "secret" not in fields_within(key.message)


def test_a_briefing_with_a_secret_differs_in_its_key_alone() -> None:
    for vehicle in SHORT.vehicles:
        plain, kept = (briefing(SHORT, vehicle.name, 7, secret) for secret in ("", SECRET))
        assert plain.key != kept.key
        assert msgspec.structs.replace(plain, key=kept.key) == kept
        assert SECRET.encode() not in msgspec.json.encode(kept)


def check_files(folder: Path, recorded: Path) -> dict[str, Any]:
    """Check that only the owner can read the files of a run with the secret; return its summary."""
    for file in (folder / "summary.json", recorded):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    recording = flight_of(recorded, None)
    found = refly(recording)
    assert recording.head.secret == found.flight.secret == SECRET
    assert found.difference is None
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_bytes())
    assert summary["secret"] == SECRET
    return summary


@pytest.mark.usefixtures("nothing_left_behind")
def test_processes_with_a_secret_keep_it_and_fly_its_bits(tmp_path, monkeypatch):
    """No command line and no environment of a started process contains the secret.

    The run has hazards and loses map updates: in processes, too, it has one trajectory.
    """
    monkeypatch.setenv(VARIABLE, SECRET)
    files = tmp_path / "out", tmp_path / "run.mcap"
    options = ("--out", str(files[0]), "--record", str(files[1]), "--no-picture")
    lossy = ("--set", "duration=100000.0", "--set", "links.radio.loss=0.3")
    with flying("minefield", *lossy, *options) as going:
        children = family(going.pid)
        assert not any(
            SECRET.encode() in Path(f"/proc/{pid}/environ").read_bytes() for pid in children
        )
        assert not any(SECRET in command_line(pid) for pid in (going.pid, *children))
        going.send_signal(signal.SIGINT)
        _, err = going.communicate(timeout=60)
    assert SECRET not in err
    summary = check_files(*files)
    changes = [f"duration={summary['ticks'] * 0.05!r}", "links.radio.loss=0.3"]
    alone = load_scenario("minefield", overrides=changes)
    assert summary["trajectory_sha256"] == run(alone, secret=SECRET).trajectory_sha256


# the same secret, the same bits


def test_the_environment_and_many_worlds_fly_the_bits_of_the_run() -> None:
    flight, summary = fly(SHORT, 7, secret=SECRET)
    assert summary.secret == SECRET
    env = parallel_env(SHORT, secret=SECRET)
    seen, _ = env.reset(seed=7)
    worlds = OutriderVectorEnv(SHORT, num_envs=2, secret=SECRET)
    first, _ = worlds.reset(seed=6)
    assert first[1].tobytes() == seen["uav_0"].tobytes()
    record(env, pilots(env), seen)
    assert np.array_equal(env.world.position, flight.world.position)
    assert np.array_equal(env.world.detections, flight.world.detections)


def test_secret_flight_survives_rejoin_and_reset_over_the_bus(tmp_path: Path) -> None:
    scenario = degraded(300)
    with stage(tmp_path, 300, scenario=scenario, secret=SECRET, respawn=True) as going:
        going.start("ugv_0")
        going.start("uav_0", until=100, again=True)

        def reset(send: Any, await_status: Any) -> None:
            await_status(lambda status: status.tick > 110)
            send(Control(action=Action.RESET))

        def slowly() -> None:  # otherwise the run may end before the reset
            if going.server.flight.episode == 0:
                time.sleep(0.02)

        flight = going.fly(slowly, operator=reset)
    assert flight.episode == 1
    alone, plain = (fly(scenario, scenario.seed, secret=secret)[1] for secret in (SECRET, ""))
    assert plain.trajectory_sha256 != flight.recorder.sha256() == alone.trajectory_sha256


def test_run_with_a_secret_in_one_process_leaves_private_files(tmp_path, command):
    (tmp_path / "secret").write_text(SECRET.upper() + "\n", encoding="ascii")
    files = tmp_path / "out", tmp_path / "run.mcap"
    options = ("escort", "--duration", "5", "--in-process", "--secret", f"@{tmp_path}/secret")
    done = command("run", *options, "--out", files[0], "--record", files[1], "--no-picture")
    assert done.returncode == 0, done.stderr
    assert SECRET not in done.stderr
    flown = check_files(*files)["trajectory_sha256"]
    assert run(SHORT).trajectory_sha256 != flown == run(SHORT, secret=SECRET).trajectory_sha256


# creation


@pytest.mark.parametrize("is_private", [True, False])
def test_only_a_simulator_with_credentials_makes_a_secret(
    is_private, endpoint, tmp_path, monkeypatch, command
):
    monkeypatch.delenv(VARIABLE, raising=False)
    options = ["escort", "--run", "run", "--duration", "5", "--json", "--listen", endpoint]
    vehicles = [Vehicle(endpoint, name, is_open=not is_private) for name in ("ugv_0", "uav_0")]
    if is_private:
        files = write_credentials(GIVEN, tmp_path / "credentials")
        options += ["--credentials", str(files["router"])]
    done = command("simulator", *options, "--join-timeout", "30")
    for vehicle in vehicles:
        vehicle.join()
    summary = json.loads(done.stdout)
    secret = summary["secret"]
    assert re.fullmatch("[0-9a-f]{32}" if is_private else "", secret)
    assert not secret or secret not in done.stderr
    assert summary["trajectory_sha256"] == run(SHORT, secret=secret).trajectory_sha256


def test_where_one_is_wanted_it_is_new_unless_it_is_given() -> None:
    made = {secret_of("", wanted=True), secret_of("new"), secret_of("new", wanted=True)}
    assert len(made) == 3
    assert all(re.fullmatch("[0-9a-f]{32}", secret) for secret in made)
    assert secret_of("") == ""
    assert secret_of(SECRET, wanted=True) == secret_of(SECRET.upper()) == SECRET


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b"", "is empty; allowed: 32 to 128"),
        (b"\xff" * 40, "not a text file"),
        (b"0" * 31, "31 characters: not a secret; allowed: "),
        (b"0" * 10**6, "1000 characters: not a secret"),
        (b"my very own passphrase, and it is long", "38 characters: not a secret"),
    ],
    ids=["missing", "empty", "no text", "short", "long", "words"],
)
def test_a_file_that_holds_none_is_refused_in_one_line(content, message, tmp_path):
    path = tmp_path / "kept"
    if content is not None:
        path.write_bytes(content)
    with refused(ScenarioError, message) as refusal:
        secret_of(f"@{path}")
    assert str(path) in str(refusal.value)
