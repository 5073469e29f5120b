"""Options shared by several commands, and credentials and sessions made from them."""

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import msgspec
import typer

from bus.errors import AccessDenied, ScenarioError
from bus.keys import OPERATOR_NAME, Party, Role, check_run_name
from bus.locator import check_endpoint
from bus.messages.base import MAX_SEED
from bus.policies import policy_forms
from bus.profiles import PROFILES
from bus.registry import (
    DRIVERS,
    LAWS,
    described,
)

if TYPE_CHECKING:
    from agents.process import MakePilot
    from bus.credentials import Credential
    from bus.session import Session

ScenarioName = Annotated[str, typer.Argument(help="Name of a shipped scenario, or a TOML file.")]
Seed = Annotated[
    int | None,
    typer.Option(
        help="Set the seed of all random numbers; default: the scenario's.", min=0, max=MAX_SEED
    ),
]
Secret = Annotated[
    str,
    typer.Option(
        "--secret",
        metavar="@FILE|new|HEX",
        help="Set the run's secret: @FILE, `new`, or 32 to 128 hexadecimal digits.",
        envvar="OUTRIDER_SECRET",
    ),
]
Duration = Annotated[
    float | None, typer.Option(help="Set the simulated time in s; default: the scenario's.")
]
LawName = Annotated[
    str | None,
    typer.Option(
        "--law",
        help=f"Set the UAVs' law. {described(LAWS)}.",
    ),
]
DriverName = Annotated[
    str | None,
    typer.Option(
        "--driver",
        help=f"Set the UGVs' driver. {described(DRIVERS)}; or your own policy, policy:module:function or KIND:FILE.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set a field, such as detections.noise=0.2 or uav.*.max_speed=0.5; repeatable.",
    ),
]
Weighting = Annotated[
    str, typer.Option(help="Load a weighting for the law `weighted`, as module:function.")
]
PolicyName = Annotated[
    str,
    typer.Option(
        "--policy",
        help="Load a policy for the driver `policy`: module:function, module:object or KIND:FILE.",
    ),
]
UavPolicyName = Annotated[
    str,
    typer.Option(
        "--uav-policy",
        metavar="POLICY",
        help="Load a policy for `certified` or `policy`: module:function or KIND:FILE.",
    ),
]
FlownPolicy = Annotated[
    str,
    typer.Option(
        "--uav-policy",
        metavar="POLICY",
        help=f"Fly the UAVs by {policy_forms('uav')}; inside the safety filter, unless --law policy.",
    ),
]
NetworkName = Annotated[
    str,
    typer.Option(
        "--network",
        help=f"Set the profile of all radio links: {', '.join(PROFILES)}.",
    ),
]
AllowCode = Annotated[
    bool,
    typer.Option(
        "--allow-code",
        help="Load code named in the scenario file.",
    ),
]
VirtualPath = Annotated[
    str, typer.Option("--path", help="Load a path for the law `path`, as module:function.")
]
Json = Annotated[bool, typer.Option("--json", help="Print only a JSON object on stdout.")]
Child = Annotated[
    bool,
    typer.Option(
        hidden=True,
        help="Run as a child of `outrider run`, controlled over stdin.",
    ),
]


def _run_name(name: str) -> str:
    try:
        return check_run_name(name)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


RunName = Annotated[
    str,
    typer.Option(
        "--run", help="Set the name of the run.", envvar="OUTRIDER_RUN", callback=_run_name
    ),
]

Connect = Annotated[
    str, typer.Option(help="Connect to the router at this endpoint.", envvar="OUTRIDER_CONNECT")
]
CredentialFile = Annotated[
    Path | None,
    typer.Option(
        "--credentials",
        help="Read this process's name and password from this file.",
        envvar="OUTRIDER_CREDENTIALS",
    ),
]
RouterCredentials = Annotated[
    Path | None,
    typer.Option(
        "--credentials",
        help="Read all parties' credentials from this file (router.json).",
        envvar="OUTRIDER_CREDENTIALS",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Listen beyond this machine without credentials; any process can join.",
    ),
]
Record = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Record every tick to this MCAP file; needs the extra [record]."
    ),
]
JoinTimeout = Annotated[
    float,
    typer.Option(
        help="Wait this many seconds for a disconnected simulator or router.",
        min=0.0,
        envvar="OUTRIDER_JOIN_TIMEOUT",
    ),
]
RealTime = Annotated[
    float | None,
    typer.Option(
        "--realtime",
        metavar="F",
        help="Run at F simulated seconds per second; 0 (default): lockstep.",
        envvar="OUTRIDER_REALTIME",
        min=0.0,
        max=1e4,
    ),
]
FlightNumber = Annotated[
    int | None,
    typer.Option(help="Select a flight of a reset run, from 0; default: the last."),
]
Companions = Annotated[
    list[str] | None,
    typer.Option(
        "--with",
        metavar="NAME[:OPTION=VALUE,...]",
        help="Start a companion, such as dashboard:port=9000; repeatable.",
    ),
]


DEFAULT_ENDPOINT = "tcp/127.0.0.1:17447"
DEFAULT_RUN = "flight"


