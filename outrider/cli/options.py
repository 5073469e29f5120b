"""Options shared by several commands."""

from pathlib import Path
from typing import Annotated

import typer

from bus.errors import ScenarioError
from bus.keys import check_run_name
from bus.locator import check_endpoint
from bus.messages.base import MAX_SEED
from bus.policies import policy_forms
from bus.profiles import PROFILES
from bus.registry import (
    DRIVERS,
    LAWS,
    described,
)

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
        help=f"Set the law of all UAVs, whatever the scenario names. {described(LAWS)}.",
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
        metavar="PROFILE",
        help=f"Set the profile of all radio links: {', '.join(PROFILES)}; or FILE.toml[:NAME].",
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
