"""`outrider run`: flight of a scenario, in several processes or in one."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from outrider.cli import options

MOST_PROCESSES = 20
"""Default limit of a run's processes."""


InProcess = Annotated[
    bool, typer.Option("--in-process", help="Fly everything in this process, without a bus.")
]
Respawn = Annotated[
    bool,
    typer.Option(
        "--respawn",
        help="Restart a vehicle's process if it exits; lockstep waits for it.",
    ),
]
AllowProcesses = Annotated[
    int,
    typer.Option("--allow-processes", metavar="N", help="Allow up to N processes.", min=1),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Write trajectory, picture and summary to this folder; default: new, in runs/.",
    ),
]
Listen = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ENDPOINT",
        help="Let operators and observers join at this endpoint, with credentials; repeatable.",
    ),
]
RunCredentials = Annotated[
    Path | None,
    typer.Option(
        "--credentials",
        metavar="FILE",
        help="With --listen: use these credentials (router.json); default: new ones.",
        envvar="OUTRIDER_CREDENTIALS",
    ),
]
Files = Annotated[bool, typer.Option(help="Write the files of the run.")]
Picture = Annotated[bool, typer.Option(help="Draw the picture.")]


class RunOptions(NamedTuple):
    """Options of `outrider run`."""

    scenario: str
    seed: int | None
    secret: str
    duration: float | None
    law: str | None
    driver: str | None
    uav_policy: str
    changes: list[str]
    network: str
    allow_code: bool
    in_process: bool
    record: Path | None
    realtime: float | None
    companions: list[str]
    respawn: bool
    allow_processes: int
    listen: tuple[str, ...]
    credentials: Path | None
    out: Path | None
    files: bool
    picture: bool
    json: bool


def command(
    scenario: options.ScenarioName = "escort",
    seed: options.Seed = None,
    secret: options.Secret = "",
    duration: options.Duration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    uav_policy: options.FlownPolicy = "",
    changes: options.Set = None,
    network: options.NetworkName = "",
    allow_code: options.AllowCode = False,
    in_process: InProcess = False,
    record: options.Record = None,
    realtime: options.RealTime = None,
    companions: options.Companions = None,
    respawn: Respawn = False,
    allow_processes: AllowProcesses = MOST_PROCESSES,
    listen: Listen = None,
    credentials: RunCredentials = None,
    out: Out = None,
    files: Files = True,
    picture: Picture = True,
    json: options.Json = False,
) -> None:
    """Fly a scenario, with one process for the simulator and one per vehicle.

    The processes communicate over Zenoh. The run ends with a table of metrics, a picture and the trajectory. Ctrl-C
    ends the run early and keeps its results. If a vehicle's process exits, the vehicle brakes and the run continues;
    with --respawn, the process is restarted and flies on. --with dashboard shows the run on a page.

    With --listen, others can join the run, from other machines too. They need its credentials, whose files the run
    prints; it removes new ones at the end. With --driver teleop, the run prints the `outrider drive` command that
    steers the UGV, and follows the wall clock unless --realtime is given (0: lockstep).

    Example: outrider run escort --seed 3 --law switching

    Example: outrider run escort --driver teleop --listen tcp/0.0.0.0:17447
    """
    from outrider.cli.work.run import run  # noqa: PLC0415 - the compiler

    run(
        RunOptions(
            scenario=scenario,
            seed=seed,
            secret=secret,
            duration=duration,
            law=law,
            driver=driver,
            uav_policy=uav_policy,
            changes=changes or [],
            network=network,
            allow_code=allow_code,
            in_process=in_process,
            record=record,
            realtime=realtime,
            companions=companions or [],
            respawn=respawn,
            allow_processes=allow_processes,
            listen=tuple(listen or ()),
            credentials=credentials,
            out=out,
            files=files,
            picture=picture,
            json=json,
        )
    )
