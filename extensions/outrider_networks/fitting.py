"""Fit of link settings to a recorded link, and the nearest profile."""

import math
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from bus.numbers import above, below
from outrider_networks.correlation_fit import autocorrelation, with_correlation
from outrider_networks.delay_fit import LONGEST, fit_delay
from outrider_networks.loss_fit import fit_blackouts, fit_loss
from outrider_networks.nearest import ranked_profiles, wait_factor
from outrider_networks.profile_file import settings_toml
from outrider_networks.samples import Sample, drawn_sample, recorded_sample
from sim.channel.recorded import Fates, RecordedLink, recording_of
from sim.compiling.compile import FloatArray

_DELAYS = {"least": 0.0, "median": 0.5, "95 %": 0.95, "99 %": 0.99, "most": 1.0}
"""Reported quantiles of the delay."""
_OUTAGE = 0.2
"""Shortest gap between opportunities that counts as an outage [s]."""
_OUTSTANDING = 4.0
"""Ratio of an outage's length to the 99 % quantile of the gaps."""
_FEWEST, _FEW = 30, 300
"""Numbers of received messages below which a fit is refused, and below which it has a warning."""
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
    nearest: str | None
    """Profile with the smallest factor of those with a similar loss; None: no profile has."""
    profiles: dict[str, float]
    """Factors of all profiles in ascending order."""
    losses: dict[str, float]
    """Expected shares of messages that each profile loses."""
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
        The fit, and the samples `recorded`, `fitted` and `nearest`, the last only if there is a nearest profile.

    Raises:
        ScenarioError: If the file is not a recorded link, or too few messages arrive.
    """
    sample = recorded_sample(recorded, rate=rate, message_bytes=message_bytes)
    _check(recorded.name, sample)
    settings = with_correlation(_rounded(_settings(sample, _outages(recorded))), sample)
    fitted = drawn_sample(settings, sample.interval)
    ranked = ranked_profiles(sample)
    nearest = next((one for one in ranked if one.similar_loss), None)
    delays = np.quantile(sample.arrived, tuple(_DELAYS.values())).tolist()
    factor = wait_factor(sample, fitted)
    notes = list(_notes(recorded, sample, settings))
    if nearest is not None and nearest.factor < factor:
        notes.append(
            f"the profile {nearest.name} is closer ({below(nearest.factor, factor, 3)}) than the fit "
            f"({above(factor, nearest.factor, 3)}): use it, or "
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
        nearest=None if nearest is None else nearest.name,
        profiles={one.name: one.factor for one in ranked},
        losses={one.name: one.lost for one in ranked},
        notes=notes,
        toml=as_toml(settings),
    )
    samples = {"recorded": sample, "fitted": fitted}
    return fit, samples if nearest is None else samples | {"nearest": nearest.sample}


def _check(name: str, sample: Sample) -> None:
    """Check that a recording can be fitted.

    Raises:
        ScenarioError: If too few messages arrive, or all too late.
    """
    received = sample.arrived.size
    if received < _FEWEST:
        what = "message arrives" if received == 1 else "messages arrive"
        raise ScenarioError(
            f"{name}: {received} {what}: too few for a fit; allowed: {_FEWEST} or more, better {_FEW} or more"
        )
    if sample.arrived[0] > LONGEST:
        raise ScenarioError(
            f"{name}: the smallest delay is {above(sample.arrived[0], LONGEST)} s; "
            f"allowed: {LONGEST:g} s or less"
        )


def as_toml(settings: LinkSettings) -> str:
    """Return the fields that differ from a perfect link, as a table of a scenario."""
    return f"[links.detections]    # or commands, operator, radio\n{settings_toml(settings)}"


def _notes(recorded: RecordedLink, sample: Sample, settings: LinkSettings) -> Iterator[str]:
    recording, received = recording_of(recorded), sample.arrived.size
    if received < _FEW:
        yield (
            f"only {received} messages arrive: losses below {300.0 / len(sample.delay):.2g} % do not show, and the "
            f"largest delays are missing; record {_FEW} messages or more"
        )
    r = autocorrelation(sample, 1)
    if r > _CORRELATED and settings.jitter_time == 0.0:
        yield (
            f"consecutive delays are correlated (r = {r:.2f}), but independent ones are closer in their waits: "
            "replay the file if that matters"
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
    """Round to three digits, the precision of a recording; no delay falls out of the recorded ones."""
    symmetric = settings.jitter_shape in ("uniform", "normal")
    up = {"delay", "max_jitter"}
    down = {"jitter"} if symmetric else set[str]()
    found = {
        field: _digits(value, (field in up) - (field in down))
        for field, value in msgspec.to_builtins(settings).items()
    }
    return msgspec.convert(found, LinkSettings)


def _digits(value: Any, direction: int) -> Any:  # noqa: ANN401 - a field's value
    """Round a number to three digits: up (1), down (-1) or to the nearest (0); return any other value."""
    if not isinstance(value, float) or value == 0.0:
        return value
    found = float(f"{value:.3g}")
    if (found - value) * direction < -1e-9 * value:
        found = float(
            f"{value + direction * 0.5 * 10.0 ** (math.floor(math.log10(value)) - 2):.3g}"
        )
    return found


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
    blackouts, rest = fit_blackouts(sample)
    if len(outages):
        lengths = outages[:, 1] - outages[:, 0]
        whole = len(sample.delay) * sample.interval
        between = max(whole - float(lengths.sum()), 1e-3) / len(outages)
        blackouts = {"blackout_length": float(lengths.mean()), "blackout_interval": between}
        rest = _without(sample, outages)
        return msgspec.structs.replace(
            LinkSettings(), **fit_delay(rest.arrived), **blackouts, **fit_loss(rest)
        )
    return msgspec.structs.replace(
        LinkSettings(), **fit_delay(sample.arrived), **blackouts, **fit_loss(rest)
    )
