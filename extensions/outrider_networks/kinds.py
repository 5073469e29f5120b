"""Detections and commands over one link and one run: schedules, windows and queues."""

import functools
import math
from collections.abc import Iterator

import numpy as np

from bus.messages.links import LinkSettings
from bus.ticks import TICK_TOLERANCE, first_tick_from
from outrider_networks.automaton import Plan, Window, endless_window, window_of
from outrider_networks.link_runs import MOST_CELLS, SUMMED, DrawnRun, LinkRun, RecordedRun
from outrider_networks.recorded_positions import (
    delays_by_position,
    intervals_by_position,
    oldest_by_position,
    undetected_by_position,
)
from sim.channel.description import link_parameters
from sim.channel.gaps import Mask, age_window, command_window, loss_chain, shares_by_delay
from sim.channel.link_records import OPPORTUNITIES, LinkParameters
from sim.channel.recorded import RecordedLink
from sim.compiling.compile import FloatArray

_MAHIMAHI = "its Mahimahi trace makes the queue depend on every earlier message"
_LONG = "the trace is too long to be evaluated from each start position"
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
    """Return the link run of the detections' ages, with one detection every `period` ticks."""
    parameters = link_parameters(settings, dt, traces=traces)
    if settings.trace:
        return _recorded_ages(parameters, period, dropout, ticks)
    left, by_delay = _left(parameters, ticks), shares_by_delay(parameters)
    reasons = _reasons(parameters, by_delay)
    sent = np.arange(ticks) % period == 0
    queued = parameters.spacing > period + TICK_TOLERANCE
    soonest = _soonest(parameters, by_delay)
    plan = Plan(
        functools.partial(_age_window, by_delay, soonest, 0),
        lambda _: endless_window(ticks),
        ((1.0, sent & left),),
        sent,
    )
    plans: tuple[Plan, ...] = (plan,)
    if queued:
        plans = tuple(_queued(plan, parameters, by_delay, period, dropout, left))
        reasons.append("detections queue for the bandwidth")
        if not plans:
            return "missed detections let the queue run empty"
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
    """Return the link run of the command intervals, with one packet per tick."""
    parameters = link_parameters(settings, dt, traces=traces)
    if settings.trace:
        return _recorded_intervals(parameters, delay, repeats, ticks)
    if parameters.spacing > 1.0 + TICK_TOLERANCE:
        return "the bandwidth is below the packet rate, so that trajectories queue and are dropped"
    left, by_delay = _left(parameters, ticks), shares_by_delay(parameters)
    window = functools.partial(_interval_window, by_delay, delay, repeats)
    plan = Plan(window, window, ((1.0, left),), np.ones(ticks, dtype=bool))
    why = _because(_reasons(parameters, by_delay[: delay + 1]))
    regular = bool(left.all())
    return DrawnRun(loss_chain(parameters), (plan,), ticks, regular, why, ticks - delay)


def _left(parameters: LinkParameters, ticks: int) -> Mask:
    """Return the ticks at which a message leaves outside planned blackouts."""
    left = np.ones(ticks, dtype=bool)
    for first, after in parameters.blackouts.tolist():
        left[first:after] = False
    return left


def _reasons(parameters: LinkParameters, by_delay: FloatArray) -> list[str]:
    """Return the reasons why the result is an upper bound."""
    reasons = []
    if len(set(by_delay.tolist()) - {0.0}) > 1:
        reasons.append("delays vary")
    if parameters.memory > 0.0:
        reasons.append("delays are correlated, so that the longest is assumed for each message")
    if parameters.up > 0.0:
        reasons.append("blackouts are random")
    return reasons


def _because(reasons: list[str]) -> str:
    return f"{SUMMED}: {', '.join(reasons)}" if reasons else ""


def _soonest(parameters: LinkParameters, by_delay: FloatArray) -> int:
    """Return the delay before which no message arrives [ticks]."""
    if parameters.memory == 0.0:
        return int(np.flatnonzero(by_delay)[0])
    return first_tick_from(parameters.settings.delay + parameters.least, parameters.dt)


def _age_window(by_delay: FloatArray, soonest: int, waited: int, age: int) -> Window:
    """Return the window for an age, with a queuing time before departure [ticks]."""
    fails = max(age - waited + 1, soonest)
    return window_of(age_window(age, waited), by_delay, fails)


def _interval_window(by_delay: FloatArray, delay: int, repeats: int, interval: int) -> Window:
    return window_of(command_window(delay, repeats, interval), by_delay, delay + interval)


def _not_evaluated(parameters: LinkParameters, ticks: int) -> str:
    """Return why a trace cannot be evaluated; empty if it can."""
    if parameters.replay == OPPORTUNITIES:
        return _MAHIMAHI
    return _LONG if parameters.period * max(ticks, parameters.longest) > MOST_CELLS else ""


def _recorded_ages(
    parameters: LinkParameters, period: int, dropout: float, ticks: int
) -> RecordedRun | str:
    if why := _not_evaluated(parameters, ticks):
        return why
    delays, left = delays_by_position(parameters), _left(parameters, ticks)
    if dropout == 0.0:
        oldest = oldest_by_position(delays, left, period)
        return RecordedRun(lambda age: (oldest > age).astype(float), ticks, "", ticks - 1)

    @functools.lru_cache(maxsize=64)
    def exceeded(age: int) -> FloatArray:
        return np.minimum(1.0, undetected_by_position(delays, left, period, dropout, age))

    return RecordedRun(exceeded, ticks, _because(["detections are missed at random"]), ticks - 1)


def _recorded_intervals(
    parameters: LinkParameters, delay: int, repeats: int, ticks: int
) -> RecordedRun | str:
    if why := _not_evaluated(parameters, ticks):
        return why
    waits = intervals_by_position(
        delays_by_position(parameters), _left(parameters, ticks), delay, repeats
    )
    return RecordedRun(lambda interval: (waits > interval).astype(float), ticks, "", ticks - delay)


def _queued(
    plan: Plan,
    parameters: LinkParameters,
    by_delay: FloatArray,
    period: int,
    dropout: float,
    left: Mask,
) -> Iterator[Plan]:
    """Yield bounds for a bandwidth below the detector's rate.

    A sender that is never idle transmits one message every 1/bandwidth, from the first successful detection. It is
    never idle if misses + 1 detection periods fit between two messages, and no more than `misses` detections in a row
    fail; the probability of longer failures is added. If the queue keeps the newest, a departing message is at most
    queue (misses + 1) periods old, because queued ones are among the last `queue` successful detections. If the queue
    keeps the oldest, it waited for at most `queue` others.
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
                1.0 if len(begins) == 1 else (1.0 - dropout) * dropout**miss,
                _slots(parameters, miss * period, ticks) & left,
            )
            for miss in begins
        )
        yield plan._replace(
            window=functools.partial(_age_window, by_delay, _soonest(parameters, by_delay), waited),
            schedules=schedules,
            regular=_slots(parameters, 0, ticks),
            extra=extra,
        )
        if extra < _NEVER:
            return


def _slots(parameters: LinkParameters, first: int, ticks: int) -> Mask:
    """Return the ticks at which a sender that is busy from tick `first` transmits."""
    leaves = np.zeros(ticks, dtype=bool)
    at = np.ceil(
        first
        + np.arange(math.ceil(ticks / parameters.spacing)) * parameters.spacing
        - TICK_TOLERANCE
    ).astype(int)
    leaves[at[at < ticks]] = True
    return leaves
