"""The operators' controls, with real sessions: laws, drivers, speed and resets during a run."""

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.keys import OPERATOR
from bus.messages.control import Action, Control
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from bus.messages.vehicle import Teleoperation
from outrider.running.assumptions import assumption_warnings
from outrider.running.flying import fly
from processes import wait_until
from sim.scenario.loading import load_scenario
from staging import local_flight, stage


def test_another_law_is_flown_from_its_tick_on(tmp_path: Path) -> None:
    with stage(tmp_path, 100_000) as run:
        run.start_both()

        def work(send: Any, status: Any) -> None:
            status(lambda s: s.tick > 50)
            send(Control(action=Action.LAW, law=Law(name="tracking")))
            changed = status(lambda s: s.law == "tracking")
            status(lambda s: s.tick > changed.tick + 1500)
            run.server.flight.stop()

        flight = run.fly(operator=work)
    tick = run.server.changes[0].tick
    before = local_flight(tick).recorder.states
    assert np.array_equal(flight.recorder.states[:tick, :, :4], before[:tick, :, :4])
    assert not np.array_equal(
        flight.recorder.states[: tick + 60, 0, :2],
        local_flight(tick + 60).recorder.states[: tick + 60, 0, :2],
    )
    assert flight.recorder.escorts[-1, 0, 0] < 0.6  # it hovers over its UGV
    assert any(f"operator: law tracking at tick {tick}" in event for event in run.events)


IMPOSSIBLE = {
    "fancy": Control(action=Action.LAW, law=Law(name="fancy")),
    "law: missing": Control(action=Action.LAW),
    "custom.weighting": Control(action=Action.LAW, law=Law(name="weighted")),
    "ghost": Control(action=Action.DRIVER, driver="ghost"),
    "ugv_7": Control(action=Action.DRIVER, vehicle="ugv_7", driver="teleop"),
    "driver": Control(action=Action.DRIVER),
}
"""Controls that a simulator rejects, by a phrase of the reason."""


def test_impossible_controls_are_rejected_and_change_nothing(tmp_path: Path) -> None:
    with stage(tmp_path, 300) as run:
        run.start_both()
        rejected = threading.Event()

        def work(send: Any, status: Any) -> None:
            for control in IMPOSSIBLE.values():
                send(control)
            wait_until(lambda: len(run.events) == len(IMPOSSIBLE))
            rejected.set()

        # until then a tick takes long: the run does not end earlier
        flight = run.fly(lambda: rejected.wait(0.02) and None, operator=work)
    assert flight.recorder.sha256() == local_flight(300).recorder.sha256()
    for event, phrase in zip(run.events, IMPOSSIBLE, strict=True):
        assert "is rejected" in event
        assert phrase in event
    assert not run.server.changes


def test_changed_link_reports_the_broken_assumption(tmp_path: Path) -> None:
    with stage(tmp_path, 300, warn=assumption_warnings) as run:
        flight = run.server.flight
        assert run.server.status(0.0).warnings == ()
        flight.order(Law(name="tracking"))
        flight.degrade(LinkKind.COMMANDS, None, LinkSettings(delay=0.3))
        assert run.server.status(0.0).warnings == ()  # this law guarantees nothing
        flight.order(Law(name="certified"))
        (line,) = run.server.status(0.0).warnings
        assert "A5" in line
        assert "links.commands.delay = 0.3" in line
        flight.degrade(LinkKind.COMMANDS, None, LinkSettings())
        assert run.server.status(0.0).warnings == ()


def test_reset_starts_a_flight_with_new_seed_and_pilots(tmp_path: Path) -> None:
    with stage(tmp_path, 400) as run:
        vehicles = run.start_both()
        resets = iter((7, 8))

        def work(send: Any, status: Any) -> None:
            for seed in resets:
                status(lambda s: 30 < s.tick < 390)
                send(Control(action=Action.RESET, seed=seed))
                status(lambda s, seed=seed: s.seed == seed and s.changes)

        def slowly() -> None:  # no run but the last ends before its operator has acted
            if run.server.flight.seed != 8:
                time.sleep(0.02)

        flight = run.fly(slowly, operator=work)
        status = run.server.status(1.0)
    assert flight.complete
    assert (flight.seed, flight.episode) == (8, 2)
    assert flight.answers.first_missing is None
    assert status.vehicles["uav_0"].lost == 0
    # of the last run: the previous pilot has ended
    assert [seen.tick for seen in vehicles[0].seen] == list(range(400))
    assert {seen.episode for seen in vehicles[0].seen} == {2}
    assert flight.recorder.sha256() == fly(flight.scenario, 8)[0].recorder.sha256()


