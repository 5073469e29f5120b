"""MAVLink messages in UDP datagrams to and from ground stations and autopilots."""

import secrets
import select
import socket
import struct
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from bus.errors import BusError, OutriderError, ScenarioError
from outrider_mavlink.dialect import MavMessage, mavlink

UNREADABLE = "is not a MAVLink message"
_MAX_BATCH = 500
"""Maximum number of datagrams read in one batch."""
_LARGEST = 65_535
_PEER_TIMEOUT = 30.0
"""Time without a message after which a peer receives nothing more [s]."""
MAX_PEERS = 16
"""Maximum number of peers of one socket."""


class Address(NamedTuple):
    """UDP endpoint."""

    host: str
    port: int


class Peer(NamedTuple):
    """MAVLink component at an address; several components may share one address."""

    address: Address
    system: int
    component: int

    def __str__(self) -> str:
        return f"{self.system}/{self.component} at {self.address.host}:{self.address.port}"


def parse_address(text: str, *, listens: bool) -> Address:
    """Return host and port of `HOST:PORT`, `udpout:HOST:PORT` or `udpin:HOST:PORT`.

    Args:
        text: Address as entered by the user.
        listens: True for an address to listen on.

    Raises:
        ScenarioError: If the address is invalid.
    """
    kind = "udpin" if listens else "udpout"
    host, _, port = text.removeprefix(f"{kind}:").partition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        option = "--in" if listens else "--to"
        raise ScenarioError(
            f"{option} {text}: invalid address; allowed: HOST:PORT, such as 127.0.0.1:14550, or {kind}:HOST:PORT"
        )
    return Address(host, int(port))


def private_port() -> int:
    """Return a random unused UDP port of this machine.

    Raises:
        BusError: If no unused port is found.
    """
    for _ in range(100):
        port = 20_000 + secrets.randbelow(40_000)
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", port))
            return port
    raise BusError("127.0.0.1: no free UDP port")


@dataclass(slots=True)
class _Link:
    """Socket with a fixed peer, or with all peers that have sent to it."""

    socket: socket.socket
    fixed: Address | None
    received: dict[Address, float]

    def reached(self, now: float) -> list[Address]:
        if self.fixed is not None:
            return [self.fixed]
        for address in [one for one, when in self.received.items() if now - when > _PEER_TIMEOUT]:
            del self.received[address]
        return list(self.received)

    def admits(self, address: Address, now: float) -> bool:
        """Return True, and register the sender, unless the socket has too many peers."""
        knows = self.fixed is not None or address in self.received
        if not knows and len(self.reached(now)) >= MAX_PEERS:
            return False
        self.received[address] = now
        return True


def _resolved(address: Address) -> Address:
    try:
        found = socket.getaddrinfo(*address, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise ScenarioError(
            f"{address.host}:{address.port}: {error.strerror or error}; allowed: a host name with an IPv4 address"
        ) from error
    return Address(*found[0][4][:2])


def _bind(opened: socket.socket, address: Address) -> None:
    where = _resolved(address)
    try:
        opened.bind(where)
    except OSError as error:
        raise BusError(
            f"cannot listen on {address.host}:{address.port}: {error.strerror or error}"
        ) from error


class Network:
    """UDP sockets of one process.

    Args:
        out: Addresses to send to.
        listen: Addresses to listen on.

    Raises:
        ScenarioError: If a host has no address.
        BusError: If the process cannot listen on an address.
    """

    def __init__(self, out: Iterable[Address] = (), listen: Iterable[Address] = ()) -> None:
        self.unreadable = 0
        """Number of datagrams, or parts of them, without a valid message."""
        self.strangers = 0
        """Number of discarded datagrams from an address other than the socket's fixed peer."""
        self.sent: Counter[str] = Counter()
        """Number of messages sent, by type; a message to several peers counts once."""
        self._links: list[_Link] = []
        self.turned_away: list[tuple[Peer, MavMessage]] = []
        """Messages of the latest `receive` from peers beyond the maximum."""
        self._guests: dict[Address, socket.socket] = {}
        try:
            for address in out:
                self._open(_resolved(address))
            for address in listen:
                _bind(self._open(None), address)
        except OutriderError:
            self.close()
            raise

    def _open(self, fixed: Address | None) -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setblocking(False)
        self._links.append(_Link(opened, fixed, {}))
        return opened

    def receive(self, patience: float) -> Iterator[tuple[Peer, MavMessage]]:
        """Yield the received messages; wait up to `patience` [s] for the first one."""
        self.turned_away.clear()
        self._guests.clear()
        sockets = {link.socket: link for link in self._links}
        ready, _, _ = select.select(list(sockets), [], [], patience)
        for one in ready:
            yield from self._read(sockets[one])

    def _read(self, link: _Link) -> Iterator[tuple[Peer, MavMessage]]:
        for _ in range(_MAX_BATCH):
            try:
                data, (host, port) = link.socket.recvfrom(_LARGEST)
            except BlockingIOError:
                return
            except OSError:  # an earlier datagram reached no listener
                continue
            address = Address(host, port)
            if link.fixed not in (None, address):
                self.strangers += 1
                continue
            found = self._parse(data)
            peers = [Peer(address, one.get_srcSystem(), one.get_srcComponent()) for one in found]
            messages = zip(peers, found, strict=True)
            if found and not link.admits(address, time.monotonic()):
                self._guests[address] = link.socket
                self.turned_away += messages
            else:
                yield from messages

    def _parse(self, data: bytes) -> list[MavMessage]:
        """Return the messages of one datagram; a new parser prevents damage to later datagrams."""
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        try:
            found = parser.parse_buffer(data) or []
        except (mavlink.MAVError, struct.error, ValueError, IndexError):
            self.unreadable += 1
            return []
        good = [one for one in found if one.get_type() != "BAD_DATA"]
        self.unreadable += len(found) - len(good) + (parser.buf_len() > 0)
        return good

    def send(self, packed: bytes, kind: str, to: Address | None = None) -> None:
        """Send a packed message.

        Args:
            packed: Bytes of the message.
            kind: Type of the message, for the counters.
            to: Single receiver, possibly one just turned away; None: all peers.
        """
        now = time.monotonic()
        self.sent[kind] += 1
        reached = [(link.socket, one) for link in self._links for one in link.reached(now)]
        for opened, address in (*reached, *((one, who) for who, one in self._guests.items() if to)):
            if to is None or to == address:
                with suppress(
                    OSError
                ):  # a full buffer or a missing receiver loses the message, as on a radio
                    opened.sendto(packed, address)

    def close(self) -> None:
        """Close all sockets."""
        for link in self._links:
            link.socket.close()