def with_respawn(changes: list[str] | None, *, respawn: bool) -> list[str]:
    """Return the changes of `--set`, with the one that `--respawn` stands for."""
    return [*(changes or ()), *(["run.respawn=true"] if respawn else [])]


def secret_of(given: str, *, wanted: bool = False) -> str:
    """Return the run's secret.

    Args:
        given: Value of the option: @FILE, `new`, hexadecimal digits, or empty.
        wanted: True: make a secret if the option is empty.

    Raises:
        ScenarioError: If the secret is invalid, or its file cannot be read.
    """
    from sim.engine.run_keys import check_secret, new_secret

    if given == "new" or (wanted and not given):
        return new_secret()
    source = "--secret"
    if given.startswith("@"):
        source = given[1:]
        try:
            with Path(source).open(encoding="ascii") as file:
                given = file.read(1000).strip()
        except (OSError, UnicodeDecodeError) as error:
            raise ScenarioError(
                f"--secret {source}: {getattr(error, 'strerror', '') or 'not a text file'}"
            ) from error
        if not given:
            raise ScenarioError(
                f"--secret {source}: the file is empty; allowed: 32 to 128 hexadecimal digits"
            )
    try:
        return check_secret(given, source)
    except ValueError as error:
        raise ScenarioError(str(error)) from error


def check_endpoints(endpoints: tuple[str, ...], *, secured: bool, insecure: bool) -> None:
    """Check that no other machine can join without credentials by mistake.

    Raises:
        ScenarioError: If an endpoint is invalid, or other machines reach it without credentials.
    """
    for endpoint in endpoints:
        if not (check_endpoint(endpoint).is_local or secured or insecure):
            raise ScenarioError(
                f"endpoint {endpoint}: other machines can join, and there are no credentials; "
                "make them with `outrider credentials`, or add --insecure"
            )


def staff_of(file: Path | None, role: Role) -> "tuple[Party, Credential | None]":
    """Return the operator or observer whose credentials a file holds, with the credentials.

    Args:
        file: File of credentials; None: use the password of this process, if any.
        role: Role of the password's party. Without a password, all parties have all rights, and the operator is
            returned.

    Raises:
        AccessDenied: If the file belongs to a party of another role.
    """
    from bus.credentials import read_credential

    found = credential_of(None, role, role.value) if file is None else read_credential(file)
    if found is None:
        return Party(role=Role.OPERATOR, name=OPERATOR_NAME), None
    if found.role not in (Role.OPERATOR, Role.OBSERVER):
        raise AccessDenied(
            f"{file}: credentials of {found.name} ({found.role}); allowed: an operator or observer"
        )
    return found.party, found


class Joining(NamedTuple):
    """Arguments with which a process joins a run."""

    party: Party
    connect: str
    run: str
    credential: "Credential | None"
    join_timeout: float
    """Longest wait for a router or simulator [s]."""

    def session(self) -> "AbstractContextManager[Session]":
        """Open the session; errors as in `open_session`."""
        from bus.joining import open_session

        return open_session(
            self.party,
            self.run,
            connect=self.connect,
            credential=self.credential,
            join_timeout=self.join_timeout,
        )

    def fly(self, make_pilot: "MakePilot") -> int:
        """Fly the vehicle until the run is over; result and errors as in `agents.process.fly`."""
        from agents.process import fly

        return fly(
            self.party,
            make_pilot,
            connect=self.connect,
            run=self.run,
            credential=self.credential,
            join_timeout=self.join_timeout,
        )


def joining(
    role: str, name: str, connect: str, run: str, file: Path | None, join_timeout: float
) -> Joining:
    """Return the arguments with which a party joins; errors as in `check_endpoint`, `party_of`, `credential_of`."""
    from bus.roles import party_of

    check_endpoint(connect)
    credential = credential_of(file, role, name)
    return Joining(party_of(role, name), connect, run, credential, join_timeout)


def join(
    role: str, run: str, connect: str, file: Path | None, join_timeout: float = 10.0
) -> "AbstractContextManager[Session]":
    """Open the session of a run's operator, observer or bridge; errors as in `joining`."""
    return joining(role, str(role), connect, run, file, join_timeout).session()


def credential_of(file: Path | None, role: str, name: str) -> "Credential | None":
    """Return this process's credential, from its file or from OUTRIDER_PASSWORD; None without either.

    Raises:
        AccessDenied: If the file belongs to another party.
        ScenarioError: If the password is invalid.
    """
    from bus.credentials import Credential, read_credential

    if file is not None:
        found = read_credential(file)
        if (found.role, found.name) != (role, name):
            raise AccessDenied(
                f"{file}: credentials of {found.name} ({found.role}); allowed: {name} ({role})"
            )
        return found
    password = os.environ.get("OUTRIDER_PASSWORD")
    if not password:
        return None
    try:
        return msgspec.convert({"name": name, "role": str(role), "password": password}, Credential)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"OUTRIDER_PASSWORD or name: {error}") from error


def size_of(path: Path) -> int:
    """Return the size of a file, or of all files in a folder [bytes]."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.iterdir() if file.is_file())


def help_without_command(context: typer.Context) -> None:
    """Print the help of a command group and exit with 2, if no command is given."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(2)
