"""The first steps of a user: name collisions, brackets in paths and errors, a first file, the doctor."""

import errno
import importlib
import json
import sys
import tomllib
from contextlib import ExitStack, suppress
from pathlib import Path
from pkgutil import resolve_name
from unittest.mock import create_autospec

import msgspec
import numpy as np
import pytest

import outrider

pytest.importorskip("jsonschema", reason="a development tool")
pytest.importorskip("mcap", reason="the extra [record] is not installed")

import jsonschema

from bus.errors import ScenarioError
from bus.messages.vehicle import UavCommand, UgvCommand
from bus.registry import LAWS
from flights import Piloted
from outrider.cli import doctor
from outrider.recording.reader import flight_of
from outrider.recording.refly import external_uavs, restore
from outrider.recording.writer import FlightRecorder
from outrider.running.flying import fly, make_pilots
from outrider.running.resolve import resolve
from outrider.running.summary import summarize
from outrider.running.user_code import foreign_code
from outrider.view.flight_picture import flight_figure
from outrider.view.output import output_folder
from processes import ran
from sim.env.spaces import action_space
from sim.scenario.checks import scenario_warnings
from sim.scenario.loading import load_scenario, scenario_names, schema_text, shipped_text
from sim.scenario.types import Custom
from sim.server.flight import Flight
from tabular import words

SCRIPT = Path(sys.executable).with_name("outrider")


def test_shadowing_module_is_named_in_one_line(tmp_path):
    """Imported in a script beside it, and on the path of the command."""
    file = tmp_path / "bus.py"
    file.touch()
    (tmp_path / "train.py").write_text("import outrider\n")
    line = ran([sys.executable, "train.py"], cwd=tmp_path).stderr.splitlines()[-1]
    assert line.startswith(f"ImportError: {file} hides")
    run = ran([SCRIPT, "--version"], env={"PYTHONPATH": str(tmp_path)})
    assert run.returncode == 1
    assert run.stderr.startswith(f"outrider: {file} hides")
    assert len(run.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("code", "option", "phrase", "exit_code"),
    [
        ("from bus import speed", "driver=policy policy", "bus.py in this folder is hidden by", 2),
        ("def f(d, r_s): return d.nothing", "law=weighted weighting", "(mine.py:1, in f)", 1),
    ],
)
def test_error_in_user_code_is_explained_in_one_line(
    code, option, phrase, exit_code, here, command
):
    (here / "bus.py").write_text("speed = 0.1\n")
    (here / "mine.py").write_text(f"{code}\n")
    choice, own = option.split()
    name, value = choice.split("=")
    options = (f"--{name}", value, "--set", f"custom.{own}=mine:f")
    done = command("run", "--in-process", "--no-files", *options)
    assert done.returncode == exit_code
    (line,) = done.stderr.splitlines()
    assert phrase in line


def test_failed_run_leaves_no_new_empty_folder(here, command):
    (here / "bad.py").write_text("def wheel(o, b): raise RuntimeError('off')\n")
    (here / "mine").mkdir()
    own = words("run --in-process --driver policy --set custom.policy=bad:wheel")
    for out in ((), ("--out", "mine"), ("--out", "deep/er")):
        assert command(*own, *out).returncode == 2
    there = [name for name in ("mine", "runs", "deep") if (here / name).exists()]
    assert there == ["mine"]


def test_runs_of_the_same_second_get_folders_of_their_own(here, monkeypatch):
    with ExitStack() as stack:
        with (
            monkeypatch.context() as blind
        ):  # every other run creates its folder after this one's look
            blind.setattr(Path, "exists", lambda _path, **_: False)
            folders = [stack.enter_context(output_folder(None, "escort")) for _ in range(5)]
        assert len(set(folders)) == 5
        assert all(folder.is_dir() for folder in folders)
        (folders[2] / "summary.json").write_text("{}")
    assert list((here / "runs").iterdir()) == [folders[2].absolute()]