def test_changed_speed_changes_no_bit(tmp_path: Path) -> None:
    with stage(tmp_path, 600) as run:
        run.start_both()
        done = threading.Event()  # until then a tick takes long: the run does not end earlier

        def work(send: Any, status: Any) -> None:
            for factor in (5.0, None):
                send(Control(action=Action.SPEED, factor=factor))
                status(lambda s, factor=factor: s.target_factor == factor)
            done.set()

        flight = run.fly(lambda: done.wait(0.02) and None, operator=work)
    assert done.is_set()
    assert flight.complete
    if flight.answers.first_missing is None:
        assert flight.recorder.sha256() == local_flight(600).recorder.sha256()


def test_operator_takes_over_drives_and_hands_back(tmp_path: Path) -> None:
    """Through the bus, the simulator and the UGV's driver: bounded, braking without messages, without a jump."""
    with stage(tmp_path, 100_000, realtime=10.0) as run:
        run.start_both()
        world, ticks = run.server.flight.world, list[int]()

        def work(send: Any, status: Any) -> None:
            outbox = run.client("operator").outbox(OPERATOR, "ugv_0")
            wait_until(lambda: outbox.wanted)
            assert status(lambda s: s.tick > 100).drivers == {"ugv_0": "waypoints"}
            for name in ("someone_else", "a_person"):
                send(Control(action=Action.DRIVER, vehicle="ugv_0", driver="teleop", operator=name))
                status(lambda s, name=name: s.operators == {"ugv_0": name})

            def is_fast() -> bool:
                outbox.send(Teleoperation(operator="a person", velocity=(0.0, -1e5)))
                return bool(world.velocity[1, 1] <= -0.195)

            wait_until(is_fast)
            ticks.append(world.tick)
            ticks.append(status(lambda s: s.tick > ticks[0] + 80).tick)
            send(Control(action=Action.DRIVER, vehicle="ugv_0", driver="waypoints"))
            back = status(lambda s: s.drivers["ugv_0"] == "waypoints")
            assert not back.operators
            status(lambda s: s.tick > back.tick + 80)
            run.server.flight.stop()

        flight = run.fly(operator=work)
    v = flight.recorder.states[:, 1, 2:4]
    silent, still = ticks
    assert v[silent] == pytest.approx([0.0, -0.2], abs=0.02)
    assert np.hypot(*v[still]) < 1e-6
    assert np.hypot(*v[-1]) > 0.1
    assert np.hypot(v[:, 0], v[:, 1]).max() <= 0.2 + 1e-12
    assert np.hypot(*np.diff(v, axis=0).T).max() <= 0.1 * 0.05 + 1e-12
    drivers = [change.control.driver for change in run.server.changes]
    assert drivers == ["teleop", "teleop", "waypoints"]


def change(flight: Any) -> None:
    """Send operators' controls at fixed ticks of a run."""
    tick = flight.world.tick
    if tick == 60:
        flight.assign_driver("ugv_0", "wander")
    if tick == 100:
        flight.order(Law(name="linear"))
    if tick == 150:
        flight.assign_driver("ugv_0", "teleop")
    if 150 <= tick < 220 and tick % 4 == 0:
        flight.teleoperate("ugv_0", Teleoperation(operator="a person", velocity=(0.15, -0.1)))


@pytest.mark.parametrize("victim", ["uav_0", "ugv_0"])
def test_rejoined_vehicle_knows_changes_and_messages(victim, tmp_path):
    expected = fly(load_scenario("escort", overrides=["duration=20.0"]), 7, on_tick=change)[0]
    with stage(tmp_path, 400, respawn=True) as run:
        run.start("uav_0" if victim == "ugv_0" else "ugv_0")
        run.start(victim, until=205, again=True)
        flight = run.fly(lambda: change(run.server.flight))
    assert flight.answers.first_missing is None
    assert flight.recorder.sha256() == expected.recorder.sha256()
    assert flight.recorder.sha256() != local_flight(400).recorder.sha256()
