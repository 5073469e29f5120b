"""`outrider run --listen`: others join the run with its credentials only; `--driver teleop` says how to drive."""

import json
import re
import shlex
import socket
import subprocess
from pathlib import Path

import pytest

from bus import keys
from bus.credentials import read_credential
from bus.errors import AccessDenied
from bus.joining import open_session
from bus.locator import reachable
from bus.messages.telemetry import Status
from processes import started, wait_until
from tabular import words

pytestmark = pytest.mark.usefixtures("nothing_left_behind")


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def line_with(process: "subprocess.Popen[str]", phrase: str) -> str:
    assert process.stderr is not None
    seen = []
    for line in process.stderr:
        seen.append(line)
        if phrase in line:
            return line
    raise AssertionError(f"no {phrase!r} in: {seen}")


def option(line: str, name: str) -> str:
    parts = shlex.split(line.replace(",", " "))
    return parts[parts.index(name) + 1]


def joins(line: str, endpoint: str) -> float:
    """Join with the options of a line; return the target factor that the run reports."""
    credential = read_credential(Path(option(line, "--credentials")))
    with open_session(
        credential.party,
        option(line, "--run"),
        connect=endpoint,
        credential=credential,
        join_timeout=20.0,
    ) as session:
        inbox = session.inbox(keys.STATUS, newest=1)
        received = inbox.receive(120.0)  # the simulator may compile
        assert received is not None
        assert isinstance(received.message, Status)
        return received.message.target_factor or 0.0


def test_operator_joins_with_the_printed_options_only(endpoint: str) -> None:
    arguments = words(f"run --listen {endpoint} --driver teleop --no-files --duration 600")
    with started(*arguments) as run:
        line = line_with(run, "listening on")
        assert option(line, "--connect") == endpoint
        drive = line_with(run, "outrider drive")
        assert option(drive, "--name") == "ugv_0"
        assert option(drive, "--run") == option(line, "--run")
        assert joins(line, endpoint) == 1.0  # an operator drives: real time
        observer = re.search(r"observers with (\S+)", line)
        assert observer is not None
        assert read_credential(Path(observer.group(1))).role == "observer"
        party = keys.Party(role=keys.Role.OPERATOR, name=keys.OPERATOR_NAME)
        with (
            pytest.raises(AccessDenied),
            open_session(party, option(line, "--run"), connect=endpoint, join_timeout=3.0),
        ):
            pass
        file = Path(option(line, "--credentials"))
        run.terminate()
        run.wait(60.0)
    wait_until(lambda: not file.exists())


def test_lockstep_wins_over_the_pace_of_an_operator(command) -> None:
    done = command(*words("run --driver teleop --realtime 0 --duration 5 --no-files --json"))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["realtime"] is None
    assert "outrider drive" in done.stderr


def test_given_credentials_are_those_of_the_run(endpoint: str, tmp_path: Path, command) -> None:
    assert command("credentials", str(tmp_path), "--run", "mine").returncode == 0
    arguments = words(f"run --listen {endpoint} --realtime 1 --no-files --duration 600")
    with started(*arguments, "--credentials", str(tmp_path / "router.json")) as run:
        line = line_with(run, "listening on")
        assert option(line, "--run") == "mine"
        assert Path(option(line, "--credentials")) == tmp_path / "operator.json"
        assert joins(line, endpoint) == 1.0
        run.terminate()
        run.wait(60.0)
    assert (tmp_path / "operator.json").exists()


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ("--listen nowhere", "endpoint 'nowhere'"),
        ("--listen tcp/127.0.0.1:17999 --in-process", "several processes required"),
        ("--listen tcp/127.0.0.1:17999 --credentials none.json", "none.json"),
    ],
)
def test_wrong_door_is_refused(arguments: str, phrase: str, command) -> None:
    done = command("run", "--no-files", *words(arguments))
    assert done.returncode == 2
    assert phrase in done.stderr


def test_given_credentials_must_suit_the_scenario(tmp_path: Path, command) -> None:
    assert command("credentials", str(tmp_path)).returncode == 0
    file = str(tmp_path / "router.json")
    listen = words("run scouts --no-files --listen tcp/127.0.0.1:17999 --credentials")
    done = command(*listen, file)
    assert done.returncode == 2
    assert "no credentials for uav_1, uav_2" in done.stderr


def test_busy_port_ends_the_run_with_a_reason(command) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        there = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        done = command("run", "--no-files", "--listen", there)
    assert done.returncode != 0
    assert there in done.stderr


def test_wildcard_address_becomes_the_name_of_this_host() -> None:
    assert reachable("tcp/0.0.0.0:17447") == f"tcp/{socket.gethostname()}:17447"
    assert reachable("tcp/127.0.0.1:17447") == "tcp/127.0.0.1:17447"
