"""A recording holds the messages of each tick, and those of operators with their ticks."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from flights import HERE, escort, pairs
from refusals import refused

pytest.importorskip("foxglove", reason="the extra [record] is not installed")
pytest.importorskip("mcap", reason="the extra [record] is not installed")

from bus.errors import ScenarioError
from bus.messages.control import Action, Change, Control
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from bus.messages.vehicle import Teleoperation
from observed import Observer
from outrider.recording.mcap_file import RecordingFile
from outrider.recording.reader import entries, flight_of, load
from outrider.recording.refly import refly, restore
from outrider.recording.schemas import Commands, OperatorCommand, head_of
from outrider.recording.writer import FlightRecorder
from outrider.running.flying import InProcess, make_pilots
from sim.scenario.loading import load_scenario
from sim.scenario.types import Detections, Scenario
from sim.scenario.vehicle_types import Ugv
from sim.server.flight import Flight

PAIRS = pairs(
    (HERE, (12.0, 21.0)),
    ({"position": HERE, "goals": ((26.0, 21.0),)}, (12.0, 20.0)),
    detections=Detections(noise=0.1, dropout=0.3, rate=10.0),
    duration=8.0,
    name="pairs",
)
ONE = escort(
    ugv=Ugv(position=(20.0, 21.0), goals=((26.0, 21.0), (12.0, 25.0))),
    detections=Detections(dropout=0.2),
    duration=10.0,
    name="said",
)
ABOVE = load_scenario("courtyard", overrides={"duration": 10.0})
ENCODE = msgspec.json.Encoder().encode


@pytest.mark.parametrize("scenario", [PAIRS, ONE, ABOVE], ids=["two pairs", "one pair", "above"])
def test_every_tick_is_recorded_as_its_messages(scenario: Scenario, tmp_path: Path) -> None:
    path, flight = tmp_path / "run.mcap", Flight(scenario, 3)
    recorder, truths = FlightRecorder(path, scenario, 3), [flight.truth()]

    def follow() -> None:
        recorder.tick(flight)
        truths.append(flight.truth())

    flight.fly(InProcess(make_pilots(scenario, 3)), on_tick=follow)
    recorder.close()
    commands = []
    for truth in truths[1:]:
        accelerations = {name: one.command for name, one in truth.vehicles.items()}
        climbs = {uav.name: truth.vehicles[uav.name].vertical_acceleration for uav in scenario.uav}
        vertical = climbs if scenario.has_altitude else {}
        commands.append(
            Commands(tick=truth.tick - 1, accelerations=accelerations, vertical=vertical)
        )
    found = [(entry.topic, entry.data) for entry in entries(path)]
    assert [data for topic, data in found if topic == "/truth"] == [ENCODE(one) for one in truths]
    assert [data for topic, data in found if topic == "/commands"] == list(map(ENCODE, commands))
    missed = sum(truth.escorts[0].detection is None for truth in truths)
    assert 0 < missed < len(truths)


ACTIONS = {
    0: [("teleoperate", "ugv_0", Teleoperation(operator="anna", velocity=(0.1, 0.0)))],
    7: [("assign_driver", "ugv_0", "teleop")],
    9: [
        ("teleoperate", "ugv_0", Teleoperation(operator="anna", velocity=(0.1, 1.0 / 3.0))),
        ("teleoperate", "ugv_0", Teleoperation(operator="ben", goal=(21.0, 22.0))),
        ("teleoperate", "ugv_0", Teleoperation(operator="ben", speed=-0.1, turn_rate=0.2)),
    ],
    20: [("degrade", LinkKind.RADIO, "uav_0", LinkSettings(loss=0.5))],
    40: [("order", Law(name="switching"))],
    41: [
        ("assign_driver", "ugv_0", "teleop"),
        ("teleoperate", "ugv_0", Teleoperation(operator="anna")),
    ],
}


class Operated(InProcess):
    """Operators that act at their ticks, as listed above."""

    def __init__(self, flight: Flight) -> None:
        super().__init__(make_pilots(flight.scenario, flight.seed))
        self._flight = flight
        self.received: list[Teleoperation] = []

    def begin(self, tick: int) -> None:
        for what, *arguments in ACTIONS.get(tick, ()):
            getattr(self._flight, what)(*arguments)

    def publish(self, observations: Any) -> None:
        self.received += observations["ugv_0"].operator
        super().publish(observations)


def test_operator_messages_and_changes_are_recorded_with_ticks(tmp_path: Path) -> None:
    path, flight = tmp_path / "run.mcap", Flight(ONE, 3)
    recorder, exchange = FlightRecorder(path, ONE, 3), Operated(flight)
    flight.fly(exchange, on_tick=lambda: recorder.tick(flight))
    recorder.close()
    recording = flight_of(path)
    assert [word.tick for _, word in recording.operator_commands] == [0, 9, 9, 9, 41]
    assert {ugv for ugv, _ in recording.operator_commands} == {"ugv_0"}
    assert [
        OperatorCommand(tick=command.tick, **msgspec.structs.asdict(received))
        for (_, command), received in zip(
            recording.operator_commands, exchange.received, strict=True
        )
    ] == [command for _, command in recording.operator_commands]
    radio = {"link": LinkKind.RADIO, "vehicle": "uav_0", "settings": LinkSettings(loss=0.5)}
    assert recording.changes == [
        Change(tick=7, control=Control(action=Action.DRIVER, vehicle="ugv_0", driver="teleop")),
        Change(tick=20, control=Control(action=Action.LINK, **radio)),
        Change(tick=40, control=Control(action=Action.LAW, law=Law(name="switching"))),
        Change(tick=41, control=Control(action=Action.DRIVER, vehicle="ugv_0", driver="teleop")),
    ]
    found = list(entries(path))
    times = [entry.time for entry in found]
    assert times == sorted(times)
    stamps = [entry.time for entry in found if entry.topic in ("/ugv_0/operator", "/changes")]
    assert stamps == [round(tick * ONE.dt * 1e9) for tick in (0, 7, 9, 9, 9, 20, 40, 41, 41)]
    assert refly(recording).trajectory_sha256 == flight.recorder.sha256()
    for known in (flight, restore(recording)):
        assert (known.law, known.drivers) == (Law(name="switching"), {"ugv_0": "teleop"})


def test_an_observer_writes_each_change_once(tmp_path: Path) -> None:
    observer, flight = Observer(RecordingFile(tmp_path / "run.mcap"), ONE), Flight(ONE, 3)
    changes = [
        Change(tick=k // 2, control=Control(action=Action.STEP, ticks=1 + k % 3)) for k in range(60)
    ]
    for count in (0, 0, 1, 3, 3, 18, 22, 41, 60, 60):  # a status contains the last 20 changes
        observer.receive(flight, changes=tuple(changes[max(0, count - 20) : count]))
        observer.recorder.record(0.0)
        flight.apply({})
    observer.recorder.close()
    assert load(tmp_path / "run.mcap")[0].changes == changes


def test_undecodable_teleoperation_is_one_line(tmp_path: Path) -> None:
    from mcap.writer import Writer  # noqa: PLC0415 - an extra

    path = tmp_path / "bad.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        messages = (("/scenario", ENCODE(head_of(ONE, 3))), ("/ugv_0/operator", b'{"tick":-1}'))
        for topic, data in messages:
            writer.add_message(writer.register_channel(topic, "json", 0), 0, data, 0)
        writer.finish()
    with refused(ScenarioError, r"bad\.mcap: /ugv_0/operator at 0 s"):
        load(path)
