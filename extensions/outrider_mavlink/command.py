"""`outrider mavlink`: show a run in MAVLink ground stations, or control a UAV."""

import os
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bus.errors import PeerLost, ScenarioError
from bus.keys import SAMPLED_TRUTH, STATUS, Role
from bus.locator import LOOPBACK, check_endpoint
from bus.messages.scenario import Origin
from outrider.cli import options
from outrider.cli.stopping import Stop, stop_on_signals
from outrider.cli.waiting import RouterTimer, await_status

if TYPE_CHECKING:
    from agents.process import MakePilot
    from bus.session import Session
    from outrider.view.operator import RunClient
    from outrider_mavlink.autopilot import AutopilotLink
    from outrider_mavlink.identity import VehicleSystem
    from outrider_mavlink.offboard import OffboardGateway
    from outrider_mavlink.run_gateway import RunGateway
    from outrider_mavlink.udp import Address, Network

_OUT, _OFFBOARD = "127.0.0.1:14550", "127.0.0.1:14540"
_AUTOPILOT = "127.0.0.1:14540"
_LINGER = 0.6
"""Time for which the gateway continues after the end of a run, in case of a reset [s]."""
_NICE = 5
"""Lower priority than the run on a busy machine."""
_TRUTH = "telemetry, including the truth,"
_TURN = 0.02
"""Maximum time between two updates from the run [s]."""

_Out = Annotated[
    list[str] | None,
    typer.Option(
        "--to",
        metavar="HOST:PORT",
        help=f"Send to this ground station; repeatable [default: {_OUT}; with --vehicle: {_OFFBOARD}].",
    ),
]
_Listen = Annotated[
    list[str] | None,
    typer.Option(
        "--in",
        metavar="HOST:PORT",
        help=f"Listen for ground stations here; repeatable [default with --autopilot: {_AUTOPILOT}].",
    ),
]
_Private = Annotated[
    bool,
    typer.Option(
        "--private",
        help="Send to a random local port, and print it.",
    ),
]
_Vehicle = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Join as this UAV, controlled by setpoints inside the safety filter.",
    ),
]
_Autopilot = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Join as this UAV, with a real autopilot as its inner loop.",
    ),
]
_First = Annotated[
    int,
    typer.Option(
        "--first-system", help="Set the system number of the first vehicle.", min=1, max=200
    ),
]
_Height = Annotated[
    float,
    typer.Option(help="Set the height in telemetry of UAVs without an altitude [m].", min=0.0),
]


