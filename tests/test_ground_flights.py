"""Runs over ground with hazards: one trajectory in every environment, and the value of the escort."""

import msgspec
import numpy as np
import pytest

from flights import flown_in_both
from outrider.envs.closed_loop import ClosedLoop
from outrider.running.assumptions import assumption_warnings
from outrider.running.flying import fly
from processes import run_json
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable
from worlds import LOSSY, raw

RADIO = msgspec.structs.replace(LOSSY, delay=0.2)


@pytest.mark.parametrize("name", ["minefield", "rubble", "rescue"])
def test_a_flight_over_hazards_has_one_trajectory(name: str) -> None:
    """In a run, in the environment, and in a batch whose other worlds have other hazards; without estimator."""
    scenario = msgspec.structs.replace(
        raw(load_scenario(name)), duration=30.0, links=LinkTable(radio=RADIO)
    )
    _, flight, _ = flown_in_both(scenario, 4)
    assert flight.world.position[1].tolist() != list(scenario.ugv[0].position)
    loop = ClosedLoop(scenario, 2, threads=1)
    loop.begin([5, 4])
    loop.fly()
    batch, ground = loop.state.batch, loop.batch.ground
    assert np.array_equal(batch.vehicles["position"][1], flight.world.position)
    assert not np.array_equal(ground.tiles[0], ground.tiles[1])
    assert loop.mission(1) == flight.world.mission


def test_hazards_fly_one_trajectory_over_three_processes() -> None:
    arguments = ["minefield", "--duration", "15", "--seed", "4", "--set", "links.radio.loss=0.3"]
    over_the_bus, alone = run_json(*arguments), run_json(*arguments, "--in-process")
    assert over_the_bus["trajectory_sha256"] == alone["trajectory_sha256"]


@pytest.mark.parametrize("profile", ["wifi", "wifi-poor", "jammed"])
def test_a_cautious_ugv_enters_no_unknown_tile_over_bad_links(profile: str) -> None:
    """Its commands carry the following stop."""
    scenario = load_scenario("minefield", overrides=[f"links.profile={profile}"])
    for seed in range(3):
        summary = fly(scenario, seed)[1]
        assert summary.mission is not None
        assert summary.mission.entered_unknown_tile == 0
        assert summary.mission.arrived


def test_entering_unknown_tiles_is_counted() -> None:
    bold = load_scenario("minefield", overrides=["ugv.0.driver=waypoints"])
    mission = fly(bold, 1)[1].mission
    assert mission is not None
    assert mission.entered_unknown_tile > 0


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
