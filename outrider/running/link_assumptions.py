"""Checks of a radio link against the bounds of a certificate: the age of detections (A2) and command gaps (A5').

Random losses are reported with the expected share of ticks in which they exceed a bound (`sim.channel.gaps`).
"""

import math
from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import msgspec
import numpy as np

from bus.messages.links import LinkKind
from bus.messages.vehicle import MOST_CARRIED
from bus.numbers import above, at_least, enough_digits, exact
from bus.ticks import TICK_TOLERANCE, first_tick_from
from sim.channel.description import link_parameters, longest_delay, longest_wait
from sim.channel.gaps import (
    age_window,
    command_window,
    delays_at,
    late_shares,
    recorded_late_share,
    too_many,
)
from sim.channel.link_records import DELAYS, LinkParameters
from sim.channel.links import first_arrivals
from sim.channel.recorded import Opportunities, recording_of
from sim.channel.recorded import found as trace_named
from sim.compiling.compile import IntArray
from sim.models.safety import SafetyBounds
from sim.scenario.types import LinkTable, Scenario

RARE = 1e-6
"""Events that are expected less often than this in a whole run are not reported."""
_MOST_REPLAYED = 1_000_000
"""Largest number of ticks inspected of a recorded link."""
_MOST_MESSAGES = 1_000_000_000
"""Largest number of messages of a recorded link that are inspected, summed over the windows of all ticks."""
_SAME_TICK = 1e-3
"""Largest error of a printed time [ticks]."""
_NO_BLACKOUTS = np.zeros((0, 2), dtype=np.int64)


class Frequency(StrEnum):
    """Frequency at which an assumption is broken."""

    ALWAYS = "always"
    """In every tick: nothing can be certified."""
    THROUGHOUT = "throughout"
    """In most ticks: hardly anything can be certified."""
    CERTAIN = "at known times"
    """At times known before the run."""
    SOMETIMES = "at random"


class Finding(NamedTuple):
    """Bound of the certificate that a scenario may exceed."""

    frequency: Frequency
    cause: str
    """Fields of the scenario with their values, and their effect."""
    field: str
    """Field of `[certificate]` with the bound."""
    values: tuple[float, ...] = ()
    """Values of the bound to try as a remedy; empty: a list of times."""
    remedy: str = ""
    """Advice for the user; empty: the bound is to be raised."""


def frequency_of(share: float, *, whole: bool = True) -> Frequency:
    """Return the frequency for a share of the ticks; `whole`: of all ticks, not of a part."""
    return Frequency.THROUGHOUT if whole and share >= 0.5 else Frequency.SOMETIMES


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{100.0 * share:.3g} %"


class _Replay(NamedTuple):
    """Delays of a run's messages on a recorded link."""

    delays: tuple[IntArray, ...]
    """Delays for each alignment of recording and messages: see `recorded_late_share`."""
    ticks: int
    """Inspected ticks of each alignment, without the end of a window."""
    whole: bool
    """True if the whole recording is inspected."""


