"""The command line: help with examples, one clear line for bad input, one JSON object where it is asked for."""

import json
import sys
from pathlib import Path

import pytest
from processes import outrider

from bus import session
from outrider.cli import main
from outrider.cli.main import COMMANDS


def here(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """The same in this process, which need not start: the exit code."""
    monkeypatch.setattr(sys, "argv", ["outrider", *arguments])
    return main._run()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(name, monkeypatch, capsys):
    assert here(monkeypatch, name, "--help") == 0
    assert f"Example: outrider {name}" in " ".join(capsys.readouterr().out.split())


BAD = {
    "unknown command": (["fly"], "No such command"),
    "unknown option": (["run", "--fast"], "No such option"),
    "not a number": (["run", "--seed", "x"], "--seed"),
    "negative seed": (["run", "--seed", "-1"], "--seed"),
    "unknown scenario": (["run", "escrot"], "did you mean"),
    "missing file": (["run", "nowhere.toml"], "nowhere.toml"),
    "unknown law": (["run", "--law", "fancy"], 'law.name = "fancy"'),
    "unknown driver": (["run", "--driver", "ghost"], 'driver = "ghost"'),
    "unknown field": (["run", "--set", "law.nmae=1"], "law.nmae"),
    "bad override": (["run", "--set", "nonsense"], "nonsense"),
    "impossible": (["run", "--set", "visibility.radius=5.5"], "visibility.radius = 5.5"),
    "negative time": (["run", "--duration", "-1"], "duration = -1"),
    "no whole tick": (["run", "--duration", "0.07"], "duration = 0.07"),
    "weighting missing": (["run", "--law", "weighted"], "custom.weighting"),
    "weighting not there": (
        ["run", "--in-process", "--law", "weighted", "--weighting", "nowhere:f"],
        "nowhere",
    ),
    "weighting quoted": (["run", "--law", "weighted", "--weighting", 'a"b:c'], "custom.weighting"),
    "weighting that does not fit": (
        ["run", "--law", "weighted", "--weighting", "json:dumps"],
        "weighting at a distance",
    ),
    "path that does not fit": (["run", "--law", "path", "--path", "math:sin"], "path at t ="),
    "check": (["check", "nowhere.toml"], "nowhere.toml"),
    "bench row": (["bench", "--only", "nothing"], "no such row"),
    "run name": (["uav", "--run", "a/b"], "run = 'a/b'"),
    "router for strangers": (
        ["router", "--listen", "tcp/0.0.0.0:17447"],
        "there are no credentials",
    ),
    "simulator for strangers": (
        ["simulator", "--listen", "tcp/[::]:17447"],
        "there are no credentials",
    ),
    "no endpoint": (["router", "--listen", "17447"], "endpoint '17447'"),
    "no endpoint to go to": (["uav", "--connect", "nowhere"], "endpoint 'nowhere'"),
    "unknown protocol": (["uav", "--connect", "carrier-pigeon/roof"], "carrier-pigeon"),
    "credentials not there": (["uav", "--credentials", "nowhere.json"], "nowhere.json"),
    "owner": (["credentials", "--owner", "me"], "--owner 'me'"),
    "clock without processes": (["run", "--in-process", "--realtime", "1"], "--realtime"),
    "clock that stands": (["run", "--realtime", "0"], "--realtime"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_line_exit_code_2_and_no_traceback(case, tmp_path, monkeypatch, capsys):
    arguments, told = BAD[case]
    monkeypatch.chdir(tmp_path)
    code = here(monkeypatch, *arguments)
    out, err = capsys.readouterr()
    assert code == 2, err
    assert told in err
    assert len(err.strip().splitlines()) == 1
    assert out == ""
    assert not list(tmp_path.iterdir())


def test_bad_input_ends_the_process_with_the_same_line_and_code(tmp_path: Path) -> None:
    run = outrider("run", "escrot", cwd=tmp_path)
    assert run.returncode == 2
    assert "did you mean" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
    assert run.stdout == ""
    assert not list(tmp_path.iterdir())


def test_no_router_is_one_line_and_exit_code_1(monkeypatch, capsys):
    monkeypatch.setitem(session._CLIENT, "connect/timeout_ms", 300)
    assert here(monkeypatch, "uav", "--connect", "tcp/127.0.0.1:1") == 1
    line = capsys.readouterr().err
    assert "no router at tcp/127.0.0.1:1" in line
    assert len(line.strip().splitlines()) == 1


def test_a_folder_that_cannot_be_written_shows_before_the_flight(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    run = outrider("run", "--out", str(tmp_path / "taken"))
    assert run.returncode == 1
    assert "taken" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1


def test_a_run_leaves_its_files_and_prints_one_json_object(tmp_path: Path) -> None:
    run = outrider(
        "run", "--in-process", "--duration", "2", "--out", str(tmp_path / "mine"), "--json"
    )
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    wanted = (
        "scenario, seed, law, dt, ticks, ticks_per_second, max_distance, mean_distance, visibility_violations, switching_radius, "
        "crossings, initial_error, mean_error, final_error, estimate_rmse, detection_rmse, trajectory_sha256, processes"
    )
    assert set(wanted.split(", ")) <= set(summary)
    assert summary["processes"] == []
    assert json.loads((tmp_path / "mine" / "summary.json").read_text(encoding="utf-8")) == summary
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {
        "trajectory.csv",
        "flight.png",
        "coverage.npy",
        "summary.json",
    }


def test_json_of_the_lists(tmp_path: Path) -> None:
    scenarios = json.loads(outrider("scenarios", "--json").stdout)["scenarios"]
    assert scenarios[0]["name"] == "escort"
    assert json.loads(outrider("check", "escort", "--json").stdout) == {
        "scenario": "escort",
        "valid": True,
        "certifiable": "always",
        "warnings": [],
    }
    rows = json.loads(
        outrider("bench", "--only", "kernel_vs_numpy", "--repeats", "1", "--json").stdout
    )["rows"]
    assert set(rows[0]) == {"name", "value", "unit", "reference", "reference_value", "ratio"}
    assert rows[0]["value"] > 0.0


def test_a_circle_that_cannot_be_flown_warns_and_flies() -> None:
    run = outrider("run", "circle-too-fast", "--in-process", "--no-files", "--duration", "5")
    assert run.returncode == 0
    assert "0.1086 rad/s" in " ".join(run.stderr.split())


def test_a_weighting_of_ones_own_flies_over_the_bus(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "def careful(distance, r_s):\n    share = min(distance / r_s, 1.0)\n    return share, 1.0 - share\n",
        encoding="utf-8",
    )
    own = ["--law", "weighted", "--weighting", "mine:careful"]
    hashes = set()
    for arguments in (own, [*own, "--in-process"], ["--law", "linear", "--in-process"]):
        run = outrider(
            "run", "escort", *arguments, "--duration", "20", "--no-files", "--json", cwd=tmp_path
        )
        assert run.returncode == 0, run.stderr
        hashes.add(json.loads(run.stdout)["trajectory_sha256"])
    assert len(hashes) == 1


def test_the_version_is_told() -> None:
    assert outrider("--version").stdout.startswith("outrider ")


def test_a_path_that_cannot_be_followed_warns_with_the_bound(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import math\n\ndef path(t):\n    x, y = 2 * math.cos(t), 2 * math.sin(t)\n    return (x, y), (-x, -y)\n",
        encoding="utf-8",
    )
    run = outrider(
        "run",
        "--law",
        "path",
        "--path",
        "mine:path",
        "--in-process",
        "--duration",
        "2",
        "--no-files",
        cwd=tmp_path,
    )
    assert run.returncode == 0
    told = " ".join(run.stderr.split())
    assert "cannot be flown: 2 m/s" in told
    assert "v_a - v_g = 0.4 m/s" in told
    assert "u_a = 0.3 m/s²" in told


def test_credentials_are_made_once_and_each_party_gets_its_own(tmp_path: Path) -> None:
    made = outrider("credentials", "mine", "--run", "night", "--json", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    files = json.loads(made.stdout)["files"]
    assert set(files) == {"router", "simulator", "uav_0", "ugv_0", "operator", "observer"}
    again = outrider("credentials", "mine", cwd=tmp_path)
    assert again.returncode == 1
    assert "never overwritten" in again.stderr
    borrowed = outrider("uav", "--credentials", files["ugv_0"], cwd=tmp_path)
    assert borrowed.returncode == 2
    assert "the credentials of ugv_0 (ugv), not of uav_0 (uav)" in borrowed.stderr
    another = outrider("router", "--credentials", files["router"], "--run", "day", cwd=tmp_path)
    assert another.returncode == 2
    assert "for the run night" in another.stderr


def test_a_password_may_come_from_the_environment(tmp_path, monkeypatch):
    from bus.access import read_credential
    from bus.errors import ScenarioError
    from bus.keys import Role
    from outrider.cli.options import credential_of

    made = outrider("credentials", "mine", "--json", cwd=tmp_path)
    known = read_credential(tmp_path / json.loads(made.stdout)["files"]["uav_0"])
    assert credential_of(None, Role.UAV, "uav_0") is None
    monkeypatch.setenv("OUTRIDER_PASSWORD", known.password)
    assert credential_of(None, Role.UAV, "uav_0") == known
    monkeypatch.setenv("OUTRIDER_PASSWORD", "a b")
    with pytest.raises(ScenarioError, match="OUTRIDER_PASSWORD"):
        credential_of(None, Role.UAV, "uav_0")


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:1", True),
        ("tcp/localhost:1", True),
        ("tcp/[::1]:1", True),
        ("unixsock-stream//tmp/x", True),
        ("tcp/0.0.0.0:1", False),
        ("tcp/[::]:1", False),
        ("tls/10.0.0.1:1", False),
        ("udp/host:1", False),
    ],
)
def test_only_this_machines_endpoints_need_no_credentials(endpoint: str, local: bool) -> None:
    from outrider.cli.options import is_local

    assert is_local(endpoint) is local


def test_many_pairs_can_be_flown(tmp_path: Path) -> None:
    from outrider.bench.pairs import pairs_toml
    from sim.scenario.loading import load_scenario

    for count in (1, 5, 50):
        (tmp_path / "pairs.toml").write_text(pairs_toml(count, seconds=10), encoding="utf-8")
        scenario = load_scenario(tmp_path / "pairs.toml")
        assert len(scenario.uav) == len(scenario.ugv) == count
    with pytest.raises(ValueError, match="count = 0"):
        pairs_toml(0, seconds=10)
