"""`outrider mavlink`: a run for ground stations, and a UAV that is flown over MAVLink."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from outrider.cli.options import (
    DEFAULT_ENDPOINT,
    DEFAULT_RUN,
    Connect,
    CredentialFile,
    Insecure,
    Json,
    RunName,
    check_endpoints,
)

if TYPE_CHECKING:
    from bus.access import Credential
    from bus.messages import Status
    from bus.session import Session
    from outrider.bridges.mavlink.run_gateway import RunGateway
    from outrider.bridges.mavlink.udp import Network
    from outrider.cli.stopping import Stop
    from outrider.view.operator import RunClient

_OUT = "udpout:127.0.0.1:14550"
_LINGER = 0.6
"""The time for which a run that is over is still told [s]: one that is reset goes on."""
_ALONE = 3.0
"""After so long without a router it has gone [s]."""
_TURN = 0.02
"""The longest time between two looks at the run [s]."""


def command(
    out: Annotated[
        list[str] | None,
        typer.Option(
            metavar="udpout:HOST:PORT",
            help=f"A ground station that is told of the run; may be repeated. By default {_OUT}, "
            "where QGroundControl and MAVProxy listen, unless --in is given.",
        ),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            "--in",
            metavar="udpin:HOST:PORT",
            help="Where ground stations and programs may ask; may be repeated.",
        ),
    ] = None,
    connect: Connect = DEFAULT_ENDPOINT,
    run: RunName = DEFAULT_RUN,
    credentials: CredentialFile = None,
    first: Annotated[
        int,
        typer.Option("--first-system", help="Number of the first system.", min=1, max=200),
    ] = 1,
    height: Annotated[
        float,
        typer.Option(help="Height in m at which UAVs are told to fly: a run is flat.", min=0.0),
    ] = 10.0,
    insecure: Insecure = False,
    json: Json = False,
) -> None:
    """Show a run to MAVLink ground stations while it is flown: one system a vehicle, over UDP.

    Each tells HEARTBEAT, ATTITUDE, GLOBAL_POSITION_INT (from the scenario's origin), LOCAL_POSITION_NED, a UGV also
    FOLLOW_TARGET, and in texts what is lost or not certified and when it is well again. The run's settings are
    parameters. With the operator's credentials a ground station's sticks drive a UGV, and LAW, PAUSED and RT_FACTOR can
    be set; with the observer's it only shows. Ends with the run, or at Ctrl-C.

    Example: outrider mavlink --out udpout:127.0.0.1:14550 --credentials credentials/observer.json
    """
    from outrider.bridges.mavlink.udp import Network, parse_address
    from outrider.cli.console import ERR, print_json
    from outrider.cli.stopping import stop_on_signals

    check_endpoints((connect,), secured=True, insecure=False)
    told = [_OUT] if out is None and listen is None else out or []
    asked = listen or []
    _check_listening(asked, insecure=insecure)
    network = Network(
        [parse_address(text, listens=False) for text in told],
        [parse_address(text, listens=True) for text in asked],
    )
    began = time.monotonic()
    try:
        with stop_on_signals() as stop:
            found = _show(network, connect, run, _staff(credentials), stop, first, height)
    finally:
        network.close()
    found["seconds"] = time.monotonic() - began
    if json:
        print_json(found)
    else:
        ERR.print(_story(found), soft_wrap=True)


def _check_listening(addresses: list[str], *, insecure: bool) -> None:
    """Refuse to let strangers in by mistake: MAVLink knows no passwords.

    Raises:
        ScenarioError: If other machines reach an address.
    """
    from bus.errors import ScenarioError

    for address in addresses:
        host = address.split(":")[1] if address.count(":") == 2 else ""
        if host not in ("127.0.0.1", "localhost", "") and not insecure:
            raise ScenarioError(
                f"--in {address}: other machines reach it, and MAVLink knows no passwords; say --insecure if they may"
            )


def _staff(credentials: Path | None) -> "Credential | None":
    """The observer's or the operator's; None without a file or a password."""
    from bus.access import read_credential
    from bus.errors import AccessDenied
    from bus.keys import OBSERVER_NAME, Role
    from outrider.cli.options import credential_of

    if credentials is None:
        return credential_of(None, Role.OBSERVER, OBSERVER_NAME)
    found = read_credential(credentials)
    if found.role not in (Role.OPERATOR, Role.OBSERVER):
        raise AccessDenied(
            f"{credentials}: the credentials of {found.name} ({found.role}), not of an operator or observer"
        )
    return found


def _show(
    network: "Network",
    connect: str,
    run: str,
    credential: "Credential | None",
    stop: "Stop",
    first: int,
    height: float,
) -> dict[str, object]:
    """Tell a run until it is over or somebody wants the end; what was told."""
    from bus.errors import PeerLost
    from bus.keys import OPERATOR_NAME, Party, Role
    from bus.session import open_session
    from outrider.bridges.mavlink.run_gateway import RunGateway
    from outrider.cli.console import ERR
    from outrider.view.operator import RunClient

    # Without credentials everybody may do everything: then it is an operator.
    party = (
        Party(role=Role.OPERATOR, name=OPERATOR_NAME) if credential is None else credential.party
    )
    with open_session(party, run, connect=connect, credential=credential) as session:
        client = RunClient(session, maps=False)
        status = _await_run(client, run, stop)
        if status is None:
            client.close()
            return {"vehicles": {}}
        gateway = RunGateway(client, network, status, first=first, height=height)
        named = {system.name: number for number, system in gateway.systems.items()}
        ERR.print(
            f"the run {run}: {', '.join(f'system {n} is {name}' for name, n in named.items())}",
            soft_wrap=True,
        )
        try:
            lost = _follow(session, client, gateway, stop)
        finally:
            gateway.close()
    if lost:
        raise PeerLost(f"the router at {connect} has gone")
    return {"vehicles": named, **gateway.counts()}


def _await_run(client: "RunClient", run: str, stop: "Stop") -> "Status | None":
    """The first status that tells of the vehicles; None if a signal came before it."""
    from outrider.cli.console import ERR

    told, since = False, time.monotonic()
    while not stop:
        for _ in client.news():
            pass
        status = client.status
        if status is not None and status.geometry is not None:
            return status
        if not told and time.monotonic() - since > 1.0:
            told = True
            ERR.print(f"waiting for the simulator of the run {run}; Ctrl-C leaves", soft_wrap=True)
        time.sleep(_TURN)
    return None


def _follow(session: "Session", client: "RunClient", gateway: "RunGateway", stop: "Stop") -> bool:
    """Tell the run until it is over or somebody wants the end; whether it was the router that went."""
    from outrider.view.operator import SILENCE

    over_since = alone_since = None
    while not stop:
        for message in client.news():
            gateway.take(message)
        gateway.silent = client.age > SILENCE  # a vehicle of which nothing is known is not there
        gateway.turn(_TURN)
        now = time.monotonic()
        over = client.status is not None and client.status.over
        over_since = (over_since or now) if over else None
        alone_since = None if session.connected else alone_since or now
        if over_since is not None and now - over_since > _LINGER:
            return False
        if alone_since is not None and now - alone_since > _ALONE:
            return True
    return False


def _story(found: dict[str, object]) -> str:
    sent, refused = found.get("sent"), found.get("refused")
    count = sum(sent.values()) if isinstance(sent, dict) else 0
    causes = (
        ", ".join(f"{n} {cause}" for cause, n in refused.items())
        if isinstance(refused, dict)
        else ""
    )
    return f"{count} messages sent, {found.get('received', 0)} received" + (
        f"; refused: {causes}" if causes else ""
    )
