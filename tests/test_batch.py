"""Many worlds at once: world k is, bit for bit, the single world of its seed."""

import threading

import numpy as np
import pytest

from bus.messages.links import LinkKind, LinkSettings
from bus.profiles import PROFILES
from bus.ticks import detection_rows
from flights import escort
from sim.channel.link_records import ARRIVED
from sim.compiling.threads import WorkerThreads
from sim.engine.batch import Batch, arrays_of
from sim.scenario.types import (
    Coverage,
    Detections,
    LinkTable,
    Region,
    Scenario,
    Sensor,
    VehicleLinks,
)
from sim.world import World
from worlds import POOR, SEVERAL, SMALL, small, step

HARSH = Detections(noise=0.3, dropout=0.3, rate=5.0)
CORNER = Region(lower=(2.0, 2.0), upper=(20.0, 20.0))
TOGETHER = LinkSettings(
    delay=0.1, jitter=0.2, jitter_shape="exponential", jitter_time=0.6, loss=0.1, duplicates=0.1
)
JAMMED = VehicleLinks(vehicle="uav_0", commands=PROFILES["jammed"])
SCENARIOS: dict[str, Scenario] = {
    "plain": escort(),
    "noise": escort(detections=HARSH, sensor=Sensor(model="plateau"), area=SMALL),
    "covered": escort(coverage=Coverage(desired=1.0, covered=(CORNER,))),
    "several": SEVERAL,
    "network": small("tracking", links=POOR),
    "late together": small("tracking", links=LinkTable(detections=TOGETHER, commands=TOGETHER)),
    "one link": small("tracking", links=LinkTable(only=(JAMMED,))),
}


def _alone(scenario, seed):
    """Return a single world that counts the gains."""
    others = (LinkKind.OPERATOR, LinkKind.RADIO)
    batch = Batch(scenario, 1, gains=True, threads=1, others=others)
    batch.begin((seed,))
    return World.of_batch(batch, 0, seed)


def _fly_both(scenario, seeds, ticks):
    batch = Batch(scenario, len(seeds), gains=True)
    batch.begin(seeds)
    worlds = [_alone(scenario, seed) for seed in seeds]
    rng = np.random.default_rng(5)
    for _ in range(ticks):
        commands = rng.uniform(-0.4, 0.4, (len(seeds), len(scenario.vehicles), 2))
        for world, rows in zip(worlds, commands.tolist(), strict=True):
            for v, command in enumerate(rows):
                world.send(v, world.tick, command)
            world.advance()
        step(batch, commands)
        _same(batch, worlds)
    return batch, worlds


def _same(batch: Batch, worlds: list[World]) -> None:
    s = batch.state
    for k, world in enumerate(worlds):
        assert s.ticks[k] == world.tick
        for u in range(len(world.uavs)):
            received = detection_rows(world.received(u), world.parameters.dt)
            packets = s.packets[k, u, ARRIVED, : s.links["arrived"][k, u]]
            found = np.column_stack([packets["stamp"], packets["vector"]])
            assert found.tolist() == [list(one) for one in received]
        assert world.vehicles.tobytes() == s.vehicles[k].tobytes()
        assert world.coverage.tobytes() == s.coverage[k].tobytes()


@pytest.mark.parametrize("name", SCENARIOS)
def test_world_k_of_a_batch_is_the_single_world_of_its_seed(name: str) -> None:
    batch, worlds = _fly_both(SCENARIOS[name], [3, 2**53 - 1, 40], 150)
    for k, world in enumerate(worlds):
        expected = {
            key: one
            for key, one in world.links.status().items()
            if not key.endswith(("radio", "operator"))
        }
        assert batch.links.status(k) == expected


def test_batch_size_and_threads_change_no_bit() -> None:
    scenario, seeds = SCENARIOS["network"], list(range(50, 120))
    commands = np.random.default_rng(1).uniform(-0.4, 0.4, (60, len(seeds), 2, 2))
    batches = []
    for first, threads in ((0, 1), (0, 3), (69, 1)):
        batch = Batch(scenario, len(seeds[first:]), threads=threads)
        batch.begin(seeds[first:])
        for row in commands[:, first:]:
            step(batch, np.ascontiguousarray(row))
        batches.append(batch.state)
    for name in ("vehicles", "coverage", "links"):
        one, other, last = (getattr(state, name) for state in batches)
        assert one.tobytes() == other.tobytes()
        assert one[69].tobytes() == last[0].tobytes()


def test_reset_world_equals_one_that_has_never_flown() -> None:
    batch, _ = _fly_both(SCENARIOS["network"], [1, 2, 3], 90)
    kept = [array[1].copy() for array in arrays_of(batch.state)]
    batch.begin([9, 8], [2, 0])
    for array, before in zip(arrays_of(batch.state), kept, strict=True):
        assert str(array[1].tolist()) == str(before.tolist())  # padding bytes differ
    fresh = Batch(SCENARIOS["network"], 3, gains=True)
    fresh.begin([8, 2, 9])
    commands = np.full((3, 2, 2), 0.2)
    for _ in range(60):
        step(batch, commands)
        step(fresh, commands)
    for array, other in zip(batch.state[:3], fresh.state[:3], strict=True):
        assert str(array[[0, 2]].tolist()) == str(other[[0, 2]].tolist())


def test_a_batch_needs_worlds_and_a_seed_for_each_that_begins() -> None:
    with pytest.raises(ValueError, match="worlds"):
        Batch(SCENARIOS["plain"], 0)
    with pytest.raises(ValueError, match="3 seeds for 2 worlds"):
        Batch(SCENARIOS["plain"], 2).begin([1, 2, 3])


def test_threads_share_everything_once_and_pass_on_what_fails() -> None:
    workers, done, lock = WorkerThreads(3), [], threading.Lock()

    def work(fail: bool, begin: int, end: int) -> None:
        with lock:
            done.extend(range(begin, end))
        if fail and begin == 0:
            raise ValueError("the first part")

    workers.share(work, 100, False)
    with pytest.raises(ValueError, match="the first part"):
        workers.share(work, 100, True)
    assert sorted(done) == sorted([*range(100)] * 2)
    with pytest.raises(ValueError, match="threads = 0"):
        WorkerThreads(0)
