"""Recorded links: the outcome of each message against plain Python; reproducibility; invalid files."""

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.errors import ScenarioError
from bus.messages.links import LinkKind, LinkSettings
from bus.profiles import PROFILES
from flights import degraded, flown_in_both
from one_link import OneLink, conserved
from outrider.running.assumptions import assumption_warnings
from outrider.running.flying import fly
from refusals import SMALL, refusal
from seeded import a_key
from sim.channel.description import check_link, link_parameters
from sim.channel.links import first_arrivals
from sim.channel.recorded import MOST_BYTES, RecordedLink, pack
from sim.engine.batch import Batch
from sim.models.randomness import LINK_TRACE, Key, draw
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable
from sim.server.flight import Flight
from sim.world import World
from tabular import words
from worlds import step

DT = 0.05
AGED = "MEASUREMENT_TOO_OLD"
TABLE = "# by hand\nsent [s],delay [s]\n5.0,0.1\n5.2,lost\n5.3,0\n5.3,0.24\n5.5,\n5.51,0.05\n"
"""One loop takes 0.52 s, eleven ticks: the last row lasts 10 ms, like the gap before it."""
TICK_DELAYS = [0.1] * 4 + [None] * 2 + [0.24] * 4 + [None]
"""Delays of the loop at each tick of 0.05 s."""
MAHIMAHI = "0\n3\n3\n20\n20\n47\n120\n121\n260\n"


def a_trace(text: str, name: str = "trace") -> RecordedLink:
    return pack(name, text.encode())


def offset_of(key: Key, period: int) -> int:
    """Return the offset in the recording at which a run with this key starts."""
    return int(draw(key, LINK_TRACE, 0, 0)[0]) % period


def arrivals(link: OneLink, ticks: int) -> list[list[int]]:
    """Return the numbers of the messages that arrive at each tick; one is sent in every tick."""
    found = []
    for tick in range(ticks):
        link.send(tick, tick, tick)
        found.append(link.arrivals(tick))
    return found


# --- the outcome of each message


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("delay", [0.0, 0.12])
def test_message_follows_the_last_row_before_it(number: int, delay: float) -> None:
    key, ticks = a_key(number, 5), 100
    settings = LinkSettings(trace="trace", delay=delay, blackouts=((1.0, 0.75),))
    link = OneLink(settings, dt=DT, key=key, traces=(a_trace(TABLE),))
    wanted: list[list[int]] = [[] for _ in range(ticks + 20)]
    lost = 0
    for tick in range(ticks):
        took = TICK_DELAYS[(tick + offset_of(key, len(TICK_DELAYS))) % len(TICK_DELAYS)]
        if 20 <= tick < 35:
            continue
        if took is None:
            lost += 1
        else:
            wanted[tick + math.ceil(round((took + delay) / DT, 9))].append(tick)
    assert arrivals(link, ticks) == wanted[:ticks]
    status = link.counters()
    assert status.lost == {**dict.fromkeys(status.lost, 0), "trace": lost, "blackout": 15}
    assert conserved(link.counters())


def granted(
    times: list[int], size: int, queue: int, newest: bool, dt: float, offset: int, ticks: int
) -> tuple[dict[int, int], int]:
    """Return when each message leaves [ms], and the messages lost in the queue: millisecond by millisecond in plain
    Python.
    """
    period, left, lost, now = times[-1], dict[int, int](), 0, 0
    waiting: list[tuple[int, int]] = []  # message, missing bytes
    for tick in range(ticks):
        sending = 1 if waiting and waiting[0][1] < size else 0
        if len(waiting) - sending >= queue:
            lost += 1
            if newest:
                del waiting[sending]
        if len(waiting) - sending < queue:
            waiting.append((tick, size))
        until = math.floor(round((tick + 1) * dt * 1000.0, 6))
        while now < until:
            now += 1
            place = (now + offset) % period or period
            for _ in range(times.count(place) + (times.count(0) if place == period else 0)):
                budget = 1500
                while budget and waiting:
                    message, missing = waiting.pop(0)
                    used = min(budget, missing)
                    budget -= used
                    if missing > used:
                        waiting.insert(0, (message, missing - used))
                    else:
                        left[message] = now
    return left, lost


