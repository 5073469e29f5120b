"""`outrider dashboard`: live web page of a run."""

import os
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bus.keys import OPERATOR_NAME, Party, Role
from bus.locator import check_endpoint
from bus.plugins import require
from outrider.cli import options

_Port = Annotated[
    int,
    typer.Option(
        "--port",
        help="Port to serve the page on; 0: any free port.",
        min=0,
        max=65535,
        envvar="OUTRIDER_PORT",
    ),
]

_Token = Annotated[
    str,
    typer.Option(
        "--token",
        help="Set the access token; safer in OUTRIDER_TOKEN than on the command line.",
        envvar="OUTRIDER_TOKEN",
        show_default=False,
        show_envvar=True,
    ),
]
_NoToken = Annotated[
    bool,
    typer.Option(
        "--no-token",
        help="Serve the page without a token, on a single-user machine.",
        envvar="OUTRIDER_NO_TOKEN",
    ),
]

_Proxy = Annotated[
    str,
    typer.Option(
        "--proxy",
        metavar="ADDRESSES",
        help="Trust proxies at these addresses or networks, besides local ones.",
        envvar="OUTRIDER_PROXY",
        show_default=False,
    ),
]

if TYPE_CHECKING:
    from outrider.recording.reader import Recording
    from outrider.running.parent import Start
    from outrider_dashboard.address import Access

_NICE = 5
"""Lower priority than the run on a busy machine."""


def command(
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    host: Annotated[
        str, typer.Option(help="Address to serve the page on.", envvar="OUTRIDER_HOST")
    ] = "127.0.0.1",
    port: _Port = 8080,
    token: _Token = "",
    no_token: _NoToken = False,
    proxy: _Proxy = "",
    replay: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Play this recording instead of a live run."),
    ] = None,
    flight: options.FlightNumber = None,
    realtime: Annotated[
        float,
        typer.Option(
            metavar="F",
            help="Set the playback speed, in simulated seconds per second.",
            min=0.01,
            max=1e6,
        ),
    ] = 1.0,
    child: options.Child = False,
) -> None:
    """Show a run live in the browser, and control it.

    With the operator's credentials, users can pause the run, change its speed, law, driver and links, and drive a UGV.
    With the observer's credentials, the page is read-only. Open the printed address, which contains the access token:
    20 to 128 letters, digits, '_' and '-', random by default. Other users of this machine can read a token on the
    command line, but not in OUTRIDER_TOKEN. The page needs no internet access. A proxy states its
    path in X-Forwarded-Prefix and TLS in X-Forwarded-Proto. Ends at Ctrl-C or SIGTERM.
    `outrider run --with dashboard` starts the dashboard together with the run.

    Example: outrider dashboard --connect tcp/127.0.0.1:17447 --credentials credentials/operator.json
    """
    from outrider.running.parent import read_start
    from outrider_dashboard.address import Access, choose_token, open_socket, trusted_proxies

    start = read_start() if child else None
    check_endpoint(connect)
    access = Access(choose_token(host, token, wanted=not no_token), trusted_proxies(proxy))
    require("dashboard")
    if replay is not None:
        from outrider.recording.reader import flight_of

        _show_recording(flight_of(replay, flight), realtime, host, port, access)
        return
    party, credential = (
        (Party(role=Role.OPERATOR, name=OPERATOR_NAME), start.credential)
        if start is not None
        else options.staff_of(credentials, Role.OPERATOR)
    )
    os.nice(_NICE)
    with open_socket(host, port) as opened:
        joining = options.Joining(party, connect, run, credential, 10.0)
        _show_run(joining, opened, access, start)


def _show_run(
    joining: options.Joining, opened: socket.socket, access: "Access", start: "Start | None"
) -> None:
    """Serve the page of a run; as a child process, report on standard output when it is ready and over."""
    from outrider.cli.console import ERR
    from outrider_dashboard.address import address_of
    from outrider_dashboard.app import serve
    from outrider_dashboard.controls.run_card import Controls
    from outrider_dashboard.hub import Hub
    from outrider_dashboard.sources.live import LiveRun

    line = f"dashboard of the run: {address_of(opened, access.token)}"

    def report(text: str) -> None:
        if start is None:
            ERR.tell(text)
        else:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()

    def on_end() -> None:
        if start is not None:
            report("over")

    with joining.session() as session:
        hub = Hub(LiveRun(session), start.law if start is not None else None, on_end)
        controls = (lambda: Controls(hub).show) if hub.source.may_steer else None
        serve(hub, opened, access, controls=controls, ready=lambda: report(line))


def _show_recording(
    recording: "Recording", speed: float, host: str, port: int, access: "Access"
) -> None:
    from outrider.cli.console import ERR
    from outrider_dashboard.address import address_of, open_socket
    from outrider_dashboard.app import serve
    from outrider_dashboard.controls.player import Player
    from outrider_dashboard.hub import Hub
    from outrider_dashboard.sources.recorded import RecordedRun

    with open_socket(host, port) as opened:
        recorded = RecordedRun(recording, speed)
        hub = Hub(recorded)
        line = (
            f"dashboard of {recording.path}: {address_of(opened, access.token)} (stop with Ctrl-C)"
        )
        serve(
            hub,
            opened,
            access,
            controls=lambda: Player(hub, recorded).show,
            ready=lambda: ERR.tell(line),
        )
