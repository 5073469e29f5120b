"""Roles of ROS 2 parties, the entry point `outrider.roles`: what the router lets through beside the key table.

ROS 2 nodes with rmw_zenoh use keys of their own, `<domain>/<topic>/<type>/<hash>`, and liveliness tokens under
`@ros2_lv`, which no `**` matches: each is named here. None of them can be a key of a run's own.

| party | reads | writes |
|---|---|---|
| `ros2`, the bridge; `operator`'s bridge | `cmd_vel`, calls, if an operator's | all but inputs and vehicles' own |
| `ros2_observer`, nodes that look on | all topics but vehicles' own | nothing |
| `ros2_operator`, nodes that drive | the same | `cmd_vel`; calls of services |
| a vehicle: its bridge and its node | `<vehicle>/pilot/...` of its own | the same |

A vehicle sees the tokens of its own topics alone. Those carry names that anybody may choose: whoever declares one of a
vehicle's topics could tell that vehicle something by it, so each vehicle's are its own to declare too.
"""

from enum import StrEnum
from typing import NamedTuple

from bus.keys import Grant, Party, Role
from bus.roles import Roles

PILOT = "pilot"
"""Second part of the topics that are a vehicle's own, such as `/uav_0/pilot/odom`: nobody else reads or writes them."""
CMD_VEL = "cmd_vel"
SERVICES = ("pause", "step", "reset")
"""The services that an operator's nodes may call."""

BRIDGE = "ros2"
"""Role of the bridge that shows ROS 2 a run."""
NODE_OBSERVER, NODE_OPERATOR = "ros2_observer", "ros2_operator"
"""Roles of ROS 2 nodes that look on, and of those that drive."""

NO_HASH = "TypeHashNotSupported"
"""In the place of a type's hash, where a distribution of ROS 2 knows none."""
_TYPE = "*/RIHS01_$*"
"""Type and hash: no key of ours ends with such a hash."""
_HASHES = (_TYPE, f"*/{NO_HASH}")
TOPICS = "*/*/**/RIHS01_$*"
"""All data of ROS 2, in every domain."""
_LATE = "@adv/**"
"""After a topic's key: how transient-local topics serve those who come late."""
_ANY_OWN = tuple(f"*/**/{PILOT}/*/{hashed}" for hashed in _HASHES)
_GRAPH = "@ros2_lv/**"
_ENDPOINT = "@ros2_lv/*/*/*/*/*/*/*/*/{name}/*/*/*"
_OTHER_WAY = {"ingress": "egress", "egress": "ingress"}


class Operation(StrEnum):
    """The operation by which a bridge's input is written."""

    PUT = "put"
    CALL = "call"


class Input(NamedTuple):
    """One row: an input of a bridge."""

    operation: Operation
    keys: tuple[str, ...]
    """Its keys in every domain and namespace, with whatever hash."""
    writer: str
    """The only role that may write it."""
    reader: str
    """The role of the bridge that acts on it."""


VELOCITIES = Input(
    Operation.PUT,
    tuple(f"*/**/{CMD_VEL}/{hashed}" for hashed in _HASHES),
    NODE_OPERATOR,
    Role.OPERATOR.value,
)
"""Velocities for UGVs."""
CALLS = Input(
    Operation.CALL,
    tuple(f"*/**/{service}/{hashed}" for service in SERVICES for hashed in _HASHES),
    NODE_OPERATOR,
    Role.OPERATOR.value,
)
"""Calls of services."""
INPUTS = (VELOCITIES, CALLS)
"""Inputs of a bridge that shows a run; a bridge that flies a vehicle has the inputs of that vehicle alone."""


def _late(*keys: str) -> tuple[str, ...]:
    return tuple(f"{key}/{_LATE}" for key in keys)


def _publishes(*keys: str) -> list[Grant]:
    return [
        Grant("put", "ingress", keys),
        Grant("declare_subscriber", "egress", keys),
        # The newest messages of what stays as it is, for those who come late.
        Grant("liveliness_token", "ingress", _late(*keys)),
        Grant("declare_queryable", "ingress", _late(*keys)),
        Grant("query", "egress", _late(*keys)),
        Grant("reply", "ingress", (*keys, *_late(*keys))),
        Grant("declare_liveliness_subscriber", "egress", _late(*keys)),
        Grant("liveliness_query", "egress", _late(*keys)),
    ]


