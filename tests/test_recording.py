"""Recordings: exact, complete up to the last half second after a kill, flown again to the same bits, drawn."""

import json
import math
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from flights import HERE, escort
from processes import wait_until
from staging import stage
from worlds import SCENARIOS

pytest.importorskip("foxglove", reason="the extra [record] is not installed")
pytest.importorskip("mcap", reason="the extra [record] is not installed")

from mcap.reader import make_reader

from bus import keys
from bus.errors import ScenarioError
from bus.keys import KEYS
from bus.messages.scenario import Law
from bus.messages.vehicle import UavCommand
from observed import recorded
from outrider.recording.mcap_file import RecordingFile
from outrider.recording.observer import RunRecorder
from outrider.recording.reader import (
    Damage,
    Recording,
    coverages,
    entries,
    flight_of,
    load,
    statuses,
    stream,
)
from outrider.recording.refly import refly, restore
from outrider.recording.repair import repair
from outrider.recording.schemas import (
    CHANGES,
    COMMANDS,
    TOPICS,
    TRUTH,
    OperatorCommand,
    head_of,
    inlined_schema,
    read_head,
)
from outrider.recording.writer import FlightRecorder
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.summary import summarize
from sim.scenario.types import Detections, Scenario
from sim.scenario.vehicle_types import Uav, Ugv
from sim.server.flight import Flight
from tabular import words

SCENARIO = escort(
    "logarithmic",
    uav=Uav(position=HERE, velocity=(-0.0, 0.1)),
    ugv=Ugv(position=(20.0, 21.0), goals=((26.0, 21.0), (12.0, 25.0))),
    detections=Detections(noise=0.1, dropout=0.1, rate=10.0),
    duration=40.0,
    name="recorded",
)
SHORT = escort(ugv=Ugv(position=(20.0, 21.0), goals=((26.0, 21.0),)), duration=3.0, name="short")
SEED = 5


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Flight]:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    return path, recorded(path, SCENARIO, SEED)


def plain(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return time and data of each channel in the order in which the library `mcap` reads the file."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


@pytest.mark.parametrize(
    "message",
    dict.fromkeys([*(row.message for row in (*KEYS, *TOPICS)), CHANGES.message, OperatorCommand]),
)
def test_no_schema_refers_to_another(message: type[Any]) -> None:
    schema = inlined_schema(message)
    text = json.dumps(schema)
    assert "$ref" not in text
    assert "$defs" not in text
    assert schema["type"] == "object"
    assert set(schema["properties"]) == set(message.__struct_fields__)


def test_closed_file_has_every_message_in_time_order(flown):
    path, flight = flown
    found = plain(path)
    viewers = {"/tf", "/scene", "/grid", "/log", "/pose/uav_0", "/pose/ugv_0"}
    assert set(found) == {topic.name for topic in TOPICS} | viewers
    ticks = flight.recorder.ticks
    assert [stamp for stamp, _ in found["/truth"]] == [
        round(k * SCENARIO.dt * 1e9) for k in range(ticks + 1)
    ]
    assert len(found["/commands"]) == ticks
    assert len(found["/coverage"]) == len(found["/grid"]) >= SCENARIO.duration
    with path.open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages()]
    assert times == sorted(times)
    written = [entry.time for entry in entries(path)]
    assert written == sorted(written)
    assert len(written) == len(times)


def test_every_float_comes_back_exactly(flown: tuple[Path, Flight]) -> None:
    path, flight = flown
    states, escorts = flight.recorder.states, flight.recorder.escorts
    for k, truth in enumerate(flight_of(path).truths):
        assert truth.tick == k
        assert truth.time == k * SCENARIO.dt
        for n, name in enumerate(flight.world.names):
            vehicle = truth.vehicles[name]
            packed = struct.pack("<4d", *vehicle.position, *vehicle.velocity)
            assert packed == states[k, n, :4].tobytes()  # also -0.0
            if k:
                assert vehicle.acceleration == tuple(states[k - 1, n, 4:6])
        seen = truth.escorts[0]
        assert (seen.distance, seen.coverage_error) == tuple(escorts[k, 0, :2])
        assert (seen.detection is None) == math.isnan(escorts[k, 0, 2])
        assert seen.detection is None or seen.detection == tuple(escorts[k, 0, 2:4])
        assert (seen.report is None) == (k == 0)
        assert seen.report is None or seen.report.estimate == tuple(escorts[k - 1, 0, 4:6])


