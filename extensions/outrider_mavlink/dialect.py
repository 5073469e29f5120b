"""Messages of MAVLink's common dialect, from the optional package pymavlink."""

from typing import Any

from bus.plugins import needs

with needs("mavlink"):
    from pymavlink.dialects.v20 import common as mavlink

__all__ = ["MavMessage", "mavlink", "packed"]

MavMessage = Any
"""Message of pymavlink, which is untyped."""


def packed(message: MavMessage, sender: Any) -> bytes:  # noqa: ANN401 - pymavlink's MAVLink, untyped
    """Return the bytes of a message with the next sequence number of its sender."""
    data = bytes(message.pack(sender))
    sender.seq = (sender.seq + 1) % 256
    return data
