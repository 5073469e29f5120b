"""Bags and captures as recorded links."""

import json
import math
import struct

import numpy as np
import pytest

from bus.errors import ScenarioError
from outrider_networks.recordings import read_source
from outrider_networks.source import Source
from sim.channel.recorded import recording_of

pytest.importorskip("rosbags", reason="the extra [networks] is not installed")
dpkt = pytest.importorskip("dpkt", reason="the extra [networks] is not installed")

from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402 - after the check of the extra
from rosbags.typesys import Stores, get_typestore  # noqa: E402

START = 1_700_000_000
SENT, DELAYS = np.arange(400) / 20.0, 0.02 + 0.01 * (np.arange(400) * 7 % 40) / 40
LOST = np.arange(400) % 25 == 10


def fates(source):
    """Return sent times and delays of a recording."""
    recorded, notes = read_source(source)
    found = recording_of(recorded)
    return found.sent, found.delay, notes


def a_bag(folder, sent, delays, lost, topics=("/pose",), offset=0.0):
    """Write a bag with poses that are received late or not at all, and texts."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=types)
        raw = types.serialize_cdr(types.types["std_msgs/msg/String"]("hello"), text.msgtype)
        writer.write(text, START * 10**9, raw)
        kind, header, time = (
            types.types[name]
            for name in (
                "geometry_msgs/msg/PointStamped", "std_msgs/msg/Header", "builtin_interfaces/msg/Time",
            )
        )  # fmt: skip
        point = types.types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
        for topic in topics:
            there = writer.add_connection(topic, "geometry_msgs/msg/PointStamped", typestore=types)
            for at, took, gone in zip(sent, delays, lost, strict=True):
                if not gone:
                    stamp = START * 10**9 + round(at * 1e9)
                    message = kind(header(time(stamp // 10**9, stamp % 10**9), "map"), point)
                    raw = types.serialize_cdr(message, there.msgtype)
                    writer.write(there, stamp + round((took + offset) * 1e9), raw)
    return folder


def test_bag_shows_delays_and_losses_by_header_stamps(tmp_path) -> None:
    sent, delay, notes = fates(Source(a_bag(tmp_path / "bag", SENT, DELAYS, LOST)))
    assert sent == pytest.approx(SENT, abs=1e-6)
    assert np.array_equal(np.isnan(delay), LOST)
    assert delay[~LOST] == pytest.approx(DELAYS[~LOST], abs=2e-6)
    assert "header stamps" in notes[0]


def test_uneven_stamps_show_no_losses(tmp_path) -> None:
    rng = np.random.default_rng(3)
    sent = np.cumsum(rng.exponential(0.05, 400))
    _, delay, notes = fates(Source(a_bag(tmp_path / "bag", sent, DELAYS, LOST)))
    assert not np.isnan(delay).any()
    assert any("losses do not show" in note for note in notes)


@pytest.mark.parametrize(
    ("topics", "topic", "offset", "phrase"),
    [
        (("/a", "/b"), "", 0.0, "several topics with headers; allowed: --topic with /a or /b"),
        (("/a",), "/aa", 0.0, "--topic /aa: unknown, did you mean '/a'?"),
        (("/a",), "/text", 0.0, "--topic /text: its messages have no header"),
        (("/a",), "", -0.1, "a delay is -0.08 s, as the receiver's clock is behind the sender's"),
        (("/a",), "", 1e6, "use different clocks; allowed: synchronized clocks"),
        ((), "", 0.0, "no topic with a header"),
    ],
)
def test_bag_without_usable_messages_is_refused(topics, topic, offset, phrase, tmp_path) -> None:
    folder = a_bag(tmp_path / "bag", SENT, DELAYS, LOST, topics, offset)
    with pytest.raises(ScenarioError) as caught:
        read_source(Source(folder, topic=topic))
    assert phrase in str(caught.value)


def test_damaged_bag_is_refused_in_one_line(tmp_path) -> None:
    folder = a_bag(tmp_path / "bag", SENT, DELAYS, LOST)
    for path, content in (("bag.db3", b"x" * 100), ("metadata.yaml", b"x: [")):
        file = next(one for one in folder.iterdir() if one.name.endswith(path[-4:]))
        file.write_bytes(content)
        with pytest.raises(ScenarioError, match=r"cannot be read: .*allowed: an intact rosbag2"):
            read_source(Source(folder))
    file.unlink()
    with pytest.raises(ScenarioError, match=r"metadata\.yaml is missing"):
        read_source(Source(folder))


def packet(number, payload=None, port=14550, nat=False):
    """Return an Ethernet frame with a UDP datagram, whose IPv4 identification is its number."""
    payload = struct.pack("<I", number) + b"telemetry" if payload is None else payload
    udp = dpkt.udp.UDP(sport=50000 if nat else 4000, dport=port, data=payload)
    udp.ulen = len(udp)
    ip = dpkt.ip.IP(
        src=b"\x0a\x00\x00\x01", dst=b"\x0a\x00\x00\x02", p=17, id=number % 65536, data=udp
    )
    ip.len = len(ip)
    return bytes(dpkt.ethernet.Ethernet(data=ip))


def a_capture(file, frames, form=dpkt.pcap.Writer):
    """Write frames with their times into a pcap or pcapng file."""
    with file.open("wb") as opened:
        writer = form(opened)
        for time, frame in frames:
            writer.writepkt(frame, START + time)
    return file


def captures(folder, make=packet, form=dpkt.pcap.Writer):
    """Write the captures of a flow at its sender and, behind a NAT, at its receiver."""
    sender = [(at, make(k)) for k, at in enumerate(SENT.tolist())]
    arrivals = sorted(
        (at + took, k)
        for k, (at, took, gone) in enumerate(zip(SENT.tolist(), DELAYS.tolist(), LOST, strict=True))
        if not gone
    )
    receiver = [(at, make(k, nat=True)) for at, k in arrivals]
    other = [(at + 0.01, packet(k, b"other", port=53)) for k, at in enumerate(SENT.tolist())]
    return (
        a_capture(folder / "sent.pcap", sender, form),
        a_capture(folder / "received.pcap", sorted(receiver + other), form),
    )


@pytest.mark.parametrize("form", [dpkt.pcap.Writer, dpkt.pcapng.Writer], ids=["pcap", "pcapng"])
@pytest.mark.parametrize("repeated", [False, True], ids=["numbered", "repeated"])
def test_captures_show_delays_and_losses(form, repeated, tmp_path) -> None:
    def make(number, nat=False):
        return packet(number, struct.pack("<I", number % 200) if repeated else None, nat=nat)

    sent, delay, notes = fates(Source(*captures(tmp_path, make, form)))
    assert sent == pytest.approx(SENT, abs=5e-6)
    assert np.array_equal(np.isnan(delay), LOST)
    assert delay[~LOST] == pytest.approx(DELAYS[~LOST], abs=5e-6)
    assert "an offset of the two clocks" in notes[0]


def test_messages_outside_the_receivers_capture_do_not_count_as_lost(tmp_path) -> None:
    sender, receiver = captures(tmp_path)
    with receiver.open("rb") as opened:
        later = [(t - START, raw) for t, raw in dpkt.pcap.Reader(opened) if 5.0 < t - START < 15.0]
    _, delay, _ = fates(Source(sender, a_capture(tmp_path / "part.pcap", later)))
    assert 199 <= len(delay) <= 201
    assert np.isnan(delay).sum() == LOST[100:300].sum()


def test_incomplete_end_of_a_capture_is_ignored(tmp_path) -> None:
    sender, receiver = captures(tmp_path)
    for cut in (5, 30):
        receiver.write_bytes(receiver.read_bytes()[:-cut])
        _, delay, _ = fates(Source(sender, receiver))
        assert len(delay) > 390


@pytest.mark.parametrize(
    ("case", "phrase"),
    [
        ("alone", "one capture does not show delays; allowed: with --received"),
        ("two ports", "2 UDP flows; allowed: --port with one of 53, 14550"),
        ("port", "no UDP datagram to port 7; allowed: a capture of the messages at their sender"),
        ("equal", "400 of 400 datagrams are equal to another one"),
        ("strangers", "none of the 400 datagrams of"),
        ("cut", "is cut to 0; allowed: a capture of whole packets"),
        ("fragments", "a fragmented datagram"),
        ("link", "packets of link type 105"),
        ("text", "cannot be read: "),
        ("clock", "the receiver's clock is behind the sender's"),
        ("bag option", "--topic /x: not for a capture"),
    ],
)
def test_captures_that_show_no_delays_are_refused(case, phrase, tmp_path) -> None:
    sender, receiver = captures(tmp_path)
    frames = [(at, packet(k)) for k, at in enumerate(SENT.tolist())]
    source = Source(sender, receiver)
    if case == "alone":
        source = Source(sender)
    elif case == "two ports":
        a_capture(sender, [*frames, (30.0, packet(0, port=53))])
    elif case == "port":
        source = Source(sender, receiver, port=7)
    elif case == "equal":
        a_capture(sender, [(at, packet(0, b"ping")) for at, _ in frames])
    elif case == "strangers":
        a_capture(receiver, [(at, packet(k, b"x%d" % k)) for k, (at, _) in enumerate(frames)])
    elif case == "cut":
        a_capture(sender, [(at, raw[:42]) for at, raw in frames])
    elif case == "fragments":
        raw = bytearray(frames[0][1])
        raw[20] = 0x20
        a_capture(sender, [(0.0, bytes(raw)), *frames])
    elif case == "link":
        content = bytearray(sender.read_bytes())
        content[20:24] = struct.pack("<I" if content[0] == 0xD4 else ">I", 105)
        sender.write_bytes(content)
    elif case == "text":
        receiver.write_text("hello")
    elif case == "clock":
        a_capture(receiver, [(at - 0.5, raw) for at, raw in frames])
    elif case == "bag option":
        source = source._replace(topic="/x")
    with pytest.raises(ScenarioError) as caught:
        read_source(source)
    assert phrase in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_options_of_another_format_are_refused(tmp_path) -> None:
    table, drive = tmp_path / "a.csv", tmp_path / "drive"
    table.write_text("sent,delay\n0,0.1\n")
    drive.write_text("1\n2\n")
    for source, phrase in (
        (Source(table, rate=5.0), "--rate 5.0: not for a table"),
        (Source(table, received=drive), "--received"),
        (Source(drive, port=5), "--port 5: not for a Mahimahi file"),
        (Source(tmp_path, port=5), "--port 5: not for a bag"),
        (Source(tmp_path / "none"), "cannot be read: No such file"),
    ):
        with pytest.raises(ScenarioError) as caught:
            read_source(source)
        assert phrase in str(caught.value)


def test_command_fits_captures_and_writes_their_table(here, command, monkeypatch) -> None:
    monkeypatch.setattr("outrider_networks.samples._MESSAGES", 500)
    captures(here)
    fit = ("network", "fit", "sent.pcap", "--received", "received.pcap", "--table", "drive.csv")
    done = command(*fit, "--save", "drive.toml", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["lost"] == LOST.mean()
    assert "an offset of the two clocks" in found["notes"][0]
    again = json.loads(command("network", "fit", "drive.csv", "--json").stdout)
    assert again["settings"] == found["settings"]
    assert math.isclose(again["delay"]["most"], DELAYS[~LOST].max(), abs_tol=5e-6)
