"""CONTRIBUTING.md says enough: its blocks are done in a copy of the sources, and what they add is flown."""

import ast
import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from processes import python

# on one worker: its copy is made and flown once
ROOT = Path(__file__).resolve().parent.parent
GUIDE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = re.findall(
    r"```(?:python|toml)\n# (\S+?)(?:: an? (\w+)(?: of (\w+))?)?\n(.*?)```", GUIDE, re.DOTALL
)
"""File, kind of place and its name, if it is no file of its own, and the text of every block."""

ASKED = """
import json

import numba
import numpy as np

from sim.kernels import compile, records

if numba.config.DISABLE_JIT:
    def plain(function, **_):
        function.py_func = function
        return function

    compile._compile = plain  # which leaves it as it is, but for what a compiled function has
    rows_type = records.record_type  # Python reads a record's columns by name, not those of a void
    records.record_type = lambda fields: np.dtype((np.record, rows_type(fields)))

import outrider
from agents.control.laws import OwnTerms, law_parameters, weights
from bus.registry import LAWS, SENSORS
from sim.engine.briefing import briefing
from sim.models.field import sensor_quality, sensor_slope

def branches():
    scenario = outrider.load_scenario("zigzag")
    law, cone = law_parameters(briefing(scenario, "uav_0", 0), scenario.law), SENSORS["cone"].code
    return {
        "where": outrider.__file__,
        "jit": not numba.config.DISABLE_JIT,
        "r_s": law.r_s,
        "weights": weights(law, OwnTerms(), 1.0),
        "sensor": [sensor_quality(cone, 4.0, 2.0, 5.0), sensor_slope(cone, 4.0, 2.0, 5.0)],
    }
"""
BRANCHES = ASKED + "print(json.dumps(branches()))"
FLIGHT = (
    ASKED
    + """
import contextlib, io, sys

import msgspec

from bus.keys import KEYS
from outrider.cli.main import run_command_line
from outrider.style import law_color

def said(*arguments):
    sys.argv, text = ["outrider", *arguments], io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        code = run_command_line()
    return code, " ".join(text.getvalue().replace("│", " ").split())

def flown(**overrides):
    named = {field.replace("__", "."): value for field, value in overrides.items()}
    return outrider.run(outrider.load_scenario("zigzag", overrides=named))

scenario = outrider.load_scenario("zigzag")
remark = next(key for key in KEYS if key.topic == "remark")
plain = flown()
print(json.dumps({
    "help": said("run", "--help")[1],
    "scenarios": said("scenarios")[1],
    "check": said("check", "zigzag"),
    "late": said("check", "zigzag", "--set", "visibility.alarm=4.75"),
    "unlike": [
        said("check", "escort", "--set", f"{field}={name}")
        for field, name in {
            "law.name": "cautios", "ugv.0.driver": "zigzg", "sensor.model": "con",
            "visibility.alrm": "1.0", "links.profile": "smoky",
        }.items()
    ],
    "alarm": [scenario.visibility.alarm, outrider.load_scenario("escort").visibility.alarm],
    "profile": scenario.links.commands.burst_loss,
    "law": plain.law,
    "ticks": plain.ticks,
    "hashes": [
        one.trajectory_sha256
        for one in (
            plain, flown(), flown(law__name="linear"), flown(ugv__0__driver="waypoints"),
            flown(sensor__model="hill"),
        )
    ],
    **branches(),
    "color": law_color("cautious"),
    "compared": LAWS["cautious"].compared,
    "remark": msgspec.json.encode(remark.message(text="well flown")).decode(),
    "written_by": [str(remark.writer), *map(str, remark.readers)],
}))
"""
)


def _line_of(text: str, kind: str, name: str, block: str) -> int:
    """The line, from 0, before which a block belongs."""
    tree = ast.parse(text)
    if kind == "row":
        table = next(
            node
            for node in tree.body
            if isinstance(node, ast.Assign | ast.AnnAssign)
            and name in ast.unparse(node).split("=")[0]
        )
        return table.end_lineno - 1
    if kind in ("branch", "field"):
        body = next(node.body for node in tree.body if getattr(node, "name", "") == name)
        if kind == "branch":
            return next(node for node in body if isinstance(node, ast.If)).lineno - 1
        return max(node.end_lineno for node in body if isinstance(node, ast.AnnAssign | ast.Expr))
    if kind == "import":
        return (
            next(node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)).lineno
            - 1
        )
    (made,) = ast.parse(block).body
    mine = made.targets[0].id if isinstance(made, ast.Assign) else made.name
    used = [
        node.lineno - 1
        for node in tree.body
        if not isinstance(node, ast.FunctionDef | ast.ClassDef)
        and any(isinstance(part, ast.Name) and part.id == mine for part in ast.walk(node))
    ]
    return min(used, default=len(text.splitlines()))


def apply(root: Path, blocks: list[tuple[str, str, str, str]]) -> None:
    """Do in a copy of the sources what the blocks say."""
    for file, kind, name, block in sorted(blocks, key=lambda one: one[1] != "row"):
        path = root / file
        if not kind:
            assert not path.exists(), file
            path.write_text(block, encoding="utf-8")
            continue
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines(keepends=True)
        lines.insert(_line_of(text, kind, name, block), block)
        path.write_text("".join(lines), encoding="utf-8")


