"""Roles of ROS 2 parties, entry point `outrider.roles`: permissions on the router beyond the key table.

ROS 2 nodes with rmw_zenoh use the keys `<domain>/<topic>/<type>/<hash>` and liveliness tokens under `@ros2_lv`. No `**`
matches these tokens, so each is named here. No such key can be one of a run's own keys.

| party | reads | writes |
|---|---|---|
| bridge (`ros2`, `operator`) | `cmd_vel`, service calls (`operator` only) | all but inputs and pilot topics |
| `ros2_observer`: observing nodes | all topics but pilot topics | nothing |
| `ros2_operator`: driving nodes | all topics but pilot topics | `cmd_vel`, service calls |
| a vehicle: its bridge and its node | its own `<vehicle>/pilot/...` | its own `<vehicle>/pilot/...` |

A vehicle sees only the tokens of its own topics, and only the vehicle may declare them: tokens contain freely chosen
names, through which another party could send information to the vehicle.
"""

from enum import StrEnum
from typing import NamedTuple

from bus.keys import Grant, Party, Role
from bus.messages.team import Request
from bus.roles import Roles

PILOT = "pilot"
"""Second part of a vehicle's private topics, such as `/uav_0/pilot/odom`."""
CMD_VEL = "cmd_vel"
RUN_SERVICES = ("pause", "step", "reset")
"""Services for the whole run."""
REQUESTS = {"call": Request.GUARD, "relieve": Request.RELIEF}
"""Services of each UAV in a team, such as `/uav_0/relieve`, and the request that they send."""
SERVICES = (*RUN_SERVICES, *REQUESTS)
"""Services that an operator's nodes may call."""

BRIDGE = "ros2"
"""Role of the bridge that publishes a run to ROS 2."""
NODE_OBSERVER, NODE_OPERATOR = "ros2_observer", "ros2_operator"
"""Roles of observing and of driving ROS 2 nodes."""

NO_HASH = "TypeHashNotSupported"
"""Placeholder for the type's hash in ROS 2 distributions without type hashes."""
_TYPE = "*/RIHS01_$*"
"""Type and hash at the end of a ROS 2 key; no key of a run ends with such a hash."""
_HASHES = (_TYPE, f"*/{NO_HASH}")
TOPICS = "*/*/**/RIHS01_$*"
"""All ROS 2 data, in every domain."""
_LATE = "@adv/**"
"""Suffix of a topic's key through which transient-local topics serve late subscribers."""
_PILOT_KEYS = tuple(f"*/**/{PILOT}/*/{hashed}" for hashed in _HASHES)
_GRAPH = "@ros2_lv/**"
_ENDPOINT = "@ros2_lv/*/*/*/*/*/*/*/*/{name}/*/*/*"
_OPPOSITE = {"ingress": "egress", "egress": "ingress"}


class Operation(StrEnum):
    """Operation that writes an input of a bridge."""

    PUT = "put"
    CALL = "call"


class Input(NamedTuple):
    """Input of a bridge."""

    operation: Operation
    keys: tuple[str, ...]
    """Keys in every domain and namespace, with any hash."""
    writer: str
    """Only role that may write the input."""
    reader: str
    """Role of the bridge that reads the input."""


VELOCITIES = Input(
    Operation.PUT,
    tuple(f"*/**/{CMD_VEL}/{hashed}" for hashed in _HASHES),
    NODE_OPERATOR,
    Role.OPERATOR.value,
)
"""Velocity commands for UGVs."""
CALLS = Input(
    Operation.CALL,
    tuple(f"*/**/{service}/{hashed}" for service in SERVICES for hashed in _HASHES),
    NODE_OPERATOR,
    Role.OPERATOR.value,
)
"""Service calls."""
INPUTS = (VELOCITIES, CALLS)
"""Inputs of the bridge of a run; the bridge of a vehicle has only that vehicle's inputs."""


def _late(*keys: str) -> tuple[str, ...]:
    return tuple(f"{key}/{_LATE}" for key in keys)


def _publishes(*keys: str) -> list[Grant]:
    return [
        Grant("put", "ingress", keys),
        Grant("declare_subscriber", "egress", keys),
        # The newest messages of transient-local topics, for late subscribers.
        Grant("liveliness_token", "ingress", _late(*keys)),
        Grant("declare_queryable", "ingress", _late(*keys)),
        Grant("query", "egress", _late(*keys)),
        Grant("reply", "ingress", (*keys, *_late(*keys))),
        Grant("declare_liveliness_subscriber", "egress", _late(*keys)),
        Grant("liveliness_query", "egress", _late(*keys)),
    ]


def _other_end(grants: list[Grant]) -> list[Grant]:
    """Return the matching grants of the peer, with ingress and egress exchanged."""
    return [grant._replace(flow=_OPPOSITE[grant.flow]) for grant in grants]


def _subscribes(*keys: str) -> list[Grant]:
    return _other_end(_publishes(*keys))


_DISCOVERS = [
    Grant("declare_liveliness_subscriber", "ingress", (_GRAPH,)),
    Grant("liveliness_query", "ingress", (_GRAPH,)),
]
_DECLARES = [
    Grant("liveliness_token", "ingress", (_GRAPH,)),
    Grant("liveliness_token", "egress", (_GRAPH,)),
]
_DENY_PILOT = [
    Grant(message, flow, _PILOT_KEYS, "deny")
    for message in ("put", "declare_subscriber", "reply")
    for flow in _OPPOSITE
] + [
    Grant("liveliness_token", "ingress", (_ENDPOINT.format(name=f"$*%{PILOT}%$*"),), "deny"),
    Grant("query", "ingress", _late(*_PILOT_KEYS), "deny"),
    Grant("query", "egress", _late(*_PILOT_KEYS), "deny"),
    Grant("declare_queryable", "ingress", _late(*_PILOT_KEYS), "deny"),
    Grant("liveliness_token", "ingress", _late(*_PILOT_KEYS), "deny"),
    Grant("liveliness_token", "egress", _late(*_PILOT_KEYS), "deny"),
]


def _reads(row: Input) -> list[Grant]:
    """Return the grants of the reader of an input; the writer gets the opposite grants."""
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
    """Return the denials for a party that may publish all other topics, but not write this input."""
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
        *_DISCOVERS,
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
    return [*found, *_DISCOVERS, *_DECLARES, *_DENY_PILOT]


def _grants(party: Party) -> list[Grant]:
    """Return the grants of a party on ROS 2 keys, in a run whose credentials include a bridge."""
    if party.role in (Role.UAV, Role.UGV):
        return _of_vehicle(party.name)
    return _of_staff(party.extension or party.role.value)


ROLES = Roles(
    parties={BRIDGE: Role.OBSERVER, NODE_OBSERVER: Role.GUEST, NODE_OPERATOR: Role.GUEST},
    grants=_grants,
)
