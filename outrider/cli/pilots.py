"""`outrider uav` and `outrider ugv`: one vehicle's process."""

from typing import Annotated

import typer

from bus.keys import Party, Role
from outrider.cli import options

JoinTimeout = Annotated[
    float,
    typer.Option(
        help="Seconds to wait for a simulator or router that is away.",
        min=0.0,
        envvar="OUTRIDER_JOIN_TIMEOUT",
    ),
]


def uav(
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    name: Annotated[
        str, typer.Option(help="The UAV's name in the scenario.", envvar="OUTRIDER_NAME")
    ] = "uav_0",
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    join_timeout: JoinTimeout = 30.0,
    weighting: options.Weighting = "",
    path: options.VirtualPath = "",
    watchdog: options.Watchdog = False,
) -> None:
    """Fly one UAV: join the run, answer every observation with a command, leave when it is over.

    Joins again when simulator or router have been away. OUTRIDER_PASSWORD may stand for the credentials' file.

    Example: outrider uav --connect tcp/127.0.0.1:17447 --name uav_0
    """
    from agents.process import fly, uav_maker
    from outrider.running.user_code import load_function

    _watch(watchdog)
    options.check_endpoint(connect)
    maker = uav_maker(
        weighting=load_function(weighting, what="weighting"),
        path=load_function(path, what="path"),
    )
    credential = options.credential_of(credentials, Role.UAV, name)
    fly(
        Party(role=Role.UAV, name=name),
        maker,
        connect=connect,
        run=run,
        credential=credential,
        join_timeout=join_timeout,
    )


def ugv(
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    name: Annotated[
        str, typer.Option(help="The UGV's name in the scenario.", envvar="OUTRIDER_NAME")
    ] = "ugv_0",
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    join_timeout: JoinTimeout = 30.0,
    policy: options.PolicyName = "",
    watchdog: options.Watchdog = False,
) -> None:
    """Drive one UGV: join the run, answer every observation with a command, leave when it is over.

    Joins again when simulator or router have been away. OUTRIDER_PASSWORD may stand for the credentials' file.

    Example: outrider ugv --connect tcp/127.0.0.1:17447 --name ugv_0
    """
    from agents.process import fly, ugv_maker
    from outrider.running.user_code import load_function

    _watch(watchdog)
    options.check_endpoint(connect)
    credential = options.credential_of(credentials, Role.UGV, name)
    maker = ugv_maker(policy=load_function(policy, what="policy"), policy_name=policy)
    fly(
        Party(role=Role.UGV, name=name),
        maker,
        connect=connect,
        run=run,
        credential=credential,
        join_timeout=join_timeout,
    )


def _watch(watchdog: bool) -> None:
    if watchdog:
        from outrider.running.watchdog import start_watchdog

        start_watchdog()
