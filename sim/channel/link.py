r"""One radio link in simulated time: compiled, seeded, the same bits for one world and for many.

A tick of a link has one order: `advance` once, `send` for each message of this tick, `receive` once; `exchange` does
the three. `advance` comes first: it settles what the channel is like at this tick, and what waits at the sender leaves
before what is new. Ticks in which nothing is sent, waits or flies may be left out: the next `advance` makes them up.

A message meets, in this order:

1. The sender's queue, where the bandwidth is limited: one message leaves every 1/bandwidth; one that finds the queue
   full costs the oldest that waits, or itself. The time on the air is no part of this, it belongs to the delay.
2. The channel at the tick at which it leaves. A blackout takes it, or a burst, or independent loss: the first of them
   is the cause that is counted. The sender does not notice.
3. What gets through may be doubled, and each of the two has a delay of its own: delay + jitter, and for those held back
   more. One that leaves at tick k with the delay d arrives at the first tick n with n dt >= k dt + d; among those of
   one tick the first sent comes first.

A recorded link (`LinkParameters.replay`) is played in a loop from an offset on that is drawn once from the link's key:
of a table of fates, the row that is nearest before the message tells its delay or its loss, in the place of the draws
in 2 and 3; with delivery opportunities, messages wait at the sender until their bytes have been granted, 1,500 at each
opportunity after they were sent, and meet 2 and 3 as at the tick before they leave.

Draws are pure functions of (the link's key, purpose, tick, index): those of a message by the tick at which it was
sent and its number within that tick; those of the channel by the tick, or by the number of the random blackout.
"""

import math
from typing import NamedTuple

import numpy as np

from bus.ticks import DUST, first_tick_from
from sim.channel.ring import LinkParameters
from sim.kernels.compile import FloatArray, IntArray, borrowing, compiled
from sim.kernels.records import RecordArray, record_type
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

UNIFORM, NORMAL, EXPONENTIAL, PARETO = range(4)
SHAPES = {"uniform": UNIFORM, "normal": NORMAL, "exponential": EXPONENTIAL, "pareto": PARETO}
"""The spread of the extra delay, by the scale j: within -j and j; normal with deviation j; exponential with mean j;
Pareto's law of the second kind (from 0 on) with mean j and the tail index 2.5, whose variance is finite and whose skew
is not.
"""

CAUSES = ("loss", "burst", "blackout", "queue", "full", "trace")
"""Why messages are lost; `full`: the link had no room, which one message a tick never meets; `trace`: it was lost in
the recorded link."""

LOSS, BURST, BLACKOUT, QUEUE, FULL, TRACE = range(6)

NOTHING, FATES, OPPORTUNITIES = range(3)
"""The kind of recording: none, a table of fates, or delivery opportunities."""

_TAIL = 2.5


@compiled
def normal_quantile(share: float) -> float:
    """The x below which this share of a standard normal lies; 0 < share < 1.

    Abramowitz and Stegun, *Handbook of Mathematical Functions*, 26.2.23, off by less than 4.5e-4, then two steps
    of Halley towards the share, which leave rounding.
    """
    tail = min(share, 1.0 - share)
    t = math.sqrt(-2.0 * math.log(tail))
    top = (0.010328 * t + 0.802853) * t + 2.515517
    bottom = ((0.001308 * t + 0.189269) * t + 1.432788) * t + 1.0
    x = top / bottom - t
    for _ in range(2):
        off = 0.5 * math.erfc(-x / math.sqrt(2.0)) - tail
        step = off * math.sqrt(2.0 * math.pi) * math.exp(0.5 * x * x)
        x -= step / (1.0 + 0.5 * x * step)
    return x if share < 0.5 else -x


@compiled
def jitter_share(shape: int, scale: float, extra: float) -> float:
    """The share of extra delays up to `extra` [s]; shape and scale [s] as in `SHAPES`."""
    x = extra / scale
    if shape == UNIFORM:
        return min(max(0.5 * (x + 1.0), 0.0), 1.0)
    if shape == NORMAL:
        return 0.5 * math.erfc(-x / math.sqrt(2.0))
    if x <= 0.0:
        return 0.0
    if shape == EXPONENTIAL:
        return -math.expm1(-x)
    return 1.0 - float((1.0 + x / (_TAIL - 1.0)) ** -_TAIL)


