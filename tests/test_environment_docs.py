"""The pages about environments, suite and tutorial show what is there."""

import inspect
import re

import pytest

import outrider
from outrider.envs.single import single_env
from outrider.envs.vector import vector_env
from outrider.registration import ESCORT
from pages import PAGES, ROOT, blocks, marked, run_shown
from sim.env.settings import Settings

pytest.importorskip("outrider_learning", reason="the pages show its suite")

from outrider_learning.suite import tasks
from outrider_learning.suite.board import BASELINES, leaderboard
from outrider_learning.suite.tasks import MISSIONS, TASKS, Task, suite

DEFAULTS = vars(Settings())
VECTOR, SUITE = "docs/reference/vector-environment.md", "docs/reference/suite.md"


@pytest.mark.parametrize(
    "block", blocks("python", VECTOR), ids=lambda block: re.search(r"outrider\.\w+|make", block)[0]
)
def test_the_environments_shown_can_be_flown(block, capsys):
    run_shown(block, VECTOR)
    assert capsys.readouterr().out


def test_the_entry_shown_is_scored(monkeypatch, capsys):
    (block,) = blocks("python", SUITE)
    short = Task(name="short", hard="", changes={**suite()["short-sight"].changes, "duration": 5.0})
    monkeypatch.setattr(tasks, "suite", lambda: {"short-sight": short})
    run_shown(block, SUITE)
    out = capsys.readouterr().out
    assert "0 of 20 lost" in out
    assert "| **mean** | " in out


def test_all_the_arguments_are_told() -> None:
    told = {
        row[0]
        for row in re.findall(r"^\| `(\w+)` \| (`[^`]*`) \|", PAGES[VECTOR], flags=re.MULTILINE)
    }
    assert told == {"scenario"} | DEFAULTS.keys()


def test_the_defaults_told_are_those_taken() -> None:
    told = dict(re.findall(r"^\| `(\w+)` \| `([^`]*)` \|", PAGES[VECTOR], flags=re.MULTILINE))
    assert told.pop("scenario") == repr(
        inspect.signature(vector_env).parameters["scenario"].default
    ).replace("'", '"')
    assert told.pop("dtype") == "np.float64"
    assert told.pop("rewards") == "RewardWeights()"
    assert told == {name: repr(DEFAULTS[name]) for name in told}
    assert inspect.signature(single_env).parameters["agent"].default == "uav_0"


def test_the_tasks_told_are_the_suites() -> None:
    _, *rows = marked("tasks", SUITE)
    assert [(row[0].strip("`"), row[1]) for row in rows] == [
        (task.name, task.hard) for task in TASKS
    ]
    for row, task in zip(rows, TASKS, strict=True):
        assert re.findall(r"`([\w.]+)", row[2]) == list(task.changes)
    assert all(
        name in (ESCORT, *(task.env_id for task in (*TASKS, *MISSIONS)))
        for name in re.findall(r"`(outrider/[\w-]+-v\d)`", PAGES[VECTOR])
    )


def test_the_leaderboard_told_is_what_the_command_makes() -> None:
    """Its frame, and three cells: soonest flown, a driver that draws its way, and a filter on bad links."""
    head, *rows = marked("board", SUITE)
    assert [row[0] for row in rows] == [*suite().names, "**mean**"]
    assert set(head[1:]) == set(BASELINES)
    means = [float(cell.split(" ± ")[0]) for cell in rows[-1][1:]]
    assert means == sorted(means, reverse=True)
    (secret,) = re.findall(r"outrider suite --secret ([0-9a-f]{32}) --markdown", PAGES[SUITE])
    for task, law in (
        ("covered", "tracking"),
        ("wander", "tracking"),
        ("all-at-once", "certified"),
    ):
        made = leaderboard([law], tasks=[suite()[task]], secret=secret).rows()[1][1]
        assert made == rows[suite().names.index(task)][head.index(law)]


def test_the_tutorial_shows_the_example_as_it_is() -> None:
    source = (ROOT / "examples" / "tutorial.py").read_text(encoding="utf-8")
    cells = [cell.strip() for cell in re.split(r"^# %%.*\n", source, flags=re.MULTILINE)[1:]]
    code = [
        cell
        for cell in cells
        if not all(line.startswith("#") or not line for line in cell.splitlines())
    ]
    assert [block.strip() for block in blocks("python", "docs/tutorial.md")] == code
    compile(source, "tutorial.py", "exec")


@pytest.fixture(autouse=True)
def _front_door(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outrider, "single_env", single_env, raising=False)
