"""`outrider dashboard`: the live page of a run."""

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
        help="Where the page is served; 0 takes any that is free.",
        min=0,
        max=65535,
        envvar="OUTRIDER_PORT",
    ),
]

_Token = Annotated[
    str,
    typer.Option(
        "--token",
        help="Token that opens the page: 20 to 128 letters, digits, '_' and '-'; random by "
        "default. Other users of this machine see a command line, but not OUTRIDER_TOKEN.",
        envvar="OUTRIDER_TOKEN",
        show_default=False,
        show_envvar=True,
    ),
]
_NoToken = Annotated[
    bool,
    typer.Option(
        "--no-token",
        help="Open the page without a token, on a machine with one user.",
        envvar="OUTRIDER_NO_TOKEN",
    ),
]

if TYPE_CHECKING:
    from outrider.recording.reader import Recording
    from outrider.running.parent import Start

_NICE = 5
"""On a machine that is busy the run goes first."""


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
    replay: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Play this recording instead, with a slider over time."),
    ] = None,
    flight: options.FlightNumber = None,
    realtime: Annotated[
        float,
        typer.Option(
            metavar="F",
            help="Speed of a recording, in simulated seconds a second.",
            min=0.01,
            max=1e6,
        ),
    ] = 1.0,
    child: options.Child = False,
) -> None:
    """Show a run in the browser while it is flown, and steer it.

    Pause, speed, law, driver, and a UGV's wheel are steered with the operator's credentials; with the observer's it
    only shows. Runs until Ctrl-C or SIGTERM. Needs no internet. The printed address contains a token that opens the
    page. `outrider run --with dashboard` starts one with the run.

    Example: outrider dashboard --connect tcp/127.0.0.1:17447 --credentials credentials/operator.json
    """
    from outrider.running.parent import read_start
    from outrider_dashboard.address import choose_token, open_socket

    start = read_start() if child else None
    check_endpoint(connect)
    token = choose_token(host, token, wanted=not no_token)
    require("dashboard")
    if replay is not None:
        from outrider.recording.reader import flight_of

        _show_recording(flight_of(replay, flight), realtime, host, port, token)
        return
    party, credential = (
        (Party(role=Role.OPERATOR, name=OPERATOR_NAME), start.credential)
        if start is not None
        else options.staff_of(credentials, Role.OPERATOR)
    )
    os.nice(_NICE)
    with open_socket(host, port) as opened:
        joining = options.Joining(party, connect, run, credential, 10.0)
        _show_run(joining, opened, token, start)


def _show_run(
    joining: options.Joining, opened: socket.socket, token: str, start: "Start | None"
) -> None:
    """Serve the page of a run; as a child of the run, write to standard output when it is ready and over."""
    from outrider.cli.console import ERR
    from outrider_dashboard.address import address_of
    from outrider_dashboard.app import serve
    from outrider_dashboard.controls.run_card import Controls
    from outrider_dashboard.hub import Hub
    from outrider_dashboard.sources.live import Live

    line = f"the run is shown at {address_of(opened, token)}"

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
        hub = Hub(Live(session), start.law if start is not None else None, on_end)
        controls = (lambda: Controls(hub).show) if hub.source.may_steer else None
        serve(hub, opened, token, controls=controls, ready=lambda: report(line))


def _show_recording(recording: "Recording", speed: float, host: str, port: int, token: str) -> None:
    from outrider.cli.console import ERR
    from outrider_dashboard.address import address_of, open_socket
    from outrider_dashboard.app import serve
    from outrider_dashboard.controls.player import Player
    from outrider_dashboard.hub import Hub
    from outrider_dashboard.sources.tape import Tape

    with open_socket(host, port) as opened:
        tape = Tape(recording, speed)
        hub = Hub(tape)
        line = f"{recording.path} is played at {address_of(opened, token)}; Ctrl-C ends it"
        serve(
            hub,
            opened,
            token,
            controls=lambda: Player(hub, tape).show,
            ready=lambda: ERR.tell(line),
        )
