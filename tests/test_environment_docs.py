"""The pages about environments, suite and tutorial show what is there."""

import inspect
import re
from pathlib import Path

import pytest

import outrider
from outrider.envs.single import single_env
from outrider.envs.vector import BATCH_DEFAULTS, vector_env
from outrider.experiments.suite.board import BASELINES, leaderboard
from outrider.experiments.suite.tasks import TASKS, Task, suite
from outrider.registration import env_ids

ROOT = Path(__file__).resolve().parent.parent


def page(name: str) -> str:
    (path,) = (ROOT / "docs").rglob(f"{name}.md")
    return path.read_text(encoding="utf-8")


def python_blocks(name: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page(name), flags=re.DOTALL)


def between(text: str, mark: str) -> list[list[str]]:
    """The rows of the table between two marks, without its head."""
    shown = text.split(f"<!-- {mark} -->\n")[1].split(f"<!-- /{mark} -->", maxsplit=1)[0]
    return [line.strip("| ").split(" | ") for line in shown.strip().splitlines()[2:]]


@pytest.mark.parametrize(
    "block",
    python_blocks("vector-environment"),
    ids=lambda block: re.search(r"outrider\.\w+|make", block)[0],
)
def test_the_environments_shown_can_be_flown(block, capsys):
    exec(compile(block, "vector-environment.md", "exec"), {})  # noqa: S102 - our own page
    assert capsys.readouterr().out


def test_the_entry_shown_is_scored(monkeypatch, capsys):
    (block,) = python_blocks("suite")
    short = Task(name="short", hard="", changes={**suite()["short-sight"].changes, "duration": 5.0})
    monkeypatch.setattr(outrider, "suite", lambda: {"short-sight": short}, raising=False)
    exec(compile(block, "suite.md", "exec"), {})  # noqa: S102 - our own page
    out = capsys.readouterr().out
    assert "0 of 20 lost" in out
    assert "| **mean** | " in out


def test_all_the_arguments_are_told() -> None:
    told = {
        row[0]
        for row in re.findall(
            r"^\| `(\w+)` \| (`[^`]*`) \|", page("vector-environment"), flags=re.MULTILINE
        )
    }
    assert told == {"scenario"} | BATCH_DEFAULTS.keys()


def test_the_defaults_told_are_those_taken() -> None:
    told = dict(
        re.findall(r"^\| `(\w+)` \| `([^`]*)` \|", page("vector-environment"), flags=re.MULTILINE)
    )
    assert told.pop("scenario") == repr(
        inspect.signature(vector_env).parameters["scenario"].default
    ).replace("'", '"')
    assert told.pop("dtype") == "np.float64"
    assert told == {name: repr(BATCH_DEFAULTS[name]) for name in told}
    assert inspect.signature(single_env).parameters["agent"].default == "uav_0"


def test_the_tasks_told_are_the_suites() -> None:
    rows = between(page("suite"), "tasks")
    assert [(row[0].strip("`"), row[1]) for row in rows] == [
        (task.name, task.hard) for task in TASKS
    ]
    for row, task in zip(rows, TASKS, strict=True):
        assert re.findall(r"`([\w.]+)", row[2]) == list(task.changes)
    assert all(
        name in env_ids()
        for name in re.findall(r"`(outrider/[\w-]+-v\d)`", page("vector-environment"))
    )


def test_the_leaderboard_told_is_what_the_command_makes() -> None:
    """Its frame, and the cell that is soonest flown."""
    text = page("suite")
    rows = between(text, "board")
    head = text.split("<!-- board -->\n")[1].splitlines()[0].strip("| ").split(" | ")
    assert [row[0] for row in rows] == [*suite().names, "**mean**"]
    assert set(head[1:]) == set(BASELINES)
    means = [float(cell.split(" ± ")[0]) for cell in rows[-1][1:]]
    assert means == sorted(means, reverse=True)
    (secret,) = re.findall(r"outrider suite --secret ([0-9a-f]{32}) --markdown", text)
    made = leaderboard(["tracking"], tasks=[suite()["covered"]], secret=secret).rows()[1][1]
    assert made == rows[suite().names.index("covered")][head.index("tracking")]


def test_the_tutorial_shows_the_example_as_it_is() -> None:
    source = (ROOT / "examples" / "tutorial.py").read_text(encoding="utf-8")
    cells = [cell.strip() for cell in re.split(r"^# %%.*\n", source, flags=re.MULTILINE)[1:]]
    code = [
        cell
        for cell in cells
        if not all(line.startswith("#") or not line for line in cell.splitlines())
    ]
    assert [block.strip() for block in python_blocks("tutorial")] == code
    compile(source, "tutorial.py", "exec")


@pytest.fixture(autouse=True)
def _front_door(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outrider, "single_env", single_env, raising=False)
    monkeypatch.setattr(outrider, "leaderboard", leaderboard, raising=False)
