r"""Chances that random links exceed what is declared of them, and the numbers that are seldom exceeded.

The certificate of docs/explanation/certificate.md relies on numbers that are declared: the largest age of the newest
detection, the longest time from the beginning of one motion to that of the next, the largest error. Here a link's
settings become a small Markov chain, and the chance that such a number is exceeded within a flight is the mass that an
automaton over this chain absorbs. docs/explanation/chances.md tells it at length, with tables beside frequencies.

**The chain.** A tick is good or bad (Gilbert-Elliott, with the link's own chances of change). A message that leaves
then is lost with a chance that depends on this state alone. A planned blackout takes a message for certain, as if it
did not exist.

**The automaton.** A *base* is a message that gets through. After each base a window of later messages is useful; the
first of them that gets through in time is the next base. If none does, the number is exceeded, for good. All that is
done is to push the distribution of chain and base through the flight, tick by tick. With a fixed delay this is exact.

**Where delays vary** it is no longer the last base alone that counts. Let E_k be that message k gets through and that
none of its window is in time, each with its own share of delays that are short enough. Wherever the number is exceeded
some E_k holds, so the sum of their chances, the expected number of times, is a bound.

**Random blackouts** are exponential times of light and fixed ones of darkness, which no chain over ticks has. The sum
of the chances of E_k needs them within one window only, from a tick on that is in the light, and there a recursion from
the window's end bounds them: see `_none_in_time`.

**A recorded table** is gone through from each place at which a run may begin in it: see `sim.channel.places`.
"""

import functools
import math
import operator
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages import LinkSettings
from bus.ticks import DUST, ticks_within
from sim.channel.description import arrival_share, link_parameters
from sim.channel.link_records import OPPORTUNITIES, LinkParameters
from sim.channel.places import delays_by_place, oldest_by_place, unseen_by_place, waits_by_place
from sim.channel.recorded import RecordedLink
from sim.kernels.compile import FloatArray

_Mask = npt.NDArray[np.bool_]

_MOST_TICKS = 100_000
_MOST_CELLS = 1e8
"""Work that a flight may take: ticks by those of a window."""
_GROUP = 4096
"""Bases that are gone through at a time."""
_NEVER = 1e-18


class Chance(NamedTuple):
    """A chance within a flight."""

    value: float | None
    """None: nothing can be stated."""
    why: str
    """The limits of the statement in words; empty where it is exact."""

    @property
    def exact(self) -> bool:
        """False: a bound, or no statement."""
        return not self.why


class Smallest(NamedTuple):
    """The smallest number that is exceeded in a flight with at most a given chance."""

    value: float | None
    """None: no number is."""
    why: str
    """The limits of the statement, or why there is no number."""


class _Channel(NamedTuple):
    """One link as a Markov chain over ticks, good or bad; the first axis is of these states."""

    turn: FloatArray
    """Chance of each state after each. Shape (states, states)."""
    share: FloatArray
    """Of each state in the long run, and at the first tick."""
    through: FloatArray
    """Chance, by state, that a message that leaves in the light is not lost."""
    up: float
    """Mean time between two random blackouts [ticks]; 0: there are none."""
    down: float
    """Their length [ticks]."""

    @property
    def bases(self) -> FloatArray:
        """The chance that a message gets through, by state, whatever was before."""
        light = self.up / (self.up + self.down) if self.up > 0.0 else 1.0
        return self.share * self.through * light

    def push(self, mass: FloatArray) -> FloatArray:
        """The distribution a tick later. Shape (states, any)."""
        return mass if len(mass) == 1 else _mixed(self.turn.T, mass)

    def pull(self, value: FloatArray, ticks: int = 1) -> FloatArray:
        """The mean of what will be so many ticks later, by the state now. Shape (states, any)."""
        if len(value) == 1:
            return value
        return _mixed(np.linalg.matrix_power(self.turn, ticks), value)


def _mixed(shares: FloatArray, rows: FloatArray) -> FloatArray:
    """Sums of the rows, each by a row of shares."""
    return np.stack([sum(map(operator.mul, row, rows)) for row in shares])


