"""`outrider quadrotor`: tracking error of a rigid body, and its price."""

from typing import TYPE_CHECKING, Annotated

import typer

from outrider.cli import options
from outrider.cli.options import Json

if TYPE_CHECKING:
    from sim.scenario.types import Scenario

app = typer.Typer(invoke_without_command=True, add_completion=False, rich_markup_mode=None)
Flights = Annotated[
    int, typer.Option(help="Set the number of flights of each kind.", min=1, max=100_000)
]
Markdown = Annotated[bool, typer.Option("--markdown", help="Print the table as Markdown.")]


@app.callback()
def command(context: typer.Context) -> None:
    """Fly a quadrotor with attitude and motors.

    It is the true body of a UAV below the reference model; its tracking error is measured.

    Example: outrider quadrotor measure escort
    """
    options.help_without_command(context)


def _resolved(
    source: str,
    changes: list[str] | None,
    duration: float | None,
    law: str | None,
    driver: str | None = None,
) -> "Scenario":
    """Return the scenario with the options of a command applied."""
    from outrider.running.resolve import resolve  # noqa: PLC0415 - the compiler

    return resolve(source, changes=changes, duration=duration, law=law, driver=driver)[0]


@app.command()
def measure(
    scenario: options.ScenarioName,
    flights: Flights = 20,
    margin: Annotated[
        float, typer.Option(help="Add this share to the largest error.", min=0.0, max=10.0)
    ] = 0.2,
    changes: options.Set = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Measure the tracking error, and propose a bound.

    It flies references at the bounds of each UAV: full, periodic and random reversals of the acceleration, circles at
    the maximum speed, and stops at walls, with wind and position error at their limits in directions that jump. Then it
    flies the scenario itself. The proposal is the largest error plus the margin.

    Example: outrider quadrotor measure escort --duration 60
    """
    from outrider_quadrotor.work import print_measurement  # noqa: PLC0415 - the compiler

    found = _resolved(scenario, changes, duration, law, driver)
    print_measurement(found, flights, margin, markdown=markdown, json=json)


@app.command()
def compare(
    scenario: options.ScenarioName,
    flights: Flights = 100,
    changes: options.Set = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Fly the quadrotor and the double integrator with the same seeds.

    The exit code is 1 if a tick was certified out of sight, a certificate was broken, or the quadrotor exceeded its
    declared bound.

    Example: outrider quadrotor compare escort --duration 20 --set certificate.max_tracking_error=0.2
    """
    from outrider_quadrotor.work import print_comparison  # noqa: PLC0415 - the compiler

    found = _resolved(scenario, changes, duration, law, driver)
    print_comparison(found, flights, markdown=markdown, json=json)
