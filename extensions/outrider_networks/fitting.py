"""Fit of link settings to a recorded link, and the nearest shipped profile.

Delay: for each jitter shape, delay and scale minimize the difference of the logarithms of the quantiles; the best shape
wins. Loss: runs of nearly equal length are random blackouts. The rest is a Gilbert-Elliott chain by maximum likelihood;
a parameter is kept only if it improves Schwarz's criterion (BIC).
"""

import math
from collections.abc import Iterator
from itertools import product
from typing import Any

import msgspec
import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from bus.messages.links import LinkSettings
from bus.numbers import above, below
from bus.profiles import PROFILES
from outrider_networks.profile_file import settings_toml
from outrider_networks.samples import Sample, drawn_sample, recorded_sample
from sim.channel.description import extra_delays
from sim.channel.jitter import SHAPES, jitter_quantile, jitter_share
from sim.channel.recorded import Fates, RecordedLink, recording_of
from sim.compiling.compile import FloatArray, compiled

_LEVELS: FloatArray = 1.0 - 10.0 ** (-3.0 * (np.arange(400, dtype=np.float64) + 0.5) / 400.0)
"""Levels of the compared quantiles, from the smallest to the largest but one in a thousand, spaced by powers of ten."""
_DELAYS = {"least": 0.0, "median": 0.5, "95 %": 0.95, "99 %": 0.99, "most": 1.0}
"""Reported quantiles of the delay."""
_SHORTEST = 1e-3
"""Lower limit of the waits [s]; shorter ones make no difference at a tick."""
_STEADY = 1e-6
"""Spread of the delay below which there is no jitter [s]."""
_OUTAGE = 0.2
"""Shortest gap between opportunities that counts as an outage [s]."""
_OUTSTANDING = 4.0
"""Ratio of an outage's length to the 99 % quantile of the gaps."""
_IN_A_ROW = 3
"""Fewest consecutive losses that count as a blackout."""
_CORRELATED = 0.5


class Fit(msgspec.Struct, frozen=True, kw_only=True):
    """Recorded link and its nearest settings."""

    file: str
    messages: int
    interval: float
    """Time between two messages [s]."""
    lost: float
    """Share of lost messages."""
    longest_burst: float
    """Longest time in which every message was lost [s]."""
    delay: dict[str, float]
    """Smallest, median, 95 %, 99 % and largest delay [s]."""
    settings: LinkSettings
    """Fitted settings."""
    factor: float
    """Mean ratio of the waits over the fitted and the recorded link, over their quantiles; 1 is a perfect fit."""
    nearest: str
    """Shipped profile with the smallest factor."""
    profiles: dict[str, float]
    """Factors of all profiles in ascending order."""
    notes: list[str]
    """Traits of the recorded link that settings cannot reproduce."""
    toml: str
    """Settings in the scenario's format."""


def fit_link(
    recorded: RecordedLink, *, rate: float = 20.0, message_bytes: int = 1000
) -> tuple[Fit, dict[str, Sample]]:
    """Fit link settings to a recorded link.

    Args:
        recorded: The recorded link.
        rate: Message rate over a Mahimahi file [1/s].
        message_bytes: Message size [bytes].

    Returns:
        The fit, and the samples `recorded`, `fitted` and `nearest`.

    Raises:
        ScenarioError: If the file is not a recorded link, or no message arrives.
    """
    sample = recorded_sample(recorded, rate=rate, message_bytes=message_bytes)
    settings = _rounded(_settings(sample, _outages(recorded)))
    drawn = {name: drawn_sample(one, sample.interval) for name, one in PROFILES.items()}
    fitted = drawn_sample(settings, sample.interval)
    factors = {name: wait_factor(sample, one) for name, one in drawn.items()}
    ranked = dict(sorted(factors.items(), key=lambda item: item[1]))
    nearest = next(iter(ranked))
    delays = np.quantile(sample.arrived, tuple(_DELAYS.values())).tolist()
    factor = wait_factor(sample, fitted)
    notes = list(_notes(recorded, sample))
    if ranked[nearest] < factor:
        notes.append(
            f"the profile {nearest} is closer ({below(ranked[nearest], factor, 3)}) than the fit "
            f"({above(factor, ranked[nearest], 3)}): use it, or "
            f'replay the file with trace = "{recorded.name}" under [links.detections]'
        )
    fit = Fit(
        file=recorded.name,
        messages=len(sample.delay),
        interval=sample.interval,
        lost=sample.lost,
        longest_burst=float(sample.bursts.max(initial=0)) * sample.interval,
        delay=dict(zip(_DELAYS, delays, strict=True)),
        settings=settings,
        factor=factor,
        nearest=nearest,
        profiles=ranked,
        notes=notes,
        toml=as_toml(settings),
    )
    return fit, {"recorded": sample, "fitted": fitted, "nearest": drawn[nearest]}