def _channel(parameters: LinkParameters, dropout: float) -> _Channel:
    """The chain of a link; messages are also lost before it, each with the chance `dropout`."""
    through = (1.0 - dropout) * (1.0 - parameters.loss)
    turn, share, kept = np.ones((1, 1)), np.ones(1), np.array([through])
    if parameters.bursts:
        turn = np.array(
            [
                [1.0 - parameters.bad_enter, parameters.bad_enter],
                [1.0 - parameters.bad_stay, parameters.bad_stay],
            ]
        )
        share = np.array([1.0 - parameters.bad_share, parameters.bad_share])
        kept = np.array([through, through * (1.0 - parameters.burst_loss)])
    return _Channel(turn, share, kept, parameters.up, parameters.down)


class _Window(NamedTuple):
    """Messages that are useful after a base, and when the number is exceeded if none of them gets through in time."""

    useful: FloatArray
    """By ticks since the base, which is 0: the share of those that are not lost which arrive in time."""
    fails: int
    """Ticks from the base to the first at which the number is exceeded."""

    @property
    def last(self) -> int:
        """Ticks from the base to the last useful message; 0: there is none."""
        return len(self.useful) - 1


class _Plan(NamedTuple):
    """A schedule by which messages leave, with the windows after them."""

    window: Callable[[int], _Window]
    """After each base, by the number [ticks] that must not be exceeded."""
    first: Callable[[int], _Window]
    """Likewise at the beginning, as if the tick before the first were a base of which nothing is known."""
    schedules: tuple[tuple[float, _Mask], ...]
    """By tick, whether a message leaves that no planned blackout takes; each with the chance of this schedule."""
    regular: _Mask
    """By ticks after a message, whether another leaves, were it not for planned blackouts."""
    extra: float = 0.0
    """Chance that none of the schedules is flown."""


def _none_in_time(channel: _Channel, useful: FloatArray) -> tuple[FloatArray, FloatArray]:
    r"""Upper bound of the chance that no useful message gets through in time; exact without random blackouts.

    Let N_o be this chance for the messages from offset o on if the link is in the light at o, and B_o if a blackout has
    begun since o - 1, the state of the chain at o being known; q = 1 - exp(-1/up) is the chance that one begins within
    a tick of light. With K = ⌈D⌉ and the mean over the chain's later state,

    - N_o = (1 - share in time) L_o and L_o = mean of q B_{o+1} + (1 - q) N_{o+1}: exact, as light has no memory;
    - B_o = mean of X_{o+K}: the blackout ends after o + K - 1 and before o + K. In what is left of that tick the next
      one begins with some chance from 0 to q, so what follows is at most X_m = max(N_m, q B_m + (1 - q) N_m).

    Where D > 1 is no whole number, the blackout may end just before m = o + K - 1 instead, and what follows is at most
    the greater of X_m and the mean of X_{m+1}. A shorter one than a tick darkens no more than one that lasts a tick.

    Args:
        channel: Of the link.
        useful: By ticks since each base, the share that arrives in time. Shape (last + 1, bases).

    Returns:
        After a base, by its state, shape (states, bases); and with offset 1 the first tick of a flight, shape (bases,).
    """
    last, shape = len(useful) - 1, (len(channel.share), useful.shape[1])
    value, clear = np.ones(shape), np.ones(shape)
    if channel.up == 0.0:
        for share in useful[:0:-1]:
            clear = (1.0 - share * channel.through[:, None]) * value
            value = channel.pull(clear)
        return value, channel.share @ clear
    begins, whole = -math.expm1(-1.0 / channel.up), max(1, math.ceil(channel.down - 1e-9))
    broken = whole > 1 and whole - channel.down > 1e-9
    ends = [value] * (last + 1 + whole + 1)  # X by offset
    for o in range(last, 0, -1):
        clear = (1.0 - useful[o] * channel.through[:, None]) * value
        dark = channel.pull(ends[o + whole], whole)
        if broken:
            sooner = np.maximum(channel.pull(ends[o + whole]), ends[o + whole - 1])
            dark = channel.pull(sooner, whole - 1)
        either = begins * dark + (1.0 - begins) * clear
        ends[o] = np.maximum(clear, either)
        value = channel.pull(either)
    left = np.minimum(1.0, channel.down - np.arange(whole)) / (channel.up + channel.down)
    first = channel.up / (channel.up + channel.down) * clear
    for k in range(whole):  # dark at the first tick, and for so many whole ticks after it
        first = first + left[k] * ends[min(2 + k, last + 1)]
    return value, channel.share @ first


