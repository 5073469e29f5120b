"""The radio channel.

Each impairment against its theory, conservation of messages, reproducibility, and changes of settings.
"""

import math
import re
import weakref
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.special import ndtri

from bus.errors import ScenarioError
from bus.messages.links import LinkSettings, LinkStatus
from bus.profiles import PROFILES
from one_link import OneLink, conserved
from properties import PROPERTY
from seeded import a_key
from sim.channel.description import KEEPS, check_link, extra_delays, link_parameters
from sim.channel.jitter import SHAPES, jitter_quantile, jitter_share, normal_quantile
from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED, CAUSES
from sim.channel.links import change_links, exchange, link_status, new_links, place_traces
from sim.compiling.compile import compiled
from tabular import words

MILLION = 1_000_000
DT = 0.05
KS = 1.95
"""KS * n**-0.5 is exceeded by a correct empirical distribution once in a thousand cases."""


@compiled
def _drive(links, packets, traces, w, first, ticks, each, log, in_blackout):
    """Send `each` messages in every tick; log a row (arrival tick, sent tick, number) for each arrival."""
    n, link = 0, links[w, 0]
    for tick in range(first, first + ticks):
        begin_tick(link, packets, w, traces, tick)
        in_blackout[tick - first] = link.blackout
        for k in range(each):
            packet = packets[w, 0, ARRIVED, 0]
            packet.stamp, packet.block = tick, k
            send(link, packets, w, traces, packet)
        for k in range(receive(link, packets, w)):
            packet = packets[w, 0, ARRIVED, k]
            log[n, 0], log[n, 1], log[n, 2] = tick, packet.stamp, packet.block
            n += 1
    return n


class Flown:
    """A link over which messages were sent in every tick."""

    def __init__(self, wanted, ticks, *, dt=DT, each=1, seed=1, link=2):
        self.parameters = link_parameters(check_link(wanted, "test"), dt, per_tick=each)
        self.links, self.packets, self.traces = new_links([self.parameters])
        self.links["key"] = a_key(seed, link)
        self.each, self.tick = each, 0
        self.arrived = np.zeros((0, 3), dtype=np.int64)
        self.advance(ticks)

    def advance(self, ticks: int) -> None:
        rows = 2 * self.each * ticks + self.packets.shape[3]
        log, self.in_blackout = np.zeros((rows, 3), dtype=np.int64), np.zeros(ticks, dtype=np.int64)
        link = self.links, self.packets, self.traces
        n = _drive(*link, 0, self.tick, ticks, self.each, log, self.in_blackout)
        self.tick += ticks
        self.arrived = np.concatenate([self.arrived, log[:n]])

    def change(self, wanted: LinkSettings) -> None:
        new = link_parameters(check_link(wanted, "test"), self.parameters.dt, per_tick=self.each)
        self.packets = change_links(self.links, self.packets, 0, new)
        self.parameters, self.traces = new, place_traces(self.links, [new])

    @property
    def delays(self) -> np.ndarray:
        """Delay of each arrival [ticks]."""
        return self.arrived[:, 0] - self.arrived[:, 1]

    @property
    def missing(self) -> np.ndarray:
        """Ticks whose messages have not arrived."""
        lost = np.ones(self.tick, dtype=bool)
        lost[self.arrived[:, 1]] = False
        return lost

    @property
    def status(self) -> LinkStatus:
        return link_status(self.links[0, 0])

    @property
    def bits(self) -> bytes:
        link = self.links.copy()
        link["key"] = 0
        return repr(link[0].tolist()).encode() + self.arrived.tobytes()


def _spread(share: float, n: float = MILLION) -> float:
    """Return four standard deviations of a share among n messages."""
    return 4.0 * math.sqrt(share * (1.0 - share) / n)


def _only(status: LinkStatus, *causes: str) -> bool:
    """Return whether messages were lost by this cause only."""
    return not any(number for cause, number in status.lost.items() if cause not in causes)


# --- perfect link, and times