def command(
    out: _Out = None,
    listen: _Listen = None,
    private: _Private = False,
    vehicle: _Vehicle = "",
    autopilot: _Autopilot = "",
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    first: _First = 1,
    height: _Height = 10.0,
    join_timeout: options.JoinTimeout = 30.0,
    insecure: options.Insecure = False,
    json: options.Json = False,
) -> None:
    """Show a run in MAVLink ground stations, or control a UAV over MAVLink.

    Each vehicle is a MAVLink system. It sends HEARTBEAT, ATTITUDE, GLOBAL_POSITION_INT (from the scenario's origin) and
    LOCAL_POSITION_NED; a UGV also sends FOLLOW_TARGET. Status texts report lost processes and missing certificates.
    The run's settings are parameters. With the operator's credentials, a ground station can drive a UGV by joystick and
    set LAW, PAUSED and RT_FACTOR. With the observer's credentials, access is read-only. QGroundControl and MAVProxy
    listen on port 14550, MAVSDK on 14540. The command ends with the run, or at Ctrl-C.

    With --vehicle, the command replaces `outrider uav` for this UAV. In mode OFFBOARD, the UAV tracks
    SET_POSITION_TARGET_LOCAL_NED (velocity, acceleration). In mode HOLD, it holds its position. In mode MISSION, or
    without a setpoint for the scenario's `command_timeout`, the run's law controls it. The safety filter is always
    active.

    With --autopilot, the run's law controls the UAV and a real autopilot tracks its reference state. If the tracking
    error exceeds `certificate.max_tracking_error`, or telemetry is missing, the UAV holds its position and nothing is
    certified. The autopilot must be armed, airborne and in a mode that follows setpoints. The run must keep real time.
    PX4 sends to the default address of --in.

    Example: outrider mavlink --to 127.0.0.1:14550 --credentials credentials/observer.json

    Example: outrider mavlink --vehicle uav_0 --to 127.0.0.1:14540 --credentials credentials/uav_0.json
    """
    from outrider.cli.console import print_json
    from outrider_mavlink.identity import VehicleSystem
    from outrider_mavlink.udp import private_port

    check_endpoint(connect)
    if vehicle and autopilot:
        raise typer.BadParameter("--vehicle and --autopilot: not both; allowed: one of the two")
    if private and (out or autopilot):
        raise typer.BadParameter(
            f"--private and {'--to' if out else '--autopilot'}: not both; allowed: one of the two"
        )
    if private:
        out = [f"127.0.0.1:{private_port()}"]
    elif out is None and listen is None:
        out = [] if autopilot else [_OFFBOARD if vehicle else _OUT]
        listen = [_AUTOPILOT] if autopilot else []
    what = "telemetry" if vehicle else "setpoints" if autopilot else _TRUTH
    network = _open_network(what, out or [], listen or [], private=private, insecure=insecure)
    began = time.monotonic()
    try:
        if vehicle or autopilot:
            name = vehicle or autopilot
            joining = options.joining(Role.UAV, name, connect, run, credentials, join_timeout)
            system = VehicleSystem(name, first, flies=True, origin=Origin(), height=height)
            found = (
                _fly(network, system, joining) if vehicle else _fly_with_autopilot(network, joining)
            )
        else:
            os.nice(_NICE)
            with stop_on_signals() as stop:
                party, credential = options.staff_of(credentials, Role.OBSERVER)
                joining = options.Joining(party, connect, run, credential, join_timeout)
                found = _show(network, joining, stop, first, height)
    finally:
        network.close()
    found["seconds"] = time.monotonic() - began
    if json:
        print_json(found)
    else:
        sys.stderr.write(_summary(found) + "\n")


def _open_network(
    what: str, out: list[str], listen: list[str], *, private: bool, insecure: bool
) -> "Network":
    """Open the sockets, and print the addresses.

    Raises:
        ScenarioError: If an address is invalid, or other machines can reach it.
    """
    from outrider_mavlink.udp import Network, parse_address

    listening = {text: parse_address(text, listens=True) for text in listen}
    _check_listening(listening, insecure=insecure)
    targets = [parse_address(text, listens=False) for text in out]
    network = Network(targets, list(listening.values()))
    _print_addresses(what, out, listen, private=private)
    return network


def _print_addresses(what: str, out: list[str], listen: list[str], *, private: bool) -> None:
    """Print the addresses first, since any process may receive UDP datagrams."""
    if out:
        chosen = "" if private else "; use --private for a random port, or --to HOST:PORT"
        sys.stderr.write(
            f"sending {what} to {', '.join(out)}: any user's process can listen there{chosen}\n"
        )
    if listen:
        sys.stderr.write(
            f"sending {what} to any process, of any user, that connects to {', '.join(listen)}\n"
        )


def _join(
    joining: options.Joining, make: "MakePilot", gateway: "OffboardGateway | AutopilotLink"
) -> None:
    """Fly a UAV until the end of the run, and serve MAVLink in parallel."""
    from agents.process import warm_up
    from outrider_mavlink.offboard import serving

    warm_up(Role.UAV, inner=lambda _observation: (0.0, 0.0))
    with serving(gateway):
        joining.fly(make)


