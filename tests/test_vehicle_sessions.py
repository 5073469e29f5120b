"""The slots of a run, with real sessions.

Second sessions, vehicles that rejoin with their past, real time, pause and step.
"""

import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from agents import process
from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.keys import BRIEFING, COMMAND, OBSERVATION, Party, Role
from bus.messages.control import Action, Control
from bus.messages.vehicle import Teleoperation, UavCommand, UgvCommand
from flights import Piloted, degraded
from outrider.running.flying import make_pilots
from processes import wait_until
from sim.engine.briefing import briefing
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable, Scenario
from sim.server.flight import Flight
from staging import GIVEN, Vehicle, client_of, hosted, local_flight, stage, zenoh_of


@pytest.mark.parametrize("victim", ["uav_0", "ugv_0"])
def test_rejoined_vehicle_with_its_past_flies_the_same_bits(victim, tmp_path):
    """Use more ticks than fit one part of a briefing; the new process knows only its briefing."""
    with stage(tmp_path, 1500, respawn=True) as run:
        run.start("uav_0" if victim == "ugv_0" else "ugv_0")
        run.start(victim, until=1233, again=True)
        flight = run.fly()
        statuses = run.server.vehicles()
    first, later = (vehicle for vehicle in run.vehicles if vehicle.name == victim)
    assert [seen.tick for seen in first.seen] == list(range(1234))
    assert [seen.tick for seen in later.seen] == list(range(1500))
    assert flight.recorder.sha256() == local_flight(1500).recorder.sha256()
    assert flight.answers.first_missing is None
    assert (statuses[victim].lost, statuses[victim].rejoined) == (1, 1)
    assert run.events == [
        f"{victim} disconnected at tick 1234",
        f"{victim} rejoined at tick 1234",
    ]


@pytest.mark.timeout(60)
@pytest.mark.parametrize("is_open", [True, False])
def test_a_vehicle_that_the_scenario_lacks_is_refused(tmp_path, is_open):
    other = load_scenario("escort", overrides={"uav.0.name": "scout", "duration": 0.5})
    with stage(tmp_path, 10, scenario=other, is_open=is_open) as run:
        assert run.client("ugv_0").is_offered()
        credential = GIVEN.of("ugv_0" if is_open else "uav_0")
        party = Party(role=Role.UAV, name=credential.name)
        own = None if is_open else credential
        with pytest.raises(ScenarioError, match=f"{party.name}: no such UAV"):
            process.fly(party, UavPilot, connect=run.endpoint, run="run", credential=own)


@pytest.mark.parametrize("scenario", [degraded(400, LinkTable()), degraded(400)], ids=["", "late"])
def test_a_past_is_what_the_vehicle_has_perceived(scenario: Scenario) -> None:
    flight = Flight(scenario, 7)
    pilots = make_pilots(scenario, 7)
    seen: dict[str, list[Any]] = {name: [] for name in pilots}
    for _ in range(300):
        flight.teleoperate("ugv_0", Teleoperation(operator="me", velocity=(0.1, 0.0)))
        observations = flight.observations()
        flight.recorder.record(flight.answers.reports)
        for name, observation in observations.items():
            # the past does not contain the flown trajectory
            seen[name].append(msgspec.structs.replace(observation, committed_trajectory=None))
        flight.apply({name: pilots[name].act(observations[name]) for name in observations})
    assert any(observation.radio for observation in seen["ugv_0"])
    assert any(not observation.detections for observation in seen["uav_0"])
    for name, own in seen.items():
        assert list(flight.past(name, 0, 300, ())) == own
        assert list(flight.past(name, 120, 180, ())) == own[120:180]
        missing = list(flight.past(name, 0, 300, range(100, 200)))
        assert missing[:100] + missing[200:] == own[:100] + own[200:]
        assert [one.position for one in missing] == [one.position for one in own]
        for kind in ("detections", "radio"):
            assert not any(getattr(one, kind, ()) for one in missing[100:200])