@pytest.mark.parametrize("dt", [0.05, 1.0 / 30.0, 0.004])
@pytest.mark.parametrize("size", [400, 1500, 5000])
@pytest.mark.parametrize(("queue", "keep"), [(3, "newest"), (1, "newest"), (2, "oldest")])
def test_a_message_leaves_when_its_bytes_have_been_granted(dt, size, queue, keep) -> None:
    key, ticks, delay = a_key(7, size), 300, 0.06
    settings = LinkSettings(trace="trace", message_bytes=size, queue=queue, keep=keep, delay=delay)
    times = [int(line) for line in MAHIMAHI.split()]
    left, lost = granted(times, size, queue, keep == "newest", dt, offset_of(key, times[-1]), ticks)
    wanted: list[list[int]] = [[] for _ in range(ticks + 1000)]
    for message, at in left.items():
        wanted[math.ceil(round((at * 0.001 + delay) / dt, 6))].append(message)
    link = OneLink(settings, dt=dt, key=key, traces=(a_trace(MAHIMAHI),))
    assert arrivals(link, ticks) == wanted[:ticks]
    assert link.counters().lost["queue"] == lost
    assert conserved(link.counters())
    assert left


def test_a_recording_is_looped_and_begins_where_the_key_says() -> None:
    traces, settings = (a_trace(TABLE),), LinkSettings(trace="trace")
    p = link_parameters(settings, DT, traces=traces)
    came = [first_arrivals(p, a_key(k), 60) for k in range(40)]
    outcomes = [np.where(ticks < 0, -1, ticks - np.arange(60)) for ticks in came]
    for ticks in outcomes:
        assert np.array_equal(ticks[11:44], ticks[:33])
    assert len({ticks[:11].tobytes() for ticks in outcomes}) == 11


def test_mahimahi_file_combines_with_blackouts_and_losses() -> None:
    traces = (a_trace("1\n"),)
    blacked_out = LinkSettings(trace="trace", blackouts=((1.0, 1.0),), delay=0.02)
    link = OneLink(blacked_out, dt=DT, key=a_key(1), traces=traces)
    got = arrivals(link, 60)
    assert got[20:41] == [[19], *([] for _ in range(20))]
    assert link.counters().lost["blackout"] == 20
    drawn = LinkSettings(trace="trace", loss=0.5, jitter=0.01, delay=0.02, duplicates=0.5)
    link = OneLink(drawn, dt=DT, key=a_key(1), traces=traces)
    arrivals(link, 400)
    assert 150 < link.counters().lost["loss"] < 250
    assert link.counters().duplicated > 50
    assert conserved(link.counters())


# --- changes of settings

BOTH = (a_trace(TABLE, "table"), a_trace(MAHIMAHI, "mahimahi"))
CHANGES = {
    "table": LinkSettings(trace="table", delay=0.1),
    "mahimahi": LinkSettings(trace="mahimahi", message_bytes=4000, queue=2),
    "narrowband": PROFILES["narrowband"],
    "perfect": LinkSettings(),
}


@pytest.mark.parametrize("then", CHANGES)
@pytest.mark.parametrize("first", CHANGES)
def test_links_change_from_and_to_recorded_ones(first: str, then: str) -> None:
    def flown(*changes: str) -> tuple[list[list[int]], OneLink]:
        link = OneLink(CHANGES[first], dt=DT, key=a_key(3), traces=BOTH)
        got = []
        for tick in range(200):
            link.send(tick, tick, tick)
            got.append(link.arrivals(tick))
            if tick % 7 == 6 and changes:
                link.change(CHANGES[changes[tick % len(changes)]])
        return got, link

    got, link = flown(then, first, then)
    assert conserved(link.counters())
    assert sum(map(len, got)) == link.counters().delivered
    if first == then:
        assert got == flown()[0]


@pytest.mark.parametrize("number", range(5))
def test_message_restarts_transmission_in_another_size(number: int) -> None:
    """With 1,500 bytes every 0.1 s, one opportunity has passed after 0.1 s, and 4,500 bytes need three more."""
    settings = LinkSettings(trace="trace", message_bytes=3000)
    link = OneLink(settings, dt=DT, key=a_key(number), traces=(a_trace("100\n"),))
    link.send(0, "message", 0)
    arrived = [link.arrivals(tick) for tick in range(3)]
    link.change(msgspec.structs.replace(settings, message_bytes=4500))
    arrived += [link.arrivals(tick) for tick in range(3, 12)]
    (at,) = (tick for tick, messages in enumerate(arrived) if messages)
    assert 0.3 < at * DT <= 0.4 + DT
    assert conserved(link.counters())


