"""Evaluation of a recorded delay table from each start position.

A run replays the table in a loop. Its key draws the start position uniformly, and nothing else is random. The results
for all positions are therefore the whole distribution. Mahimahi files are not evaluated, because their queue depends on
every earlier message.
"""

import numpy as np

from sim.channel.gaps import Mask, delays_at
from sim.channel.link_records import LinkParameters
from sim.compiling.compile import FloatArray, IntArray


def delays_by_position(parameters: LinkParameters) -> IntArray:
    """Return the delay of a message at each position of the table [ticks]; -1 if lost. Shape (positions,)."""
    return delays_at(parameters, np.arange(parameters.period))


def oldest_by_position(delays: IntArray, left: Mask, period: int) -> IntArray:
    """Return the greatest age of the newest detection within a run [ticks], by start position.

    The age counts from the arrival of the first detection. Shape (positions,).

    Args:
        delays: See `delays_by_position`.
        left: Ticks of the run outside planned blackouts. Shape (ticks,).
        period: Ticks between two detections, all successful; the first is at tick 0.
    """
    positions = len(delays)
    twice, starts = np.concatenate((delays, delays)), np.arange(positions)
    coming = np.full((max(int(delays.max()), 0) + 1, positions), -1, dtype=np.int32)
    newest, oldest = np.full(positions, -1), np.zeros(positions, dtype=np.int64)
    for tick in range(len(left)):
        if tick % period == 0 and left[tick]:
            took = twice[tick % positions :][:positions]
            got = took >= 0
            coming[(tick + took[got]) % len(coming), starts[got]] = tick
        np.maximum(newest, coming[tick % len(coming)], out=newest)
        coming[tick % len(coming)] = -1
        np.maximum(oldest, np.where(newest >= 0, tick - newest, 0), out=oldest)
    return oldest


def undetected_by_position(
    delays: IntArray, left: Mask, period: int, dropout: float, age: int
) -> FloatArray:
    """Return the expected number of detections without a timely successor, by start position.

    Shape (positions,).

    Args:
        delays, left, period: See `oldest_by_position`.
        dropout: Share of missed detections, independent of each other; above 0.
        age: Bound on the age of the newest detection [ticks].
    """
    later, undetected = np.arange(period, age + 2, period), np.zeros(len(delays))
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
            undetected += np.roll(chance, -tick)
    return undetected


def intervals_by_position(delays: IntArray, left: Mask, delay: int, repeats: int) -> IntArray:
    """Return the longest command interval within a run [ticks], by start position.

    It is the longest time from the start of one trajectory to the start of the next. The protocol is simulated packet
    by packet, see `outrider_networks.probabilities.command_interval_exceedance`. Shape (positions,).

    Args:
        delays, left: See `oldest_by_position`; one packet a tick.
        delay: Time from a trajectory's first packet to its start [ticks].
        repeats: Packets that carry a trajectory, the first included.
    """
    positions, rows = len(delays), delay + 2
    twice = np.concatenate((delays, delays))
    in_time = [(twice >= 0) & (twice <= delay - copy) for copy in range(min(repeats, delay + 1))]
    chain, flown = np.zeros(positions, dtype=np.int64), np.full(positions, -1)
    started, longest = np.full(positions, delay - 1), np.zeros(positions, dtype=np.int64)
    parents = np.zeros((rows, positions), dtype=np.int64)
    for tick in range(len(left)):
        due = tick - delay
        if due >= 1:  # the previous trajectory did not start: begin a new chain
            chain = np.where((flown != due - 1) & (chain <= due - 1), tick, chain)
        parents[tick % rows] = np.where(chain == tick, flown, tick - 1)
        if due >= 0:
            known = np.zeros(
                positions, dtype=bool
            )  # includes void trajectories, whose parent never started
            for copy, in_its in enumerate(in_time):
                packet = due + copy
                if left[packet]:
                    known |= in_its[packet % positions :][:positions]
            begins = known & (parents[due % rows] == flown)
            flown, started = np.where(begins, due, flown), np.where(begins, tick, started)
        np.maximum(longest, tick - started + 1, out=longest)
    return longest
