"""Commands with backup trajectories: the vehicle follows the checked trajectory while commands are lost."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from agents.safety.safety_filter import SafetyFilter
from bus.messages.decision import NotCertified
from bus.messages.vehicle import MOST_CARRIED, BackupTrajectory, UavCommand
from flights import EVADED, briefing_of, flown_in_both, uav_sees
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import fly
from sim.compiling.records import struct_of
from sim.models.trajectories import received_trajectory
from sim.scenario.loading import load_scenario
from sim.scenario.types import Certificate
from sim.server.flight import Flight
from sim.world import World
from staging import stage
from worlds import SCENARIOS, raw, small

LOST = SCENARIOS["lost commands"]
RECORDED = Path(__file__).resolve().parent.parent / "examples" / "networks" / "wifi-far.csv"


def rest(begins: int, parent: int = -1, **fields) -> BackupTrajectory:
    return BackupTrajectory(begins, parent, (0.0, 0.0), **fields)


def still(interval: float | None = 1.0, delay: float = 0.2) -> World:
    """Return a UAV at rest, with perfect links."""
    scenario = small(
        "certified", certificate=Certificate(max_command_delay=delay, max_command_interval=interval)
    )
    return World(scenario, 1)


def flown(world: World, commands: dict[int, tuple[BackupTrajectory, ...]], ticks: int) -> list:
    """Return the trajectory that is flown in each tick; `commands` by the tick in which they are sent."""
    flown_ticks = []
    for tick in range(ticks):
        if tick in commands:
            world.send(0, tick, (0.0, 0.0), commands[tick])
        world.advance()
        flown_ticks.append(world.flown(0))
    return flown_ticks


# -- the receiver


@pytest.mark.parametrize(
    ("commands", "wanted"),
    [
        ({0: (rest(4),)}, [None, None, None, None, 4, 4]),
        ({3: (rest(2),)}, [None] * 8),
        # 2 follows 0, which is no longer flown
        ({0: (rest(0),), 1: (rest(1, 0),), 2: (rest(2, 0),), 3: (rest(3, 1),)}, [0, 1, 1, 3, 3]),
        ({3: (rest(3), rest(4, 3), rest(5, 4))}, [None, None, None, 3, 4, 5, 5]),
    ],
    ids=["early", "too late", "only after its parent", "repeated from lost commands"],
)
def test_trajectory_starts_in_its_own_tick(commands, wanted) -> None:
    assert flown(still(), commands, len(wanted)) == wanted


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


@pytest.mark.parametrize(("interval", "acts"), [(0.05, True), (1.0, False)])
def test_late_trajectory_acts_as_acceleration_after_the_timeout(interval, acts):
    """Before that it has no effect."""
    world = still(interval, 0.0)
    for tick in range(1, 4):
        world.move_to(tick)
        world.send(0, tick - 1, (0.1, 0.0), (BackupTrajectory(tick - 1, tick - 2, (0.2, 0.0)),))
        world.advance()
    assert world.flown(0) is None
    assert world.commands[0].tolist() == ([0.1, 0.0] if acts else [0.0, 0.0])
    tick = world.tick  # one in time takes effect again
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


def test_trajectory_survives_encoding() -> None:
    trajectory = BackupTrajectory(7, 6, (0.1, -0.2), 1, 2, 3, (0.25, 0.5), (-0.125, 1e-9))
    assert struct_of(BackupTrajectory, received_trajectory(trajectory)[0]) == trajectory


# -- the pilot


def test_command_with_all_trajectories_is_at_most_a_kilobyte() -> None:
    env, taken = parallel_env(LOST), []
    observations, _ = env.reset(seed=1)
    policies = pilots(env)
    while env.agents:
        commands = {name: policies[name](observations[name]) for name in env.agents}
        taken.append(commands["uav_0"].backup_trajectories)
        observations, *_ = env.step(commands)
    for trajectories in taken:
        begins = [trajectory.begins for trajectory in trajectories]
        assert begins == list(range(begins[0], begins[0] + len(begins)))
    assert max(len(trajectories) for trajectories in taken) == MOST_CARRIED
    assert max(len(msgspec.json.encode(trajectories)) for trajectories in taken) <= 1024


def test_too_many_trajectories_in_a_command_are_refused() -> None:
    command = UavCommand(
        tick=0, acceleration=(0.0, 0.0), backup_trajectories=(rest(0),) * (MOST_CARRIED + 1)
    )
    with pytest.raises(msgspec.ValidationError, match="length"):
        msgspec.json.decode(msgspec.json.encode(command), type=UavCommand)


# -- one trajectory


def test_lost_commands_fly_alike_in_environment_and_run() -> None:
    """Without estimator: its estimate, which the UGV receives, is rounded differently in the environment."""
    _, _, summary = flown_in_both(raw(LOST), 3)
    assert summary.certified_share == 1.0


def test_lossy_recorded_links_fly_alike_over_the_bus(tmp_path: Path) -> None:
    links = ("links.commands.loss=0.4", "links.commands.jitter=0.1", "links.commands.delay=0.1")
    bounds = ("certificate.max_command_interval=3.0", "certificate.max_measurement_age=3.0")
    recorded = f"links.detections.trace={RECORDED}"
    scenario = load_scenario("escort", overrides=[*EVADED, *links, *bounds, recorded])
    here, summary = fly(scenario, scenario.seed)
    assert summary.certified_share > 0.99  # from the first detection on
    assert summary.links["uav_0/detections"].lost["trace"] > 0
    with stage(tmp_path, here.world.tick, scenario=scenario) as run:
        run.start_both()
        over_bus = run.fly()
    assert over_bus.recorder.sha256() == summary.trajectory_sha256
    assert over_bus.world.links.status() == summary.links


def test_excessive_trajectories_are_counted_and_reported_once(caplog) -> None:
    """Foreign pilots may send them; our own pilots never do."""
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
    slightly = UavCommand(tick=0, acceleration=(0.30001, 0.0))
    flight = Flight(LOST, 3)
    flight.apply({"uav_0": slightly})
    assert flight.answers.shortened == {"uav_0": 1, "ugv_0": 0}
    assert "its command for tick 0, 0.30001 m/s², exceeds its bound 0.3 m/s²" in caplog.text


# -- the theorem


def test_filtered_policy_keeps_sight_while_commands_are_lost() -> None:
    env = parallel_env(LOST, safety_filter=True, duration=40.0)
    env.reset(seed=2)
    certified, interventions = [], 0
    while env.agents:
        away = np.array([0.3, 0.1])
        _, _, _, _, infos = env.step({"uav_0": away, "ugv_0": -away})
        certified.append(infos["uav_0"]["certified"])
        interventions += infos["uav_0"]["overridden"]
    assert len(certified) == 800
    assert all(certified)
    assert interventions > 0


def reasons(
    delay: float, interval: float, ticks: range, flown, moved=lambda _: (8.0, 7.0)
) -> list[NotCertified | None]:
    """Return a filter's decision in each tick, at rest with one detection in the first; `flown` and `moved` by tick."""
    declared = Certificate(max_command_delay=delay, max_command_interval=interval)
    pilot, found = SafetyFilter(briefing_of(small("certified", certificate=declared))), []
    for tick in ticks:
        detections = [(tick * 0.05, (0.0, 1.0))] if tick == ticks[0] else []
        seen = uav_sees(tick, *detections, position=moved(tick), committed_trajectory=flown(tick))
        pilot.see(seen)
        found.append(pilot.filter(seen, (0.0, 0.0)).reason)
    return found


