"""`outrider fmu`: vehicles and whole runs as FMI 3.0 co-simulation units."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from bus.errors import ScenarioError
from bus.keys import Role
from outrider.cli import options
from outrider.cli.console import ERR, OUT, print_json

app = typer.Typer(invoke_without_command=True, add_completion=False, rich_markup_mode=None)


@app.callback()
def command(context: typer.Context) -> None:
    """Exchange vehicles with FMI 3.0 tools (extra `[fmi]`).

    Conversely, `--driver fmu:FILE.fmu` of `outrider run` and similar commands makes a unit drive the UGVs.

    Example: outrider fmu export ugv escort --out ugv.fmu
    """
    options.help_without_command(context)


@app.command()
def export(
    what: Annotated[
        Literal["uav", "ugv", "world"], typer.Argument(help="Vehicle kind, or the whole world.")
    ],
    scenario: Annotated[
        str, typer.Argument(help="TOML file, or name of a shipped scenario.")
    ] = "escort",
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write this file; default: uav.fmu, ugv.fmu or world.fmu."
        ),
    ] = None,
    agent: Annotated[
        str, typer.Option(help="Export this vehicle; default: the first of its kind.")
    ] = "",
    seed: options.Seed = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    network: options.NetworkName = "",
    changes: options.Set = None,
    json: options.Json = False,
) -> None:
    """Export a vehicle, or the world, as a co-simulation unit.

    A vehicle unit contains its pilot or driver; a world unit simulates all vehicles. Inputs of a UAV are its own
    position and velocity and the noisy relative detection. Inputs of a UGV are its own position and velocity, and radio
    or operator messages if its driver uses them. The input of a world is the operator's command, for the driver
    `teleop`. One step is one tick of the scenario. Units are Python code: the Python that loads one needs this version
    of outrider.

    Example: outrider fmu export world escort --seed 3 --out world.fmu
    """
    from outrider.running.resolve import resolve  # noqa: PLC0415 - the compiler
    from outrider_fmi.export import export_vehicle, export_world  # noqa: PLC0415 - the compiler

    flown, _ = resolve(
        scenario,
        seed=seed,
        duration=duration,
        law=law,
        driver=driver,
        network=network,
        changes=changes,
    )
    file = out or Path(f"{what}.fmu")
    if what == "world" and agent:
        raise ScenarioError(f"--agent {agent}: the world contains all agents; allowed: none")
    try:
        with ERR.status(f"exporting {file}"):
            if what == "world":
                export_world(flown, file)
            else:
                agent = export_vehicle(flown, Role(what), file, name=agent)
    except OSError as error:
        raise ScenarioError(f"{error.filename or file}: {error.strerror or error}") from error
    if json:
        exported = {"file": str(file), "what": what, "agent": agent or None}
        print_json(exported | {"scenario": flown.name, "seed": flown.seed, "step": flown.dt})
    else:
        OUT.tell(f"{file}: {agent or 'the world'} of {flown.name}, steps of {flown.dt:g} s")
