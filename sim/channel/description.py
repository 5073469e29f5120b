"""Checks of link settings, and the parameters derived from them."""

import functools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from bus.messages.links import LinkSettings
from bus.numbers import above
from bus.ticks import TICK_TOLERANCE, first_tick_from
from sim.channel.jitter import NORMAL, SHAPES, UNIFORM, jitter_share
from sim.channel.link_records import DELAYS, NOTHING, OPPORTUNITIES, LinkParameters
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
from sim.compiling.compile import IntArray
from sim.input.faults import Fault, near
from sim.input.reading import as_raw, typed

KEEPS = ("newest", "oldest")
"""Messages that a full queue keeps."""

_LONGEST = 60.0
"""Largest total delay [s], because packets in transit need memory."""
_SLOWEST = 1e-3
"""Smallest bandwidth [1/s]."""
_SHORTEST = 1e-3
"""Shortest mean time between two random blackouts [s], because each is drawn."""
_JITTER_CUT = 5.0
_NEEDS = (
    ("burst_length", "burst_interval", "bursts never end"),
    ("blackout_interval", "blackout_length", "blackouts have no duration"),
    ("reorder", "reorder_delay", "reordered messages have no extra delay"),
)
"""Fields that require another field above 0, that field, and the error if it is 0."""


def extra_delays(settings: LinkSettings) -> tuple[float, float]:
    """Return the smallest and the largest extra delay [s]."""
    j = settings.jitter
    most = settings.max_jitter or _JITTER_CUT * j
    shape = SHAPES[settings.jitter_shape]
    if shape == UNIFORM:
        return -min(settings.delay, j), min(most, j)
    return -settings.delay if shape == NORMAL and j > 0.0 else 0.0, most if j > 0.0 else 0.0


def longest_delay(settings: LinkSettings, traces: Sequence[RecordedLink] = ()) -> float:
    """Return the longest delay of a message, without its time in the sender's queue [s]."""
    reorder_delay = settings.reorder_delay if settings.reorder > 0.0 else 0.0
    return (
        settings.delay
        + extra_delays(settings)[1]
        + reorder_delay
        + longest_recorded(settings, traces)
    )


def longest_wait(parameters: LinkParameters) -> int:
    """Return the longest time in the sender's queue of a message that is not dropped [ticks]."""
    p = parameters
    if p.replay != OPPORTUNITIES:
        return math.ceil(p.settings.queue * p.spacing)
    each = math.ceil(p.settings.message_bytes / p.opportunity)
    rounds, last = np.divmod(
        np.arange(len(p.trace)) + (p.settings.queue + 1) * each + 1, len(p.trace)
    )
    waits = p.trace[last, 0] + p.period * rounds - p.trace[:, 0]  # [ms]
    return math.ceil(float(waits.max()) / (1000.0 * p.dt)) + 1


