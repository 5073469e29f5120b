r"""Compiled, seeded radio link in simulated time: a `Link` record and its packets.

In each tick call `begin_tick` once, `send` for each message, then `receive` once. Queued packets leave before new ones.
Ticks in which nothing is sent, queued or in transit may be skipped: the next `begin_tick` catches up.

A packet passes these stages:
1. The sender's queue, if the bandwidth is limited: one packet leaves every 1/bandwidth. A full queue drops the oldest
   queued packet, or the new one. The transmission time is part of the delay.
2. The channel at the tick at which the packet leaves. A blackout, a burst or independent loss drops it; the first of
   them is counted as the cause. The sender does not notice.
3. A packet that gets through may be duplicated. Each copy has its own delay: delay + jitter, and `reorder_delay` for
   reordered packets. With `jitter_time`, the jitter of all packets (not of copies) is the quantile of one process in
   time. A packet that leaves at tick k with the delay d arrives at the first tick n with n dt >= k dt + d.
   Packets of one tick arrive in the order in which they left.

A trace (`LinkParameters.replay`) is replayed in a loop from an offset that is drawn once from the link's key. In a
table of delays, the last row before the packet replaces the random numbers of stages 2 and 3. With delivery
opportunities, packets are queued until their bytes have been granted, 1,500 at each opportunity after sending; they
pass stages 2 and 3 as at the tick before they leave.

Random numbers are pure functions of (key of the link, purpose, tick, index). The index is a packet's number within its
tick; the channel uses the tick, or the number of the random blackout.

Packets are in three lists of the array `packets`, shape (worlds, links, lists, room). `FLYING` is a ring in the order
in which packets left, `WAITING` the ring of the sender's queue, `ARRIVED` the arrivals of the tick. The caller may
write the packet to send into the first element of `ARRIVED`.
"""

import math

import numpy as np

from bus.ticks import TICK_TOLERANCE, first_tick_from
from sim.channel.jitter import jitter_quantile, normal_quantile
from sim.channel.link_records import (
    ARRIVED,
    BLACKOUT,
    BURST,
    DELAYS,
    FLYING,
    FULL,
    LOSS,
    OPPORTUNITIES,
    QUEUE,
    TRACE,
    WAITING,
    Link,
    LinkParameters,
    Packet,
)
from sim.compiling.compile import IntArray, compiled, constant
from sim.compiling.records import RecordArray
from sim.models.randomness import (
    LINK_DELAY,
    LINK_LOSS,
    LINK_STATE,
    LINK_TRACE,
    Key,
    draw,
    to_uniform,
    uniform,
)

_ZERO, _ONE, _TWO = constant(0), constant(1), constant(2)
_SMALLEST = 2.0**-54


_first_tick_from = compiled(first_tick_from)


@compiled
def _transit_time(parameters: LinkParameters, share: float, reordered: bool, later: float) -> int:
    """Return the transit time [ticks] of a packet that leaves `later` [s] after its tick.

    Args:
        parameters: Parameters of the link.
        share: Quantile of the packet's extra delay.
        reordered: True if the packet is reordered.
        later: Time after the tick [s].
    """
    settings, extra = parameters.settings, 0.0
    if settings.jitter > 0.0:
        extra = jitter_quantile(
            parameters.jitter_shape,
            settings.jitter,
            parameters.low + share * (parameters.high - parameters.low),
        )
        extra = min(max(extra, parameters.least), parameters.most)
    return _first_tick_from(
        settings.delay + extra + (settings.reorder_delay if reordered else 0.0) + later,
        parameters.dt,
    )


@compiled
def trace_offset(key: Key, period: int) -> int:
    """Return the offset at which the loop of a trace starts."""
    return int(draw(key, LINK_TRACE, _ZERO, _ZERO)[0] % np.uint64(period))


@compiled
def in_milliseconds(tick: int, dt: float) -> int:
    """Return the last full millisecond up to this tick."""
    return math.floor(tick * dt * 1000.0 + TICK_TOLERANCE)