def test_brackets_in_a_path_are_no_markup(tmp_path, command):
    out = tmp_path / "[" / "x]" / "[bold]"
    done = command(*words("run --in-process --duration 1 --no-picture --out"), out)
    assert done.returncode == 0
    assert str(out / "summary.json") in done.stdout


def test_policy_error_ends_every_kind_of_run_alike(here, command):
    (here / "frames.py").write_text(
        "def wheel(o, b): raise ValueError('frame [/base_link] unknown, [m/s²]')\n"
    )
    own = words("--duration 1 --driver policy --set custom.policy=frames:wheel")
    run = ("run", *own, "--out", "mine", "--json")
    checked, alone, done = command("check", *own), command(*run, "--in-process"), command(*run)
    (line,) = done.stderr.splitlines()
    assert "tick 0" in line
    assert "frame [/base_link] unknown, [m/s²] (frames.py:1, in wheel)" in line
    results = [(one.returncode, one.stdout, one.stderr) for one in (alone, done)]
    assert results[0] == results[1] == (2, "", done.stderr)
    assert (checked.returncode, checked.stdout) == (2, "")
    assert not (here / "mine").exists()


def test_warning_and_traceback_of_a_vehicle_are_passed_on(here, monkeypatch, command):
    (here / "deep.py").write_text(
        "import warnings\n\n\ndef wheel(o, b):\n"
        "    if o.tick == 3:\n        warnings.warn('tyres are worn')\n"
        "    return inner(o) if o.tick == 9 else (0.01, 0.0)\n\n\ndef inner(o):\n    return 1 / 0\n"
    )
    monkeypatch.setenv("OUTRIDER_DEBUG", "")  # restored afterwards
    own = words(
        "--duration 1 --no-picture --out flown --driver policy --set custom.policy=deep:wheel --debug"
    )
    done = command("run", *own)
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if "UserWarning" in line]
    assert line.startswith("ugv_0: ")
    assert "deep.py:6: UserWarning: tyres are worn" in line
    for text in (done.stderr, (here / "flown" / "logs" / "ugv_0.log").read_text()):
        assert "Traceback (most recent call last):" in text
        assert "in inner" in text
        assert "ZeroDivisionError: division by zero (deep.py:11, in inner)" in text


@pytest.mark.parametrize(
    ("raised", "phrase"),
    [
        (OSError(errno.EMFILE, "Too many open files"), "OSError: Too many open files; --debug"),
        (ConnectionRefusedError(errno.ECONNREFUSED, "refused"), "ConnectionRefusedError: refused"),
        (OSError("the recording is incomplete"), "outrider: the recording is incomplete"),
        (FileNotFoundError(errno.ENOENT, "not there", "a.csv"), "outrider: a.csv: not there"),
    ],
)
def test_system_error_is_reported_by_its_cause(raised, phrase, monkeypatch, command):
    broken = create_autospec(doctor.command, side_effect=raised)
    monkeypatch.setattr(doctor, "command", broken)
    monkeypatch.setenv("OUTRIDER_DEBUG", "")
    done = command("doctor")
    assert done.returncode == 1
    assert phrase in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback (most recent call last)" in command("doctor", "--debug").stderr


@pytest.mark.parametrize("place", ["outrider.cli.doctor.command", "outrider.cli.main.make_app"])
def test_early_ctrl_c_is_reported_in_one_line(place, monkeypatch, command):
    monkeypatch.setattr(place, create_autospec(resolve_name(place), side_effect=KeyboardInterrupt))
    done = command("doctor")
    assert (done.returncode, done.stderr) == (130, "outrider: interrupted\n")


def test_a_result_that_cannot_be_printed_names_standard_output(monkeypatch, command):
    with open("/dev/full", "w") as full, monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", full)
        done = command("scenarios", "--json")
        with suppress(OSError):
            full.close()
    assert done.returncode == 1
    assert done.stderr == "outrider: standard output: No space left on device\n"


