"""Exceedance probabilities of declared link bounds within a run, and the smallest bounds for a risk.

extensions/outrider_networks/README.md explains and proves them, with tables beside frequencies.
"""

import functools
import math
from typing import NamedTuple

from bus.messages.links import LinkSettings
from bus.ticks import ticks_within
from outrider_networks.kinds import commands_run, detections_run
from outrider_networks.link_runs import LinkRun, Probability
from sim.channel.recorded import RecordedLink


class Smallest(NamedTuple):
    """The smallest bound that is exceeded in a run with at most a given probability."""

    value: float | None
    """None: no bound is."""
    why: str
    """Limits of the statement, or why there is no bound."""


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
    """Return the probability that the newest detection that has arrived is older than `age` at some tick of a run.

    Counted from the tick on at which the first detection arrives. Exact for a fixed delay with independent loss,
    Gilbert-Elliott and planned blackouts, and for a recorded table if all looks find something; else a bound.

    Args:
        settings: Detections' link, as `check_link` has returned it.
        dt: Length of a tick [s].
        period_ticks: Ticks from one look of the detector to the next; the first is at tick 0.
        dropout: Share of looks that find nothing, independent of each other.
        ticks: Length of the run.
        age: [s]; whole ticks within it count.
        traces: Recorded links that it may play.
    """
    run = detections_run(settings, dt, period_ticks, dropout, ticks, traces)
    return _probability(run, age, dt)


@functools.lru_cache(maxsize=256)
def outage_exceedance(
    settings: LinkSettings,
    *,
    dt: float,
    delay_ticks: int,
    repeats: int,
    ticks: int,
    outage: float,
    traces: tuple[RecordedLink, ...] = (),
) -> Probability:
    """Return the probability that some motion of a run is followed by the next only after more than `outage`.

    Packet k carries the motions k - repeats + 1 to k; motion j begins at tick j + delay_ticks if one of its packets has
    arrived and the motion before began. If motion s does not, the pilot sees it at tick s + d + 1 and begins a new
    chain with the motion of that number. The rest at the start counts as a motion that begins at tick d - 1. Exact for
    a fixed delay with independent loss, Gilbert-Elliott and planned blackouts, and for a recorded table; else a bound.

    Args:
        settings: Commands' link, as `check_link` has returned it.
        dt: Length of a tick [s].
        delay_ticks: d, from the tick of a motion's packet to the one at which it begins.
        repeats: Packets that carry a motion, the first included.
        ticks: Length of the run.
        outage: [s]; whole ticks within it count.
        traces: Recorded links that it may play.
    """
    run = commands_run(settings, dt, delay_ticks, repeats, ticks, traces)
    return _probability(run, outage, dt)


def _probability(run: LinkRun, bound: float, dt: float) -> Probability:
    if isinstance(run, str):
        return Probability(None, run)
    return run.probability(ticks_within(bound, dt))


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
        risk: Between 0 and 1.
    """
    return _smallest(
        detections_run(settings, dt, period_ticks, dropout, ticks, traces), "age", risk, dt
    )


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
    """Return the smallest outage [s], in whole ticks, that is exceeded with at most the probability `risk`.

    Args:
        settings, dt, delay_ticks, repeats, ticks, traces: See `outage_exceedance`.
        risk: Between 0 and 1.
    """
    return _smallest(
        commands_run(settings, dt, delay_ticks, repeats, ticks, traces), "outage", risk, dt
    )


def _smallest(run: LinkRun, bound: str, risk: float, dt: float) -> Smallest:
    if isinstance(run, str):
        return Smallest(None, run)
    found = run.smallest(risk)
    if found is None:
        length = f"{run.ticks * dt:g} s"
        return Smallest(None, f"no {bound} shorter than the run of {length} is exceeded so rarely")
    return Smallest(round(found * dt, 9), run.why)


def error_exceedance(sigma: float, cut: float, count: int, error: float) -> Probability:
    """Return the probability that the norm of one of `count` errors is larger than `error`.

    Args:
        sigma: Standard deviation per axis [m].
        cut: No norm is larger than this many deviations; infinite: no cut.
        count: Number of errors.
        error: [m]
    """
    if sigma == 0.0 or error >= sigma * cut * (1.0 - 1e-9):
        return Probability(0.0, "")
    beyond = math.exp(-0.5 * cut * cut)
    larger = (math.exp(-0.5 * (error / sigma) ** 2) - beyond) / (1.0 - beyond)
    if larger >= 1.0:
        return Probability(1.0, "")
    return Probability(-math.expm1(count * math.log1p(-larger)), "")


def smallest_error(sigma: float, cut: float, count: int, risk: float) -> float:
    r"""Return the error [m] that `count` errors exceed with at most the probability `risk`; with a cut the cut.

    The norm of a normal vector exceeds ε with the probability exp(-ε²/(2σ²)), so that
    $$ \epsilon = \sigma \sqrt{-2 \ln(1 - (1 - \text{risk})^{1/\text{count}})} $$

    Args:
        sigma, cut, count: See `error_exceedance`.
        risk: Between 0 and 1.
    """
    if sigma == 0.0 or math.isfinite(cut):
        return sigma * cut if sigma > 0.0 else 0.0
    larger = -math.expm1(math.log1p(-risk) / max(count, 1))
    return sigma * math.sqrt(-2.0 * math.log(larger))
