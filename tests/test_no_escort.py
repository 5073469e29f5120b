"""UGVs without a UAV: the baseline for the value of the escort."""

import functools
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra [record] is not installed")

import outrider
from bus.errors import ScenarioError
from flights import record, sha256
from observed import recorded
from outrider.cli.summary_table import print_summary
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.env_pilots import pilots
from outrider.experiments.sweep.columns import row_of
from outrider.experiments.sweep.definition import Block, Sweep
from outrider.experiments.sweep.plan import lay_out
from outrider.experiments.sweep.running import cost_of
from outrider.recording.reader import flight_of, statuses
from outrider.recording.refly import refly
from outrider.running.flying import fly
from outrider.running.resolve import resolve
from outrider.running.summary import Summary, summarize
from outrider.view.film import Film
from outrider.view.flight_picture import flight_figure
from outrider.view.terminal.teleoperation import DriveView
from outrider.view.terminal.topview import Trails, draw
from sim.scenario.checks import check_scenario
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable, Scenario, Wind
from sim.scene.known import geometry_of
from sim.server.flight import Flight
from tabular import words


@functools.cache
def alone() -> Scenario:
    """Return the minefield without a UAV; loading it compiles, which must not happen during collection."""
    return load_scenario("minefield", overrides=["uav=[]", "duration=15.0"])


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Flight, Summary]:
    path = tmp_path_factory.mktemp("alone") / "run.mcap"
    flight = recorded(path, alone(), 4)
    return path, flight, summarize(flight, seconds=1.0)


def test_ugv_alone_flies_alike_in_run_replay_and_env(flown) -> None:
    path, flight, summary = flown
    env = outrider.parallel_env(alone())
    observations, _ = env.reset(seed=4)
    assert sha256(record(env, pilots(env), observations)) == summary.trajectory_sha256
    assert flight.world.position[0].tolist() != list(alone().ugv[0].position)
    assert refly(flight_of(path)).trajectory_sha256 == summary.trajectory_sha256


def test_ugv_alone_drives_like_one_with_a_silent_uav() -> None:
    silent = load_scenario("minefield", overrides=["ground.map_update_rate=0.0", "duration=20.0"])
    alone = msgspec.structs.replace(silent, uav=())
    one, other = (fly(scenario, 1)[0].recorder.states for scenario in (alone, silent))
    assert np.array_equal(one[:-1, 0], other[:-1, 1])


@pytest.mark.long
def test_ugv_alone_flies_alike_in_a_batch(flown) -> None:
    _, flight, _ = flown
    loop = ClosedLoop(alone(), 2, threads=1, end_on_sight_lost=False)
    loop.begin([5, 4])
    loop.fly()
    assert np.array_equal(loop.state.batch.vehicles["position"][1], flight.world.position)


def test_the_summary_says_nothing_of_an_escort(flown, capsys) -> None:
    _, _, summary = flown
    fields = json.loads(msgspec.json.encode(summary))
    escort = words("""
        law max_distance mean_distance switching_radius initial_error
        mean_error final_error estimate_rmse detection_rmse certified_share""")
    assert {name: fields[name] for name in escort} == dict.fromkeys(escort)
    assert fields["visibility_violations"] == fields["crossings"] == fields["detections"] == 0
    assert fields["mission"]["hazards_hit"] == 0
    print_summary(summary, [])
    table = capsys.readouterr().out
    assert "no UAV" in table
    assert "hazards hit" in table
    for word in ("in sight", "distance", "coverage error", "RMS"):
        assert word not in table


def test_every_view_shows_a_ugv_alone(flown) -> None:
    path, flight, _ = flown
    titles = [axes.get_title(loc="left") for axes in flight_figure(flight).axes]
    assert "Speed of the UGV" in titles
    recording = flight_of(path)
    frame = next(iter(Film(recording).frames([10.0])))
    assert frame.std() > 0.0
    *_, status = statuses(path, flight=0)
    status = msgspec.structs.replace(status, geometry=geometry_of(alone()))
    view = DriveView(status=status, truth=flight.truth())
    canvas = draw(view, "ugv_0", Trails(), width=60, height=20, wide=True)
    assert any(segment.text.strip() for row in range(20) for segment in canvas.row(row))
    env = outrider.parallel_env(alone(), render_mode="rgb_array")
    env.reset(seed=4)
    assert env.render() is not None


def test_ugvs_alone_are_the_agents_of_every_environment() -> None:
    assert outrider.parallel_env(alone()).possible_agents == ["ugv_0"]
    worlds = outrider.parallel_vector_env(alone(), num_envs=2)
    observations, _ = worlds.reset(seed=4)
    assert list(observations) == ["ugv_0"]
    with pytest.raises(ValueError, match=r"^agent = 'uav_0'; allowed: ugv_0$"):
        outrider.single_env(alone())


def test_a_law_is_refused_where_there_is_no_uav() -> None:
    with pytest.raises(ScenarioError, match=r"^--law circle: minefield has no UAV"):
        resolve("minefield", changes=["uav=[]"], law="circle")


def test_a_sweep_flies_a_ugv_alone_but_no_laws_over_it() -> None:
    alone = {"uav": [], "duration": 1.0}
    block = Block(name="alone")
    plan = lay_out(Sweep(scenario="minefield", set=alone, block=(block,)))
    assert cost_of(plan.points[0].scenario) > 0
    _, summary = fly(plan.points[0].scenario, 1)
    row = row_of(summary, 1.0)
    assert (row["margin"], row["violated"]) == (None, False)
    with pytest.raises(
        ScenarioError, match=r"^minefield: laws = \['circle'\]: the scenario has no UAV"
    ):
        lay_out(Sweep(scenario="minefield", laws=("circle",), set=alone, block=(block,)))


def test_uav_declarations_have_no_effect_without_a_uav() -> None:
    changes = ["uav=[]", "certificate.max_command_interval=1.0", "law.name=path", "duration=2.0"]
    scenario = load_scenario("minefield", overrides=changes)
    windy = msgspec.structs.replace(scenario, wind=Wind(mean=(0.05, 0.0)), links=LinkTable())
    _, summary = fly(check_scenario(windy), 1)
    assert summary.largest_tracking_error is None
    with pytest.raises(ScenarioError, match=r"ugv = \[\]"):
        check_scenario(msgspec.structs.replace(windy, ugv=()))
