"""The messages of MAVLink's common dialect, by pymavlink: an extra, which is missed in one line."""

from typing import Any

from bus.plugins import needs

with needs("mavlink"):
    from pymavlink.dialects.v20 import common as mavlink

__all__ = ["MavMessage", "mavlink", "packed"]

MavMessage = Any
"""A message of pymavlink's, which has no types."""


def packed(message: MavMessage, sender: Any) -> bytes:  # noqa: ANN401 - pymavlink's MAVLink, likewise
    """The bytes of a message, numbered among those of its sender."""
    data = bytes(message.pack(sender))
    sender.seq = (sender.seq + 1) % 256
    return data
