"""Teams in batches and environments: the bits of a run, the guarantee under hostile actions, rows and rewards."""

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import outrider
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from bus.errors import ScenarioError
from bus.observations import MATE, TEAM, UAV, by_name, names, team_table
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.env_pilots import pilots
from outrider.envs.worlds import Worlds
from outrider.running.flying import InProcess, fly
from outrider.running.summary import summarize
from sim.engine.briefing import uav_briefing, ugv_briefing
from sim.env.observation import uav_table
from sim.env.rewards import RewardWeights
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight

with warnings.catch_warnings():  # PettingZoo's package of tests imports deprecated games
    warnings.simplefilter("ignore")
    from pettingzoo.test import parallel_api_test

COARSE = {"area.cell": 0.5}
BAD = {"links.team.profile": "jammed", "certificate.max_measurement_age": 6.0}
OWN = {"law.name": "policy", "custom.uav_policy": "given:later"}
MISTAKES = (
    "team_certified_while_lost",
    "team_certificate_broken",
    "certified_while_lost",
    "separation_violations",
)
SHORT = {
    f"uav.{k}.{field}": value
    for k in range(3)
    for field, value in {"endurance": 226.0, "charge_time": 100.0}.items()
}
"""Charges that run low within a short flight."""
UAVS = ["uav_0", "uav_1", "uav_2"]
ROW = names(uav_table(altitude=False, gradient=False, mates=3))

recorded: list[np.ndarray] = []


class Steering:
    """Policy by all entries of the row, in a run and in an environment: a small difference in any shows in the path."""

    def __init__(self, duration: float) -> None:
        self.setup = {"duration": duration}

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        recorded.append(rows.copy())
        seen = dict(zip(ROW, rows.T, strict=True))
        away = seen["measured_x"] + 0.7 * seen["mate_x_0"] - 0.4 * seen["mate_y_1"]
        turn = np.sin(0.9 * seen["time"] + 3.0 * seen["mate_age_0"] + seen["charge"])
        aside = seen["measured_y"] + seen["is_guard"] - seen["mate_is_scout_1"]
        return np.stack((0.3 * turn + 0.02 * away, 0.2 * np.cos(away) - 0.03 * aside), axis=1)


def team(name: str = "scouts", **changes: Any) -> Scenario:
    given = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario(name, overrides=COARSE | given)


@pytest.mark.parametrize(
    ("name", "changes"),
    [("scouts", {"duration": 60.0}), ("relay", {"duration": 200.0, **SHORT})],
)
def test_an_environment_flies_the_same_bits_as_a_run(name: str, changes: dict[str, Any]) -> None:
    scenario = load_scenario(name, overrides=COARSE | changes | OWN)
    policy, flight = Steering(scenario.duration), Flight(scenario, 11)
    recorded.clear()
    flown: dict[str, Any] = {
        uav: UavPilot(uav_briefing(scenario, uav, 11), policy=policy) for uav in UAVS
    }
    flown["ugv_0"] = UgvPilot(ugv_briefing(scenario, "ugv_0", 11))
    flight.fly(InProcess(flown))
    summary = summarize(flight, seconds=1.0)
    rows = np.array(recorded)[:, 0]
    worlds = Worlds(scenario, 1, UAVS, end_on_sight_lost=False)
    worlds.reset(11, None)
    found = []
    for _ in range(scenario.ticks):
        seen = {uav: worlds.observe(uav) for uav in UAVS}
        found += [seen[uav][0] for uav in UAVS]
        worlds.step({uav: policy(seen[uav]) for uav in UAVS})
    np.testing.assert_array_equal(rows, np.array(found))
    state = worlds.loop.state.batch.vehicles["position"][0]
    np.testing.assert_array_equal(state, flight.world.position)
    metrics, status = worlds.loop.metrics("uav_0"), summary.team
    assert status is not None
    for key in ("team_certified_share", "handovers", "extra_guard_share", *MISTAKES[:2]):
        assert metrics[key][0] == getattr(status, key), key
    teams = worlds.loop.pilots.state.teams
    assert dict(zip(UAVS, teams.numbers[0].tolist(), strict=True)) == status.numbers
    if name == "relay":
        assert status.handovers > 0
        assert dict(zip(UAVS, teams.charges[0].tolist(), strict=True)) == status.charges
    links = worlds.links(0)
    sent = {key: one.delivered for key, one in summary.links.items() if key.endswith("/team")}
    assert {key: links[key].delivered for key in sent} == sent


@pytest.mark.parametrize("name", ["scouts", "relay"])
def test_laws_in_a_batch_agree_with_a_run(name: str) -> None:
    scenario = team(name, duration=15.0)
    loop = ClosedLoop(scenario, 2)
    loop.begin([5, 6])
    loop.fly()
    for k, seed in enumerate((5, 6)):
        found = fly(scenario, seed)[0].world.position
        np.testing.assert_allclose(
            loop.state.batch.vehicles["position"][k], found, rtol=0.0, atol=1e-6
        )


