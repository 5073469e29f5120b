"""The command line: help with examples, one clear line for bad input, one JSON object on request."""

import json
import os
import re
import sys
from importlib.metadata import PackageNotFoundError
from typing import Any

import pytest

from bus import plugins
from bus.credentials import read_credential
from bus.errors import ScenarioError
from bus.keys import Role
from bus.locator import Locator
from bus.plugins import registered
from outrider.cli.joining import credential_of
from outrider.cli.main import COMMANDS
from processes import outrider, python
from tabular import rows, words

GROUPS = {"scenarios", "network", "fmu"}
EXTENSIONS = {
    name.replace(".", " "): entry.module.partition(".")[0]
    for name, entry in registered("commands").items()
}
NAMES = sorted({*COMMANDS, *EXTENSIONS} - GROUPS)
LIBRARIES = {
    "sweep": "pyarrow",
    "replay": "mcap",
    "report": "pyarrow",
    "falsify": "cma",
}
LIBRARIES |= {"drive": "textual", "record": "foxglove", "render": "mcap"}
LIBRARIES |= {
    "scenarios import": "shapely",
    "mavlink": "pymavlink",
    "ros2": "rosbags",
    "dashboard": "nicegui",
}
LIBRARIES |= {"quadrotor": "mujoco"}


def needs(arguments: str) -> None:
    """Skip a test whose extension or library is not installed."""
    name, *others = arguments.split() or [""]
    name = next((one for one in EXTENSIONS if f"{arguments} ".startswith(f"{one} ")), name)
    wanted = {EXTENSIONS.get(name, "outrider"), LIBRARIES.get(name, "outrider")}
    wanted |= {LIBRARIES["dashboard"], "outrider_dashboard"} if "dashboard" in others else set()
    for one in wanted:
        pytest.importorskip(one, reason="not installed here")


@pytest.mark.parametrize("name", ["", *NAMES, *sorted(GROUPS)])
def test_every_help_has_an_example_and_fits_80_columns(name, command, monkeypatch) -> None:
    needs(name)
    monkeypatch.setenv("COLUMNS", "80")
    help_text = command(*name.split(), "--help").stdout
    assert max(map(len, help_text.splitlines())) <= 80
    assert "…" not in help_text
    assert name not in NAMES or f"Example: outrider {name}" in " ".join(help_text.split())
    assert not re.search(r"\w\.\.\.$", help_text, re.MULTILINE)
    assert "<bool>" not in help_text


HELP = """
import sys
commands, sys.argv = sys.argv[1:], ["outrider"]
from outrider.cli.main import run_command_line

for words in commands:
    sys.argv = ["outrider", *words.split(), "--help"]
    assert run_command_line() == 0
sys.exit(" ".join(sys.modules))
"""
"""Prints the help of commands, and then the modules that it has loaded."""
SLOW = {"numba", "scipy", "matplotlib"}


@pytest.mark.parametrize(
    ("commands", "forbidden"),
    [
        ([""], {*SLOW, "numpy", "zenoh", "rich.console"}),
        (["run", "replay", "render", "report", "credentials", "drive", "doctor"], SLOW),
        # a subcommand's group in the core reads scenarios
        ([one for one in sorted(EXTENSIONS) if " " not in one], {*SLOW, *LIBRARIES.values()}),
        (["scenarios import"], {"matplotlib", "shapely"}),
    ],
)
def test_help_waits_for_no_compiler_and_no_optional_library(commands, forbidden) -> None:
    for name in commands:
        needs(name)
    done = python(HELP, *commands, check=False)
    assert "Usage: outrider" in done.stdout
    assert not forbidden & set(done.stderr.split())


