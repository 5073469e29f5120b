"""`outrider ros2`: publish a run to ROS 2 nodes, and control it from them."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bus.errors import PeerLost, ScenarioError
from bus.keys import SIMULATOR_NAME, Role
from outrider.cli import options
from outrider.cli.stopping import Stop, stop_on_signals
from outrider.cli.waiting import AWAY, RouterTimer, print_waiting

if TYPE_CHECKING:
    from bus.session import Session
    from outrider_ros2.observing import RosObserver


app = typer.Typer(rich_markup_mode=None)

_Domain = Annotated[
    int, typer.Option(help="Set the ROS 2 domain id, 0 to 232.", envvar="ROS_DOMAIN_ID")
]
_Namespace = Annotated[str, typer.Option(help="Prefix all topic names, for example with /fleet.")]
_Operator = Annotated[
    bool,
    typer.Option(
        "--operator",
        help="Accept cmd_vel and the services pause, step and reset; requires operator credentials.",
    ),
]
_Vehicle = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Join as this vehicle, controlled by a ROS 2 node on /NAME/pilot/...",
    ),
]
_EveryTick = Annotated[
    bool,
    typer.Option(
        "--every-tick",
        help="Publish the truth of every tick, not at about 40 Hz.",
    ),
]


@app.callback(invoke_without_command=True)
def command(
    context: typer.Context,
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    domain: _Domain = 0,
    namespace: _Namespace = "",
    operator: _Operator = False,
    vehicle: _Vehicle = "",
    join_timeout: options.JoinTimeout = 30.0,
    every_tick: _EveryTick = False,
    json: options.Json = False,
) -> None:
    """Connect a run or its vehicles to ROS 2.

    The command uses the wire format of rmw_zenoh on the run's router. ROS 2 nodes with
    RMW_IMPLEMENTATION=rmw_zenoh_cpp connect to the same router as clients. They receive odometry, transforms, maps,
    markers, diagnostics and simulated time. Topics without subscribers are neither requested nor converted. The
    command ends with the run, or at Ctrl-C.

    With --operator, nodes can drive UGVs: a Twist or TwistStamped on /ugv_0/cmd_vel takes control of ugv_0. After one
    second of silence another node may take control. At the end, control returns to the previous driver. The services
    are /pause, /step and /reset. Rejected messages are counted by cause and published on /diagnostics.

    With --vehicle, the command waits for a node that subscribes to /NAME/pilot/observation (complete, as JSON) or
    /NAME/pilot/odom, and then joins with the vehicle's credentials. The node answers each observation on
    /NAME/pilot/command (JSON) or, with the stamp of the observation, on /NAME/pilot/accel. The node can access the
    topics of this vehicle only.

    Example: outrider ros2 --connect tcp/127.0.0.1:17447 --credentials credentials/ros2.json

    Example: outrider ros2 --operator --credentials credentials/operator.json

    Example: outrider ros2 --vehicle uav_0 --credentials credentials/uav_0.json
    """
    if context.invoked_subcommand is not None:
        return
    from outrider_ros2.interfaces import require_extra
    from outrider_ros2.roles import BRIDGE
    from outrider_ros2.wire import check_domain, check_namespace

    require_extra()
    check_domain(domain)
    space = check_namespace(namespace)
    if vehicle:
        _check_alone({"--operator": operator, "--namespace": space, "--every-tick": every_tick})
        kind = _role_of(vehicle, credentials)
        joining = options.joining(kind, vehicle, connect, run, credentials, join_timeout)
        _fly(joining, domain=domain, json=json)
        return
    role = Role.OPERATOR.value if operator else BRIDGE
    with (
        stop_on_signals() as stop,
        options.join(role, run, connect, credentials, join_timeout) as session,
    ):
        observer, lost = _observe(
            session, stop, domain=domain, namespace=space, every_tick=every_tick
        )
    _report(observer, domain, lost=lost, every_tick=every_tick, json=json)
    if lost:
        raise PeerLost(f"the router at {connect} disconnected")


def _check_alone(others: dict[str, object]) -> None:
    """Reject options that cannot be combined with --vehicle."""
    for option in (option for option, given in others.items() if given):
        raise typer.BadParameter(
            f"{option} cannot be combined with --vehicle, whose topics are /NAME/pilot/..."
        )


def _report(
    observer: "RosObserver", domain: int, *, lost: bool, every_tick: bool, json: bool
) -> None:
    """Print the number of published messages and rejections."""
    from outrider.cli.console import ERR, print_json

    found = {
        "domain": domain,
        "topics": observer.topics,
        "missing_ticks": observer.missing_ticks,
        "commands": observer.commands.accepted if observer.commands else 0,
        "refused": dict(observer.refusals.counts),
        "router_lost": lost,
    }
    if json:
        print_json(found)
    else:
        sent = sum(observer.topics.values())
        missing = f", {observer.missing_ticks} ticks missing" if every_tick else ""
        ERR.tell(f"{sent} messages on {len(observer.topics)} topics{missing}")


@app.command("export")
def export_bag(
    file: Annotated[Path, typer.Argument(help="Recording to export.")],
    bag: Annotated[Path, typer.Argument(help="Folder of the new bag.")],
    flight: options.FlightNumber = None,
    json: options.Json = False,
) -> None:
    """Export a recorded run as a rosbag2 bag.

    The bag has the topics of outrider ros2 at every tick, and the recording itself on one more topic. Ctrl-C removes
    the incomplete bag.

    Example: outrider ros2 export run.mcap bag
    """
    from outrider.cli.console import ERR, print_json, share_progress
    from outrider.recording.reader import flight_of
    from outrider_ros2.ros_bag import RosBag, check_target, copy_flight

    check_target(bag)  # before a long recording is read
    recording = flight_of(file, flight)
    with (
        stop_on_signals() as stop,
        RosBag(bag) as written,
        share_progress("writing the bag") as show,
    ):
        for seconds in copy_flight(recording, written):
            show("writing the bag", seconds / max(recording.truths[-1].time, 1e-9))
            if stop:
                raise typer.Exit(stop.exit_code)
    size, messages = options.size_of(bag), sum(written.topics.values())
    found = {"file": str(file), "flight": recording.number, "bag": str(bag), "bytes": size}
    if json:
        print_json(found | {"messages": messages, "topics": written.topics})
    else:
        topics = len(written.topics)
        ERR.tell(f"{bag}: {messages} messages on {topics} topics, {size / 1e6:.2f} MB")


@app.command("import")
def import_bag(
    bag: Annotated[
        Path,
        typer.Argument(help="Bag written by outrider ros2 export or record --format ros2."),
    ],
    file: Annotated[Path, typer.Argument(help="Recording to write; an existing file is replaced.")],
    json: options.Json = False,
) -> None:
    """Import the recording in a bag as an MCAP file.

    The file can be replayed, drawn and flown again like any other recording.

    Example: outrider ros2 import bag run.mcap
    """
    from outrider.cli.console import ERR, print_json
    from outrider.recording.reader import Damage
    from outrider_ros2 import bag_reader

    damage, messages = Damage(), 0
    with stop_on_signals() as stop:
        for _ in bag_reader.import_bag(bag, file, damage):
            messages += 1
            if stop:
                break
    if stop:
        file.unlink(missing_ok=True)
        raise typer.Exit(stop.exit_code)
    if json:
        whole = {"whole": not damage.reason, "reason": damage.reason}
        print_json({"bag": str(bag), "file": str(file), "messages": messages} | whole)
    else:
        ERR.tell(
            f"{file}: {messages} messages{f', incomplete: {damage.reason}' if damage.reason else ''}"
        )


def _observe(
    session: "Session", stop: Stop, *, domain: int, namespace: str, every_tick: bool
) -> "tuple[RosObserver, bool]":
    """Publish until the run ends or the user stops it; return the observer and True if the router disconnected."""
    from outrider.view.operator import RunClient
    from outrider_ros2.observing import RosObserver
    from outrider_ros2.ros_commands import RosCommands
    from outrider_ros2.ros_node import RosNode

    node = RosNode(session, domain=domain, name="outrider", namespace=namespace)
    observer = RosObserver(session, node, namespace=namespace, every_tick=every_tick)
    client = None
    if session.party.role is Role.OPERATOR:
        client = RunClient(session, read=())
        observer.commands = RosCommands(
            node, client, namespace=namespace, refusals=observer.refusals
        )
    try:
        return observer, _follow(session, observer, stop)
    finally:
        if observer.commands is not None and client is not None:
            observer.commands.hand_back()
            client.close()
        observer.close()
        node.close()


def _follow(session: "Session", observer: "RosObserver", stop: Stop) -> bool:
    from bus.presence import Presence

    simulator, router = Presence(session, SIMULATOR_NAME), RouterTimer(session)
    announced = False
    while not stop:
        observer.step(0.2)
        over = observer.status is not None and observer.status.over
        if router.has_gone():
            return not over
        if over and simulator.absent_for() > AWAY:
            return False
        if not announced and observer.status is None:
            announced = True
            print_waiting(session.run)
    return False


def _role_of(name: str, credentials: Path | None) -> Role:
    """Return the kind of the vehicle, from its credentials or else from its name."""
    from bus.credentials import read_credential

    kinds = (Role.UAV, Role.UGV)
    if credentials is not None:
        role: Role | None = read_credential(credentials).party.role
    else:
        role = next((kind for kind in kinds if name.startswith(kind)), None)
    if role not in kinds:
        raise ScenarioError(
            f"--vehicle {name}: unknown kind of vehicle; allowed: its --credentials, "
            "or a name that begins with uav or ugv"
        )
    return role


def _fly(joining: options.Joining, *, domain: int, json: bool) -> None:
    """Wait for a node that controls the vehicle, then fly the vehicle with it."""
    from outrider.cli.console import ERR, print_json
    from outrider_ros2.ros_node import RosNode
    from outrider_ros2.ros_pilot import RosPilot

    name = joining.party.name
    with joining.session() as session:
        node = RosNode(session, domain=domain, name="outrider", namespace=f"/{name}")
        pilot = RosPilot(node, joining.party)
        with stop_on_signals() as stop:
            if not pilot.connected:
                ERR.tell(f"waiting for a ROS 2 node that subscribes to /{name}/pilot/observation")
            while not pilot.connected and not stop:
                time.sleep(0.05)
        if stop:
            raise typer.Exit(stop.exit_code)
        try:
            sent = joining.fly(pilot.make)
        finally:
            pilot.close()
            node.close()
    found = {"vehicle": name, "commands": sent, "refused": dict(pilot.refusals.counts)}
    if json:
        print_json(found)
    else:
        ERR.tell(f"{name}: {sent} commands from a ROS 2 node")
