"""Runs over ground with hazards: one trajectory in every environment, and the value of the escort."""

import msgspec
import numpy as np
import pytest

from flights import flown_in_both
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.running.assumptions import assumption_warnings
from outrider.running.flying import fly
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable, Scenario
from sim.server.flight import Flight
from worlds import LOSSY, raw

RADIO = msgspec.structs.replace(LOSSY, delay=0.2)


def over_hazards(name: str, *changes: str) -> Scenario:
    """Return a scenario over hazards with a bad radio link, without estimator."""
    scenario = load_scenario(name, overrides=["duration=30.0", *changes])
    return msgspec.structs.replace(raw(scenario), links=LinkTable(radio=RADIO))


def assert_batch_flies_alike(scenario: Scenario, flight: Flight) -> None:
    """Fly the scenario with seed 4 in a batch whose other world has other hazards."""
    loop = ClosedLoop(scenario, 2, threads=1)
    loop.begin([5, 4])
    loop.fly()
    batch, ground = loop.state.batch, loop.batch.ground
    assert np.array_equal(batch.vehicles["position"][1], flight.world.position)
    assert not np.array_equal(ground.tiles[0], ground.tiles[1])
    assert loop.mission(1) == flight.world.mission


@pytest.mark.parametrize("name", ["minefield", "rubble"])
def test_a_flight_over_hazards_has_one_trajectory(name: str) -> None:
    scenario = over_hazards(name)
    _, flight, _ = flown_in_both(scenario, 4)
    assert flight.world.position[1].tolist() != list(scenario.ugv[0].position)


def test_a_batch_over_hazards_flies_as_runs_do() -> None:
    """The UGV drives over them: a batch with the navigating driver takes a minute to compile."""
    scenario = over_hazards("minefield", "ugv.0.driver=waypoints")
    assert_batch_flies_alike(scenario, fly(scenario, 4)[0])


@pytest.mark.long
@pytest.mark.parametrize("name", ["minefield", "rubble", "rescue"])
def test_a_batch_navigates_as_runs_do(name: str) -> None:
    scenario = over_hazards(name)
    assert_batch_flies_alike(scenario, flown_in_both(scenario, 4)[1])


def test_a_cautious_ugv_enters_no_unknown_tile() -> None:
    """Over bad links its commands carry the following stop."""
    scenario = load_scenario("minefield", overrides=["links.profile=jammed"])
    mission = fly(scenario, 1)[1].mission
    assert mission is not None
    assert mission.entered_unknown_tile == 0
    assert mission.arrived


@pytest.mark.long
@pytest.mark.parametrize("profile", ["wifi", "wifi-poor", "jammed"])
def test_many_cautious_ugvs_enter_no_unknown_tile(profile: str) -> None:
    loop = ClosedLoop(load_scenario("minefield", overrides=[f"links.profile={profile}"]), 32)
    loop.begin(range(32))
    loop.fly()
    missions = [loop.mission(k) for k in range(32)]
    assert sum(mission.entered_unknown_tile for mission in missions) == 0
    assert all(mission.arrived for mission in missions)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("ground.miss=0.1", "may be reported clear"),
        ("ugv.0.velocity=[0.1, 0.0]", "starts moving"),
        ("ground.false_alarm=0.1", ""),
        ("links.commands.loss=0.2", ""),
    ],
)
def test_assumptions_of_the_cautious_driver_are_judged(change: str, reason: str) -> None:
    base = ["ground.miss=0.0", "ground.false_alarm=0.0"]
    lines = assumption_warnings(load_scenario("minefield", overrides=[*base, change]))
    lines_of_warning = [line for line in lines if "not certified to stay on known tiles" in line]
    assert len(lines_of_warning) == bool(reason)
    assert not reason or reason in lines_of_warning[0]
