"""Commands that carry a motion: the vehicle flies on what was checked while commands are lost."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.safety.handover import largest_interval
from agents.safety.safety_filter import SafetyFilter
from bus.messages.decision import NotCertified
from bus.messages.vehicle import MOST_CARRIED, BackupTrajectory, UavCommand
from flights import EVADED, PROMISED, certified, flown_in_both, told, uav_sees
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import fly
from processes import flown_both_ways
from sim.compiling.records import struct_of
from sim.models.motion import received_motion
from sim.scenario.types import Certificate, LinkTable, Uav
from sim.server.flight import Flight
from sim.world import World
from worlds import LOSSY, SCENARIOS, raw, small

LOST = SCENARIOS["lost commands"]
RECORDED = Path(__file__).resolve().parent.parent / "examples" / "networks" / "wifi-far.csv"


def rest(begins: int, parent: int = -1, **fields) -> BackupTrajectory:
    return BackupTrajectory(begins, parent, (0.0, 0.0), **fields)


def still(outage: float | None = 1.0, delay: float = 0.2) -> World:
    """A UAV at rest, with perfect links."""
    scenario = small(
        "certified", certificate=Certificate(max_command_delay=delay, max_command_interval=outage)
    )
    return World(scenario, 1)


def flown(world: World, commands: dict[int, tuple[BackupTrajectory, ...]], ticks: int) -> list:
    """The motion that is flown in each tick; `commands` by the tick in which they set out."""
    told = []
    for tick in range(ticks):
        if tick in commands:
            world.send(0, tick, (0.0, 0.0), commands[tick])
        world.advance()
        told.append(world.flown(0))
    return told


# -- the receiver


def test_early_trajectory_starts_in_its_own_tick() -> None:
    assert flown(still(), {0: (rest(4),)}, 6) == [None, None, None, None, 4, 4]


def test_late_trajectory_never_starts() -> None:
    assert flown(still(), {3: (rest(2),)}, 8) == [None] * 8


def test_trajectory_starts_only_if_its_parent_is_flown() -> None:
    world = still()
    chain = {0: (rest(0),), 1: (rest(1, 0),), 2: (rest(2, 0),), 3: (rest(3, 1),)}
    assert flown(world, chain, 5) == [0, 1, 1, 3, 3]  # 2 goes on from 0, which is no longer flown


def test_command_repeats_the_trajectories_of_lost_commands() -> None:
    world = still()
    assert flown(world, {3: (rest(3), rest(4, 3), rest(5, 4))}, 7) == [None, None, None, 3, 4, 5, 5]


def test_trajectory_is_flown_to_its_end_and_the_vehicle_rests() -> None:
    world = still()
    plan = BackupTrajectory(0, -1, (0.2, 0.0), 2, 3, 4, (0.0, 0.1), (-0.05, -0.05))
    world.send(0, 0, (9.0, 9.0), (plan,))
    acted = []
    for _ in range(16):
        world.advance()
        acted.append(tuple(world.commands[0]))
    assert acted[:10] == [(0.2, 0.0), *[(0.0, 0.1)] * 2, *[(0.0, 0.0)] * 3, *[(-0.05, -0.05)] * 4]
    assert np.all(world.velocity[0] == 0.0)


@pytest.mark.parametrize(("outage", "begun"), [(0.05, True), (1.0, False)])
def test_late_trajectory_acts_as_acceleration_after_the_timeout(outage, begun):
    """Before that it is void."""
    world = still(outage, 0.0)
    for tick in range(1, 4):
        world.move_to(tick)
        world.send(0, tick - 1, (0.1, 0.0), (BackupTrajectory(tick - 1, tick - 2, (0.2, 0.0)),))
        world.advance()
    assert world.flown(0) is None
    assert world.commands[0].tolist() == ([0.1, 0.0] if begun else [0.0, 0.0])
    tick = world.tick  # one that is in time takes over again
    world.send(0, tick, (0.0, 0.0), (BackupTrajectory(tick, -1, (0.3, 0.0)),))
    world.advance()
    assert (world.flown(0), world.commands[0].tolist()) == (tick, [0.3, 0.0])


def test_commands_with_and_without_trajectories_take_effect() -> None:
    world = still()
    world.send(0, 0, (0.0, 0.0), (rest(0),))
    world.advance()
    world.send(0, 1, (0.1, 0.0))
    world.advance()
    assert (world.flown(0), world.commands[0].tolist()) == (None, [0.1, 0.0])
    world.send(0, 2, (0.0, 0.0), (BackupTrajectory(2, -1, (0.3, 0.0)),))
    world.advance()
    assert (world.flown(0), world.commands[0].tolist()) == (2, [0.3, 0.0])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(-2, 12), st.integers(-1, 12)), max_size=6))
def test_receiver_flies_a_received_trajectory_or_rests(sent) -> None:
    motions = [BackupTrajectory(max(0, begins), parent, (0.1, 0.0)) for begins, parent in sent]
    world = still()
    told_flown = flown(
        world, {tick: (motion,) for tick, motion in enumerate(motions)}, len(motions)
    )
    names = {motion.begins for motion in motions}
    assert all(one is None or one in names for one in told_flown)
    assert np.linalg.norm(world.velocity[0]) <= 0.6


def test_trajectory_survives_encoding() -> None:
    motion = BackupTrajectory(7, 6, (0.1, -0.2), 1, 2, 3, (0.25, 0.5), (-0.125, 1e-9))
    assert struct_of(BackupTrajectory, received_motion(motion)[0]) == motion


# -- the pilot


def test_command_with_all_trajectories_is_at_most_a_kilobyte() -> None:
    env, taken = parallel_env(LOST), []
    observations, _ = env.reset(seed=1)
    policies = pilots(env)
    while env.agents:
        commands = {name: policies[name](observations[name]) for name in env.agents}
        taken.append(commands["uav_0"].backup_trajectories)
        observations, *_ = env.step(commands)
    for motions in taken:
        begins = [motion.begins for motion in motions]
        assert begins == list(range(begins[0], begins[0] + len(begins)))
    assert max(len(motions) for motions in taken) == MOST_CARRIED
    assert max(len(msgspec.json.encode(motions)) for motions in taken) <= 1024


def test_too_many_trajectories_in_a_command_are_refused() -> None:
    command = UavCommand(
        tick=0, acceleration=(0.0, 0.0), backup_trajectories=(rest(0),) * (MOST_CARRIED + 1)
    )
    with pytest.raises(msgspec.ValidationError, match="length"):
        msgspec.json.decode(msgspec.json.encode(command), type=UavCommand)


# -- one trajectory


def test_lost_commands_fly_alike_in_environment_and_run() -> None:
    """Without estimator: the UGV hears of the UAV's, which rounds otherwise in the environment."""
    _, _, summary = flown_in_both(raw(LOST), 3)
    assert summary.certified_share == 1.0