@pytest.mark.parametrize(
    ("name", "changes"), [("scouts", BAD), ("scouts", {"team.guards": 2}), ("relay", SHORT | BAD)]
)
def test_hostile_actions_and_requests_break_no_guarantee(
    name: str, changes: dict[str, Any]
) -> None:
    """Actions that flee from the UGV, or change at random, and requests without sense."""
    scenario = load_scenario(name, overrides=COARSE | changes | {"duration": 120.0})
    worlds = Worlds(scenario, 24, UAVS, roles="action", end_on_sight_lost=False)
    worlds.reset(100, None)
    rng, roles = np.random.default_rng(3), set[str]()
    for tick in range(scenario.ticks):
        actions = {}
        for uav in UAVS:
            seen = by_name(UAV + team_table(3), worlds.observe(uav))
            flees = np.stack((seen["measured_x"], seen["measured_y"]), axis=1)
            if tick % 40 == 0:
                asked = rng.choice([-1.0, 0.0, 0.0, 0.0, 1.0], size=(24, 1))
                held = rng.normal(size=(24, 2))
                actions[uav] = np.concatenate((held, asked), axis=1)
            else:
                actions[uav] = np.concatenate((flees, np.zeros((24, 1))), axis=1)
            roles |= {key for key in names(TEAM)[:4] if seen[key].any()}
        worlds.step(actions)
    for uav in UAVS:
        found = worlds.loop.metrics(uav)
        for key in MISTAKES:
            assert not found[key].any(), key
        assert not found["certificate_broken"].any()
    assert found["handovers"].sum() > 10
    assert found["team_certified_share"].min() > 0.5
    assert {"is_scout", "is_relief", "is_guard"} <= roles


def test_an_episode_ends_when_no_uav_sees_the_ugv() -> None:
    scenario = team(duration=40.0, law__name="lookahead")
    worlds = Worlds(scenario, 4, [])
    worlds.reset(1, None)
    for _ in range(scenario.ticks):
        worlds.step({})
    terminated, truncated = worlds.ends()
    assert truncated.all()
    assert not terminated.any()
    standings = worlds.loop.state.rows.standings
    scouted = standings["violations"][:, :3]
    assert (scouted > 0).any(axis=1).all()  # a scout was out of sight
    assert not standings["terms"][:, :3, 3].any()  # which costs nothing


def test_a_shared_reward_is_the_mean_of_the_team() -> None:
    scenario = team(duration=10.0)
    both = []
    for shared in (False, True):
        own = RewardWeights(effort=1.0, team=shared)
        env = outrider.parallel_env(scenario, rewards=own)
        env.reset(seed=4)
        rng, paid = np.random.default_rng(8), []
        for _ in range(30):
            actions = {name: rng.uniform(-0.2, 0.2, 2) for name in env.agents}
            paid.append(env.step(actions)[1])
        both.append(np.array([[one[uav] for uav in UAVS] for one in paid]))
        env.close()
    assert np.ptp(both[0][1:], axis=1).min() > 0.0
    np.testing.assert_allclose(both[1], np.repeat(both[0].mean(axis=1)[:, None], 3, axis=1))


def test_rows_are_described_and_lie_in_their_space() -> None:
    env = outrider.parallel_env(team(duration=5.0), roles="action")
    parallel_api_test(env, num_cycles=30)
    space = env.action_space("uav_0")
    assert isinstance(space, spaces.Box)
    assert space.shape == (3,)
    assert env.action_space("ugv_0").shape == (2,)
    assert env.observation_space("uav_0").shape == (len(UAV) + len(TEAM) + 2 * len(MATE),)
    assert ROW[-1] == "mate_age_1"
    assert {"uav_0.is_guard", "uav_0.charge"} <= set(env.state_names)
    _, infos = env.reset(seed=1)
    known = {"overridden", "certified", "uncertified", "certified_distance"}
    assert all(set(infos[uav]) == known for uav in UAVS)
    env.close()


def test_a_batch_begins_every_episode_anew() -> None:
    envs = outrider.parallel_vector_env(team(duration=6.0), num_envs=3, agents=UAVS)
    rng = np.random.default_rng(2)
    actions = [{uav: rng.normal(size=(3, 2)) for uav in UAVS} for _ in range(60)]

    def flown() -> np.ndarray:
        envs.reset(seed=9)
        return np.array([envs.step(one)[0]["uav_1"] for one in actions])

    np.testing.assert_array_equal(flown(), flown())
    envs.close()


def test_pilots_of_an_environment_refuse_a_team() -> None:
    env = outrider.parallel_env(team(duration=5.0))
    with pytest.raises(ScenarioError, match="the rules of the team act on the actions"):
        pilots(env)
    env.close()


@pytest.mark.parametrize("given", ["Rules", None, True])
def test_a_wrong_setting_of_roles_is_refused(given: Any) -> None:
    with pytest.raises(ValueError, match="allowed: 'rules', 'action'"):
        outrider.parallel_env(team(duration=5.0), roles=given)
