"""Every error that Outrider raises on purpose, split by who must act."""


class OutriderError(Exception):
    """Base of all errors below; its text is one line for a person."""


class ScenarioError(OutriderError):
    """The scenario must be mended by the person who wrote it.

    The text names the file, the field, its value and what is allowed.
    """


class BusError(OutriderError):
    """Something between the processes failed."""


class AccessDenied(BusError):
    """A role used a key that the key table does not give it; nothing was sent."""


class PeerLost(BusError):
    """Another process did not come, or went away; the text names it."""