def test_unavoidable_command_gap_is_reported_at_once() -> None:
    """It is not reported late as a missing plan: the next trajectory starts in tau_c or later."""
    # the trajectory for tick 14 is lost
    found_reasons = reasons(
        0.4, 0.3, range(20), lambda tick: None if tick < 9 else min(tick - 1, 13)
    )
    assert found_reasons[:15] == [None] * 15
    assert set(found_reasons[15:]) == {NotCertified.COMMAND_INTERVAL}


def test_pushed_vehicle_is_reported_and_certified_again() -> None:
    """A filter whose own state differs from its prediction trusts no earlier plan."""
    found_reasons = reasons(
        *(0.1, 1.0, range(12)),
        flown=lambda tick: None if tick < 3 else tick - 1,
        moved=lambda tick: (8.0, 7.0) if tick < 6 else (8.1, 7.0),
    )
    assert found_reasons[:6] == [None] * 6
    assert found_reasons[6] is NotCertified.OFF_TRAJECTORY
    assert set(found_reasons[7:]) == {None}  # at rest it is checked again at once


def test_trajectory_of_another_pilot_is_not_trusted() -> None:
    """A filter whose vehicle follows an unknown trajectory certifies nothing until its own are flown."""
    found_reasons = reasons(0.1, 1.0, range(40, 52), lambda tick: 39 if tick < 43 else tick - 1)
    assert found_reasons[0] == NotCertified.UNCHECKED_PLAN
    assert found_reasons[-1] is None


def test_reported_trajectory_does_not_depend_on_the_ugv() -> None:
    """It follows from the UAV's links and trajectories alone, so that two different UGVs give the same result."""
    runs = []
    for push in ((0.1, 0.0), (-0.05, 0.08)):
        world = World(LOST, 4)
        answers = []
        for tick in range(200):
            last = world.flown(0)
            parent = -1 if last is None else last
            world.send(0, tick, (0.0, 0.0), (rest(tick + 8, parent),))
            world.send(1, tick, push)
            world.advance()
            answers.append(world.flown(0))
        runs.append(answers)
        assert {one for one in answers if one is not None} <= set(range(8, 208))
    assert runs[0] == runs[1]
    assert len(set(runs[0])) > 10