@compiled
def jitter_quantile(shape: int, scale: float, share: float) -> float:
    """The extra delay [s] up to which this share of them lies; the inverse of `jitter_share`."""
    inner = min(max(share, 1e-300), 1.0 - 2.0**-53)
    if shape == UNIFORM:
        return scale * (2.0 * share - 1.0)
    if shape == NORMAL:
        return scale * normal_quantile(inner)
    if shape == EXPONENTIAL:
        return -scale * math.log1p(-inner)
    return scale * (_TAIL - 1.0) * (float((1.0 - inner) ** (-1.0 / _TAIL)) - 1.0)


class LinkNumbers(NamedTuple):
    """The numbers of many links, one row a link. Made by `sim.channel.description.link_table`."""

    rows: RecordArray
    """The numbers of `LinkParameters`. Shape (links,)."""
    pairs: IntArray
    """The planned blackouts of all links, one after the other, then what is played, each once. Shape (any, 2).

    In one array, since each that is handed on costs every link time.
    """
    owners: IntArray
    """Purpose and vehicle of each link's key. Shape (links, 2)."""


class LinkMemory:
    """The memory of a link beside its messages, a row of `LinkState.memory`."""

    tick: int
    index: int
    """Messages sent in this tick."""
    free: int
    """The first free slot; -1: none."""
    waiting: int
    flying: int
    """Messages at the sender, and on their way."""
    chain: int
    """The channel's state: 1: bad, 0: good, -1: not drawn yet."""
    dark: bool
    """True in a blackout."""
    served: int
    """Messages that have left since the sender was last idle."""
    renewals: int
    """Random blackouts drawn."""
    granted: int
    """Bytes granted to the message that waits first."""
    sent: int
    delivered: int
    duplicated: int
    originals: int
    """Messages delivered, without copies."""
    ages: int
    """Ticks in `age_sum`."""
    began: float
    """Since when the sender is busy [ticks]."""
    dark_from: float
    dark_to: float
    """The random blackout [ticks]; -1: none drawn yet."""
    newest: float
    """The newest stamp that has arrived [ticks]; NaN: none."""
    age_sum: float
    age_max: float
    """Of the newest stamp's age at each tick [ticks]."""


class Slot:
    """A message that waits or flies, a row of `LinkState.slots`."""

    next: int
    """The slot behind it, in its bucket or among the free ones; -1: none."""
    due: int
    """The tick at which it arrives."""
    sent_at: int
    number: int
    """Within the tick at which it was sent."""
    copy: bool


class Bucket:
    """Slots in order, a row of `LinkState.buckets`; -1: none."""

    first: int
    last: int


class LinkState(NamedTuple):
    """Everything that a link remembers.

    With an axis for worlds in front it is the state of one link in each of them.
    """

    slots: RecordArray
    """A row of `Slot` for each message that waits or flies. Shape (room,)."""
    payload: FloatArray
    """Contents; column 0 is the tick that its content is from. Shape (room, width)."""
    buckets: RecordArray
    """A row of `Bucket` for each tick to come, modulo their number, and for the queue in the last."""
    memory: RecordArray
    """One row of `LinkMemory`. Shape (1,)."""
    lost: IntArray
    """Messages lost by each of `CAUSES`. Shape (causes,)."""


def link_state(
    parameters: LinkParameters, width: int, *, room: int = 0, wheel: int = 0
) -> LinkState:
    """A link on which nothing was ever sent.

    Args:
        parameters: Of the link.
        width: Numbers in a message's payload, 1 or more.
        room: Slots, where more than the parameters ask for are needed.
        wheel: Ticks to come that can be told apart, where more than the parameters ask for are needed.
    """
    room, wheel = max(room, parameters.room), max(wheel, parameters.longest + 1)
    state = LinkState(
        slots=np.zeros(room, dtype=record_type(Slot)),
        payload=np.zeros((room, width)),
        buckets=np.zeros(wheel + 1, dtype=record_type(Bucket)),
        memory=np.zeros(1, dtype=record_type(LinkMemory)),
        lost=np.zeros(len(CAUSES), dtype=np.int64),
    )
    state.slots["next"] = [*range(1, room), -1]
    state.buckets["first"] = state.buckets["last"] = -1
    memory = state.memory
    memory["tick"] = memory["chain"] = memory["dark_from"] = memory["dark_to"] = -1
    memory["newest"] = math.nan
    return state