def _most_within(leaves: _Mask, ticks: int) -> int:
    """The most messages that leave within so many ticks."""
    before = np.concatenate(([0], np.cumsum(leaves)))
    ends = np.minimum(np.arange(len(leaves)) + ticks, len(leaves))
    return int((before[ends] - before[:-1]).max(initial=0))


def _pushed(channel: _Channel, leaves: _Mask, window: _Window, first: _Window) -> float:
    """Push the distribution of chain and base through a flight without random blackouts; how much is absorbed.

    Args:
        channel: Of the link.
        leaves: By tick, whether a message leaves that no planned blackout takes. Shape (ticks,).
        window: After each base.
        first: At the beginning; from the tick before the first on.
    """
    ticks, through = len(leaves), channel.through
    at_first = first.fails <= ticks
    if at_first and first.last == 0:
        return 1.0
    rows = _most_within(leaves, window.last + 1) + 1
    mass, begun = np.zeros((len(through), rows)), np.zeros(rows, dtype=int)
    early, oldest, newest, value = channel.share, 0, 0, 0.0
    for tick in range(ticks):
        mass, early = channel.push(mass), channel.push(early)
        fresh = np.zeros(len(through))
        if leaves[tick]:
            got = through[:, None] * window.useful[np.minimum(tick - begun, window.last)]
            sooner = through * (first.useful[tick + 1] if tick < first.last else 0.0)
            fresh = (got * mass).sum(axis=1) + sooner * early
            mass, early = (1.0 - got) * mass, (1.0 - sooner) * early
        if at_first and tick + 1 == first.last:
            value += float(early.sum())
        while oldest < newest and begun[oldest % rows] + window.last <= tick:
            value += float(mass[:, oldest % rows].sum())
            mass[:, oldest % rows] = 0.0
            oldest += 1
        if leaves[tick] and tick + window.fails < ticks:
            if window.last == 0:
                value += float(fresh.sum())
            else:
                begun[newest % rows] = tick
                mass[:, newest % rows] = fresh
                newest += 1
    return value


def _summed(
    channel: _Channel, leaves: _Mask, window: _Window, first: _Window, regular: _Mask | None
) -> float:
    """The expected number of bases after which no useful message gets through in time.

    Args:
        channel, leaves, window, first: As of `_pushed`.
        regular: By ticks after a message, whether another leaves, where that is the same throughout.
    """
    ticks, value = len(leaves), 0.0
    bases = np.flatnonzero(leaves[: max(0, ticks - window.fails)])
    groups = [bases[k : k + _GROUP] for k in range(0, len(bases), _GROUP)]
    if regular is not None and len(bases):
        useful = window.useful * regular[: window.last + 1]
        value = len(bases) * float(channel.bases @ _none_in_time(channel, useful[:, None])[0][:, 0])
        groups = []
    for group in groups:
        useful = window.useful[:, None] * leaves[group + np.arange(window.last + 1)[:, None]]
        value += float((channel.bases @ _none_in_time(channel, useful)[0]).sum())
    if first.fails <= ticks:
        useful = first.useful * np.concatenate(([False], leaves))[: first.last + 1]
        value += float(_none_in_time(channel, useful[:, None])[1][0])
    return value


