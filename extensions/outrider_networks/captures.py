"""Delays of a UDP flow from two captures: at the sender and at the receiver.

A datagram is recognized by its payload. If payloads repeat, the identification of its IPv4 header is compared too.
Neither addresses nor ports are compared, because routers may translate them (NAT).
"""

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bus.errors import ScenarioError
from bus.files import open_regular
from bus.plugins import needs
from outrider_networks.message_times import MessageTimes
from sim.channel.recorded import MOST_LINES
from sim.input.faults import one_line

with needs("networks"):
    import dpkt

_RULE = "a pcap or pcapng file with Ethernet, Linux cooked or raw IP packets"
_MOST_BYTES = 4 << 30
_MOST_REPEATED = 0.01
"""Largest share of datagrams that may be left out because another one is equal."""
_LINKS = {
    dpkt.pcap.DLT_EN10MB: dpkt.ethernet.Ethernet,
    dpkt.pcap.DLT_LINUX_SLL: dpkt.sll.SLL,
    dpkt.pcap.DLT_LINUX_SLL2: dpkt.sll2.SLL2,
    dpkt.pcap.DLT_NULL: dpkt.loopback.Loopback,
}
"""Classes of the packets by the type of link."""
_RAW = (12, 14, 101)
"""Types of link whose packets begin with the IP header."""


class _Datagram(NamedTuple):
    """UDP datagram in a capture."""

    time: float
    """Time of the capture [s]."""
    flow: tuple[bytes, int, bytes, int]
    """Address and port of the sender and of the receiver."""
    identification: int
    """Identification in the IPv4 header; 0 for IPv6."""
    digest: bytes
    """Digest of the payload."""


def capture_times(sent: Path, received: Path, port: int | None) -> MessageTimes:
    """Return the datagrams of one UDP flow.

    Those sent before the first or after the last one that arrives are left out: one of the captures may have started
    later or ended sooner.

    Args:
        sent: Capture at the sender.
        received: Capture at the receiver.
        port: Port to which the datagrams are sent; None: the sender's capture has one flow only.

    Raises:
        ScenarioError: If a capture cannot be read, or the flow or its datagrams are ambiguous.
    """
    flow = _only_flow([one for one in _datagrams(sent) if port in (None, one.flow[3])], sent, port)
    keys = [(one.digest,) for one in flow]
    with_number = len(set(keys)) < len(keys)
    counts = Counter(_key(one, with_number) for one in flow)
    unique = [one for one in flow if counts[_key(one, with_number)] == 1]
    repeated = len(flow) - len(unique)
    if repeated > _MOST_REPEATED * len(flow):
        raise ScenarioError(
            f"{one_line(str(sent))}: {repeated:,} of {len(flow):,} datagrams are equal to another one; "
            "allowed: payloads with a counter or a time"
        )
    arrived: dict[tuple[object, ...], float] = {}
    for one in _datagrams(received):
        arrived.setdefault(_key(one, with_number), one.time)
    times = np.array([one.time for one in unique])
    delays = np.array([arrived.get(_key(one, with_number), np.nan) for one in unique]) - times
    matched = np.flatnonzero(~np.isnan(delays))
    if not matched.size:
        raise ScenarioError(
            f"{one_line(str(received))}: none of the {len(unique):,} datagrams of "
            f"{one_line(str(sent))} is in it; allowed: captures of the same flow"
        )
    kept = slice(int(matched[0]), int(matched[-1]) + 1)
    notes = [
        "delays are the receiver's capture times minus the sender's: an offset of the two clocks is part of them"
    ]
    if repeated:
        notes.append(f"{repeated} datagrams are left out, as others are equal")
    order = np.argsort(times[kept], kind="stable")
    return MessageTimes(times[kept][order], delays[kept][order], tuple(notes))


def _key(one: _Datagram, with_number: bool) -> tuple[object, ...]:
    return (one.digest, one.identification) if with_number else (one.digest,)


