"""Endpoints and their parts, such as `tcp/127.0.0.1:17447`, `tls/[::1]:17447` or `unixsock-stream//run/bus.sock`."""

import os
import re
import socket
import sys
from typing import NamedTuple, Self

from bus.errors import ScenarioError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine can reach."""
UNIX = "unixsock-stream"
PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws", UNIX)
LONGEST_SOCKET_PATH = 107 if sys.platform == "linux" else 103
"""Maximum length of a Unix socket's path [bytes], given by the operating system."""
_OPTIONS = re.compile("[?#]")
"""Characters at which Zenoh ends the path of an endpoint, also of a Unix socket."""
_INET = re.compile(r"(\[[^\[\]]+\]|[^\[\]:]+):([0-9]{1,5})")
_LAST_PORT = 65535
_WILDCARDS = ("0.0.0.0", "::")  # noqa: S104 - compared, not bound


class Locator(NamedTuple):
    """Parts of an endpoint, not checked."""

    protocol: str
    address: str
    """Path of a Unix socket, else host and port."""
    host: str
    """Host without brackets; empty if there is no port."""
    port: str

    @classmethod
    def of(cls, endpoint: str) -> Self:
        """Return the parts of an endpoint."""
        protocol, _, rest = endpoint.partition("/")
        address = rest if protocol == UNIX else _OPTIONS.split(rest, maxsplit=1)[0]
        host, _, port = address.rpartition(":")
        return cls(protocol, address, host.strip("[]"), port)

    @property
    def is_local(self) -> bool:
        """True if only processes on this machine can reach it."""
        return self.protocol == UNIX or self.host in LOOPBACK

    def listens(self) -> bool:
        """True if a process accepts connections at the endpoint."""
        return not self.connection_fault()

    def connection_fault(self) -> str:
        """Return why no connection to it can be opened; empty if one can."""
        try:
            if self.protocol != UNIX:
                socket.create_connection((self.host, int(self.port)), timeout=1.0).close()
                return ""
            with socket.socket(socket.AF_UNIX) as probe:
                probe.settimeout(1.0)
                probe.connect(self.address)
        except (OSError, ValueError) as error:
            return getattr(error, "strerror", None) or str(error)
        return ""

    def syntax_fault(self) -> str:
        """Return the syntax error and what is allowed; empty if the syntax is valid."""
        if self.protocol not in PROTOCOLS:
            return f"unknown protocol; allowed: {', '.join(PROTOCOLS)}, as in tcp/127.0.0.1:17447"
        if self.protocol == UNIX:
            return _path_fault(self.address)
        parts = _INET.fullmatch(self.address)
        if parts is None:
            wrong = "not a host and a port"
            if self.address.count(":") > 1 and "[" not in self.address:
                wrong = "an IPv6 address without brackets"
            elif ":" not in self.address:
                wrong = "has no port"
            return f"{wrong}; allowed: {self.protocol}/HOST:PORT or {self.protocol}/[IPV6-ADDRESS]:PORT"
        if not 0 < int(parts[2]) <= _LAST_PORT:
            return f"port {parts[2]}; allowed: 1 to {_LAST_PORT}"
        return ""


def _path_fault(path: str) -> str:
    if not path:
        return f"has no file; allowed: {UNIX}/ and a path"
    if _OPTIONS.search(path):
        return "Zenoh ends a path at '#' and '?'; allowed: a path without them"
    if len(os.fsencode(path)) > LONGEST_SOCKET_PATH:
        return f"too long for a socket; allowed: a path of {LONGEST_SOCKET_PATH} bytes at most"
    return ""


def check_endpoint(endpoint: str) -> Locator:
    """Check an endpoint and return its parts.

    A name server that does not respond is not an error: it may respond later.

    Raises:
        ScenarioError: If it is not an endpoint, or its host has no address.
    """
    found = Locator.of(endpoint)
    fault = found.syntax_fault()
    if not fault and found.protocol != UNIX:
        try:
            socket.getaddrinfo(found.host, int(found.port))
        except socket.gaierror as error:
            if error.errno != socket.EAI_AGAIN:
                fault = (
                    f"host {found.host!r}: {error.strerror}; allowed: a host that has an address"
                )
        except UnicodeError:
            fault = f"host {found.host!r}: not a host's name; allowed: a name or an address"
    if fault:
        raise ScenarioError(f"endpoint {endpoint!r}: {fault}")
    return found


def reachable(endpoint: str) -> str:
    """Return the endpoint with which other machines reach a listener: a wildcard address becomes this host's name."""
    found = Locator.of(endpoint)
    if found.protocol == UNIX or found.host not in _WILDCARDS:
        return endpoint
    return f"{found.protocol}/{socket.gethostname()}:{found.port}"
