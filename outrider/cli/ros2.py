"""`outrider ros2`: a run seen, driven and flown from ROS 2."""

import time
from typing import TYPE_CHECKING, Annotated

import typer

from outrider.cli.options import (
    DEFAULT_ENDPOINT,
    DEFAULT_RUN,
    Connect,
    CredentialFile,
    Json,
    RunName,
    check_endpoints,
    credential_of,
)

if TYPE_CHECKING:
    from bus.session import Session
    from outrider.bridges.ros2.observing import RosObserver
    from outrider.cli.stopping import Stop

_AWAY = 3.0
"""The time after which a router that is away has gone for good, and so has the simulator of a run that is over [s]."""


def command(
    connect: Connect = DEFAULT_ENDPOINT,
    run: RunName = DEFAULT_RUN,
    credentials: CredentialFile = None,
    domain: Annotated[
        int, typer.Option(help="ROS 2's domain id, 0 to 232.", envvar="ROS_DOMAIN_ID")
    ] = 0,
    namespace: Annotated[
        str, typer.Option(help="Before the names of all topics, such as /fleet.")
    ] = "",
    every_tick: Annotated[
        bool,
        typer.Option(
            "--every-tick",
            help="Publish the truth of every tick; by default some 40 a second of wall time.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Show a run to ROS 2 nodes, with no bridge in between: it speaks the wire format of rmw_zenoh on the run's router.

    Nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp connect to the same router, as clients, and find odometry, transforms,
    maps, markers, diagnostics and simulated time. Only what somebody reads is asked for and converted. Ends with the
    run, or at Ctrl-C.

    Example: outrider ros2 --connect tcp/127.0.0.1:17447 --credentials credentials/ros2.json
    """
    from bus.keys import Party, Role
    from bus.session import open_session
    from outrider.bridges.ros2.interfaces import require_extra
    from outrider.bridges.ros2.wire import check_domain, check_namespace
    from outrider.cli.console import ERR, print_json
    from outrider.cli.stopping import stop_on_signals

    require_extra()
    check_domain(domain)
    space = check_namespace(namespace)
    check_endpoints((connect,), secured=True, insecure=False)
    party = Party(role=Role.ROS2, name=Role.ROS2.value)
    credential = credential_of(credentials, party.role, party.name)
    with (
        stop_on_signals() as stop,
        open_session(party, run, connect=connect, credential=credential) as session,
    ):
        observer, lost = _observe(
            session, stop, domain=domain, namespace=space, every_tick=every_tick
        )
    found = {
        "domain": domain,
        "topics": observer.topics,
        "taken": observer.taken,
        "refused": dict(observer.refused),
        "router_lost": lost,
    }
    if json:
        print_json(found)
    else:
        sent = sum(observer.topics.values())
        ERR.print(f"{sent} messages on {len(observer.topics)} topics", soft_wrap=True)
    if lost:
        from bus.errors import PeerLost

        raise PeerLost(f"the router at {connect} has gone")


def _observe(
    session: "Session", stop: "Stop", *, domain: int, namespace: str, every_tick: bool
) -> "tuple[RosObserver, bool]":
    """Publish until the run is over or somebody wants the end; whether it was the router that went."""
    from outrider.bridges.ros2.observing import RosObserver
    from outrider.bridges.ros2.ros_node import RosNode

    node = RosNode(session, domain=domain, name="outrider", namespace=namespace)
    observer = RosObserver(session, node, namespace=namespace, every_tick=every_tick)
    try:
        return observer, _follow(session, observer, stop)
    finally:
        observer.close()
        node.close()


def _follow(session: "Session", observer: "RosObserver", stop: "Stop") -> bool:
    from bus.keys import SIMULATOR_NAME
    from outrider.cli.console import ERR

    simulators: set[int] = set()

    def see(_name: str, place: int, present: bool) -> None:
        (simulators.add if present else simulators.discard)(place)

    session.watch(SIMULATOR_NAME, see)
    told, there, seen = False, time.monotonic(), time.monotonic()
    while not stop:
        observer.step(0.2)
        now = time.monotonic()
        if session.connected:
            there = now
        elif now - there > _AWAY:
            return True
        if simulators:
            seen = now
        elif observer.status is not None and observer.status.over and now - seen > _AWAY:
            return False
        if not told and observer.status is None and now - there < _AWAY:
            told = True
            ERR.print(
                f"waiting for the simulator of the run {session.run}; Ctrl-C leaves", soft_wrap=True
            )
    return False
