"""The radio links as the page sees them.

How each is set, in a few words, and what is to be said to set it otherwise.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import msgspec

from bus.messages.control import Action, Control
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.telemetry import Status
from bus.profiles import PROFILES

ALL = "all"
"""Stands for every kind, and for every vehicle."""
_PAST = 50
"""Blackouts that are over are kept up to so many."""
_EVERY = 5.0
"""Time between bursts that were asked for without one [s]."""

_Say = Callable[[LinkSettings], str]
_PHRASES: tuple[tuple[tuple[str, ...], _Say], ...] = (
    (("delay",), lambda s: f"delay {s.delay:g} s"),
    (("jitter", "jitter_shape", "max_jitter"), lambda s: f"jitter {s.jitter:g} s"),
    (("loss",), lambda s: f"loss {100 * s.loss:.3g} %"),
    (
        ("burst_length", "burst_interval", "burst_loss"),
        lambda s: (
            f"bursts {s.burst_length:g} s every {s.burst_interval:g} s"
            if s.burst_length
            else "no bursts"
        ),
    ),
    (
        ("blackout_interval", "blackout_length"),
        lambda s: (
            f"dark {s.blackout_length:g} s every {s.blackout_interval:g} s"
            if s.blackout_interval
            else "none dark"
        ),
    ),
    (("duplicates",), lambda s: f"doubled {100 * s.duplicates:.3g} %"),
    (("reorder", "reorder_delay"), lambda s: f"held back {100 * s.reorder:.3g} %"),
    (
        ("bandwidth", "queue", "keep"),
        lambda s: f"{s.bandwidth:g} messages/s" if s.bandwidth else "any rate",
    ),
    (("trace", "message_bytes"), lambda s: f"plays {s.trace}" if s.trace else "nothing played"),
)
"""Fields that belong together, of which the first says whether the others count, and what is said of them."""


@lru_cache(maxsize=1000)
def words(settings: LinkSettings) -> str:
    """The settings in a few words: the nearest profile and what differs from it, or what is not perfect.

    No planned blackouts.
    """
    said = {name: _differences(settings, profile) for name, profile in PROFILES.items()}
    name = min(said, key=lambda name: len(said[name]) + (name != "perfect"))
    differences = said[name]
    return ", ".join(differences if name == "perfect" and differences else [name, *differences])


def _differences(settings: LinkSettings, profile: LinkSettings) -> list[str]:
    found = []
    for fields, say in _PHRASES:
        ours, theirs = ([getattr(one, field) for field in fields] for one in (settings, profile))
        if ours != theirs and (ours[0] or theirs[0]):
            found.append(say(settings))
    return found


def said_of_links(status: Status) -> dict[str, Any]:
    """The links' settings in words.

    `of` each link, and of each of the `changes` that is one of links ("" of others).
    """
    return {
        "of": {
            name: words(link.settings)
            for name, link in status.links.items()
            if link.settings is not None
        },
        "changes": [
            "" if change.control.settings is None else words(change.control.settings)
            for change in status.changes
        ],
    }


# What becomes of a wish


def chosen(names: Iterable[str], kind: str, vehicle: str) -> list[str]:
    """The links of a kind and a vehicle, or of all."""
    parts = {name: name.split("/") for name in names}
    return [
        name
        for name, (owner, what) in parts.items()
        if kind in (ALL, what) and vehicle in (ALL, owner)
    ]


def controls_for(wanted: Mapping[str, LinkSettings], names: Sequence[str]) -> list[Control]:
    """The controls that give links their settings: one for a kind where all of it gets the same."""
    controls = []
    for kind in LinkKind:
        owned = chosen(names, kind, ALL)
        settings = {name: wanted[name] for name in owned if name in wanted}
        if len(settings) == len(owned) and len(set(settings.values())) == 1:
            controls.append(Control(action=Action.LINK, link=kind, settings=settings[owned[0]]))
            continue
        controls += [
            Control(action=Action.LINK, link=kind, vehicle=name.split("/")[0], settings=one)
            for name, one in settings.items()
        ]
    return controls


def darkened(settings: LinkSettings, now: float, length: float) -> LinkSettings:
    """The settings with one more planned blackout.

    Of those that are over, the oldest are dropped where they are many.
    """
    over = [row for row in settings.blackouts if sum(row) <= now]
    kept = [row for row in settings.blackouts if sum(row) > now]
    return msgspec.structs.replace(
        settings, blackouts=(*over[-_PAST:], *kept, (round(now, 4), length))
    )


def with_field(settings: LinkSettings, field: str, value: float) -> LinkSettings:
    """The settings with another value in a field; bursts come with a time between them."""
    changed = {field: value}
    if field == "burst_length" and value > 0.0 and settings.burst_interval == 0.0:
        changed["burst_interval"] = _EVERY
    return msgspec.structs.replace(settings, **changed)
