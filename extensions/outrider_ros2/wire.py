"""The wire format of rmw_zenoh: keys of topics, tokens of the graph, quality of service, attachments.

As in ros2/rmw_zenoh, `docs/design.md` and `rmw_zenoh_cpp/src/detail/liveliness_utils.cpp`. Distributions from Jazzy on
carry the type's hash in the key; Humble writes `TypeHashNotSupported` there, and its nodes are refused and counted.
"""

import re
import struct
from dataclasses import dataclass
from enum import StrEnum

from bus.errors import ScenarioError
from outrider_ros2.roles import PILOT

GRAPH = "@ros2_lv"
"""First part of every liveliness token of the graph."""
MOST_DOMAIN = 232
"""The largest domain id that ROS 2 has."""
_DEFAULT_DEPTH = 42
"""Of the history in rmw_zenoh: what a token leaves out."""
_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
_PART = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class Endpoint(StrEnum):
    """The kinds of entities of the graph, as tokens call them."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"


@dataclass(frozen=True, slots=True, kw_only=True)
class Qos:
    """Quality of service of a topic."""

    reliable: bool = True
    transient_local: bool = False
    """True: who comes late is given the newest messages."""
    depth: int = 10
    """Messages that are kept."""

    def encoded(self) -> str:
        """As a token has it: reliability, durability, history and depth; defaults are left empty."""
        depth = "" if self.depth == _DEFAULT_DEPTH else str(self.depth)
        return (
            f"{'' if self.reliable else '2'}:{'1' if self.transient_local else ''}:,{depth}:,:,:,,"
        )

    def in_words(self) -> str:
        """For a table."""
        durability = ", transient local" if self.transient_local else ""
        return f"{'reliable' if self.reliable else 'best effort'}{durability}, depth {self.depth}"


RELIABLE = Qos()
NEWEST = Qos(depth=1)
SENSOR = Qos(reliable=False, depth=5)
"""ROS 2's profile for sensor data."""
CLOCK = Qos(reliable=False, depth=1)
LATCHED = Qos(transient_local=True, depth=1)
"""For what stays as it is: maps, static transforms, markers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One ROS 2 node on a Zenoh session."""

    domain: int
    zid: str
    """Zenoh id of its session."""
    name: str
    namespace: str = "/"

    def token(self, kind: Endpoint = Endpoint.NODE, number: int = 0) -> str:
        """The liveliness token that shows the node in the graph; it is number 0 of its session."""
        return (
            f"{GRAPH}/{self.domain}/{self.zid}/0/{number}/{kind}"
            f"/%/{mangled(self.namespace)}/{self.name}"
        )

    def endpoint_token(self, kind: Endpoint, number: int, topic: "WireTopic", qos: Qos) -> str:
        """The liveliness token that shows a publisher, subscription or service in the graph.

        Args:
            kind: Of the endpoint.
            number: Among the nodes and endpoints of the session.
            topic: What it writes or reads.
            qos: Its quality of service.
        """
        return (
            f"{self.token(kind, number)}"
            f"/{mangled(topic.name)}/{dds_type(topic.interface)}/{topic.hash}/{qos.encoded()}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class WireTopic:
    """A topic or service with its type, as it travels."""

    name: str
    """Absolute, such as `/uav_0/odom`."""
    interface: str
    """Its type, such as `nav_msgs/msg/Odometry`."""
    hash: str
    """RIHS01 hash of the type."""

    def key(self, domain: int) -> str:
        """The key of its messages."""
        return f"{domain}/{self.name.strip('/')}/{dds_type(self.interface)}/{self.hash}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """The attachment of each message."""

    sequence: int
    """Counted from 1 by each endpoint."""
    time: int
    """Wall time at the source [ns]."""
    gid: bytes
    """Identity of the endpoint, 16 bytes."""

    def encoded(self) -> bytes:
        """33 bytes, little-endian."""
        return _ATTACHMENT.pack(self.sequence, self.time, _GID_BYTES, self.gid)

    @classmethod
    def decoded(cls, raw: bytes) -> "Attachment | None":
        """The attachment in these bytes; None if they are none."""
        if len(raw) != _ATTACHMENT.size:
            return None
        sequence, source_time, length, gid = _ATTACHMENT.unpack(raw)
        if length != _GID_BYTES:
            return None
        return cls(sequence=sequence, time=source_time, gid=gid)


def gid_of(token: str) -> bytes:
    """The identity of an endpoint: XXH3-128 of its token, the low 64 bits first."""
    import xxhash  # noqa: PLC0415 - of the extra

    both = xxhash.xxh3_128_intdigest(token.encode())
    return (both & (2**64 - 1)).to_bytes(8, "little") + (both >> 64).to_bytes(8, "little")


def mangled(name: str) -> str:
    """A name as one part of a token; the empty one is `%`."""
    return name.replace("/", "%") or "%"


def dds_type(name: str) -> str:
    """`std_msgs/msg/String` as keys call it, `std_msgs::msg::dds_::String_`."""
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


def check_domain(domain: int) -> int:
    """The domain id, if it is one.

    Raises:
        ScenarioError: If it is not.
    """
    if not 0 <= domain <= MOST_DOMAIN:
        raise ScenarioError(f"--domain {domain}: allowed are 0 to {MOST_DOMAIN}")
    return domain


def check_namespace(namespace: str) -> str:
    """The namespace, absolute and without a slash at its end; the empty one is the root's.

    Raises:
        ScenarioError: If it cannot be one, or vehicles would take its topics for their own.
    """
    parts = [part for part in namespace.split("/") if part]
    for part in parts:
        if not _PART.fullmatch(part) or "__" in part or part == PILOT:
            raise ScenarioError(
                f"--namespace {namespace!r}: allowed are letters, digits and single '_', first no digit, "
                f"with '/' between parts, none of them {PILOT!r}"
            )
    return "".join(f"/{part}" for part in parts)