def test_lost_vehicle_brakes_and_returns_without_missed_data(tmp_path):
    """Without respawn the clock does not wait; detections during the absence remain unknown."""
    with stage(tmp_path, 20_000) as run:
        run.start("ugv_0")
        run.start("uav_0", until=100)
        flight, started = run.server.flight, threading.Event()
        returned: list[int] = []

        def come_back() -> None:
            if flight.world.tick >= 300 and not started.is_set():
                started.set()
                # the clock waits here, otherwise the UGV may already be out of sight
                run.start("uav_0")
                wait_until(lambda: run.server.vehicles()["uav_0"].rejoined)
                returned.append(flight.world.tick)
            if returned and flight.world.tick == returned[0] + 60:
                flight.stop()

        run.fly(come_back)
    later = run.vehicles[2].seen
    back = 101 + flight.answers.missing["uav_0"]
    assert 300 <= back <= returned[0] + 1
    assert run.events[0] == "uav_0 disconnected at tick 101"
    assert [seen.tick for seen in later[:back]] == list(range(back))
    assert sum(bool(seen.detections) for seen in later[:101]) > 50
    assert not any(seen.detections for seen in later[102:back])
    assert sum(bool(seen.detections) for seen in later[back:]) > 20
    assert flight.answers.first_missing == 101
    assert (abs(flight.recorder.states[165:back, 0, 2:4]) < 1e-9).all()


def test_vehicle_that_does_not_return_is_given_up_once(tmp_path: Path) -> None:
    with stage(tmp_path, 60, respawn=True, join_timeout=0.4) as run:
        run.start("ugv_0")
        run.start("uav_0", until=20)
        flight = run.fly()
    assert flight.complete
    assert flight.answers.missing == {"uav_0": 39, "ugv_0": 0}
    _, given_up = run.events
    assert "did not reconnect within 0." in given_up


def test_second_session_is_counted_and_ignored(tmp_path):
    with stage(tmp_path, 400) as run:
        first, _ = run.start_both()
        intruder: dict[str, Any] = {}

        def intrude() -> None:
            tick = run.server.flight.world.tick
            if tick == 100:
                intruder["session"] = run.client("uav_0")
                intruder["commands"] = intruder["session"].outbox(COMMAND[Role.UAV], "uav_0")
                intruder["session"].announce()
                wait_until(lambda: intruder["commands"].wanted)
            if tick >= 100:
                for answered in (tick, tick + 1):
                    intruder["commands"].send(UavCommand(tick=answered, acceleration=(0.3, 0.0)))

        flight = run.fly(intrude)
        status = run.server.vehicles()["uav_0"]
    assert flight.recorder.sha256() == local_flight(400).recorder.sha256()
    assert status.rejected["comes from a second session"] >= 300
    assert status.rejected.keys() == {"comes from a second session"}
    # Its command may arrive before the news of its session: either one reports both sessions.
    assert "a second session (number 1)" in run.events[0]
    assert "the first (number 0) stays active" in run.events[0]
    assert len(run.events) == 1
    assert [seen.tick for seen in first.seen] == list(range(400))


def test_second_session_takes_a_free_number(tmp_path: Path) -> None:
    with stage(tmp_path, 300, respawn=True) as run:
        run.start("ugv_0")
        run.start("uav_0", until=150)
        spare = threading.Event()

        def stand_by() -> None:
            if run.server.flight.world.tick == 50 and not spare.is_set():
                spare.set()
                run.start("uav_0")
                wait_until(lambda: run.server.vehicles()["uav_0"].rejected != {})

        flight = run.fly(stand_by)
    assert flight.recorder.sha256() == local_flight(300).recorder.sha256()
    assert [seen.tick for seen in run.vehicles[2].seen] == list(range(300))