def wait_factor(one: Sample, other: Sample) -> float:
    """Return the mean ratio of the waits over two links, over their quantiles; 1 if they are equal.

    In a logarithmic plot of the waits it is the mean horizontal distance of the curves.
    """
    logs = [_logs(np.quantile(sample.waits, _LEVELS)) for sample in (one, other)]
    return float(np.exp(np.abs(logs[0] - logs[1]).mean()))


def as_toml(settings: LinkSettings) -> str:
    """Return the fields that differ from a perfect link, as a table of a scenario."""
    return f"[links.detections]    # or commands, operator, radio\n{settings_toml(settings)}"


def _notes(recorded: RecordedLink, sample: Sample) -> Iterator[str]:
    recording = recording_of(recorded)
    before, after = sample.delay[:-1], sample.delay[1:]
    both = ~np.isnan(before) & ~np.isnan(after)
    if both.sum() > 2 and before[both].std() > _STEADY and after[both].std() > _STEADY:
        r = float(np.corrcoef(before[both], after[both])[0, 1])
        if r > _CORRELATED:
            yield (
                f"consecutive delays are correlated (r = {r:.2f}), but simulated delays are independent and reorder "
                "messages: replay the file if that matters"
            )
    if isinstance(recording, Fates):
        gaps = np.diff(recording.sent)
        if (
            gaps.size
            and float((np.abs(gaps - sample.interval) > 0.5 * sample.interval).mean()) > 0.01
        ):
            yield f"messages were sent at unequal intervals: the fit uses their median, {sample.interval:g} s"
    else:
        times = recording.times
        capacity = 12.0 * len(times) / float(times[-1])  # 1,500 bytes a line
        yield (
            f"{capacity:.3g} Mbit/s on average; longest time without an opportunity "
            f"{int(np.diff(times).max(initial=0))} ms"
        )


def _rounded(settings: LinkSettings) -> LinkSettings:
    """Round to three digits, the precision of a recording."""
    plain = msgspec.to_builtins(settings)
    return msgspec.convert(
        {
            field: float(f"{value:.3g}") if isinstance(value, float) else value
            for field, value in plain.items()
        },
        LinkSettings,
    )


def _outages(recorded: RecordedLink) -> FloatArray:
    """Return start and end of the outages of a Mahimahi file [s]. Shape (outages, 2)."""
    recording = recording_of(recorded)
    if isinstance(recording, Fates):
        return np.zeros((0, 2))
    times = recording.times / 1000.0
    gaps = np.diff(times)
    long = np.flatnonzero(gaps >= max(_OUTAGE, _OUTSTANDING * float(np.quantile(gaps, 0.99))))
    return np.stack([times[long], times[long + 1]], axis=1)


