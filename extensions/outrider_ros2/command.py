"""`outrider ros2`: publish a run to ROS 2 nodes, and control it from them."""

from pathlib import Path
from typing import Annotated

import typer

from bus.credentials import read_credential
from bus.errors import PeerLost, ScenarioError
from bus.keys import Role
from outrider.cli import options
from outrider.cli.joining import join, joining
from outrider.cli.stopping import stop_on_signals
from outrider_ros2.roles import BRIDGE
from outrider_ros2.wire import check_domain, check_namespace

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
    check_domain(domain)
    space = check_namespace(namespace)
    if vehicle:
        from outrider_ros2.flying import fly  # noqa: PLC0415 - the extra [ros2]

        _check_alone({"--operator": operator, "--namespace": space, "--every-tick": every_tick})
        kind = _role_of(vehicle, credentials)
        joined = joining(kind, vehicle, connect, run, credentials, join_timeout)
        fly(joined, domain=domain, json=json)
        return
    from outrider_ros2.bridge import observe, print_counts  # noqa: PLC0415 - the extra [ros2]

    role = Role.OPERATOR.value if operator else BRIDGE
    with (
        stop_on_signals() as stop,
        join(role, run, connect, credentials, join_timeout) as session,
    ):
        observer, lost = observe(
            session, stop, domain=domain, namespace=space, every_tick=every_tick
        )
    print_counts(observer, domain, lost=lost, every_tick=every_tick, json=json)
    if lost:
        raise PeerLost(f"the router at {connect} disconnected")


def _check_alone(others: dict[str, object]) -> None:
    """Reject options that cannot be combined with --vehicle."""
    for option in (option for option, given in others.items() if given):
        raise typer.BadParameter(
            f"{option} cannot be combined with --vehicle, whose topics are /NAME/pilot/..."
        )


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
    from outrider_ros2.bag_export import export_recording  # noqa: PLC0415 - the extras

    export_recording(file, bag, flight, json=json)


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
    from outrider_ros2.bag_import import import_recording  # noqa: PLC0415 - the extras

    import_recording(bag, file, json=json)


def _role_of(name: str, credentials: Path | None) -> Role:
    """Return the kind of the vehicle, from its credentials or else from its name."""
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