def test_ended_blackout_drops_no_later_message() -> None:
    blacked_out = LinkSettings(trace="trace", blackouts=((0.0, 10.0),))
    link = OneLink(blacked_out, dt=DT, key=a_key(1), traces=(a_trace("20\n"),))
    link.send(0, "message", 0)
    assert link.arrivals(0) == []
    link.change(msgspec.structs.replace(blacked_out, blackouts=()))
    assert link.arrivals(1) == ["message"]


def test_operator_may_set_only_recorded_links_already_read(tmp_path: Path) -> None:
    (tmp_path / "wifi.csv").write_text(TABLE)
    scenario = load_scenario(
        "escort", overrides=[f"links.radio.trace={tmp_path}/wifi.csv", "duration=10.0"]
    )
    flight = Flight(scenario, 1)
    name = scenario.links.traces[0].name
    flight.degrade(LinkKind.COMMANDS, None, LinkSettings(trace=name))
    assert flight.world.links.status()["uav_0/commands"].settings == LinkSettings(trace=name)
    flight.degrade(LinkKind.RADIO, None, LinkSettings())
    with pytest.raises(ScenarioError, match="not among the traces that were read"):
        flight.degrade(LinkKind.COMMANDS, None, LinkSettings(trace="/etc/hostname"))


@pytest.mark.parametrize(("message_bytes", "queue"), [(1500, 2), (1500, 40), (4000, 1)])
def test_message_delay_fits_the_capacity_of_batches(message_bytes: int, queue: int) -> None:
    """Opportunities come in a burst and then after 0.6 s: messages wait long in the queue."""
    gaps = [10] * 50 + [600] * 8
    trace = a_trace("\n".join(map(str, np.cumsum(gaps).tolist())))
    settings = LinkSettings(trace="trace", message_bytes=message_bytes, queue=queue, keep="oldest")
    scenario = degraded(3000, LinkTable(detections=settings, traces=(trace,)))
    longest = Batch(scenario, 1).links.longest(LinkKind.DETECTIONS)
    link = OneLink(settings, dt=DT, key=a_key(4), traces=(trace,))
    ages = [tick - number for tick, got in enumerate(arrivals(link, 3000)) for number in got]
    assert 0.3 * longest < max(ages) <= longest


# --- warnings


def declared(tmp_path: Path, trace: str, *changes: str, kind: str = "detections") -> Any:
    """Return a certified scenario with detections without dropouts and this recorded link."""
    (tmp_path / "trace").write_text(trace)
    overrides = [f"links.{kind}.trace={tmp_path}/trace", "detections.dropout=0.0"]
    return load_scenario("escort", overrides=[*overrides, *changes])


GRANTED = {
    "few bytes at each": (
        "45\n96\n1096\n",
        "links.detections.message_bytes=4000 links.detections.queue=10",
    ),
    "more seldom than it appears": (
        "51\n71\n72\n",
        "detections.rate=1.0 certificate.max_measurement_age=0.5",
    ),
    "at another place of it": (
        "100\n145\n190\n",
        "certificate.max_measurement_age=0.5 links.detections.message_bytes=1500 "
        "links.detections.queue=10 links.detections.keep=newest",
    ),
}


@pytest.mark.parametrize("how", GRANTED)
def test_recorded_link_slower_than_declared_warns(how: str, tmp_path: Path) -> None:
    trace, changes = GRANTED[how]
    scenario = declared(tmp_path, trace, "duration=40.0", *words(changes))
    assert fly(scenario, 1)[1].uncertified.get(AGED, 0) > 100
    (warning,) = assumption_warnings(scenario)
    assert "(A2)" in warning


def test_the_check_of_a_scenario_inspects_all_of_a_recording(tmp_path: Path, command: Any) -> None:
    """Ten minutes, without a message from 400 s to 408 s."""
    times = [time for time in range(10, 600_001, 10) if not 400_000 < time < 408_000]
    changes = ("certificate.max_measurement_age=2.0", "duration=40.0")
    scenario = declared(tmp_path, "".join(f"{time}\n" for time in times), *changes)
    (warning,) = assumption_warnings(scenario)
    assert "the newest detection is too old in 1 % of the ticks of one pass" in warning
    settings = (f"links.detections.trace={tmp_path}/trace", "detections.dropout=0.0", *changes)
    checked = command("check", "escort", *(word for one in settings for word in ("--set", one)))
    assert warning in " ".join(checked.stderr.split())


