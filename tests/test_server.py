"""The simulator behind the bus: what it counts, names and tells, with real sessions and vehicles that misbehave."""

import re
import threading
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from bus.keys import (
    BRIEFING,
    COMMAND,
    COVERAGE,
    OBSERVATION,
    SAMPLED_TRUTH,
    STATUS,
    TRUTH,
    Party,
    Role,
)
from bus.messages import (
    Command,
    CoverageMap,
    Status,
    Truth,
    UavBriefing,
    UavCommand,
    UgvBriefing,
    UgvCommand,
)
from bus.session import Outbox, Session, open_session
from sim.scenario.loading import load_scenario
from sim.server.flight import Flight
from sim.server.run_timing import Timing
from sim.server.serving import Server

KIND: dict[Role, Callable[..., Command]] = {Role.UAV: UavCommand, Role.UGV: UgvCommand}
Answer = Callable[[Outbox, Role, int], None]


def honest(outbox: Outbox, role: Role, tick: int) -> None:
    outbox.send(KIND[role](tick=tick, acceleration=(0.01, 0.0)))


def silent(outbox: Outbox, role: Role, tick: int) -> None:
    pass


def confused(outbox: Outbox, role: Role, tick: int) -> None:
    """Answers the next tick, this one, and this one again."""
    for answered in (tick + 1, tick, tick):
        outbox.send(KIND[role](tick=answered, acceleration=(0.01, 0.0)))


def _fly(session: Session, party: Party, answer: Answer, told: list[object]) -> None:
    briefings = session.inbox(BRIEFING[party.role], party.name)
    observations = session.inbox(OBSERVATION[party.role], party.name)
    outbox = session.outbox(COMMAND[party.role], party.name)
    session.announce()
    letter = briefings.receive(20.0)
    told.append(letter.message if letter else None)
    while (letter := observations.receive(20.0)) is not None and not getattr(
        letter.message, "over", True
    ):
        answer(outbox, party.role, getattr(letter.message, "tick", -1))


class Run:
    """A flight with its sessions, in threads of this process."""

    def __init__(self, stack, endpoint, ticks, answers, deadline):
        scenario = load_scenario("escort", overrides=[f"duration={ticks * 0.05!r}", "hold=0.1"])
        simulator = Party(role=Role.SIMULATOR, name="simulator")
        self.events: list[str] = []
        self.told: dict[str, list[object]] = {name: [] for name in answers}
        session = stack.enter_context(open_session(simulator, "run", listen=(endpoint,)))
        self.server = Server(
            session, scenario, 3, Timing(deadline=deadline), on_event=self.events.append
        )
        self.observer = stack.enter_context(
            open_session(Party(role=Role.OBSERVER, name="watcher"), "run", connect=endpoint)
        )
        self._threads = []
        for name, answer in answers.items():
            party = Party(role=Role.UAV if name.startswith("uav") else Role.UGV, name=name)
            own = stack.enter_context(open_session(party, "run", connect=endpoint))
            self._threads.append(
                threading.Thread(target=_fly, args=(own, party, answer, self.told[name]))
            )

    def fly(self, on_tick: Callable[[], None] | None = None) -> Flight:
        for thread in self._threads:
            thread.start()
        flight = self.server.fly(on_tick=on_tick)
        for thread in self._threads:
            thread.join(20.0)
            assert not thread.is_alive()
        return flight


@contextmanager
def flying(folder, ticks, *, deadline=10.0, uav=honest, ugv=honest):
    with ExitStack() as stack:
        endpoint = f"unixsock-stream/{folder / 'bus.sock'}"
        yield Run(stack, endpoint, ticks, {"uav_0": uav, "ugv_0": ugv}, deadline)


def test_each_vehicle_is_told_its_own_briefing(tmp_path: Path) -> None:
    with flying(tmp_path, 3) as run:
        run.fly()
    told = (*run.told["uav_0"], *run.told["ugv_0"])
    assert [type(briefing) for briefing in told] == [UavBriefing, UgvBriefing]


STRANGER = (
    "uav_0 sees its UGV and reports no estimate: a program of your own flies it, of which the law "
    "certified tells nothing"
)


def test_honest_vehicles_miss_nothing(tmp_path: Path) -> None:
    with flying(tmp_path, 20) as run:
        flight = run.fly()
    assert flight.answers.missing == {"uav_0": 0, "ugv_0": 0}
    assert flight.answers.first_missing is None
    assert run.events == [STRANGER]