BAD = rows(r"""
unknown command | fly | No such command
unknown option | run --fast | No such option
not a number | run --seed x | --seed
negative seed | run --seed -1 | --seed
unknown scenario | run escrot | did you mean
unknown law | run --law fancy | law.name = "fancy"
bad override | run --set nonsense | nonsense
weighting not there | run --in-process --law weighted --set custom.weighting=nowhere:f | nowhere
weighting that does not fit | run --law weighted --set custom.weighting=json:dumps | weighting at a distance
path that does not fit | run --law path --set custom.path=math:sin | path at t =
check | check nowhere.toml | nowhere.toml
run name | uav --run a/b | run = 'a/b'
router for strangers | router --listen tcp/0.0.0.0:17447 | there are no credentials
simulator for strangers | simulator --listen tcp/[::]:17447 | there are no credentials
no endpoint | router --listen 17447 | endpoint '17447'
no endpoint to go to | uav --connect nowhere | endpoint 'nowhere'
no port | uav --connect tcp/127.0.0.1 | has no port
IPv6 without brackets | record f.mcap --connect tcp/::1:17447 | an IPv6 address without brackets
port out of range | record f.mcap --connect tls/base:70000 | port 70000
port that is none | router --listen tcp/127.0.0.1:80x | not a host and a port
unknown host | uav --connect tcp/nowhere.invalid:17447 | host 'nowhere.invalid'
socket's name | simulator --listen unixsock-stream//tmp/a#b | ends a path at '#'
unknown protocol | uav --connect carrier-pigeon/roof | carrier-pigeon
credentials not there | uav --credentials nowhere.json | nowhere.json
owner | credentials --owner me | --owner 'me'
clock without processes | run --in-process --realtime 1 | --realtime
clock that runs back | run --realtime -1 | --realtime
page without processes | run --in-process --with dashboard | in-process
page and numbers | replay nowhere.mcap --with dashboard --json | --with cannot be combined
unknown companion | run --with dashbord | --with dashbord
scenario to show | scenarios show circel | circle
falsify, no runs | falsify --runs 0 | --runs
falsify, no time | falsify --minutes 0 | --minutes
falsify, negative limit | falsify --limit delay=-1 | --limit delay=-1: out of range; allowed: 0 to 30
falsify, all is lost | falsify --limit loss=1.5 | allowed: 0 to 0.99
falsify, undegraded with noise | falsify --limit none --limit noise=0.1 | --limit none
falsify, unknown limit | falsify --limit los=0.1 | allowed: delay, loss
falsify, limit without a number | falsify --limit loss | loss=NUMBER
falsify, nothing to promise | falsify --law certified --limit blackout=60 | nothing can be certified within
falsify, several pairs | falsify pairs.toml | 2 UAVs and 2 UGVs
falsify, altitude without the attack | falsify --law certified --altitude | --altitude
falsify, control of another law | falsify --control tracking --law linear | --control
falsify, engine of another law | falsify --law linear --engine attack | --engine
falsify, error not in the grid | falsify --law certified --error 0.4 | allowed: 0, 0.3
falsify, a folder | falsify --out . | is a folder
sweep, no seeds | sweep escort --seeds 0 | --seeds
report of no sweep | report . | not a folder of a sweep
suite, unknown law | suite --law lograithmic | law 'lograithmic': unknown
suite, unknown task | suite --only nosie | unknown task, did you mean 'noise'?; allowed: paper,
suite, policy not there | suite --uav-policy nowhere:f | --uav-policy = 'nowhere:f'
suite, no secret | suite --law linear --secret 1234 | --secret: 4 characters: not a secret; allowed:
suite, estimate for a law | suite --estimate | --estimate: applies to policies only
suite, two outputs | suite --law linear --markdown --json | both write to stdout
unit of another's agent | fmu export uav escort --agent ugv_0 | no uav of escort; allowed: uav_0
unit of a world's agent | fmu export world escort --agent uav_0 | the world contains all agents
unit's name | fmu export world escort --out world.zip | world.zip: not a unit's name; allowed: FILE.fmu
unit's folder | fmu export world escort --out no/world.fmu | no/world.fmu: No such file or directory
unit of no scenario | fmu export ugv escrot | escrot: no such file or scenario
ground stations of strangers | mavlink --in udpin:0.0.0.0:14550 | or --insecure
unknown ground station | mavlink --to udpout:nowhere.invalid:14550 | nowhere.invalid:14550: Name
domain | ros2 --domain 233 | --domain 233: out of range; allowed: 0 to 232
namespace | ros2 --namespace pilot | 'pilot'
namespace of a vehicle | ros2 --vehicle uav_0 --namespace fleet | --namespace cannot be combined with --vehicle
no vehicle | ros2 --vehicle drone | begins with uav or ugv
""")
BROKEN = rows(r"""
no router | uav --connect tcp/127.0.0.1:1 --join-timeout 0.2 | tcp/127.0.0.1:1 within 0.2 s: Connection refused
no socket | uav --connect unixsock-stream/none --join-timeout 0 | /none within 0 s: No such file
no address of this machine | router --listen tcp/192.0.2.1:17447 --insecure | tcp/192.0.2.1:17447: Can
no address of this machine, MAVLink | mavlink --in udpin:192.0.2.1:14550 --insecure | 192.0.2.1:14550: Cannot assign
a file in the folder's place | run --out taken | taken
a file in the sweep's place | sweep escort --set duration=5 --out taken | taken
a file in the place of falsify's folder | falsify --out taken/found.toml | taken: File exists
policy that raises | suite --uav-policy json:loads --only paper | --uav-policy json:loads: TypeError
policy that gives no action | suite --uav-policy math:fsum --only paper | --uav-policy math:fsum:
""")
"""Causes other than invalid input."""
TWO_PAIRS = """
uav = [{position = [7, 8]}, {position = [7, 28], escorts = "ugv_1"}]
ugv = [{position = [7, 7]}, {position = [7, 27]}]
"""


