"""The tasks' names in Gymnasium and PettingZoo."""

import gymnasium
import numpy as np
import pettingzoo
import pytest

from outrider.envs.single import SingleEnv
from outrider.envs.vector import OutriderVectorEnv
from outrider_learning.registration import register
from outrider_learning.suite.tasks import SUITES, TASKS
from processes import python

ALL = [task for tasks in SUITES.values() for task in tasks]
ENV_IDS = {task.env_id for task in ALL}
NOISE = "outrider/Suite-Noise-v0"


def test_there_is_a_name_for_each_task() -> None:
    assert len(ENV_IDS) == len(ALL)
    for task in TASKS:
        made = gymnasium.make(task.env_id).unwrapped
        assert isinstance(made, SingleEnv)
        assert made.worlds.scenario == task.scenario


def test_pettingzoo_has_the_same_names() -> None:
    register()
    assert {*pettingzoo.parallel_registry} & {*pettingzoo.aec_registry} >= ENV_IDS
    made = pettingzoo.make("parallel", "outrider/Suite-TwoPairs-v0")
    assert made.unwrapped.scenario == next(t.scenario for t in TASKS if t.name == "two-pairs")
    with pytest.raises(ValueError, match=r"max_cycles = 10: .*duration"):
        pettingzoo.make("parallel", NOISE, max_cycles=10)


def test_settings_go_through() -> None:
    env = gymnasium.make(NOISE, agent="ugv_0", dtype=np.float32)
    assert env.observation_space.shape == (8,)
    assert isinstance(gymnasium.make_vec(NOISE, num_envs=2, gradient=True), OutriderVectorEnv)
    with pytest.raises(ValueError, match=r"max_episode_steps = 3: .*duration"):
        gymnasium.make_vec(NOISE, num_envs=2, max_episode_steps=3)


def test_a_name_with_its_module_needs_no_import() -> None:
    name = f"outrider_learning.registration:{NOISE}"
    code = (
        "import sys, outrider_learning.registration; print(*sys.modules); import gymnasium; "
        f"print(gymnasium.make({name!r}).unwrapped.worlds.scenario.name)"
    )
    loaded, made = python(code).stdout.splitlines()
    assert {"numba", "sim", "agents", "zenoh"}.isdisjoint(loaded.split())
    assert made == "noise"
