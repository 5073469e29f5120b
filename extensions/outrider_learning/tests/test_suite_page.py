"""The suite's page agrees with the program."""

import re

from outrider.registration import ESCORT
from outrider_learning.suite import tasks
from outrider_learning.suite.board import BASELINES, leaderboard
from outrider_learning.suite.tasks import MISSIONS, TASKS, Task, suite
from pages import PAGES, blocks, marked, run_shown

ENVIRONMENT, SUITE = "docs/reference/environment.md", "extensions/outrider_learning/README.md"


def test_documented_entry_is_scored(monkeypatch, capsys):
    block = "\n".join(blocks("python", SUITE))
    short = Task(name="short", hard="", changes={**suite()["short-sight"].changes, "duration": 5.0})
    monkeypatch.setattr(tasks, "suite", lambda: {"short-sight": short})
    run_shown(block, SUITE)
    out = capsys.readouterr().out
    assert "0 of 20 lost" in out
    assert "| **mean** | " in out


def test_documented_tasks_are_the_suites() -> None:
    _, *rows = marked("tasks", SUITE)
    assert [(row[0].strip("`"), row[1]) for row in rows] == [
        (task.name, task.hard) for task in TASKS
    ]
    for row, task in zip(rows, TASKS, strict=True):
        assert re.findall(r"`([\w.]+)", row[2]) == list(task.changes)
    assert all(
        name in (ESCORT, *(task.env_id for task in (*TASKS, *MISSIONS)))
        for name in re.findall(r"`(outrider/[\w-]+-v\d)`", PAGES[ENVIRONMENT])
    )


def test_documented_leaderboard_matches_a_cell() -> None:
    """Check the frame and one cell: a filter on degraded links."""
    head, *rows = marked("board", SUITE)
    assert [row[0] for row in rows] == [*suite().names, "**mean**"]
    assert set(head[1:]) == set(BASELINES)
    means = [float(cell.split(" ± ")[0]) for cell in rows[-1][1:]]
    assert means == sorted(means, reverse=True)
    (secret,) = re.findall(r"outrider suite --secret ([0-9a-f]{32}) --markdown", PAGES[SUITE])
    task, law = "all-at-once", "certified"
    made = leaderboard([law], tasks=[suite()[task]], secret=secret).rows()[1][1]
    assert made == rows[suite().names.index(task)][head.index(law)]