class _Counted(NamedTuple):
    """All that can be said of one link within one flight."""

    channel: _Channel
    plans: tuple[_Plan, ...]
    """Each of them gives a bound."""
    ticks: int
    regular: bool
    """True if messages leave at equal intervals all the time: no planned blackouts, no queue."""
    why: str
    """Why it is a bound; empty: it is exact."""
    longest: int
    """The largest number that tells anything: the flight is over before a larger one is exceeded [ticks]."""

    def summed(self, plan: _Plan, number: int, *, regular: bool) -> float:
        """The expected number of times; `regular`: as if there were neither planned blackouts nor a queue."""
        window, first = plan.window(number), plan.first(number)
        pattern = plan.regular if regular else None
        return plan.extra + sum(
            weight * _summed(self.channel, leaves, window, first, pattern)
            for weight, leaves in plan.schedules
        )

    def chance(self, number: int) -> Chance:
        """The chance that so many ticks are exceeded."""
        window = self.plans[0].window(number)
        long = self.ticks > _MOST_TICKS or self.ticks * window.last > _MOST_CELLS
        if not self.why and not long:
            (plan,) = self.plans
            ((_, leaves),) = plan.schedules
            value = _pushed(self.channel, leaves, window, plan.first(number))
            return Chance(min(1.0, value), "")
        if long and not self.regular:
            return Chance(None, "the flight is too long to be gone through tick by tick")
        value = min(self.summed(plan, number, regular=self.regular) for plan in self.plans)
        return Chance(min(1.0, value), self.why or _SUMMED)

    def smallest(self, risk: float) -> int | None:
        """The smallest number of ticks exceeded with at most this chance; None: none below the flight's length."""

        def kept(number: int) -> bool:
            value = self.chance(number).value
            return value is not None and value <= risk

        def seems_kept(number: int) -> bool:
            return min(self.summed(plan, number, regular=True) for plan in self.plans) <= risk

        most = min(self.longest, _MOST_TICKS)
        guess = _first(seems_kept, 0, most)
        if guess is not None and kept(guess):
            while guess > 0 and kept(guess - 1):
                guess -= 1
            return guess
        return None if self.regular and self.why else _first(kept, guess or 0, most)


class _Played(NamedTuple):
    """All that can be said of a recorded table within one flight, as of `_Counted`."""

    exceeded: Callable[[int], FloatArray]
    """By the place at which it begins, the chance that so many ticks are exceeded, or a bound."""
    ticks: int
    why: str
    longest: int

    def chance(self, number: int) -> Chance:
        """The chance that so many ticks are exceeded: the mean over all places, which are equally likely."""
        return Chance(float(self.exceeded(number).mean()), self.why)

    def smallest(self, risk: float) -> int | None:
        """The smallest number of ticks that is exceeded with at most this chance; None: none within the flight."""
        return _first(lambda number: self.exceeded(number).mean() <= risk, 0, self.longest)


_MAHIMAHI = "it plays a Mahimahi file, in which what waits depends on all that was sent before"
_LONG = "the recording is too long to be gone through from each of its places"
_SUMMED = "the expected number of times bounds the chance"


def _first(holds: Callable[[int], bool], least: int, most: int) -> int | None:
    """The smallest number from `least` to `most` for which it holds, if it does for all larger ones."""
    step, below = 1, least - 1
    while not holds(min(below + step, most)):
        if below + step >= most:
            return None
        below, step = below + step, 2 * step
    above = min(below + step, most)
    while above - below > 1:
        middle = (above + below) // 2
        if holds(middle):
            above = middle
        else:
            below = middle
    return above


def _in_time(parameters: LinkParameters) -> FloatArray:
    """The share of the messages that are not lost which arrive within 0, 1, ... ticks; the last is 1."""
    return np.array(
        [*(arrival_share(parameters, ticks) for ticks in range(parameters.longest)), 1.0]
    )


def _left(parameters: LinkParameters, ticks: int) -> _Mask:
    """By tick, whether no planned blackout takes what leaves at it."""
    left = np.ones(ticks, dtype=bool)
    for first, after in parameters.blackouts.tolist():
        left[first:after] = False
    return left


def _reasons(parameters: LinkParameters, in_time: FloatArray) -> list[str]:
    """Why the count of this link is a bound."""
    reasons = []
    if len(set(in_time.tolist()) - {0.0}) > 1:
        reasons.append("delays vary")
    if parameters.up > 0.0:
        reasons.append("blackouts come at random")
    return reasons


def _never(ticks: int) -> _Window:
    """The wait for the first message that gets through, for ever."""
    return _Window(np.ones(ticks + 1), ticks + 1)


