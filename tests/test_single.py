"""One vehicle, one world: world 0 of the vector environment to the bit, and Gymnasium's requirements."""

import math
import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from bus.messages.decision import NotCertified
from outrider.envs.single import single_env
from outrider.envs.vector import vector_env
from sim.compiling.records import code
from sim.env.observation import one_of_world
from worlds import CASES, SCENARIOS, equal, random_actions

SCENARIO = SCENARIOS["certified"]
SETTINGS: dict[str, dict[str, Any]] = {
    "row": {},
    "ugv": {"agent": "ugv_0"},
    "patch": {"coverage_patch": (5, 1.0)},
    "filters": {"estimate": True, "gradient": True, "safety_filter": True},
    "short": {"dtype": np.float32},
}


@pytest.mark.parametrize("name", CASES)
def test_it_is_world_0_of_the_vector_environment_also_over_ends(name: str) -> None:
    scenario, agent, options = CASES[name]
    one = single_env(scenario, agent=agent, **options)
    many = vector_env(scenario, num_envs=2, agent=agent, **options)
    last, _ = one.reset(seed=21)
    seen, _ = many.reset(seed=21)
    for actions in random_actions(2, 420):
        assert equal(last, one_of_world(seen, 0))
        seen, rewards, terminated, truncated, infos = many.step(actions)
        last, reward, ends, cut, info = one.step(actions[0])
        assert (reward, ends, cut) == (rewards[0], terminated[0], truncated[0])
        if ends or cut:
            assert equal(last, infos["final_obs"][0])
            infos = infos["final_info"]
            with pytest.raises(ResetNeeded, match="after the end"):
                one.step(actions[0])
            last, _ = one.reset()
        for key in info:
            assert info[key] == infos[key][0]
        assert one.episode_seed == many.worlds.episode_seeds[0]


@pytest.mark.parametrize("name", SETTINGS)
def test_the_checker_has_nothing_against_it(name: str) -> None:
    env = single_env(SCENARIO, duration=2.0, **SETTINGS[name])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env)
    assert not [one for one in caught if "not having a spec" not in str(one.message)]


def test_what_it_returns_has_gymnasiums_types() -> None:
    env = single_env(SCENARIO, estimate=True, safety_filter=True)
    seen, info = env.reset(seed=3)
    assert info == {
        "overridden": False,
        "certified": False,
        "uncertified": code(NotCertified.NO_MEASUREMENT),
        "certified_distance": math.inf,
    }
    seen, reward, terminated, truncated, info = env.step([0, 0])
    assert env.observation_space.contains(seen)
    assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
    assert [type(value) for value in info.values()] == [bool, bool, int, float]
    metrics = env.metrics()["uav_0"]
    assert metrics["ticks"] == 1.0
    assert metrics.pop("uncertified") in ("", *NotCertified)
    assert all(type(value) is float for value in metrics.values())
    env.close()
    assert type(single_env(SCENARIO, agent="ugv_0").reset()[1]["goals_reached"]) is int