def test_an_answer_to_another_tick_or_a_second_one_is_counted_and_changes_nothing(tmp_path):
    with flying(tmp_path, 20, ugv=confused) as run:
        confused_flight = run.fly()
        status = run.server.status(1.0).vehicles["ugv_0"]
    (tmp_path / "again").mkdir()
    with flying(tmp_path / "again", 20) as run:
        honest_flight = run.fly()
    assert status.refused["answers another tick"] == 20
    assert status.refused["answers a tick twice"] >= 19  # the last one may come after the end
    assert "at tick" in status.last_fault
    assert confused_flight.answers.missing == {"uav_0": 0, "ugv_0": 0}
    assert confused_flight.recorder.sha256() == honest_flight.recorder.sha256()


def test_a_late_vehicle_is_named_with_the_tick_and_how_long(tmp_path: Path) -> None:
    with flying(tmp_path, 2, deadline=0.3, uav=silent) as run:
        flight = run.fly()
    assert flight.answers.missing == {"uav_0": 2, "ugv_0": 0}
    assert flight.answers.first_missing == 0
    assert re.fullmatch(r"uav_0 is late: no command for tick 0 after 0\.[345] s", run.events[0])


def test_a_vehicle_without_a_command_holds_its_last_one_and_then_brakes(tmp_path: Path) -> None:
    def fading(outbox: Outbox, role: Role, tick: int) -> None:
        if tick < 3:
            outbox.send(UavCommand(tick=tick, acceleration=(0.2, 0.0)))

    with flying(tmp_path, 7, deadline=0.25, uav=fading) as run:
        flight = run.fly()
    applied = flight.recorder.states[:7, 0, 4]
    assert applied[:5].tolist() == [0.2] * 5  # three of its own, two held: hold = 0.1 s
    assert (applied[5:] < 0.0).any()
    assert np.hypot(*flight.recorder.states[7, 0, 2:4]) < 0.2 * 5 * 0.05


def test_a_vehicle_that_leaves_is_named_and_the_run_goes_on(tmp_path: Path) -> None:
    class Gone(Exception):
        pass

    def leaving(outbox: Outbox, role: Role, tick: int) -> None:
        if tick == 5:
            raise Gone
        honest(outbox, role, tick)

    with flying(tmp_path, 30, uav=leaving) as run:
        uav = run._threads[0]
        body = uav.run

        def until_gone() -> None:
            try:
                body()
            except Gone:
                uav_session.close()
                uav_session._zenoh.close()

        uav_session = uav._args[0]  # type: ignore[attr-defined]
        uav.run = until_gone  # type: ignore[method-assign]
        flight = run.fly()
    assert flight.complete
    assert flight.answers.missing == {"uav_0": 25, "ugv_0": 0}
    assert run.events == [STRANGER, "uav_0 is lost at tick 5"]


def test_observers_get_truth_status_and_map(tmp_path: Path) -> None:
    with flying(tmp_path, 400) as run:
        inboxes = {
            key.topic: run.observer.inbox(key) for key in (TRUTH, SAMPLED_TRUTH, STATUS, COVERAGE)
        }
        got: dict[str, object] = {}

        def look() -> None:
            world = run.server.flight.world
            for topic, inbox in inboxes.items():
                if topic not in got or world.tick % 100 == 0:
                    letter = inbox.receive(0.05)
                    if letter is not None:
                        got[topic] = letter.message

        flight = run.fly(on_tick=look)
    truth, status, ground = got["truth"], got["status"], got["coverage"]
    assert isinstance(truth, Truth)
    assert isinstance(got["sampled-truth"], Truth)
    assert isinstance(status, Status)
    assert isinstance(ground, CoverageMap)
    row = flight.recorder.states[truth.tick]
    assert truth.vehicles["uav_0"].position == tuple(row[0, :2].tolist())
    assert truth.vehicles["ugv_0"].velocity == tuple(row[1, 2:4].tolist())
    assert truth.escorts[0].distance == flight.recorder.escorts[truth.tick, 0, 0]
    assert status.ticks == 400
    assert status.vehicles["uav_0"].present
    assert (ground.rows, ground.columns, len(ground.cells)) == (160, 160, 160 * 160)
