"""`outrider dashboard`: the live page of a run."""

from typing import TYPE_CHECKING, Annotated

import typer

from outrider.cli.options import (
    DEFAULT_ENDPOINT,
    DEFAULT_RUN,
    Connect,
    CredentialFile,
    NoPageToken,
    PagePort,
    PageToken,
    RunName,
    Watchdog,
)

if TYPE_CHECKING:
    import socket

    from bus.messages import Law

_NICE = 5
"""On a machine that is busy the run goes first."""


def command(
    connect: Connect = DEFAULT_ENDPOINT,
    run: RunName = DEFAULT_RUN,
    credentials: CredentialFile = None,
    host: Annotated[
        str, typer.Option(help="Address to serve the page on.", envvar="OUTRIDER_HOST")
    ] = "127.0.0.1",
    port: PagePort = 8080,
    token: PageToken = "",
    no_token: NoPageToken = False,
    law: Annotated[
        str, typer.Option(hidden=True, help="What the UAVs fly at first, with its gains, as JSON.")
    ] = "",
    listening: Annotated[
        int,
        typer.Option(
            hidden=True, help="Serve on this socket of the parent's, and say so on stdout."
        ),
    ] = -1,
    watchdog: Watchdog = False,
) -> None:
    """Show a run in the browser while it is flown, and steer it: pause, speed, law, driver, and a UGV's wheel.

    With the operator's credentials; with the observer's it only shows. Runs until Ctrl-C or SIGTERM. Needs no
    internet. The printed address lets in one browser, once, and another one asks for the token.
    `outrider run --dashboard` starts one with the run.

    Example: outrider dashboard --connect tcp/127.0.0.1:17447 --credentials credentials/operator.json
    """
    import os
    import sys

    from bus.keys import Role
    from bus.session import open_session
    from outrider.cli.console import ERR
    from outrider.cli.options import check_endpoint, staff_of
    from outrider.running.extras import check_extra
    from outrider.running.watchdog import start_watchdog
    from outrider.view.page.access.door import address_of, choose_admission

    if watchdog:
        start_watchdog()
    check_endpoint(connect)
    admission = choose_admission(host, token, wanted=not no_token)
    check_extra("dashboard")
    from outrider.view.page.app import serve
    from outrider.view.page.controls.run_card import Controls
    from outrider.view.page.hub import Hub
    from outrider.view.page.sources.live import Live

    party, credential = staff_of(credentials, Role.OPERATOR)
    os.nice(_NICE)
    with (
        _socket(listening, host, port) as opened,
        open_session(party, run, connect=connect, credential=credential) as session,
    ):
        line = address_of(opened, admission)

        def ready() -> None:
            if listening >= 0:
                sys.stdout.write(line + "\n")
                sys.stdout.flush()
            else:
                ERR.tell(f"the run {run} is shown at {line}")

        def on_end() -> None:
            if listening >= 0:  # the parent waits for it
                sys.stdout.write("over\n")
                sys.stdout.flush()

        hub = Hub(Live(session), _law(law), on_end)
        controls = (lambda: Controls(hub).show) if hub.source.may_steer else None
        serve(hub, opened, admission, controls=controls, ready=ready)


def _socket(number: int, host: str, port: int) -> "socket.socket":
    """The parent's, or one of our own."""
    import socket

    from outrider.view.page.access.door import open_socket

    return socket.socket(fileno=number) if number >= 0 else open_socket(host, port)


def _law(text: str) -> "Law | None":
    import msgspec

    from bus.messages import Law

    return msgspec.json.decode(text, type=Law) if text else None