def test_a_perfect_link_is_the_identity_and_draws_nothing() -> None:
    flown = Flown(LinkSettings(), 1000, each=3)
    wanted = [(tick, tick, k) for tick in range(1000) for k in range(3)]
    assert flown.parameters.perfect
    assert flown.arrived.tolist() == [list(row) for row in wanted]
    assert flown.bits == Flown(LinkSettings(), 1000, each=3, seed=99, link=77).bits
    assert flown.status.max_age == 0.0
    assert flown.status.delivery_ratio == 1.0


@pytest.mark.parametrize(
    ("delay", "dt", "ticks"),
    [
        *((0.5, 0.05, 10), (0.35, 0.05, 7), (0.0, 0.05, 0), (0.001, 0.05, 1), (0.05, 0.05, 1)),
        *((0.0501, 0.05, 2), (0.28, 0.05, 6), (0.7, 0.1, 7), (1.1, 0.1, 11), (0.07, 0.01, 7)),
        (30.0, 0.01, 3000),
    ],
)
def test_message_arrives_at_the_first_tick_after_its_delay(delay, dt, ticks):
    flown = Flown(LinkSettings(delay=delay), 4000, dt=dt)
    assert set(flown.delays.tolist()) == {ticks}
    assert len(flown.arrived) == 4000 - ticks
    assert flown.status.max_age == pytest.approx(ticks * dt)


# --- losses


@pytest.mark.parametrize("loss", [0.001, 0.1, 0.9])
def test_independent_losses_have_their_share_and_no_memory(loss: float) -> None:
    flown = Flown(LinkSettings(loss=loss), MILLION)
    lost = flown.missing
    assert lost.mean() == pytest.approx(loss, abs=_spread(loss))
    assert flown.status.lost["loss"] == lost.sum()
    assert _only(flown.status, "loss")
    assert abs(np.corrcoef(lost[:-1], lost[1:])[0, 1]) < 4.0 / math.sqrt(MILLION)