@borrowing
def take(slots: RecordArray, memory: LinkMemory) -> int:
    """A free slot, or -1."""
    slot = int(memory.free)
    if slot >= 0:
        memory.free = slots[slot].next
    return slot


@borrowing
def release(slots: RecordArray, memory: LinkMemory, slot: int) -> None:
    """The slot is free again."""
    slots[slot].next = memory.free
    memory.free = slot


@borrowing
def append(slots: RecordArray, buckets: RecordArray, bucket: int, slot: int) -> None:
    """Put a slot last into a bucket."""
    slots[slot].next = -1
    if buckets[bucket].first < 0:
        buckets[bucket].first = slot
    else:
        slots[buckets[bucket].last].next = slot
    buckets[bucket].last = slot


@borrowing
def wait(slots: RecordArray, buckets: RecordArray, memory: LinkMemory, slot: int) -> None:
    """The message joins the sender's queue."""
    append(slots, buckets, buckets.shape[0] - 1, slot)
    memory.waiting += 1


@borrowing
def wait_first(slots: RecordArray, buckets: RecordArray, memory: LinkMemory, slot: int) -> None:
    """The message joins the sender's queue in front of all others."""
    queue = buckets.shape[0] - 1
    slots[slot].next = buckets[queue].first
    if buckets[queue].first < 0:
        buckets[queue].last = slot
    buckets[queue].first = slot
    memory.waiting += 1


@borrowing
def fly(slots: RecordArray, buckets: RecordArray, memory: LinkMemory, slot: int, due: int) -> None:
    """The message is on its way."""
    slots[slot].due = due
    append(slots, buckets, due % (buckets.shape[0] - 1), slot)
    memory.flying += 1


@borrowing
def leave_queue(slots: RecordArray, buckets: RecordArray, memory: LinkMemory) -> int:
    """The slot of the message that has waited longest."""
    queue = buckets.shape[0] - 1
    slot = int(buckets[queue].first)
    buckets[queue].first = slots[slot].next
    memory.waiting -= 1
    return slot


_first_tick_from = compiled(first_tick_from)


@compiled
def _flight_time(parameters: LinkParameters, share: float, held: bool, later: float) -> int:
    """The time of flight of a message [ticks].

    Args:
        parameters: Of the link.
        share: Of the extra delays that are shorter than its own.
        held: Whether it is held back.
        later: Time after the tick at which it leaves [s].
    """
    extra = 0.0
    if parameters.jitter > 0.0:
        extra = jitter_quantile(
            parameters.jitter_shape,
            parameters.jitter,
            parameters.low + share * (parameters.high - parameters.low),
        )
        extra = min(max(extra, parameters.least), parameters.most)
    return _first_tick_from(
        parameters.delay + extra + (parameters.reorder_delay if held else 0.0) + later,
        parameters.dt,
    )


@compiled
def _fate(
    parameters: LinkParameters, dark: bool, bad: bool, key: Key, tick: int, index: int
) -> tuple[int, bool, bool]:
    """Decide what the channel does to one message.

    The cause of its loss or -1, whether it is doubled, whether it is held back.
    """
    if dark:
        return BLACKOUT, False, False
    if not (
        parameters.loss > 0.0 or bad or parameters.duplicates > 0.0 or parameters.reorder > 0.0
    ):
        return -1, False, False
    word_0, word_1, word_2, word_3 = draw(key, LINK_LOSS, tick, index)
    if bad and to_uniform(word_1) < parameters.burst_loss:
        return BURST, False, False
    if to_uniform(word_0) < parameters.loss:
        return LOSS, False, False
    return -1, to_uniform(word_2) < parameters.duplicates, to_uniform(word_3) < parameters.reorder


@compiled
def trace_offset(key: Key, period: int) -> int:
    """The place in a recorded link at which a run begins, of so many."""
    return int(draw(key, LINK_TRACE, 0, 0)[0] % np.uint64(period))


@borrowing
def _first_after(rows: IntArray, column: int, first: int, end: int, time: int) -> int:
    """The first of these rows whose time in a column is later than this one; `end`: none."""
    below, above = first, end
    while below < above:
        middle = (below + above) // 2
        if rows[middle, column] <= time:
            below = middle + 1
        else:
            above = middle
    return below


