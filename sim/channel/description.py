"""The radio channel: how a link is described and checked, and one link for callers that carry Python objects.

What happens to a message, and in which order, is told in `sim.channel.link`.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from bus.messages import LinkSettings, LinkStatus
from bus.ticks import DUST, first_tick_from
from sim.channel.link import (
    CAUSES,
    FATES,
    NORMAL,
    NOTHING,
    OPPORTUNITIES,
    QUEUE,
    SHAPES,
    UNIFORM,
    LinkMemory,
    LinkNumbers,
    LinkParameters,
    LinkState,
    exchange,
    fly,
    fly_all,
    jitter_share,
    leave_queue,
    link_state,
    make_up,
    take,
    underway,
    wait,
)
from sim.channel.recorded import (
    OPPORTUNITY,
    Opportunities,
    RecordedLink,
    first_ticks,
    found,
    longest_recorded,
    recording_of,
    trace_faults,
)
from sim.input.faults import Fault, near
from sim.input.reading import as_raw, typed
from sim.kernels.compile import IntArray, entry_point
from sim.kernels.packing import NUMBER, writer
from sim.kernels.records import records
from sim.models.randomness import Key

_write = writer(2)

KEEPS = ("newest", "oldest")
"""The messages that a full queue keeps."""

_LONGEST = 60.0
"""Longest delay of all [s]: what is on its way needs room."""
_SLOWEST = 1e-3
"""Smallest bandwidth [1/s]."""
_SHORTEST = 1e-3
"""Shortest mean time between two random blackouts [s]: each is drawn."""
_JITTER_CUT = 5.0
_NEEDS = (
    ("burst_length", "burst_interval", "bursts without an end"),
    ("blackout_interval", "blackout_length", "blackouts that do not last"),
    ("reorder", "reorder_delay", "nothing is held back"),
)
"""Fields that are nothing without another one, that one, and what is wrong where it is 0."""


def extra_delays(settings: LinkSettings) -> tuple[float, float]:
    """Least and most extra delay [s]."""
    j = settings.jitter
    most = settings.jitter_cut or _JITTER_CUT * j
    shape = SHAPES[settings.jitter_shape]
    if shape == UNIFORM:
        return -min(settings.delay, j), min(most, j)
    return -settings.delay if shape == NORMAL and j > 0.0 else 0.0, most if j > 0.0 else 0.0


def longest_delay(settings: LinkSettings, traces: Sequence[RecordedLink] = ()) -> float:
    """The longest delay of a message that does not wait at the sender [s]."""
    held = settings.reorder_delay if settings.reorder > 0.0 else 0.0
    return settings.delay + extra_delays(settings)[1] + held + longest_recorded(settings, traces)


def longest_wait(parameters: LinkParameters) -> int:
    """The longest wait of a message at its sender that is not dropped [ticks]."""
    p = parameters
    if p.replay != OPPORTUNITIES:
        return math.ceil(p.queue * p.spacing)
    each = math.ceil(p.message_bytes / p.opportunity)
    rounds, last = np.divmod(np.arange(len(p.trace)) + (p.queue + 1) * each + 1, len(p.trace))
    waits = p.trace[last, 0] + p.period * rounds - p.trace[:, 0]  # [ms]
    return math.ceil(float(waits.max()) / (1000.0 * p.dt)) + 1


def link_faults(
    settings: LinkSettings, path: str = "", traces: Sequence[RecordedLink] = ()
) -> Iterator[Fault]:
    """Find why a link is impossible whose fields are within their bounds.

    Args:
        settings: Of the link.
        path: Goes before the fields' names.
        traces: The recorded links that it may play.
    """
    yield from _number_faults(settings, path)
    if settings.jitter_shape not in SHAPES:
        wrong = f"no such shape{near(settings.jitter_shape, tuple(SHAPES))}"
        yield Fault(f"{path}jitter_shape", settings.jitter_shape, wrong, ", ".join(SHAPES))
        return
    if settings.keep not in KEEPS:
        yield Fault(
            f"{path}keep",
            settings.keep,
            f"no such order{near(settings.keep, KEEPS)}",
            ", ".join(KEEPS),
        )
    for cause, needed, wrong in _NEEDS:
        if getattr(settings, cause) > 0.0 and getattr(settings, needed) == 0.0:
            allowed = f"above 0 s, since {path}{cause} is above 0"
            yield Fault(f"{path}{needed}", 0.0, wrong, allowed)
    every, rate = settings.blackout_interval, settings.bandwidth
    if 0.0 < every < _SHORTEST:
        allowed = f"0, or {_SHORTEST:g} s or more"
        yield Fault(f"{path}blackout_interval", every, "too short", allowed)
    if 0.0 < rate < _SLOWEST:
        allowed = f"0 for no limit, or {_SLOWEST:g} /s or more"
        yield Fault(f"{path}bandwidth", rate, "too small", allowed)
    faults = list(trace_faults(settings, path, traces))
    yield from faults
    if faults:
        return
    longest = settings.delay + extra_delays(settings)[1] + settings.reorder_delay
    longest += longest_recorded(settings, traces)
    if longest > _LONGEST:
        with_what = "what is recorded" if settings.trace else "jitter and reordering"
        wrong = f"the delay can be {longest:.4g} s with {with_what}"
        yield Fault(f"{path}delay", settings.delay, wrong, f"{_LONGEST:g} s in all at most")


def _number_faults(settings: LinkSettings, path: str) -> Iterator[Fault]:
    for field in settings.__struct_fields__:
        value = getattr(settings, field)
        if isinstance(value, float) and not math.isfinite(value):
            yield Fault(f"{path}{field}", value, "not a number", "finite numbers")
    for k, (start, length) in enumerate(settings.blackouts):
        if not 0.0 <= start < math.inf:
            yield Fault(
                f"{path}blackouts.{k}.0",
                start,
                "a blackout begins before the run",
                "0 s or more, finite",
            )
        if not 0.0 < length < math.inf:
            yield Fault(
                f"{path}blackouts.{k}.1", length, "a blackout does not last", "above 0 s, finite"
            )


def check_link(
    settings: LinkSettings, where: str, traces: Sequence[RecordedLink] = ()
) -> LinkSettings:
    """The settings, if there can be such a link.

    Args:
        settings: Read from a file or made in Python; NumPy's numbers and whole numbers in it become floats.
        where: Begins the error: the file, or what the link is called.
        traces: The recorded links that it may play.

    Returns:
        Equal settings in which every value has its type.

    Raises:
        ScenarioError: One line with field, value, what is wrong and what is allowed.
    """
    checked = typed(as_raw(settings, file=where), LinkSettings, file=where)
    for fault in link_faults(checked, traces=traces):
        raise fault.error(where)
    return checked


def _dark_ticks(
    settings: LinkSettings, dt: float
) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Rows (first dark tick, first tick after) in order; what overlaps is one."""
    rows: list[list[int]] = []
    for start, length in sorted(settings.blackouts):
        first, after = first_tick_from(start, dt), first_tick_from(start + length, dt)
        if rows and first <= rows[-1][1]:
            rows[-1][1] = max(rows[-1][1], after)
        else:
            rows.append([first, after])
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


