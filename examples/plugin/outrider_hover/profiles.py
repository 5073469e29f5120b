"""Network profile of this package, for `--network mesh`."""

from bus.messages.links import LinkSettings

PROFILES = {
    "mesh": LinkSettings(delay=0.015, jitter=0.01, jitter_shape="exponential", loss=0.01),
}
