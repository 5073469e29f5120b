"""The vector environments.

Many copies of the parallel environment, to the bit, with Gymnasium's autoreset modes.
"""

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
from bus.ticks import looks_of
from outrider.envs.env_pilots import pilots
from properties import PROPERTY
from refusals import refused
from sim.env.observation import one_of_world
from sim.scenario.types import Scenario
from worlds import CASES, LATE_DETECTIONS, SCENARIO, SCENARIOS, SEVERAL, equal, random_actions


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
            last[k], paid, terms, truncs, single_infos = env.step(commands)
            assert (paid[agent], terms[agent], truncs[agent]) == (
                rewards[k],
                terminated[k],
                truncated[k],
            )
            if terms[agent] or truncs[agent]:
                ends += 1
                assert infos["_final_obs"][k]
                assert equal(last[k][agent], infos["final_obs"][k])
                assert infos["final_info"]["episode"]["l"][k] == env.world.tick
                for key, value in single_infos[agent].items():
                    if key != "links":
                        assert infos["final_info"][key][k] == value
                last[k] = env.reset()[0]
            assert env.episode_seed == many.worlds.episode_seeds[k]
    assert ends >= 3 or agent == "ugv_0"


def test_every_vehicle_may_learn() -> None:
    singles = [outrider.parallel_env(SEVERAL) for _ in range(2)]
    many = outrider.parallel_vector_env(SEVERAL, num_envs=2)
    assert many.possible_agents == singles[0].possible_agents
    seen, _ = many.reset(seed=[8, 5])
    last = [env.reset(seed=seed)[0] for env, seed in zip(singles, [8, 5], strict=True)]
    rng = np.random.default_rng(3)
    for _ in range(320):
        actions = {name: rng.uniform(-0.1, 0.1, (2, 2)) for name in many.possible_agents}
        seen, rewards, terminated, truncated, infos = many.step(actions)
        for k, env in enumerate(singles):
            last[k], paid, terms, truncs, _ = env.step(
                {name: action[k] for name, action in actions.items()}
            )
            for name in many.possible_agents:
                assert (paid[name], terms[name], truncs[name]) == (
                    rewards[name][k],
                    terminated[name][k],
                    truncated[name][k],
                )
                if not env.agents:
                    assert equal(last[k][name], infos[name]["final_obs"][k])
                else:
                    assert equal(last[k][name], seen[name][k])
            if not env.agents:
                last[k] = env.reset()[0]
                assert all(equal(last[k][name], seen[name][k]) for name in many.possible_agents)


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
    acted = 0
    outward = np.array([0.3, 0.1])
    for tick in range(360):
        assert equal(seen[0], last["uav_0"])
        world = single.world
        place = world.reference_position[0].tolist()
        received = UavObservation(
            tick=tick,
            time=world.time,
            position=place,
            velocity=world.reference_velocity[0].tolist(),
            detections=world.received(0),
        )
        keeper.see(received)
        decision = keeper.filter(received, tuple(outward))
        detections = looks_of(received.detections, briefed.dt)
        estimate = estimator.update(tick=tick, own_position=tuple(place), detections=detections)
        if estimate is not None:
            relative = np.subtract(place, estimate.position)
            row = [1.0, *relative, estimate.age]
            assert np.allclose(seen[0][5:], row, rtol=1e-9, atol=1e-9)
        seen, _, terminated, _, infos = many.step(outward[None])
        last, _, _, _, info = single.step({"uav_0": outward, "ugv_0": driver(last["ugv_0"])})
        assert not terminated[0]
        info = info["uav_0"]
        for key in ("overridden", "certified", "certified_distance"):
            assert info[key] == infos[key][0]
        assert info["overridden"] is decision.overridden
        assert info["certified"] is decision.certified
        assert info["uncertified"] == (decision.reason or "")
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