@functools.lru_cache(maxsize=64)
def _played(recorded: RecordedLink | None, delay: float, dt: float) -> tuple[int, IntArray, int]:
    """The recording's kind, its rows, and the length of a round, as in `LinkParameters`."""
    if recorded is None:
        return NOTHING, np.zeros((0, 2), dtype=np.int64), 0
    recording = recording_of(recorded)
    if isinstance(recording, Opportunities):
        rows = np.stack([recording.times, np.zeros_like(recording.times)], axis=1)
        return OPPORTUNITIES, rows, int(recording.times[-1])
    rows = first_ticks(recording, delay, dt, DUST)
    return FATES, rows, max(first_tick_from(recording.duration, dt), 1)


def link_parameters(
    settings: LinkSettings, dt: float, *, per_tick: int = 1, traces: Sequence[RecordedLink] = ()
) -> LinkParameters:
    r"""Turn checked settings into the compiled link's numbers.

    The two states of Gilbert and Elliott are exact at the ticks: with the mean lengths L and I, $\pi = L/(L + I)$ and
    $\lambda = 1/L + 1/I$ the exponential of the generator gives bad after bad $\pi + (1 - \pi) e^{-\lambda dt}$
    and bad after good $\pi (1 - e^{-\lambda dt})$.

    Args:
        settings: As `check_link` has returned them.
        dt: Length of a tick [s].
        per_tick: Messages that may be sent in every tick without any being lost for want of room.
        traces: The recorded links that it may play.
    """
    replay, trace, period = _played(found(traces, settings.trace), settings.delay, dt)
    least, most = extra_delays(settings)
    shape, j = SHAPES[settings.jitter_shape], settings.jitter
    bursts = settings.burst_length > 0.0
    share = decay = 0.0
    if bursts:
        share = settings.burst_length / (settings.burst_length + settings.burst_interval)
        decay = -math.expm1(-dt / settings.burst_length - dt / settings.burst_interval)
    held = settings.reorder_delay if settings.reorder > 0.0 else 0.0
    within_tick = dt if replay == OPPORTUNITIES else 0.0
    longest = first_tick_from(settings.delay + most + held + within_tick, dt)
    if replay == FATES:
        longest = max(int(trace[:, 1].max()), 0)
    waits = settings.queue if settings.bandwidth > 0.0 else 0
    room = per_tick * (longest + 1) + (settings.queue + 1 if replay == OPPORTUNITIES else waits)
    blackouts = _dark_ticks(settings, dt)
    harmless = (
        settings.loss,
        settings.bandwidth,
        settings.blackout_interval,
        settings.duplicates,
        longest,
        len(blackouts),
    )
    return LinkParameters(
        perfect=not bursts and not any(harmless) and replay == NOTHING,
        dt=dt,
        delay=settings.delay,
        jitter=j,
        jitter_shape=shape,
        least=least,
        most=most,
        low=jitter_share(shape, j, least) if j > 0.0 else 0.0,
        high=jitter_share(shape, j, most) if j > 0.0 else 1.0,
        reorder=settings.reorder,
        reorder_delay=settings.reorder_delay,
        loss=settings.loss,
        bursts=bursts,
        burst_loss=settings.burst_loss,
        bad_share=share,
        bad_stay=1.0 - (1.0 - share) * decay,
        bad_enter=share * decay,
        blackouts=blackouts,
        up=settings.blackout_interval / dt,
        down=settings.blackout_length / dt,
        duplicates=settings.duplicates,
        spacing=1.0 / (settings.bandwidth * dt) if settings.bandwidth > 0.0 else 0.0,
        queue=settings.queue,
        newest=settings.keep == "newest",
        longest=longest,
        room=2 * room if settings.duplicates > 0.0 else room,
        replay=replay,
        trace=trace,
        period=period,
        message_bytes=settings.message_bytes,
        opportunity=OPPORTUNITY,
    )


