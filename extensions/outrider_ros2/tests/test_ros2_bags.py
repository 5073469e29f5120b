"""Runs as rosbag2 folders: the topics of the bridge at every tick, and the recording itself."""

import json
import re
import signal
import stat
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flights import escort
from processes import python
from refusals import refused
from stamps import seconds_of

pytest.importorskip("foxglove", reason="the extra [record] is not installed")
pytest.importorskip("rosbags", reason="the extra [ros2] is not installed")

from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from bus.errors import ScenarioError
from observed import Observer, recorded
from outrider.recording import schemas
from outrider.recording.reader import Damage, coverages, flight_of, load, statuses
from outrider.recording.refly import refly
from outrider.recording.schemas import head_of
from outrider_ros2 import bag_export
from outrider_ros2.bag_reader import import_bag
from outrider_ros2.bag_records import RECORDS, RECORDS_TYPE
from outrider_ros2.interfaces import decode, encode, make, type_hash, type_store
from outrider_ros2.ros_bag import RECORDS_QOS, RosBag, copy_flight
from outrider_ros2.run_view import view_of
from outrider_ros2.topics import TOPICS, messages_of
from sim.scenario.vehicle_types import Ugv
from sim.scene.known import geometry_of
from sim.server.flight import Flight

SCENARIO = escort(
    ugv=Ugv(position=(20.0, 21.0), goals=((26.0, 21.0),)), duration=3.0, name="bagged"
)
SEED, TICKS = 5, 60


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Record a run and convert it to a bag."""
    folder = tmp_path_factory.mktemp("bags")
    flight = recorded(folder / "run.mcap", SCENARIO, SEED)
    write_bag(folder / "run.mcap", folder / "bag")
    return SimpleNamespace(file=folder / "run.mcap", bag=folder / "bag", flight=flight)


def write_bag(recording, folder, flight=None):
    with RosBag(folder) as bag:
        for _ in copy_flight(flight_of(recording, flight), bag):
            pass


def imported(bag):
    """Import the recording of a bag into a file beside it; return the file and the damage."""
    damage, file = Damage(), bag.with_name(f"{bag.name}-imported.mcap")
    for _ in import_bag(bag, file, damage):
        pass
    return file, damage


def messages_in(bag, *topics):
    with Reader(bag) as reader:
        wanted = [one for one in reader.connections if not topics or one.topic in topics]
        return [(one.topic, time, bytes(raw)) for one, time, raw in reader.messages(wanted)]


def rewritten(bag, folder, keep=lambda _number, _topic: True):
    """Copy a bag with all or some of its messages, like a third-party tool."""
    with (
        Reader(bag) as reader,
        Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        there = {
            one.id: writer.add_connection(
                one.topic, one.msgtype, typestore=type_store(),
                offered_qos_profiles=one.ext.offered_qos_profiles,
            )
            for one in reader.connections
        }  # fmt: skip
        for number, (one, time, raw) in enumerate(reader.messages(reader.connections)):
            if keep(number, one.topic):
                writer.write(there[one.id], time, raw)
    return folder


def test_bag_has_the_topics_types_hashes_and_qos_of_the_bridge(flown):
    scene = view_of(SCENARIO.name, geometry_of(SCENARIO)).scene
    wanted = {name: (row.interface, row.qos) for row in TOPICS for _, name in row.names(scene)}
    wanted[RECORDS] = (RECORDS_TYPE, RECORDS_QOS)
    with Reader(flown.bag) as reader:
        found = {one.topic: one for one in reader.connections}
    assert set(found) == set(wanted)
    for name, (interface, qos) in wanted.items():
        (offered,) = found[name].ext.offered_qos_profiles
        assert (found[name].msgtype, found[name].digest) == (interface, type_hash(interface))
        assert offered.depth == qos.depth
        assert (offered.durability is QosDurability.TRANSIENT_LOCAL) == qos.transient_local
        assert (offered.reliability is QosReliability.RELIABLE) == qos.reliable


def test_the_metadata_count_what_is_there(flown):
    came = [topic for topic, _, _ in messages_in(flown.bag)]
    with Reader(flown.bag) as reader:
        counted = {one.topic: one.msgcount for one in reader.connections}
        total = reader.message_count
    assert counted == {name: came.count(name) for name in counted}
    assert total == len(came)
    assert counted["/clock"] == counted["/uav_0/odom"] == TICKS + 1
    assert counted["/tf_static"] == counted["/discs"] == 1
    assert counted["/uav_0/path"] == 4  # one per simulated second


def test_odometry_in_a_bag_is_the_flights_to_the_last_bit(flown):
    names, states = flown.flight.world.names, flown.flight.recorder.states
    for k, name in enumerate(names):
        poses = [
            decode("nav_msgs/msg/Odometry", raw)
            for _, _, raw in messages_in(flown.bag, f"/{name}/odom")
        ]
        rows = np.array(
            [
                (p.x, p.y, v.x, v.y)
                for p, v in ((one.pose.pose.position, one.twist.twist.linear) for one in poses)
            ]
        )
        assert rows.tobytes() == np.ascontiguousarray(states[: TICKS + 1, k, :4]).tobytes()


def test_a_bag_holds_the_very_payloads_that_the_bridge_sends(flown):
    view = view_of(SCENARIO.name, geometry_of(SCENARIO))
    always = {name for row in TOPICS if row.period == 0.0 for _, name in row.names(view.scene)}
    sent = {name: [payload] for name, payload in messages_of(view, None)}
    for truth in flight_of(flown.file).truths:
        for name, payload in messages_of(view, truth, wanted=always):
            sent.setdefault(name, []).append(payload)
    found = {}
    for topic, _, raw in messages_in(flown.bag):
        found.setdefault(topic, []).append(raw)
    for topic, payloads in sent.items():
        assert found[topic] == payloads, topic


def test_times_in_a_bag_are_the_simulated_ones(flown):
    for _, time, raw in messages_in(flown.bag, "/clock"):
        assert time == round(seconds_of(decode("rosgraph_msgs/msg/Clock", raw).clock) * 1e9)


def test_no_two_records_have_one_time(flown):
    """Tools that sort by time keep the order of records."""
    times = [time for _, time, _ in messages_in(flown.bag, RECORDS)]
    assert all(later > earlier for earlier, later in pairwise(times))


def test_bag_contains_everything_of_its_recording(flown):
    again, damage = imported(flown.bag)
    (file,), (bag,) = load(flown.file), load(again)
    assert (bag.head, bag.truths, bag.commands) == (file.head, file.truths, file.commands)
    assert not damage.reason
    for read in (statuses, coverages):
        assert list(read(again)) == list(read(flown.file))


def test_rewritten_and_split_bags_refly_to_the_same_hash(flown, tmp_path):
    whole = rewritten(flown.bag, tmp_path / "whole")
    split = rewritten(flown.bag, tmp_path / "split", lambda number, _: number >= 400)
    rewritten(flown.bag, tmp_path / "first", lambda number, _: number < 400)
    (tmp_path / "first" / "first.mcap").rename(
        split / "z_0.mcap"
    )  # file names do not define the order
    for bag in (flown.bag, whole, split):
        again = refly(flight_of(imported(bag)[0]))
        assert again.difference is None
        assert again.trajectory_sha256 == flown.flight.recorder.sha256(), bag


def test_a_bag_that_lost_a_record_is_read_up_to_there(flown, tmp_path):
    ended = rewritten(
        flown.bag, tmp_path / "cut", lambda number, topic: topic != RECORDS or number < 300
    )
    # the missing end cannot be detected; the run is flown up to there
    assert len(flight_of(imported(ended)[0]).truths) < TICKS
    cut = rewritten(
        flown.bag, tmp_path / "gap", lambda number, topic: topic != RECORDS or number > 20
    )
    file, damage = imported(cut)
    assert damage.reason == "record 0 is missing"
    assert not file.exists()


def test_a_bag_with_a_truncated_file_is_read_up_to_there(flown, tmp_path, command):
    bag = rewritten(flown.bag, tmp_path / "bag", lambda number, _: number < 400)
    rewritten(flown.bag, tmp_path / "rest", lambda number, _: number >= 400)
    raw = (tmp_path / "rest" / "rest.mcap").read_bytes()
    file = tmp_path / "again.mcap"
    first_import = json.loads(command("ros2", "import", bag, file, "--json").stdout)
    assert first_import["whole"]
    assert len(flight_of(file).truths) < TICKS
    (bag / "a.mcap").write_bytes(raw[: len(raw) // 2])
    found = json.loads(command("ros2", "import", bag, file, "--json").stdout)
    assert found["messages"] == first_import["messages"]
    assert (found["whole"], found["reason"]) == (False, "a.mcap: it ends within a record")


def test_the_command_writes_a_bag_that_it_replays(flown, tmp_path, command):
    found = command("ros2", "export", flown.file, tmp_path / "bag", "--json")
    result = json.loads(found.stdout)
    assert (result["topics"]["/tf"], result["messages"]) == (
        TICKS + 1,
        sum(result["topics"].values()),
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag"]
    file = tmp_path / "again.mcap"
    assert command("ros2", "import", tmp_path / "bag", file).returncode == 0
    again = json.loads(command("replay", file, "--refly", "--json").stdout)
    assert again["same"]
    assert "allowed: an MCAP file" in command("replay", tmp_path / "bag").stderr


def test_a_folder_that_is_there_is_not_replaced(flown, tmp_path, command):
    for words in (
        ("ros2", "export", flown.file, flown.bag),
        ("record", flown.bag, "--format", "ros2", "--connect", "tcp/127.0.0.1:1"),
    ):
        assert "exists already" in command(*words).stderr
    with pytest.raises(ScenarioError, match="exists already"):
        RosBag(flown.bag)
    with pytest.raises(FileNotFoundError):
        RosBag(tmp_path / "nowhere" / "bag")
    assert not list(tmp_path.iterdir())


def test_a_bag_whose_name_was_taken_meanwhile_is_kept(flown, tmp_path):
    bag = RosBag(tmp_path / "bag")
    for _ in copy_flight(flight_of(flown.file), bag):
        pass
    (tmp_path / "bag").mkdir()
    with pytest.raises(ScenarioError, match="exists by now; the bag is in ") as error:
        bag.close()
    kept = Path(str(error.value).partition(" is in ")[2])
    assert refly(flight_of(imported(kept)[0])).trajectory_sha256 == flown.flight.recorder.sha256()


def test_failed_export_leaves_nothing(flown, tmp_path):
    def begin():
        with RosBag(tmp_path / "bag") as bag:
            next(copy_flight(flight_of(flown.file), bag))
            assert list(tmp_path.iterdir())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        begin()
    assert not list(tmp_path.iterdir())


def test_an_interrupted_command_leaves_nothing(flown, tmp_path, monkeypatch, command):
    def interrupted(recording, bag):
        for seconds in copy_flight(recording, bag):
            signal.raise_signal(signal.SIGINT)
            yield seconds

    monkeypatch.setattr(bag_export, "copy_flight", interrupted)
    found = command("ros2", "export", flown.file, tmp_path / "bag")
    assert found.returncode == 128 + signal.SIGINT
    assert not list(tmp_path.iterdir())


def _greeting(folder, topic):
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        there = writer.add_connection(topic, RECORDS_TYPE, typestore=type_store())
        writer.write(there, 0, encode(RECORDS_TYPE, make(RECORDS_TYPE, data="hello")))


def _late(folder, _):
    record = '{"number": 0, "topic": "/truth", "time": 18446744073709551615, "message": {}}'
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        there = writer.add_connection(RECORDS, RECORDS_TYPE, typestore=type_store())
        writer.write(there, 0, encode(RECORDS_TYPE, make(RECORDS_TYPE, data=record)))


def _sqlite(folder, flown):
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3):
        pass


def _truncated(folder, flown, left=0.01):
    folder.mkdir()
    for file in flown.bag.iterdir():
        whole = file.read_bytes()
        (folder / file.name).write_bytes(
            whole[: int(left * len(whole))] if file.suffix == ".mcap" else whole
        )


def _flipped(folder, flown):
    _truncated(folder, flown, 1.0)
    (file,) = folder.glob("*.mcap")
    raw = bytearray(file.read_bytes())
    for offset in range(3000, len(raw) - 9000, 50):
        raw[offset] ^= 0x55
    file.write_bytes(raw)


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda folder, _: folder.mkdir(), "metadata.yaml is missing; allowed: the folder of"),
        (
            lambda folder, _: _greeting(folder, "/chatter"),
            "not an Outrider recording: topic /outrider/recording is missing",
        ),
        (
            lambda folder, _: _greeting(folder, RECORDS),
            "/bad.mcap: /outrider/recording at 0 s: JSON is malformed.*; allowed: records",
        ),
        (_late, r"/bad\.mcap: /truth: time = 18446744073709551615 ns: out of range"),
        (_sqlite, "no MCAP file; allowed: a bag in MCAP format"),
        (_truncated, r"no intact record \(it ends within a record\)"),
        (_flipped, r"no intact record \(damaged at byte "),
    ],
)
def test_a_folder_that_is_no_bag_of_ours_is_one_line(flown, tmp_path, spoil, line):
    spoil(tmp_path / "bad", flown)
    with refused(ScenarioError, f"^{re.escape(str(tmp_path))}/bad:? ?{line}"):
        imported(tmp_path / "bad")


@pytest.mark.parametrize(
    ("topic", "field"), [("/truth", "time"), ("/status", "time"), ("/scenario", "start")]
)
def test_times_out_of_range_in_messages_are_one_line(flown, tmp_path, topic, field):
    with flown.file.open("rb") as read, (tmp_path / "late.mcap").open("wb") as written:
        writer, channels = McapWriter(written), {}
        writer.start()
        for _, channel, message in make_reader(read).iter_messages():
            name, data = channel.topic, message.data
            if name not in channels:
                channels[name] = writer.register_channel(name, channel.message_encoding, 0)
            if name == topic:
                data = json.dumps(json.loads(data) | {field: 1e12}).encode()
            writer.add_message(channels[name], message.log_time, data, message.publish_time)
        writer.finish()
    with refused(ScenarioError, "time = .* s.*: out of range"):
        write_bag(tmp_path / "late.mcap", tmp_path / "bag")
    assert [one.name for one in tmp_path.iterdir()] == ["late.mcap"]


def without_rosbags(*words):
    """Call a command in a process in which rosbags is not installed."""
    code = "import sys; sys.modules['rosbags'] = None; sys.argv[0] = 'outrider'"
    return python(f"{code}; from outrider.cli.main import main; main()", *words, check=False)


def test_without_the_extra_it_is_named(flown, tmp_path):
    refused = without_rosbags("record", str(tmp_path / "bag"), "--format", "ros2")
    assert refused.returncode == 2
    assert "pip install -e '.[ros2]'" in refused.stderr
    done = without_rosbags("ros2", "import", str(flown.bag), str(tmp_path / "run.mcap"))
    assert done.returncode == 0, done.stderr  # an import needs no more than a recording


def observed(folder, scenario, flights=2, ticks=4):
    """Record a bag of a run with resets like an observer that receives the geometry late."""
    observer = Observer(RosBag(folder), scenario)
    for _ in range(flights):
        flight = Flight(SCENARIO, SEED)
        for tick in range(ticks):
            known_geometry = geometry_of(SCENARIO) if tick >= 2 else None
            observer.receive(
                flight, tick=tick, time=flight.world.time, ticks=ticks, geometry=known_geometry
            )
            flight.apply({})
    return observer.recorder


@pytest.mark.parametrize("known", [True, False])
def test_an_observer_records_a_run_that_is_reset_into_one_bag(tmp_path, known):
    observed(tmp_path / "live", SCENARIO if known else None).close()
    file, _ = imported(tmp_path / "live")
    first, second = load(file)
    assert [truth.tick for truth in first.truths] == [truth.tick for truth in second.truths]
    clocks = messages_in(tmp_path / "live", "/clock")
    assert len(clocks) == 8  # also those before the geometry was received
    assert [time for _, time, _ in clocks] == sorted({time for _, time, _ in clocks})
    if known:
        assert refly(flight_of(file)).difference is None
        write_bag(file, tmp_path / "first", 0)
        (copied,) = load(imported(tmp_path / "first")[0])
        assert copied.truths == first.truths


def test_run_without_a_tick_has_no_bag(tmp_path):
    with pytest.raises(ScenarioError, match="no tick was received"):
        observed(tmp_path / "live", None, flights=0).close()
    with pytest.raises(ScenarioError, match="no status contained the geometry"):
        observed(tmp_path / "live", None, flights=1, ticks=2).close()
    assert not list(tmp_path.iterdir())


def test_bag_with_a_secret_is_readable_by_its_owner_only(tmp_path):
    for secret in ("", "7" * 32):
        with RosBag(tmp_path / f"bag{secret[:1]}") as bag:
            bag.begin(head_of(SCENARIO, SEED, secret=secret), SCENARIO)
            bag.take(schemas.TRUTH, Flight(SCENARIO, SEED).truth(), 0.0)
    private = tmp_path / "bag7"
    assert stat.S_IMODE(private.stat().st_mode) == 0o700
    assert {stat.S_IMODE(file.stat().st_mode) for file in private.iterdir()} == {0o600}
    assert stat.S_IMODE((tmp_path / "bag").stat().st_mode) & 0o044
