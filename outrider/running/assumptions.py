"""Tests before a flight, and when links change in it, whether a scenario's UAVs can certify that they keep sight.

The declared assumptions are those of docs/explanation/certificate.md: A1 the error of a detection, A2 the age of the
newest one, A5' the time from the start of one motion to the start of the next, A6' where the UAV is. Wind, links and
detector say which of them they cannot keep, and how often.
"""

import functools
import math
from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import msgspec
import numpy as np

from agents.control.handover import check_assumptions
from agents.control.visibility import bounds_of
from bus.messages import MOST_CARRIED, LinkKind
from bus.registry import LAWS
from bus.ticks import DUST, first_tick_from
from outrider.running.ground_assumptions import ground_warnings
from outrider.running.summary import PERHAPS_EVERY, in_flights
from sim.channel.chances import Chance, chance_of_age, chance_of_error, chance_of_outage
from sim.channel.description import (
    arrival_share,
    link_parameters,
    longest_delay,
    longest_wait,
)
from sim.channel.link_records import DELAYS, LinkParameters
from sim.channel.links import first_arrivals
from sim.channel.places import delays_at
from sim.channel.recorded import Opportunities, recording_of
from sim.channel.recorded import found as trace_named
from sim.engine.briefing import largest_tracking_error, safety_parameters, uav_briefing
from sim.kernels.compile import IntArray
from sim.models.safety import SafetyBounds
from sim.scenario.types import LinkTable, Scenario, Uav

_RARE = 1e-6
"""Events that are expected less often than this in a whole flight are not told."""
_MOST_PLAYED = 1_000_000
"""Ticks of a recorded link that are inspected at most."""


class How(StrEnum):
    """Frequency at which an assumption is broken."""

    THROUGHOUT = "for certain and throughout"
    """In every tick, or in most of them: hardly anything can be certified."""
    CERTAIN = "for certain"
    """At times that are known before the flight."""
    SOMETIMES = "now and then"
    """At random."""


class Shortfall(NamedTuple):
    """An assumption that links or detector cannot keep."""

    uav: str
    assumption: str
    """A1 to A9 of docs/explanation/certificate.md; empty: the declared numbers themselves allow no certificate."""
    how: How
    what: str
    """The fields as the scenario writes them, and what follows."""
    by_chance: bool = False
    """True if the chance that it comes about is reckoned with in `odds`."""

    @property
    def line(self) -> str:
        """For a person."""
        if not self.assumption:
            return f"{self.uav}: not certified: {self.what}"
        return f"{self.uav}: not certified, {self.assumption} is broken {self.how}: {self.what}"


@functools.lru_cache(maxsize=256)
def promise_warnings(scenario: Scenario, links: LinkTable | None = None) -> tuple[str, ...]:
    """Warnings of what stands in the way of the law `certified`, one line each; none for other laws.

    Arguments as in `shortfalls`.
    """
    told, lines = odds(scenario, links), [found.line for found in shortfalls(scenario, links)]
    lines += [*_perfect_detectors(scenario), *ground_warnings(scenario)]
    return (*lines, told.line) if lines and told is not None and told.line else tuple(lines)


def _perfect_detectors(scenario: Scenario) -> Iterator[str]:
    """Warn of each UAV whose certificate relies on detections without any error."""
    if not LAWS[scenario.law.name].watched:
        return
    for uav in scenario.uav:
        if safety_parameters(scenario, uav.name).max_measurement_error == 0.0:
            source = (
                "certificate.error" if scenario.certificate.error == 0.0 else "detections.noise"
            )
            yield (
                f"{uav.name}: {source} = 0: sight is certified for a detector without any error; for a real one set "
                "certificate.error to its greatest error [m]"
            )


class Odds(NamedTuple):
    """The worth of the declared numbers: chances within a flight."""

    exceeded: dict[str, float | None]
    """By `vehicle/number`, the chance that this number is exceeded in a flight, or a bound; None: nothing can be
    stated.
    """
    lost: float | None
    """Once certified, sight is lost in at most this share of the flights, by proof; None: nothing can be promised."""

    @property
    def line(self) -> str:
        """For a person; empty where nothing can be promised, or sight may be lost in every flight."""
        if self.lost is None or self.lost >= PERHAPS_EVERY:
            return ""
        return f"once certified, sight is lost {in_flights(self.lost)}, by proof"


