"""The vector environments.

Many copies of the parallel environment, to the bit, with Gymnasium's autoreset modes.
"""

from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics, RescaleAction
from hypothesis import given, settings
from hypothesis import strategies as st

import outrider
from agents.estimation.estimator import estimator_of
from agents.safety.safety_filter import SafetyFilter
from bus.messages.vehicle import UavObservation
from bus.ticks import detection_rows
from outrider.envs.env_pilots import pilots
from properties import PROPERTY
from sim.compiling.records import code
from sim.env.observation import one_of_world
from sim.scenario.types import Scenario
from tabular import words
from worlds import CASES, FAST, LATE_DETECTIONS, SCENARIO, SCENARIOS, SEVERAL, equal, random_actions

OWN: dict[str, dict[str, Any]] = {
    "uav_1": {"estimate": True},
    "uav_0": {"gradient": True, "dtype": np.float32},
    "uav_2": {"coverage_patch": (4, 1.0)},
}


def test_observation_settings_may_differ_by_agent() -> None:
    by_agent: dict[str, Any] = {}
    for uav, own in OWN.items():
        for key, value in own.items():
            by_agent.setdefault(key, {})[uav] = value
    many = outrider.parallel_vector_env(SEVERAL, num_envs=2, **by_agent)
    one = outrider.parallel_env(SEVERAL, **by_agent)
    plain = {uav: outrider.parallel_vector_env(SEVERAL, num_envs=2, **OWN[uav]) for uav in OWN}
    for env in (many, one, *plain.values()):
        env.reset(seed=3)
    for uav, env in plain.items():
        assert many.observation_space(uav) == env.observation_space(uav)
        assert one.observation_space(uav) == env.observation_space(uav)
    rng = np.random.default_rng(1)
    for _ in range(40):
        actions = {name: rng.uniform(-0.2, 0.2, (2, 2)) for name in many.agents}
        seen = many.step(actions)[0]
        first = one.step({name: given[0] for name, given in actions.items()})[0]
        for uav, env in plain.items():
            same = env.step(actions)[0]
            assert equal(seen[uav], same[uav])
            assert equal(first[uav], one_of_world(same[uav], 0))


def test_settings_of_an_unknown_agent_are_refused() -> None:
    with pytest.raises(ValueError, match="estimate: 'uav_9': no such vehicle; allowed: uav_0"):
        outrider.parallel_env(SEVERAL, estimate={"uav_9": True})
    with pytest.raises(ValueError, match=r"coverage_patch: .*allowed: the same for all vehicles"):
        outrider.parallel_env(SEVERAL, coverage_patch={"uav_0": (4, 1.0), "uav_1": (5, 1.0)})
    with pytest.raises(TypeError, match="estimate = 1; allowed: True, False"):
        outrider.parallel_env(SEVERAL, estimate={"uav_0": 1})


@pytest.mark.parametrize("name", CASES)
def test_each_world_is_the_parallel_environment_also_over_ends(name: str) -> None:
    scenario, agent, options = CASES[name]
    seeds = [21, 22, 23]
    singles = [outrider.parallel_env(scenario, **options) for _ in seeds]
    policies = [pilots(env) for env in singles]
    many = outrider.vector_env(scenario, num_envs=3, agent=agent, **options)
    seen, _ = many.reset(seed=21)
    last = [env.reset(seed=seed)[0] for env, seed in zip(singles, seeds, strict=True)]
    ends = 0
    for actions in random_actions(3, 420):
        assert all(equal(last[k][agent], one_of_world(seen, k)) for k in range(3))
        seen, rewards, terminated, truncated, infos = many.step(actions)
        for k, env in enumerate(singles):
            commands = {one: policy(last[k][one]) for one, policy in policies[k].items()} | {
                agent: actions[k]
            }
            last[k], *results, single_infos = env.step(commands)
            results = [result[agent] for result in results]
            assert results == [rewards[k], terminated[k], truncated[k]]
            if not env.agents:
                ends += 1
                assert infos["_final_obs"][k]
                assert equal(last[k][agent], infos["final_obs"][k])
                assert infos["final_info"]["episode"]["l"][k] == env.world.tick
                for key, value in single_infos[agent].items():
                    assert infos["final_info"][key][k] == value
                last[k] = env.reset()[0]
            assert env.episode_seed == many.worlds.episode_seeds[k]
    assert ends >= 3 or agent == "ugv_0"