def _other_end(grants: list[Grant]) -> list[Grant]:
    """The rules of those with whom these let a party speak: what comes in from the one goes out to the other."""
    return [grant._replace(flow=_OTHER_WAY[grant.flow]) for grant in grants]


def _subscribes(*keys: str) -> list[Grant]:
    return _other_end(_publishes(*keys))


_LOOKS = [
    Grant("declare_liveliness_subscriber", "ingress", (_GRAPH,)),
    Grant("liveliness_query", "ingress", (_GRAPH,)),
]
_DECLARES = [
    Grant("liveliness_token", "ingress", (_GRAPH,)),
    Grant("liveliness_token", "egress", (_GRAPH,)),
]
_NOT_OWN = [
    Grant(message, flow, _ANY_OWN, "deny")
    for message in ("put", "declare_subscriber", "reply")
    for flow in _OTHER_WAY
] + [
    Grant("liveliness_token", "ingress", (_ENDPOINT.format(name=f"$*%{PILOT}%$*"),), "deny"),
    Grant("query", "ingress", _late(*_ANY_OWN), "deny"),
    Grant("query", "egress", _late(*_ANY_OWN), "deny"),
    Grant("declare_queryable", "ingress", _late(*_ANY_OWN), "deny"),
    Grant("liveliness_token", "ingress", _late(*_ANY_OWN), "deny"),
    Grant("liveliness_token", "egress", _late(*_ANY_OWN), "deny"),
]


def _reads(row: Input) -> list[Grant]:
    """The grants of the reader of a bridge's input; those of its writer are the other end."""
    if row.operation is Operation.PUT:
        return [
            Grant("declare_subscriber", "ingress", row.keys),
            Grant("put", "egress", row.keys),
        ]
    return [
        Grant("declare_queryable", "ingress", row.keys),
        Grant("query", "egress", row.keys),
        Grant("reply", "ingress", row.keys),
    ]


def _never_writes(row: Input) -> list[Grant]:
    """The denials for a party that is not a bridge's input's writer, although it may publish all other topics."""
    late = _late(*row.keys)
    return [
        Grant("put", "ingress", row.keys, "deny"),
        Grant("query", "ingress", row.keys, "deny"),
        Grant("reply", "ingress", late, "deny"),
        Grant("declare_queryable", "ingress", late, "deny"),
        Grant("liveliness_token", "ingress", late, "deny"),
    ]


def _of_vehicle(name: str) -> list[Grant]:
    own, unhashed = f"*/{name}/{PILOT}/*/{_TYPE}", f"*/{name}/{PILOT}/*/*/{NO_HASH}"
    tokens, node = _ENDPOINT.format(name=f"%{name}%{PILOT}%$*"), f"@ros2_lv/*/*/*/*/NN/*/%{name}/*"
    return [
        *_publishes(own, unhashed),
        *_subscribes(own, unhashed),
        *_LOOKS,
        Grant("liveliness_token", "ingress", (tokens, node)),
        Grant("liveliness_token", "egress", (tokens,)),
    ]


def _of_staff(role: str) -> list[Grant]:
    found: list[Grant] = []
    if role in (BRIDGE, Role.OPERATOR):
        found += _publishes(TOPICS)
    if role in (NODE_OBSERVER, NODE_OPERATOR):
        found += _subscribes(TOPICS)
    if not found:
        return []
    for row in INPUTS:
        found += _reads(row) if role == row.reader else []
        found += _other_end(_reads(row)) if role == row.writer else _never_writes(row)
    return [*found, *_LOOKS, *_DECLARES, *_NOT_OWN]


def _grants(party: Party) -> list[Grant]:
    """Return all that a party may do on the keys of ROS 2, in a run whose credentials have a bridge."""
    if party.role in (Role.UAV, Role.UGV):
        return _of_vehicle(party.name)
    return _of_staff(party.extension or party.role.value)


ROLES = Roles(
    parties={BRIDGE: Role.OBSERVER, NODE_OBSERVER: Role.GUEST, NODE_OPERATOR: Role.GUEST},
    grants=_grants,
)
