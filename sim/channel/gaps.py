"""Expected share of ticks in which a link exceeds a declared bound because no message arrives in time.

A *window* lists the messages that satisfy a bound: for each number of ticks after a given tick, the longest delay with
which a message sent then is in time. The bound is exceeded if no message of a window is in time. Random losses are a
Markov chain over ticks, so this probability is one recursion over the window. The probability that a bound is exceeded
at all in a run needs more: see the extension outrider_networks and extensions/outrider_networks/README.md.
"""

import math
import operator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.channel.description import arrival_share
from sim.channel.link_records import LinkParameters
from sim.compiling.compile import FloatArray, IntArray

Mask = npt.NDArray[np.bool_]

_GROUP = 4_000_000
"""Messages of windows evaluated at a time."""
_MOST_DELAYS = 20_000
"""Largest number of delays whose shares are evaluated; of more, the share of a shorter delay is used."""
_MOST_STEPS, _MOST_CELLS = 50_000, 1_000_000_000
"""Largest number of steps of a recursion, and of messages of all windows, that are evaluated; see `too_many`."""
_NEGLIGIBLE = 1e-12


def age_window(age: int, waited: int = 0) -> IntArray:
    """Return the window of detections that arrive before the newest is older than `age` [ticks].

    Args:
        age: Largest age of the newest detection [ticks].
        waited: Time that each detection has waited in the sender's queue [ticks].

    Returns:
        Longest delay that is in time, by ticks after a detection [ticks]; -1: none.
    """
    rest = age - waited + 1
    limits = np.arange(max(rest, 0), -1, -1)
    limits[0] = -1
    return limits


def command_window(delay: int, repeats: int, interval: int) -> IntArray:
    """Return the window of packets that start a trajectory within `interval` ticks after the start of the last one.

    A new chain of trajectories starts every d + 1 ticks; copy i of its first trajectory must arrive within d - i ticks.

    Args:
        delay: d, from the tick of a trajectory's packet to the tick at which it starts [ticks].
        repeats: Packets that carry a trajectory, including the first.
        interval: Longest time from the start of one trajectory to the start of the next [ticks].

    Returns:
        Longest delay that is in time, by ticks after a packet [ticks]; -1: none.
    """
    chains = (interval - 1) // (delay + 1) + 1
    limits = np.full(chains * (delay + 1) + repeats + 1, -1, dtype=np.int64)
    copies = np.arange(min(repeats, delay + 1))
    limits[1 + np.arange(chains)[:, None] * (delay + 1) + copies] = delay - copies
    return limits


def shares_by_delay(parameters: LinkParameters) -> FloatArray:
    """Return the shares of messages that arrive within 0, 1, ... ticks, of those not lost; the last is 1.

    If delays are correlated, the shares of several messages cannot be multiplied. Then every message is taken to need
    the longest delay: it arrives no later, so that all that follows for messages in time is a lower bound.
    """
    longest = parameters.longest
    if parameters.memory > 0.0:
        return np.append(np.zeros(longest), 1.0)
    step = 1 + longest // _MOST_DELAYS
    shares = [arrival_share(parameters, ticks) for ticks in range(0, longest, step)]
    return np.append(np.repeat(shares, step)[:longest], 1.0)


def useful_shares(window: IntArray, by_delay: FloatArray) -> FloatArray:
    """Return the share of each message of a window that is in time if not lost, up to the last above 0.

    Args:
        window: Limits [ticks], see `age_window`.
        by_delay: See `shares_by_delay`.
    """
    shares = np.where(window >= 0, by_delay[np.clip(window, 0, len(by_delay) - 1)], 0.0)
    return shares[: int(np.flatnonzero(shares).max(initial=0)) + 1]


class LossChain(NamedTuple):
    """Losses of one link as a Markov chain over ticks; the first axis is the state, good or bad."""

    turn: FloatArray
    """Probability of each state after each. Shape (states, states)."""
    share: FloatArray
    """Stationary distribution, also of the first tick."""
    through: FloatArray
    """Probability, by state, that a message sent outside blackouts is not lost."""
    up: float
    """Mean time between two random blackouts [ticks]; 0: no blackouts."""
    down: float
    """Duration of a random blackout [ticks]."""

    @property
    def light(self) -> float:
        """Share of the time outside random blackouts."""
        return self.up / (self.up + self.down) if self.up > 0.0 else 1.0

    def push(self, mass: FloatArray) -> FloatArray:
        """Return the distribution one tick later. Shape (states, any)."""
        return mass if len(mass) == 1 else _mixed(self.turn.T, mass)

    def pull(self, value: FloatArray, ticks: int = 1) -> FloatArray:
        """Return the mean of a value `ticks` later, by the present state. Shape (states, any)."""
        if len(value) == 1:
            return value
        return _mixed(np.linalg.matrix_power(self.turn, ticks), value)


