"""The information contract on ROS 2's keys: what the router lets through for sessions that bypass our API."""

from typing import Any

import zenoh

from bus.access import access_control
from bus.credentials import new_credentials
from bus.errors import AccessDenied
from bus.keys import KEYS, Key, Role, check_reads, check_writes
from outrider_ros2.roles import (
    CALLS,
    INPUTS,
    NO_HASH,
    NODE_OPERATOR,
    SERVICES,
    VELOCITIES,
    Operation,
)
from staging import Received, await_exactly, raw_sessions, subscribed

GIVEN = new_credentials("run", ["uav_0"], ["ugv_0"], extensions=["ros2"])
NAMES = [one.name for one in GIVEN.parties if one.role != Role.SIMULATOR]
TYPE = "nav_msgs::msg::dds_::Odometry_/RIHS01_3cc97dc7"
TRUTHS = {f"0/uav_0/odom/{TYPE}", f"42/fleet/ugv_0/odom/{TYPE}", f"0/tf/{TYPE}"}
CMD_VEL = f"0/ugv_0/cmd_vel/{TYPE}"
OWN = {"uav_0": f"0/uav_0/pilot/odom/{TYPE}", "ugv_0": f"7/ugv_0/pilot/command/{TYPE}"}
FORBIDDEN = {
    f"0/fleet/uav_0/pilot/odom/{TYPE}",
    f"0/uav_0/pilot/ugv_0/pilot/odom/{TYPE}",
    f"0/ugv_0/pilot/uav_0/pilot/odom/{TYPE}",
    "outrider/run/uav_0/observation",
    "0/uav_0/odom/without_a_hash",
}
DATA = TRUTHS | {CMD_VEL} | set(OWN.values()) | FORBIDDEN
BRIDGES, VIEWERS = {"ros2", "operator"}, {"ros2_observer", "ros2_operator"}
SUFFIX = f"{TYPE}/::,10:,:,:,,"


def readers(key: str) -> set[str]:
    """Return the parties that may read a key."""
    own = {name for name, mine in OWN.items() if mine == key}
    if own or key in FORBIDDEN:
        return own
    return VIEWERS | ({"operator"} if key == CMD_VEL else set())


def writers(key: str) -> set[str]:
    """Return the parties that may write a key; the input of a bridge has a writer of its own."""
    own = {name for name, mine in OWN.items() if mine == key}
    if own or key in FORBIDDEN:
        return own
    return {VELOCITIES.writer} if key == CMD_VEL else BRIDGES


def test_each_party_accesses_its_own_topics_only(endpoint: str) -> None:
    wanted = {
        (reader, key, writer)
        for key in DATA
        for reader in readers(key)
        for writer in writers(key)
        if reader != writer
    }
    assert {("ros2_observer", f"0/tf/{TYPE}", "ros2")} < wanted
    assert not {one for one in wanted if one[0] in OWN}
    found: Received = set()
    with raw_sessions(endpoint, GIVEN, NAMES) as sessions:
        widest = ("**", "0/**", f"*/**/{TYPE}")
        kept = [
            subscribed(opened, name, (*DATA, *widest), found) for name, opened in sessions.items()
        ]

        def publish() -> None:
            for name, opened in sessions.items():
                for key in DATA:
                    opened.put(key, name.encode(), allowed_destination=zenoh.Locality.REMOTE)

        await_exactly(wanted, found, publish)
        assert kept
    assert found == wanted


def token(name: str, by: str, namespace: str = "%") -> str:
    return f"@ros2_lv/0/{by}/0/1/MP/%/{namespace}/node/{name}/{SUFFIX}"


def node(namespace: str, by: str) -> str:
    return f"@ros2_lv/0/{by}/0/0/NN/%/{namespace}/node"


def test_a_vehicle_sees_the_graph_of_its_own_topics_alone(endpoint: str) -> None:
    """Names in tokens are free: none of another party's names may reach a vehicle."""
    truths = {"%tf", "%uav_0%odom", "%fleet%ugv_0%odom"}
    nasty = {"%fleet%uav_0%pilot%x", "%uav_0%pilot%x%ugv_0%pilot%y", "%ugv_0%pilot%uav_0%pilot%y"}
    names = truths | nasty | {"%uav_0%pilot%odom", "%ugv_0%pilot%odom"}

    def declared(by: str) -> set[str]:
        spaces = {node(space, by) for space in ("%", "%uav_0", "%ugv_0")}
        return {token(name, by) for name in names} | spaces

    staff = BRIDGES | VIEWERS
    open_names = {token(name, by) for name in truths for by in staff}
    open_names |= {node(space, by) for space in ("%", "%uav_0", "%ugv_0") for by in staff}
    own = {
        vehicle: {
            one
            for one in declared(vehicle)
            if f"/%{vehicle}%pilot%" in one or f"NN/%/%{vehicle}/" in one
        }
        for vehicle in OWN
    }
    seen: dict[str, set[str]] = {name: set() for name in NAMES}
    with raw_sessions(endpoint, GIVEN, NAMES) as sessions:
        kept: list[Any] = []
        for name, opened in sessions.items():
            kept.append(
                opened.liveliness().declare_subscriber(
                    "@ros2_lv/**",
                    lambda sample, name=name: seen[name].add(str(sample.key_expr)),
                    history=True,
                )
            )
            kept += [opened.liveliness().declare_token(one) for one in declared(name)]
        wanted = open_names | own["uav_0"] | own["ugv_0"]
        await_exactly(wanted, seen["ros2_observer"])
        asked = sessions["uav_0"].liveliness().get("@ros2_lv/**", timeout=0.5)
        replies = {str(reply.ok.key_expr) for reply in asked if reply.ok is not None}
    for name in staff:
        assert seen[name] - declared(name) == wanted - declared(name)
    for name in OWN:
        assert not seen[name] - declared(name)
    assert not replies - declared("uav_0")
    assert not seen["observer"] - declared("observer")


