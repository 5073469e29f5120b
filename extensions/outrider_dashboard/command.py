"""`outrider dashboard`: live web page of a run."""

import os
from pathlib import Path
from typing import Annotated

import typer

from bus.keys import OPERATOR_NAME, Party, Role
from bus.locator import check_endpoint
from bus.plugins import require
from outrider.cli import options
from outrider.cli.joining import Joining, staff_of
from outrider.running.parent import read_start
from outrider_dashboard.address import Access, choose_token, open_socket, trusted_proxies

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
    scenario: Annotated[
        str, typer.Option(help="Name the run's scenario, for its network budget.")
    ] = "",
    changes: options.Set = None,
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
    start = read_start() if child else None
    check_endpoint(connect)
    access = Access(choose_token(host, token, wanted=not no_token), trusted_proxies(proxy))
    require("dashboard")
    if replay is not None:
        from outrider_dashboard.playback import show_recording  # noqa: PLC0415 - two extras

        show_recording(replay, flight, realtime, host, port, access)
        return
    party, credential = (
        (Party(role=Role.OPERATOR, name=OPERATOR_NAME), start.credential)
        if start is not None
        else staff_of(credentials, Role.OPERATOR)
    )
    known = _resolved(scenario, changes)
    os.nice(_NICE)
    with open_socket(host, port) as opened:
        from outrider_dashboard.serving import show_run  # noqa: PLC0415 - the extra [dashboard]

        joining = Joining(party, connect, run, credential, 10.0)
        show_run(joining, opened, access, start, known)


def _resolved(scenario: str, changes: list[str] | None) -> str:
    """Return the resolved scenario as TOML; empty without a scenario."""
    if not scenario:
        return ""
    from outrider.running.resolve import resolve  # noqa: PLC0415 - the compiler
    from sim.scenario.resolved import as_toml  # noqa: PLC0415 - the compiler

    return as_toml(resolve(scenario, changes=changes)[0])
