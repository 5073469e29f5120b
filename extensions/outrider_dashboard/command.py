"""`outrider dashboard`: the live page of a run."""

import os
import socket
import sys
from typing import Annotated

import msgspec
import typer

from bus.keys import OPERATOR_NAME, Party, Role
from bus.locator import check_endpoint
from bus.messages import Law
from bus.plugins import require
from outrider.cli import options

_NICE = 5
"""On a machine that is busy the run goes first."""


def command(
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    host: Annotated[
        str, typer.Option(help="Address to serve the page on.", envvar="OUTRIDER_HOST")
    ] = "127.0.0.1",
    port: options.PagePort = 8080,
    token: options.PageToken = "",
    no_token: options.NoPageToken = False,
    law: Annotated[
        str, typer.Option(hidden=True, help="What the UAVs fly at first, with its gains, as JSON.")
    ] = "",
    listening: Annotated[
        int,
        typer.Option(
            hidden=True, help="Serve on this socket of the parent's, and say so on stdout."
        ),
    ] = -1,
    child: options.Child = False,
) -> None:
    """Show a run in the browser while it is flown, and steer it.

    Pause, speed, law, driver, and a UGV's wheel are steered with the operator's credentials; with the observer's it
    only shows. Runs until Ctrl-C or SIGTERM. Needs no internet. The printed address contains a token that opens the
    page. `outrider run --dashboard` starts one with the run.

    Example: outrider dashboard --connect tcp/127.0.0.1:17447 --credentials credentials/operator.json
    """
    from bus.session import open_session
    from outrider.cli.console import ERR
    from outrider.running.parent import read_start
    from outrider_dashboard.address import address_of, choose_token, open_socket

    start = read_start() if child else None
    check_endpoint(connect)
    token = choose_token(host, token, wanted=not no_token)
    require("dashboard")
    from outrider_dashboard.app import serve
    from outrider_dashboard.controls.run_card import Controls
    from outrider_dashboard.hub import Hub
    from outrider_dashboard.sources.live import Live

    party, credential = (
        (Party(role=Role.OPERATOR, name=OPERATOR_NAME), start.credential)
        if start is not None
        else options.staff_of(credentials, Role.OPERATOR)
    )
    os.nice(_NICE)
    has_parent = listening >= 0
    with (
        socket.socket(fileno=listening) if has_parent else open_socket(host, port) as opened,
        open_session(party, run, connect=connect, credential=credential) as session,
    ):
        line = address_of(opened, token)

        def ready() -> None:
            if has_parent:
                sys.stdout.write(line + "\n")
                sys.stdout.flush()
            else:
                ERR.tell(f"the run {run} is shown at {line}")

        def on_end() -> None:
            if has_parent:  # the parent waits for it
                sys.stdout.write("over\n")
                sys.stdout.flush()

        first_law = msgspec.json.decode(law, type=Law) if law else None
        hub = Hub(Live(session), first_law, on_end)
        controls = (lambda: Controls(hub).show) if hub.source.may_steer else None
        serve(hub, opened, token, controls=controls, ready=ready)
