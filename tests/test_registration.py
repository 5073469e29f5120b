"""The environments' names in Gymnasium and PettingZoo: correct settings, and no limit applied twice."""

import copy
import importlib
import pickle
import sys

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

import outrider
from outrider.envs.vector import OutriderVectorEnv
from outrider.registration import ESCORT, register
from processes import python
from refusals import refused


def test_import_of_outrider_registers_the_name(monkeypatch) -> None:
    registries = (gymnasium.registry, pettingzoo.parallel_registry, pettingzoo.aec_registry)
    register()
    for registry in registries:
        monkeypatch.delitem(registry, ESCORT)
    monkeypatch.delitem(sys.modules, "outrider.registration")
    importlib.reload(outrider)
    assert all(ESCORT in registry for registry in registries)


@pytest.mark.parametrize("library", ["gymnasium", "pettingzoo"])
def test_the_name_resolves_whatever_is_imported_first(library) -> None:
    kind = "" if library == "gymnasium" else "'parallel', "
    made = f"print({library}.make({kind}{ESCORT!r}, duration=1.0).unwrapped.render_mode)"
    for order in (f"outrider, {library}", f"{library}, outrider"):
        assert python(f"import {order}; {made}").stdout.strip() == "None"


def test_registering_again_does_nothing() -> None:
    register()
    registries = (gymnasium.registry, pettingzoo.parallel_registry, pettingzoo.aec_registry)
    before = [dict(one) for one in registries]
    register()
    assert [dict(one) for one in registries] == before


def test_pettingzoo_makes_all_vehicles_agents() -> None:
    register()
    env = pettingzoo.make("parallel", ESCORT, duration=1.0)
    assert env.possible_agents == ["uav_0", "ugv_0"]
    assert env.unwrapped.scenario.duration == 1.0
    turns = pettingzoo.make("aec", ESCORT, duration=1.0)
    turns.reset(seed=1)
    assert turns.agent_selection == "uav_0"
    with pytest.raises(ValueError, match=r"max_cycles = 10: .*duration"):
        pettingzoo.make("parallel", ESCORT, max_cycles=10)


def test_a_spec_can_be_copied_pickled_written_and_made_again() -> None:
    spec = gymnasium.spec(ESCORT)
    assert copy.deepcopy(spec) == pickle.loads(pickle.dumps(spec)) == spec  # noqa: S301 - our own data
    assert EnvSpec.from_json(spec.to_json()) == spec
    env = gymnasium.make(spec, duration=1.0, agent="ugv_0", dtype=np.float32)
    again = gymnasium.make(env.spec)
    assert again.unwrapped.worlds.scenario == env.unwrapped.worlds.scenario
    assert again.unwrapped.worlds.scenario.duration == 1.0
    space = again.observation_space
    assert (space.shape, space.dtype) == ((8,), np.float32)


def test_what_is_made_passes_the_checker() -> None:
    check_env(gymnasium.make(ESCORT, duration=2.0).unwrapped)


def test_time_is_limited_once() -> None:
    assert gymnasium.spec(ESCORT).max_episode_steps is None
    env = gymnasium.make(ESCORT, duration=0.5)
    env.reset(seed=1)
    ends = [env.step(np.zeros(2))[2:4] for _ in range(10)]
    assert ends == [(False, False)] * 9 + [(False, True)]


def test_a_limit_of_steps_is_gymnasiums_own() -> None:
    env = gymnasium.make(ESCORT, max_episode_steps=3)
    env.reset(seed=1)
    assert [env.step(np.zeros(2))[3] for _ in range(3)] == [False, False, True]
    many = gymnasium.make_vec(ESCORT, num_envs=2, vectorization_mode="sync", max_episode_steps=3)
    many.reset(seed=1)
    assert [many.step(np.zeros((2, 2)))[3].tolist() for _ in range(3)][-1] == [True, True]
    with refused(
        ValueError, "max_episode_steps = 3: not for many worlds at once; allowed: duration"
    ):
        gymnasium.make_vec(ESCORT, num_envs=2, max_episode_steps=3)


def test_vector_modes_make_the_same_bits() -> None:
    fast = gymnasium.make_vec(ESCORT, num_envs=3, duration=1.0)
    slow = gymnasium.make_vec(ESCORT, num_envs=3, vectorization_mode="sync", duration=1.0)
    same_kind = gymnasium.make_vec(ESCORT, num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(fast, OutriderVectorEnv)
    assert isinstance(same_kind, OutriderVectorEnv)
    assert isinstance(slow, SyncVectorEnv)
    assert fast.single_observation_space == slow.single_observation_space
    seen, same = fast.reset(seed=5)[0], slow.reset(seed=5)[0]
    for actions in np.random.default_rng(1).uniform(-0.3, 0.3, (15, 3, 2)):
        assert seen.tobytes() == same.tobytes()
        (seen, rewards, *_), (same, paid, *_) = fast.step(actions), slow.step(actions)
        assert rewards.tolist() == paid.tolist()
    fast.close()
    slow.close()