def copied(root: Path) -> Path:
    """A copy of the sources."""
    for package in ("agents", "bus", "outrider", "sim"):
        shutil.copytree(
            ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    return root


def answer(root: Path, code: str, **environment: str) -> dict[str, Any]:
    """The one JSON object that a program prints, run with the copy."""
    own = {"PYTHONPATH": str(root), "OUTRIDER_CACHE": str(root / "cache"), "COLUMNS": "250"}
    done = python(code, cwd=root, env=os.environ | own | environment, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    assert Path(found["where"]).is_relative_to(root)
    return found


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources with everything of the guide in it."""
    root = copied(tmp_path_factory.mktemp("extended"))
    apply(root, BLOCKS)
    return root


@pytest.fixture(scope="module")
def extended(root: Path) -> dict[str, Any]:
    """Its output and its flight; without numba, as compiling a flight takes longer than all the rest."""
    return answer(root, FLIGHT, NUMBA_DISABLE_JIT="1")


def test_every_block_of_the_guide_is_done() -> None:
    assert len(BLOCKS) == GUIDE.count("```") // 2
    sections = set(re.findall(r"^## An? (.+)$", GUIDE, re.MULTILINE))
    some = {"field of a scenario", "profile of links"}
    assert sections == {"law", "driver", "sensor", "scenario", "message"} | some


def test_what_the_guide_adds_flies_and_is_no_other(extended: dict[str, Any]) -> None:
    first, again, law, driver, sensor = extended["hashes"]
    assert (extended["law"], extended["ticks"]) == ("cautious", 20)
    assert first == again
    assert len({first, law, driver, sensor}) == 4


def test_help_and_list_of_scenarios_tell_it(extended: dict[str, Any]) -> None:
    assert "cautious: both, tracking sooner than linear" in extended["help"]
    assert "zigzag: turns all the time" in extended["help"]
    assert "smoke" in extended["help"]
    assert "zigzag cautious 1 s A UGV that turns all the time" in extended["scenarios"]
    assert extended["color"] == "#7a6f2b"
    assert extended["compared"]  # so it is an entry of the suite


def test_check_and_reader_know_it(extended: dict[str, Any]) -> None:
    assert extended["check"][0] == 0
    assert "law cautious" in extended["check"][1]
    assert extended["alarm"] == [4.0, 0.0]
    assert extended["profile"] == 0.8
    code, line = extended["late"]
    assert code == 2
    assert "visibility.alarm = 4.75: comes too late; allowed: less than" in line


@pytest.mark.parametrize("name", ["cautious", "zigzag", "cone", "alarm", "smoke"])
def test_a_name_that_is_nearly_one_of_the_new_ones_is_refused_with_it(extended, name):
    (told,) = [
        (code, line) for code, line in extended["unlike"] if f"did you mean '{name}'?" in line
    ]
    assert told[0] == 2
    assert told[1].endswith(name)  # the last of what is allowed


def test_a_new_message_has_its_key(extended: dict[str, Any]) -> None:
    assert extended["remark"] == '{"text":"well flown"}'
    assert extended["written_by"] == ["operator", "observer"]


def test_law_and_sensor_compile_to_the_same_numbers(root: Path, extended: dict[str, Any]) -> None:
    compiled = answer(root, BRANCHES)
    share = (1.0 / compiled["r_s"]) ** 0.5
    assert compiled["jit"]
    assert compiled["weights"] == pytest.approx([share, 1.0 - share])
    assert compiled["sensor"] == pytest.approx([2.0 * (1.0 - 4.0 / 25.0), -2.0 / 25.0])
    assert {name: extended[name] for name in ("weights", "sensor", "r_s")} == {
        name: compiled[name] for name in ("weights", "sensor", "r_s")
    }


@pytest.mark.parametrize(
    ("file", "name", "code", "wrong"),
    [
        (
            "agents/drivers/zigzag.py",
            "",
            "import agents.ugv",
            "No module named 'agents.drivers.zigzag'",
        ),
        (
            "agents/control/laws.py",
            "weights",
            BRANCHES,
            "law.name = 'cautious': has a row in bus.registry, but no branch in",
        ),
    ],
    ids=["driver", "law"],
)
def test_a_row_whose_code_is_missing_is_refused(tmp_path, file, name, code, wrong):
    blocks = [block for block in BLOCKS if (block[0], block[2]) != (file, name)]
    assert len(blocks) == len(BLOCKS) - 1
    apply(copied(tmp_path), blocks)
    with pytest.raises(AssertionError, match=wrong):
        answer(tmp_path, code, NUMBA_DISABLE_JIT="1")


def test_another_code_has_another_cache_of_compiled_functions(root: Path) -> None:
    code = """
import json
from pathlib import Path
import bus.registry
from sim.kernels.compile import _source_digest
rows, before = Path(bus.registry.__file__), _source_digest()
text = rows.read_text()
rows.write_text(text.replace("code=9", "code=10"))
after = _source_digest()
rows.write_text(text)
print(json.dumps({"where": str(rows), "digests": [before, after, _source_digest()]}))
"""
    before, after, again = answer(root, code)["digests"]
    assert before == again
    assert after != before