def link_table(
    links: Sequence[LinkParameters], owners: Sequence[tuple[int, int]] | None = None
) -> LinkNumbers:
    """The table of these links.

    Args:
        links: What each does.
        owners: Purpose and vehicle of each one's key, where the table is asked for them.
    """
    edges = np.cumsum([0, *(len(p.blackouts) for p in links)]).tolist()
    traces = {id(p.trace): p.trace for p in links}  # one that several links play stands there once
    ends = (edges[-1] + np.cumsum([len(trace) for trace in traces.values()])).tolist()
    places = {
        one: (end - len(trace), end) for (one, trace), end in zip(traces.items(), ends, strict=True)
    }
    rows = [
        p._replace(
            first_blackout=first,
            end_blackout=end,
            first_row=places[id(p.trace)][0],
            end_row=places[id(p.trace)][1],
        )
        for p, first, end in zip(links, edges, edges[1:], strict=False)
    ]
    none: IntArray = np.zeros((0, 2), dtype=np.int64)
    return LinkNumbers(
        rows=records(LinkParameters, rows),
        pairs=np.concatenate([none, *(p.blackouts for p in links), *traces.values()]),
        owners=np.array(owners or [(0, 0)] * len(links), dtype=np.int64).reshape(-1, 2),
    )


def least_ticks(parameters: LinkParameters) -> int:
    """The age in ticks below which no message arrives, if one is sent in every tick; with a sender that is kept busy.

    Where the bandwidth is less than one message a tick the queue fills and stays full. From then on each message
    that leaves has waited `queue` ticks if the newest are kept, and `queue` spacings if the oldest are.
    """
    if parameters.replay == FATES:
        arrives = parameters.trace[parameters.trace[:, 1] >= 0, 1]
        return int(arrives.min()) if arrives.size else 0
    waits = 0
    if parameters.spacing > 1.0 + DUST:
        waits = (
            parameters.queue
            if parameters.newest
            else math.floor(parameters.queue * parameters.spacing)
        )
    least = waits + first_tick_from(
        parameters.delay + (parameters.least if parameters.jitter > 0.0 else 0.0), parameters.dt
    )
    return max(least, 1) if parameters.replay == OPPORTUNITIES else least


