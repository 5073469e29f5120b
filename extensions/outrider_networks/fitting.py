"""The settings of a drawn link that come nearest to a recorded one, and the nearest of the shipped profiles.

Delay: for each shape of the jitter the delay and scale whose quantiles differ least from those recorded, in their
logarithms, then the best shape. Loss: runs of nearly one length are random blackouts; the rest is a chain of Gilbert
and Elliott by maximum likelihood, of which a part is only taken where it pays by Schwarz's criterion (BIC).
"""

import math
from collections.abc import Iterator
from itertools import product
from typing import Any

import msgspec
import numpy as np

from bus.messages.links import LinkSettings
from bus.profiles import PROFILES
from outrider_networks.samples import Sample, drawn_sample, recorded_sample
from sim.channel.description import extra_delays
from sim.channel.jitter import SHAPES, jitter_quantile, jitter_share
from sim.channel.recorded import Fates, RecordedLink, recording_of
from sim.compiling.compile import FloatArray, compiled

_LEVELS: FloatArray = 1.0 - 10.0 ** (-3.0 * (np.arange(400, dtype=np.float64) + 0.5) / 400.0)
"""Shares at which quantiles are compared: from the least to the longest but one in a thousand, each power of ten alike.
"""
_DELAYS = {"least": 0.0, "median": 0.5, "95 %": 0.95, "99 %": 0.99, "most": 1.0}
"""Quantiles of the delay that a fit tells."""
_SHORTEST = 1e-3
"""Waits that are shorter count as this long [s]: no tick notices them."""
_STEADY = 1e-6
"""Delays that differ by less than this have no jitter [s]."""
_OUTAGE = 0.2
"""Shorter gaps between opportunities are no outage [s]."""
_OUTSTANDING = 4.0
"""An outage is so many times longer than all but one gap in a hundred."""
_IN_A_ROW = 3
"""Fewer messages lost in a row are no blackout."""
_CORRELATED = 0.5


class Fit(msgspec.Struct, frozen=True, kw_only=True):
    """A recorded link and what comes nearest to it."""

    file: str
    messages: int
    interval: float
    """Between two messages [s]."""
    lost: float
    """Share of the messages."""
    longest_burst: float
    """Time in which every message was lost, at most [s]."""
    delay: dict[str, float]
    """Least, median, 95 %, 99 % and largest [s]."""
    settings: LinkSettings
    """The best that were found."""
    factor: float
    """By which waits over that link differ from those recorded, on average over their quantiles; 1: not at all."""
    nearest: str
    """The shipped profile whose factor is least."""
    profiles: dict[str, float]
    """Factors of all profiles, the nearest first."""
    notes: list[str]
    """The traits of the recorded link that cannot be drawn."""
    toml: str
    """The settings as a scenario writes them."""