def _only_flow(found: list[_Datagram], file: Path, port: int | None) -> list[_Datagram]:
    """Return the datagrams, after checking that they are one flow."""
    name = one_line(str(file))
    if not found:
        what = "UDP datagram" if port is None else f"UDP datagram to port {port}"
        raise ScenarioError(
            f"{name}: no {what}; allowed: a capture of the messages at their sender"
        )
    flows = Counter(one.flow for one in found)
    if len(flows) > 1:
        ports = sorted({flow[3] for flow in flows})
        allowed = f"--port with one of {', '.join(map(str, ports[:10]))}"
        if len(ports) == 1:
            allowed = "a capture with one sender and one receiver at this port"
        raise ScenarioError(f"{name}: {len(flows)} UDP flows; allowed: {allowed}")
    return found


def _datagrams(file: Path) -> Iterator[_Datagram]:
    """Yield the UDP datagrams of a capture.

    Raises:
        ScenarioError: If it is not a capture, or its packets are cut or fragmented.
    """
    name = one_line(str(file))
    try:
        with open_regular(file, _MOST_BYTES) as opened:
            reader = dpkt.pcap.UniversalReader(opened)
            link = reader.datalink()
            if link not in _LINKS and link not in _RAW:
                raise ScenarioError(f"{name}: packets of link type {link}; allowed: {_RULE}")
            yield from _udp(reader, link, name)
    except (dpkt.Error, ValueError, ArithmeticError) as error:
        if isinstance(error, ScenarioError):
            raise
        reason = one_line(str(error)) or "damaged"
        raise ScenarioError(f"{name}: cannot be read: {reason}; allowed: {_RULE}") from error
    except OSError as error:
        reason = one_line(str(error.strerror or error))
        raise ScenarioError(f"{name}: cannot be read: {reason}; allowed: {_RULE}") from error


def _udp(reader: Iterable[tuple[float, bytes]], link: int, name: str) -> Iterator[_Datagram]:
    """Yield the UDP datagrams of an open capture, up to an incomplete end: tcpdump may have been killed."""
    count, cut = 0, ""
    packets = iter(reader)
    while count <= MOST_LINES:
        try:
            time, data = next(packets)
        except StopIteration:
            return
        except dpkt.NeedData:
            if count == 0:
                raise
            return
        if cut:
            raise ScenarioError(f"{name}: {cut}; allowed: a capture of whole packets")
        datagram = _datagram_in(_network_packet(link, data), name)
        if datagram is None:
            continue
        packet, udp = datagram
        payload = bytes(udp.data)
        if len(payload) < udp.ulen - 8:
            cut = f"a datagram of {udp.ulen - 8} bytes is cut to {len(payload)}"
            continue
        count += 1
        yield _Datagram(
            time=float(time),
            flow=(bytes(packet.src), int(udp.sport), bytes(packet.dst), int(udp.dport)),
            identification=int(getattr(packet, "id", 0)),
            digest=hashlib.blake2b(payload, digest_size=16).digest(),
        )
    raise ScenarioError(f"{name}: more than {MOST_LINES:,} datagrams; allowed: a shorter capture")


def _network_packet(link: int, data: bytes) -> object:
    """Return the IP packet in a frame; anything else for other protocols, or damaged frames."""
    try:
        if link in _RAW:
            return (dpkt.ip6.IP6 if data[:1] and data[0] >> 4 == 6 else dpkt.ip.IP)(data)
        found: object = _LINKS[link](data).data
    except (dpkt.UnpackError, ValueError, IndexError):
        return None
    return found


def _datagram_in(packet: object, name: str) -> tuple[Any, Any] | None:
    """Return an IP packet and the UDP datagram in it; None if there is none."""
    if not isinstance(packet, dpkt.ip.IP | dpkt.ip6.IP6):
        return None
    fragments = isinstance(packet, dpkt.ip.IP) and packet.p == dpkt.ip.IP_PROTO_UDP
    if fragments and (packet.mf or packet.offset):
        raise ScenarioError(
            f"{name}: a fragmented datagram; allowed: datagrams that fit into a packet"
        )
    return (packet, packet.data) if isinstance(packet.data, dpkt.udp.UDP) else None