class InspectedLink:
    """Link of one kind of a UAV, with its settings and delays in ticks."""

    def __init__(self, scenario: Scenario, table: LinkTable, uav: str, kind: LinkKind) -> None:
        self.scenario, self._traces = scenario, table.traces
        self.settings, self.path = table.of(uav, kind), table.path_of(uav, kind)
        p = link_parameters(self.settings, scenario.dt, traces=table.traces)
        self.parameters: LinkParameters = p
        self.least = first_tick_from(
            self.settings.delay + (p.least if self.settings.jitter > 0.0 else 0.0), p.dt
        )
        self.most = first_tick_from(longest_delay(self.settings), p.dt)

    def named(self, *fields: str) -> str:
        """Return these fields with their values, without zeros."""
        values = {field: getattr(self.settings, field) for field in fields}
        return ", ".join(
            f"{self.path}.{field} = {exact(value)}" for field, value in values.items() if value
        )

    def planned_blackouts(self) -> Iterator[tuple[int, int]]:
        """Yield the first tick of each planned blackout within the run, and the first tick after it."""
        for first, after in self.parameters.blackouts.tolist():
            if first < min(after, self.scenario.ticks):
                yield first, min(after, self.scenario.ticks)

    def replayed(self, every: int, window: int) -> _Replay:
        """Return the delays of a recorded link without planned blackouts, for every possible start of a run.

        Args:
            every: Ticks between two messages.
            window: Ticks needed beyond the inspected ones.
        """
        p, most = self.parameters, min(_MOST_REPLAYED, 1 + _MOST_MESSAGES // (window + 1))
        if p.replay == DELAYS:
            whole = p.period * every <= most
            ticks = min(p.period, most)
            places = np.arange(ticks + window)
            delays = delays_at(p, places % p.period)
            sent = [(places + phase) % every == 0 for phase in range(every if whole else 1)]
            return _Replay(tuple(np.where(leaves, delays, -1) for leaves in sent), ticks, whole)
        tick = 1000.0 * p.dt
        step = round(tick * every)
        exact = step > 0 and abs(step - tick * every) < TICK_TOLERANCE
        round_ticks = math.ceil(math.lcm(p.period, step) / tick) if exact else most + 1
        ticks = min(round_ticks, most)
        filled = min(p.longest + longest_wait(p) + every, _MOST_REPLAYED)  # the queue fills first
        sent_at = np.arange(0, filled + ticks + window + p.longest + every, every)
        bare = p._replace(blackouts=_NO_BLACKOUTS)
        with np.errstate(over="ignore"):  # uncompiled, the random numbers overflow by design
            arrived = first_arrivals(bare, (np.uint64(0), np.uint64(0)), len(sent_at), every=every)
        delays = np.full(int(sent_at[-1]) + 1, -1, dtype=np.int64)
        delays[sent_at] = np.where(arrived < 0, -1, arrived - sent_at)
        return _Replay((delays[filled : filled + ticks + window],), ticks, ticks == round_ticks)

    def inspected(self, replay: _Replay) -> str:
        """Describe the inspected part of the recorded link."""
        return "one pass" if replay.whole else f"its first {self.seconds(replay.ticks)}"

    def recorded_share(self, window: IntArray, every: int, dropout: float) -> tuple[float, _Replay]:
        """Return the share of ticks in which a recorded link is late, and the inspected part."""
        replay = self.replayed(every, len(window) - 1)
        shares = [recorded_late_share(delays, window, dropout) for delays in replay.delays]
        return sum(shares) / len(shares), replay

    def longest_gap(self) -> tuple[float, float]:
        """Return the longest time without a delivery opportunity in a Mahimahi file, and its start [s]."""
        recorded = trace_named(self._traces, self.settings.trace)
        recording = None if recorded is None else recording_of(recorded)
        if not isinstance(recording, Opportunities):
            return 0.0, 0.0
        times = np.concatenate(([recording.times[-1]], recording.times[-1] + recording.times))
        longest = int(np.argmax(np.diff(times)))
        begins = int(times[longest] % recording.times[-1])
        return float(np.diff(times)[longest]) / 1000.0, begins / 1000.0

    def seconds(self, ticks: float) -> str:
        """Return ticks as a time with its unit."""
        dt = self.scenario.dt
        return f"{enough_digits(ticks * dt, lambda time: abs(time / dt - ticks) < _SAME_TICK)} s"


# A2: the age of the newest detection

_AGE, _INTERVAL = "max_measurement_age", "max_command_interval"


def age_findings(link: InspectedLink, bounds: SafetyBounds) -> Iterator[Finding]:
    """Find detections that become older than the bound.

    Detections are made at multiples of the detector's period. Each arrives after `least` to `most` ticks, unless it is
    lost.
    """
    scenario, p = link.scenario, link.parameters
    period, age = scenario.detection_period, bounds.max_age_ticks
    if link.settings.trace:
        yield from _recorded_ages(link, bounds)
        yield from _blackout_ages(link, age)
        return
    waits, in_blackouts = _queue_ticks(p, period), list(_blackout_ages(link, age))
    if waits is not None and scenario.detections.dropout == 0.0 and link.least + waits > age:
        rate = 1.0 / (period * scenario.dt)
        cause = (
            f"{link.named('bandwidth', 'queue')}: the link carries fewer messages than the detector sends ({rate:g} "
            f"/s), and they arrive up to {link.seconds(link.most + waits)} old"
        )
        yield Finding(Frequency.CERTAIN, cause, _AGE)
    elif waits is None and link.least + period - 1 > age:
        frequency = Frequency.ALWAYS if link.least > age else Frequency.CERTAIN
        why = (
            link.named("delay", "jitter")
            or f"detections.rate = {exact(scenario.detections.rate)} /s"
        )
        oldest = link.seconds(link.least + period - 1)
        cause = f"{why}: the newest detection is {oldest} old before the next one arrives"
        yield Finding(frequency, cause, _AGE)
    else:
        yield from _random_ages(link, bounds, planned=not in_blackouts)
    yield from in_blackouts


def _recorded_ages(link: InspectedLink, bounds: SafetyBounds) -> Iterator[Finding]:
    """Find ages that a recording causes, alone or together with missed detections."""
    scenario, every = link.scenario, link.scenario.detection_period
    if bounds.max_age_ticks >= scenario.ticks:
        return
    window, missed = age_window(bounds.max_age_ticks), scenario.detections.dropout
    share, replay = link.recorded_share(window, every, missed)
    whole, trace = replay.whole, f"{link.path}.trace"
    dropout = f", detections.dropout = {exact(missed)}" if missed else ""
    gap, at = link.longest_gap() if not whole else (0.0, 0.0)
    if share * scenario.ticks > RARE:
        part = f"{percent(share)} of the ticks of {link.inspected(replay)}"
        cause = f"{trace}{dropout}: the newest detection is too old in {part}"
        yield Finding(frequency_of(share, whole=whole), cause, _AGE)
    elif gap > bounds.max_measurement_age + scenario.dt:
        cause = f"{trace}: no detection arrives for {above(gap, bounds.max_measurement_age)} s from {at:g} s on"
        yield Finding(Frequency.SOMETIMES, cause, _AGE)
    elif not whole:
        cause = (
            f"{trace}: only {link.inspected(replay)} was inspected, where no detection is too old"
        )
        yield Finding(Frequency.SOMETIMES, cause, _AGE, remedy="shorten the recording")
    elif link.parameters.replay != DELAYS:
        nearly = age_window(max(bounds.max_age_ticks - every - 1, 0))
        if link.recorded_share(nearly, every, missed)[0] * scenario.ticks > RARE:
            cause = (
                f"{trace}: the age of the newest detection comes so close to the bound that it exceeds it where a run "
                "starts at another point of the recording"
            )
            yield Finding(Frequency.SOMETIMES, cause, _AGE)


def _queue_ticks(parameters: LinkParameters, period: int) -> int | None:
    """Return the largest age of the newest detection behind a full queue, without delay; None: no queue forms."""
    if parameters.spacing <= period + TICK_TOLERANCE:
        return None
    queue = parameters.settings.queue
    waits = (
        (queue - 1) * period + 1 if parameters.newest else math.floor(queue * parameters.spacing)
    )
    return waits + math.floor(parameters.spacing) - 1


def _uninspected(
    link: InspectedLink, window: IntArray, field: str, period: int = 1
) -> Iterator[Finding]:
    """Find a bound with too many ticks to inspect the link."""
    if too_many(link.parameters, window, ticks=link.scenario.ticks, period=period):
        cause = (
            f"dt = {exact(link.scenario.dt)} s: {link.path} was not inspected, as {len(window):,} ticks fit into "
            "the bound"
        )
        yield Finding(Frequency.SOMETIMES, cause, field, remedy="raise dt")


def _random_ages(link: InspectedLink, bounds: SafetyBounds, *, planned: bool) -> Iterator[Finding]:
    """Find ages that random losses cause; `planned`: include planned blackouts, which alone do not exceed the bound.

    At a sender whose messages wait, each message is assumed to wait as long as a full queue lasts.
    """
    scenario, p = link.scenario, link.parameters
    dropout, period, waited = scenario.detections.dropout, scenario.detection_period, 0
    if bounds.max_age_ticks >= scenario.ticks:
        return
    if p.spacing > period + TICK_TOLERANCE:
        waited = (
            link.settings.queue * period if p.newest else math.ceil(link.settings.queue * p.spacing)
        )
        period = math.ceil(p.spacing - TICK_TOLERANCE)
    if not planned:
        p = p._replace(blackouts=_NO_BLACKOUTS)
    window = age_window(bounds.max_age_ticks, waited)
    uninspected = list(_uninspected(link, window, _AGE, period))
    if uninspected:
        yield from uninspected
        return
    late = late_shares(p, window, ticks=scenario.ticks, period=period, dropout=dropout)
    if late.sum() <= RARE:
        return
    fields = (
        link.named("jitter", "reorder", "loss", "bandwidth"),
        link.named("burst_length", "burst_interval", "blackout_length", "blackout_interval"),
        f"detections.dropout = {exact(dropout)}" if dropout else "",
    )
    share = float(late.mean())
    effect = f"the newest detection is too old in {percent(share)} of the ticks"
    yield Finding(frequency_of(share), f"{', '.join(filter(None, fields))}: {effect}", _AGE)


def _blackout_ages(link: InspectedLink, age: int) -> Iterator[Finding]:
    """Find planned blackouts after which the newest detection is too old before the next one can arrive."""
    scenario, period = link.scenario, link.scenario.detection_period
    rows = list(link.planned_blackouts())
    made = np.arange(0, scenario.ticks, period)
    arrives = np.ones(len(made), dtype=bool)
    for first, after in rows:
        arrives[(made >= first) & (made < after)] = False
    for first, after in rows:
        before, later = made[arrives & (made < first)], made[arrives & (made >= after)]
        until = min(int(later[0]) + link.least if later.size else scenario.ticks, scenario.ticks)
        if not before.size:
            cause = f"{link.path}.blackouts: no detection arrives before {link.seconds(until)}"
            yield Finding(
                Frequency.CERTAIN, cause, _AGE, remedy=f"end {link.path}.blackouts earlier"
            )
        elif until - 1 - int(before[-1]) > age:
            since, oldest = int(before[-1]) + age + 1, until - 1 - int(before[-1])
            cause = (
                f"{link.path}.blackouts, {link.seconds(first)} to {link.seconds(after)}: the newest detection becomes "
                f"{link.seconds(oldest)} old, too old from {link.seconds(since)} to {link.seconds(until)}"
            )
            yield Finding(Frequency.CERTAIN, cause, _AGE)


# A5': the time between plans


def _late_settings(link: InspectedLink) -> str:
    """Return the settings that can make commands late or lose them, as the scenario writes them."""
    fields = (
        link.named("delay", "jitter", "reorder", "loss", "bandwidth"),
        link.named("burst_length", "burst_interval", "blackout_length", "blackout_interval"),
        f"{link.path}.blackouts" if any(link.planned_blackouts()) else "",
        f"{link.path}.trace" if link.settings.trace else "",
    )
    return ", ".join(filter(None, fields))


def interval_findings(link: InspectedLink, bounds: SafetyBounds) -> Iterator[Finding]:
    """Find times between two plans that exceed the bound, as commands are lost or late."""
    scenario, p, interval = link.scenario, link.parameters, bounds.interval_ticks
    if interval >= scenario.ticks:
        return
    settings = _late_settings(link)
    late = "no command with a new plan takes effect in time"
    window = command_window(bounds.delay_ticks, MOST_CARRIED, interval)
    if not link.settings.trace and link.least > bounds.delay_ticks:
        cause = f"{settings}: every command takes {link.seconds(link.least)} or longer to arrive, so all are late"
        times = (round(link.least * scenario.dt, 9), round(link.most * scenario.dt, 9))
        yield Finding(Frequency.ALWAYS, cause, "max_command_delay", values=times)
        return
    if p.spacing > 1.0 + TICK_TOLERANCE:
        rate = f"{link.path}.bandwidth to {at_least(1.0 / scenario.dt)} messages per second"
        throughout = p.spacing > interval + TICK_TOLERANCE
        cause = f"{settings}: the link carries fewer messages than one per tick, and commands are dropped"
        yield Finding(
            Frequency.THROUGHOUT if throughout else Frequency.SOMETIMES,
            cause,
            _INTERVAL,
            remedy=f"raise {rate} or more",
        )
        return
    uninspected = [] if link.settings.trace else list(_uninspected(link, window, _INTERVAL))
    if uninspected:
        yield from uninspected
        return
    lossless = p._replace(
        settings=msgspec.structs.replace(p.settings, loss=0.0), bursts=False, up=0.0
    )
    certain = late_shares(lossless, window, ticks=scenario.ticks)
    blackouts = [
        (f, a) for f, a in link.planned_blackouts() if certain[f:a].max(initial=0.0) == 1.0
    ]
    for first, after in blackouts:
        span = f"{link.seconds(first)} to {link.seconds(after)}"
        yield Finding(Frequency.CERTAIN, f"{link.path}.blackouts, {span}: {late}", _INTERVAL)
    if blackouts:
        p = p._replace(blackouts=_NO_BLACKOUTS)
    part = "of the ticks"
    if link.settings.trace:
        share, replay = link.recorded_share(window, 1, 0.0)
        part = f"of the ticks of {link.inspected(replay)}"
        if share == 0.0 and not replay.whole:
            cause = f"{settings}: only {link.inspected(replay)} was inspected"
            yield Finding(Frequency.SOMETIMES, cause, _INTERVAL, remedy="shorten the recording")
    else:
        late_share = late_shares(p, window, ticks=scenario.ticks)
        share = float(late_share.mean()) if late_share.size else 0.0  # longer than the run
    if share * scenario.ticks <= RARE:
        return
    cause = f"{settings}: {late} in {percent(share)} {part}"
    if not link.settings.trace and link.most > bounds.delay_ticks:
        waiting = command_window(link.most, MOST_CARRIED, interval)
        if late_shares(p, waiting, ticks=scenario.ticks).sum() <= RARE:
            values = (round(link.most * scenario.dt, 9),)
            yield Finding(frequency_of(share), cause, "max_command_delay", values=values)
            return
    yield Finding(frequency_of(share), cause, _INTERVAL)