def fit_link(
    recorded: RecordedLink, *, rate: float = 20.0, message_bytes: int = 1000
) -> tuple[Fit, dict[str, Sample]]:
    """Fit a link to a recorded one.

    Args:
        recorded: The recorded link.
        rate: Messages a second, over a Mahimahi file.
        message_bytes: Their size.

    Returns:
        The fit, and the messages of which it is made: `recorded`, `fitted` and `nearest`.

    Raises:
        ScenarioError: If it is no recorded link, or nothing arrives over it.
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
            f"the profile {nearest} comes nearer ({ranked[nearest]:.2f}) than the fit ({factor:.2f}): use it or "
            f'play the file itself, with trace = "{recorded.name}" under [links.detections]'
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
    """By which factor the waits over two links differ, as the geometric mean over their quantiles; 1: not at all.

    In the picture of the waits, both axes logarithmic, it is the mean distance of the curves to the right.
    """
    logs = [_logs(np.quantile(sample.waits, _LEVELS)) for sample in (one, other)]
    return float(np.exp(np.abs(logs[0] - logs[1]).mean()))


def as_toml(settings: LinkSettings) -> str:
    """The fields that differ from a perfect link, as a scenario writes them."""
    lines = [
        f"{field} = {msgspec.json.encode(value).decode()}"
        for field, value in settings.changes().items()
    ]
    return "\n".join(["[links.detections]    # or commands, operator, radio", *lines])


def _notes(recorded: RecordedLink, sample: Sample) -> Iterator[str]:
    recording = recording_of(recorded)
    before, after = sample.delay[:-1], sample.delay[1:]
    both = ~np.isnan(before) & ~np.isnan(after)
    if both.sum() > 2 and before[both].std() > _STEADY and after[both].std() > _STEADY:
        r = float(np.corrcoef(before[both], after[both])[0, 1])
        if r > _CORRELATED:
            yield (
                f"neighbouring delays are alike (r = {r:.2f}); drawn ones are independent, so that messages overtake "
                "each other: play the file itself where that matters"
            )
    if isinstance(recording, Fates):
        gaps = np.diff(recording.sent)
        if (
            gaps.size
            and float((np.abs(gaps - sample.interval) > 0.5 * sample.interval).mean()) > 0.01
        ):
            yield f"messages were not sent at equal times; {sample.interval:g} s, the median, is taken for all"
    else:
        times = recording.times
        capacity = 12.0 * len(times) / float(times[-1])  # 1,500 bytes a line
        yield (
            f"{capacity:.3g} Mbit/s on average; longest time without an opportunity "
            f"{int(np.diff(times).max(initial=0))} ms"
        )


def _rounded(settings: LinkSettings) -> LinkSettings:
    """Numbers with three digits: more would say more than any recording knows."""
    plain = msgspec.to_builtins(settings)
    return msgspec.convert(
        {
            field: float(f"{value:.3g}") if isinstance(value, float) else value
            for field, value in plain.items()
        },
        LinkSettings,
    )


def _outages(recorded: RecordedLink) -> FloatArray:
    """Return begin and end of the outages of a Mahimahi file [s]: gaps between opportunities. Shape (outages, 2)."""
    recording = recording_of(recorded)
    if isinstance(recording, Fates):
        return np.zeros((0, 2))
    times = recording.times / 1000.0
    gaps = np.diff(times)
    long = np.flatnonzero(gaps >= max(_OUTAGE, _OUTSTANDING * float(np.quantile(gaps, 0.99))))
    return np.stack([times[long], times[long + 1]], axis=1)


def _without(sample: Sample, outages: FloatArray) -> Sample:
    """Return the messages that no outage delayed or lost: runs of such messages, about as long as an outage, go."""
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
    dark, rest = _blackouts(sample)
    if len(outages):
        lengths = outages[:, 1] - outages[:, 0]
        whole = len(sample.delay) * sample.interval
        between = max(whole - float(lengths.sum()), 1e-3) / len(outages)
        dark = {"blackout_length": float(lengths.mean()), "blackout_interval": between}
        rest = _without(sample, outages)
        return msgspec.structs.replace(
            LinkSettings(), **_delay(rest.arrived), **dark, **_loss(rest)
        )
    return msgspec.structs.replace(LinkSettings(), **_delay(sample.arrived), **dark, **_loss(rest))


# Delay


def _delay(arrived: FloatArray) -> dict[str, Any]:
    """Delay, jitter, its shape and its cut."""
    from scipy.optimize import minimize  # noqa: PLC0415 - slow to load

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
    """The mean distance of the quantiles' logarithms from those wanted; x as in `_jittered`."""
    return float(np.abs(_logs(_quantiles(_jittered(x, shape, most))) - wanted).mean())


def _logs(times: FloatArray) -> FloatArray:
    found: FloatArray = np.log(np.maximum(times, _SHORTEST))
    return found


def _jittered(x: FloatArray, shape: str, most: float) -> LinkSettings:
    """The settings with this delay and this logarithm of the jitter, cut at the largest delay that was seen."""
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
    """Random blackouts, and the messages without them.

    Runs of lost messages in a chain of Gilbert and Elliott have lengths that scatter like a geometric law's; those
    of blackouts are all alike.
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
    """Of which messages were lost (1) and which not (0), under a chain of Gilbert and Elliott."""
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
    """Share of the bad state, memory, loss and loss in bursts, whose log-odds are x; what is not free is 0 or 1."""
    from scipy.special import expit  # noqa: PLC0415 - slow to load

    bad, memory, loss, burst = expit(x).tolist()
    return bad, memory, loss if free_loss else 0.0, burst if free_burst else 1.0


def _unlikely(x: FloatArray, gone: FloatArray, free_loss: bool, free_burst: bool) -> float:
    """The negative logarithm of the likelihood of `_chain`."""
    return -_log_likelihood(gone, *_chain(x, free_loss, free_burst))


def _loss(sample: Sample) -> dict[str, float]:
    """Loss and bursts; a part only where it pays."""
    from scipy.optimize import minimize  # noqa: PLC0415 - slow to load

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
