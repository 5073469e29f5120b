"""Options that several commands share, and how they become a scenario."""

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import msgspec
import typer

from bus.errors import AccessDenied, ScenarioError
from bus.keys import OPERATOR_NAME, Party, Role, check_run_name
from bus.locator import check_endpoint
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

ScenarioName = Annotated[str, typer.Argument(help="A shipped scenario's name, or a TOML file.")]
Seed = Annotated[
    int | None,
    typer.Option(
        help="Seed of all random numbers; the scenario's own by default.", min=0, max=2**53 - 1
    ),
]
Secret = Annotated[
    str,
    typer.Option(
        "--secret",
        metavar="@FILE|new|HEX",
        help="The run's secret, which no vehicle is told: @FILE that holds it, `new` to make one, "
        "or 32 to 128 hexadecimal digits, which other users of this machine would see in the list "
        "of processes.",
        envvar="OUTRIDER_SECRET",
    ),
]
Duration = Annotated[
    float | None, typer.Option(help="Simulated time in s, instead of the scenario's.")
]
LawName = Annotated[
    str | None,
    typer.Option(
        "--law",
        help=f"The UAVs' law. {described(LAWS)}.",
    ),
]
DriverName = Annotated[
    str | None,
    typer.Option(
        "--driver",
        help=f"The UGVs' driver. {described(DRIVERS)}; or a saved policy, as fmu:FILE.fmu.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Any field of the scenario, such as detections.noise=0.2 or uav.*.max_speed=0.5; may be repeated.",
    ),
]
Weighting = Annotated[
    str, typer.Option(help="A weighting of your own as module:function, for the law `weighted`.")
]
PolicyName = Annotated[
    str,
    typer.Option(
        "--policy",
        help="For the driver `policy`: module:function, module:object with a method predict, or a saved policy as "
        "KIND:FILE, such as onnx:FILE.onnx.",
    ),
]
UavPolicyName = Annotated[
    str,
    typer.Option(
        "--uav-policy",
        metavar="POLICY",
        help="For the laws `certified` (inside the safety filter) and `policy` (without it): module:function, or a "
        "saved policy as KIND:FILE, such as npz:FILE.npz.",
    ),
]
NetworkName = Annotated[
    str,
    typer.Option(
        "--network",
        help=f"The profile of every radio link: {', '.join(PROFILES)}. One link: --set links.detections.delay=0.5.",
    ),
]
AllowCode = Annotated[
    bool,
    typer.Option(
        "--allow-code",
        help="Load the code that the file itself names ([custom]); code that you name in the "
        "command is loaded without it.",
    ),
]
VirtualPath = Annotated[
    str, typer.Option("--path", help="A path of your own as module:function, for the law `path`.")
]
Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")
]
Child = Annotated[
    bool,
    typer.Option(
        hidden=True,
        help="Started by `outrider run`: read credentials from stdin, end when it closes, report on stdout.",
    ),
]


def _run_name(name: str) -> str:
    try:
        return check_run_name(name)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


RunName = Annotated[
    str, typer.Option("--run", help="Name of the run.", envvar="OUTRIDER_RUN", callback=_run_name)
]

Connect = Annotated[str, typer.Option(help="Endpoint of the router.", envvar="OUTRIDER_CONNECT")]
CredentialFile = Annotated[
    Path | None,
    typer.Option(
        "--credentials",
        help="File with this process' name and password (outrider credentials).",
        envvar="OUTRIDER_CREDENTIALS",
    ),
]
RouterCredentials = Annotated[
    Path | None,
    typer.Option(
        "--credentials",
        help="The router's file of all credentials (router.json).",
        envvar="OUTRIDER_CREDENTIALS",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Listen beyond this machine without credentials: anybody may read and write everything.",
    ),
]
Record = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Record every tick into this MCAP file; needs the extra [record]."
    ),
]
JoinTimeout = Annotated[
    float,
    typer.Option(
        help="Seconds to wait for a simulator or router that is away.",
        min=0.0,
        envvar="OUTRIDER_JOIN_TIMEOUT",
    ),
]
RealTime = Annotated[
    float | None,
    typer.Option(
        "--realtime",
        metavar="F",
        help="Keep the wall clock: F simulated seconds a second, waiting for nobody; 0 for lockstep, the default.",
        envvar="OUTRIDER_REALTIME",
        min=0.0,
        max=1e4,
    ),
]
FlightNumber = Annotated[
    int | None,
    typer.Option(help="Which flight of a run that was reset, from 0; the last one by default."),
]
Companions = Annotated[
    list[str] | None,
    typer.Option(
        "--with",
        metavar="NAME[:OPTION=VALUE,...]",
        help="Start a companion, such as dashboard, with options of its own: dashboard:port=9000. May be repeated.",
    ),
]