UNHASHED = f"nav_msgs::msg::dds_::Odometry_/{NO_HASH}"
INPUT_KEYS = {
    Operation.PUT: {CMD_VEL, f"0/fleet/ugv_0/cmd_vel/{UNHASHED}"},
    Operation.CALL: {f"{n}/{name}/{TYPE}" for n, name in enumerate(SERVICES)}
    | {f"0/fleet/{name}/{UNHASHED}" for name in SERVICES},
}
ROWS = [(key, key.expression("run", "uav_0"), "uav_0") for key in KEYS if key.vehicle is Role.UAV]
ROWS += [(key, key.expression("run", "ugv_0"), "ugv_0") for key in KEYS if key.vehicle is Role.UGV]
ROWS += [(key, key.expression("run"), "") for key in KEYS if key.vehicle is None]
Done = set[tuple[str, str, str, Operation]]
"""Party reached by an operation, key, party that performed it, and the operation."""


def may(check: Any, key: Key, name: str, vehicle: str) -> bool:
    try:
        check(key, GIVEN.of(name).party, vehicle)
    except AccessDenied:
        return False
    return True


def declared_inputs() -> Done:
    """Return all that the tables let through on the run's own keys and on the inputs of bridges."""
    names = [one.name for one in GIVEN.parties]
    done = {
        (reader, expression, writer, Operation.PUT)
        for key, expression, vehicle in ROWS
        for reader in names
        for writer in names
        if may(check_reads, key, reader, vehicle) and may(check_writes, key, writer, vehicle)
    }
    for row in INPUTS:
        for key in INPUT_KEYS[row.operation]:
            done.add((row.reader, key, row.writer, row.operation))
            if row.operation is Operation.PUT and NO_HASH not in key:  # `ros2 topic echo`
                done.add(("ros2_observer", key, row.writer, row.operation))
    return done


def test_inputs_obey_the_access_tables(endpoint: str) -> None:
    """Let every party put to, delete, call, serve and read every key, by itself and by wildcards."""
    assert {VELOCITIES.writer, CALLS.writer} == {NODE_OPERATOR}
    wanted, found, deleted = declared_inputs(), set[Any](), set[Any]()
    names = [one.name for one in GIVEN.parties]
    keys = {expression for _, expression, _ in ROWS}.union(*INPUT_KEYS.values())

    def record_sample(name: str, sample: zenoh.Sample) -> None:
        if sample.kind is zenoh.SampleKind.DELETE:
            deleted.add((name, str(sample.key_expr)))
        else:
            key, writer = str(sample.key_expr), sample.payload.to_string()
            found.add((name, key, writer, Operation.PUT))

    def serve(name: str, query: zenoh.Query) -> None:
        with query:
            caller = query.payload.to_string() if query.payload is not None else ""
            found.add((name, str(query.key_expr), caller, Operation.CALL))
            query.reply(query.key_expr, name.encode())

    with raw_sessions(endpoint, GIVEN, names, "observer") as sessions:
        kept: list[Any] = []
        for name, opened in sessions.items():
            for key in (*keys, "**", "0/**"):
                kept.append(
                    opened.declare_subscriber(key, lambda one, name=name: record_sample(name, one))
                )
                kept.append(opened.declare_queryable(key, lambda one, name=name: serve(name, one)))

        def publish() -> None:
            remote = zenoh.Locality.REMOTE
            for name, opened in sessions.items():
                for key in keys:
                    opened.put(key, name.encode(), allowed_destination=remote)
                    opened.delete(key, allowed_destination=remote)
                    list(
                        opened.get(
                            key, payload=name.encode(), timeout=0.2, allowed_destination=remote
                        )
                    )

        await_exactly(wanted, found, publish)
        assert kept
    assert found == wanted
    assert not deleted


def test_late_reader_gets_the_newest_message_but_no_vehicle_does(endpoint: str) -> None:
    key = f"0/coverage/{TYPE}"
    got: set[str] = set()
    with raw_sessions(endpoint, GIVEN, NAMES) as sessions:
        publisher = zenoh.ext.declare_advanced_publisher(
            sessions["ros2"],
            key,
            cache=zenoh.ext.CacheConfig(1),
            sample_miss_detection=zenoh.ext.MissDetectionConfig(),
            publisher_detection=True,
        )
        publisher.put(b"map")
        kept = [
            zenoh.ext.declare_advanced_subscriber(
                sessions[name],
                key,
                lambda sample, name=name: got.add(name),
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
            )
            for name in NAMES
            if name != "ros2"
        ]
        await_exactly(VIEWERS, got)
        for one in kept:
            one.undeclare()
    assert got == VIEWERS


def test_a_run_without_ros2_lets_nothing_of_it_through() -> None:
    plain = new_credentials("run", ["uav_0"], ["ugv_0"])
    keys = {key for rule in access_control(plain)["rules"] for key in rule["key_exprs"]}
    assert all(key.startswith("outrider/run/") for key in keys)
    assert not any("ros2" in name for name in (one.name for one in plain.parties))


def test_no_key_of_a_run_is_one_of_ros2s() -> None:
    own = [zenoh.KeyExpr(key.expression("run", "uav_0")) for key in KEYS]
    rules = access_control(GIVEN)["rules"]
    wide = {expression for rule in rules for expression in rule["key_exprs"]}
    foreign = [zenoh.KeyExpr(one) for one in wide if not one.startswith("outrider/")]
    assert len(foreign) > 10
    assert not [(one, key) for one in foreign for key in own if one.intersects(key)]
