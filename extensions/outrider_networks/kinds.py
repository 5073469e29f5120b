"""Detections and commands over one link and one run: their schedules, windows and queues."""

import functools
import math
from collections.abc import Iterator

import numpy as np

from bus.messages.links import LinkSettings
from bus.ticks import TICK_TOLERANCE
from outrider_networks.automaton import Plan, Window, endless_window, window_of
from outrider_networks.link_runs import MOST_CELLS, SUMMED, DrawnRun, LinkRun, RecordedRun
from outrider_networks.places import (
    delays_by_place,
    oldest_by_place,
    unseen_by_place,
    waits_by_place,
)
from sim.channel.description import link_parameters
from sim.channel.gaps import Mask, age_window, command_window, loss_chain, shares_by_delay
from sim.channel.link_records import OPPORTUNITIES, LinkParameters
from sim.channel.recorded import RecordedLink
from sim.compiling.compile import FloatArray

_MAHIMAHI = "it plays a Mahimahi file, in which what waits depends on all that was sent before"
_LONG = "the recording is too long to be evaluated from each of its places"
_NEVER = 1e-18


@functools.lru_cache(maxsize=64)
def detections_run(
    settings: LinkSettings,
    dt: float,
    period: int,
    dropout: float,
    ticks: int,
    traces: tuple[RecordedLink, ...],
) -> LinkRun:
    """Return the ages of detections, one every `period` ticks."""
    parameters = link_parameters(settings, dt, traces=traces)
    if settings.trace:
        return _recorded_ages(parameters, period, dropout, ticks)
    left, by_delay = _left(parameters, ticks), shares_by_delay(parameters)
    reasons = _reasons(parameters, by_delay)
    sent = np.arange(ticks) % period == 0
    queued = parameters.spacing > period + TICK_TOLERANCE
    plan = Plan(
        functools.partial(_age_window, by_delay, 0),
        lambda _: endless_window(ticks),
        ((1.0, sent & left),),
        sent,
    )
    plans: tuple[Plan, ...] = (plan,)
    if queued:
        plans = tuple(_queued(plan, parameters, by_delay, period, dropout, left))
        reasons.append("detections wait for others")
        if not plans:
            return "looks that find nothing let the queue run empty"
    chain = loss_chain(parameters, 0.0 if queued else dropout)
    regular = bool(left.all()) and not queued
    return DrawnRun(chain, plans, ticks, regular, _because(reasons), ticks - 1)


@functools.lru_cache(maxsize=64)
def commands_run(
    settings: LinkSettings,
    dt: float,
    delay: int,
    repeats: int,
    ticks: int,
    traces: tuple[RecordedLink, ...],
) -> LinkRun:
    """Return the outages of commands, one packet a tick."""
    parameters = link_parameters(settings, dt, traces=traces)
    if settings.trace:
        return _recorded_outages(parameters, delay, repeats, ticks)
    if parameters.spacing > 1.0 + TICK_TOLERANCE:
        return "fewer packets leave than are sent, so that motions wait and are dropped"
    left, by_delay = _left(parameters, ticks), shares_by_delay(parameters)
    window = functools.partial(_outage_window, by_delay, delay, repeats)
    plan = Plan(window, window, ((1.0, left),), np.ones(ticks, dtype=bool))
    why = _because(_reasons(parameters, by_delay[: delay + 1]))
    regular = bool(left.all())
    return DrawnRun(loss_chain(parameters), (plan,), ticks, regular, why, ticks - delay)


def _left(parameters: LinkParameters, ticks: int) -> Mask:
    """Return by tick whether no planned blackout hides a message that leaves then."""
    left = np.ones(ticks, dtype=bool)
    for first, after in parameters.blackouts.tolist():
        left[first:after] = False
    return left


def _reasons(parameters: LinkParameters, by_delay: FloatArray) -> list[str]:
    """Return why the result for this link is a bound."""
    reasons = []
    if len(set(by_delay.tolist()) - {0.0}) > 1:
        reasons.append("delays vary")
    if parameters.up > 0.0:
        reasons.append("blackouts come at random")
    return reasons


