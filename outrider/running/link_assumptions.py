"""Assumptions of the law `certified` that a radio link cannot keep: A2, the age of detections, and A5', commands.

How often random losses break them is an expected share of the ticks (`sim.channel.gaps`).
"""

import math
from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import msgspec
import numpy as np

from bus.messages.links import LinkKind
from bus.messages.vehicle import MOST_CARRIED
from bus.ticks import TICK_TOLERANCE, first_tick_from
from sim.channel.description import link_parameters, longest_delay, longest_wait
from sim.channel.gaps import (
    age_window,
    command_window,
    delays_at,
    late_shares,
    recorded_late_share,
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
_MOST_PLAYED = 1_000_000
"""Ticks of a recorded link that are inspected at most."""
_NO_BLACKOUTS = np.zeros((0, 2), dtype=np.int64)


class How(StrEnum):
    """Frequency at which an assumption is broken."""

    THROUGHOUT = "for certain and throughout"
    """In every tick, or in most of them: hardly anything can be certified."""
    CERTAIN = "for certain"
    """At times that are known before the run."""
    SOMETIMES = "now and then"
    """At random."""


def how_often(share: float, *, whole: bool = True) -> How:
    """Return the frequency that a share of the ticks means; `whole`: of all ticks, not of a part."""
    return How.THROUGHOUT if whole and share >= 0.5 else How.SOMETIMES


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{100.0 * share:.3g} %"


class _Played(NamedTuple):
    """Delays that a recorded link gives to the messages of a run."""

    delays: tuple[IntArray, ...]
    """For each alignment of recording and messages: see `recorded_late_share`."""
    ticks: int
    """Ticks that are inspected of each, without the end of a window."""
    whole: bool
    """True if all of the recording is inspected."""


class InspectedLink:
    """A UAV's link of one kind with what follows from its settings."""

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
        """These fields with their values, but for those that are zero."""
        values = {field: getattr(self.settings, field) for field in fields}
        return ", ".join(
            f"{self.path}.{field} = {value:g}" for field, value in values.items() if value
        )

    def dark(self) -> Iterator[tuple[int, int]]:
        """First tick of each planned blackout of this flight, and the first after it."""
        for first, after in self.parameters.blackouts.tolist():
            if first < min(after, self.scenario.ticks):
                yield first, min(after, self.scenario.ticks)

    def played(self, every: int, window: int) -> _Played:
        """Return the delays of a recorded link without planned blackouts, for every place at which a run may begin.

        Args:
            every: Ticks between two messages.
            window: Ticks that are needed beyond those that are inspected.
        """
        p = self.parameters
        if p.replay == DELAYS:
            whole = p.period * every <= _MOST_PLAYED
            ticks = min(p.period, _MOST_PLAYED)
            places = np.arange(ticks + window)
            delays = delays_at(p, places % p.period)
            sent = [(places + phase) % every == 0 for phase in range(every if whole else 1)]
            return _Played(tuple(np.where(leaves, delays, -1) for leaves in sent), ticks, whole)
        tick = 1000.0 * p.dt
        step = round(tick * every)
        exact = step > 0 and abs(step - tick * every) < TICK_TOLERANCE
        round_ticks = math.ceil(math.lcm(p.period, step) / tick) if exact else _MOST_PLAYED + 1
        ticks = min(round_ticks, _MOST_PLAYED)
        begun = min(p.longest + longest_wait(p) + every, _MOST_PLAYED)  # before, the queue fills
        sent_at = np.arange(0, begun + ticks + window + p.longest + every, every)
        bare = p._replace(blackouts=_NO_BLACKOUTS)
        with np.errstate(over="ignore"):  # of its draws, where it is not compiled
            arrived = first_arrivals(bare, (np.uint64(0), np.uint64(0)), len(sent_at), every=every)
        delays = np.full(int(sent_at[-1]) + 1, -1, dtype=np.int64)
        delays[sent_at] = np.where(arrived < 0, -1, arrived - sent_at)
        return _Played((delays[begun : begun + ticks + window],), ticks, ticks == round_ticks)

    def inspected(self, played: _Played) -> str:
        """Describe the part of the recorded link that was inspected."""
        return "a round" if played.whole else f"its first {self.seconds(played.ticks)}"

    def recorded_share(self, window: IntArray, every: int, dropout: float) -> tuple[float, _Played]:
        """Return the share of the ticks at which a recorded link is late, and the part that was inspected."""
        played = self.played(every, len(window) - 1)
        shares = [recorded_late_share(delays, window, dropout) for delays in played.delays]
        return sum(shares) / len(shares), played

    def longest_gap(self) -> tuple[float, float]:
        """Return the longest time without a delivery opportunity of a Mahimahi file, and where it begins [s]."""
        recorded = trace_named(self._traces, self.settings.trace)
        recording = None if recorded is None else recording_of(recorded)
        if not isinstance(recording, Opportunities):
            return 0.0, 0.0
        times = np.concatenate(([recording.times[-1]], recording.times[-1] + recording.times))
        longest = int(np.argmax(np.diff(times)))
        begins = int(times[longest] % recording.times[-1])
        return float(np.diff(times)[longest]) / 1000.0, begins / 1000.0

    def seconds(self, ticks: float) -> str:
        """As a time."""
        return f"{ticks * self.scenario.dt:g} s"


# A2: the age of the newest detection


def age_shortfalls(link: InspectedLink, promise: SafetyBounds) -> Iterator[tuple[How, str]]:
    """Looks are at multiples of the detector's period; each that gets through arrives after `least` to `most` ticks."""
    scenario, p = link.scenario, link.parameters
    period, age = scenario.detection_period, promise.max_age_ticks
    limit = f"certificate.max_measurement_age = {promise.max_measurement_age:g} s"
    if link.settings.trace:
        yield from _recorded_ages(link, promise, limit)
        yield from _dark_ages(link, age, limit)
        return
    waits, dark = _queue_ticks(p, period), list(_dark_ages(link, age, limit))
    if waits is not None and scenario.detections.dropout == 0.0 and link.least + waits > age:
        rate = 1.0 / (period * scenario.dt)
        what = f"{link.named('bandwidth', 'queue')}: fewer than the detector's looks, {rate:g} /s"
        yield How.CERTAIN, f"{what}: they are up to {link.seconds(link.most + waits)} old, {limit}"
    elif waits is None and link.least + period - 1 > age:
        how = How.THROUGHOUT if link.least > age else How.CERTAIN
        why = link.named("delay", "jitter") or f"detections.rate = {scenario.detections.rate:g} /s"
        oldest = link.seconds(link.least + period - 1)
        yield (
            how,
            f"{why}: the newest detection is {oldest} old before the next one arrives, {limit}",
        )
    else:
        yield from _unlucky_ages(link, promise, planned=not dark)
    yield from dark


def _recorded_ages(
    link: InspectedLink, promise: SafetyBounds, limit: str
) -> Iterator[tuple[How, str]]:
    """Ages that a recording causes by itself in every round, or together with looks that find nothing."""
    scenario, every = link.scenario, link.scenario.detection_period
    if promise.max_age_ticks >= scenario.ticks:
        return
    window, missed = age_window(promise.max_age_ticks), scenario.detections.dropout
    share, played = link.recorded_share(window, every, missed)
    whole = played.whole
    dropout = f", detections.dropout = {missed:g}" if missed else ""
    gap, at = link.longest_gap() if not whole else (0.0, 0.0)
    if share * scenario.ticks > RARE:
        part = f"{percent(share)} of the ticks of {link.inspected(played)}"
        told = f"the newest detection is older than {limit} in {part}"
        yield how_often(share, whole=whole), f"{link.path}.trace{dropout}: {told}"
    elif gap > promise.max_measurement_age + scenario.dt:
        told = f"no detection arrives for {gap:g} s from {at:g} s on, longer than {limit}"
        yield How.SOMETIMES, f"{link.path}.trace: {told}"
    elif not whole:
        told = f"not older than {limit} in {link.inspected(played)}; the rest was not inspected"
        yield How.SOMETIMES, f"{link.path}.trace: the newest detection is {told}"
    elif link.parameters.replay != DELAYS:
        nearly = age_window(max(promise.max_age_ticks - every - 1, 0))
        if link.recorded_share(nearly, every, missed)[0] * scenario.ticks > RARE:
            told = f"the newest detection becomes so nearly as old as {limit} that it may be older"
            yield (
                How.SOMETIMES,
                f"{link.path}.trace: {told} where a run begins at another place of it",
            )


def _queue_ticks(parameters: LinkParameters, period: int) -> int | None:
    """Greatest age of the newest look, but for the way, once the queue is full; None: it never fills."""
    if parameters.spacing <= period + TICK_TOLERANCE:
        return None
    waits = (
        (parameters.settings.queue - 1) * period + 1
        if parameters.newest
        else math.floor(parameters.settings.queue * parameters.spacing)
    )
    return waits + math.floor(parameters.spacing) - 1


def _unlucky_ages(
    link: InspectedLink, promise: SafetyBounds, *, planned: bool
) -> Iterator[tuple[How, str]]:
    """Ages that random losses cause; `planned`: with planned blackouts, which alone do not.

    At a sender whose messages wait, each of them is taken to have waited for as long as a full queue lasts.
    """
    scenario, p = link.scenario, link.parameters
    dropout, period, waited = scenario.detections.dropout, scenario.detection_period, 0
    if promise.max_age_ticks >= scenario.ticks:
        return
    if p.spacing > period + TICK_TOLERANCE:
        waited = (
            link.settings.queue * period if p.newest else math.ceil(link.settings.queue * p.spacing)
        )
        period = math.ceil(p.spacing - TICK_TOLERANCE)
    if not planned:
        p = p._replace(blackouts=_NO_BLACKOUTS)
    late = late_shares(
        p,
        age_window(promise.max_age_ticks, waited),
        ticks=scenario.ticks,
        period=period,
        dropout=dropout,
    )
    if late.sum() <= RARE:
        return
    fields = (
        link.named("jitter", "reorder", "loss", "bandwidth"),
        link.named("burst_length", "burst_interval", "blackout_length", "blackout_interval"),
        f"detections.dropout = {dropout:g}" if dropout else "",
    )
    share, limit = (
        float(late.mean()),
        f"certificate.max_measurement_age = {promise.max_measurement_age:g} s",
    )
    told = f"the newest detection is older than {limit} in {percent(share)} of the ticks"
    yield how_often(share), f"{', '.join(filter(None, fields))}: {told}"


def _dark_ages(link: InspectedLink, age: int, limit: str) -> Iterator[tuple[How, str]]:
    """Planned blackouts after which the newest detection is too old before the next one can arrive."""
    scenario, period = link.scenario, link.scenario.detection_period
    rows = list(link.dark())
    looks = np.arange(0, scenario.ticks, period)
    through = np.ones(len(looks), dtype=bool)
    for first, after in rows:
        through[(looks >= first) & (looks < after)] = False
    for first, after in rows:
        before, later = looks[through & (looks < first)], looks[through & (looks >= after)]
        until = min(int(later[0]) + link.least if later.size else scenario.ticks, scenario.ticks)
        if not before.size:
            yield (
                How.CERTAIN,
                f"{link.path}.blackouts: nothing is detected before {link.seconds(until)}",
            )
        elif until - 1 - int(before[-1]) > age:
            since, oldest = int(before[-1]) + age + 1, until - 1 - int(before[-1])
            span = f"from {link.seconds(since)} to {link.seconds(until)}"
            yield (
                How.CERTAIN,
                f"{link.path}.blackouts, {link.seconds(first)} to {link.seconds(after)}: the newest detection becomes "
                f"{link.seconds(oldest)} old, {limit}, {span}",
            )


# A5: a command acts exactly tau_c after its tick


def outage_shortfalls(link: InspectedLink, promise: SafetyBounds) -> Iterator[tuple[How, str]]:
    """Motions begin at most `outage` after one another: the packets of one link are lost or late for longer."""
    scenario, p, interval = link.scenario, link.parameters, promise.interval_ticks
    if interval >= scenario.ticks:
        return
    fields = (
        link.named("delay", "jitter", "reorder", "loss", "bandwidth"),
        link.named("burst_length", "burst_interval", "blackout_length", "blackout_interval"),
        f"{link.path}.blackouts" if any(link.dark()) else "",
        f"{link.path}.trace" if link.settings.trace else "",
        f"tau_c = {link.seconds(promise.delay_ticks)}",
    )
    told = ", ".join(filter(None, fields))
    late = f"the next motion begins later than certificate.max_command_interval = {link.seconds(interval)}"
    window = command_window(promise.delay_ticks, MOST_CARRIED, interval)
    if not link.settings.trace and link.least > promise.delay_ticks:
        soonest = f"no motion arrives before {link.seconds(link.least)} after its tick"
        yield How.THROUGHOUT, f"{told}: {soonest}, so all are late"
        return
    if p.spacing > interval + TICK_TOLERANCE:
        rate = 1.0 / (interval * scenario.dt)
        yield How.THROUGHOUT, f"{told}: fewer messages than {rate:g} /s, so that {late}"
        return
    if p.spacing > 1.0 + TICK_TOLERANCE:
        yield How.SOMETIMES, f"{told}: {late}, as packets wait and are dropped"
        return
    lossless = p._replace(
        settings=msgspec.structs.replace(p.settings, loss=0.0), bursts=False, up=0.0
    )
    certain = late_shares(lossless, window, ticks=scenario.ticks)
    blackouts = [(f, a) for f, a in link.dark() if certain[f:a].max(initial=0.0) == 1.0]
    for first, after in blackouts:
        span = f"{link.seconds(first)} to {link.seconds(after)}"
        yield How.CERTAIN, f"{link.path}.blackouts, {span}: {late}"
    if blackouts:
        p = p._replace(blackouts=_NO_BLACKOUTS)
    part = "of the ticks"
    if link.settings.trace:
        share, played = link.recorded_share(window, 1, 0.0)
        part = f"of the ticks of {link.inspected(played)}"
        if share == 0.0 and not played.whole:
            yield How.SOMETIMES, f"{told}: {link.inspected(played)} alone was inspected"
    else:
        late_share = late_shares(p, window, ticks=scenario.ticks)
        share = float(late_share.mean()) if late_share.size else 0.0  # longer than the run
    if share * scenario.ticks > RARE:
        yield how_often(share), f"{told}: {late} in {percent(share)} {part}"