def test_every_vehicle_may_learn() -> None:
    singles = [outrider.parallel_env(SEVERAL) for _ in range(2)]
    many = outrider.parallel_vector_env(SEVERAL, num_envs=2)
    assert many.possible_agents == singles[0].possible_agents
    many.reset(seed=[8, 5])
    for env, seed in zip(singles, [8, 5], strict=True):
        env.reset(seed=seed)
    rng = np.random.default_rng(3)
    for _ in range(320):
        actions = {name: rng.uniform(-0.1, 0.1, (2, 2)) for name in many.possible_agents}
        seen, *results, infos = many.step(actions)
        for k, env in enumerate(singles):
            last, *expected, _ = env.step({name: action[k] for name, action in actions.items()})
            first = last if env.agents else env.reset()[0]
            for name in many.possible_agents:
                assert [one[name] for one in expected] == [one[name][k] for one in results]
                assert equal(first[name], seen[name][k])
                if first is not last:
                    assert equal(last[name], infos[name]["final_obs"][k])
            np.testing.assert_array_equal(many.state()[k], env.state())


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_states_of_many_worlds_are_those_of_single_ones(weight: float) -> None:
    """Compare also where the batch does not compute e(t) for its rewards."""
    options: dict[str, Any] = {"duration": 2.0, "autoreset_mode": "NextStep"}
    rewards = outrider.RewardWeights(uncovered=weight)
    many = outrider.parallel_vector_env("town", num_envs=2, rewards=rewards, **options)
    with pytest.raises(ResetNeeded, match=r"state\(\) before reset"):
        many.state()
    singles = [outrider.parallel_env("town", duration=2.0) for _ in range(2)]
    many.reset(seed=4)
    for k, env in enumerate(singles):
        env.reset(seed=4 + k)
        assert (env.state_names, env.state_space) == (many.state_names, many.state_space)
    for _ in range(40):
        many.step({"uav_0": np.full((2, 3), 0.1), "ugv_0": np.full((2, 2), 0.02)})
        states = many.state()
        for k, env in enumerate(singles):
            env.step({"uav_0": [0.1, 0.1, 0.1], "ugv_0": [0.02, 0.02]})
            np.testing.assert_array_equal(states[k], env.state())
            assert many.state_space.contains(states[k])


@pytest.mark.parametrize("scenario", [SCENARIO, LATE_DETECTIONS], ids=["in time", "late"])
def test_the_filters_are_those_of_the_pilots(scenario: Scenario) -> None:
    """Compare with the estimator and the safety filter of `agents` beside the same world."""
    single = outrider.parallel_env(scenario, estimate=True, safety_filter=True)
    many = outrider.vector_env(
        scenario, num_envs=1, agent="uav_0", estimate=True, safety_filter=True
    )
    driver, briefed = pilots(single)["ugv_0"], single.briefing("uav_0")
    estimator, keeper = estimator_of(briefed), SafetyFilter(briefed)
    seen, _ = many.reset(seed=4)
    last, _ = single.reset(seed=4)
    acted, outward = 0, np.array([0.3, 0.1])
    for tick in range(360):
        assert equal(seen[0], last["uav_0"])
        world = single.world
        position, velocity = (
            tuple(one[0].tolist()) for one in (world.reference_position, world.reference_velocity)
        )
        own = {"position": position, "velocity": velocity, "detections": world.received(0)}
        received = UavObservation(tick=tick, time=world.time, **own)
        keeper.see(received)
        decision = keeper.filter(received, tuple(outward))
        detections = detection_rows(received.detections, briefed.dt)
        estimate = estimator.update(tick=tick, own_position=position, detections=detections)
        if estimate is not None:
            row = [1.0, *np.subtract(position, estimate.position), estimate.age]
            assert np.allclose(seen[0][5:], row, rtol=1e-9, atol=1e-9)
        seen, _, terminated, _, infos = many.step(outward[None])
        last, _, _, _, info = single.step({"uav_0": outward, "ugv_0": driver(last["ugv_0"])})
        assert not terminated[0]
        info = info["uav_0"]
        assert info == {key: infos[key][0] for key in info}
        assert info["overridden"] is decision.overridden
        assert info["certified"] is decision.certified
        assert info["uncertified"] == (code(decision.reason) if decision.reason else 0)
        acted += decision.overridden
    assert acted > 0


def test_single_precision_is_the_double_rounded() -> None:
    one, other = (
        outrider.vector_env(SCENARIO, num_envs=2, coverage_patch=(4, 1.0), dtype=dtype)
        for dtype in (np.float32, np.float64)
    )
    pairs = [(one.reset(seed=1)[0], other.reset(seed=1)[0])]
    for actions in random_actions(2, 20):
        pairs.append((one.step(actions)[0], other.step(actions)[0]))
    for short, exact in pairs:
        assert one.observation_space.contains(short)
        assert all(equal(short[key], exact[key].astype(np.float32)) for key in exact)


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_it_is_a_vector_environment_for_gymnasiums_wrappers(mode: str) -> None:
    env = outrider.vector_env(SCENARIO, num_envs=4, duration=1.0, autoreset_mode=mode)
    assert isinstance(env, VectorEnv)
    assert env.metadata["autoreset_mode"] is env.autoreset_mode is AutoresetMode(mode)
    layered, lengths = RescaleAction(RecordEpisodeStatistics(env), -1.0, 1.0), []
    if mode == "NextStep":  # the only mode of this wrapper
        layered = NormalizeObservation(layered)
    layered.reset(seed=3)
    for actions in random_actions(4, 50, size=0.1):
        _, rewards, terminated, truncated, infos = layered.step(actions)
        assert rewards.dtype == np.float64
        assert terminated.dtype == truncated.dtype == np.bool_
        lengths += [infos["episode"]["l"][infos["_episode"]].tolist()] if "episode" in infos else []
    assert lengths == [[20] * 4] * 2
    layered.close()