@borrowing
def _play(
    traces: IntArray, parameters: LinkParameters, state: LinkState, key: Key, slot: int
) -> None:
    """The message leaves the sender, and has the fate of the recorded row that is nearest before it."""
    slots, memory = state.slots, state.memory[0]
    place = (slots[slot].sent_at + trace_offset(key, parameters.period)) % parameters.period
    ticks = traces[_first_after(traces, 0, parameters.first_row, parameters.end_row, place) - 1, 1]
    if memory.dark or ticks < 0:
        state.lost[BLACKOUT if memory.dark else TRACE] += 1
        release(slots, memory, slot)
    else:
        fly(slots, state.buckets, memory, slot, memory.tick + ticks)


@borrowing
def _transmit(
    parameters: LinkParameters, state: LinkState, key: Key, slot: int, later: float
) -> None:
    """The message leaves the sender: the channel takes it, or it flies, perhaps twice.

    Args:
        parameters, state, key: The link; its state is changed.
        slot: Of the message.
        later: Time after the link's tick at which it leaves [s].
    """
    slots, payload, buckets, memory = state.slots, state.payload, state.buckets, state.memory[0]
    tick, index = slots[slot].sent_at, slots[slot].number
    lost, twice, held = _fate(parameters, memory.dark, memory.chain == 1, key, tick, index)
    if lost >= 0:
        state.lost[lost] += 1
        release(slots, memory, slot)
        return
    share, share_too, held_too = 0.0, 0.0, False
    if parameters.jitter > 0.0 or twice:
        word_0, word_1, word_2, _ = draw(key, LINK_DELAY, tick, index)
        share, share_too = to_uniform(word_0), to_uniform(word_1)
        held_too = to_uniform(word_2) < parameters.reorder
    fly(slots, buckets, memory, slot, memory.tick + _flight_time(parameters, share, held, later))
    other = take(slots, memory) if twice else -1
    if other >= 0:
        memory.duplicated += 1
        slots[other].copy = True
        for k in range(payload.shape[1]):
            payload[other, k] = payload[slot, k]
        due = memory.tick + _flight_time(parameters, share_too, held_too, later)
        fly(slots, buckets, memory, other, due)


@borrowing
def _dark_by_plan(blackouts: IntArray, first: int, end: int, tick: int) -> bool:
    row = _first_after(blackouts, 1, first, end, tick)
    return row < end and bool(blackouts[row, 0] <= tick)


@borrowing
def _dark_by_chance(up: float, down: float, memory: LinkMemory, key: Key, tick: int) -> bool:
    """Exponential times of light and fixed ones of darkness, in continuous time; stationary from the first tick on."""
    while memory.dark_to <= tick + DUST:
        word_0, word_1, _, _ = draw(key, LINK_STATE, memory.renewals, 1)
        memory.renewals += 1
        light = -up * math.log1p(-to_uniform(word_0))
        place = to_uniform(word_1) * (up + down)
        if memory.dark_to >= 0.0:
            memory.dark_from = memory.dark_to + light
        else:
            memory.dark_from = tick + (place - down if place < down else light)
        memory.dark_to = memory.dark_from + down
    return bool(memory.dark_from <= tick + DUST)


@borrowing
def _settle(numbers: LinkNumbers, row: int, state: LinkState, key: Key, tick: int) -> None:
    """Begin a tick: what the channel is like at it, good or bad, dark or not."""
    parameters, memory = numbers.rows[row], state.memory[0]
    memory.tick, memory.index = tick, 0
    if parameters.perfect and memory.waiting == 0:
        return
    if parameters.bursts:
        chance = parameters.bad_stay if memory.chain == 1 else parameters.bad_enter
        if memory.chain < 0:
            chance = parameters.bad_share
        memory.chain = 1 if uniform(key, LINK_STATE, tick, 0) < chance else 0
    dark = _dark_by_plan(numbers.pairs, parameters.first_blackout, parameters.end_blackout, tick)
    if parameters.up > 0.0:
        dark = _dark_by_chance(parameters.up, parameters.down, memory, key, tick) or dark
    memory.dark = dark