def arrival_share(parameters: LinkParameters, ticks: int) -> float:
    """The share of the messages neither lost nor queued that arrive within so many ticks after they were sent."""

    def within(extra: float) -> float:
        if parameters.jitter == 0.0 or extra >= parameters.most:
            return 1.0 if extra >= parameters.most else 0.0
        share = (
            jitter_share(parameters.jitter_shape, parameters.jitter, max(extra, parameters.least))
            - parameters.low
        ) / (parameters.high - parameters.low)
        return 0.0 if extra < parameters.least else min(max(share, 0.0), 1.0)

    room = (ticks + DUST) * parameters.dt - parameters.delay
    return (1.0 - parameters.reorder) * within(room) + parameters.reorder * within(
        room - parameters.reorder_delay
    )


def arrivals_of(parameters: LinkParameters, key: Key, messages: int, *, every: int = 1) -> IntArray:
    """The tick at which each message arrives first that is sent at the ticks 0, every, 2 every, ...

    -1: it is lost, or still on its way at the end.

    Args:
        parameters: The link.
        key: Of its random numbers.
        messages: How many are sent.
        every: Ticks between two.
    """
    state, arrived = link_state(parameters, 2), np.empty(messages, dtype=np.int64)
    table = link_table([parameters])
    fly_all(table, state, key, every, np.empty_like(state.payload), arrived)
    return arrived