def test_in_real_time_a_slow_vehicle_degrades_itself_only(tmp_path: Path) -> None:
    """The UAV needs 0.1 s per answer and a tick lasts 0.025 s: its commands are used late, those of the UGV in time."""
    with stage(tmp_path, 100, realtime=2.0) as run:
        uav = run.start("uav_0", on_tick=lambda _tick: time.sleep(0.1))
        run.start("ugv_0")
        started: list[float] = []
        flight = run.fly(lambda: started.append(time.monotonic()))
        status = run.server.vehicles()
    assert started[-1] - started[0] >= 99 * 0.025 - 0.05  # never faster than requested
    assert len(uav.seen) < 50  # it answers the newest observation, and does not fall behind further
    assert uav.seen[-1].tick > 80
    assert flight.complete
    assert status["uav_0"].stale_commands >= 3
    assert status["uav_0"].missing_commands > 40
    assert status["ugv_0"].missing_commands < 20


def test_real_time_uses_commands_by_age_and_then_brakes() -> None:
    """Commands remain in effect for `command_timeout` after the tick they answer, however late they arrive."""
    scenario = load_scenario("escort", overrides=["duration=5.0", "command_timeout=0.2"])
    flight = Flight(scenario, 7)
    ugv = flight.world.names.index("ugv_0")

    def step(answered: int | None) -> float:
        commands: dict[str, Any] = {
            "uav_0": UavCommand(tick=flight.world.tick, acceleration=(0.0, 0.0))
        }
        if answered is not None:
            commands["ugv_0"] = UgvCommand(tick=answered, acceleration=(0.05, 0.0))
        flight.apply(commands)
        return float(flight.world.acceleration[ugv, 0])

    assert [step(0), *(step(None) for _ in range(4))] == [0.05] * 5  # until it is 0.2 s old
    assert step(None) < 0.0
    assert step(3) == step(None) == 0.05  # it arrives at tick 6, 3 ticks old
    assert step(None) < 0.0
    assert step(3) <= 0.0  # too late to be flown
    assert flight.answers.first_missing == 1
    assert flight.answers.missing["ugv_0"] == 7


def test_a_flight_can_be_paused_stepped_and_resumed(tmp_path: Path) -> None:
    received = threading.Event()

    def work(send: Any, awaited: Any) -> None:
        send(Control(action=Action.PAUSE))
        paused = awaited(lambda status: status.paused)
        received.set()
        send(Control(action=Action.STEP, ticks=5))
        awaited(lambda status: status.paused and status.tick == paused.tick + 5)
        send(Control(action=Action.RESUME))

    with stage(tmp_path, 300) as run:
        run.start_both()
        # slowly, so that the run does not end before the operator's message
        flight = run.fly(lambda: received.wait(0.02) and None, operator=work)
    assert flight.complete
    assert flight.recorder.sha256() == local_flight(300).recorder.sha256()


@pytest.mark.parametrize(
    "payload",
    [b'{"tick":999999,"acceleration":[0,0]}', b'{"tick":-1}'],
    ids=["readable", "unreadable"],
)
def test_a_flood_of_messages_neither_stops_the_clock_nor_the_end(payload, tmp_path):
    """The UGV answers nothing and sends without end.

    It is late like any other vehicle, and the session closes meanwhile.
    """
    over = threading.Event()
    with stage(tmp_path, 2, deadline=0.3) as run:
        ugv = run.client("ugv_0")
        ugv.announce()
        uav = run.start("uav_0")
        flooding = zenoh_of(ugv).declare_publisher(
            "outrider/run/ugv_0/command", congestion_control=zenoh.CongestionControl.BLOCK
        )

        def flood() -> None:
            while not over.is_set():
                flooding.put(payload)

        tap = threading.Thread(target=flood, daemon=True)
        tap.start()
        started = time.monotonic()
        try:
            flight = run.fly()
            elapsed = time.monotonic() - started
            refused = run.server.vehicles()["ugv_0"].rejected
            run.server_session.close()
        finally:
            over.set()
            tap.join()
    assert flight.complete
    assert flight.answers.missing == {"uav_0": 0, "ugv_0": 2}
    assert elapsed < 15.0
    assert sum(refused.values()) > 100
    assert [seen.tick for seen in uav.seen] == [0, 1]
    (late,) = (event for event in run.events if "is late" in event)  # then only counted
    assert late == "ugv_0 is late: no command for tick 0 after 1.8 s"


