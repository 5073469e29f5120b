"""The pages about environments and suite agree with the code."""

import inspect
import re

import pytest

from outrider.envs.single import single_env
from outrider.envs.vector import vector_env
from pages import PAGES, blocks, run_shown
from sim.env.settings import Settings

DEFAULTS = vars(Settings())
PAGE = "docs/reference/environment.md"


@pytest.mark.parametrize(
    "block", blocks("python", PAGE)[1:], ids=("vector", "parallel_vector", "names", "transformed")
)
def test_environment_blocks_run(block, capsys):
    if "outrider_learning" in block:
        pytest.importorskip("outrider_learning", reason="a copy of the core alone")
    run_shown(block, PAGE)
    assert capsys.readouterr().out


def test_all_arguments_are_documented() -> None:
    documented = {
        row[0]
        for row in re.findall(r"^\| `(\w+)` \| (`[^`]*`) \|", PAGES[PAGE], flags=re.MULTILINE)
    }
    assert documented == {"scenario"} | DEFAULTS.keys()


def test_documented_defaults_are_the_defaults() -> None:
    documented = dict(re.findall(r"^\| `(\w+)` \| `([^`]*)` \|", PAGES[PAGE], flags=re.MULTILINE))
    assert documented.pop("scenario") == repr(
        inspect.signature(vector_env).parameters["scenario"].default
    ).replace("'", '"')
    assert documented.pop("dtype") == "np.float64"
    assert documented.pop("rewards") == "RewardWeights()"
    assert documented == {name: repr(DEFAULTS[name]) for name in documented}
    assert inspect.signature(single_env).parameters["agent"].default == "uav_0"