def relink(
    old: LinkParameters,
    state: LinkState,
    new: LinkParameters,
    *,
    room: int = 0,
    wheel: int = 0,
) -> LinkState:
    """The state with which a link goes on under new parameters, between two ticks.

    What flies arrives when it would have; what waits goes on waiting, but for what a shorter queue drops; the message
    that left last keeps the new spacing to the next; one that is half granted to an opportunity begins anew, unless it
    goes on in messages of the same size. Counters stay. A burst or random blackout goes on where there still are any;
    the time to the next random blackout is drawn anew, from now on, if its law has changed.

    Args:
        old: Parameters so far.
        state: State so far, at the end of a tick; stays as it is.
        new: Parameters from the next tick on.
        room, wheel: Least sizes of the new state, as of `link_state`.
    """
    before = LinkState._make(array.copy() for array in state)
    was: Any = before.memory[0]
    tick, waiting, flying = int(was.tick), int(was.waiting), int(was.flying)
    ahead = max((int(due) - tick for due in _dues(state)), default=0)
    fresh = link_state(
        new,
        state.payload.shape[1],
        room=max(room, new.room + 2 * waiting + flying),
        wheel=max(wheel, new.longest + 1, ahead + 1),
    )
    memory: Any = fresh.memory[0]
    for name in LinkMemory.__annotations__.keys() - {"free", "waiting", "flying"}:
        memory[name] = was[name]
    fresh.lost[:] = state.lost
    granted = new.replay == OPPORTUNITIES
    goes_on = granted and old.replay == OPPORTUNITIES and old.message_bytes == new.message_bytes
    if not goes_on:
        memory.granted = 0
    begun = 1 if memory.granted > 0 else 0
    for k in range(-begun, waiting - begun):
        slot = leave_queue(before.slots, before.buckets, was)
        surplus = (new.spacing > 0.0 or granted) and (
            0 <= k < waiting - begun - new.queue if new.newest else k >= new.queue
        )
        if surplus:
            fresh.lost[QUEUE] += 1
        else:
            wait(fresh.slots, fresh.buckets, memory, _moved(before, slot, fresh))
    wheel = len(before.buckets) - 1
    for due in range(tick + 1, tick + 1 + ahead):
        slot = int(before.buckets["first"][due % wheel])
        while slot >= 0:
            fly(fresh.slots, fresh.buckets, memory, _moved(before, slot, fresh), due)
            slot = int(before.slots["next"][slot])
    _change_pace(old, new, memory)
    _change_weather(old, new, memory)
    return fresh


def _dues(state: LinkState) -> Iterator[int]:
    """The due ticks of all that fly."""
    for first in state.buckets["first"][:-1].tolist():
        if first >= 0:
            yield int(state.slots["due"][first])


def _moved(before: LinkState, slot: int, after: LinkState) -> int:
    """The slot of this message in the new state."""
    other = take(after.slots, after.memory[0])
    after.slots[other], after.payload[other] = before.slots[slot], before.payload[slot]
    return other


def _change_pace(old: LinkParameters, new: LinkParameters, memory: LinkMemory) -> None:
    if new.spacing != old.spacing and memory.served > 0:
        memory.began += (memory.served - 1) * old.spacing
        memory.served = 1


def _change_weather(old: LinkParameters, new: LinkParameters, memory: LinkMemory) -> None:
    memory.dark = False
    if not new.bursts:
        memory.chain = -1
    if (old.up, old.down) == (new.up, new.down):
        return
    if new.up == 0.0 or old.up == 0.0:
        memory.dark_from = memory.dark_to = -1.0
    elif memory.dark_from > memory.tick:
        memory.dark_from = memory.dark_to = float(memory.tick)


def link_status(
    parameters: LinkParameters, state: LinkState, settings: LinkSettings | None = None
) -> LinkStatus:
    """The counters of a link so far, from its state; with its settings, where they are given."""
    [values], dt = state.memory.tolist(), parameters.dt
    m = dict(zip(LinkMemory.__annotations__, values, strict=True))
    lost, ages = dict(zip(CAUSES, state.lost.tolist(), strict=True)), m["ages"]
    known = m["originals"] + sum(lost.values())
    return LinkStatus(
        sent=m["sent"],
        delivered=m["delivered"],
        duplicated=m["duplicated"],
        waiting=m["waiting"],
        flying=m["flying"],
        lost=lost,
        delivery_ratio=m["originals"] / known if known else None,
        age=(m["tick"] - m["newest"]) * dt if ages else None,
        mean_age=m["age_sum"] / ages * dt if ages else None,
        max_age=m["age_max"] * dt if ages else None,
        degraded=not parameters.perfect,
        settings=settings,
    )