TOO_FAST = """from math import cos, sin

def spin(t):
    return (4.0 * cos(t), 4.0 * sin(t)), (-4.0 * cos(t), -4.0 * sin(t))
"""


def test_check_calls_user_functions_like_run(here, command):
    (here / "spinning.py").write_text(TOO_FAST)
    text = shipped_text("escort").replace('name = "certified"', 'name = "path"')
    (here / "mine.toml").write_text(f'{text}\n[custom]\npath = "spinning:spin"\n')
    checked = command("check", "mine.toml")
    assert checked.returncode == 0
    assert "allow it with --allow-code" in checked.stderr
    own = words("mine.toml --duration 1 --allow-code")
    checked = command("check", *own)
    flown = command("run", *own, "--in-process", "--no-files")
    assert checked.returncode == flown.returncode == 0
    warned = [line for line in flown.stderr.splitlines() if "warning" in line]
    for part in ("cannot be flown: needs 4 m/s", "v_a - v_g = 0.4 m/s", "u_a = 0.3 m/s²"):
        assert part in " ".join(warned)
    assert [line for line in checked.stderr.splitlines() if "warning" in line] == warned


@pytest.fixture(scope="module")
def schema():
    return json.loads(schema_text())


def test_schema_accepts_shipped_scenarios_and_no_nonsense(schema):
    validator = jsonschema.Draft202012Validator(schema)
    validator.check_schema(schema)
    for name in scenario_names():
        validator.validate(tomllib.loads(shipped_text(name)))
    assert validator.is_valid(
        {**tomllib.loads(shipped_text("escort")), "links": {"profile": "lte"}}
    )
    for given in ("mine.toml", "folder/mine.toml:radio", "mesh"):
        links = {"links": {"commands": {"profile": given}}}
        assert validator.is_valid({**tomllib.loads(shipped_text("escort")), **links}), given
    for change in ({"duratoin": 3.0}, {"dt": "0.05"}, {"seed": -1}, {"links": {"profile": "5g"}}):
        assert not validator.is_valid({**tomllib.loads(shipped_text("escort")), **change}), change


def test_the_shipped_schema_is_the_one_that_the_types_make(monkeypatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).resolve().parent.parent / "docs" / "generators")
    assert importlib.import_module("scenario_schema").schema_text() == schema_text()


def test_new_scenario_copies_a_shipped_one_and_replaces_no_file(tmp_path, command, schema):
    file = tmp_path / "Käfig 1.toml"
    made = command("scenarios", "new", file, "--from", "circle")
    assert made.returncode == 0
    assert f"outrider check '{file}'" in made.stdout  # so that it can be copied
    assert load_scenario(file, overrides={"name": "circle"}) == load_scenario("circle")
    beside = json.loads((tmp_path / "scenario.schema.json").read_text())
    assert beside == json.loads(json.dumps(schema))
    again = command("scenarios", "new", file)
    assert again.returncode == 2
    assert "--force" in again.stderr
    assert "circle" in file.read_text()


@pytest.mark.parametrize("name", ["mine", "escort.toml"])
def test_scenario_names_that_confuse_are_refused(name, here, command) -> None:
    made = command("scenarios", "new", name)
    assert made.returncode == 2
    assert list(here.iterdir()) == []


def test_the_doctor_finds_what_is_here_and_what_is_not(monkeypatch, command):
    monkeypatch.setattr(
        doctor, "missing", lambda extra: ("cryptography",) if extra == "tls" else ()
    )
    done = command("doctor", "--json")
    assert done.returncode == 0
    found = {row["what"]: row for row in json.loads(done.stdout)["findings"]}
    assert found["packages"]["state"] == "ok"
    assert found["[tls]"]["state"] == "missing"
    assert "pip install -e '.[tls]'" in found["[tls]"]["details"]
    assert found["[record]"]["state"] == "ok"
    broken = doctor.Finding("packages", "wrong", "not installed: numpy")
    monkeypatch.setattr(doctor, "CHECKS", (lambda: iter([broken]),))
    done = command("doctor")
    assert done.returncode == 1
    assert "not installed: numpy" in done.stdout