def _runs(flags: np.ndarray) -> np.ndarray:
    """Return the lengths of the runs of true values that start and end inside."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8)))
    if flags[0]:
        edges = edges[1:]
    return np.diff(edges[: len(edges) // 2 * 2])[::2]


@pytest.mark.parametrize(
    ("length", "interval", "dt"),
    [(0.5, 2.0, DT), (0.02, 0.03, DT), (2.0, 1.0, DT), (0.2, 0.3, 0.01)],
)
def test_bursts_are_a_gilbert_elliott_chain_sampled_exactly(length, interval, dt) -> None:
    flown = Flown(LinkSettings(burst_length=length, burst_interval=interval), MILLION, dt=dt)
    bad, share = flown.missing, length / (length + interval)
    decay = math.exp(-dt * (1.0 / length + 1.0 / interval))
    effective = MILLION * (1.0 - decay) / (1.0 + decay)
    assert bad.mean() == pytest.approx(share, abs=_spread(share, effective))
    assert flown.status.lost["burst"] == bad.sum()
    assert _only(flown.status, "burst")
    leave = (1.0 - share) * (1.0 - decay)
    runs = _runs(bad)
    error = math.sqrt((1.0 - leave) / leave**2 / len(runs))
    assert runs.mean() == pytest.approx(1.0 / leave, abs=4.0 * error)
    top = max(2, int(math.log(100.0 / len(runs)) / math.log(1.0 - leave)))
    found = np.bincount(np.minimum(runs, top), minlength=top + 1)[1:]
    shares = [*(leave * (1.0 - leave) ** np.arange(top - 1)), (1.0 - leave) ** (top - 1)]
    wanted = len(runs) * np.array(shares)
    assert stats.chisquare(found, wanted).pvalue > 1e-3


def test_burst_losses_add_to_independent_losses() -> None:
    status = Flown(
        LinkSettings(loss=0.1, burst_length=0.5, burst_interval=0.5, burst_loss=0.6), MILLION
    ).status
    correlated = MILLION * math.tanh(DT * 4.0 / 2.0)
    assert status.lost["burst"] / MILLION == pytest.approx(0.3, abs=_spread(0.5, correlated))
    assert status.lost["loss"] / (MILLION - status.lost["burst"]) == pytest.approx(
        0.1, abs=_spread(0.1, 0.7 * MILLION)
    )


@pytest.mark.parametrize("kind", ["burst", "blackout"])
def test_the_channel_starts_in_its_stationary_state(kind: str) -> None:
    settings = LinkSettings(**{f"{kind}_length": 0.9, f"{kind}_interval": 2.1})
    lost = [Flown(settings, 1, seed=seed).status.lost[kind] for seed in range(2000)]
    assert np.mean(lost) == pytest.approx(0.3, abs=_spread(0.3, 2000))


# --- blackouts


def test_planned_blackouts_drop_messages_sent_within_them() -> None:
    plan = ((1.0, 0.5), (3.02, 0.1), (0.35, 0.35), (1.2, 0.6), (7.0, 0.01))
    flown = Flown(LinkSettings(delay=0.2, blackouts=plan), 300)
    flown.advance(10)
    times = np.arange(310) * DT + 1e-9
    wanted = np.any(
        [(times >= start) & (times + 1e-8 < start + length) for start, length in plan], axis=0
    )
    assert np.flatnonzero(flown.missing)[:-4].tolist() == np.flatnonzero(wanted).tolist()
    assert flown.status.lost["blackout"] == wanted.sum()
    assert _only(flown.status, "blackout")


@pytest.mark.parametrize(("length", "interval"), [(2.0, 8.0), (0.03, 0.01), (0.3, 0.7)])
def test_random_blackouts_take_their_share_of_the_time(length: float, interval: float) -> None:
    flown = Flown(LinkSettings(blackout_length=length, blackout_interval=interval), MILLION)
    share, cycle = length / (length + interval), length + interval
    deviation = 4.0 * length * interval / cycle**2 / math.sqrt(MILLION * DT / cycle)
    assert flown.in_blackout.mean() == pytest.approx(share, abs=deviation + _spread(share))
    assert flown.status.lost["blackout"] == flown.in_blackout.sum() == flown.missing.sum()


def test_random_blackouts_are_a_poisson_process() -> None:
    settings = LinkSettings(blackout_length=0.5, blackout_interval=1.0)
    in_blackout = Flown(settings, MILLION, dt=0.001).in_blackout.astype(bool)
    lit, dark = _runs(~in_blackout) * 0.001, _runs(in_blackout)
    # two blackouts whose gap contains no tick count as one
    assert (np.abs(dark - 500) > 1).mean() < 0.005
    assert stats.kstest(lit, "expon").statistic < KS / math.sqrt(len(lit)) + 0.001


# --- delays


@given(st.floats(1e-300, 1.0, exclude_max=True))
@settings(PROPERTY, max_examples=500)
def test_the_quantile_of_the_normal_is_scipys(share: float) -> None:
    assert normal_quantile(share) == pytest.approx(
        float(stats.norm.ppf(share)), rel=1e-13, abs=1e-15
    )


SCIPY: dict[str, Callable[[float], Any]] = {
    "uniform": lambda j: stats.uniform(-j, 2.0 * j),
    "normal": lambda j: stats.norm(0.0, j),
    "exponential": lambda j: stats.expon(0.0, j),
    "pareto": lambda j: stats.lomax(2.5, 0.0, 1.5 * j),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_each_shape_is_its_distribution_and_has_its_mean(shape: str) -> None:
    law = SCIPY[shape](0.4)
    assert law.mean() == pytest.approx(0.4 if shape in {"exponential", "pareto"} else 0.0)
    for share in (1e-6, 0.01, 0.3, 0.5, 0.9, 0.999, 1.0 - 1e-9):
        extra = jitter_quantile(SHAPES[shape], 0.4, share)
        assert extra == pytest.approx(law.ppf(share), rel=1e-6, abs=1e-12)
        assert jitter_share(SHAPES[shape], 0.4, extra) == pytest.approx(share, abs=1e-12)
    for extra in (-0.5, -0.1, 0.0, 0.2, 5.0):
        assert jitter_share(SHAPES[shape], 0.4, extra) == pytest.approx(law.cdf(extra), abs=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("delay", "cut"), [(0.0, 0.0), (0.05, 0.03), (0.5, 0.15)])
def test_delays_follow_the_cut_distribution_in_ticks(shape: str, delay: float, cut: float) -> None:
    jitter, dt = 0.1, 0.001
    flown = Flown(
        LinkSettings(delay=delay, jitter=jitter, jitter_shape=shape, max_jitter=cut), 400_000, dt=dt
    )
    law, (least, most) = SCIPY[shape](jitter), (-delay, cut or 5.0 * jitter)
    low, high = law.cdf(least), law.cdf(most)
    delays = flown.delays[flown.arrived[:, 1] < 400_000 - flown.parameters.longest]
    ticks = np.arange(flown.parameters.longest + 1)
    found = np.bincount(delays, minlength=len(ticks)).cumsum() / len(delays)
    wanted = np.clip((law.cdf(ticks * dt - delay) - low) / (high - low), 0.0, 1.0)
    assert np.abs(found - wanted).max() < KS / math.sqrt(len(delays))
    assert delays.max() <= math.ceil((delay + most) / dt - 1e-6)
    assert flown.status.lost == dict.fromkeys(CAUSES, 0)


@pytest.mark.parametrize("shape", SHAPES)
def test_correlated_delays_keep_their_distribution(shape: str) -> None:
    delay, jitter, cut, dt, together = 0.5, 0.1, 0.4, 0.001, 0.05
    given = LinkSettings(delay=delay, jitter=jitter, jitter_shape=shape, max_jitter=cut)
    flown = Flown(msgspec.structs.replace(given, jitter_time=together), 400_000, dt=dt)
    apart = Flown(given, 400_000, dt=dt)
    delays = []
    for one in (flown, apart):
        order = np.argsort(one.arrived[:, 1])
        delays.append(one.delays[order][: 400_000 - one.parameters.longest])
    ticks = np.arange(flown.parameters.longest + 1)
    found, wanted = (np.bincount(d, minlength=len(ticks)).cumsum() / len(d) for d in delays)
    independent = len(delays[0]) * dt / (2.0 * together)
    assert np.abs(found - wanted).max() < KS / math.sqrt(independent)
    assert delays[0].max() <= flown.parameters.longest == apart.parameters.longest
    assert delays[0].min() >= delays[1].min()
    scores = [ndtri((stats.rankdata(d) - 0.5) / len(d)) for d in delays]
    for lag in (1, 20, 100):
        r = float(np.corrcoef(scores[0][:-lag], scores[0][lag:])[0, 1])
        assert r == pytest.approx(math.exp(-lag * dt / together), abs=0.03)
        assert abs(np.corrcoef(scores[1][:-lag], scores[1][lag:])[0, 1]) < 0.01


def test_messages_of_one_tick_are_late_together() -> None:
    settings = LinkSettings(delay=0.5, jitter=0.3, jitter_time=0.2, loss=0.2)
    flown = Flown(settings, 5_000, each=3)
    times = [set[int]() for _ in range(5_000)]
    for at, sent, _ in flown.arrived.tolist():
        times[sent].add(at)
    assert max(map(len, times)) == 1


def test_correlation_ends_with_its_setting() -> None:
    late = LinkSettings(delay=0.5, jitter=0.3, jitter_time=5.0)
    apart = msgspec.structs.replace(late, jitter_time=0.0)
    flown, never = Flown(late, 100), Flown(apart, 100)
    for one in (flown, never):
        one.change(apart)
        one.advance(200)
    after = [one.arrived[one.arrived[:, 1] >= 100] for one in (flown, never)]
    assert np.array_equal(*(one[np.lexsort(one.T)] for one in after))


def test_only_a_longer_delay_lets_a_message_be_overtaken():
    flown = Flown(LinkSettings(delay=0.2, jitter=0.2), 20_000, each=2)
    order = np.lexsort((flown.arrived[:, 2], flown.arrived[:, 1], flown.arrived[:, 0]))
    assert order.tolist() == list(range(len(order)))
    assert (np.diff(flown.arrived[:, 1]) < 0).any()


def test_duplicates_and_held_back_messages_have_their_shares() -> None:
    flown = Flown(LinkSettings(delay=0.1, duplicates=0.2, reorder=0.3, reorder_delay=0.25), MILLION)
    assert flown.status.duplicated / MILLION == pytest.approx(0.2, abs=_spread(0.2))
    assert set(flown.delays.tolist()) == {2, 7}
    assert (flown.delays == 7).mean() == pytest.approx(0.3, abs=_spread(0.3))


def test_a_copy_has_a_delay_of_its_own_and_is_no_further_message() -> None:
    settings = LinkSettings(delay=0.5, jitter=0.4, duplicates=1.0, reorder=0.3, reorder_delay=2.0)
    flown = Flown(settings, 50_000, dt=0.01)
    order = np.argsort(flown.arrived[:, 1], kind="stable")
    twice = np.bincount(flown.arrived[:, 1])[flown.arrived[order, 1]] == 2
    pairs = flown.delays[order][twice].reshape(-1, 2)  # the shorter delay first
    swapped = np.random.default_rng(1).permuted(pairs, axis=1)
    assert abs(np.corrcoef(swapped.T)[0, 1]) < 4.0 / math.sqrt(len(pairs))
    late = (pairs > 150).sum(axis=1)  # held back or not, each for itself
    assert (late == 1).mean() == pytest.approx(0.42, abs=_spread(0.42, len(pairs)))
    half = Flown(LinkSettings(duplicates=1.0, loss=0.5), 1000).status
    assert half.duplicated == 1000 - half.lost["loss"]
    assert half.delivery_ratio == 1.0 - half.lost["loss"] / 1000


# --- bandwidth


@pytest.mark.parametrize("bandwidth", [0.37, 2.0, 7.0, 19.999, 20.0, 33.3, 50.0])
@pytest.mark.parametrize("keep", KEEPS)
def test_link_carries_the_smaller_of_bandwidth_and_load(bandwidth, keep):
    ticks = 40_000
    for each in (1, 3):
        flown = Flown(LinkSettings(bandwidth=bandwidth, queue=4, keep=keep), ticks, each=each)
        offered = each / DT
        if bandwidth < offered:
            assert flown.status.delivered in {
                math.floor(bandwidth * (ticks - 1) * DT + 1e-6) + k for k in (0, 1)
            }
        else:
            assert flown.status.delivered == flown.status.sent
            assert flown.delays.max() == 0
        assert _only(flown.status, "queue")
        assert conserved(flown.status)


@pytest.mark.parametrize("queue", [1, 3, 10])
def test_a_full_queue_keeps_the_newest_or_the_oldest_as_wanted(queue: int) -> None:
    newest = Flown(LinkSettings(bandwidth=2.0, queue=queue, keep="newest"), 2000)
    oldest = Flown(LinkSettings(bandwidth=2.0, queue=queue, keep="oldest"), 2000)
    assert (
        newest.arrived[:, 0].tolist() == oldest.arrived[:, 0].tolist() == list(range(0, 2000, 10))
    )
    steady = slice(queue + 2, None)
    assert set(newest.delays[steady].tolist()) == {queue}
    assert set(oldest.delays[steady].tolist()) == {10 * queue}
    assert newest.status.queued == oldest.status.queued == queue


# --- combinations


shares = st.sampled_from([0.0, 0.0, 0.05, 0.5, 1.0])
spans = st.sampled_from([0.0, 0.0, 0.02, 0.05, 0.3, 1.0])


@st.composite
def links(draw: st.DrawFn) -> LinkSettings:
    blackouts = st.lists(st.tuples(st.floats(0.0, 20.0), st.floats(0.01, 3.0)), max_size=3)
    times = words("delay jitter max_jitter jitter_time burst_length blackout_interval")
    return LinkSettings(
        **{name: draw(spans) for name in times},
        **{name: draw(shares) for name in words("loss burst_loss duplicates reorder")},
        jitter_shape=draw(st.sampled_from(list(SHAPES))),
        burst_interval=draw(st.floats(0.01, 3.0)),
        blackouts=tuple(draw(blackouts)),
        blackout_length=draw(st.floats(0.01, 2.0)),
        reorder_delay=draw(st.floats(0.01, 1.0)),
        bandwidth=draw(st.sampled_from([0.0, 0.0, 3.0, 19.0, 45.0])),
        queue=draw(st.integers(1, 6)),
        keep=draw(st.sampled_from(KEEPS)),
    )


@given(links(), links(), st.integers(1, 3), st.integers(0, 2**53 - 1))
@settings(PROPERTY)
def test_no_message_appears_or_vanishes_and_none_lacks_room(first, then, each, seed):
    flown = Flown(first, 200, each=each, seed=seed)
    for wanted in (then, first, LinkSettings()):
        assert conserved(flown.status)
        assert flown.status.lost["full"] == 0
        assert flown.delays.min(initial=0) >= 0
        before = flown.status
        flown.change(wanted)
        assert conserved(flown.status)
        assert flown.status.in_transit == before.in_transit
        flown.advance(200)
    flown.advance(200)
    assert flown.status.queued == flown.status.in_transit == 0
    assert conserved(flown.status)


@given(links(), st.integers(0, 2**53 - 1))
@settings(PROPERTY)
def test_resetting_equal_settings_changes_nothing(wanted: LinkSettings, seed: int) -> None:
    whole, changed = Flown(wanted, 300, seed=seed), Flown(wanted, 150, seed=seed)
    changed.change(wanted)
    changed.advance(150)
    assert changed.arrived.tobytes() == whole.arrived.tobytes()
    assert changed.status == whole.status


def test_messages_beyond_capacity_are_counted() -> None:
    links, packets, traces = new_links([link_parameters(LinkSettings(delay=0.2), DT)])
    for tick in range(100):
        exchange(links, packets, 0, traces, tick, np.full(5, float(tick)))
    status = link_status(links[0, 0])
    assert status.lost["full"] == status.sent - status.delivered - status.in_transit == 400
    assert conserved(status)


# --- reproducibility


LATE = {"delay": 0.1, "jitter": 0.1, "jitter_shape": "pareto", "reorder": 0.1, "reorder_delay": 0.1}
BURSTS = {"burst_length": 0.3, "burst_interval": 1.0, "burst_loss": 0.8}
BLACKOUTS = {"blackout_interval": 5.0, "blackout_length": 0.5}
BUSY = LinkSettings(loss=0.1, bandwidth=15.0, duplicates=0.1, **LATE, **BURSTS, **BLACKOUTS)


def test_link_is_reproducible_and_independent_of_other_links() -> None:
    alone = Flown(BUSY, 2000, seed=5, link=3).bits
    assert Flown(BUSY, 2000, seed=5, link=3).bits == alone
    links, packets, traces = new_links([link_parameters(BUSY, DT)], worlds=7)
    for world in range(7):
        links["key"][world] = a_key(5 + world, 3)
    log, in_blackout, arrived = np.zeros((9000, 3), dtype=np.int64), np.zeros(1, dtype=np.int64), []
    for tick in range(2000):
        for world in (6, 3, 2, 0, 1, 4, 5):
            found = _drive(links, packets, traces, world, tick, 1, 1, log, in_blackout)
            arrived += log[:found].tolist() if world == 0 else []
    links["key"] = 0
    assert repr(links[0].tolist()).encode() + np.array(arrived, dtype=np.int64).tobytes() == alone


def test_neighbouring_numbers_links_and_seeds_are_independent() -> None:
    def table(number: int, seed: int, link: int) -> np.ndarray:
        """Return the delay of each message with this number in its tick; -1: lost."""
        settings = LinkSettings(delay=0.5, jitter=0.5, loss=0.3)
        flown = Flown(settings, 20_000, dt=0.01, each=2, seed=seed, link=link)
        delays, chosen = np.full(20_000, -1), flown.arrived[:, 2] == number
        delays[flown.arrived[chosen, 1]] = flown.delays[chosen]
        return delays[:-200]

    first = table(0, 1, 2)
    for other in (table(1, 1, 2), table(0, 2, 2), table(0, 1, 3), np.roll(first, 1)):
        assert abs(np.corrcoef(first < 0, other < 0)[0, 1]) < 4.0 / math.sqrt(len(first))
        both = (first >= 0) & (other >= 0)
        assert abs(np.corrcoef(first[both], other[both])[0, 1]) < 4.0 / math.sqrt(both.sum())


@pytest.mark.parametrize("field", ["loss", "burst_loss"])
def test_a_greater_share_loses_the_same_messages_and_more(field: str) -> None:
    """Draws do not depend on settings, so two settings can be compared on the same random numbers."""
    settled = msgspec.structs.replace(BUSY, bandwidth=0.0, loss=0.0, burst_loss=0.0)
    less, more = (
        Flown(msgspec.structs.replace(settled, **{field: share}), 5000) for share in (0.1, 0.4)
    )
    arrived = [{tuple(row) for row in flown.arrived.tolist()} for flown in (less, more)]
    assert arrived[1] < arrived[0]


# --- changes of settings


def test_new_settings_leave_messages_in_flight_unchanged() -> None:
    flown = Flown(LinkSettings(delay=1.0), 30)
    flown.change(LinkSettings(delay=0.1, loss=1.0))
    flown.advance(40)
    assert flown.arrived[:, :2].tolist() == [[k + 20, k] for k in range(30)]
    assert flown.status.lost["loss"] == 40
    flown.change(LinkSettings())
    flown.advance(5)
    assert flown.arrived[-5:, 0].tolist() == flown.arrived[-5:, 1].tolist() == [70, 71, 72, 73, 74]


def test_waiting_messages_leave_at_the_new_rate() -> None:
    flown = Flown(LinkSettings(bandwidth=1.0, queue=8, keep="oldest"), 49)
    flown.change(LinkSettings(bandwidth=4.0, queue=8, keep="oldest"))
    flown.advance(13)
    assert flown.arrived[:, 0].tolist() == [0, 20, 40, 49, 50, 55, 60]
    flown.change(LinkSettings(delay=0.1))
    flown.advance(3)
    assert flown.status.queued == 0
    assert flown.arrived[7:, 0].tolist() == [64] * 9


@pytest.mark.parametrize("keep", KEEPS)
def test_a_shorter_queue_drops_what_it_would_not_keep(keep: str) -> None:
    flown = Flown(LinkSettings(bandwidth=0.1, queue=6, keep=keep), 7)
    flown.change(LinkSettings(bandwidth=20.0, queue=2, keep=keep))
    assert flown.status.lost["queue"] == 4
    flown.advance(2)
    assert flown.arrived[1:3, 1].tolist() == ([5, 6] if keep == "newest" else [1, 2])


def test_burst_and_blackout_continue_under_other_settings() -> None:
    for kind, after in (
        ("burst", LinkSettings(burst_length=2e5, burst_interval=1.0, delay=0.1)),
        ("blackout", LinkSettings(blackout_length=0.1, blackout_interval=1.0)),
    ):
        flown = Flown(LinkSettings(**{f"{kind}_length": 1e5, f"{kind}_interval": 1.0}), 50)
        flown.change(after)
        flown.advance(50)
        assert len(flown.arrived) == 0
        flown.change(LinkSettings())
        flown.advance(50)
        assert len(flown.arrived) == 50


# --- age of information, and the link for Python objects


@pytest.mark.parametrize("every", [1, 3, 70])
def test_age_of_information_is_that_of_the_newest_delivery(every: int) -> None:
    settings = LinkSettings(delay=0.1, reorder=0.5, reorder_delay=1.0, blackouts=((0.5, 0.3),))
    link = OneLink(settings, dt=DT, key=a_key(1, 1))
    assert link.counters().age is None
    ages, delivered = [], []
    for tick in range(300):
        if tick % every == every // 2:
            link.send(tick, tick, tick - 3)
        delivered += link.arrivals(tick)
        if delivered:
            ages.append((tick - max(delivered) + 3) * DT)
            assert link.counters().age == pytest.approx(ages[-1])
    assert delivered != sorted(delivered) or every == 70
    assert link.counters().mean_age == pytest.approx(np.mean(ages))
    assert link.counters().max_age == pytest.approx(max(ages))


class _Message:
    def __init__(self, number: int) -> None:
        self.number = number


@pytest.mark.parametrize("name", [*PROFILES, "busy"])
def test_python_objects_arrive_unchanged_and_are_released(name: str) -> None:
    wanted = PROFILES.get(name, BUSY)
    link, flown = OneLink(wanted, dt=DT, key=a_key(4, 2)), Flown(wanted, 2000, seed=4, link=2)
    arrived, kept = [], weakref.WeakValueDictionary[int, _Message]()
    for tick in range(2000):
        kept[tick] = message = _Message(tick)
        link.send(tick, message, tick)
        del message
        arrived += [(tick, message.number) for message in link.arrivals(tick)]
        left = link.counters().queued + link.counters().in_transit
        assert len(kept) <= left
        assert bool(kept) == bool(left)
    assert arrived == [(t, k) for t, k, _ in flown.arrived.tolist()]
    assert link.counters() == msgspec.structs.replace(flown.status, settings=wanted)
    link.change(LinkSettings())
    for tick in range(2000, 2200):
        link.arrivals(tick)
    assert not kept


# --- settings


WRONG: dict[str, dict[str, Any]] = {
    "delay": {"delay": -0.1},
    "delay = 30.0": {"delay": 30.0, "jitter": 5.0, "jitter_shape": "normal"}
    | {"reorder": 0.1, "reorder_delay": 6.0},
    "max_jitter = -1.0": {"max_jitter": -1.0},
    "jitter = nan": {"jitter": math.nan},
    "jitter_shape": {"jitter_shape": "gaussian"},
    "loss = 1.5": {"loss": 1.5},
    "burst_interval": {"burst_length": 0.5},
    "blackout_length": {"blackout_interval": 5.0},
    "blackout_interval": {"blackout_interval": 1e-9, "blackout_length": 1.0},
    "blackouts.1.0 = -2.0": {"blackouts": ((0.0, 1.0), (-2.0, 1.0))},
    "blackouts.0.1 = 0.0": {"blackouts": ((3.0, 0.0),)},
    "blackouts.0.0 = nan": {"blackouts": ((math.nan, 1.0),)},
    "reorder_delay": {"reorder": 0.1},
    "bandwidth": {"bandwidth": 1e-300},
    "queue = 0": {"queue": 0},
    "keep": {"keep": "latest"},
}


@pytest.mark.parametrize("field", WRONG)
def test_an_impossible_link_is_refused_in_one_line(field: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        check_link(LinkSettings(**WRONG[field]), "escort.toml: link.radio")
    line = str(caught.value)
    wanted = rf"escort\.toml: link\.radio: {re.escape(field)}\b.*: .+; allowed: .+"
    assert re.fullmatch(wanted, line), line
    with pytest.raises(ScenarioError):
        OneLink(LinkSettings(**WRONG[field]), dt=DT, key=a_key(1, 1))


def test_checked_settings_are_equal_and_have_their_types() -> None:
    checked = check_link(LinkSettings(delay=1, loss=np.float64(0.5), blackouts=((1, 2),)), "test")
    assert repr(checked) == repr(LinkSettings(delay=1.0, loss=0.5, blackouts=((1.0, 2.0),)))


@pytest.mark.parametrize("name", PROFILES)
def test_each_profile_is_a_link_that_does_what_it_says(name: str) -> None:
    profile = check_link(PROFILES[name], name)
    assert msgspec.json.decode(msgspec.json.encode(profile), type=LinkSettings) == profile
    status = Flown(profile, 100_000).status
    assert conserved(status)
    assert status.lost["full"] == 0
    assert (status.delivery_ratio == 1.0) == (name == "perfect")
    assert extra_delays(profile)[1] + profile.delay < 1.0
    ranges = {"wifi": (0.98, 0.999), "wifi-poor": (0.8, 0.95), "lte": (0.99, 0.999)}
    low, high = (ranges | {"satellite": (0.98, 0.999)}).get(name, (0.05, 1.0))
    assert low <= (status.delivery_ratio or 0.0) <= high
    assert status.lost["queue"] == 0 or name == "narrowband"
