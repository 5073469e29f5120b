"""`outrider mavlink`: a run for ground stations, and a UAV that is flown over MAVLink."""

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
"""The time for which a run that is over is still told [s]: one that is reset goes on."""
_NICE = 5
"""On a machine that is busy the run goes first."""
_TRUTH = "telemetry, the truth among it,"
_TURN = 0.02
"""The longest time between two looks at the run [s]."""

_Out = Annotated[
    list[str] | None,
    typer.Option(
        "--to",
        metavar="HOST:PORT",
        help=f"A ground station that is told of the run; may be repeated. By default {_OUT}, "
        "where QGroundControl and MAVProxy listen, and with --vehicle "
        f"{_OFFBOARD}, where MAVSDK does; neither if --in or --autopilot is given.",
    ),
]
_Listen = Annotated[
    list[str] | None,
    typer.Option(
        "--in",
        metavar="HOST:PORT",
        help="Where ground stations and programs may ask; may be repeated. With --autopilot "
        f"by default {_AUTOPILOT}, to which PX4 sends.",
    ),
]
_Private = Annotated[
    bool,
    typer.Option(
        "--private",
        help="Send to a random port of this machine, and print it, instead of the usual one.",
    ),
]
_Vehicle = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Join as this UAV, with its credentials, and fly it by setpoints inside the safety filter.",
    ),
]
_Autopilot = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Join as this UAV, and let a real autopilot fly along: its telemetry in, its setpoints out.",
    ),
]
_First = Annotated[
    int,
    typer.Option("--first-system", help="Number of the first vehicle's system.", min=1, max=200),
]
_Height = Annotated[
    float,
    typer.Option(help="Height in m at which UAVs are told to fly: a run is flat.", min=0.0),
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
    """Show a run to MAVLink ground stations, or fly a UAV by it.

    While it is flown each vehicle is a system. Each tells HEARTBEAT, ATTITUDE, GLOBAL_POSITION_INT (from the scenario's
    origin), LOCAL_POSITION_NED, a UGV also FOLLOW_TARGET, and in texts what is lost or not certified and when it is
    well again. The run's settings are parameters. With the operator's credentials a ground station's sticks drive a
    UGV, and LAW, PAUSED and RT_FACTOR can be set; with the observer's it only shows. Ends with the run, or at Ctrl-C.

    With --vehicle it is that UAV's process, in the place of `outrider uav`: in the mode OFFBOARD it flies
    SET_POSITION_TARGET_LOCAL_NED (velocity, acceleration), in HOLD it stays, in MISSION and where no setpoint has come
    for the scenario's `command_timeout` the run's law flies; the safety filter watches over all of them.

    With --autopilot the run's law flies that UAV, and an autopilot is its inner loop: it is told where the UAV is to
    be, and where it is farther off than `certificate.max_tracking_error` declares, or silent, the UAV stays and
    nothing is certified. It must be armed and in the air, and listen to setpoints; the run must keep real time.

    Example: outrider mavlink --to 127.0.0.1:14550 --credentials credentials/observer.json

    Example: outrider mavlink --vehicle uav_0 --to 127.0.0.1:14540 --credentials credentials/uav_0.json
    """
    from outrider.cli.console import print_json
    from outrider_mavlink.identity import VehicleSystem
    from outrider_mavlink.udp import private_port

    check_endpoint(connect)
    if vehicle and autopilot:
        raise typer.BadParameter("--vehicle or --autopilot, not both")
    if private and (out or autopilot):
        raise typer.BadParameter(f"--private or {'--to' if out else '--autopilot'}, not both")
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
            found = _fly(network, system, joining) if vehicle else _fly_along(network, joining)
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
        sys.stderr.write(_story(found) + "\n")


def _open_network(
    what: str, told: list[str], asked: list[str], *, private: bool, insecure: bool
) -> "Network":
    """Open the sockets that tell and are asked, after it is said what goes where.

    Raises:
        ScenarioError: If an address is not one, or strangers reach it.
    """
    from outrider_mavlink.udp import Network, parse_address

    listening = {text: parse_address(text, listens=True) for text in asked}
    _check_listening(listening, insecure=insecure)
    telling = [parse_address(text, listens=False) for text in told]
    network = Network(telling, list(listening.values()))
    _say_where(what, told, asked, private=private)
    return network


def _say_where(what: str, told: list[str], asked: list[str], *, private: bool) -> None:
    """Print first what goes where: over UDP, to whichever process is there."""
    if told:
        chosen = "" if private else "; --private chooses a random port, --to HOST:PORT another"
        sys.stderr.write(
            f"sends {what} to {', '.join(told)}: to the process that listens there, of whatever user{chosen}\n"
        )
    if asked:
        sys.stderr.write(
            f"sends {what} to the processes, of whatever user, that ask at {', '.join(asked)}\n"
        )


def _join(
    joining: options.Joining, make: "MakePilot", gateway: "OffboardGateway | AutopilotLink"
) -> None:
    """Fly a UAV until the run is over, and serve MAVLink beside it."""
    from agents.process import warm_up
    from outrider_mavlink.offboard import serving

    warm_up(Role.UAV, inner=lambda _observation: (0.0, 0.0))
    with serving(gateway):
        joining.fly(make)


def _fly(network: "Network", system: "VehicleSystem", joining: options.Joining) -> dict[str, Any]:
    """Fly a UAV by setpoints until the run is over; what became of them."""
    from outrider_mavlink.dialect import mavlink
    from outrider_mavlink.offboard import OffboardGateway, OffboardPilot

    system.capabilities |= mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    pilot = OffboardPilot()
    gateway = OffboardGateway(pilot, network, system)
    _join(joining, pilot.make, gateway)
    gateway.say(system, "the run is over")
    return {"vehicles": {system.name: system.number}, **gateway.counts()}


def _fly_along(network: "Network", joining: options.Joining) -> dict[str, Any]:
    """Let an autopilot fly along with a UAV until the run is over; what became of it."""
    from outrider_mavlink.autopilot import AutopilotLink, AutopilotPilot

    link = AutopilotLink(network)
    pilot = AutopilotPilot(link)
    began, told = time.monotonic(), False
    while link.reported is None:  # the run is not to begin without it
        link.turn(_TURN)
        link.refresh()
        if not told and time.monotonic() - began > 1.0:
            told = True
            sys.stderr.write("waiting for the telemetry of an autopilot; Ctrl-C leaves\n")
    _join(joining, pilot.make, link)
    vehicles = {joining.party.name: 0 if link.peer is None else link.peer.system}
    found = {"vehicles": vehicles, "sent": dict(network.sent), "received": link.reports}
    return found | pilot.counts()


def _check_listening(addresses: "dict[str, Address]", *, insecure: bool) -> None:
    """Refuse to let strangers in by mistake: MAVLink knows no passwords.

    Raises:
        ScenarioError: If other machines reach an address.
    """
    for text, address in addresses.items():
        if not (insecure or address.host in LOOPBACK):
            raise ScenarioError(
                f"--in {text}: other machines reach it, and MAVLink knows no passwords; say --insecure if they may"
            )


def _show(
    network: "Network",
    joining: options.Joining,
    stop: Stop,
    first: int,
    height: float,
) -> dict[str, Any]:
    """Tell a run until it is over or somebody wants the end; what was told."""
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
            f"the run {joining.run}: {', '.join(f'system {n} is {name}' for name, n in named.items())}"
        )
        try:
            lost = _follow(session, client, gateway, stop)
        finally:
            gateway.close()
    if lost:
        raise PeerLost(f"the router at {joining.connect} has gone")
    return {"vehicles": named, **gateway.counts()}


def _follow(session: "Session", client: "RunClient", gateway: "RunGateway", stop: Stop) -> bool:
    """Tell the run until it is over or somebody wants the end; whether it was the router that went."""
    from outrider.view.operator import SILENCE

    over_since, router = None, RouterTimer(session)
    while not stop:
        for message in client.news():
            gateway.take(message)
        gateway.silent = client.age > SILENCE  # a vehicle of which nothing is known is not there
        gateway.turn(_TURN)
        now = time.monotonic()
        over = client.status is not None and client.status.over
        over_since = (over_since or now) if over else None
        if over_since is not None and now - over_since > _LINGER:
            return False
        if router.has_gone():
            return True
    return False


def _story(found: dict[str, Any]) -> str:
    count = sum(found.get("sent", {}).values())
    causes = ", ".join(f"{n} {cause}" for cause, n in found.get("refused", {}).items())
    return f"{count} messages sent, {found.get('received', 0)} received" + (
        f"; refused: {causes}" if causes else ""
    )