def _age_window(in_time: FloatArray, waited: int, age: int) -> _Window:
    """Detections that arrive before the base's is older than this; all have waited before they left [ticks]."""
    rest = age - waited + 1
    room = rest - np.arange(max(rest, 0) + 1)  # ticks within which a message has to arrive
    share = in_time[np.clip(room, 0, len(in_time) - 1)]
    share[0] = 0.0
    return _Window(_to_last(share), max(rest, int(np.flatnonzero(in_time)[0])))


def _outage_window(in_time: FloatArray, delay: int, repeats: int, outage: int) -> _Window:
    """The tries whose motions begin at most this many ticks after the last that has begun.

    A chain of motions begins every d + 1 ticks; copy i of its first one has to arrive within d - i ticks.
    """
    chains = (outage - 1) // (delay + 1) + 1
    useful = np.zeros(chains * (delay + 1) + repeats + 1)
    for chain in range(chains):
        for copy in range(min(repeats, delay + 1)):
            share = in_time[min(delay - copy, len(in_time) - 1)]
            useful[1 + chain * (delay + 1) + copy] = share
    return _Window(_to_last(useful), delay + outage)


def _to_last(useful: FloatArray) -> FloatArray:
    """The shares up to the last message that may arrive in time."""
    return useful[: int(np.flatnonzero(useful).max(initial=0)) + 1]


def _not_gone_through(parameters: LinkParameters, ticks: int) -> str:
    """Why nothing can be stated of what a link plays; empty: it can."""
    if parameters.replay == OPPORTUNITIES:
        return _MAHIMAHI
    return _LONG if parameters.period * max(ticks, parameters.longest) > _MOST_CELLS else ""


def _played_ages(
    parameters: LinkParameters, period: int, dropout: float, ticks: int
) -> _Played | str:
    if why := _not_gone_through(parameters, ticks):
        return why
    delays, left = delays_by_place(parameters), _left(parameters, ticks)
    if dropout == 0.0:
        oldest = oldest_by_place(delays, left, period)
        return _Played(lambda age: (oldest > age).astype(float), ticks, "", ticks - 1)

    @functools.lru_cache(maxsize=64)
    def exceeded(age: int) -> FloatArray:
        return np.minimum(1.0, unseen_by_place(delays, left, period, dropout, age))

    return _Played(exceeded, ticks, _because(["looks find nothing at random"]), ticks - 1)


def _played_outages(
    parameters: LinkParameters, delay: int, repeats: int, ticks: int
) -> _Played | str:
    if why := _not_gone_through(parameters, ticks):
        return why
    waits = waits_by_place(delays_by_place(parameters), _left(parameters, ticks), delay, repeats)
    return _Played(lambda outage: (waits > outage).astype(float), ticks, "", ticks - delay)


@functools.lru_cache(maxsize=64)
def _ages(
    settings: LinkSettings,
    dt: float,
    period: int,
    dropout: float,
    ticks: int,
    traces: tuple[RecordedLink, ...],
) -> _Counted | _Played | str:
    """The ages of detections, one look every `period` ticks; a string: why nothing can be stated."""
    parameters = link_parameters(settings, dt, traces=traces)
    if settings.trace:
        return _played_ages(parameters, period, dropout, ticks)
    left, in_time = _left(parameters, ticks), _in_time(parameters)
    reasons = _reasons(parameters, in_time)
    looks = np.arange(ticks) % period == 0
    queued = parameters.spacing > period + DUST
    plan = _Plan(
        functools.partial(_age_window, in_time, 0),
        lambda _: _never(ticks),
        ((1.0, looks & left),),
        looks,
    )
    plans: tuple[_Plan, ...] = (plan,)
    if queued:
        plans = tuple(_queued(plan, parameters, in_time, period, dropout, left))
        reasons.append("detections wait for others")
        if not plans:
            return "looks that find nothing let the queue run empty"
    channel = _channel(parameters, 0.0 if queued else dropout)
    regular = bool(left.all()) and not queued
    return _Counted(channel, plans, ticks, regular, _because(reasons), ticks - 1)


def _because(reasons: list[str]) -> str:
    return f"{_SUMMED}: {', '.join(reasons)}" if reasons else ""