def test_the_shell_completes_commands():
    typed = {"COMP_WORDS": "outrider scen", "COMP_CWORD": "1"}
    run = ran([SCRIPT], env={"_OUTRIDER_COMPLETE": "complete_bash"} | typed, check=True)
    assert run.stdout.split() == ["scenarios"]


@pytest.mark.parametrize(
    ("own", "options"),
    [
        ("policy", {"driver": "policy"}),
        ("weighting", {"law": "weighted"}),
        ("path", {"law": "path"}),
        ("uav_policy", {"law": "certified"}),
    ],
)
def test_user_code_is_flown_or_warned_about(own: str, options: dict[str, str]) -> None:
    code = [f"custom.{own}=mine:f"]
    flown, named = resolve("escort", changes=code, **options)
    assert (foreign_code(flown, named), scenario_warnings(flown)) == ((), ())
    ignored, _ = resolve("escort", changes=code, law="linear", driver="evade")
    (warning,) = scenario_warnings(ignored)
    assert warning.startswith(f"custom.{own} = 'mine:f': not used; requires ")
    assert all(name in warning for name in options.values())


def test_policies_have_the_same_names_at_every_entry_point() -> None:
    flown, named = resolve("escort", uav_policy="mine:act", driver="policy:mine:wheel")
    assert (flown.law.name, flown.custom.uav_policy) == ("certified", "mine:act")
    assert (flown.ugv[0].driver, flown.custom.policy) == ("policy", "mine:wheel")
    assert foreign_code(flown, named) == ()
    assert resolve("escort", uav_policy="mine:act", law="policy")[0].law.name == "policy"
    with pytest.raises(ScenarioError, match=r"not used by --law linear; allowed: with certified"):
        resolve("escort", uav_policy="mine:act", law="linear")


@pytest.mark.parametrize("name", ["onnx:model.onnx", "torch:model.pt", "fmu:model.fmu"])
def test_a_policy_for_ugvs_alone_says_what_uavs_support(name: str) -> None:
    says = "is for a UGV only, not for a UAV; allowed: module:function, npz:FILE.npz or sb3:"
    with pytest.raises(ScenarioError, match=says):
        resolve("escort", uav_policy=name)
    with pytest.raises(ScenarioError, match=says):
        outrider.load_policy(name)
    with pytest.raises(ScenarioError, match=says):
        outrider.vector_env("escort", num_envs=1, agent="ugv_0", others={"uav_0": name})
    with pytest.raises(ScenarioError, match="npz: is for a UAV only, not for a UGV; allowed: "):
        resolve("escort", driver="npz:model.npz")


def test_a_vehicle_without_a_name_gets_the_next_one(tmp_path):
    file = tmp_path / "four.toml"
    file.write_text(
        "[[uav]]\nposition = [6.0, 21.0]\n[[uav]]\nposition = [8.0, 21.0]\n"
        "[[uav]]\nname = 'uav_0'\nposition = [7.0, 21.0]\n"
        "[[ugv]]\nposition = [6.0, 20.0]\n[[ugv]]\nposition = [30.0, 20.0]\n"
    )
    scenario = load_scenario(file)
    assert [uav.name for uav in scenario.uav] == ["uav_1", "uav_2", "uav_0"]
    assert [ugv.name for ugv in scenario.ugv] == ["ugv_0", "ugv_1"]