def test_thirty_year_table_is_inspected_in_part(tmp_path: Path) -> None:
    (warning,) = assumption_warnings(declared(tmp_path, "sent,delay\n0,0.01\n1e9,2.0\n"))
    assert "only its first 50000 s was inspected" in warning


@pytest.mark.parametrize(("kind", "share"), [("detections", "5.5 %"), ("commands", "15 %")])
def test_warning_counts_violations_of_a_recorded_link(kind, share, tmp_path) -> None:
    rows = [f"{k * DT:.2f},{'lost' if 20 <= k < 50 else 0.05}" for k in range(200)]
    scenario = declared(tmp_path, "sent,delay\n" + "\n".join(rows), kind=kind)
    (warning,) = assumption_warnings(scenario)
    assert f"links.{kind}.trace" in warning
    assert f"in {share} of the ticks of one pass" in warning


# --- reproducibility


def test_world_batch_and_environment_play_the_same() -> None:
    table = LinkTable(
        detections=LinkSettings(trace="table", delay=0.05),
        commands=LinkSettings(trace="mahimahi", message_bytes=3000),
        radio=LinkSettings(trace="table"),
        operator=LinkSettings(trace="mahimahi"),
        traces=BOTH,
    )
    scenario = msgspec.structs.replace(degraded(300, table), command_timeout=1.0)
    _, _, summary = flown_in_both(scenario, 7)
    assert summary.links["uav_0/detections"].lost["trace"] > 20
    assert summary.traces == {one.name: one.sha256 for one in BOTH}
    seeds = [7, 8, 9]
    batch, worlds = Batch(scenario, 3), [World(scenario, seed) for seed in seeds]
    batch.begin(seeds)
    commands = np.random.default_rng(1).uniform(-0.2, 0.2, (200, 3, 2, 2))
    for row in commands:
        step(batch, row)
        for world, own in zip(worlds, row.tolist(), strict=True):
            for v, command in enumerate(own):
                world.send(v, world.tick, tuple(command))
            world.advance()
    for k, world in enumerate(worlds):
        assert batch.state.vehicles["position"][k].tobytes() == world.position.tobytes()
        status = batch.links.status(k)
        assert status == {name: world.links.status()[name] for name in status}
    ages = {batch.links.status(k)["uav_0/detections"].mean_age for k in range(3)}
    assert len(ages) == 3  # each seed starts at another offset


