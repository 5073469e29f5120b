"""Datagrams to and from ground stations and autopilots, as MAVLink messages; what is none is counted."""

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

UNREADABLE = "is no MAVLink message"
_MOST = 500
"""Datagrams that are read at once before anything else is done."""
_LARGEST = 65_535
_QUIET = 30.0
"""A party that has been silent for so long is sent nothing more [s]."""
MOST_PEERS = 16
"""Parties that one socket reaches at most."""


class Address(NamedTuple):
    """An end of a UDP connection."""

    host: str
    port: int


class Peer(NamedTuple):
    """A party of MAVLink's: two behind one address are two."""

    address: Address
    system: int
    component: int

    def __str__(self) -> str:
        return f"{self.system}/{self.component} at {self.address.host}:{self.address.port}"


def parse_address(text: str, *, listens: bool) -> Address:
    """Return host and port of `HOST:PORT`, `udpout:HOST:PORT` or `udpin:HOST:PORT`.

    Args:
        text: As the user has written it.
        listens: True: it is where we listen.

    Raises:
        ScenarioError: If it is none.
    """
    kind = "udpin" if listens else "udpout"
    host, _, port = text.removeprefix(f"{kind}:").partition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        option = "--in" if listens else "--to"
        raise ScenarioError(
            f"{option} {text}: allowed is HOST:PORT, such as 127.0.0.1:14550, or {kind}:HOST:PORT"
        )
    return Address(host, int(port))


def private_port() -> int:
    """Return a random UDP port of this machine that no process listens on.

    Raises:
        BusError: If none is found.
    """
    for _ in range(100):
        port = 20_000 + secrets.randbelow(40_000)
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", port))
            return port
    raise BusError("127.0.0.1: no free UDP port was found")


@dataclass(slots=True)
class _Line:
    """A socket, and whom it reaches: one party, or whoever has spoken to it."""

    socket: socket.socket
    fixed: Address | None
    received: dict[Address, float]

    def reached(self, now: float) -> list[Address]:
        if self.fixed is not None:
            return [self.fixed]
        for address in [one for one, when in self.received.items() if now - when > _QUIET]:
            del self.received[address]
        return list(self.received)

    def admits(self, address: Address, now: float) -> bool:
        """Return whether there is room for the party that has sent something."""
        knows = self.fixed is not None or address in self.received
        if not knows and len(self.reached(now)) >= MOST_PEERS:
            return False
        self.received[address] = now
        return True


def _resolved(address: Address) -> Address:
    try:
        found = socket.getaddrinfo(*address, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise ScenarioError(
            f"{address.host}:{address.port}: {error.strerror or error}; allowed: a host that has an address"
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
    """All the sockets of one process.

    Args:
        out: Addresses that are told without having asked.
        listen: Addresses at which others may ask.

    Raises:
        ScenarioError: If a host has no address.
        BusError: If an address cannot be listened on.
    """

    def __init__(self, out: Iterable[Address] = (), listen: Iterable[Address] = ()) -> None:
        self.unreadable = 0
        """Datagrams, or parts of them, that held no message."""
        self.strangers = 0
        """Datagrams to a socket that reaches one party, from another: nobody reads them."""
        self.sent: Counter[str] = Counter()
        """Messages by type, however many parties each went to."""
        self._lines: list[_Line] = []
        self.turned_away: list[tuple[Peer, MavMessage]] = []
        """Messages of the newest `receive` from parties for which there was no room."""
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
        self._lines.append(_Line(opened, fixed, {}))
        return opened

    def receive(self, patience: float) -> Iterator[tuple[Peer, MavMessage]]:
        """The messages that are there, after a wait of up to `patience` [s] for the first."""
        self.turned_away.clear()
        self._guests.clear()
        sockets = {line.socket: line for line in self._lines}
        ready, _, _ = select.select(list(sockets), [], [], patience)
        for one in ready:
            yield from self._read(sockets[one])

    def _read(self, line: _Line) -> Iterator[tuple[Peer, MavMessage]]:
        for _ in range(_MOST):
            try:
                data, (host, port) = line.socket.recvfrom(_LARGEST)
            except BlockingIOError:
                return
            except OSError:  # nobody listened where we have sent
                continue
            address = Address(host, port)
            if line.fixed not in (None, address):
                self.strangers += 1
                continue
            found = self._parse(data)
            peers = [Peer(address, one.get_srcSystem(), one.get_srcComponent()) for one in found]
            messages = zip(peers, found, strict=True)
            if found and not line.admits(address, time.monotonic()):
                self._guests[address] = line.socket
                self.turned_away += messages
            else:
                yield from messages

    def _parse(self, data: bytes) -> list[MavMessage]:
        """The messages of one datagram: each holds whole ones, so nothing of one can spoil the next."""
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
            packed: Its bytes.
            kind: Its type, which is counted.
            to: To this party alone, also if it was turned away just now; None: to everybody.
        """
        now = time.monotonic()
        self.sent[kind] += 1
        reached = [(line.socket, one) for line in self._lines for one in line.reached(now)]
        for opened, address in (*reached, *((one, who) for who, one in self._guests.items() if to)):
            if to is None or to == address:
                with suppress(OSError):  # a full buffer, or nobody there: as a radio would
                    opened.sendto(packed, address)

    def close(self) -> None:
        """Give back all sockets."""
        for line in self._lines:
            line.socket.close()
