"""`outrider router`: the meeting point of processes in several containers or on several machines."""

from typing import Annotated

import typer

from outrider.cli.options import DEFAULT_ENDPOINT, Insecure, RouterCredentials, check_endpoints


def command(
    listen: Annotated[
        list[str] | None,
        typer.Option(help=f"Endpoint to listen on; {DEFAULT_ENDPOINT} by default; may be repeated.", envvar="OUTRIDER_LISTEN"),
    ] = None,
    credentials: RouterCredentials = None,
    insecure: Insecure = False,
) -> None:
    """Route messages between the processes of a run, and let each have its own keys only.

    Runs until Ctrl-C or SIGTERM. `outrider simulator` hosts a router itself; this one is for containers and several machines.

    Example: outrider router --listen tcp/0.0.0.0:17447 --credentials credentials/router.json
    """
    from bus.access import read_credentials
    from bus.session import open_router
    from outrider.cli.console import ERR
    from outrider.cli.stopping import stop_on_signals

    endpoints = tuple(listen or (DEFAULT_ENDPOINT,))
    given = None if credentials is None else read_credentials(credentials)
    check_endpoints(endpoints, secured=given is not None, insecure=insecure)
    with stop_on_signals() as stop, open_router(endpoints, given):
        who = "anybody" if given is None else f"{', '.join(c.name for c in given.parties)} in the run {given.run}"
        ERR.print(f"routing on {', '.join(endpoints)} for {who}", soft_wrap=True)
        stop.wait()