@pytest.mark.parametrize(
    ("arguments", "phrase", "code"),
    [
        pytest.param(*row, code, id=case)
        for code, of in ((2, BAD), (1, BROKEN))
        for case, *row in of
    ],
)
@pytest.mark.usefixtures("impatient")
def test_impossible_command_gives_one_line_exit_code_and_no_file(
    arguments, phrase, code, here, command
):
    needs(arguments)
    (here / "taken").write_text("a file", encoding="utf-8")
    (here / "pairs.toml").write_text(TWO_PAIRS, encoding="utf-8")
    run = command(*words(arguments))
    assert run.returncode == code, run.stderr
    assert phrase in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
    assert run.stdout == ""
    assert sorted(path.name for path in here.iterdir()) == ["pairs.toml", "taken"]


@pytest.mark.parametrize(
    ("arguments", "module", "extra"),
    rows("""
run --with dashboard | nicegui | dashboard
dashboard | nicegui | dashboard
falsify | cma | falsify
sweep | pyarrow | sweep
sweep --dask tcp://127.0.0.1:1 | distributed | dask
mavlink | pymavlink.dialects.v20 | mavlink
ros2 | rosbags.typesys | ros2
record f.mcap | foxglove | record
replay f.mcap | mcap | record
"""),
)
def test_a_missing_extra_is_one_line_that_says_what_to_install(
    arguments, module, extra, monkeypatch, command
):
    needs(arguments)

    package = module.partition(".")[0]
    known = plugins.version_of

    def version(name: str) -> str:
        if name == package:
            raise PackageNotFoundError(name)
        return known(name)

    monkeypatch.setattr(plugins, "version_of", version)
    monkeypatch.setitem(sys.modules, module, None)
    importers = ("outrider_mavlink.", "outrider_ros2.", "outrider.cli.work.", "outrider.recording.")
    for ours in [name for name in sys.modules if name.startswith(importers)]:
        monkeypatch.delitem(sys.modules, ours)  # other tests may have loaded it
    run = command(*words(arguments))
    assert run.returncode == 2
    (line,) = run.stderr.splitlines()
    assert package in line
    assert f"-e '.[{extra}]'" in line


@pytest.mark.parametrize(
    ("variable", "phrase", "code"),
    [
        ("NUMBA_DISABLE_JIT=1", "Outrider needs compiled code; allowed: 0", 2),
        ("NUMBA_NUM_THREADS=0", "Number of threads specified must be > 0", 1),
    ],
)
def test_an_unusable_switch_of_numba_is_one_line(variable: str, phrase: str, code: int) -> None:
    name, _, value = variable.partition("=")
    run = outrider("check", "escort", env=os.environ | {name: value})
    (line,) = run.stderr.splitlines()
    assert (run.returncode, run.stdout) == (code, "")
    assert name in line
    assert phrase in line


def test_ctrl_c_during_the_imports_is_one_line(tmp_path) -> None:
    text = "import os, signal; os.kill(os.getpid(), signal.SIGINT)"
    (tmp_path / "typer.py").write_text(text, encoding="utf-8")
    path = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", "")))
    run = outrider("check", "escort", env=os.environ | {"PYTHONPATH": path})
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "outrider: interrupted\n")


def test_a_file_name_that_is_no_text_is_one_line(here, command) -> None:
    run = command(*words("run --duration 1 --out"), "r\udcff")
    (line,) = run.stderr.splitlines()
    assert (run.returncode, "not UTF-8" in line) == (2, True)


def test_an_ascii_terminal_shows_what_it_can() -> None:
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    run = outrider("scenarios", "schema", env=os.environ | ascii_only)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.isascii()
    assert "m/s?" in run.stdout


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
    files = words("coverage.npy flight.png scenario.toml summary.json trajectory.csv")
    assert sorted(path.name for path in (tmp_path / "mine").iterdir()) == files


def test_lists_are_printed_as_json(command):
    def json_of(arguments: str) -> dict[str, Any]:
        return json.loads(command(*words(arguments), "--json").stdout)

    assert json_of("scenarios")["scenarios"][0]["name"] == "escort"
    checked = json_of("check escort")
    verdict = checked.pop("verdicts")["uav_0"]
    assert (verdict["certifiable"], verdict["changes"]) == ("always", [])
    assert verdict["r_cert"] < verdict["radius"] < 4.75
    search = checked.pop("searches")["uav_0"]
    assert 0.0 < search["near"] < search["area"]
    valid = {"scenario": "escort", "valid": True, "certifiable": "always", "warnings": []}
    assert checked == valid


def test_too_fast_circle_warns_and_flies(command) -> None:
    run = command(*words("run circle-too-fast --in-process --no-files --duration 5"))
    assert run.returncode == 0
    assert "0.108597 rad/s" in " ".join(run.stderr.split())


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
    assert "credentials of ugv_0 (ugv); allowed: uav_0 (uav)" in borrowed.stderr
    another = command("router", "--credentials", files["router"], "--run", "day")
    assert another.returncode == 2
    assert "allowed: night" in another.stderr


def test_a_password_may_come_from_the_environment(here, command, monkeypatch):
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
    assert {Locator.of(endpoint).is_local for endpoint in words(endpoints)} == {local}
