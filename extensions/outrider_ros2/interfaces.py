"""ROS 2's message types: made, hashed, written as CDR and read back.

The types are those of Jazzy; of the ones that are used here every distribution from Jazzy on has the same hashes.
"""

from functools import cache
from typing import Any

from bus.plugins import needs
from outrider.running.refused import Refused
from outrider_ros2.wire import dds_type

RosMessage = Any
"""A message of ROS 2's, of a class that rosbags generates and that has no types."""
_MOST_ITEMS = 1 << 20
"""Elements of a sequence that is read: what claims to have more is no message to us."""
_SERVICES = {
    "std_srvs/srv/SetBool": (
        "bool data",
        "bool success\nstring message",
        "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    ),
    "std_srvs/srv/Trigger": (
        "uint8 structure_needs_at_least_one_member",
        "bool success\nstring message",
        "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    ),
}


def require_extra() -> None:
    """Refuse to go on without the packages of the extra.

    Raises:
        ScenarioError: If one is missing.
    """
    with needs("ros2"):
        import rosbags.typesys  # noqa: F401, PLC0415
        import xxhash  # noqa: F401, PLC0415


@cache
def type_store() -> Any:  # noqa: ANN401 - rosbags' store of generated classes
    """The types of ROS 2 Jazzy, with those of the services that are offered."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415

    store = get_typestore(Stores.ROS2_JAZZY)
    store.max_sequence_length = _MOST_ITEMS
    for name, (request, response, _) in _SERVICES.items():
        store.register(get_types_from_msg(request, request_of(name)))
        store.register(get_types_from_msg(response, response_of(name)))
    return store


def request_of(service: str) -> str:
    """The type of a service's requests: it is no message of its own to ROS 2, but one to us."""
    return f"{service.replace('/srv/', '/msg/')}_Request"


def response_of(service: str) -> str:
    """The type of a service's responses, likewise."""
    return f"{service.replace('/srv/', '/msg/')}_Response"


def make(interface: str, /, **fields: object) -> RosMessage:
    """A message of a type, such as `geometry_msgs/msg/Point`, with all its fields."""
    return type_store().types[interface](**fields)


@cache
def type_hash(name: str) -> str:
    """The RIHS01 hash of a message's or service's type."""
    if name in _SERVICES:
        return _SERVICES[name][2]
    return str(type_store().hash_rihs01(name))


def encode(name: str, message: object) -> bytes:
    """A message as CDR, little-endian, with its encapsulation header."""
    return bytes(type_store().serialize_cdr(message, name, little_endian=True))


def decode(name: str, raw: bytes) -> RosMessage:
    """The message in these bytes.

    Raises:
        Refused: If they are no CDR of this type.
    """
    try:
        return type_store().deserialize_cdr(raw, name)
    except Exception as error:  # generated code raises whatever it meets in foreign bytes
        raise Refused("no CDR of its type", f"{name}: {error}") from error


def check_type(interface: str, hashed: str, *allowed: str) -> str:
    """Return the name of the type that a key has.

    Args:
        interface: The type, as keys call it.
        hashed: The hash in the key.
        allowed: Names of types.

    Raises:
        Refused: If it is of none of the allowed types, or has another hash.
    """
    name = next((one for one in allowed if dds_type(one) == interface), None)
    if name is None:
        verb = "are" if len(allowed) > 1 else "is"
        raise Refused("another type", f"{interface}; allowed {verb} {' and '.join(allowed)}")
    if hashed != type_hash(name):
        raise Refused("another hash", f"{hashed} of {name}; here it is {type_hash(name)}")
    return name


def decode_checked(interface: str, hashed: str, raw: bytes, *allowed: str) -> RosMessage:
    """The message in these bytes, whose key has this type and hash.

    Raises:
        Refused: If it is of none of the allowed types, or no CDR of its type.
    """
    return decode(check_type(interface, hashed, *allowed), raw)
