"""Named radio links: presets for scenarios, commands and the operator's page, and profiles of other packages.

They are values of a message, so that a vehicle's process, which must not import links, can list them in its help texts.
The numbers are rounded from commonly published values for each kind of link, one way, for small messages; none is
fitted to one measurement. docs/how-to/network.md gives the sources and compares the profiles with an independent
simulator. Delays shorter than a tick arrive at the next tick: at dt = 0.05 s a good Wi-Fi is a link of one tick.

An installed package adds profiles by an entry point `outrider.profiles`: a dict like `SHIPPED`.
"""

import re
from collections.abc import Mapping
from types import MappingProxyType

import msgspec

from bus import plugins
from bus.errors import OutriderError
from bus.messages.links import LinkSettings

SHIPPED: Mapping[str, LinkSettings] = {
    # No delay, no loss.
    "perfect": LinkSettings(),
    # A good 802.11 link in line of sight: a few ms, a tail from retransmissions, short fades; the remaining loss is a
    # few per thousand.
    "wifi": LinkSettings(
        delay=0.003,
        jitter=0.003,
        jitter_shape="exponential",
        max_jitter=0.1,
        loss=0.002,
        burst_length=0.05,
        burst_interval=10.0,
        burst_loss=0.5,
        duplicates=0.0005,
    ),
    # Wi-Fi at the edge of its range or in a busy channel: a heavy tail up to half a second, a few percent lost, fades
    # of 0.3 s every few seconds, duplicates from lost acknowledgements.
    "wifi-poor": LinkSettings(
        delay=0.01,
        jitter=0.03,
        jitter_shape="pareto",
        max_jitter=0.5,
        loss=0.03,
        burst_length=0.3,
        burst_interval=4.0,
        burst_loss=0.9,
        duplicates=0.005,
        reorder=0.005,
        reorder_delay=0.05,
    ),
    # A public 4G network: round trips of 50 to 80 ms, so 25 ms and more one way; the radio layer retransmits until
    # little is lost; a handover interrupts for some tens of ms, here once a minute.
    "lte": LinkSettings(
        delay=0.025,
        jitter=0.01,
        jitter_shape="exponential",
        max_jitter=0.3,
        loss=0.001,
        blackout_interval=60.0,
        blackout_length=0.1,
    ),
    # A geostationary satellite: 240 to 270 ms up and down at the speed of light, the rest is processing; rare fades.
    "satellite": LinkSettings(
        delay=0.28,
        jitter=0.01,
        jitter_shape="normal",
        max_jitter=0.05,
        loss=0.003,
        burst_length=1.0,
        burst_interval=120.0,
        burst_loss=0.5,
    ),
    # LoRa-like: 13 bytes at spreading factor 9 and 125 kHz take 165 ms on the air (Semtech AN1200.13), 300 ms with
    # protocol overhead. Two messages a second is generous: a legal duty cycle of 1 % would allow one in 16 s.
    "narrowband": LinkSettings(
        delay=0.3,
        jitter=0.05,
        loss=0.02,
        bandwidth=2.0,
        queue=2,
        keep="newest",
    ),
    # A jammer that disturbs half a second in two and a half, and sometimes whole seconds. Invented, not measured.
    "jammed": LinkSettings(
        delay=0.02,
        jitter=0.02,
        jitter_shape="exponential",
        loss=0.05,
        burst_length=0.5,
        burst_interval=2.0,
        burst_loss=0.95,
        blackout_interval=20.0,
        blackout_length=2.0,
    ),
}
"""Link settings of the shipped profiles by name."""
NAME_RULE = "up to 32 of a-z, 0-9, '_' and '-', the first a letter"
"""Form of a profile's name."""


def is_profile_name(text: object) -> bool:
    """Return true if a profile may have this name."""
    return isinstance(text, str) and re.fullmatch(r"[a-z][a-z0-9_-]{0,31}", text) is not None


def _checked(
    given: Mapping[object, object], taken: Mapping[str, LinkSettings]
) -> dict[str, LinkSettings]:
    """Return the profiles of a package.

    Raises:
        ValueError: If a name or the settings of a profile are invalid.
    """
    found: dict[str, LinkSettings] = {}
    for name, settings in given.items():
        if not isinstance(name, str) or not is_profile_name(name):
            raise ValueError(f"profile {name!r}: wrong form of the name; allowed: {NAME_RULE}")
        if name in taken:
            raise ValueError(f"profile {name!r}: the name is taken")
        if not isinstance(settings, LinkSettings):
            raise ValueError(f"profile {name!r}: is not a LinkSettings")
        try:
            found[name] = msgspec.convert(msgspec.to_builtins(settings), LinkSettings)
        except (msgspec.ValidationError, TypeError) as error:
            raise ValueError(f"profile {name!r}: {error}") from error
        if settings.trace:
            raise ValueError(f"profile {name!r}: names a trace; allowed: all other settings")
    return found


def _with_packages() -> Mapping[str, LinkSettings]:
    """Return all profiles by name, also of other packages; skip invalid ones, with a warning."""
    table = dict(SHIPPED)
    for entry, given in plugins.load_all("profiles", dict).items():
        try:
            with plugins.foreign():
                table |= _checked(given, table)
        except OutriderError as error:
            plugins.ignore_named("profiles", entry, error)
    return MappingProxyType(table)


PROFILES = _with_packages()
"""Link settings by name of the profile, the shipped ones first."""
