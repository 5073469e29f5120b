"""Links as options of `tc-netem`, the network emulator of Linux."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from bus.messages.links import LinkKind, LinkSettings
from outrider_networks.delay_fit import delay_quantiles
from sim.channel.description import extra_delays, link_parameters, longest_delay
from sim.engine.scenario_links import vehicles_with
from sim.scenario.types import Scenario

_LEVELS = (np.arange(10_000) + 0.5) / 10_000
_BELOW, _ABOVE = 2.0 / 3.0, 4.0
"""Limits of iproute2's table `pareto` below and above its mean, in units of its scale."""


class NetemLine(msgspec.Struct, frozen=True, kw_only=True):
    """Command that makes a network device a link, as closely as netem can."""

    link: str
    """`vehicle/kind`, or the profile's name."""
    rate: float
    """Messages per second on the link [1/s]."""
    command: str | None
    """Command; None: netem cannot express the link."""
    differences: list[str]
    """Traits of the link that the command does not reproduce."""


class _Part(NamedTuple):
    """Options of netem, and what they do not reproduce."""

    options: str
    differences: tuple[str, ...] = ()


def netem_lines(scenario: Scenario, device: str) -> list[NetemLine]:
    """Return one command for each link of a scenario.

    Args:
        scenario: The scenario. Its detections leave at their rate, all other messages once a tick.
        device: Network device of each link.
    """
    lines = []
    for kind in LinkKind:
        period = scenario.detection_period if kind is LinkKind.DETECTIONS else 1
        for vehicle in vehicles_with(scenario, kind):
            settings = scenario.links.of(vehicle, kind)
            rate = 1.0 / (period * scenario.dt)
            lines.append(netem_line(f"{vehicle}/{kind}", settings, rate, device))
    return lines


def netem_line(link: str, settings: LinkSettings, rate: float, device: str) -> NetemLine:
    """Return the command for one link.

    Args:
        link: Name of the link.
        settings: Checked settings.
        rate: Messages per second [1/s].
        device: Network device.
    """
    if settings.trace:
        why = f"trace = {settings.trace!r}: netem replays no recording; fit it first"
        return NetemLine(link=link, rate=rate, command=None, differences=[why])
    parts = [_delay(settings, rate), _loss(settings, rate), *_others(settings, rate)]
    options = " ".join(part.options for part in parts if part.options)
    return NetemLine(
        link=link,
        rate=rate,
        command=f"tc qdisc add dev {device} root netem {options}".rstrip(),
        differences=[why for part in parts for why in part.differences],
    )


def _delay(settings: LinkSettings, rate: float) -> _Part:
    """Return delay and jitter; without a distribution, the kernel draws uniformly from mean - jitter to mean + jitter.

    The table `pareto` has the link's smallest and mean delay.
    """
    if settings.jitter == 0.0:
        return _Part(f"delay {_ms(settings.delay)}" if settings.delay > 0.0 else "")
    correlation, narrower = "", tuple[str, ...]()
    if settings.jitter_time > 0.0:
        correlation = f" {_percent(math.exp(-1.0 / (rate * settings.jitter_time)))}"
        why = (
            f"jitter_time: correlated from one message to the next, right for {rate:g} messages per second; "
            "netem's correlation narrows the distribution"
        )
        narrower = (why,)
    least, most = (settings.delay + extra for extra in extra_delays(settings))
    if settings.jitter_shape == "uniform":
        half = f"{_ms(0.5 * (most - least))}{correlation}"
        return _Part(f"delay {_ms(0.5 * (least + most))} {half}", narrower)
    drawn = delay_quantiles(settings, _LEVELS)
    mean = float(drawn.mean())
    if settings.jitter_shape == "normal":
        scale = float(drawn.std())
        limits = mean - _ABOVE * scale, mean + _ABOVE * scale
        shape, kind = "normal", "same mean and standard deviation"
    else:
        scale = (mean - least) / _BELOW
        limits = least, mean + _ABOVE * scale
        shape, kind = "pareto", "same smallest and mean delay"
    why = (
        f"jitter_shape = {settings.jitter_shape!r}: {kind}, from {_ms(max(limits[0], 0.0))} to {_ms(limits[1])} "
        f"instead of {_ms(least)} to {_ms(most)}"
    )
    options = f"delay {_ms(mean)} {_ms(scale)}{correlation} distribution {shape}"
    return _Part(options, (why, *narrower))


def _loss(settings: LinkSettings, rate: float) -> _Part:
    """Return independent loss, or the Gilbert-Elliott chain from one message to the next."""
    if settings.burst_length == 0.0:
        return _Part(f"loss random {_percent(settings.loss)}" if settings.loss > 0.0 else "")
    chain = link_parameters(settings, 1.0 / rate)
    in_bad = 1.0 - (1.0 - settings.loss) * (1.0 - settings.burst_loss)
    shares = (chain.bad_enter, 1.0 - chain.bad_stay, in_bad, settings.loss)
    why = f"bursts: counted in messages instead of seconds, right for {rate:g} messages per second"
    return _Part(f"loss gemodel {' '.join(map(_percent, shares))}", (why,))


def _others(settings: LinkSettings, rate: float) -> Iterator[_Part]:
    if settings.duplicates > 0.0:
        yield _Part(f"duplicate {_percent(settings.duplicates)}")
    if settings.reorder > 0.0:
        yield _Part(
            "", ("reorder: netem cannot hold messages back; its reorder sends them at once",)
        )
    if settings.blackouts:
        first, length = settings.blackouts[0]
        planned = (
            f"blackouts: {len(settings.blackouts)} planned, the first from {first:g} s on for {length:g} s; "
            "change the loss to 100% by a script"
        )
        yield _Part("", (planned,))
    if settings.blackout_interval > 0.0:
        blackouts = (
            f"blackout_interval: netem has no random blackouts of {settings.blackout_length:g} s "
            f"every {settings.blackout_interval:g} s"
        )
        yield _Part("", (blackouts,))
    if settings.bandwidth > 0.0:
        bits = math.ceil(8.0 * settings.message_bytes * settings.bandwidth)
        flying = math.ceil(longest_delay(settings) * min(rate, settings.bandwidth))
        differences = [
            f"bandwidth: as {settings.message_bytes} bytes a message with all headers (message_bytes)",
            f"queue: limit counts the up to {flying} messages on their way too",
        ]
        if settings.keep == "newest":
            differences.append('keep = "newest": a full queue of netem drops the newest message')
        yield _Part(f"rate {bits}bit limit {settings.queue + flying}", tuple(differences))


def _ms(seconds: float) -> str:
    return f"{1000.0 * seconds:.6g}ms"


def _percent(share: float) -> str:
    return f"{100.0 * share:.6g}%"
