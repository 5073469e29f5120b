"""`outrider router`: router for processes in several containers or on several machines."""

from typing import TYPE_CHECKING, Annotated

import typer

from bus.credentials import read_credentials
from bus.errors import ScenarioError
from bus.joining import open_session
from bus.keys import OBSERVER_NAME, SIMULATOR_NAME, STATUS, Party, Role
from bus.messages.telemetry import Status
from bus.presence import Presence
from outrider.cli import options
from outrider.cli.console import ERR
from outrider.cli.stopping import Stop, stop_on_signals

if TYPE_CHECKING:
    from bus.session import Session


def command(
    listen: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Listen on this endpoint; default: {options.DEFAULT_ENDPOINT}; repeatable.",
            envvar="OUTRIDER_LISTEN",
        ),
    ] = None,
    credentials: options.RouterCredentials = None,
    run: options.RunName = options.DEFAULT_RUN,
    once: Annotated[
        bool,
        typer.Option("--once", help="Exit when the simulator reports the end of the run."),
    ] = False,
    insecure: options.Insecure = False,
) -> None:
    """Route the messages of a run; each party may use only its own keys.

    Runs until Ctrl-C or SIGTERM. `outrider simulator` hosts a router itself. Use this command for containers and for
    several machines.

    Example: outrider router --listen tcp/0.0.0.0:17447 --credentials credentials/router.json
    """
    endpoints = tuple(listen or (options.DEFAULT_ENDPOINT,))
    given = None if credentials is None else read_credentials(credentials)
    options.check_endpoints(endpoints, secured=given is not None, insecure=insecure)
    if given is not None and run not in (given.run, options.DEFAULT_RUN):
        raise ScenarioError(
            f"--run {run}: the credentials in {credentials} are for another run; allowed: {given.run}"
        )
    name = run if given is None else given.run
    observer = Party(role=Role.OBSERVER, name=OBSERVER_NAME)
    with (
        stop_on_signals() as stop,
        open_session(observer, name, listen=endpoints, given=given) as session,
    ):
        clients = (
            "any process"
            if given is None
            else ", ".join(credential.name for credential in given.parties)
        )
        ERR.tell(f"routing on {', '.join(endpoints)} for {clients} in the run {name}")
        if once:
            _until_over(session, stop)
        else:
            stop.wait()


def _until_over(session: "Session", stop: Stop) -> None:
    """Wait until the simulator has reported the end of the run and left; a simulator that fails may come back."""
    simulator = Presence(session, SIMULATOR_NAME)
    statuses = session.inbox(STATUS)
    over = False
    while not stop and not (over and not simulator.there):
        envelope = statuses.receive(0.5)
        if envelope is not None and isinstance(envelope.message, Status):
            over = envelope.message.over