@borrowing
def _is_free(spacing: float, memory: LinkMemory) -> bool:
    """True if the sender may let a message go at this tick.

    Number m of a busy time leaves m spacings after the first.
    """
    return bool(memory.began + memory.served * spacing <= memory.tick + DUST)


@borrowing
def _note_age(memory: LinkMemory) -> None:
    """End a tick: count the age of what is known."""
    if not math.isnan(memory.newest):
        age = memory.tick - memory.newest
        memory.age_max = age if memory.ages == 0 else max(memory.age_max, age)
        memory.age_sum += age
        memory.ages += 1


@borrowing
def make_up(numbers: LinkNumbers, row: int, state: LinkState, key: Key, tick: int) -> None:
    """Go through the ticks up to this one, it included, that were left out; in none of them was anything under way.

    Args:
        numbers, row: The link.
        state: Is changed.
        key: Of the draws.
        tick: The last one that is over; the first is 0.
    """
    memory = state.memory[0]
    while memory.tick < tick:
        _settle(numbers, row, state, key, memory.tick + 1)
        _note_age(memory)


@compiled
def in_milliseconds(tick: int, dt: float) -> int:
    """The last whole millisecond up to this tick."""
    return math.floor(tick * dt * 1000.0 + DUST)


@borrowing
def _grant(numbers: LinkNumbers, row: int, state: LinkState, key: Key, tick: int) -> None:
    """Let what waits leave at the recorded opportunities since the link's tick, up to this one, which is the next."""
    parameters, memory, traces = numbers.rows[row], state.memory[0], numbers.pairs
    offset = trace_offset(key, parameters.period)
    begin = in_milliseconds(tick - 1, parameters.dt) + offset
    end = in_milliseconds(tick, parameters.dt) + offset
    start, place = begin - begin % parameters.period, begin % parameters.period
    k = _first_after(traces, 0, parameters.first_row, parameters.end_row, place)
    while memory.waiting > 0:
        now = start + traces[k, 0]
        if now > end:
            return
        bytes_left = parameters.opportunity
        while bytes_left > 0 and memory.waiting > 0:
            used = min(bytes_left, parameters.message_bytes - memory.granted)
            bytes_left -= used
            memory.granted += used
            if memory.granted == parameters.message_bytes:
                memory.granted = 0
                # a moment past the tick at least, so that what leaves after a tick arrives after it
                later = max(
                    0.001 * (now - offset) - (tick - 1) * parameters.dt, 2.0 * DUST * parameters.dt
                )
                _transmit(
                    parameters, state, key, leave_queue(state.slots, state.buckets, memory), later
                )
        k += 1
        if k == parameters.end_row:
            k, start = parameters.first_row, start + parameters.period


@borrowing
def advance(numbers: LinkNumbers, row: int, state: LinkState, key: Key, tick: int) -> None:
    """Begin a tick: the channel's state, then whatever may leave the queue. Once a tick, in order.

    Args:
        numbers, row: The link.
        state: Is changed.
        key, tick: Of the draws; tick 0 is the first.
    """
    parameters, memory = numbers.rows[row], state.memory[0]
    make_up(numbers, row, state, key, tick - 1)
    if memory.waiting > 0 and parameters.replay == OPPORTUNITIES:
        _grant(numbers, row, state, key, tick)
    _settle(numbers, row, state, key, tick)
    while (
        memory.waiting > 0
        and parameters.replay != OPPORTUNITIES
        and _is_free(parameters.spacing, memory)
    ):
        memory.served += 1
        slot = leave_queue(state.slots, state.buckets, memory)
        if parameters.replay == FATES:
            _play(numbers.pairs, parameters, state, key, slot)
        else:
            _transmit(parameters, state, key, slot, 0.0)


