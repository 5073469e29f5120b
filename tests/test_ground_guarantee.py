"""The certificates of cautious UGVs, to stay on known tiles, against the truth."""

import msgspec
import numpy as np
import pytest

from agents.ugv import UgvPilot
from bus.messages.ground import Hazard, MapUpdate, TileReport
from bus.messages.links import LinkSettings
from bus.messages.telemetry import MissionResult, UgvGuarantee
from bus.messages.vehicle import Teleoperation, UgvObservation, UgvReport
from flights import record
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import InProcess, fly, make_pilots
from sim.engine.briefing import ugv_briefing
from sim.models.ground import CLEAR, NOT_OWN, UNCERTIFIED, UNSEEN, block_letters
from sim.models.hazards import BLOCK
from sim.scenario.checks import check_scenario
from sim.scenario.loading import load_scenario
from sim.scenario.types import Ground, LinkTable, Scenario
from sim.scenario.vehicle_types import Ugv
from sim.server.flight import Flight
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


# changes of the driver


def flown_by_turns(stop: float, *, delay: float, first: str = "navigate") -> Flight:
    """Fly a UGV towards a mine, from second 1 on by an operator, and by `navigate` again where x reaches `stop` [m]."""
    mine = Hazard(kind="block", center=(10.0, 6.0), radius=0.5)
    ugv = Ugv(
        position=(7.0, 6.0), goals=((12.0, 6.0),), driver=first, max_speed=0.3, max_acceleration=0.1
    )
    links = LinkTable(commands=LinkSettings(delay=delay))
    ground = Ground(sensing_range=1.0)
    scenario = check_scenario(
        Scenario(ugv=(ugv,), hazard=(mine,), ground=ground, links=links, duration=60.0)
    )
    flight, operated = Flight(scenario, 1), 20 if first == "navigate" else 0
    exchange, east = (
        InProcess(make_pilots(scenario, 1)),
        Teleoperation(operator="a", velocity=(1.0, 0.0)),
    )
    while not flight.over:
        tick, x = flight.world.tick, flight.world.position[0, 0]
        if tick == operated:
            flight.assign_driver("ugv_0", "teleop")
        if flight.drivers["ugv_0"] == "teleop":
            flight.teleoperate("ugv_0", east)
            if x >= stop:
                flight.assign_driver("ugv_0", "navigate")
        flight.fly_tick(exchange)
    return flight


def guarantee(flight: Flight) -> UgvGuarantee:
    return mission(flight.world).guarantees["ugv_0"]


def test_nothing_is_certified_while_an_operators_command_acts() -> None:
    """The mine's tiles start at x = 9 m; the UGV brakes within 0.45 m, and drives 0.15 m before commands arrive."""
    for stop in np.arange(8.3, 8.6, 0.03):
        found = guarantee(flown_by_turns(float(stop), delay=0.5))
        assert found.certificate_broken == 0
        assert found.uncertified[UNCERTIFIED[NOT_OWN]] == 11
        assert found.certified > 0


@pytest.mark.parametrize("first", ["navigate", "teleop"])
def test_navigate_knows_what_other_drivers_have_sensed(first: str) -> None:
    """Without a UAV: the UGV has sensed the tiles around it while the operator drove."""
    flight = flown_by_turns(8.0, delay=0.0, first=first)
    assert mission(flight.world).arrived
    assert guarantee(flight).certificate_broken == 0


def test_reports_too_late_to_answer_are_on_the_map() -> None:
    """A pilot that is slower than the clock only perceives some observations."""
    scenario = on_unseen_ground().scenario
    ugv = msgspec.structs.replace(scenario.ugv[0], driver="navigate")
    (name,) = (one.name for one in scenario.ugv)
    pilot = UgvPilot(ugv_briefing(msgspec.structs.replace(scenario, ugv=(ugv,)), name, 1))
    x, y = ugv.position
    reports = tuple(TileReport(j, i, ".") for i in range(24) for j in range(24))
    own = {"position": (x, y), "velocity": (0.0, 0.0)}
    pilot.perceive(UgvObservation(tick=0, time=0.0, **own, tile_reports=reports))
    pilot.forget_commands()
    assert pilot.act(UgvObservation(tick=1, time=0.05, **own)).acceleration != (0.0, 0.0)