@compiled
def _first_after(rows: IntArray, column: int, first: int, end: int, time: int) -> int:
    """Return the first of these rows whose time in a column is later than `time`; `end`: none."""
    below, above = first, end
    while below < above:
        middle = (below + above) // 2
        if rows[middle, column] <= time:
            below = middle + 1
        else:
            above = middle
    return below


@compiled
def _key_of(link: Link) -> Key:
    return link.key[0], link.key[1]


@compiled
def _ring_index(link: Link, k: int) -> int:
    """Return the ring index for a number below twice the ring's size."""
    return k - link.room if k >= link.room else k


@compiled
def _close_gaps(link: Link, packets: RecordArray, w: int) -> None:
    """Remove arrived packets from the ring, behind a packet with a longer delay."""
    row, kept = link.number, 0
    for n in range(link.span):
        packet = packets[w, row, FLYING, _ring_index(link, link.first + n)]
        if packet.due >= 0:
            packets[w, row, FLYING, _ring_index(link, link.first + kept)] = packet
            kept += 1
    link.span = kept


@compiled
def _transport(link: Link, packets: RecordArray, w: int, packet: Packet, due: int) -> None:
    """Add a packet to those in transit."""
    if link.in_transit == link.room:
        link.lost[FULL] += 1
        return
    if link.span == link.room:
        _close_gaps(link, packets, w)
    k = _ring_index(link, link.first + link.span)
    packets[w, link.number, FLYING, k] = packet
    packets[w, link.number, FLYING, k].due = due
    link.span += 1
    link.in_transit += 1


@compiled
def _replay(link: Link, packets: RecordArray, w: int, traces: IntArray, packet: Packet) -> None:
    """Send a packet with the delay or loss of the last trace row before it was sent."""
    p = link.parameters
    phase = (packet.sent_at + trace_offset(_key_of(link), p.period)) % p.period
    ticks = traces[_first_after(traces, 0, p.first_row, p.end_row, phase) - 1, 1]
    if link.blackout or ticks < 0:
        link.lost[BLACKOUT if link.blackout else TRACE] += 1
    else:
        _transport(link, packets, w, packet, link.tick + ticks)


@compiled
def _transmit(link: Link, packets: RecordArray, w: int, packet: Packet, later: float) -> None:
    """Transmit a packet: the channel drops it or delivers it, possibly twice.

    Args:
        link, packets, w: The link.
        packet: The packet; changed.
        later: Time after the link's tick at which it leaves [s].
    """
    p, s = link.parameters, link.parameters.settings
    key, bad = _key_of(link), link.bad == 1
    if link.blackout:
        link.lost[BLACKOUT] += 1
        return
    twice, reordered = False, False
    if s.loss > 0.0 or bad or s.duplicates > 0.0 or s.reorder > 0.0:
        word_0, word_1, word_2, word_3 = draw(key, LINK_LOSS, packet.sent_at, packet.number)
        if bad and to_uniform(word_1) < s.burst_loss:
            link.lost[BURST] += 1
            return
        if to_uniform(word_0) < s.loss:
            link.lost[LOSS] += 1
            return
        twice, reordered = to_uniform(word_2) < s.duplicates, to_uniform(word_3) < s.reorder
    share, share_too, reordered_too = 0.0, 0.0, False
    if s.jitter > 0.0 or twice:
        word_0, word_1, word_2, _ = draw(key, LINK_DELAY, packet.sent_at, packet.number)
        share, share_too = to_uniform(word_0), to_uniform(word_1)
        if p.memory > 0.0:
            share = 0.5 * math.erfc(-link.score / math.sqrt(2.0))
        reordered_too = to_uniform(word_2) < s.reorder
    _transport(link, packets, w, packet, link.tick + _transit_time(p, share, reordered, later))
    if twice and link.in_transit < link.room:
        link.duplicated += 1
        packet.copy = True
        _transport(
            link, packets, w, packet, link.tick + _transit_time(p, share_too, reordered_too, later)
        )