DEFAULT_ENDPOINT = "tcp/127.0.0.1:17447"
DEFAULT_RUN = "flight"


def secret_of(given: str, *, wanted: bool = False) -> str:
    """The run's secret.

    Args:
        given: On the command line or in the environment: @FILE, `new`, hexadecimal digits, or nothing.
        wanted: Whether one is made where none is given.

    Raises:
        ScenarioError: If what is given is none, or its file cannot be read.
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
                f"--secret {source}: {getattr(error, 'strerror', '') or 'is no text'}"
            ) from error
        if not given:
            raise ScenarioError(
                f"--secret {source}: is empty; allowed: 32 to 128 hexadecimal digits"
            )
    try:
        return check_secret(given, source)
    except ValueError as error:
        raise ScenarioError(str(error)) from error


def check_endpoints(endpoints: tuple[str, ...], *, secured: bool, insecure: bool) -> None:
    """Refuse to let strangers in by mistake.

    Raises:
        ScenarioError: If an endpoint is none, or can be reached from other machines while nothing protects it.
    """
    for endpoint in endpoints:
        if not (check_endpoint(endpoint).is_local or secured or insecure):
            raise ScenarioError(
                f"endpoint {endpoint}: other machines reach it, and there are no credentials; "
                "make some with `outrider credentials`, or say --insecure"
            )


def staff_of(file: Path | None, role: Role) -> "tuple[Party, Credential | None]":
    """The operator or the observer of a run, whoever the file is of, and its credentials.

    Args:
        file: None: this process may have a password.
        role: Whose that is. Without one everybody may do everything: then it is an operator.

    Raises:
        AccessDenied: If the file is somebody else's.
    """
    from bus.credentials import read_credential

    found = credential_of(None, role, role.value) if file is None else read_credential(file)
    if found is None:
        return Party(role=Role.OPERATOR, name=OPERATOR_NAME), None
    if found.role not in (Role.OPERATOR, Role.OBSERVER):
        raise AccessDenied(
            f"{file}: the credentials of {found.name} ({found.role}), not of an operator or observer"
        )
    return found.party, found


class Joining(NamedTuple):
    """The way of one process into a run."""

    party: Party
    connect: str
    run: str
    credential: "Credential | None"
    join_timeout: float
    """The time for which a router or a simulator may be away [s]."""

    def session(self) -> "AbstractContextManager[Session]":
        """Its session; errors as of `open_session`."""
        from bus.joining import open_session

        return open_session(
            self.party,
            self.run,
            connect=self.connect,
            credential=self.credential,
            join_timeout=self.join_timeout,
        )

    def fly(self, make_pilot: "MakePilot") -> int:
        """Fly the vehicle until the run is over; result and errors as of `agents.process.fly`."""
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
    """The way of a party; errors as of `check_endpoint`, `party_of` and `credential_of`."""
    from bus.roles import party_of

    check_endpoint(connect)
    credential = credential_of(file, role, name)
    return Joining(party_of(role, name), connect, run, credential, join_timeout)


def join(
    role: str, run: str, connect: str, file: Path | None, join_timeout: float = 10.0
) -> "AbstractContextManager[Session]":
    """The session of a run's operator, observer or bridge; errors as of `joining`."""
    return joining(role, str(role), connect, run, file, join_timeout).session()


def credential_of(file: Path | None, role: str, name: str) -> "Credential | None":
    """By what this process is known: from its file, or its password from OUTRIDER_PASSWORD; None without either.

    Raises:
        AccessDenied: If the file is not this party's.
        ScenarioError: If the password cannot be one.
    """
    from bus.credentials import Credential, read_credential

    if file is not None:
        found = read_credential(file)
        if (found.role, found.name) != (role, name):
            raise AccessDenied(
                f"{file}: the credentials of {found.name} ({found.role}), not of {name} ({role})"
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
    """Return the bytes of a file, or of all files in a folder."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.iterdir() if file.is_file())


def help_without_command(context: typer.Context) -> None:
    """Print a command group's help, and end with exit code 2, if no command is named."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(2)
