"""Recording of a link, as named on the command line."""

from pathlib import Path
from typing import NamedTuple


class Source(NamedTuple):
    """Recording to fit, with the options of its format."""

    file: Path
    """Mahimahi file, CSV table, folder of a rosbag2, or capture at the sender."""
    received: Path | None = None
    """Capture at the receiver."""
    topic: str = ""
    """Topic in a bag; empty: the only one with headers."""
    port: int | None = None
    """UDP port to which the messages in a capture are sent; None: the only flow."""
    rate: float | None = None
    """Message rate over a Mahimahi file [1/s]."""
    message_bytes: int | None = None
    """Message size over a Mahimahi file [bytes]."""
