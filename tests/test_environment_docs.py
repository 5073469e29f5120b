"""The pages about environments, suite and tutorial show what is there."""

import inspect
import re

import pytest

import outrider
from outrider.envs.single import single_env
from outrider.envs.vector import vector_env
from pages import PAGES, ROOT, blocks, run_shown
from sim.env.settings import Settings

DEFAULTS = vars(Settings())
VECTOR = "docs/reference/vector-environment.md"


@pytest.mark.parametrize(
    "block", blocks("python", VECTOR), ids=lambda block: re.search(r"outrider\.\w+|make", block)[0]
)
def test_the_environments_shown_can_be_flown(block, capsys):
    run_shown(block, VECTOR)
    assert capsys.readouterr().out


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