def test_lossy_recorded_links_fly_alike_over_three_processes() -> None:
    links = ("links.commands.loss=0.4", "links.commands.jitter=0.1", "links.commands.delay=0.1")
    recorded = (f"links.detections.trace={RECORDED}", "certificate.max_measurement_age=3.0")
    there, here = flown_both_ways(
        "escort", *EVADED, *links, "certificate.max_command_interval=3.0", *recorded, seed=3
    )
    assert there["certified_share"] == here.certified_share > 0.99  # from the first detection on
    assert there["links"]["uav_0/detections"]["lost"]["trace"] > 0


def test_excessive_trajectories_are_counted_and_reported_once(caplog) -> None:
    """As a pilot of somebody else's may send them; those of ours never are."""
    flight, _ = fly(LOST, 3)
    assert flight.answers.shortened == {"uav_0": 0, "ugv_0": 0}
    too_far = msgspec.structs.replace(rest(8), turn=3, turning=(0.3, 0.4))
    flight = Flight(LOST, 3)
    for tick in range(2):
        flight.apply(
            {
                "uav_0": UavCommand(
                    tick=tick, acceleration=(0.0, 0.0), backup_trajectories=(too_far,)
                )
            }
        )
    assert flight.answers.shortened == {"uav_0": 2, "ugv_0": 0}
    assert caplog.text.count("its command for tick 0, 0.5 m/s², exceeds its bound 0.3") == 1


# -- the theorem


def test_command_interval_costs_radius_and_age() -> None:
    paper = PROMISED | {"eps": 0.3, "age": 5.0}
    numbers = [certified(**paper, outage=b) for b in (0.05, 1.0, 4.0)]
    assert [c.handover_bound for c in numbers] == sorted(
        (c.handover_bound for c in numbers), reverse=True
    )
    assert all(c.handover_radius <= numbers[0].handover_radius for c in numbers)
    most = largest_interval(numbers[0])
    assert math.isnan(certified(**paper, outage=most + 0.1).handover_radius)
    assert not math.isnan(certified(**paper, outage=most - 0.1).handover_radius)


