"""A recorded table of delays, evaluated from each place at which a run may begin in it.

It is played in a loop from a place that each run's key draws, all equally likely, and nothing else is drawn. So the
results for all places are the whole distribution. A Mahimahi file is not evaluated: what waits then depends on what was
sent before.
"""

import numpy as np

from sim.channel.gaps import Mask, delays_at
from sim.channel.link_records import LinkParameters
from sim.compiling.compile import FloatArray, IntArray


def delays_by_place(parameters: LinkParameters) -> IntArray:
    """Return the delay of a message that is sent at each place of a round [ticks]; -1: it is lost. Shape (places,)."""
    return delays_at(parameters, np.arange(parameters.period))


def oldest_by_place(delays: IntArray, left: Mask, period: int) -> IntArray:
    """Return the greatest age of the newest detection within a run [ticks], by the place at which it begins.

    Counted from the tick on at which the first detection arrives. Shape (places,).

    Args:
        delays: See `delays_by_place`.
        left: By tick of the run, whether no planned blackout hides what is sent at it.
        period: Ticks from one look to the next, each of which finds something; the first is at tick 0.
    """
    places = len(delays)
    twice, begun = np.concatenate((delays, delays)), np.arange(places)
    coming = np.full((max(int(delays.max()), 0) + 1, places), -1, dtype=np.int32)
    newest, oldest = np.full(places, -1), np.zeros(places, dtype=np.int64)
    for tick in range(len(left)):
        if tick % period == 0 and left[tick]:
            took = twice[tick % places :][:places]
            got = took >= 0
            coming[(tick + took[got]) % len(coming), begun[got]] = tick
        np.maximum(newest, coming[tick % len(coming)], out=newest)
        coming[tick % len(coming)] = -1
        np.maximum(oldest, np.where(newest >= 0, tick - newest, 0), out=oldest)
    return oldest


def unseen_by_place(
    delays: IntArray, left: Mask, period: int, dropout: float, age: int
) -> FloatArray:
    """Return the expected number of detections after which no other is in time, by the place where a run begins.

    Shape (places,).

    Args:
        delays, left, period: See `oldest_by_place`.
        dropout: Share of looks that find nothing, each independent of each other; above 0.
        age: The newest must not become older than this [ticks].
    """
    later, unseen = np.arange(period, age + 2, period), np.zeros(len(delays))
    in_time: Mask = np.zeros((len(later), len(delays)), dtype=bool)
    for row, after in zip(in_time, later.tolist(), strict=True):
        took = np.roll(delays, -after)
        row[:] = (took >= 0) & (took <= age + 1 - after)
    bases = (1.0 - dropout) * (delays >= 0)
    usual = bases * dropout ** in_time.sum(axis=0)
    for tick in range(0, len(left) - age - 1, period):
        if left[tick]:
            lit = left[tick + later]
            chance = usual if lit.all() else bases * dropout ** in_time[lit].sum(axis=0)
            unseen += np.roll(chance, -tick)
    return unseen


def waits_by_place(delays: IntArray, left: Mask, delay: int, repeats: int) -> IntArray:
    """Return the longest time from the start of one motion to the start of the next [ticks], by where a run begins.

    The protocol of the motions, packet by packet: see `outrider_networks.probabilities.outage_exceedance`. Shape
    (places,).

    Args:
        delays, left: See `oldest_by_place`; one packet a tick.
        delay: From the tick of a motion's packet to the one at which it begins [ticks].
        repeats: Packets that carry a motion, the first included.
    """
    places, rows = len(delays), delay + 2
    twice = np.concatenate((delays, delays))
    in_time = [(twice >= 0) & (twice <= delay - copy) for copy in range(min(repeats, delay + 1))]
    chain, flown = np.zeros(places, dtype=np.int64), np.full(places, -1)
    begun, longest = np.full(places, delay - 1), np.zeros(places, dtype=np.int64)
    parents = np.zeros((rows, places), dtype=np.int64)
    for tick in range(len(left)):
        due = tick - delay
        if due >= 1:  # what should have begun in the tick before has not: a new chain
            chain = np.where((flown != due - 1) & (chain <= due - 1), tick, chain)
        parents[tick % rows] = np.where(chain == tick, flown, tick - 1)
        if due >= 0:
            known = np.zeros(places, dtype=bool)  # a void one too, whose parent never began
            for copy, in_its in enumerate(in_time):
                packet = due + copy
                if left[packet]:
                    known |= in_its[packet % places :][:places]
            begins = known & (parents[due % rows] == flown)
            flown, begun = np.where(begins, due, flown), np.where(begins, tick, begun)
        np.maximum(longest, tick - begun + 1, out=longest)
    return longest