def test_the_gradient_points_to_new_ground() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=2, agent="uav_0", gradient=True)
    seen, _ = env.reset(seed=1)
    assert seen.shape == (2, 11)
    for actions in random_actions(2, 40):
        seen, *_ = env.step(actions)
    assert (np.linalg.norm(seen[:, 9:], axis=1) > 0.01).all()
    assert env.observation_space.contains(seen)


def test_it_is_a_gymnasium_vector_environment() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=4, agent="uav_0", duration=1.0)
    assert isinstance(env, VectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.observation_space.shape == (4, 9)
    recorded = RecordEpisodeStatistics(env)
    seen, _ = recorded.reset(seed=3)
    assert recorded.observation_space.contains(seen)
    for actions in random_actions(4, 25, size=0.01):
        seen, rewards, terminated, truncated, infos = recorded.step(actions)
        assert rewards.dtype == np.float64
        assert terminated.dtype == truncated.dtype == np.bool_
        assert recorded.observation_space.contains(seen)
        if truncated.any():
            assert infos["episode"]["l"].tolist() == [20] * 4
    recorded.close()


def test_a_part_of_the_worlds_can_be_reset() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=3, agent="uav_0")
    first, _ = env.reset(seed=7)
    for actions in random_actions(3, 10):
        later, *_ = env.step(actions)
    again, _ = env.reset(seed=7, options={"reset_mask": np.array([True, False, True])})
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
    name=st.sampled_from(["certified", "evade", "network", "raw detections", "several"]),
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
def test_the_spaces_contain_whatever_is_returned(name, agent, options, action_list):
    env = outrider.vector_env(
        SCENARIOS[name], num_envs=2, agent=agent, duration=4.0, threads=1, **options
    )
    seen, _ = env.reset(seed=len(action_list))
    assert env.observation_space.contains(seen)
    for tick in range(100):
        seen, rewards, *_, infos = env.step(
            np.array([action_list[tick // 10 % len(action_list)]] * 2)
        )
        assert env.observation_space.contains(seen)
        assert np.isfinite(rewards).all()
        for k in np.flatnonzero(infos.get("_final_obs", [])):
            assert env.single_observation_space.contains(infos["final_obs"][k])


def test_all_worlds_must_be_reset_before_a_part_of_them() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=2)
    with pytest.raises(ResetNeeded):
        env.reset(options={"reset_mask": np.array([True, False])})


@pytest.mark.parametrize("kind", ["vector", "parallel"])
def test_next_step_mode_restarts_in_the_next_step(kind: str) -> None:
    """The same episodes as in the mode SAME_STEP, with one more step at each end, whose action is ignored."""
    make = outrider.vector_env if kind == "vector" else outrider.parallel_vector_env
    agents = {} if kind == "vector" else {"agents": ["uav_0"]}
    same, late = (
        make(SCENARIO, num_envs=3, duration=2.0, autoreset_mode=mode, **agents)
        for mode in (AutoresetMode.SAME_STEP, "NextStep")
    )
    assert late.metadata["autoreset_mode"] is late.autoreset_mode is AutoresetMode.NEXT_STEP

    def flown(env, actions):
        step = env.step(actions if kind == "vector" else {"uav_0": actions})
        return step if kind == "vector" else tuple(part["uav_0"] for part in step)

    same.reset(seed=4)
    late.reset(seed=4)
    episodes: dict[str, list[list[bytes]]] = {"same": [[], [], []], "late": [[], [], []]}
    over, ends = np.zeros(3, dtype=bool), 0
    for actions in random_actions(3, 100):
        seen, rewards, *ended, infos = flown(late, actions * np.array([[9.0], [1.0], [0.1]]))
        for k in range(3):
            if over[k]:
                assert (rewards[k], ended[0][k], ended[1][k]) == (0.0, False, False)
        over = ended[0] | ended[1]
        ends += over.sum()
        assert "final_obs" not in infos
        ticks = late.metrics()["uav_0"]["ticks"]
        for k in range(3):
            episodes["late"][k].append(seen[k].tobytes())
            assert over[k] == (ticks[k] == 40.0 or ended[0][k])
    assert ends >= 6
    applied = np.zeros((3, 2))
    turn, last = [0, 0, 0], [False] * 3
    actions_of = random_actions(3, 100) * np.array([[9.0], [1.0], [0.1]])
    for _ in range(90):
        for k in range(3):
            if last[k]:  # the step that has started the episode
                turn[k] += 1
            applied[k] = actions_of[min(turn[k], 99), k]
            turn[k] += 1
        seen, _, terminated, truncated, infos = flown(same, applied)
        last = (terminated | truncated).tolist()
        for k in range(3):
            shown = infos["final_obs"][k] if last[k] else seen[k]
            episodes["same"][k].append(shown.tobytes())
            if last[k]:
                episodes["same"][k].append(seen[k].tobytes())
    for k in range(3):
        assert episodes["same"][k][:100] == episodes["late"][k][: len(episodes["same"][k])][:100]


def test_gymnasiums_own_wrappers_take_the_mode_next_step() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=2, duration=1.0, autoreset_mode="NextStep")
    layered = NormalizeObservation(RescaleAction(RecordEpisodeStatistics(env), -1.0, 1.0))
    layered.reset(seed=1)
    lengths = []
    for actions in random_actions(2, 50, size=0.1):
        *_, infos = layered.step(actions)
        lengths += [infos["episode"]["l"][infos["_episode"]].tolist()] if "episode" in infos else []
    assert lengths == [[20, 20], [20, 20]]
    layered.close()


def test_a_mode_of_another_name_is_refused() -> None:
    for mode in ("Disabled", AutoresetMode.DISABLED, "sometimes", 3):
        with refused(ValueError, "autoreset_mode = .*allowed: 'SameStep', 'NextStep'"):
            outrider.vector_env(SCENARIO, num_envs=1, autoreset_mode=mode)


def test_final_info_of_an_episode_is_available() -> None:
    """Use a safety filter with radii half a metre too large, and a fleeing UGV: each end is certified out of sight."""
    env = outrider.parallel_vector_env(
        "escort", num_envs=4, duration=60.0, safety_filter=True, autoreset_mode="NextStep"
    )
    with pytest.raises(ResetNeeded, match="metrics"):
        env.metrics()
    for field in ("radius", "handover_radius", "handover_bound"):
        env.worlds.loop.tables.safety[field] += 0.5
    env.reset(seed=1)
    position = env.worlds.loop.batch.state.vehicles["position"]
    lengths, lost, over = np.zeros(4), 0, np.zeros(4, dtype=bool)
    for _ in range(400):
        apart = position[:, 0] - position[:, 1]
        apart /= np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
        _, _, terminated, _, _ = env.step({"uav_0": 10.0 * apart, "ugv_0": -10.0 * apart})
        lengths = np.where(over, 0.0, lengths + 1)
        over = terminated["uav_0"]
        metrics = env.metrics()["uav_0"]
        assert (metrics["ticks"] == lengths).all()
        assert (metrics["max_distance"][over] >= 4.75).all()
        assert (metrics["certified_while_lost"][over] == 1.0).all()
        lost += over.sum()
    assert lost >= 8


def test_other_libraries_find_the_mode_and_random_numbers() -> None:
    env = outrider.vector_env(SCENARIO, num_envs=2)
    for one in (env, outrider.parallel_vector_env(num_envs=1)):
        assert one.autoreset_mode is AutoresetMode.SAME_STEP
    for one in (env, outrider.parallel_env(SCENARIO), outrider.single_env(SCENARIO)):
        draws = []
        for seed in (3, 3, 4):
            one.reset(seed=seed)
            draws.append(one.np_random.random())
        assert draws[0] == draws[1] != draws[2]