def link_faults(
    settings: LinkSettings, path: str = "", traces: Sequence[RecordedLink] = ()
) -> Iterator[Fault]:
    """Yield the faults of a link whose fields are within their bounds.

    Args:
        settings: Settings of the link.
        path: Prefix of the fields' names.
        traces: Traces that the settings may name.
    """
    yield from _number_faults(settings, path)
    if settings.jitter_shape not in SHAPES:
        wrong = f"unknown shape{near(settings.jitter_shape, tuple(SHAPES))}"
        yield Fault(f"{path}jitter_shape", settings.jitter_shape, wrong, ", ".join(SHAPES))
        return
    if settings.keep not in KEEPS:
        yield Fault(
            f"{path}keep",
            settings.keep,
            f"unknown order{near(settings.keep, KEEPS)}",
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
        with_what = "the trace" if settings.trace else "jitter and reordering"
        wrong = f"the delay can be {above(longest, _LONGEST)} s with {with_what}"
        yield Fault(f"{path}delay", settings.delay, wrong, f"at most {_LONGEST:g} s in total")


def _number_faults(settings: LinkSettings, path: str) -> Iterator[Fault]:
    for field in settings.__struct_fields__:
        value = getattr(settings, field)
        if isinstance(value, float) and not math.isfinite(value):
            yield Fault(f"{path}{field}", value, "not finite", "finite numbers")
    for k, (start, length) in enumerate(settings.blackouts):
        if not 0.0 <= start < math.inf:
            yield Fault(
                f"{path}blackouts.{k}.0",
                start,
                "the blackout starts before the run",
                "0 s or more, finite",
            )
        if not 0.0 < length < math.inf:
            yield Fault(
                f"{path}blackouts.{k}.1",
                length,
                "the blackout has no duration",
                "above 0 s, finite",
            )


def check_link(
    settings: LinkSettings, where: str, traces: Sequence[RecordedLink] = ()
) -> LinkSettings:
    """Check the settings of a link and return them.

    Args:
        settings: Read from a file or made in Python; NumPy numbers and integers become floats.
        where: Prefix of error messages: the file, or the name of the link.
        traces: Traces that the settings may name.

    Returns:
        Equal settings with correctly typed values.

    Raises:
        ScenarioError: One line with field, value, what is wrong and what is allowed.
    """
    checked = typed(as_raw(settings, file=where), LinkSettings, file=where)
    for fault in link_faults(checked, traces=traces):
        raise fault.error(where)
    return checked


def _blackout_ticks(
    settings: LinkSettings, dt: float
) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Return rows (first tick of a blackout, first tick after it) in order; overlapping blackouts are merged."""
    rows: list[list[int]] = []
    for start, length in sorted(settings.blackouts):
        first, after = first_tick_from(start, dt), first_tick_from(start + length, dt)
        if rows and first <= rows[-1][1]:
            rows[-1][1] = max(rows[-1][1], after)
        else:
            rows.append([first, after])
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


@functools.lru_cache(maxsize=64)
def _trace_rows(
    recorded: RecordedLink | None, delay: float, dt: float
) -> tuple[int, IntArray, int]:
    """Return the kind of a trace, its rows, and its period, as in `LinkParameters`."""
    if recorded is None:
        return NOTHING, np.zeros((0, 2), dtype=np.int64), 0
    recording = recording_of(recorded)
    if isinstance(recording, Opportunities):
        rows = np.stack([recording.times, np.zeros_like(recording.times)], axis=1)
        return OPPORTUNITIES, rows, int(recording.times[-1])
    rows = first_ticks(recording, delay, dt, TICK_TOLERANCE)
    return DELAYS, rows, max(first_tick_from(recording.duration, dt), 1)


def link_parameters(
    settings: LinkSettings, dt: float, *, per_tick: int = 1, traces: Sequence[RecordedLink] = ()
) -> LinkParameters:
    r"""Convert checked settings to the parameters of the compiled link.

    The two states of Gilbert and Elliott are exact at the ticks: with the mean durations L and I, $\pi = L/(L + I)$ and
    $\lambda = 1/L + 1/I$, the exponential of the generator gives the probability of bad after bad $\pi + (1 - \pi)
    e^{-\lambda dt}$ and of bad after good $\pi (1 - e^{-\lambda dt})$.

    A correlated extra delay is the quantile at $\Phi(z)$ of a normal process z with the correlation $e^{-t/T}$, so that
    its distribution is that of independent ones.

    Args:
        settings: As returned by `check_link`.
        dt: Duration of a tick [s].
        per_tick: Messages that may be sent in every tick without exceeding the capacity.
        traces: Traces that the settings may name.
    """
    replay, trace, period = _trace_rows(found(traces, settings.trace), settings.delay, dt)
    least, most = extra_delays(settings)
    shape, j = SHAPES[settings.jitter_shape], settings.jitter
    correlated = j > 0.0 and settings.jitter_time > 0.0
    bursts = settings.burst_length > 0.0
    share = decay = 0.0
    if bursts:
        share = settings.burst_length / (settings.burst_length + settings.burst_interval)
        decay = -math.expm1(-dt / settings.burst_length - dt / settings.burst_interval)
    reorder_delay = settings.reorder_delay if settings.reorder > 0.0 else 0.0
    within_tick = dt if replay == OPPORTUNITIES else 0.0
    longest = first_tick_from(settings.delay + most + reorder_delay + within_tick, dt)
    if replay == DELAYS:
        longest = max(int(trace[:, 1].max()), 0)
    waits = settings.queue if settings.bandwidth > 0.0 else 0
    room = per_tick * (longest + 1) + (settings.queue + 1 if replay == OPPORTUNITIES else waits)
    blackouts = _blackout_ticks(settings, dt)
    harmless = (
        settings.loss,
        settings.bandwidth,
        settings.blackout_interval,
        settings.duplicates,
        longest,
        len(blackouts),
    )
    return LinkParameters(
        settings=settings,
        perfect=not bursts and not any(harmless) and replay == NOTHING,
        dt=dt,
        jitter_shape=shape,
        least=least,
        most=most,
        low=jitter_share(shape, j, least) if j > 0.0 else 0.0,
        high=jitter_share(shape, j, most) if j > 0.0 else 1.0,
        bursts=bursts,
        bad_share=share,
        bad_stay=1.0 - (1.0 - share) * decay,
        bad_enter=share * decay,
        memory=math.exp(-dt / settings.jitter_time) if correlated else 0.0,
        innovation=math.sqrt(-math.expm1(-2.0 * dt / settings.jitter_time)) if correlated else 1.0,
        blackouts=blackouts,
        up=settings.blackout_interval / dt,
        down=settings.blackout_length / dt,
        spacing=1.0 / (settings.bandwidth * dt) if settings.bandwidth > 0.0 else 0.0,
        newest=settings.keep == "newest",
        longest=longest,
        room=2 * room if settings.duplicates > 0.0 else room,
        replay=replay,
        trace=trace,
        period=period,
        opportunity=OPPORTUNITY,
    )


def least_ticks(parameters: LinkParameters) -> int:
    """Return the smallest age at which messages arrive if one is sent in every tick and the sender stays busy [ticks].

    If the bandwidth is below one message per tick, the queue fills and stays full. Each message then leaves after
    `queue` ticks if the newest are kept, and after `queue` spacings if the oldest are.
    """
    if parameters.replay == DELAYS:
        arrives = parameters.trace[parameters.trace[:, 1] >= 0, 1]
        return int(arrives.min()) if arrives.size else 0
    settings, waits = parameters.settings, 0
    if parameters.spacing > 1.0 + TICK_TOLERANCE:
        waits = (
            settings.queue if parameters.newest else math.floor(settings.queue * parameters.spacing)
        )
    least = waits + first_tick_from(
        settings.delay + (parameters.least if settings.jitter > 0.0 else 0.0), parameters.dt
    )
    return max(least, 1) if parameters.replay == OPPORTUNITIES else least


def arrival_share(parameters: LinkParameters, ticks: int) -> float:
    """Return the share of messages that arrive within `ticks` after sending, of those neither lost nor queued."""
    settings = parameters.settings

    def within(extra: float) -> float:
        if settings.jitter == 0.0 or extra >= parameters.most:
            return 1.0 if extra >= parameters.most else 0.0
        share = (
            jitter_share(parameters.jitter_shape, settings.jitter, max(extra, parameters.least))
            - parameters.low
        ) / (parameters.high - parameters.low)
        return 0.0 if extra < parameters.least else min(max(share, 0.0), 1.0)

    room = (ticks + TICK_TOLERANCE) * parameters.dt - settings.delay
    return (1.0 - settings.reorder) * within(room) + settings.reorder * within(
        room - settings.reorder_delay
    )
