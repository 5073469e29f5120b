"""`outrider dashboard`: the live page of a run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from outrider.cli.options import DEFAULT_ENDPOINT, DEFAULT_RUN, Connect, CredentialFile, RunName

if TYPE_CHECKING:
    from bus.access import Credential

_NICE = 5
"""On a machine that is busy the run goes first."""


def command(
    connect: Connect = DEFAULT_ENDPOINT,
    run: RunName = DEFAULT_RUN,
    credentials: CredentialFile = None,
    host: Annotated[
        str, typer.Option(help="Address to serve the page on; beyond this machine only with a token.", envvar="OUTRIDER_HOST")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0 takes any that is free.", min=0, max=65535, envvar="OUTRIDER_PORT")] = 8080,
    token: Annotated[
        str, typer.Option(help="What a browser must know: 8 to 128 letters, digits, '_' and '-'.", envvar="OUTRIDER_TOKEN")
    ] = "",
) -> None:
    """Show a run in the browser while it is flown, and steer it: pause, speed, law, driver, and a UGV's wheel.

    With the operator's credentials; with the observer's it only shows. Runs until Ctrl-C or SIGTERM. Needs no internet.

    Example: outrider dashboard --connect tcp/127.0.0.1:17447 --credentials credentials/operator.json
    """
    import os

    from bus.errors import ScenarioError
    from bus.keys import OPERATOR_NAME, Party, Role
    from bus.session import open_session
    from outrider.cli.console import ERR
    from outrider.cli.options import check_endpoints

    check_endpoints((connect,), secured=True, insecure=False)
    _check_token(host, token)
    try:
        from outrider.dashboard.app import open_socket, serve
    except ModuleNotFoundError as error:
        raise ScenarioError(f"{error.name} is missing: pip install 'outrider[dashboard]'") from error
    credential = _credential(credentials)
    os.nice(_NICE)
    party = Party(role=Role.OPERATOR, name=OPERATOR_NAME) if credential is None else credential.party
    with open_socket(host, port) as listening, open_session(party, run, connect=connect, credential=credential) as session:
        bound = listening.getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        line = f"the run {run} is shown at http://{shown}:{bound}" + (" to whoever has the token" if token else "")
        serve(session, listening, token, ready=lambda: ERR.print(line, soft_wrap=True))


def _check_token(host: str, token: str) -> None:
    import re

    from bus.errors import ScenarioError
    from outrider.dashboard import LOOPBACK

    if token and not re.fullmatch(r"[A-Za-z0-9_-]{8,128}", token):
        raise ScenarioError("--token: allowed are 8 to 128 letters, digits, '_' and '-'")
    if not token and host not in LOOPBACK:
        raise ScenarioError(f"--host {host}: other machines reach it, and there is no token; give one with --token")


def _credential(file: Path | None) -> "Credential | None":
    """The operator's or the observer's; None without a file or a password."""
    from bus.access import read_credential
    from bus.errors import AccessDenied
    from bus.keys import OPERATOR_NAME, Role
    from outrider.cli.options import credential_of

    if file is None:
        return credential_of(None, Role.OPERATOR, OPERATOR_NAME)
    found = read_credential(file)
    if found.role not in (Role.OPERATOR, Role.OBSERVER):
        raise AccessDenied(f"{file}: the credentials of {found.name} ({found.role}), not of an operator or observer")
    return found
