"""Comparison of a recorded link with the profiles."""

from typing import NamedTuple

import numpy as np

from bus.messages.links import LinkSettings
from bus.profiles import PROFILES
from outrider_networks.delay_fit import LEVELS, logs
from outrider_networks.samples import Sample, drawn_sample
from sim.channel.description import link_faults, link_parameters
from sim.channel.gaps import loss_chain

MOST_LOSS_RATIO = 100.0
"""Ratio of losses from which a profile does not describe a recording."""


class Candidate(NamedTuple):
    """Profile compared with a recording."""

    name: str
    factor: float
    """Mean ratio of the waits, see `wait_factor`."""
    lost: float
    """Expected share of lost messages, outside planned blackouts."""
    similar_loss: bool
    """True if the shares of lost messages differ by less than `MOST_LOSS_RATIO`."""
    sample: Sample


def ranked_profiles(recorded: Sample) -> list[Candidate]:
    """Return all valid profiles in ascending order of their factors."""
    found = []
    for name, settings in PROFILES.items():
        if any(link_faults(settings)):
            continue  # a package's
        drawn = drawn_sample(settings, recorded.interval)
        lost = _expected_loss(settings, drawn)
        similar = has_similar_loss(recorded, lost)
        found.append(Candidate(name, wait_factor(recorded, drawn), lost, similar, drawn))
    return sorted(found, key=lambda one: one.factor)


def has_similar_loss(recorded: Sample, lost: float) -> bool:
    """Return whether a share of lost messages differs from the recorded one by a factor below `MOST_LOSS_RATIO`.

    If the recording lost none, half a message is assumed, because it cannot show a smaller share.
    """
    gone, sent = int(np.isnan(recorded.delay).sum()), len(recorded.delay)
    if gone == 0 and lost == 0.0:
        return True
    share = max(gone, 0.5) / sent
    return bool(share / MOST_LOSS_RATIO < lost < share * MOST_LOSS_RATIO)


def _expected_loss(settings: LinkSettings, drawn: Sample) -> float:
    """Return the expected share of lost messages; of a queue's losses, the drawn one."""
    if settings.bandwidth > 0.0:
        return drawn.lost
    chain = loss_chain(link_parameters(settings, drawn.interval))
    return 1.0 - chain.light * float(chain.share @ chain.through)


def wait_factor(one: Sample, other: Sample) -> float:
    """Return the mean ratio of the waits over two links, over their quantiles; 1 if they are equal.

    In a logarithmic plot of the waits it is the mean horizontal distance of the curves.
    """
    ours, theirs = (logs(np.quantile(sample.waits, LEVELS)) for sample in (one, other))
    return float(np.exp(np.abs(ours - theirs).mean()))
