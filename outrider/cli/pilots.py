"""`outrider uav` and `outrider ugv`: process of one vehicle."""

from pathlib import Path
from typing import Annotated

import typer

from agents.process import uav_maker, ugv_maker
from bus.keys import Party, Role
from outrider.cli import options
from outrider.cli.joining import Joining, joining
from outrider.cli.standard_files import print_starting
from outrider.running.parent import read_start
from outrider.running.user_code import load_function


def uav(
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    name: Annotated[
        str, typer.Option(help="Name of the UAV in the scenario.", envvar="OUTRIDER_NAME")
    ] = "uav_0",
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    join_timeout: options.JoinTimeout = 30.0,
    weighting: options.Weighting = "",
    path: options.VirtualPath = "",
    uav_policy: options.UavPolicyName = "",
    child: options.Child = False,
) -> None:
    """Fly one UAV of a run in this process.

    The process joins the run, answers every observation with a command, and exits when the run is over. It reconnects
    after simulator or router were disconnected. OUTRIDER_PASSWORD may replace the credentials file.

    Example: outrider uav --connect tcp/127.0.0.1:17447 --name uav_0
    """
    joined, code = _joining(Role.UAV, name, connect, run, credentials, join_timeout, child=child)
    code = code or {"weighting": weighting, "path": path, "uav_policy": uav_policy}
    functions = {field: load_function(value, what=field) for field, value in code.items()}
    maker = uav_maker(
        weighting=functions["weighting"],
        path=functions["path"],
        policy=functions["uav_policy"],
        policy_name=code["uav_policy"],
    )
    joined.fly(maker)


def ugv(
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    name: Annotated[
        str, typer.Option(help="Name of the UGV in the scenario.", envvar="OUTRIDER_NAME")
    ] = "ugv_0",
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    join_timeout: options.JoinTimeout = 30.0,
    policy: options.PolicyName = "",
    child: options.Child = False,
) -> None:
    """Drive one UGV of a run in this process.

    The process joins the run, answers every observation with a command, and exits when the run is over. It reconnects
    after simulator or router were disconnected. OUTRIDER_PASSWORD may replace the credentials file.

    Example: outrider ugv --connect tcp/127.0.0.1:17447 --name ugv_0
    """
    joined, code = _joining(Role.UGV, name, connect, run, credentials, join_timeout, child=child)
    policy = code.get("policy", policy)
    maker = ugv_maker(policy=load_function(policy, what="policy"), policy_name=policy)
    joined.fly(maker)


def _joining(
    role: Role,
    name: str,
    connect: str,
    run: str,
    credentials: Path | None,
    join_timeout: float,
    *,
    child: bool,
) -> tuple[Joining, dict[str, str]]:
    """Return the arguments with which this vehicle joins the run, and the code that its parent names."""
    if not child:
        print_starting()
        return joining(role, name, connect, run, credentials, join_timeout), {}

    start, party = read_start(), Party(role=role, name=name)
    return Joining(party, connect, run, start.credential, start.join_timeout), start.code
