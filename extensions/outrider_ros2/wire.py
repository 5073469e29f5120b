"""Wire format of rmw_zenoh: topic keys, tokens of the ROS graph, quality of service, attachments.

See `docs/design.md` and `rmw_zenoh_cpp/src/detail/liveliness_utils.cpp` in ros2/rmw_zenoh. Keys contain the type's hash
from Jazzy on. Humble writes `TypeHashNotSupported` instead; messages of its nodes are rejected and counted.
"""

import re
import struct
from dataclasses import dataclass
from enum import StrEnum

from bus.errors import ScenarioError
from outrider_ros2.roles import PILOT

GRAPH = "@ros2_lv"
"""First part of every liveliness token of the ROS graph."""
MAX_DOMAIN = 232
"""Largest ROS 2 domain id."""
_DEFAULT_DEPTH = 42
"""Default depth of the history in rmw_zenoh, omitted from tokens."""
_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
_PART = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class Endpoint(StrEnum):
    """Kind of an entity of the ROS graph, as written in tokens."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"


@dataclass(frozen=True, slots=True, kw_only=True)
class Qos:
    """Quality of service of a topic."""

    reliable: bool = True
    transient_local: bool = False
    """True if late subscribers receive the newest messages."""
    depth: int = 10
    """Number of messages in the history."""

    def encoded(self) -> str:
        """Return the token form: reliability, durability, history and depth; defaults are empty."""
        depth = "" if self.depth == _DEFAULT_DEPTH else str(self.depth)
        return (
            f"{'' if self.reliable else '2'}:{'1' if self.transient_local else ''}:,{depth}:,:,:,,"
        )

    def in_words(self) -> str:
        """Return a description for a table."""
        durability = ", transient local" if self.transient_local else ""
        return f"{'reliable' if self.reliable else 'best effort'}{durability}, depth {self.depth}"


RELIABLE = Qos()
NEWEST = Qos(depth=1)
SENSOR = Qos(reliable=False, depth=5)
"""ROS 2 profile for sensor data."""
CLOCK = Qos(reliable=False, depth=1)
LATCHED = Qos(transient_local=True, depth=1)
"""Profile for latched topics: maps, static transforms, markers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """ROS 2 node on a Zenoh session."""

    domain: int
    zid: str
    """Zenoh id of the session."""
    name: str
    namespace: str = "/"

    def token(self, kind: Endpoint = Endpoint.NODE, number: int = 0) -> str:
        """Return the liveliness token of the node in the ROS graph; the node is number 0 of its session."""
        return (
            f"{GRAPH}/{self.domain}/{self.zid}/0/{number}/{kind}"
            f"/%/{mangled(self.namespace)}/{self.name}"
        )

    def endpoint_token(self, kind: Endpoint, number: int, topic: "WireTopic", qos: Qos) -> str:
        """Return the liveliness token of a publisher, subscription or service in the ROS graph.

        Args:
            kind: Kind of the endpoint.
            number: Number among the nodes and endpoints of the session.
            topic: Topic or service.
            qos: Quality of service.
        """
        return (
            f"{self.token(kind, number)}"
            f"/{mangled(topic.name)}/{dds_type(topic.interface)}/{topic.hash}/{qos.encoded()}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class WireTopic:
    """Topic or service with its type."""

    name: str
    """Absolute name, such as `/uav_0/odom`."""
    interface: str
    """Type, such as `nav_msgs/msg/Odometry`."""
    hash: str
    """RIHS01 hash of the type."""

    def key(self, domain: int) -> str:
        """Return the key of the messages."""
        return f"{domain}/{self.name.strip('/')}/{dds_type(self.interface)}/{self.hash}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """Attachment of a message."""

    sequence: int
    """Sequence number of the endpoint, from 1."""
    time: int
    """Wall time at the source [ns]."""
    gid: bytes
    """Identity of the endpoint, 16 bytes."""

    def encoded(self) -> bytes:
        """Return the 33 bytes of the attachment, little-endian."""
        return _ATTACHMENT.pack(self.sequence, self.time, _GID_BYTES, self.gid)

    @classmethod
    def decoded(cls, raw: bytes) -> "Attachment | None":
        """Decode an attachment; return None if the bytes are invalid."""
        if len(raw) != _ATTACHMENT.size:
            return None
        sequence, source_time, length, gid = _ATTACHMENT.unpack(raw)
        if length != _GID_BYTES:
            return None
        return cls(sequence=sequence, time=source_time, gid=gid)


def mangled(name: str) -> str:
    """Return a name as one part of a token; an empty name becomes `%`."""
    return name.replace("/", "%") or "%"


def dds_type(name: str) -> str:
    """Return a type as written in keys: `std_msgs/msg/String` becomes `std_msgs::msg::dds_::String_`."""
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


def check_domain(domain: int) -> int:
    """Return the domain id after a check.

    Raises:
        ScenarioError: If the domain id is out of range.
    """
    if not 0 <= domain <= MAX_DOMAIN:
        raise ScenarioError(f"--domain {domain}: out of range; allowed: 0 to {MAX_DOMAIN}")
    return domain


def check_namespace(namespace: str) -> str:
    """Return the absolute namespace without a final slash; empty for the root namespace.

    Raises:
        ScenarioError: If the name is invalid, or collides with the private topics of vehicles.
    """
    parts = [part for part in namespace.split("/") if part]
    for part in parts:
        if not _PART.fullmatch(part) or "__" in part or part == PILOT:
            raise ScenarioError(
                f"--namespace {namespace!r}: invalid namespace; allowed: parts of letters, digits and single '_', "
                f"no leading digit, separated by '/', none of them {PILOT!r}"
            )
    return "".join(f"/{part}" for part in parts)
