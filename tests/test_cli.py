"""The command line: help with examples, one clear line for bad input, one JSON object where it is asked for."""

import json
from pathlib import Path

import pytest
from processes import outrider
from tabular import rows, words

from bus import session
from outrider.cli.main import COMMANDS


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(name, command):
    told = command(name, "--help")
    assert told.returncode == 0
    assert f"Example: outrider {name}" in " ".join(told.stdout.split())


BAD = {
    case: (arguments.split(), told)
    for case, arguments, told in rows(r"""
unknown command | fly | No such command
unknown option | run --fast | No such option
not a number | run --seed x | --seed
negative seed | run --seed -1 | --seed
unknown scenario | run escrot | did you mean
missing file | run nowhere.toml | nowhere.toml
unknown law | run --law fancy | law.name = "fancy"
unknown driver | run --driver ghost | driver = "ghost"
unknown field | run --set law.nmae=1 | law.nmae
bad override | run --set nonsense | nonsense
impossible | run --set visibility.radius=5.5 | visibility.radius = 5.5
negative time | run --duration -1 | duration = -1
no whole tick | run --duration 0.07 | duration = 0.07
weighting missing | run --law weighted | custom.weighting
weighting not there | run --in-process --law weighted --weighting nowhere:f | nowhere
weighting quoted | run --law weighted --weighting a"b:c | custom.weighting
weighting that does not fit | run --law weighted --weighting json:dumps | weighting at a distance
path that does not fit | run --law path --path math:sin | path at t =
check | check nowhere.toml | nowhere.toml
bench row | bench --only nothing | no such row
run name | uav --run a/b | run = 'a/b'
router for strangers | router --listen tcp/0.0.0.0:17447 | there are no credentials
simulator for strangers | simulator --listen tcp/[::]:17447 | there are no credentials
no endpoint | router --listen 17447 | endpoint '17447'
no endpoint to go to | uav --connect nowhere | endpoint 'nowhere'
unknown protocol | uav --connect carrier-pigeon/roof | carrier-pigeon
credentials not there | uav --credentials nowhere.json | nowhere.json
owner | credentials --owner me | --owner 'me'
clock without processes | run --in-process --realtime 1 | --realtime
clock that stands | run --realtime 0 | --realtime
""")
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_line_exit_code_2_and_no_traceback(case, here, command):
    arguments, told = BAD[case]
    run = command(*arguments)
    assert run.returncode == 2, run.stderr
    assert told in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
    assert run.stdout == ""
    assert not list(here.iterdir())


def test_bad_input_ends_the_process_with_the_same_line_and_code(tmp_path: Path) -> None:
    run = outrider("run", "escrot", cwd=tmp_path, fresh=True)
    assert run.returncode == 2
    assert "did you mean" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
    assert run.stdout == ""
    assert not list(tmp_path.iterdir())


def test_no_router_is_one_line_and_exit_code_1(monkeypatch, command):
    monkeypatch.setitem(session._CLIENT, "connect/timeout_ms", 300)
    run = command("uav", "--connect", "tcp/127.0.0.1:1")
    assert run.returncode == 1
    assert "no router at tcp/127.0.0.1:1" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1


def test_a_folder_that_cannot_be_written_shows_before_the_flight(tmp_path, command):
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    run = command("run", "--out", str(tmp_path / "taken"))
    assert run.returncode == 1
    assert "taken" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1


def test_a_run_leaves_its_files_and_prints_one_json_object(tmp_path, command):
    run = command(*words("run --in-process --duration 2 --json --out"), str(tmp_path / "mine"))
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    wanted = """
        scenario seed law dt ticks ticks_per_second max_distance mean_distance trajectory_sha256
        visibility_violations switching_radius crossings initial_error mean_error final_error
        estimate_rmse detection_rmse processes"""
    assert set(words(wanted)) <= set(summary)
    assert summary["processes"] == []
    assert json.loads((tmp_path / "mine" / "summary.json").read_text(encoding="utf-8")) == summary
    files = words("coverage.npy flight.png summary.json trajectory.csv")
    assert sorted(path.name for path in (tmp_path / "mine").iterdir()) == files


def test_json_of_the_lists(command):
    def told(arguments: str) -> dict[str, object]:
        return json.loads(command(*words(arguments), "--json").stdout)

    assert told("scenarios")["scenarios"][0]["name"] == "escort"
    checked = told("check escort")
    exceeded = checked.pop("exceeded_chance")
    assert sorted(exceeded) == ["uav_0/age", "uav_0/error"]
    assert 0.0 < checked.pop("lost_chance") == sum(exceeded.values()) < 1e-12
    valid = {"scenario": "escort", "valid": True, "certifiable": "always", "warnings": []}
    assert checked == valid
    rows = told("bench --only kernel_vs_numpy --repeats 1")["rows"]
    assert set(rows[0]) == {"name", "value", "unit", "reference", "reference_value", "ratio"}
    assert rows[0]["value"] > 0.0


def test_a_circle_that_cannot_be_flown_warns_and_flies(command) -> None:
    run = command(*words("run circle-too-fast --in-process --no-files --duration 5"))
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
        rest = words("--duration 20 --no-files --json")
        run = outrider("run", "escort", *arguments, *rest, cwd=tmp_path)
        assert run.returncode == 0, run.stderr
        hashes.add(json.loads(run.stdout)["trajectory_sha256"])
    assert len(hashes) == 1


def test_the_version_is_told() -> None:
    assert outrider("--version", fresh=True).stdout.startswith("outrider ")


def test_a_path_that_cannot_be_followed_warns_with_the_bound(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import math\n\ndef path(t):\n    x, y = 2 * math.cos(t), 2 * math.sin(t)\n    return (x, y), (-x, -y)\n",
        encoding="utf-8",
    )
    rest = words("--law path --path mine:path --in-process --duration 2 --no-files")
    run = outrider("run", *rest, cwd=tmp_path)
    assert run.returncode == 0
    told = " ".join(run.stderr.split())
    assert "cannot be flown: 2 m/s" in told
    assert "v_a - v_g = 0.4 m/s" in told
    assert "u_a = 0.3 m/s²" in told


def test_credentials_are_made_once_and_each_party_gets_its_own(here, command) -> None:
    made = command("credentials", "mine", "--run", "night", "--json")
    assert made.returncode == 0, made.stderr
    files = json.loads(made.stdout)["files"]
    assert set(files) == {"router", "simulator", "uav_0", "ugv_0", "operator", "observer"}
    again = command("credentials", "mine")
    assert again.returncode == 1
    assert "never overwritten" in again.stderr
    borrowed = command("uav", "--credentials", files["ugv_0"])
    assert borrowed.returncode == 2
    assert "the credentials of ugv_0 (ugv), not of uav_0 (uav)" in borrowed.stderr
    another = command("router", "--credentials", files["router"], "--run", "day")
    assert another.returncode == 2
    assert "for the run night" in another.stderr


def test_a_password_may_come_from_the_environment(here, command, monkeypatch):
    from bus.access import read_credential
    from bus.errors import ScenarioError
    from bus.keys import Role
    from outrider.cli.options import credential_of

    made = command("credentials", "mine", "--json")
    known = read_credential(here / json.loads(made.stdout)["files"]["uav_0"])
    assert credential_of(None, Role.UAV, "uav_0") is None
    monkeypatch.setenv("OUTRIDER_PASSWORD", known.password)
    assert credential_of(None, Role.UAV, "uav_0") == known
    monkeypatch.setenv("OUTRIDER_PASSWORD", "a b")
    with pytest.raises(ScenarioError, match="OUTRIDER_PASSWORD"):
        credential_of(None, Role.UAV, "uav_0")


@pytest.mark.parametrize(
    ("local", "endpoints"),
    [
        (True, "tcp/127.0.0.1:1 tcp/localhost:1 tcp/[::1]:1 unixsock-stream//tmp/x"),
        (False, "tcp/0.0.0.0:1 tcp/[::]:1 tls/10.0.0.1:1 udp/host:1"),
    ],
)
def test_only_this_machines_endpoints_need_no_credentials(local: bool, endpoints: str) -> None:
    from outrider.cli.options import is_local

    assert {is_local(endpoint) for endpoint in words(endpoints)} == {local}


def test_many_pairs_can_be_flown(tmp_path: Path) -> None:
    from outrider.bench.pairs import pairs_toml
    from sim.scenario.loading import load_scenario

    for count in (1, 5, 50):
        (tmp_path / "pairs.toml").write_text(pairs_toml(count, seconds=10), encoding="utf-8")
        scenario = load_scenario(tmp_path / "pairs.toml")
        assert len(scenario.uav) == len(scenario.ugv) == count
    with pytest.raises(ValueError, match="count = 0"):
        pairs_toml(0, seconds=10)
