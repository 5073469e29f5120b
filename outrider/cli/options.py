"""Options that several commands share, and how they become a scenario."""

import os
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import msgspec
import typer

from bus.errors import AccessDenied, ScenarioError
from bus.keys import OPERATOR_NAME, Party, Role, check_run_name
from bus.locator import check_endpoint
from bus.policies import policy_kinds
from bus.profiles import PROFILES
from bus.registry import (
    DRIVERS,
    LAWS,
    DriverRow,
    LawRow,
    described,
)

if TYPE_CHECKING:
    from agents.process import MakePilot
    from bus.access import Credential
    from bus.session import Session
    from sim.scenario.types import Scenario

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
        help="Any field of the scenario, such as detections.noise=0.2; may be repeated.",
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
        help="Keep the wall clock: F simulated seconds a second, waiting for nobody. Lockstep by default.",
        envvar="OUTRIDER_REALTIME",
        min=1e-3,
        max=1e4,
    ),
]
Deadline = Annotated[
    float, typer.Option(help="Seconds to wait for the commands of one tick.", min=0.01)
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


def scenario_of(
    name: str,
    *,
    seed: int | None = None,
    duration: float | None = None,
    law: str | None = None,
    driver: str | None = None,
    changes: list[str] | None = None,
    weighting: str = "",
    path: str = "",
    policy: str = "",
    uav_policy: str = "",
    network: str = "",
) -> "tuple[Scenario, list[str]]":
    """The scenario that the options ask for, and the same options as `--set` arguments for another process.

    Raises:
        ScenarioError: If it cannot be flown.
    """
    # a vehicle's process, which shares these options, must not load it
    from sim.scenario.loading import load_scenario

    overrides = list(changes or ())
    custom = {
        "custom.weighting": weighting,
        "custom.path": path,
        "custom.policy": policy,
        "custom.uav_policy": uav_policy,
    }
    own = {key.removeprefix("custom."): value for key, value in custom.items() if value}
    if own:
        plain = load_scenario(name, overrides=overrides)
        law = _user_of(own, "law", LAWS, law, {plain.law.name})
        driver = _user_of(own, "driver", DRIVERS, driver, {ugv.driver for ugv in plain.ugv})
    quoted = {"law.name": law, **custom, "links.profile": network}
    overrides += [f'{key}="{_plain(key, value)}"' for key, value in quoted.items() if value]
    if duration is not None:
        overrides.append(f"duration={duration!r}")
    if seed is not None:
        overrides.append(f"seed={seed}")
    if driver:
        count = len(load_scenario(name, overrides=overrides).ugv)
        overrides += [f'ugv.{k}.driver="{_plain("driver", driver)}"' for k in range(count)]
    found = load_scenario(name, overrides=overrides)
    for option, value in (
        ("law", law),
        ("weighting", weighting),
        ("path", path),
        ("uav-policy", uav_policy),
    ):
        if value and not found.uav:
            raise ScenarioError(
                f"--{option} {value}: {found.name} has no UAV that could fly it; allowed: none"
            )
    return found, overrides


def _user_of(
    own: Mapping[str, str],
    kind: str,
    rows: Mapping[str, LawRow] | Mapping[str, DriverRow],
    chosen: str | None,
    flown: set[str],
) -> str | None:
    """The law or driver that uses the function which the user has named, so that none is ignored.

    Args:
        own: What the user has named, by option.
        kind: `law` or `driver`.
        rows: All there are.
        chosen: What the user has chosen with --law or --driver.
        flown: What the scenario says.

    Raises:
        ScenarioError: If another is chosen.
    """
    users: dict[str, list[str]] = {}
    for row in rows.values():
        for field in (row.own, row.inner if isinstance(row, LawRow) else ""):
            if field and own.get(field):
                users.setdefault(field, []).append(row.name)
    if len(users) > 1:
        options = " and ".join(f"--{field.replace('_', '-')}" for field in users)
        raise ScenarioError(f"{options}: only one can fly")
    for field, names in users.items():
        option = f"--{field.replace('_', '-')} {own[field]}"
        if chosen not in (None, *names):
            raise ScenarioError(
                f"{option}: is for --{kind} {' or '.join(names)}, not for --{kind} {chosen}"
            )
        if chosen is None and not flown & set(names):
            from outrider.cli.console import ERR

            others = "".join(f"; --{kind} {name}: {rows[name].about}" for name in names[1:])
            ERR.tell(f"{option}: so the {kind} is {names[0]}{others}")
            return names[0]
    return chosen


def _plain(field: str, value: str) -> str:
    # a saved policy: any path that TOML's quotes hold
    kind, separator, _ = value.partition(":")
    a_file = field in ("custom.policy", "custom.uav_policy") or (
        separator != "" and kind in policy_kinds("ugv")
    )
    if not re.fullmatch(r"[^\"\\\x00-\x1f\x7f]+" if a_file else r"[A-Za-z0-9_.:-]+", value):
        allowed = (
            "no quotes, backslashes and control characters"
            if a_file
            else "letters, digits, '_', '.', ':' and '-'"
        )
        raise ScenarioError(f"{field} = {value!r}: allowed are {allowed}")
    return value


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
    from bus.access import read_credential

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
        from bus.session import open_session

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
    from bus.access import Credential, read_credential

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