def test_filtered_policy_keeps_sight_while_commands_are_lost() -> None:
    scenario = small(
        "certified",
        links=LinkTable(commands=LOSSY),
        certificate=Certificate(max_command_delay=0.4, max_command_interval=2.0),
        duration=40.0,
    )
    env = parallel_env(scenario, safety_filter=True)
    env.reset(seed=2)
    certified, interventions = [], 0
    while env.agents:
        away = np.array([0.3, 0.1])
        _, _, _, _, infos = env.step({"uav_0": away, "ugv_0": -away})
        certified.append(infos["uav_0"]["certified"])
        interventions += infos["uav_0"]["overridden"]
    assert env.world.tick == scenario.ticks
    assert all(certified)
    assert interventions > 0


def test_undeclared_command_gap_is_reported_by_name() -> None:
    scenario = small(
        "certified",
        links=LinkTable(commands=msgspec.structs.replace(LOSSY, blackouts=((5.0, 3.0),))),
        certificate=Certificate(max_command_delay=0.4, max_command_interval=2.0),
    )
    _, summary = fly(scenario, 1)
    assert summary.uncertified[NotCertified.COMMAND_INTERVAL] >= 15
    assert summary.certified_while_lost == summary.certificate_broken == 0
    assert summary.certified_share > 0.8


def reasons(
    delay: float, outage: float, ticks: range, flown, moved=lambda _: (8.0, 7.0)
) -> list[NotCertified | None]:
    """A filter's answers to each tick, at rest and with one detection in the first; `flown` and `moved` by tick."""
    declared = Certificate(max_command_delay=delay, max_command_interval=outage)
    pilot, found = SafetyFilter(told(small("certified", certificate=declared))), []
    for tick in ticks:
        looks = [(tick * 0.05, (0.0, 1.0))] if tick == ticks[0] else []
        seen = uav_sees(tick, *looks, position=moved(tick), committed_trajectory=flown(tick))
        pilot.see(seen)
        found.append(pilot.filter(seen, (0.0, 0.0)).reason)
    return found


def test_unavoidable_command_gap_is_reported_at_once() -> None:
    """And not as a plan that is missing, when it is too late: the next motion begins tau_c from now, or later."""
    # what begins in tick 14 is lost
    said = reasons(0.4, 0.3, range(20), lambda tick: None if tick < 9 else min(tick - 1, 13))
    assert said[:15] == [None] * 15
    assert set(said[15:]) == {NotCertified.COMMAND_INTERVAL}


def test_pushed_vehicle_is_reported_and_certified_again() -> None:
    """A filter that is told another state than it has predicted trusts no plan that was made before."""
    said = reasons(
        *(0.1, 1.0, range(12)),
        flown=lambda tick: None if tick < 3 else tick - 1,
        moved=lambda tick: (8.0, 7.0) if tick < 6 else (8.1, 7.0),
    )
    assert said[:6] == [None] * 6
    assert said[6] is NotCertified.OFF_TRAJECTORY
    assert set(said[7:]) == {None}  # at rest it is checked anew at once


def test_trajectory_of_another_pilot_is_not_trusted() -> None:
    """A filter that is told of a motion that it has not sent certifies nothing until its own are flown."""
    said = reasons(0.1, 1.0, range(40, 52), lambda tick: 39 if tick < 43 else tick - 1)
    assert said[0] == NotCertified.UNCHECKED_PLAN
    assert said[-1] is None


def test_reported_trajectory_does_not_depend_on_the_ugv() -> None:
    """Its own links and motions lead to it, and nothing else: two UGVs that move differently, one answer."""
    scenario = small(
        "certified",
        links=LinkTable(commands=LOSSY),
        certificate=Certificate(max_command_delay=0.4, max_command_interval=2.0),
    )
    told = []
    for push in ((0.1, 0.0), (-0.05, 0.08)):
        world = World(scenario, 4)
        answers = []
        for tick in range(200):
            last = world.flown(0)
            parent = -1 if last is None else last
            world.send(0, tick, (0.0, 0.0), (rest(tick + 8, parent),))
            world.send(1, tick, push)
            world.advance()
            answers.append(world.flown(0))
        told.append(answers)
        assert {one for one in answers if one is not None} <= set(range(8, 208))
    assert told[0] == told[1]
    assert len(set(told[0])) > 10


def test_uavs_alone_have_receivers() -> None:
    world = still()
    follows = world.vehicles["follows_motions"].tolist()
    assert follows == [isinstance(v, Uav) for v in world.scenario.vehicles]