def _because(reasons: list[str]) -> str:
    return f"{SUMMED}: {', '.join(reasons)}" if reasons else ""


def _age_window(by_delay: FloatArray, waited: int, age: int) -> Window:
    """Return the window for an age, where each detection has waited before it left [ticks]."""
    fails = max(age - waited + 1, int(np.flatnonzero(by_delay)[0]))
    return window_of(age_window(age, waited), by_delay, fails)


def _outage_window(by_delay: FloatArray, delay: int, repeats: int, outage: int) -> Window:
    return window_of(command_window(delay, repeats, outage), by_delay, delay + outage)


def _not_evaluated(parameters: LinkParameters, ticks: int) -> str:
    """Return why nothing is known of a recording; empty: it is."""
    if parameters.replay == OPPORTUNITIES:
        return _MAHIMAHI
    return _LONG if parameters.period * max(ticks, parameters.longest) > MOST_CELLS else ""


def _recorded_ages(
    parameters: LinkParameters, period: int, dropout: float, ticks: int
) -> RecordedRun | str:
    if why := _not_evaluated(parameters, ticks):
        return why
    delays, left = delays_by_place(parameters), _left(parameters, ticks)
    if dropout == 0.0:
        oldest = oldest_by_place(delays, left, period)
        return RecordedRun(lambda age: (oldest > age).astype(float), ticks, "", ticks - 1)

    @functools.lru_cache(maxsize=64)
    def exceeded(age: int) -> FloatArray:
        return np.minimum(1.0, unseen_by_place(delays, left, period, dropout, age))

    return RecordedRun(exceeded, ticks, _because(["looks find nothing at random"]), ticks - 1)


def _recorded_outages(
    parameters: LinkParameters, delay: int, repeats: int, ticks: int
) -> RecordedRun | str:
    if why := _not_evaluated(parameters, ticks):
        return why
    waits = waits_by_place(delays_by_place(parameters), _left(parameters, ticks), delay, repeats)
    return RecordedRun(lambda outage: (waits > outage).astype(float), ticks, "", ticks - delay)


def _queued(
    plan: Plan,
    parameters: LinkParameters,
    by_delay: FloatArray,
    period: int,
    dropout: float,
    left: Mask,
) -> Iterator[Plan]:
    """Yield bounds for a bandwidth below the detector's rate.

    A sender that is never idle lets one message go every 1/bandwidth, from the first look on that finds something. It
    is never idle if no more than `misses` looks in a row find nothing, which fails with a probability that is added,
    and if misses + 1 looks fit between two messages. A message that leaves was taken at most queue (misses + 1) looks
    ago if the newest are kept: those that wait are among the last `queue` that found something. If the oldest are
    kept, it has waited for at most `queue` others.
    """
    ticks = len(left)
    for misses in range(math.floor(parameters.spacing + TICK_TOLERANCE) // period):
        extra = math.ceil(ticks / period) * dropout ** (misses + 1)
        if extra >= 1.0:
            continue
        waited = (
            parameters.settings.queue * (misses + 1) * period
            if parameters.newest
            else math.ceil(parameters.settings.queue * parameters.spacing)
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
            window=functools.partial(_age_window, by_delay, waited),
            schedules=schedules,
            regular=_slots(parameters, 0, ticks),
            extra=extra,
        )
        if extra < _NEVER:
            return


def _slots(parameters: LinkParameters, first: int, ticks: int) -> Mask:
    """Return by tick whether a sender that is busy from the tick `first` on lets a message go."""
    leaves = np.zeros(ticks, dtype=bool)
    at = np.ceil(
        first
        + np.arange(math.ceil(ticks / parameters.spacing)) * parameters.spacing
        - TICK_TOLERANCE
    ).astype(int)
    leaves[at[at < ticks]] = True
    return leaves
