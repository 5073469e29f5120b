"""`outrider uav` and `outrider ugv`: one vehicle's process."""

from typing import Annotated

import typer

from outrider.cli.options import DEFAULT_ENDPOINT, DEFAULT_RUN, Leash, RunName, VirtualPath, Weighting

Connect = Annotated[str, typer.Option(help="Endpoint of the simulator's router.", envvar="OUTRIDER_CONNECT")]
JoinTimeout = Annotated[float, typer.Option(help="Seconds to wait for a simulator that is not there.", min=0.0)]


def uav(
    connect: Connect = DEFAULT_ENDPOINT,
    name: Annotated[str, typer.Option(help="The UAV's name in the scenario.", envvar="OUTRIDER_NAME")] = "uav_0",
    run: RunName = DEFAULT_RUN,
    join_timeout: JoinTimeout = 30.0,
    weighting: Weighting = "",
    path: VirtualPath = "",
    leash: Leash = False,
) -> None:
    """Fly one UAV: join the run, answer every observation with a command, leave when it is over.

    Example: outrider uav --connect tcp/127.0.0.1:17447 --name uav_0
    """
    from agents.process import fly, uav_maker
    from bus.keys import Party, Role
    from outrider.own import load_function

    _hold(leash)
    maker = uav_maker(
        weighting=load_function(weighting, what="weighting"),
        path=load_function(path, what="path"),
    )
    fly(Party(role=Role.UAV, name=name), maker, connect=connect, run=run, join_timeout=join_timeout)


def ugv(
    connect: Connect = DEFAULT_ENDPOINT,
    name: Annotated[str, typer.Option(help="The UGV's name in the scenario.", envvar="OUTRIDER_NAME")] = "ugv_0",
    run: RunName = DEFAULT_RUN,
    join_timeout: JoinTimeout = 30.0,
    leash: Leash = False,
) -> None:
    """Drive one UGV: join the run, answer every observation with a command, leave when it is over.

    Example: outrider ugv --connect tcp/127.0.0.1:17447 --name ugv_0
    """
    from agents.process import fly
    from agents.ugv import UgvPilot
    from bus.keys import Party, Role

    _hold(leash)
    fly(Party(role=Role.UGV, name=name), UgvPilot, connect=connect, run=run, join_timeout=join_timeout)


def _hold(leash: bool) -> None:
    if leash:
        from outrider.leash import hold

        hold()