@borrowing
def send(numbers: LinkNumbers, row: int, state: LinkState, key: Key, payload: FloatArray) -> None:
    """Send one message at the tick that `advance` has begun.

    Args:
        numbers, row: The link.
        state: Is changed.
        key: As in `advance`.
        payload: Is copied; element 0 is the tick that its content is from. Shape (width,).
    """
    parameters = numbers.rows[row]
    slots = state.slots
    held = state.payload
    buckets = state.buckets
    memory = state.memory[0]
    index = memory.index
    memory.index += 1
    memory.sent += 1
    busy = (
        memory.waiting > 0
        or parameters.replay == OPPORTUNITIES
        or not _is_free(parameters.spacing, memory)
    )
    begun = 1 if busy and memory.granted > 0 else 0  # the first that waits is leaving already
    if busy and memory.waiting - begun >= parameters.queue:
        state.lost[QUEUE] += 1
        if not parameters.newest:
            return
        first = leave_queue(slots, buckets, memory)
        release(slots, memory, leave_queue(slots, buckets, memory) if begun else first)
        if begun:
            wait_first(slots, buckets, memory, first)
    slot = take(slots, memory)
    if slot < 0:
        state.lost[FULL] += 1
        return
    for k in range(held.shape[1]):
        held[slot, k] = payload[k]
    slots[slot].sent_at, slots[slot].number, slots[slot].copy = memory.tick, index, False
    if busy:
        wait(slots, buckets, memory, slot)
        return
    memory.began, memory.served = memory.tick, 1
    if parameters.perfect:
        fly(slots, buckets, memory, slot, memory.tick)
    elif parameters.replay == FATES:
        _play(numbers.pairs, parameters, state, key, slot)
    else:
        _transmit(parameters, state, key, slot, 0.0)


@borrowing
def receive(state: LinkState, out: FloatArray) -> int:
    """End a tick: hand out what arrives at it, and note the age of what is known.

    Args:
        state: Is changed.
        out: Gets a row for each message that arrives; as many rows as the state has slots are always enough. Shape
            (rows, width).

    Returns:
        How many have arrived.

    Raises:
        ValueError: If `out` has too few rows.
    """
    slots, payload, buckets, memory = state.slots, state.payload, state.buckets, state.memory[0]
    bucket = memory.tick % (buckets.shape[0] - 1)
    n, slot = 0, buckets[bucket].first
    while slot >= 0:
        if n == out.shape[0]:
            raise ValueError("out has fewer rows than messages arrive")
        for k in range(payload.shape[1]):
            out[n, k] = payload[slot, k]
        if not payload[slot, 0] <= memory.newest:
            memory.newest = payload[slot, 0]
        memory.delivered += 1
        memory.originals += 0 if slots[slot].copy else 1
        memory.flying -= 1
        buckets[bucket].first = slots[slot].next
        release(slots, memory, slot)
        slot = buckets[bucket].first
        n += 1
    _note_age(memory)
    return n


@borrowing
def exchange(
    numbers: LinkNumbers,
    state: LinkState,
    key: Key,
    tick: int,
    payloads: FloatArray,
    count: int,
    out: FloatArray,
) -> tuple[int, int]:
    """One whole tick of a table's only link: `advance`, `send` for the first rows of `payloads`, `receive` into `out`.

    How many have arrived, and how many wait or fly, with all copies.
    """
    advance(numbers, 0, state, key, tick)
    for k in range(count):
        send(numbers, 0, state, key, payloads[k])
    arrived = receive(state, out)
    return arrived, state.memory[0].waiting + state.memory[0].flying


@borrowing
def underway(state: LinkState, out: FloatArray) -> int:
    """Write the payloads of all that wait or fly into `out`, which has a row for each slot; how many there are."""
    n = 0
    for bucket in range(state.buckets.shape[0]):
        slot = state.buckets[bucket].first
        while slot >= 0:
            for k in range(state.payload.shape[1]):
                out[n, k] = state.payload[slot, k]
            slot = state.slots[slot].next
            n += 1
    return n


@borrowing
def fly_all(
    numbers: LinkNumbers, state: LinkState, key: Key, every: int, out: FloatArray, arrived: IntArray
) -> None:
    """Send message m of a table's only link at tick m * every, from its first tick on, and note when each arrives.

    Args:
        numbers, state, key: The link; its state is changed.
        every: Ticks between two messages.
        out: As in `receive`, for payloads of two numbers.
        arrived: Gets the tick at which each arrives first, -1 where it is lost or still on its way at the end. Shape
            (messages,).
    """
    arrived[:] = -1
    payload = out[0]  # is copied when it is sent
    for tick in range(arrived.shape[0] * every):
        advance(numbers, 0, state, key, tick)
        if tick % every == 0:
            payload[0], payload[1] = tick, tick // every
            send(numbers, 0, state, key, payload)
        for k in range(receive(state, out)):
            message = int(out[k, 1])
            if arrived[message] < 0:
                arrived[message] = tick