@compiled
def _in_random_blackout(link: Link, tick: int) -> bool:
    """Draw exponential times between blackouts of fixed duration, stationary from the first tick on."""
    up, down = link.parameters.up, link.parameters.down
    while link.blackout_end <= tick + TICK_TOLERANCE:
        word_0, word_1, _, _ = draw(_key_of(link), LINK_STATE, link.renewals, _ONE)
        link.renewals += 1
        between = -up * math.log1p(-to_uniform(word_0))
        phase = to_uniform(word_1) * (up + down)
        if link.blackout_end >= 0.0:
            link.blackout_begin = link.blackout_end + between
        else:
            link.blackout_begin = tick + (phase - down if phase < down else between)
        link.blackout_end = link.blackout_begin + down
    return bool(link.blackout_begin <= tick + TICK_TOLERANCE)


@compiled
def _draw_score(link: Link, tick: int) -> None:
    """Draw the normal score of this tick's extra delays: a stationary process, correlated with the last tick's."""
    share = max(uniform(_key_of(link), LINK_STATE, tick, _TWO), _SMALLEST)
    score = normal_quantile(share)
    if not math.isnan(link.score):
        score = link.parameters.memory * link.score + link.parameters.innovation * score
    link.score = score


@compiled
def _draw_channel(link: Link, traces: IntArray, tick: int) -> None:
    """Start a tick with the state of the channel: good or bad, late or early, blackout or not."""
    p = link.parameters
    link.tick, link.index = tick, 0
    if p.perfect and link.queued == 0:
        return
    if p.bursts:
        chance = p.bad_stay if link.bad == 1 else p.bad_enter
        if link.bad < 0:
            chance = p.bad_share
        link.bad = 1 if uniform(_key_of(link), LINK_STATE, tick, _ZERO) < chance else 0
    if p.memory > 0.0:
        _draw_score(link, tick)
    row = _first_after(traces, 1, p.first_blackout, p.end_blackout, tick)
    blackout = row < p.end_blackout and traces[row, 0] <= tick
    if p.up > 0.0:
        blackout = _in_random_blackout(link, tick) or blackout
    link.blackout = blackout


@compiled
def _count_age(link: Link) -> None:
    """End a tick: add the age of the newest stamp."""
    if not math.isnan(link.newest):
        age = link.tick - link.newest
        link.age_max = age if link.ages == 0 else max(link.age_max, age)
        link.age_sum += age
        link.ages += 1


@compiled
def _sender_is_free(link: Link) -> bool:
    """True if the sender may transmit at this tick: packet m of a busy period leaves m spacings after the first."""
    return bool(
        link.busy_since + link.served * link.parameters.spacing <= link.tick + TICK_TOLERANCE
    )


@compiled
def _leave_queue(link: Link) -> int:
    """Remove the oldest queued packet; return its index."""
    k = link.first_waiting
    link.first_waiting = _ring_index(link, k + 1)
    link.queued -= 1
    return k


@compiled
def _grant(link: Link, packets: RecordArray, w: int, traces: IntArray, tick: int) -> None:
    """Transmit packets at the recorded opportunities from the link's tick up to `tick`, which is the next."""
    p, message_bytes = link.parameters, link.parameters.settings.message_bytes
    offset = trace_offset(_key_of(link), p.period)
    begin = in_milliseconds(tick - 1, p.dt) + offset
    end = in_milliseconds(tick, p.dt) + offset
    start, phase = begin - begin % p.period, begin % p.period
    k = _first_after(traces, 0, p.first_row, p.end_row, phase)
    while link.queued > 0:
        now = start + traces[k, 0]
        if now > end:
            return
        bytes_left = p.opportunity
        while bytes_left > 0 and link.queued > 0:
            used = min(bytes_left, message_bytes - link.granted)
            bytes_left -= used
            link.granted += used
            if link.granted == message_bytes:
                link.granted = 0
                # slightly later than the tick, so that a packet that leaves after a tick arrives after it
                later = max(0.001 * (now - offset) - (tick - 1) * p.dt, 2.0 * TICK_TOLERANCE * p.dt)
                packet = packets[w, link.number, WAITING, _leave_queue(link)]
                _transmit(link, packets, w, packet, later)
        k += 1
        if k == p.end_row:
            k, start = p.first_row, start + p.period