def test_recorded_link_flies_alike_and_replays_without_its_file(
    tmp_path: Path, command: Any
) -> None:
    pytest.importorskip("foxglove", reason="the extra [record] is not installed")
    (tmp_path / "recorded").mkdir()
    (tmp_path / "recorded" / "wifi.csv").write_text(TABLE)
    (tmp_path / "mine.toml").write_text(
        'duration = 5.0\ncommand_timeout = 1.0\n[law]\nname = "logarithmic"\n'
        '[links.detections]\ntrace = "recorded/wifi.csv"\n[links.commands]\ntrace = "recorded/wifi.csv"\ndelay = 0.1\n'
        + SMALL
    )
    scenario = load_scenario(tmp_path / "mine.toml")
    _, here = fly(scenario, scenario.seed)
    options = ("--in-process", "--record", tmp_path / "run.mcap", "--no-files", "--json")
    flown = command("run", tmp_path / "mine.toml", *options)
    assert flown.returncode == 0, flown.stderr
    summary = json.loads(flown.stdout)
    assert summary["trajectory_sha256"] == here.trajectory_sha256
    assert summary["traces"] == {"recorded/wifi.csv": scenario.links.traces[0].sha256}
    (tmp_path / "recorded" / "wifi.csv").unlink()
    again = command("replay", tmp_path / "run.mcap", "--refly", "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["trajectory_sha256"] == here.trajectory_sha256


# --- invalid files

BAD = {
    "empty": (b"", "empty"),
    "only comments": (b"# nothing\n\n", "empty"),
    "binary": (b"1\n2\0\n", "not text but binary"),
    "not UTF-8": (b"sent,delay\n0,\xff\n", "byte 13: not text in UTF-8"),
    "prose": (b"A drive through the city\n", "line 1 = "),
    "another unit": (b"sent [ms],delay [ms]\n0,1\n", "not a trace"),
    "no rows": (b"sent,delay\n", "line 1: a header without rows"),
    "too few cells": (b"sent,delay\n0,1\n1\n", "line 3 = 1: too few cells"),
    "no number": (b"sent,delay\n0,fast\n", "line 2 = fast: delay is not a time"),
    "no time": (b"sent,delay\nnan,0.1\n", "line 2 = nan: sent is not a time"),
    "negative": (b"sent,delay\n0,-0.1\n", "line 2 = -0.1: a negative delay"),
    "back in time": (b"sent,delay\n1,0.1\n0.5,0.1\n", "line 3 = 0.5: sent before 1 s"),
    "too late": (b"sent,delay\n0,61\n", "the delay can be 61 s"),
    "Mahimahi back in time": (b"5\n7\n6\n", "line 3 = 6: before 7"),
    "Mahimahi with a word": (b"5\nseven\n", "line 2 = "),
    "Mahimahi with a fraction": (b"5\n7.5\n", "not a whole number of ms"),
    "Mahimahi of no time": (b"0\n0\n", "lasts 0 ms"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    content, phrase = BAD[name]
    (tmp_path / "trace").write_bytes(content)
    (tmp_path / "mine.toml").write_text('[links.radio]\ntrace = "trace"\n' + SMALL)
    line = refusal(tmp_path / "mine.toml")
    assert "mine.toml: links.radio" in line
    assert phrase in line.replace('"', "")
    assert "allowed:" in line


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "trace").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    assert "larger than 50 MiB" in refusal(overrides=[f"links.radio.trace={tmp_path}/trace"])


def test_too_many_lines_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sim.channel.recorded.MOST_LINES", 5)
    (tmp_path / "trace").write_text("1\n2\n3\n4\n5\n6\n7\n8\n")
    assert "more than 5 rows" in refusal(overrides=[f"links.radio.trace={tmp_path}/trace"])


@pytest.mark.parametrize(
    ("trace", "phrase"),
    [
        ("none.csv", "cannot be read: No such file"),
        (".", "cannot be read: Is a directory"),
        ("../outside.csv", "outside the scenario's folder"),
        ("/etc/hostname", "outside the scenario's folder"),
        ("leads-out.csv", "outside the scenario's folder"),
        ("a\\u0000b", "cannot be read"),
    ],
)
def test_a_scenario_names_recordings_beside_it_or_below(trace, phrase, tmp_path) -> None:
    (tmp_path / "outside.csv").write_text(TABLE)
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "leads-out.csv").symlink_to(tmp_path / "outside.csv")
    (folder / "mine.toml").write_text(f'[links.radio]\ntrace = "{trace}"\n' + SMALL)
    assert phrase in refusal(folder / "mine.toml")


@pytest.mark.parametrize(
    ("changes", "phrase"),
    [
        (("links.radio.loss=0.1",), "links.radio.loss = 0.1: cannot be combined with a table"),
        (("links.radio.profile=wifi",), "links.radio.jitter = 0.003: cannot be combined with"),
        (("links.radio.bandwidth=5",), "links.radio.bandwidth = 5.0: cannot be combined with"),
        (("links.radio.duplicates=0.5",), "allowed: 0; delay and blackouts can"),
    ],
)
def test_settings_incompatible_with_a_recording_are_refused(changes, phrase, tmp_path) -> None:
    (tmp_path / "t.csv").write_text(TABLE)
    assert phrase in refusal(overrides=[f"links.radio.trace={tmp_path}/t.csv", *changes])
    (tmp_path / "t.csv").write_text(MAHIMAHI)
    if "bandwidth" in phrase:
        assert phrase in refusal(overrides=[f"links.radio.trace={tmp_path}/t.csv", *changes])
    else:
        load_scenario(overrides=[f"links.radio.trace={tmp_path}/t.csv", *changes])


def test_content_that_is_not_the_files_is_refused() -> None:
    other = msgspec.structs.replace(BOTH[0], content=BOTH[1].content)
    broken = msgspec.structs.replace(BOTH[0], content=b"no zlib")
    for one in (other, broken):
        with pytest.raises(ScenarioError, match="trace table: damaged"):
            check_link(LinkSettings(trace="table"), "radio", (one,))