def _mixed(shares: FloatArray, rows: FloatArray) -> FloatArray:
    """Return sums of the rows, each weighted by a row of shares."""
    return np.stack([sum(map(operator.mul, row, rows)) for row in shares])


def loss_chain(parameters: LinkParameters, dropout: float = 0.0) -> LossChain:
    """Return the chain of a link; `dropout` is the probability that a message is lost before the link."""
    through = (1.0 - dropout) * (1.0 - parameters.settings.loss)
    turn, share, kept = np.ones((1, 1)), np.ones(1), np.array([through])
    if parameters.bursts:
        turn = np.array(
            [
                [1.0 - parameters.bad_enter, parameters.bad_enter],
                [1.0 - parameters.bad_stay, parameters.bad_stay],
            ]
        )
        share = np.array([1.0 - parameters.bad_share, parameters.bad_share])
        kept = np.array([through, through * (1.0 - parameters.settings.burst_loss)])
    return LossChain(turn, share, kept, parameters.up, parameters.down)


def none_in_time(chain: LossChain, useful: FloatArray) -> tuple[FloatArray, FloatArray]:
    r"""Return an upper bound of the probability that no useful message is in time; exact without random blackouts.

    Let N_o be this probability for the messages from offset o on without a blackout at o, and B_o the one if a blackout
    has started since o - 1, both for a known state of the chain at o; q = 1 - exp(-1/up) is the probability that a
    blackout starts within a tick. With K = ⌈D⌉ and the mean over the chain's later state,

    - N_o = (1 - share in time) L_o and L_o = mean of q B_{o+1} + (1 - q) N_{o+1}: exact, as the start is memoryless;
    - B_o = mean of X_{o+K}: the blackout ends after o + K - 1 and before o + K. In the rest of that tick the next one
      starts with a probability from 0 to q, so the remainder is at most X_m = max(N_m, q B_m + (1 - q) N_m).

    If D > 1 is not an integer, the blackout may instead end just before m = o + K - 1, and the remainder is at most the
    larger of X_m and the mean of X_{m+1}. A blackout shorter than a tick hides no more than one of a full tick.

    Args:
        chain: Losses of the link.
        useful: Share that arrives in time, by ticks since each start. Shape (last + 1, starts).

    Returns:
        Probability after a message that got through, by its state, shape (states, starts); and for a stationary link,
        of which nothing is known at offset 1, shape (starts,).
    """
    last, shape = len(useful) - 1, (len(chain.share), useful.shape[1])
    value, clear = np.ones(shape), np.ones(shape)
    if chain.up == 0.0:
        for share in useful[:0:-1]:
            clear = (1.0 - share * chain.through[:, None]) * value
            value = chain.pull(clear)
        return value, chain.share @ clear
    begins, whole = -math.expm1(-1.0 / chain.up), max(1, math.ceil(chain.down - 1e-9))
    broken = whole > 1 and whole - chain.down > 1e-9
    ends = [value] * (last + 1 + whole + 1)  # X by offset
    for o in range(last, 0, -1):
        clear = (1.0 - useful[o] * chain.through[:, None]) * value
        blackout = chain.pull(ends[o + whole], whole)
        if broken:
            sooner = np.maximum(chain.pull(ends[o + whole]), ends[o + whole - 1])
            blackout = chain.pull(sooner, whole - 1)
        either = begins * blackout + (1.0 - begins) * clear
        ends[o] = np.maximum(clear, either)
        value = chain.pull(either)
    left = np.minimum(1.0, chain.down - np.arange(whole)) / (chain.up + chain.down)
    first = chain.light * clear
    for k in range(whole):  # in a blackout at the first tick, and for k full ticks after it
        first = first + left[k] * ends[min(2 + k, last + 1)]
    return value, chain.share @ first


