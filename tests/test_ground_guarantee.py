"""The certificates of cautious UGVs, to stay on known tiles, against the truth."""

import msgspec
import numpy as np
import pytest

from bus.messages.ground import Hazard, MapUpdate
from bus.messages.telemetry import MissionResult
from bus.messages.vehicle import UgvReport
from flights import record
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import fly
from sim.models.ground import CLEAR, UNCERTIFIED, UNSEEN, block_letters
from sim.models.hazards import BLOCK
from sim.scenario.loading import load_scenario
from sim.world import World
from test_seen_ground import scenario_with

CERTIFIED = UgvReport(certified=True)
NOT = UgvReport(certified=False, uncertified=next(iter(UNCERTIFIED.values())))


def on_unseen_ground() -> World:
    """Return a cautious UGV in the middle of ground without any map updates."""
    scenario = scenario_with(Hazard(kind="block", center=(2.0, 2.0), radius=0.5), sensing_range=0.0)
    (ugv,) = scenario.ugv
    cautious = msgspec.structs.replace(ugv, driver="waypoints", caution="cautious")
    return World(msgspec.structs.replace(scenario, ugv=(cautious,)), 1)


def mission(world: World) -> MissionResult:
    assert world.mission is not None
    return world.mission


def test_certified_tick_on_unknown_ground_breaks_the_guarantee() -> None:
    world = on_unseen_ground()
    for _ in range(100):
        world.send(0, world.tick, (0.0, 0.0))
        world.send(1, world.tick, (0.1, 0.0))
        world.record_claim(1, CERTIFIED)
        world.advance()
    guarantee = mission(world).guarantees["ugv_0"]
    assert guarantee.ticks == guarantee.certified == 100
    assert guarantee.entered_unknown_tile > 0
    assert guarantee.certificate_broken == guarantee.entered_unknown_tile
    assert mission(world).ground_certificate_broken == guarantee.certificate_broken


def test_false_ground_report_excuses_a_broken_certificate() -> None:
    world = on_unseen_ground()
    for report in (CERTIFIED, NOT, NOT, None, CERTIFIED, NOT, CERTIFIED, None):
        world.record_claim(1, report)
    guarantee = mission(world).guarantees["ugv_0"]
    assert guarantee.certificate_broken == 2  # a claim may end when another driver takes over
    assert (guarantee.certified, guarantee.uncertified) == (3, {NOT.uncertified: 3})
    world.ground.missions["untrue"] = 1
    for report in (CERTIFIED, NOT):
        world.record_claim(1, report)
    assert mission(world).ground_certificate_broken == 2


@pytest.mark.parametrize(
    ("before", "reported", "true", "untrue"),
    [
        (UNSEEN, CLEAR, CLEAR, 0),
        (UNSEEN, CLEAR, BLOCK, 1),
        (UNSEEN, BLOCK, CLEAR, 0),
        (CLEAR, BLOCK, CLEAR, 1),
        (BLOCK, CLEAR, CLEAR, 0),
    ],
)
def test_false_reports_on_drivable_ground_excuse(
    before: int, reported: int, true: int, untrue: int
) -> None:
    """A false alarm alone does not: it closes ground and opens none."""
    world = on_unseen_ground()
    ground = world.ground
    ground.tiles[0, 0, 0] = true
    ground.radioed[0, 0, 0, 0] = before
    states = np.full((1, 1), reported, np.uint8)
    world.receive_block(1, MapUpdate(row=0, column=0, tiles=block_letters(states, 0, 0)))
    assert ground.missions["untrue"].tolist() == [[untrue]]


@pytest.mark.parametrize("change", ["links.profile=wifi-poor", "ground.false_alarm=0.2"])
def test_runs_and_environments_count_alike(change: str) -> None:
    """Batches: tests/test_ground_flights.py."""
    scenario = load_scenario("minefield", overrides=["duration=25.0", change])
    guarantees = fly(scenario, 3)[1].mission.guarantees
    env = parallel_env(scenario=scenario, end_on_sight_lost=False)
    record(env, pilots(env), env.reset(seed=3)[0])
    assert guarantees["ugv_0"].ticks == 500
    assert guarantees["ugv_0"].certified > 400
    assert mission(env.unwrapped.world).guarantees == guarantees