UNBOUNDED = escort(
    Law(name="tracking"),
    uav=Uav(position=HERE, max_speed=math.inf, max_acceleration=math.inf),
    ugv=Ugv(position=(20.0, 21.0), goals=((26.0, 21.0),)),
    duration=2.0,
)


@pytest.mark.parametrize(
    "scenario",
    [SCENARIOS["lost commands"], SCENARIOS["wind"], UNBOUNDED],
    ids=words("trajectories wind infinity"),
)
def test_any_scenario_is_flown_again_and_restored(scenario: Scenario, tmp_path: Path) -> None:
    """Trajectories, wind, and infinite bounds."""
    flight = recorded(tmp_path / "run.mcap", scenario, SEED)
    recording = flight_of(tmp_path / "run.mcap")
    assert recording.scenario == scenario
    found = refly(recording)
    assert (found.difference, found.note, found.ticks) == (None, "", flight.recorder.ticks)
    assert found.trajectory_sha256 == found.recorded_sha256 == flight.recorder.sha256()
    again = restore(recording).recorder
    assert again.sha256() == flight.recorder.sha256()
    assert again.reference.tobytes() == flight.recorder.reference.tobytes()


def test_a_command_is_what_was_asked_for_before_the_bounds(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder, flight = FlightRecorder(path, SCENARIO, SEED), Flight(SCENARIO, SEED)
    asked = [(0.1 * k, -7.0 / 3.0) for k in range(30)]
    for k, u in enumerate(asked):
        flight.recorder.record(flight.answers.reports)
        # beyond u_max; the UGV receives nothing and finally brakes
        flight.apply({"uav_0": UavCommand(tick=k, acceleration=u)})
        recorder.tick(flight)
    flight.recorder.record(flight.answers.reports)
    recorder.close()
    recording = flight_of(path)
    assert [recording.commands[k].accelerations["uav_0"] for k in range(30)] == asked
    assert [truth.vehicles["uav_0"].command for truth in recording.truths[1:]] == asked
    applied = [truth.vehicles["uav_0"].acceleration for truth in recording.truths]
    assert all(math.hypot(*u) < 0.3 + 1e-12 for u in applied)
    assert refly(recording).trajectory_sha256 == flight.recorder.sha256()


@pytest.mark.parametrize(("tick", "vehicle"), [(0, "uav_0"), (300, "ugv_0"), (799, "uav_0")])
def test_a_changed_command_is_found_at_its_tick(flown, tick, vehicle, tmp_path, command):
    recording, file = flight_of(flown[0]), RecordingFile(tmp_path / "other.mcap")
    asked = recording.commands[tick]
    changed = {**asked.accelerations, vehicle: (asked.accelerations[vehicle][0] * 0.5 + 1e-9, 0.0)}
    recording.commands[tick] = msgspec.structs.replace(asked, accelerations=changed)
    file.begin(recording.head, recording.scenario)
    for truth in recording.truths:
        file.take(TRUTH, truth, truth.time)
        if truth.tick in recording.commands:
            file.take(COMMANDS, recording.commands[truth.tick], truth.time)
    file.close()
    found = command("replay", tmp_path / "other.mcap", "--refly", "--json")
    assert found.returncode == 1
    output = json.loads(found.stdout)
    assert output["same"] is False
    assert (output["difference"]["tick"], output["difference"]["vehicle"]) == (tick + 1, vehicle)


def test_the_restored_flight_sums_up_like_the_live_one(flown: tuple[Path, Flight]) -> None:
    path, flight = flown
    recording = flight_of(path)
    restored = restore(recording)
    assert all(link.sent for name, link in recording.links.items() if "operator" not in name)
    summary = msgspec.structs.replace(summarize(restored, seconds=1.0), links=recording.links)
    assert summary == summarize(flight, seconds=1.0)
    assert (restored.world.coverage == flight.world.coverage).all()


def test_the_map_is_the_ground(flown: tuple[Path, Flight]) -> None:
    path, flight = flown
    maps = list(coverages(path))
    assert [ground.tick for ground in maps[:3]] == [0, 1, 21]
    last = maps[-1]
    assert last.tick == flight.recorder.ticks
    share = (
        (flight.world.coverage * (255.0 / SCENARIO.coverage.desired)).clip(0.0, 255.0).astype("u1")
    )
    assert last.cells == share.tobytes()
    assert (last.rows, last.columns) == flight.world.coverage.shape


def test_status_and_log_describe_the_run(tmp_path: Path) -> None:
    blind = escort("coverage", ugv=Ugv(position=(20.0, 21.0), goals=((30.0, 21.0),)), duration=60.0)
    path = tmp_path / "run.mcap"
    recorder = FlightRecorder(path, blind, 0)
    recorder.event("everybody is here")

    def follow(flight: Flight) -> None:
        recorder.tick(flight)
        if flight.world.tick == 100:
            recorder.event("somebody coughed")

    flight, _ = fly(blind, 0, on_tick=follow)
    recorder.close()
    messages = list(statuses(path))
    assert (messages[0].over, messages[-1].over) == (False, True)
    assert messages[-1].tick == flight.recorder.ticks
    lost = flight.recorder.escorts[:, 0, 0] >= blind.visibility.radius
    assert lost.any()
    events = (b"everybody is here", 1), (b"somebody coughed", 100), (b"lost sight", lost.argmax())
    log = plain(path)["/log"]
    for line, tick in events:
        when = round(tick * blind.dt * 1e9)
        assert any(line in data and time == when for time, data in log)


def test_a_run_that_is_reset_has_several_flights_in_one_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = FlightRecorder(path, SCENARIO, SEED)
    flights = [Flight(SCENARIO, SEED), Flight(SCENARIO, 9, episode=1)]

    def on_tick() -> None:
        recorder.tick(flight)
        if flight.world.tick == 60:
            flight.stop()

    for flight in flights:
        flight.fly(InProcess(make_pilots(flight.scenario, flight.seed)), on_tick=on_tick)
    recorder.close()
    found = load(path)
    assert [flight.head.seed for flight in found] == [SEED, 9]
    assert [len(flight.truths) for flight in found] == [61, 61]
    assert [refly(flight).trajectory_sha256 for flight in found] == [
        flight.recorder.sha256() for flight in flights
    ]
    times = [entry.time for entry in entries(path)]
    assert times == sorted(times)
    assert flight_of(path).number == 1
    assert flight_of(path, 0).head.seed == SEED
    with pytest.raises(ScenarioError, match="allowed: 0 to 1"):
        flight_of(path, 2)


_ENDLESS = """
import sys, time
from pathlib import Path
from outrider.recording.writer import FlightRecorder
from outrider.running.flying import fly
from sim.scenario.loading import load_scenario
scenario = load_scenario("escort", overrides={"duration": 100000.0})
recorder = FlightRecorder(Path(sys.argv[1]), scenario, 3)
def follow(flight):
    recorder.tick(flight)
    if flight.world.tick % 2 == 0:
        sys.stdout.write(f"{flight.world.tick} {time.monotonic()}\\n")
        sys.stdout.flush()
    time.sleep(0.008)
fly(scenario, 3, on_tick=follow)
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[int, float]], float]:
    """Record a run that is killed with SIGKILL; return the file, the times of its ticks, and the time of the kill."""
    path = tmp_path_factory.mktemp("killed") / "run.mcap"
    process = subprocess.Popen(
        [sys.executable, "-c", _ENDLESS, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    reached: list[tuple[int, float]] = []
    for line in process.stdout:
        tick, when = line.split()
        reached.append((int(tick), float(when)))
        if any(before > 30 and then < float(when) - 1.0 for before, then in reached):
            break
    process.kill()
    now = time.monotonic()
    reached += [
        (int(line.split()[0]), float(line.split()[1]))
        for line in process.stdout
        if line.endswith("\n")
    ]
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL
    return path, reached, now


def test_a_kill_costs_half_a_second_at_most(killed):
    path, reached, now = killed
    recording = flight_of(path)
    assert recording.damage.reason
    last = recording.truths[-1].tick
    assert recording.missing_ticks == 0
    safe = max(tick for tick, when in reached if when < now - 0.5)
    assert last >= safe > 30
    found = refly(recording)
    assert (found.difference, found.ticks) == (None, last)


def test_a_repaired_file_opens_in_the_plain_reader(killed, tmp_path):
    path, out = killed[0], tmp_path / "saved.mcap"
    saved = repair(path, out)
    assert saved.reason
    found, before = plain(out), list(entries(path))
    assert sum(len(messages) for messages in found.values()) == saved.messages == len(before)
    assert [data for _, data in found["/truth"]] == [
        entry.data for entry in before if entry.topic == "/truth"
    ]
    assert not flight_of(out).damage.reason
    assert refly(flight_of(out)).trajectory_sha256 == refly(flight_of(path)).trajectory_sha256
    with pytest.raises(ScenarioError, match="the damaged file itself"):
        repair(path, path)


def test_a_file_cut_anywhere_gives_a_prefix_or_one_line(tmp_path: Path) -> None:
    path, cut = tmp_path / "run.mcap", tmp_path / "cut.mcap"
    recorded(path, SHORT, SEED)
    data, whole = path.read_bytes(), flight_of(path).truths
    starts = [8]  # of the records: kind, length and content
    while starts[-1] + 9 <= len(data):
        (length,) = struct.unpack_from("<Q", data, starts[-1] + 1)
        starts.append(starts[-1] + 9 + length)
    offsets = {0, 1, 7, 8, 9, len(data) - 1, len(data) - 8, len(data) - 9}
    offsets |= {at + offset for at in starts for offset in (0, 4, 9, 12) if at + offset < len(data)}
    offsets |= set(range(0, len(data), max(1, len(data) // 30)))
    lengths = set()
    for offset in sorted(offsets):
        cut.write_bytes(data[:offset])
        recording = _read_or_one_line(cut)
        length = len(recording.truths) if recording else 0
        if recording is not None and length not in lengths:
            assert recording.truths == whole[:length]
            assert refly(recording).difference is None
        lengths.add(length)
    assert lengths >= {0, len(whole)}


def _read_or_one_line(path: Path) -> Recording | None:
    try:
        return flight_of(path)
    except ScenarioError as error:
        line = str(error)
    assert str(path) in line
    assert "\n" not in line
    return None


def test_damaged_bytes_end_the_reading_without_false_data(tmp_path: Path) -> None:
    path, hurt = tmp_path / "run.mcap", tmp_path / "hurt.mcap"
    recorded(path, SHORT, SEED)
    data, whole = bytearray(path.read_bytes()), flight_of(path).truths
    for offset in range(8, len(data), max(1, len(data) // 150)):
        data[offset] ^= 0xFF
        hurt.write_bytes(data)
        data[offset] ^= 0xFF
        recording = _read_or_one_line(hurt)
        assert recording is None or recording.truths == whole[: len(recording.truths)]


def test_a_file_of_another_version_is_refused() -> None:
    head = msgspec.json.encode(head_of(SCENARIO, 1))
    assert read_head(head, file="x").seed == 1
    old = head.replace(b'"format":1', b'"format":7').replace(b'"seed"', b'"corn"')
    with pytest.raises(ScenarioError, match=r"old\.mcap: recording of format 7; allowed: 1"):
        read_head(old, file="old.mcap")
    for other in (b"", b"{}", b"[]", b'{"format":-1}', b"\xff", b'{"format":1,"seed":1}'):
        with pytest.raises(ScenarioError, match=r"old\.mcap"):
            read_head(other, file="old.mcap")


def test_replay_prints_the_runs_numbers(flown, command):
    path, flight = flown
    for options in (("--json",), ("--refly", "--json")):
        found = command("replay", path, *options)
        assert found.returncode == 0, found.stderr
        output = json.loads(found.stdout)
        assert output["trajectory_sha256"] == flight.recorder.sha256()
        assert output["ticks"] == flight.recorder.ticks
    assert 0 < json.loads(command("replay", path, "--json").stdout)["bytes_per_minute"] < 2e6
    assert command("replay", path, "--realtime", "1000000").returncode == 0


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n\x01"])
@pytest.mark.parametrize(
    "arguments",
    [("replay",), ("replay", "--refly"), ("render", "-o", "x.gif"), ("record", "--repair")],
)
def test_what_is_no_recording_gives_one_line(tmp_path, content, arguments, command):
    (tmp_path / "no.mcap").write_bytes(content)
    for name in ("no.mcap", "absent.mcap"):
        found = command(*arguments, tmp_path / name)
        (line,) = found.stderr.splitlines()
        assert found.returncode == 2
        assert name in line


@pytest.mark.parametrize("encoding", ["json", "cdr"])
def test_another_programs_mcap_is_refused(tmp_path: Path, encoding: str) -> None:
    from mcap.writer import Writer  # noqa: PLC0415 - an extra

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/odom", encoding, 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(ScenarioError, match="not a recording made by Outrider"):
        load(path)
    assert [entry.topic for entry in entries(path)] == ["/odom"] * (encoding == "json")
    damage = Damage()
    assert list(stream(path, damage))
    assert not damage.reason


def test_full_disk_is_reported_and_does_not_end_the_run() -> None:
    with pytest.raises(OSError, match="No space left"):
        FlightRecorder(Path("/dev/full"), SCENARIO, SEED)


def test_an_observer_records_a_run_in_progress_to_the_same_bits(tmp_path, command):
    path = tmp_path / "run.mcap"
    with stage(tmp_path, 0, scenario=msgspec.structs.replace(SCENARIO, seed=SEED)) as run:
        recorder = RunRecorder(run.client("observer"), RecordingFile(path), None)

        def observe() -> None:
            while not recorder.over:
                recorder.record(0.2)
            recorder.close()

        with ThreadPoolExecutor(1) as threads:
            work = threads.submit(observe)
            run.start_both()
            truths = run.server_session.outbox(keys.TRUTH)
            wait_until(lambda: truths.wanted)
            flight = run.fly()
            work.result(30.0)
    recording = flight_of(path)
    assert recording.missing_ticks == 0
    assert len(recording.truths) == flight.recorder.ticks + 1
    distances = [truth.escorts[0].distance for truth in recording.truths]
    assert distances == flight.recorder.escorts[:, 0, 0].tolist()
    assert [*statuses(path)][-1].vehicles["uav_0"].present
    ground = [*coverages(path)][-1]
    assert len(ground.cells) == ground.rows * ground.columns == flight.world.coverage.size
    assert recording.head.scenario is None
    with pytest.raises(ScenarioError, match="without the scenario"):
        refly(recording)
    known = replace(recording, head=head_of(SCENARIO, SEED))
    assert refly(known).trajectory_sha256 == flight.recorder.sha256()
    assert command("replay", str(path), "--json").returncode == 0
    assert command("render", str(path), "-o", str(tmp_path / "x.png")).returncode == 0


def test_a_picture_and_a_film_are_drawn(flown, tmp_path, command):
    from PIL import Image  # noqa: PLC0415 - an extra

    for name, arguments in (("run.png", ()), ("run.gif", ("--realtime", "100", "--fps", "10"))):
        found = command("render", str(flown[0]), "-o", str(tmp_path / name), *arguments)
        assert found.returncode == 0, found.stderr
    with Image.open(tmp_path / "run.png") as picture:
        assert picture.size == (1400, 800)
    with Image.open(tmp_path / "run.gif") as film:
        assert getattr(film, "n_frames", 1) == 5
        film.seek(4)
        colors = Counter(struct.iter_unpack("3B", film.convert("RGB").tobytes()))
    red = sum(count for (r, g, b), count in colors.items() if r > 190 and g < 90 and b < 100)
    blue = sum(count for (r, g, b), count in colors.items() if r < 60 and g < 120 and b > 170)
    green = sum(count for (r, g, b), count in colors.items() if g > r + 30 and g > b + 10)
    assert min(red, blue, green / 100) > 200


def test_a_film_as_mp4_needs_ffmpeg_and_gives_it_every_frame(flown, tmp_path, monkeypatch, command):
    monkeypatch.setenv("PATH", str(tmp_path))
    refused = command("render", str(flown[0]), "-o", str(tmp_path / "run.mp4"))
    assert refused.returncode == 2
    assert "ffmpeg" in refused.stderr
    program = tmp_path / "ffmpeg"
    # like ffmpeg, which treats text before ':' as a protocol
    program.write_text(
        "#!/bin/sh\nfor last; do :; done\n"
        'case "$last" in /*) /bin/cat > "$last" ;; *) echo no such protocol >&2; exit 1 ;; esac\n'
    )
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    made = command("render", str(flown[0]), "-o", "run:1.mp4", "--realtime", "200")
    assert made.returncode == 0
    lines, rest = divmod((tmp_path / "run:1.mp4").stat().st_size, 800 * 4 * 5)  # 5 frames
    assert (lines > 300, rest) == (True, 0)
    program.write_text("#!/bin/sh\necho no such codec >&2\nexit 1\n")
    failed = command("render", str(flown[0]), "-o", str(tmp_path / "run.mp4"))
    assert (failed.returncode, "no such codec" in failed.stderr) == (1, True)