def test_commands_in_wrong_units_are_counted_or_reported_once(tmp_path, monkeypatch, caplog):
    (tmp_path / "units.py").write_text(
        "class Rows:\n    def predict(self, row):\n        return (5.0, 0.0)\n\nrows = Rows()\n\n"
        "def wheel(observation, briefing):\n    return (5.0, 0.0)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    own = {"duration": 2.0, "ugv.0.driver": "policy"}
    scenario = load_scenario("escort", overrides={**own, "custom.policy": "units:rows"})
    flight, summary = fly(scenario, 7)
    assert flight.answers.shortened == {"uav_0": 0, "ugv_0": 40}
    assert summary.faults == {"ugv_0": {"command beyond its bound": 40}}
    flight, summary = fly(msgspec.structs.replace(scenario, custom=Custom(policy="units:wheel")), 7)
    # on board it is limited to its bounds
    assert flight.answers.shortened == {"uav_0": 0, "ugv_0": 0}
    first, second = (record.getMessage() for record in caplog.records)
    assert first == (
        "ugv_0: its command for tick 0, 5 m/s², exceeds its bound 0.1 m/s² and is shortened; "
        "further ones are only counted"
    )
    assert second.startswith("policy = 'units:wheel': tick 0: returned 5 m/s², above the")


@pytest.mark.parametrize("name", ["escort", "scenario-2", "minefield"])
def test_no_action_of_the_space_counts_as_a_fault(name: str) -> None:
    scenario = load_scenario(name)
    flight = Flight(scenario, 1)
    for tick in range(16):
        commands: dict[str, UavCommand | UgvCommand] = {}
        for vehicle in scenario.vehicles:
            space = action_space(scenario, vehicle)
            space.seed(tick)
            corner = [(space.low, space.high)[tick >> k & 1][k] for k in range(space.shape[0])]
            action = np.float32(corner if tick < 8 else space.sample()).tolist()
            kind = UavCommand if vehicle in scenario.uav else UgvCommand
            higher = {"vertical_acceleration": action[2]} if len(action) == 3 else {}
            commands[vehicle.name] = kind(tick=tick, acceleration=tuple(action[:2]), **higher)
        flight.apply(commands)
    assert set(flight.answers.shortened.values()) == {0}


@pytest.mark.parametrize("law", [law.name for law in LAWS.values() if not law.own])
def test_no_builtin_law_exceeds_its_bound(law):
    scenario = load_scenario("escort", overrides={"duration": 5.0, "law.name": law})
    flight, summary = fly(scenario, 7)
    assert flight.answers.shortened == {"uav_0": 0, "ugv_0": 0}
    assert summary.faults == {}


class Hover:
    """The pilot of docs/how-to/own-code.md, which reports no estimate."""

    def act(self, observation):
        (detection, *_) = observation.detections or [None]
        x, y = detection.relative_position if detection else (0.0, 0.0)
        v_x, v_y = observation.velocity
        return UavCommand(tick=observation.tick, acceleration=(-0.2 * x - v_x, -0.2 * y - v_y))


def test_external_uav_is_not_titled_with_a_law(tmp_path):
    notices: list[str] = []
    scenario = load_scenario("escort", overrides={"duration": 5.0})
    flight = Flight(scenario, 7, on_notice=notices.append)
    recorder = FlightRecorder(tmp_path / "own.mcap", scenario, 7)
    exchange = Piloted(make_pilots(scenario, 7), "uav_0", Hover().act)
    flight.fly(exchange, on_tick=lambda: recorder.tick(flight))
    recorder.close()
    summary = summarize(flight, seconds=1.0)
    assert (summary.law, summary.certified_share, summary.uncertified) == ("external", None, {})
    (line,) = notices
    assert line.startswith("uav_0 receives detections but reports no estimate: your own program")
    recording = flight_of(tmp_path / "own.mcap")
    assert external_uavs(recording) == {"uav_0"}
    titles = [text.get_text() for text in flight_figure(restore(recording)).texts]
    assert "law external" in " ".join(titles)


def test_blind_built_in_pilot_is_not_called_external():
    blind = {"duration": 3.0, "links.detections.blackouts": [[0.0, 10.0]]}
    _, summary = fly(load_scenario("escort", overrides=blind), 7)
    assert summary.law == "certified"
    assert summary.uncertified == {"NO_REPORT": 60}
