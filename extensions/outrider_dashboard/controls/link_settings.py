"""Settings of the radio links: short descriptions, and commands that change them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import msgspec

from bus.messages.control import Action, Control
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.telemetry import Status
from bus.profiles import PROFILES

ALL = "all"
"""Choice of all kinds of links, or of all vehicles."""
_MAX_PAST_BLACKOUTS = 50
"""Maximum number of past blackouts in the settings of a link."""
_BURST_INTERVAL = 5.0
"""Default time between two bursts [s]."""

_Describe = Callable[[LinkSettings], str]
_PHRASES: tuple[tuple[tuple[str, ...], _Describe], ...] = (
    (("delay",), lambda s: f"delay {s.delay:g} s"),
    (("jitter", "jitter_shape", "max_jitter", "jitter_time"), lambda s: f"jitter {s.jitter:g} s"),
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
            f"blackouts {s.blackout_length:g} s every {s.blackout_interval:g} s"
            if s.blackout_interval
            else "no blackouts"
        ),
    ),
    (("duplicates",), lambda s: f"duplicates {100 * s.duplicates:.3g} %"),
    (("reorder", "reorder_delay"), lambda s: f"reordered {100 * s.reorder:.3g} %"),
    (
        ("bandwidth", "queue", "keep"),
        lambda s: f"{s.bandwidth:g} messages/s" if s.bandwidth else "unlimited rate",
    ),
    (("trace", "message_bytes"), lambda s: f"trace {s.trace}" if s.trace else "no trace"),
)
"""Groups of fields and their description; the others have no effect if the first is zero."""


@lru_cache(maxsize=1000)
def describe(settings: LinkSettings) -> str:
    """Return a short description: the closest profile and the differences from it.

    Planned blackouts are not included.
    """
    found = {name: _differences(settings, profile) for name, profile in PROFILES.items()}
    name = min(found, key=lambda name: len(found[name]) + (name != "perfect"))
    differences = found[name]
    return ", ".join(differences if name == "perfect" and differences else [name, *differences])


def _differences(settings: LinkSettings, profile: LinkSettings) -> list[str]:
    found = []
    for fields, describe_group in _PHRASES:
        ours, theirs = ([getattr(one, field) for field in fields] for one in (settings, profile))
        if ours != theirs and (ours[0] or theirs[0]):
            found.append(describe_group(settings))
    return found


def describe_links(status: Status) -> dict[str, Any]:
    """Return the descriptions of the links' settings.

    `of` has one for each link, `changes` one for each change of the status (empty unless it changed a link).
    """
    return {
        "of": {
            name: describe(link.settings)
            for name, link in status.links.items()
            if link.settings is not None
        },
        "changes": [
            "" if change.control.settings is None else describe(change.control.settings)
            for change in status.changes
        ],
    }


# Commands


def select_links(names: Iterable[str], kind: str, vehicle: str) -> list[str]:
    """Return the names of the links of a kind and a vehicle, or of all."""
    parts = {name: name.split("/") for name in names}
    return [
        name
        for name, (owner, what) in parts.items()
        if kind in (ALL, what) and vehicle in (ALL, owner)
    ]


def controls_for(wanted: Mapping[str, LinkSettings], names: Sequence[str]) -> list[Control]:
    """Return the controls that set the links: a single one for a kind whose links all get the same settings."""
    controls = []
    for kind in LinkKind:
        owned = select_links(names, kind, ALL)
        settings = {name: wanted[name] for name in owned if name in wanted}
        if len(settings) == len(owned) and len(set(settings.values())) == 1:
            controls.append(Control(action=Action.LINK, link=kind, settings=settings[owned[0]]))
            continue
        controls += [
            Control(action=Action.LINK, link=kind, vehicle=name.split("/")[0], settings=one)
            for name, one in settings.items()
        ]
    return controls


def with_blackout(settings: LinkSettings, now: float, length: float) -> LinkSettings:
    """Return the settings with one more planned blackout.

    The oldest of many past blackouts are dropped.

    Args:
        settings: Settings of a link.
        now: Start of the blackout [s].
        length: Its length [s].
    """
    over = [row for row in settings.blackouts if sum(row) <= now]
    kept = [row for row in settings.blackouts if sum(row) > now]
    return msgspec.structs.replace(
        settings, blackouts=(*over[-_MAX_PAST_BLACKOUTS:], *kept, (round(now, 4), length))
    )


def with_field(settings: LinkSettings, field: str, value: float) -> LinkSettings:
    """Return the settings with a new value in a field; a burst length also sets a missing burst interval."""
    changed = {field: value}
    if field == "burst_length" and value > 0.0 and settings.burst_interval == 0.0:
        changed["burst_interval"] = _BURST_INTERVAL
    return msgspec.structs.replace(settings, **changed)
