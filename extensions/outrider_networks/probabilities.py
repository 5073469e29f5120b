"""Exceedance probabilities of declared link bounds within a run, and the smallest bounds for a risk.

extensions/outrider_networks/README.md explains and proves them, and compares them with simulated frequencies.
"""

import functools
import math
from typing import NamedTuple

from bus.messages.links import LinkSettings
from bus.ticks import ticks_within
from outrider_networks.kinds import commands_run, detections_run
from outrider_networks.link_runs import LinkRun, Probability
from sim.channel.recorded import RecordedLink
from sim.models.detection import error_share


class Smallest(NamedTuple):
    """Smallest bound that a run exceeds with at most a given probability."""

    value: float | None
    """Bound; None if there is none."""
    why: str
    """Limits of the statement, or the reason why there is no bound."""


@functools.lru_cache(maxsize=256)
def age_exceedance(
    settings: LinkSettings,
    *,
    dt: float,
    period_ticks: int,
    dropout: float,
    ticks: int,
    age: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Probability:
    """Return the probability that the newest detection becomes older than `age` within a run.

    The age counts from the arrival of the first detection. The result is exact for a fixed delay with independent loss,
    Gilbert-Elliott loss and planned blackouts, and for a recorded table without missed detections. Otherwise it is an
    upper bound.

    Args:
        settings: Link of the detections, returned by `check_link`.
        dt: Length of a tick [s].
        period_ticks: Ticks between two detections; the first is at tick 0.
        dropout: Share of missed detections, independent of each other.
        ticks: Length of the run [ticks].
        age: Bound [s], rounded down to ticks.
        traces: Recorded links available for replay.
    """
    run = detections_run(settings, dt, period_ticks, dropout, ticks, traces)
    return _probability(run, age, dt)


@functools.lru_cache(maxsize=256)
def command_interval_exceedance(
    settings: LinkSettings,
    *,
    dt: float,
    delay_ticks: int,
    repeats: int,
    ticks: int,
    max_command_interval: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Probability:
    """Return the probability that a run exceeds the command interval `max_command_interval`.

    The command interval is the time from the start of one trajectory to the start of the next. Packet k carries the
    trajectories k - repeats + 1 to k. Trajectory j starts at tick j + delay_ticks if one of its packets has arrived and
    the previous trajectory started. If trajectory s does not start, the pilot detects it at tick s + d + 1 and begins a
    new chain with the trajectory of that number. The rest at the start counts as a trajectory that starts at tick d -
    1. The result is exact for a fixed delay with independent loss, Gilbert-Elliott loss and planned blackouts, and for
    a recorded table. Otherwise it is an upper bound.

    Args:
        settings: Link of the commands, returned by `check_link`.
        dt: Length of a tick [s].
        delay_ticks: Time d from a trajectory's first packet to its start [ticks].
        repeats: Packets that carry a trajectory, the first included.
        ticks: Length of the run [ticks].
        max_command_interval: Bound [s], rounded down to ticks.
        traces: Recorded links available for replay.
    """
    run = commands_run(settings, dt, delay_ticks, repeats, ticks, traces)
    return _probability(run, max_command_interval, dt)


def _probability(run: LinkRun, bound: float, dt: float) -> Probability:
    if isinstance(run, str):
        return Probability(None, run)
    return run.probability(ticks_within(bound, dt))


@functools.lru_cache(maxsize=1024)
def keeps_age(
    settings: LinkSettings,
    *,
    dt: float,
    period_ticks: int,
    dropout: float,
    ticks: int,
    age: float,
    risk: float,
    traces: tuple[RecordedLink, ...] = (),
) -> bool:
    """Return whether `age_exceedance` is at most `risk`, much faster than by its value; arguments as there."""
    run = detections_run(settings, dt, period_ticks, dropout, ticks, traces)
    return not isinstance(run, str) and run.keeps(ticks_within(age, dt), risk)


@functools.lru_cache(maxsize=1024)
def keeps_command_interval(
    settings: LinkSettings,
    *,
    dt: float,
    delay_ticks: int,
    repeats: int,
    ticks: int,
    max_command_interval: float,
    risk: float,
    traces: tuple[RecordedLink, ...] = (),
) -> bool:
    """Return whether `command_interval_exceedance` is at most `risk`, much faster than by its value."""
    run = commands_run(settings, dt, delay_ticks, repeats, ticks, traces)
    return not isinstance(run, str) and run.keeps(ticks_within(max_command_interval, dt), risk)


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
    """Return the smallest age [s], in whole ticks, that is exceeded with at most the probability `risk`.

    Args:
        settings, dt, period_ticks, dropout, ticks, traces: See `age_exceedance`.
        risk: Probability, between 0 and 1.
    """
    return _smallest(
        detections_run(settings, dt, period_ticks, dropout, ticks, traces), "age", risk, dt
    )


@functools.lru_cache(maxsize=64)
def smallest_command_interval(
    settings: LinkSettings,
    *,
    dt: float,
    delay_ticks: int,
    repeats: int,
    ticks: int,
    risk: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Smallest:
    """Return the smallest command interval [s], in whole ticks, exceeded with at most the probability `risk`.

    Args:
        settings, dt, delay_ticks, repeats, ticks, traces: See `command_interval_exceedance`.
        risk: Probability, between 0 and 1.
    """
    return _smallest(
        commands_run(settings, dt, delay_ticks, repeats, ticks, traces),
        "command interval",
        risk,
        dt,
    )


def _smallest(run: LinkRun, bound: str, risk: float, dt: float) -> Smallest:
    if isinstance(run, str):
        return Smallest(None, run)
    found = run.smallest(risk)
    if found is None:
        length = f"{run.ticks * dt:g} s"
        return Smallest(None, f"every {bound} up to the run's {length} is exceeded more often")
    return Smallest(round(found * dt, 9), run.why)


def error_exceedance(sigma: float, cut: float, count: int, error: float) -> Probability:
    """Return the probability that the norm of one of `count` errors exceeds `error`.

    Args:
        sigma: Standard deviation per axis [m].
        cut: Truncation of the norm, in standard deviations; may be infinite.
        count: Number of errors.
        error: Bound on the norm [m].
    """
    larger = error_share(sigma, cut, error)
    if larger >= 1.0:
        return Probability(1.0, "")
    return Probability(-math.expm1(count * math.log1p(-larger)), "")


def smallest_error(sigma: float, cut: float, count: int, risk: float) -> float:
    r"""Return the error [m] that `count` errors exceed with at most probability `risk`; the truncation if finite.

    The norm of a normal vector exceeds ε with the probability exp(-ε²/(2σ²)), so that
    $$ \epsilon = \sigma \sqrt{-2 \ln(1 - (1 - \text{risk})^{1/\text{count}})} $$

    Args:
        sigma, cut, count: See `error_exceedance`.
        risk: Probability, between 0 and 1.
    """
    if sigma == 0.0 or math.isfinite(cut):
        return sigma * cut if sigma > 0.0 else 0.0
    larger = -math.expm1(math.log1p(-risk) / max(count, 1))
    return sigma * math.sqrt(-2.0 * math.log(larger))
