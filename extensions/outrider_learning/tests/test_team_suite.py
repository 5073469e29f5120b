"""The suite of teams: its score follows the definition, and a saved policy flies a team in a run as in a batch."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import outrider
from bus.errors import ScenarioError
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.closed_loop.pilots import pilot_names
from outrider.envs import worlds
from outrider.envs.worlds import Worlds
from outrider.running.flying import InProcess, fly, make_pilots
from outrider_learning.mlp import Mlp, save_policy
from outrider_learning.networks import OBSERVATION, load_npz_policy
from outrider_learning.recipe import observation_recipe
from outrider_learning.suite.board import BASELINES, leaderboard
from outrider_learning.suite.evaluation import evaluate
from outrider_learning.suite.tasks import TEAMS, Task
from sim.engine.run_keys import derive_secret
from sim.engine.world_state import first_coverage
from sim.models.field import coverage_error
from sim.scenario.checks import scenario_warnings
from sim.scenario.loading import load_scenario
from sim.server.flight import Flight

SECRET = bytes(range(16)).hex()
UAVS = ["uav_0", "uav_1", "uav_2"]
SHORT = Task(name="short", hard="", base="scouts", changes={"area.cell": 0.5, "duration": 6.0})


@pytest.mark.parametrize("task", TEAMS, ids=lambda task: task.name)
def test_every_ranked_law_can_fly_each_task_of_a_team(task: Task) -> None:
    scenario = task.scenario
    assert task.team
    assert not scenario_warnings(scenario)
    assert all(set(BASELINES) <= set(pilot_names(scenario, uav.name)) for uav in scenario.uav)


def test_the_score_of_a_team_is_its_covered_share() -> None:
    """Compare with a single flight in the loop of the bus, tick by tick."""
    scenario, own = SHORT.scenario, derive_secret(SECRET, SHORT.name)
    flight = Flight(scenario, 9001, secret=own)
    flight.fly(InProcess(make_pilots(scenario, 9001, secret=own)))
    errors = flight.recorder.escorts[:, 0, 1]
    places = flight.recorder.states[:, flight.world.escorts[0, 1], :2].tolist()
    r_o, area = scenario.visibility.radius + scenario.sensor.range, scenario.area
    nothing, desired = first_coverage(scenario), scenario.coverage.desired
    most = np.array([coverage_error(nothing, x, y, r_o, desired, area.cell) for x, y in places])
    result = evaluate(SHORT, "lookahead", seeds=[9000, 9001], secret=SECRET)
    assert result.scores[1] == pytest.approx(100.0 * np.mean(1.0 - errors / most), rel=1e-9)
    board = leaderboard(["lookahead"], tasks=[SHORT], seeds=[9000, 9001], secret=SECRET)
    assert f", {result.mean_error:.1f} m² |" in board.markdown()


def test_an_episode_without_sight_scores_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    class Near(ClosedLoop):
        """End sight a little beyond the distance at the start, 1 m."""

        def begin(self, seeds: Any, worlds: Any = None) -> None:
            self.tables.batch.world["r_v"] = 1.2
            super().begin(seeds, worlds)

    assert SHORT.evaluate("circle", seeds=[9000], secret=SECRET).score > 0.0
    monkeypatch.setattr(worlds, "ClosedLoop", Near)
    result = SHORT.evaluate("circle", seeds=[9000], secret=SECRET)
    assert (result.lost, result.scores) == (1, (0.0,))
    assert result.mean_error > 0.0  # of the ticks in sight


@pytest.fixture(scope="module")
def policy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a random network on a UAV's row in a team of three, which holds an action for five ticks."""
    env = outrider.parallel_vector_env(
        SHORT.scenario, num_envs=1, estimate=True, omit=("time", "position")
    )
    recipe = observation_recipe(env, "uav_0")
    env.close()
    assert recipe.mates == 3
    entries, rng = recipe.shown_space().shape, np.random.default_rng(4)
    assert entries is not None
    network = Mlp(
        (rng.normal(0.0, 0.1, (8, *entries)), rng.normal(size=(2, 8))),
        (np.zeros(8), np.zeros(2)),
    )
    held = msgspec.structs.replace(recipe, layers=({"kind": "repeat", "ticks": 5},))
    file = tmp_path_factory.mktemp("policy") / "team.npz"
    action = {"low": [-0.3, -0.3], "high": [0.3, 0.3]}
    save_policy(file, network, {OBSERVATION: msgspec.to_builtins(held), "action": action})
    return file


def test_a_saved_policy_flies_a_team_in_a_run_as_in_a_batch(policy_file: Path) -> None:
    given = SHORT.changes | {"law.name": "policy", "custom.uav_policy": f"npz:{policy_file}"}
    scenario = load_scenario("scouts", overrides=given)
    flown = fly(scenario, 11)[0].world.position
    policy = load_npz_policy(str(policy_file), "policy")
    batch = Worlds(SHORT.scenario, 2, UAVS, **policy.setup)
    batch.reset([11, 12], None)
    policies = {uav: load_npz_policy(str(policy_file), "policy") for uav in UAVS}
    for _ in range(scenario.ticks):
        batch.step({uav: policies[uav](batch.observe(uav)) for uav in UAVS})
    found = batch.loop.state.batch.vehicles["position"]
    np.testing.assert_array_equal(found[0], flown)
    assert np.abs(found[0] - found[1]).max() > 0.0
    assert 0.0 < SHORT.evaluate(policy, seeds=[9000], secret=SECRET).score < 100.0


def test_a_policy_of_a_team_is_refused_without_one(policy_file: Path) -> None:
    with pytest.raises(ScenarioError, match="the policy was trained with a team of 3 UAVs"):
        fly(load_scenario("escort", overrides={"custom.uav_policy": f"npz:{policy_file}"}), 1)
