"""The parts of an endpoint, such as `tcp/127.0.0.1:17447`, `tls/[::1]:17447` or `unixsock-stream//run/bus.sock`."""

import socket
from typing import NamedTuple, Self

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""
UNIX = "unixsock-stream"
PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws", UNIX)


class Locator(NamedTuple):
    """An endpoint taken apart, whatever it is worth."""

    protocol: str
    address: str
    """A path for a Unix socket, else host and port."""
    host: str
    """Without brackets; empty where there is no port."""
    port: str

    @classmethod
    def of(cls, endpoint: str) -> Self:
        """The parts of an endpoint."""
        protocol, _, address = endpoint.partition("/")
        host, _, port = address.rpartition(":")
        return cls(protocol, address, host.strip("[]"), port)

    @property
    def is_local(self) -> bool:
        """True if only processes of this machine can reach it."""
        return self.protocol == UNIX or self.host in LOOPBACK

    def listens(self) -> bool:
        """True if somebody accepts connections there."""
        try:
            if self.protocol != UNIX:
                socket.create_connection((self.host, int(self.port)), timeout=1.0).close()
                return True
            with socket.socket(socket.AF_UNIX) as probe:
                probe.settimeout(1.0)
                probe.connect(self.address)
        except (OSError, ValueError):
            return False
        return True