def _without(sample: Sample, outages: FloatArray) -> Sample:
    """Return the messages without those that an outage delayed or lost.

    Runs of late or lost messages about as long as an outage are removed.
    """
    usual = float(np.median(sample.arrived))
    late = np.isnan(sample.delay) | (sample.delay > usual + 2.0 * sample.interval)
    edges = np.flatnonzero(np.diff(late.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    shortest = 0.5 * float((outages[:, 1] - outages[:, 0]).min())
    kept = np.ones(len(sample.delay), dtype=bool)
    for begin, end in edges.tolist():
        if (end - begin) * sample.interval >= shortest:
            kept[begin:end] = False
    return sample._replace(delay=sample.delay[kept]) if kept.any() else sample


def _settings(sample: Sample, outages: FloatArray) -> LinkSettings:
    blackouts, rest = _blackouts(sample)
    if len(outages):
        lengths = outages[:, 1] - outages[:, 0]
        whole = len(sample.delay) * sample.interval
        between = max(whole - float(lengths.sum()), 1e-3) / len(outages)
        blackouts = {"blackout_length": float(lengths.mean()), "blackout_interval": between}
        rest = _without(sample, outages)
        return msgspec.structs.replace(
            LinkSettings(), **_delay(rest.arrived), **blackouts, **_loss(rest)
        )
    return msgspec.structs.replace(
        LinkSettings(), **_delay(sample.arrived), **blackouts, **_loss(rest)
    )


# Delay


def _delay(arrived: FloatArray) -> dict[str, Any]:
    """Return delay, jitter, jitter shape and its limit."""
    least, most = float(arrived[0]), float(arrived[-1])
    if most - least < _STEADY:
        return {"delay": float(np.median(arrived))}
    wanted = _logs(np.quantile(arrived, _LEVELS))
    mean, deviation = float(arrived.mean()), float(arrived.std())
    starts = {
        "exponential": (least, mean - least),
        "uniform": (0.5 * (least + most), 0.5 * (most - least)),
        "normal": (mean, deviation),
        "pareto": (least, mean - least),
    }
    least_off, best = math.inf, LinkSettings()
    for shape, (delay, scale) in starts.items():
        found = minimize(
            _quantiles_off,
            np.array([delay, math.log(max(scale, _STEADY))]),
            args=(shape, most, wanted),
            method="Nelder-Mead",
            options={"xatol": 1e-6, "fatol": 1e-7, "maxiter": 300},
        )
        if found.fun < least_off:
            least_off, best = found.fun, _jittered(found.x, shape, most)
    if best.jitter < _STEADY:
        return {"delay": float(np.median(arrived))}
    fields = ("delay", "jitter", "jitter_shape", "max_jitter")
    return {field: getattr(best, field) for field in fields}


def _quantiles_off(x: FloatArray, shape: str, most: float, wanted: FloatArray) -> float:
    """Return the mean difference of the quantiles' logarithms; x as in `_jittered`."""
    return float(np.abs(_logs(_quantiles(_jittered(x, shape, most))) - wanted).mean())


def _logs(times: FloatArray) -> FloatArray:
    found: FloatArray = np.log(np.maximum(times, _SHORTEST))
    return found


def _jittered(x: FloatArray, shape: str, most: float) -> LinkSettings:
    """Return settings with this delay and logarithm of the jitter, limited to the largest recorded delay."""
    delay, jitter = min(max(float(x[0]), 0.0), 30.0), min(math.exp(float(x[1])), 10.0)
    cut = 0.0 if shape == "uniform" else min(max(most - delay, 0.01 * jitter), 60.0)
    return LinkSettings(delay=delay, jitter=jitter, jitter_shape=shape, max_jitter=cut)


def _quantiles(settings: LinkSettings) -> FloatArray:
    least, most = extra_delays(settings)
    shape = SHAPES[settings.jitter_shape]
    return settings.delay + _extra_quantiles(shape, settings.jitter, least, most, _LEVELS)


@compiled
def _extra_quantiles(
    shape: int, scale: float, least: float, most: float, levels: FloatArray
) -> FloatArray:
    low, high = jitter_share(shape, scale, least), jitter_share(shape, scale, most)
    found = np.empty_like(levels)
    for k in range(levels.shape[0]):
        extra = jitter_quantile(shape, scale, low + levels[k] * (high - low))
        found[k] = min(max(extra, least), most)
    return found


# Loss


def _blackouts(sample: Sample) -> tuple[dict[str, float], Sample]:
    """Return random blackouts, and the messages without them.

    Runs of losses in a Gilbert-Elliott chain have geometrically distributed lengths; blackouts are of equal length.
    """
    runs = sample.lost_runs
    long = runs[runs[:, 1] - runs[:, 0] >= _IN_A_ROW]
    lengths = long[:, 1] - long[:, 0]
    over = float(lengths.mean()) - _IN_A_ROW if lengths.size else 0.0
    if lengths.size < 3 or over < 2.0 or float(lengths.var()) > 0.25 * over * (1.0 + over):
        return {}, sample
    kept = np.ones(len(sample.delay), dtype=bool)
    for begin, end in long:
        kept[begin:end] = False
    between = float(kept.sum()) * sample.interval / lengths.size
    found = {
        "blackout_length": float(lengths.mean()) * sample.interval,
        "blackout_interval": max(between, 1e-3),
    }
    return found, sample._replace(delay=sample.delay[kept])


@compiled
def _log_likelihood(
    gone: FloatArray, bad_share: float, memory: float, loss: float, burst_loss: float
) -> float:
    """Return the log-likelihood of losses (1) and arrivals (0) under a Gilbert-Elliott chain."""
    in_bad = 1.0 - (1.0 - loss) * (1.0 - burst_loss)
    bad, total = bad_share, 0.0
    for k in range(gone.shape[0]):
        if gone[k] > 0.0:
            in_one, in_other = bad * in_bad, (1.0 - bad) * loss
        else:
            in_one, in_other = bad * (1.0 - in_bad), (1.0 - bad) * (1.0 - loss)
        chance = max(in_one + in_other, 1e-300)
        total += math.log(chance)
        bad = bad_share + memory * (in_one / chance - bad_share)
    return total


def _chain(x: FloatArray, free_loss: bool, free_burst: bool) -> tuple[float, float, float, float]:
    """Return share of the bad state, memory, loss and loss in bursts from log-odds x; fixed ones are 0 or 1."""
    bad, memory, loss, burst = expit(x).tolist()
    return bad, memory, loss if free_loss else 0.0, burst if free_burst else 1.0


def _unlikely(x: FloatArray, gone: FloatArray, free_loss: bool, free_burst: bool) -> float:
    """Return the negative log-likelihood of `_chain`."""
    return -_log_likelihood(gone, *_chain(x, free_loss, free_burst))


def _loss(sample: Sample) -> dict[str, float]:
    """Return loss and bursts; each parameter only if it improves the fit."""
    gone = np.isnan(sample.delay).astype(np.float64)
    share, n = float(gone.mean()), len(gone)
    if share in (0.0, 1.0):
        return {"loss": share}
    chain = (0.0, 0.0, share, 0.0)
    best = _log_likelihood(gone, *chain) - 0.5 * math.log(n)
    memory = min(max(1.0 - 1.0 / float(sample.bursts.mean()), 0.1), 0.999)
    steady = (memory, 0.5 * (1.0 + memory))
    for free_loss, free_burst, start in product((False, True), (False, True), steady):
        at = np.array([0.5 * share, start, 0.5 * share, 0.8])
        found = minimize(
            _unlikely,
            np.log(at / (1.0 - at)),
            args=(gone, free_loss, free_burst),
            method="Nelder-Mead",
            options={"xatol": 1e-3, "fatol": 1e-2, "maxiter": 400},
        )
        price = 0.5 * (2 + free_loss + free_burst) * math.log(n)
        if -found.fun - price > best:
            best, chain = -found.fun - price, _chain(found.x, free_loss, free_burst)
    bad, memory, loss, burst = chain
    if bad == 0.0:
        return {"loss": loss}
    rate = -math.log(memory) / sample.interval  # of both states together [1/s]
    return {
        "loss": loss,
        "burst_length": 1.0 / (rate * (1.0 - bad)),
        "burst_interval": 1.0 / (rate * bad),
        "burst_loss": burst,
    }