def test_a_part_of_the_worlds_can_be_reset() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=3, agent="uav_0")
    part = {"reset_mask": np.array([True, False, True])}
    with pytest.raises(ResetNeeded):
        env.reset(options=part)
    first, _ = env.reset(seed=7)
    for actions in random_actions(3, 10):
        later, *_ = env.step(actions)
    again, _ = env.reset(seed=7, options=part)
    assert equal(again[[0, 2]], first[[0, 2]])
    assert equal(again[1], later[1])


def test_others_may_be_policies_for_all_worlds_at_once() -> None:
    rows: list[np.ndarray] = []

    def south(seen: np.ndarray) -> np.ndarray:
        rows.append(seen)
        return np.tile([0.0, -0.05], (len(seen), 1))

    env = outrider.vector_env(SCENARIO, num_envs=2, agent="uav_0", others={"ugv_0": south})
    env.reset(seed=1)
    for actions in random_actions(2, 20, size=0.0):
        env.step(actions)
    assert rows[0].shape == (2, 8)
    assert (rows[-1][:, 4] < -0.03).all()
    assert rows[-1].dtype == np.float64


EXTREMES = st.sampled_from([0.0, 1e-300, -1e-9, 0.3, -0.3, 1e6, -1e6])


@settings(PROPERTY, max_examples=20)
@given(
    scenario=st.sampled_from(
        [FAST, *(SCENARIOS[name] for name in words("certified network several"))]
    ),
    agent=st.sampled_from(["uav_0", "ugv_0"]),
    options=st.fixed_dictionaries(
        {
            "estimate": st.booleans(),
            "gradient": st.booleans(),
            "safety_filter": st.booleans(),
            "dtype": st.sampled_from([np.float32, np.float64]),
            "coverage_patch": st.sampled_from([None, (3, 2.0)]),
        }
    ),
    action_list=st.lists(st.tuples(EXTREMES, EXTREMES), min_size=1, max_size=8),
)
def test_the_spaces_contain_whatever_is_returned(scenario, agent, options, action_list):
    env = outrider.vector_env(scenario, num_envs=2, agent=agent, duration=4.0, threads=1, **options)
    seen, _ = env.reset(seed=len(action_list))
    assert env.observation_space.contains(seen)
    for tick in range(100):
        action = action_list[tick // 10 % len(action_list)]
        seen, rewards, *_, infos = env.step(np.array([action, action]))
        assert env.observation_space.contains(seen)
        assert np.isfinite(rewards).all()
        for k in np.flatnonzero(infos.get("_final_obs", [])):
            assert env.single_observation_space.contains(infos["final_obs"][k])


def test_next_step_mode_restarts_in_the_next_step() -> None:
    """The same episodes as in the mode SAME_STEP, with one more step at each end, whose action is ignored."""
    same, late = (
        outrider.parallel_vector_env(
            SCENARIO, num_envs=3, duration=9.0, agents=["uav_0"], autoreset_mode=mode
        )
        for mode in ("SameStep", AutoresetMode.NEXT_STEP)
    )
    with pytest.raises(ResetNeeded, match="metrics"):
        late.metrics()
    actions = {"uav_0": np.array([[-0.3, 0.0], [0.0, 0.1], [0.0, 0.0]])}
    flights: dict[str, list[list[Any]]] = {"same": [[], [], []], "late": [[], [], []]}
    for env, name in ((same, "same"), (late, "late")):
        env.reset(seed=4)
        lengths, over = np.zeros(3), np.zeros(3, dtype=bool)
        for _ in range(400):
            seen, *results, infos = env.step(actions)
            for k, flight in enumerate(flights[name]):
                row = seen["uav_0"][k]
                step = [result["uav_0"][k] for result in results]
                if name == "same" and any(step[1:]):
                    flight.append((infos["uav_0"]["final_obs"][k].tobytes(), *step))
                    step = [0.0, False, False]
                flight.append((row.tobytes(), *step))
            if name == "late":
                lengths = np.where(over, 0.0, lengths + 1.0)
                over = results[1]["uav_0"] | results[2]["uav_0"]
                assert "final_obs" not in infos["uav_0"]
                assert (env.metrics()["uav_0"]["ticks"] == lengths).all()
    for ours, theirs in zip(flights["same"], flights["late"], strict=True):
        assert ours[:400] == theirs
        assert sum(any(step[2:]) for step in theirs) >= 2
    assert any(step[2] for step in flights["late"][0])
    assert any(step[3] for step in flights["late"][2])


def test_other_libraries_find_mode_and_random_numbers() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=2)
    assert env.autoreset_mode is AutoresetMode.SAME_STEP
    for one in (env, outrider.parallel_env(SCENARIO), outrider.single_env(SCENARIO)):
        draws = []
        for seed in (3, 3, 4):
            one.reset(seed=seed)
            draws.append(one.np_random.random())
        assert draws[0] == draws[1] != draws[2]