def _fly(network: "Network", system: "VehicleSystem", joining: options.Joining) -> dict[str, Any]:
    """Fly a UAV by setpoints until the end of the run; return the counts."""
    from outrider_mavlink.dialect import mavlink
    from outrider_mavlink.offboard import OffboardGateway, OffboardPilot

    system.capabilities |= mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    pilot = OffboardPilot()
    gateway = OffboardGateway(pilot, network, system)
    _join(joining, pilot.make, gateway)
    gateway.say(system, "the run is over")
    return {"vehicles": {system.name: system.number}, **gateway.counts()}


def _fly_with_autopilot(network: "Network", joining: options.Joining) -> dict[str, Any]:
    """Fly a UAV with a real autopilot until the end of the run; return the counts."""
    from outrider_mavlink.autopilot import AutopilotLink, AutopilotPilot

    link = AutopilotLink(network)
    pilot = AutopilotPilot(link)
    began, announced = time.monotonic(), False
    while link.reported is None:  # the run must not start without telemetry
        link.turn(_TURN)
        link.refresh()
        if not announced and time.monotonic() - began > 1.0:
            announced = True
            sys.stderr.write("waiting for an autopilot's telemetry; cancel with Ctrl-C\n")
    _join(joining, pilot.make, link)
    vehicles = {joining.party.name: 0 if link.peer is None else link.peer.system}
    found = {"vehicles": vehicles, "sent": dict(network.sent), "received": link.reports}
    return found | pilot.counts()


def _check_listening(addresses: "dict[str, Address]", *, insecure: bool) -> None:
    """Reject addresses open to other machines, since MAVLink has no authentication.

    Raises:
        ScenarioError: If other machines can reach an address.
    """
    for text, address in addresses.items():
        if not (insecure or address.host in LOOPBACK):
            raise ScenarioError(
                f"--in {text}: other machines can reach it without a password; allowed: a local address, or --insecure"
            )


def _show(
    network: "Network",
    joining: options.Joining,
    stop: Stop,
    first: int,
    height: float,
) -> dict[str, Any]:
    """Serve a run until it ends or the user stops the command; return the counts."""
    from outrider.cli.console import ERR
    from outrider.view.operator import RunClient
    from outrider_mavlink.run_gateway import RunGateway

    with joining.session() as session:
        status = await_status(session, stop)
        if status is None:
            return {"vehicles": {}}
        client = RunClient(session, status, read=(STATUS, SAMPLED_TRUTH))
        gateway = RunGateway(client, network, status, first=first, height=height)
        named = {system.name: number for number, system in gateway.systems.items()}
        ERR.tell(
            f"run {joining.run}: {', '.join(f'system {n} is {name}' for name, n in named.items())}"
        )
        try:
            lost = _follow(session, client, gateway, stop)
        finally:
            gateway.close()
    if lost:
        raise PeerLost(f"the router at {joining.connect} disconnected")
    return {"vehicles": named, **gateway.counts()}


def _follow(session: "Session", client: "RunClient", gateway: "RunGateway", stop: Stop) -> bool:
    """Serve the run until it ends or the user stops it; return True if the router disconnected."""
    from outrider.view.operator import SILENCE

    over_since, router = None, RouterTimer(session)
    while not stop:
        for message in client.news():
            gateway.take(message)
        gateway.silent = client.age > SILENCE  # without news, send no telemetry
        gateway.turn(_TURN)
        now = time.monotonic()
        over = client.status is not None and client.status.over
        over_since = (over_since or now) if over else None
        if over_since is not None and now - over_since > _LINGER:
            return False
        if router.has_gone():
            return True
    return False


def _summary(found: dict[str, Any]) -> str:
    count = sum(found.get("sent", {}).values())
    causes = ", ".join(f"{n} {cause}" for cause, n in found.get("refused", {}).items())
    return f"{count} messages sent, {found.get('received', 0)} received" + (
        f"; rejected: {causes}" if causes else ""
    )
