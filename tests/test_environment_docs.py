"""The pages about environments and suite agree with the code."""

import inspect
import re

import pytest

from outrider.envs.single import single_env
from outrider.envs.vector import vector_env
from pages import PAGES, blocks, run_shown
from sim.env.settings import Settings

PAGE = "docs/reference/environment.md"


@pytest.mark.parametrize(
    "block",
    blocks("python", PAGE)[1:],
    ids=("vector", "parallel_vector", "names", "teams", "transformed"),
)
def test_environment_blocks_run(block, capsys):
    if "outrider_learning" in block:
        pytest.importorskip("outrider_learning", reason="a copy of the core alone")
    run_shown(block, PAGE)
    assert capsys.readouterr().out


def test_all_arguments_are_documented_with_their_defaults() -> None:
    documented = dict(re.findall(r"^\| `(\w+)` \| `([^`]*)` \|", PAGES[PAGE], flags=re.MULTILINE))
    scenario = inspect.signature(vector_env).parameters["scenario"].default
    defaults = {name: repr(default) for name, default in vars(Settings()).items()}
    defaults |= {"dtype": "np.float64", "rewards": "RewardWeights()", "scenario": f'"{scenario}"'}
    assert documented == defaults
    assert inspect.signature(single_env).parameters["agent"].default == "uav_0"