@compiled
def catch_up(link: Link, traces: IntArray, tick: int) -> None:
    """Catch up on skipped ticks up to `tick`; no packet was queued or in transit in them."""
    while link.tick < tick:
        _draw_channel(link, traces, link.tick + 1)
        _count_age(link)


@compiled
def begin_tick(link: Link, packets: RecordArray, w: int, traces: IntArray, tick: int) -> None:
    """Start a tick: draw the channel's state, then transmit from the queue. Call once per tick, in order.

    Args:
        link: The link; changed.
        packets: Packets of all links. Shape (worlds, links, 3, room).
        w: World of the link.
        traces: Scheduled blackouts and traces. Shape (rows, 2).
        tick: The tick; 0 is the first.
    """
    catch_up(link, traces, tick - 1)
    p = link.parameters
    if link.queued > 0 and p.replay == OPPORTUNITIES:
        _grant(link, packets, w, traces, tick)
    _draw_channel(link, traces, tick)
    while link.queued > 0 and p.replay != OPPORTUNITIES and _sender_is_free(link):
        link.served += 1
        packet = packets[w, link.number, WAITING, _leave_queue(link)]
        if p.replay == DELAYS:
            _replay(link, packets, w, traces, packet)
        else:
            _transmit(link, packets, w, packet, 0.0)


@compiled
def _wait(link: Link, packets: RecordArray, w: int, packet: Packet) -> None:
    """Add a packet to the sender's queue, which drops one if it is full."""
    row, partial = link.number, 1 if link.granted > 0 else 0  # 1: the first is partly sent
    if link.queued - partial >= link.parameters.settings.queue:
        link.lost[QUEUE] += 1
        if not link.parameters.newest:
            return
        first = _leave_queue(link)
        if partial == 1:  # it replaces the next one, which is dropped
            packets[w, row, WAITING, link.first_waiting] = packets[w, row, WAITING, first]
    if link.queued == link.room:
        link.lost[FULL] += 1
        return
    packets[w, row, WAITING, _ring_index(link, link.first_waiting + link.queued)] = packet
    link.queued += 1


@compiled
def send(link: Link, packets: RecordArray, w: int, traces: IntArray, packet: Packet) -> None:
    """Send one packet at the tick that `begin_tick` has started.

    Args:
        link, packets, w, traces: As in `begin_tick`.
        packet: The packet, with its content; changed and copied.
    """
    packet.sent_at, packet.number, packet.copy = link.tick, link.index, False
    link.index += 1
    link.sent += 1
    p = link.parameters
    if link.queued > 0 or p.replay == OPPORTUNITIES or not _sender_is_free(link):
        _wait(link, packets, w, packet)
        return
    link.busy_since, link.served = link.tick, 1
    if p.perfect:
        _transport(link, packets, w, packet, link.tick)
    elif p.replay == DELAYS:
        _replay(link, packets, w, traces, packet)
    else:
        _transmit(link, packets, w, packet, 0.0)


@compiled
def receive(link: Link, packets: RecordArray, w: int) -> int:
    """End a tick: copy its arrivals into the list `ARRIVED`, and add the age of the newest stamp.

    Args:
        link, packets, w: As in `begin_tick`.

    Returns:
        Number of arrivals, which is `link.arrived`.
    """
    row, arrived = link.number, 0
    for n in range(link.span):
        packet = packets[w, row, FLYING, _ring_index(link, link.first + n)]
        if packet.due == link.tick:
            packets[w, row, ARRIVED, arrived] = packet
            arrived += 1
            if not packet.stamp <= link.newest:
                link.newest = packet.stamp
            link.delivered += 1
            link.originals += 0 if packet.copy else 1
            link.in_transit -= 1
            packet.due = -1
    while link.span > 0 and packets[w, row, FLYING, link.first].due < 0:
        link.first = _ring_index(link, link.first + 1)
        link.span -= 1
    link.arrived = arrived
    _count_age(link)
    return arrived
