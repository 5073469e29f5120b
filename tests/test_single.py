"""One vehicle, one world: world 0 of the vector environment to the bit, and what Gymnasium asks of an environment."""

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordEpisodeStatistics
from refusals import refused
from worlds import CASES, SCENARIOS, equal, random_actions, row_of

from outrider.envs.single import SingleEnv, single_env
from outrider.envs.vector import vector_env

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
        assert equal(last, row_of(seen, 0))
        seen, rewards, terminated, truncated, infos = many.step(actions)
        last, reward, ends, cut, info = one.step(actions[0])
        assert (reward, ends, cut) == (rewards[0], terminated[0], truncated[0])
        if ends or cut:
            assert equal(last, infos["final_obs"][0])
            infos = infos["final_info"]
            with pytest.raises(ResetNeeded, match="after the end"):
                one.step(actions[0])
            last, _ = one.reset()
        for key, value in info.items():
            assert value == infos[key][0]
        assert one.episode_seed == many.worlds.episode_seeds[0]


@pytest.mark.parametrize("name", SETTINGS)
def test_the_checker_has_nothing_against_it(name: str) -> None:
    env = single_env(SCENARIO, duration=2.0, **SETTINGS[name])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env)
    ours = [str(one.message) for one in caught if "not having a spec" not in str(one.message)]
    # An estimate has no largest distance: its space is unbounded on purpose.
    assert all("infinity" in line for line in ours) if name == "filters" else not ours


def test_what_it_returns_has_gymnasiums_types() -> None:
    env = single_env(SCENARIO, estimate=True, safety_filter=True)
    seen, info = env.reset(seed=3)
    assert info == {"intervened": False, "certified": False, "certified_distance": 0.0}
    seen, reward, terminated, truncated, info = env.step([0, 0])
    assert env.observation_space.contains(seen)
    assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
    assert [type(value) for value in info.values()] == [bool, bool, float]
    env.close()
    assert type(single_env(SCENARIO, agent="ugv_0").reset()[1]["goals_reached"]) is int


def test_what_was_returned_is_never_changed_later() -> None:
    env = single_env(SCENARIO)
    kept = [env.reset(seed=1)[0]]
    copies = [kept[0].copy()]
    for actions in random_actions(1, 5):
        kept.append(env.step(actions[0])[0])
        copies.append(kept[-1].copy())
    assert all(equal(one, other) for one, other in zip(kept, copies, strict=True))


def test_an_episode_is_counted_once() -> None:
    env = RecordEpisodeStatistics(single_env(SCENARIO, duration=0.5))
    env.reset(seed=1)
    for _ in range(9):
        assert not env.step(np.zeros(2))[3]
    _, _, _, truncated, info = env.step(np.zeros(2))
    assert truncated
    assert info["episode"]["l"] == 10


def test_the_first_seed_is_the_scenarios_and_each_later_one_follows_from_the_last_given() -> None:
    one, other = single_env(SCENARIO), single_env(SCENARIO)
    one.reset()
    assert one.episode_seed == SCENARIO.seed
    other.reset(seed=SCENARIO.seed)
    for env in (one, other):
        env.reset()
    assert one.episode_seed == other.episode_seed != SCENARIO.seed


def test_it_must_be_reset_first() -> None:
    with pytest.raises(ResetNeeded, match="before reset"):
        single_env(SCENARIO).step(np.zeros(2))


@pytest.mark.parametrize("seed", [-1, 2**53, "a", 1.5], ids=str)
def test_a_bad_seed_is_refused_and_the_episode_goes_on(seed: Any) -> None:
    env = single_env(SCENARIO)
    env.reset(seed=1)
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=seed)
    assert env.episode_seed == 1
    env.step(np.zeros(2))


@pytest.mark.parametrize(
    "action",
    [
        np.zeros(3),
        [[0.0, 0.0]],
        None,
        "a",
        [np.nan, 0.0],
        [0.0, 1e9],
        {"uav_0": [0, 0]},
        [True, False],
    ],
    ids=str,
)
def test_a_bad_action_is_refused_in_one_line_and_nothing_has_happened(action: Any) -> None:
    env, other = single_env(SCENARIO), single_env(SCENARIO)
    for one in (env, other):
        one.reset(seed=1)
    with refused(ValueError, "action of uav_0"):
        env.step(action)
    assert equal(env.step([0.1, 0.2])[0], other.step([0.1, 0.2])[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"agent": "uav_7"}, "agent = 'uav_7'; allowed: uav_0, ugv_0"),
        ({"others": {"uav_0": "linear"}}, "comes? from outside"),
        ({"render_mode": "human"}, "render_mode = 'human'; allowed: None"),
        ({"dtype": np.int32}, "dtype"),
    ],
    ids=str,
)
def test_a_bad_argument_is_refused_in_one_line(options: dict[str, Any], message: str) -> None:
    with refused(ValueError, message):
        SingleEnv(SCENARIO, **options)


def test_metrics_are_plain_numbers() -> None:
    env = single_env(SCENARIO)
    env.reset(seed=1)
    env.step([0.0, 0.0])
    told = env.metrics()["uav_0"]
    assert told["ticks"] == 1.0
    assert all(type(value) is float for value in told.values())