def too_many(parameters: LinkParameters, window: IntArray, *, ticks: int, period: int = 1) -> bool:
    """Return whether `late_shares` would take minutes, as the window has too many ticks. Arguments as there."""
    size = len(window)
    steps, cells = min(size // period, int(np.count_nonzero(window >= 0))), 0
    if parameters.up > 0.0:
        steps, cells = size, size * period
    hidden = sum(after - first + 2 * size for first, after in parameters.blackouts.tolist())
    return steps > _MOST_STEPS or cells + min(ticks, hidden) * size > _MOST_CELLS


def _shares_by_phase(chain: LossChain, useful: FloatArray, period: int) -> FloatArray:
    """Return the probability that no message of a window is in time, by the window's start in a period.

    Without random blackouts, only the ticks at which messages are sent are evaluated.

    Args:
        chain: Losses of the link.
        useful: Share that arrives in time, by ticks since the start. Shape (last + 1,).
        period: Ticks between two messages.
    """
    last, start = len(useful) - 1, np.arange(period)
    if chain.up > 0.0:
        leaves = (start + np.arange(last + 1)[:, None]) % period == 0
        return none_in_time(chain, useful[:, None] * leaves)[1]
    sent = np.zeros((-(-last // period), period))  # by message, and by ticks before the first
    sent.reshape(-1)[:last] = useful[1:]
    clear, later = np.ones((len(chain.share), period)), len(sent)
    for row in np.flatnonzero(sent.any(axis=1))[::-1].tolist():
        value = chain.pull(clear, (later - row) * period)
        clear, later = (1.0 - sent[row] * chain.through[:, None]) * value, row
    by_start: FloatArray = (chain.share @ clear)[-start - 1]
    return by_start


def late_shares(
    parameters: LinkParameters,
    window: IntArray,
    *,
    ticks: int,
    period: int = 1,
    dropout: float = 0.0,
) -> FloatArray:
    """Return the probability, by tick, that no message of the window after it is in time.

    For an age this is the probability that the newest detection is too old at the end of the window. Not for links with
    a trace or a sender's queue.

    Args:
        parameters: The link.
        window: See `age_window` and `command_window`.
        ticks: Duration of the run [ticks].
        period: Ticks between two messages; the first is sent at tick 0.
        dropout: Share of messages lost before the link.

    Returns:
        One value for each window that ends within the run; the first starts at tick 0. Shape (windows,).
    """
    useful = useful_shares(window, shares_by_delay(parameters))
    chain = loss_chain(parameters, dropout)
    last = len(useful) - 1
    starts, offsets = np.arange(-1, ticks - len(window) + 1), np.arange(last + 1)[:, None]
    shares = _shares_by_phase(chain, useful, period)[starts % period]
    blackout = np.zeros(ticks + last + 2, dtype=bool)  # from tick -1 on
    for first, after in parameters.blackouts.tolist():
        blackout[1 + first : 1 + min(after, ticks)] = True
    before = np.concatenate(([0], np.cumsum(blackout)))
    hidden = before[starts + last + 2] - before[starts + 2]
    shares[(hidden > 0) & (hidden == last)] = 1.0
    partly = np.flatnonzero((hidden > 0) & (hidden < last))
    size = max(1, _GROUP // (last + 1))
    for group in (partly[k : k + size] for k in range(0, len(partly), size)):
        at = starts[group] + offsets
        reached = useful[:, None] * ((at % period == 0) & ~blackout[at + 1])
        shares[group] = none_in_time(chain, reached)[1]
    return shares


def delays_at(parameters: LinkParameters, phases: IntArray) -> IntArray:
    """Return the delay of a message sent at each of these positions of a table [ticks]; -1: lost."""
    rows = np.searchsorted(parameters.trace[:, 0], phases, side="right") - 1
    delays: IntArray = parameters.trace[rows, 1]
    return delays


def recorded_late_share(delays: IntArray, window: IntArray, dropout: float = 0.0) -> float:
    """Return the share of a recording's ticks after which no message of the window is in time.

    Args:
        delays: Delay of the message sent at each tick [ticks]; -1: none sent, or lost. Shape (ticks,).
        window: See `age_window` and `command_window`.
        dropout: Share of messages lost before the link.
    """
    missed = np.ones(max(len(delays) - len(window) + 1, 0))
    left = np.arange(len(missed))
    for offset in np.flatnonzero(window >= 0).tolist():
        there = delays[left + offset]
        missed[left[(there >= 0) & (there <= window[offset])]] *= dropout
        left = left[missed[left] > _NEGLIGIBLE]
        if not left.size:
            break
    return float(missed.mean()) if len(missed) else 0.0