@pytest.mark.parametrize(("slow_at", "missing"), [(0, 0), (3, 1)])
def test_only_a_first_answer_may_take_several_deadlines(slow_at, missing, tmp_path) -> None:
    """A vehicle compiles before its first answer on a new machine."""
    with stage(tmp_path, 6, deadline=0.3) as run:
        run.start("uav_0")
        run.start("ugv_0", on_tick=lambda tick: time.sleep(0.8 if tick == slow_at else 0.0))
        flight = run.fly()
    assert flight.answers.missing["uav_0"] == 0
    assert bool(flight.answers.missing["ugv_0"]) == bool(missing)


def test_wrong_or_second_answers_are_counted_and_ignored(tmp_path):
    scenario = load_scenario("escort", overrides=["duration=1.0"])

    def confused(commands: Any, tick: int) -> None:
        """Answer the next tick, this one, and this one again."""
        for answered in (tick + 1, tick, tick):
            commands.send(UgvCommand(tick=answered, acceleration=(0.01, 0.0)))

    with stage(tmp_path, 20) as run:
        run.start("uav_0")
        run.program("ugv_0", confused)
        flight = run.fly()
        status = run.server.vehicles()["ugv_0"]
    assert status.rejected["answers another tick"] == 20
    assert status.rejected["answers a tick twice"] >= 19  # the last one may arrive after the end
    assert "at tick" in status.last_fault
    assert flight.answers.missing == {"uav_0": 0, "ugv_0": 0}
    once = Flight(scenario, scenario.seed)
    once.fly(
        Piloted(
            make_pilots(scenario, scenario.seed),
            "ugv_0",
            lambda seen: UgvCommand(tick=seen.tick, acceleration=(0.01, 0.0)),
        )
    )
    assert flight.recorder.sha256() == once.recorder.sha256()


def test_vehicle_acts_once_on_each_observation_of_its_run(endpoint: str) -> None:
    """A simulator that sends everything twice and interrupts a briefing follows one that left messages behind."""
    scenario = load_scenario("escort", overrides=["duration=5.0"])
    flight, observations = Flight(scenario, 7), list[Any]()
    for _ in range(12):
        observations.append(flight.observations()["uav_0"])
        flight.apply({})
    whole, part = briefing(scenario, "uav_0", scenario.seed), msgspec.structs.replace
    with ExitStack() as stack:
        stack.enter_context(hosted(endpoint, name="observer"))
        simulator = GIVEN.of("simulator")
        old, new = (stack.enter_context(client_of(endpoint, simulator)) for _ in range(2))
        old_briefing, briefed = (s.outbox(BRIEFING[Role.UAV], "uav_0") for s in (old, new))
        old_sight, sight = (s.outbox(OBSERVATION[Role.UAV], "uav_0") for s in (old, new))
        answers = new.inbox(COMMAND[Role.UAV], "uav_0")
        new.announce()
        vehicle = Vehicle(endpoint, "uav_0")
        wait_until(lambda: old_briefing.wanted and sight.wanted)
        old_briefing.send(part(whole, past=tuple(observations[:2]), more=True))  # interrupted
        # two sessions: their messages are not ordered otherwise
        wait_until(lambda: len(vehicle.seen) == 2)
        briefed.send(part(whole, past=tuple(observations[:3]), more=True))
        briefed.send(part(whole, past=tuple(observations[3:5])))
        wait_until(lambda: len(vehicle.seen) == 5)
        old_sight.send(observations[11])
        for k in (4, 5, 5, 6, 5, 7):
            sight.send(observations[k])
        answered = []
        while 7 not in answered:
            envelope = answers.receive(5.0)
            assert envelope is not None
            answered.append(envelope.message.tick)  # type: ignore[attr-defined]
        sight.send(part(observations[8], over=True))
        vehicle.join()
    assert answered in ([5, 6, 7], [5, 7], [6, 7], [7])  # it answers the newest observation
    acted = [seen.tick for seen in vehicle.seen]
    # it may also act on a single observation that it missed, without sending the answer
    assert acted in ([0, 1, 2, 3, 4, *later] for later in ([5, 6, 7], [5, 7], [6, 7], [7]))
    assert set(answered) <= set(acted)