def _queued(
    plan: _Plan,
    parameters: LinkParameters,
    in_time: FloatArray,
    period: int,
    dropout: float,
    left: _Mask,
) -> Iterator[_Plan]:
    """Bounds for a bandwidth below the detector's rate.

    A sender that is never idle lets one message go every 1/bandwidth, from the first look on that finds something. It
    is never idle if no more than `misses` looks in a row find nothing, which fails with a chance that is added, and if
    misses + 1 looks fit between two messages. What leaves was taken at most queue (misses + 1) looks ago if the newest
    are kept: what waits is among the last `queue` that found something. If the oldest are kept, it has waited for at
    most `queue` others.
    """
    ticks = len(left)
    for misses in range(math.floor(parameters.spacing + DUST) // period):
        extra = math.ceil(ticks / period) * dropout ** (misses + 1)
        if extra >= 1.0:
            continue
        waited = (
            parameters.queue * (misses + 1) * period
            if parameters.newest
            else math.ceil(parameters.queue * parameters.spacing)
        )
        begins = range(misses + 1) if dropout > 0.0 and not left.all() else (0,)
        schedules = tuple(
            (
                1.0 if len(begins) == 1 else (1.0 - dropout) * dropout**look,
                _slots(parameters, look * period, ticks) & left,
            )
            for look in begins
        )
        yield plan._replace(
            window=functools.partial(_age_window, in_time, waited),
            schedules=schedules,
            regular=_slots(parameters, 0, ticks),
            extra=extra,
        )
        if extra < _NEVER:
            return


def _slots(parameters: LinkParameters, first: int, ticks: int) -> _Mask:
    """By tick, whether a sender that is busy from the tick `first` on lets a message go."""
    leaves = np.zeros(ticks, dtype=bool)
    at = np.ceil(
        first + np.arange(math.ceil(ticks / parameters.spacing)) * parameters.spacing - DUST
    ).astype(int)
    leaves[at[at < ticks]] = True
    return leaves


@functools.lru_cache(maxsize=64)
def _outages(
    settings: LinkSettings,
    dt: float,
    delay: int,
    repeats: int,
    ticks: int,
    traces: tuple[RecordedLink, ...],
) -> _Counted | _Played | str:
    """The outages of motions, one packet a tick; a string: why nothing can be stated."""
    parameters = link_parameters(settings, dt, traces=traces)
    if settings.trace:
        return _played_outages(parameters, delay, repeats, ticks)
    if parameters.spacing > 1.0 + DUST:
        return "fewer packets leave than are sent, so that motions wait and are dropped"
    left, in_time = _left(parameters, ticks), _in_time(parameters)
    window = functools.partial(_outage_window, in_time, delay, repeats)
    plan = _Plan(window, window, ((1.0, left),), np.ones(ticks, dtype=bool))
    why = _because(_reasons(parameters, in_time[: delay + 1]))
    return _Counted(_channel(parameters, 0.0), (plan,), ticks, bool(left.all()), why, ticks - delay)


def _chance(counted: _Counted | _Played | str, bound: float, dt: float) -> Chance:
    if isinstance(counted, str):
        return Chance(None, counted)
    return counted.chance(ticks_within(bound, dt))


@functools.lru_cache(maxsize=256)
def chance_of_age(
    settings: LinkSettings,
    *,
    dt: float,
    period_ticks: int,
    dropout: float,
    ticks: int,
    age: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Chance:
    """The chance that the newest detection that has arrived is older than `age` at some tick of a flight.

    Counted from the tick on at which the first detection arrives. Exact for a fixed delay with independent loss,
    Gilbert-Elliott and planned blackouts, and for a recorded table if all looks find something; else a bound.

    Args:
        settings: Of the detections' link, as `check_link` has passed them.
        dt: Length of a tick [s].
        period_ticks: Ticks from one look of the detector to the next; the first is at tick 0.
        dropout: Share of looks that find nothing, each on its own.
        ticks: Of the flight.
        age: [s]; whole ticks within it count.
        traces: The recorded links that it may play.
    """
    counted = _ages(settings, dt, period_ticks, dropout, ticks, traces)
    return _chance(counted, age, dt)


@functools.lru_cache(maxsize=256)
def chance_of_outage(
    settings: LinkSettings,
    *,
    dt: float,
    delay_ticks: int,
    repeats: int,
    ticks: int,
    outage: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Chance:
    """The chance that some motion of a flight is followed by the next only after more than `outage`.

    Packet k carries the motions k - repeats + 1 to k; motion j begins at tick j + delay_ticks if one of its packets has
    arrived and the motion before began. If motion s does not, the pilot sees it at tick s + d + 1 and begins a new
    chain with the motion of that number. The rest at the beginning counts as a motion that begins at tick d - 1. Exact
    for a fixed delay with independent loss, Gilbert-Elliott and planned blackouts, and for a recorded table; else a
    bound.

    Args:
        settings: Of the commands' link, as `check_link` has passed them.
        dt: Length of a tick [s].
        delay_ticks: d, from the tick of a motion's packet to the one at which it begins.
        repeats: Packets that carry a motion, the first included.
        ticks: Of the flight.
        outage: [s]; whole ticks within it count.
        traces: The recorded links that it may play.
    """
    counted = _outages(settings, dt, delay_ticks, repeats, ticks, traces)
    return _chance(counted, outage, dt)


def _seconds(counted: _Counted | _Played | str, what: str, risk: float, dt: float) -> Smallest:
    if isinstance(counted, str):
        return Smallest(None, counted)
    found = counted.smallest(risk)
    if found is None:
        length = f"{counted.ticks * dt:g} s"
        return Smallest(
            None, f"no {what} shorter than the flight of {length} is exceeded so seldom"
        )
    return Smallest(round(found * dt, 9), counted.why)


@functools.lru_cache(maxsize=64)
def smallest_age(
    settings: LinkSettings,
    *,
    dt: float,
    period_ticks: int,
    dropout: float,
    ticks: int,
    risk: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Smallest:
    """The smallest age [s], in whole ticks, that is exceeded with at most the chance `risk`.

    Args:
        settings, dt, period_ticks, dropout, ticks, traces: As of `chance_of_age`.
        risk: Between 0 and 1.
    """
    return _seconds(_ages(settings, dt, period_ticks, dropout, ticks, traces), "age", risk, dt)


@functools.lru_cache(maxsize=64)
def smallest_outage(
    settings: LinkSettings,
    *,
    dt: float,
    delay_ticks: int,
    repeats: int,
    ticks: int,
    risk: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Smallest:
    """The smallest outage [s], in whole ticks, that is exceeded with at most the chance `risk`.

    Args:
        settings, dt, delay_ticks, repeats, ticks, traces: As of `chance_of_outage`.
        risk: Between 0 and 1.
    """
    return _seconds(_outages(settings, dt, delay_ticks, repeats, ticks, traces), "outage", risk, dt)


def chance_of_error(sigma: float, cut: float, count: int, error: float) -> Chance:
    """The chance that the norm of one of so many errors is larger than `error`.

    Args:
        sigma: Standard deviation per axis [m].
        cut: No norm is larger than this many deviations; infinite: no cut.
        count: Errors.
        error: [m]
    """
    if sigma == 0.0 or error >= sigma * cut * (1.0 - 1e-9):
        return Chance(0.0, "")
    beyond = math.exp(-0.5 * cut * cut)
    larger = (math.exp(-0.5 * (error / sigma) ** 2) - beyond) / (1.0 - beyond)
    if larger >= 1.0:
        return Chance(1.0, "")
    return Chance(-math.expm1(count * math.log1p(-larger)), "")


def largest_error(sigma: float, cut: float, count: int, risk: float) -> float:
    r"""The error [m] that none of so many exceeds but with at most the chance `risk`; with a cut the cut.

    The norm of a normal vector exceeds ε with the chance exp(-ε²/(2σ²)), so that
    $$ \epsilon = \sigma \sqrt{-2 \ln(1 - (1 - \text{risk})^{1/\text{count}})} $$

    Args:
        sigma, cut, count: As of `chance_of_error`.
        risk: Between 0 and 1.
    """
    if sigma == 0.0 or math.isfinite(cut):
        return sigma * cut if sigma > 0.0 else 0.0
    larger = -math.expm1(math.log1p(-risk) / max(count, 1))
    return sigma * math.sqrt(-2.0 * math.log(larger))