class Link:
    """One link that carries Python objects: `send` as often as wanted, then `arrivals`, in every tick from 0 on.

    The compiled link carries their numbers. In ticks in which it has nothing to carry it is not called.

    Args:
        settings: What it does; refused with a ScenarioError where there can be no such link.
        traces: The recorded links that it may play, now or after a change.
        dt: Length of a tick [s].
        key: Of its random numbers.
        label: Names it in errors.
        per_tick: Messages that may be sent in every tick without any being lost for want of room.
    """

    def __init__(
        self,
        settings: LinkSettings,
        *,
        dt: float,
        key: Key,
        label: str = "link",
        per_tick: int = 1,
        traces: Sequence[RecordedLink] = (),
    ) -> None:
        self.settings = check_link(settings, label, traces)
        """Its settings now."""
        self._dt, self._key, self._label, self._per_tick = dt, key, label, per_tick
        self._traces = traces
        self._parameters = link_parameters(self.settings, dt, per_tick=per_tick, traces=traces)
        self._table = link_table([self._parameters])
        self._state = link_state(self._parameters, 2)
        self._out = np.empty_like(self._state.payload)
        self._tick = 0
        self._number = 0
        self._sent = np.empty((per_tick, 2))  # stamps and numbers of this tick's messages
        self._count = 0
        self._objects: dict[float, Any] = {}  # those that are sent, wait or fly

    @property
    def perfect(self) -> bool:
        """True if its settings do nothing to a message."""
        return self._parameters.perfect

    def send(self, tick: int, message: Any, stamp: float) -> None:  # noqa: ANN401 - handed out as it came
        """Send a message at this tick; it is counted when `arrivals` is called.

        Args:
            tick: The one whose arrivals come next.
            message: Is handed out as it is, more than once if it is duplicated.
            stamp: The tick that its content is from.
        """
        if tick != self._tick:
            raise self._out_of_order(tick)
        if self._count == len(self._sent):
            self._sent = np.concatenate((self._sent, np.empty_like(self._sent)))
        self._objects[self._number] = message
        _write(self._sent, self._count * 2 * NUMBER, stamp, self._number)
        self._count += 1
        self._number += 1

    def arrivals(self, tick: int) -> list[Any]:
        """The messages that arrive at this tick, in order; once for every tick."""
        if tick != self._tick:
            raise self._out_of_order(tick)
        self._tick = tick + 1
        if not self._objects:
            return []
        out, link = self._out, (self._table, self._state, self._key)
        arrived, left = self._exchange(*link, tick, self._sent, self._count, out)
        self._count = 0
        messages = [self._objects[out.item(row, 1)] for row in range(arrived)]
        if not left:
            self._objects.clear()
        elif len(self._objects) != left:
            self._forget()
        return messages

    @functools.cached_property
    def _exchange(self) -> Callable[..., tuple[int, int]]:
        link = self._table, self._state, self._key
        return entry_point(exchange, *link, 0, self._sent, 0, self._out)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_exchange"}

    def change(self, settings: LinkSettings) -> None:
        """Go on with other settings from the next tick on; see `relink`."""
        checked = check_link(settings, self._label, self._traces)
        new = link_parameters(checked, self._dt, per_tick=self._per_tick, traces=self._traces)
        self._make_up()
        self._state = relink(self._parameters, self._state, new)
        self.settings, self._parameters, self._table = checked, new, link_table([new])
        self._out = np.empty_like(self._state.payload)

    def counters(self) -> LinkStatus:
        """The counters up to the last `arrivals`."""
        self._make_up()
        return link_status(self._parameters, self._state, self.settings)

    def _make_up(self) -> None:
        """Let the compiled link go through the ticks in which it was not called."""
        make_up(self._table, 0, self._state, self._key, self._tick - 1)

    def _out_of_order(self, tick: int) -> ValueError:
        return ValueError(
            f"the link is at tick {self._tick}, not {tick}: every tick once, in order"
        )

    def _forget(self) -> None:
        """Drop the objects that nobody will get any more."""
        numbers = self._out[: underway(self._state, self._out), 1].tolist()
        self._objects = {number: self._objects[number] for number in numbers}
