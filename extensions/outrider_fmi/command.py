"""`outrider fmu`: vehicles and whole flights as FMI 3.0 co-simulation units."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from bus.errors import ScenarioError
from bus.keys import Role
from outrider.cli import options

app = typer.Typer(invoke_without_command=True, add_completion=False, rich_markup_mode=None)


@app.callback()
def command(context: typer.Context) -> None:
    """Exchange vehicles with FMI 3.0 tools (extra `[fmi]`).

    The other way, `--driver fmu:FILE.fmu` of every command that flies lets a unit drive the UGVs.

    Example: outrider fmu export ugv escort --out ugv.fmu
    """
    options.help_without_command(context)


@app.command()
def export(
    what: Annotated[
        Literal["uav", "ugv", "world"], typer.Argument(help="A vehicle, or the whole flight.")
    ],
    scenario: Annotated[
        str, typer.Argument(help="A TOML file, or a shipped scenario's name.")
    ] = "escort",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The file to write; uav.fmu, ... by default."),
    ] = None,
    agent: Annotated[
        str, typer.Option(help="The vehicle's name in the scenario; the first by default.")
    ] = "",
    seed: options.Seed = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    network: options.NetworkName = "",
    changes: options.Set = None,
    json: options.Json = False,
) -> None:
    """Write a vehicle, or the world, as a co-simulation unit.

    A vehicle is its pilot or driver, the world is all of them. A UAV's inputs are its own position and velocity and the
    noisy relative detection; a UGV's its own position and velocity, and what it is told by radio or an operator where
    its driver uses it; the world's an operator's wish, for the driver `teleop`. One step is one tick of the scenario.
    The unit is Python: the Python that loads it needs this outrider.

    Example: outrider fmu export world escort --seed 3 --out world.fmu
    """
    from outrider.cli.console import ERR, OUT, print_json
    from outrider.running.resolve import resolve
    from outrider_fmi.export import export_vehicle, export_world

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
        raise ScenarioError(f"--agent {agent}: the world has all of them; allowed: none")
    try:
        with ERR.status(f"making {file}"):
            if what == "world":
                export_world(flown, file)
            else:
                agent = export_vehicle(flown, Role(what), file, name=agent)
    except OSError as error:
        raise ScenarioError(f"{error.filename or file}: {error.strerror or error}") from error
    if json:
        told = {"file": str(file), "what": what, "agent": agent or None}
        print_json(told | {"scenario": flown.name, "seed": flown.seed, "step": flown.dt})
    else:
        OUT.tell(f"{file}: {agent or 'the world'} of {flown.name}, steps of {flown.dt:g} s")
