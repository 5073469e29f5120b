"""The ring link against the link of slots and buckets: the same arrivals and counters, to the bit."""

import msgspec
import numpy as np
import pytest

from bus.messages import LinkSettings
from bus.profiles import PROFILES
from sim.channel import link as slots
from sim.channel.description import check_link, link_parameters, link_status, link_table, relink
from sim.channel.links import change_links, new_links, trace_rows
from sim.channel.links import link_status as ring_status
from sim.channel.recorded import pack
from sim.channel.ring import ARRIVED, begin_tick, receive, send
from sim.kernels.compile import borrowing
from sim.kernels.records import fill

DT = 0.05
CSV = pack("csv", b"sent,delay\n0,0.1\n0.2,lost\n0.3,0\n0.3,0.24\n0.5,\n0.51,0.05\n1.2,0.7\n")
MAHIMAHI = pack("mahi", b"0\n3\n3\n20\n20\n47\n120\n121\n260\n")
TRACES = (CSV, MAHIMAHI)
LATE = {"delay": 0.1, "jitter": 0.1, "jitter_shape": "pareto", "reorder": 0.1, "reorder_delay": 0.1}
BURSTS = {"burst_length": 0.3, "burst_interval": 1.0, "burst_loss": 0.8}
DARK = {"blackout_interval": 5.0, "blackout_length": 0.5}
SETTINGS = {
    "perfect": LinkSettings(),
    "delay": LinkSettings(delay=0.32),
    "normal": LinkSettings(delay=0.3, jitter=0.2, jitter_shape="normal"),
    "uniform": LinkSettings(delay=0.3, jitter=0.2, jitter_shape="uniform", loss=0.3),
    "bursts": LinkSettings(delay=0.1, burst_length=0.5, burst_interval=1.0, burst_loss=0.7),
    "blackouts": LinkSettings(
        blackout_interval=2.0, blackout_length=0.43, blackouts=((1.0, 0.5), (3.0, 2.0), (4.0, 2.0))
    ),
    "duplicates": LinkSettings(duplicates=0.4, delay=0.2, reorder=0.3, reorder_delay=0.4),
    "newest": LinkSettings(bandwidth=4.0, queue=3, delay=0.2),
    "oldest": LinkSettings(bandwidth=7.0, queue=5, keep="oldest", loss=0.1),
    "fast": LinkSettings(bandwidth=33.0, queue=4, duplicates=0.2, **LATE),
    "busy": LinkSettings(loss=0.1, bandwidth=15.0, duplicates=0.1, **LATE, **BURSTS, **DARK),
    "csv": LinkSettings(trace="csv", delay=0.1, blackouts=((5.0, 1.0),)),
    "mahimahi": LinkSettings(trace="mahi", queue=3, message_bytes=2500, loss=0.1, delay=0.2),
    "mahimahi oldest": LinkSettings(
        trace="mahi", queue=2, keep="oldest", message_bytes=4000, duplicates=0.3, jitter=0.05
    ),
    "mahimahi small": LinkSettings(trace="mahi", queue=1, message_bytes=400, **DARK),
    **{name: PROFILES[name] for name in ("jammed", "satellite", "wifi-poor", "narrowband")},
}


@borrowing
def _slots_tick(table, state, key, tick, count, out):
    slots.advance(table, 0, state, key, tick)
    for k in range(count):
        out[0, 0], out[0, 1] = tick - 0.5 * k, k
        slots.send(table, 0, state, key, out[0])
    return slots.receive(state, out)


@borrowing
def _ring_tick(links, packets, traces, tick, count, out):
    link = links[1, 0]
    begin_tick(link, packets, 1, traces, tick)
    for k in range(count):
        packet = packets[1, 0, ARRIVED, 0]
        packet.stamp, packet.block = tick - 0.5 * k, k
        send(link, packets, 1, traces, packet)
    n = receive(link, packets, 1)
    for k in range(n):
        packet = packets[1, 0, ARRIVED, k]
        out[k, 0], out[k, 1] = packet.stamp, packet.block
    return n


class Both:
    """One link in both forms, with the same traffic."""

    def __init__(self, settings, seed, per_tick):
        self.per_tick = per_tick
        self.p = self._parameters(settings)
        self.key = (np.uint64(seed), np.uint64(7))
        self.state, self.table = slots.link_state(self.p, 2), link_table([self.p])
        self.links, self.packets, self.traces = new_links([self.p], worlds=2)
        self.links["key"] = self.key
        self.rng, self.tick, self.arrived = np.random.default_rng(seed), 0, 0

    def _parameters(self, settings):
        checked = check_link(settings, "test", TRACES)
        return link_parameters(checked, DT, per_tick=self.per_tick, traces=TRACES)

    def run(self, ticks):
        for _ in range(ticks):
            count = int(self.rng.integers(0, self.per_tick + 1))
            old = np.zeros((max(len(self.state.slots), 1), 2))
            new = np.zeros((self.packets.shape[3] + self.per_tick, 2))
            n = _slots_tick(self.table, self.state, self.key, self.tick, count, old)
            m = _ring_tick(self.links, self.packets, self.traces, self.tick, count, new)
            assert old[:n].tolist() == new[:m].tolist()
            ours = ring_status(self.links[1, 0])
            assert ours == link_status(self.p, self.state)
            self.tick += 1
            self.arrived += n
        memory, link = self.state.memory[0], self.links[1, 0]
        for ours, theirs in (("bad", "chain"), ("blackout", "dark"), ("busy_since", "began")):
            assert link[ours] == memory[theirs]
        for name in ("served", "renewals", "granted", "originals", "ages"):
            assert link[name] == memory[name]
        assert link["lost"].tolist() == self.state.lost.tolist()
        assert link["lost"][slots.FULL] == 0

    def change(self, settings):
        new = self._parameters(settings)
        self.state = relink(self.p, self.state, new)
        self.packets = change_links(self.links, self.packets, 0, new)
        self.p, self.table = new, link_table([new])
        self.traces, (placed,) = trace_rows([new])
        for w in range(2):
            fill(self.links["parameters"][w, 0], placed)


@pytest.mark.parametrize("per_tick", [1, 3])
@pytest.mark.parametrize("name", SETTINGS)
def test_both_links_deliver_and_count_the_same(name: str, per_tick: int) -> None:
    arrived = 0
    for seed in range(7):
        both = Both(SETTINGS[name], seed, per_tick)
        both.run(300)
        arrived += both.arrived
    assert arrived > 200


@pytest.mark.parametrize("seed", range(12))
def test_both_links_change_their_settings_alike(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = rng.permutation(list(SETTINGS))
    both = Both(SETTINGS[names[0]], seed, 2)
    for name in (*names[1:], *names):
        both.run(int(rng.integers(1, 40)))
        settings = SETTINGS[name]
        if rng.random() < 0.3 and not settings.trace:
            settings = msgspec.structs.replace(settings, delay=settings.delay + 1.0)
        both.change(settings)
    both.run(100)