@functools.lru_cache(maxsize=256)
def odds(scenario: Scenario, links: LinkTable | None = None) -> Odds | None:
    """The chances that the numbers are exceeded which the law `certified` relies on; None for other laws or no UAV.

    Arguments as in `shortfalls`. Sight is lost by proof in no more flights than the sum of these chances, where all
    else that the theorem assumes holds for certain.
    """
    if not scenario.uav or not LAWS[scenario.law.name].watched:
        return None
    table, exceeded = links or scenario.links, dict[str, float | None]()
    looks = -(-scenario.ticks // scenario.detection_period)
    for uav in scenario.uav:
        bounds = safety_parameters(scenario, uav.name)
        link = _Link(scenario, table, uav.name, LinkKind.DETECTIONS)
        exceeded[f"{uav.name}/age"] = link.chance_of_age(bounds.max_measurement_age).value
        link = _Link(scenario, table, uav.name, LinkKind.COMMANDS)
        delay = first_tick_from(bounds.max_command_delay, scenario.dt)
        exceeded[f"{uav.name}/outage"] = link.chance_of_outage(
            delay, bounds.max_command_interval
        ).value
        if bounds.max_measurement_error is not None:
            sigma, cut = scenario.detections.noise, scenario.noise_cut
            error = chance_of_error(sigma, cut, looks, bounds.max_measurement_error)
            exceeded[f"{uav.name}/error"] = error.value
    known = [value for value in exceeded.values() if value is not None]
    kept = all(found.by_chance for found in shortfalls(scenario, links))
    lost = min(1.0, sum(known)) if kept and len(known) == len(exceeded) else None
    return Odds(exceeded, lost)


def how_certifiable(scenario: Scenario) -> str | None:
    """Tells if sight can be certified `always`, `not always` or `hardly ever`, as far as that is known.

    None for other laws.
    """
    if not scenario.uav or not LAWS[scenario.law.name].watched:
        return None
    broken = {found.how for found in shortfalls(scenario)}
    return "hardly ever" if How.THROUGHOUT in broken else "not always" if broken else "always"


def shortfalls(scenario: Scenario, links: LinkTable | None = None) -> tuple[Shortfall, ...]:
    """The declared assumptions of the law `certified` that cannot be kept, and how often they are broken.

    Args:
        scenario: What is flown; what the UAVs rely on follows from it when they join.
        links: What the links do now, where an operator has changed them; by default the scenario's.

    Returns:
        Empty for other laws, and where nothing stands in the way. What is expected less than once in a million
        flights is left out.
    """
    if not LAWS[scenario.law.name].watched:
        return ()
    table, found = links or scenario.links, list[Shortfall]()
    for uav in scenario.uav:
        promise = bounds_of(uav_briefing(scenario, uav.name, scenario.seed))
        found += [
            Shortfall(uav.name, "", How.THROUGHOUT, fault) for fault in check_assumptions(promise)
        ]
        if math.isfinite(promise.placed_error):
            found += [
                Shortfall(uav.name, "A1", how, what, by_chance=True)
                for how, what in _errors(scenario, promise.max_measurement_error)
            ]
            found += [
                Shortfall(uav.name, "A6'", how, what) for how, what in _off(scenario, uav, promise)
            ]
        for kind, name, check in (
            (LinkKind.DETECTIONS, "A2", _ages),
            (LinkKind.COMMANDS, "A5'", _outages),
        ):
            link = _Link(scenario, table, uav.name, kind)
            found += [
                Shortfall(uav.name, name, how, what, how is not How.CERTAIN)
                for how, what in check(link, promise)
            ]
    return tuple(found)


class _Link:
    """A UAV's link of one kind with what follows from its settings."""

    def __init__(self, scenario: Scenario, table: LinkTable, uav: str, kind: LinkKind) -> None:
        self.scenario, self._traces = scenario, table.traces
        self.settings, self.path = table.of(uav, kind), table.path_of(uav, kind)
        p = link_parameters(self.settings, scenario.dt, traces=table.traces)
        self.parameters: LinkParameters = p
        self.least = first_tick_from(p.delay + (p.least if p.jitter > 0.0 else 0.0), p.dt)
        self.most = first_tick_from(longest_delay(self.settings), p.dt)

    def chance_of_age(self, age: float, *, planned: bool = True) -> Chance:
        """That the newest detection becomes older than this [s], with planned blackouts or without."""
        s, settings = self.scenario, self.settings
        return chance_of_age(
            settings if planned else msgspec.structs.replace(settings, blackouts=()),
            dt=s.dt,
            period_ticks=s.detection_period,
            dropout=s.detections.dropout,
            ticks=s.ticks,
            age=age,
            traces=self._traces,
        )

    def chance_of_outage(self, delay: int, outage: float) -> Chance:
        """That the next motion begins later than this [s], where commands act after `delay` ticks."""
        return chance_of_outage(
            self.settings,
            dt=self.scenario.dt,
            delay_ticks=delay,
            repeats=MOST_CARRIED,
            ticks=self.scenario.ticks,
            outage=outage,
            traces=self._traces,
        )

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

    def played(self, every: int) -> tuple[IntArray, bool]:
        """Age of the newest message at each tick of the recorded link [ticks], without planned blackouts.

        Args:
            every: Ticks between two messages.

        Returns:
            The ages until all repeats, and whether it is so: otherwise they are those of a part.
        """
        p = self.parameters
        table, tick = p.replay == DELAYS, 1000.0 * p.dt
        most = _MOST_PLAYED
        step = round(tick * every)
        whole, settled = p.period, p.longest + p.queue * every  # before that it has only begun
        if not table:
            exact = step > 0 and abs(step - tick * every) < DUST
            whole = math.ceil(math.lcm(p.period, step) / tick) if exact else most + 1
            settled = p.longest + longest_wait(p) + every
        ticks, settled = min(whole, most), min(settled, most)
        sent = np.arange(0, settled + ticks + every, every)
        if table:
            took = delays_at(p, sent % p.period)
            arrived = np.where(took < 0, -1, sent + took)
        else:
            bare = p._replace(blackouts=np.zeros((0, 2), dtype=np.int64))
            with np.errstate(over="ignore"):  # of its draws, where it is not compiled
                arrived = first_arrivals(bare, (np.uint64(0), np.uint64(0)), len(sent), every=every)
        newest = np.full(settled + ticks, -1, dtype=np.int64)
        there = (arrived >= 0) & (arrived < len(newest))
        np.maximum.at(newest, arrived[there], sent[there])
        newest = np.maximum.accumulate(newest)
        return (np.arange(len(newest)) - newest)[settled:], ticks == whole

    def inspected(self, ages: IntArray, whole: bool) -> str:
        """Describe the part of the recorded link that `played` has inspected."""
        return "a round" if whole else f"its first {self.seconds(len(ages))}"

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


def _often(share: float, *, whole: bool = True) -> How:
    return How.THROUGHOUT if whole and share >= 0.5 else How.SOMETIMES


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


# A1: the error of a detection


def _errors(scenario: Scenario, eps: float) -> Iterator[tuple[How, str]]:
    """Noise is normal in each axis, so that its norm exceeds x with the chance exp(-x²/(2 sigma²)), cut or not."""
    sigma, cut = scenario.detections.noise, scenario.noise_cut
    if sigma == 0.0 or eps >= sigma * cut * (1.0 - DUST):
        return
    beyond = math.exp(-0.5 * cut * cut)
    share = (math.exp(-0.5 * (eps / sigma) ** 2) - beyond) / (1.0 - beyond)
    if share * scenario.ticks / scenario.detection_period > _RARE:
        errors = (
            "have no bound (detections.cut = 0)"
            if math.isinf(cut)
            else f"of the detections reach {sigma * cut:g} m"
        )
        yield (
            _often(share),
            f"certificate.error = {eps:g} m, but the errors {errors} at detections.noise = {sigma:g} m: "
            f"{_percent(share)} are larger",
        )


# A6': where the UAV is


def _off(scenario: Scenario, uav: Uav, promise: SafetyBounds) -> Iterator[tuple[How, str]]:
    """Wind and own position may take it farther from where it is told that it is than is declared, but need not."""
    most, declared = largest_tracking_error(scenario, uav), promise.max_tracking_error
    if most > declared * (1.0 + DUST):
        what = f"certificate.tracking = {declared:g} m, but wind and own_error may take it {most:.3g} m off"
        yield How.SOMETIMES, what


# A2: the age of the newest detection


def _ages(link: _Link, promise: SafetyBounds) -> Iterator[tuple[How, str]]:
    """Looks are at multiples of the detector's period; each that gets through arrives after `least` to `most` ticks."""
    scenario, p = link.scenario, link.parameters
    period, age = scenario.detection_period, promise.max_age_ticks
    limit = f"certificate.age = {promise.max_measurement_age:g} s"
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


def _recorded_ages(link: _Link, promise: SafetyBounds, limit: str) -> Iterator[tuple[How, str]]:
    """Ages that a recording causes by itself in every round, or together with looks that find nothing."""
    scenario, every = link.scenario, link.scenario.detection_period
    ages, whole = link.played(every)
    share = float(np.mean(ages > promise.max_age_ticks))
    chance = link.chance_of_age(promise.max_measurement_age, planned=False)
    if chance.value is not None and chance.value <= _RARE:
        return
    often = in_flights(chance.value) if chance.value is not None else ""
    missed = scenario.detections.dropout
    dropout = f", detections.dropout = {missed:g}" if missed else ""
    gap, at = link.longest_gap() if not whole else (0.0, 0.0)
    if share > 0.0:
        what = (
            f"older than {limit} in {_percent(share)} of the ticks of {link.inspected(ages, whole)}"
        )
        told = f"the newest detection is {what}{', and becomes so ' if often else ''}{often}"
        yield _often(share, whole=whole), f"{link.path}.trace: {told}"
    elif often:
        told = f"the newest detection becomes older than {limit} {often}"
        yield How.SOMETIMES, f"{link.path}.trace{dropout}: {told}"
    elif gap > promise.max_measurement_age + scenario.dt:
        told = f"no detection arrives for {gap:g} s from {at:g} s on, longer than {limit}"
        yield How.SOMETIMES, f"{link.path}.trace: {told}"
    elif not whole:
        told = (
            f"not older than {limit} in {link.inspected(ages, whole)}; the rest was not inspected"
        )
        yield How.SOMETIMES, f"{link.path}.trace: the newest detection is {told}"
    elif ages.max() + every + 1 > promise.max_age_ticks:
        told = f"the newest detection becomes {link.seconds(ages.max())} old, so near to {limit} that it may be older"
        yield How.SOMETIMES, f"{link.path}.trace: {told} where a run begins at another place of it"


def _queue_ticks(parameters: LinkParameters, period: int) -> int | None:
    """Greatest age of the newest look, but for the way, once the queue is full; None: it never fills."""
    if parameters.spacing <= period + DUST:
        return None
    waits = (
        (parameters.queue - 1) * period + 1
        if parameters.newest
        else math.floor(parameters.queue * parameters.spacing)
    )
    return waits + math.floor(parameters.spacing) - 1


def _unlucky_ages(
    link: _Link, promise: SafetyBounds, *, planned: bool
) -> Iterator[tuple[How, str]]:
    """Ages that chance causes now and then; `planned`: with planned blackouts, which alone do not."""
    scenario, parameters = link.scenario, link.parameters
    chance = link.chance_of_age(promise.max_measurement_age, planned=planned)
    if chance.value is not None and chance.value <= _RARE:
        return
    missed = 1.0 - (1.0 - parameters.loss) * (1.0 - scenario.detections.dropout)
    period, age = scenario.detection_period, promise.max_age_ticks
    shares = np.array(
        [1.0 - (1.0 - missed) * arrival_share(parameters, ticks) for ticks in range(age + 1)]
    )
    old = sum(float(np.prod(shares[phase::period])) for phase in range(period)) / period
    dropout = scenario.detections.dropout
    fields = (
        link.named("jitter", "reorder", "loss", "bandwidth"),
        link.named("burst_length", "burst_interval", "blackout_length", "blackout_interval"),
        f"detections.dropout = {dropout:g}" if dropout else "",
    )
    limit = f"certificate.age = {promise.max_measurement_age:g} s"
    often = in_flights(chance.value) if chance.value is not None else chance.why
    yield (
        _often(old),
        f"{', '.join(filter(None, fields))}: the newest detection becomes older than {limit} {often}",
    )


def _dark_ages(link: _Link, age: int, limit: str) -> Iterator[tuple[How, str]]:
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


# A5: from the start of one motion to the start of the next


def _outages(link: _Link, promise: SafetyBounds) -> Iterator[tuple[How, str]]:
    """Motions begin at most `outage` after one another: the packets of one link are lost or late for longer."""
    outage, parameters = promise.interval_ticks * promise.dt, link.parameters
    chance = link.chance_of_outage(promise.delay_ticks, outage)
    if chance.value is not None and chance.value <= _RARE:
        return
    fields = (
        link.named("delay", "jitter", "reorder", "loss", "bandwidth"),
        link.named("burst_length", "burst_interval", "blackout_length", "blackout_interval"),
        f"{link.path}.blackouts" if any(link.dark()) else "",
        f"{link.path}.trace" if link.settings.trace else "",
        f"tau_c = {link.seconds(promise.delay_ticks)}",
    )
    told, late = ", ".join(filter(None, fields)), f"later than certificate.outage = {outage:g} s"
    if link.least > promise.delay_ticks:
        first = (
            f"no motion arrives before {link.seconds(link.least)} after its tick, so all are late"
        )
        yield How.THROUGHOUT, f"{told}: {first}"
    elif parameters.spacing > promise.interval_ticks + DUST:
        rate = 1.0 / outage
        yield (
            How.THROUGHOUT,
            f"{told}: fewer messages than {rate:g} /s, so that the next motion begins {late}",
        )
    elif chance.value is None:
        unknown = f"how seldom the next motion begins {late} is unknown, as {chance.why}"
        yield How.SOMETIMES, f"{told}: {unknown}"
    else:
        planned = any(link.dark()) or link.settings.trace
        how = How.CERTAIN if planned and chance == (1.0, "") else How.SOMETIMES
        yield how, f"{told}: the next motion begins {late} {in_flights(chance.value)}"
