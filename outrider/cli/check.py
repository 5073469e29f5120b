"""`outrider check`: whether a scenario can be flown."""

from typing import Annotated

import typer

_LISTED = 12
"""Vehicles are named up to so many."""


def command(
    file: Annotated[str, typer.Argument(help="A TOML file, or a shipped scenario's name.")],
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Any field of the scenario; may be repeated."
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Validate a scenario: exit code 0 if it can be flown, 2 and one line naming file, field and value if not.

    For the law certified it warns of each declared assumption that links or detector cannot keep, and says whether
    sight can be certified always, not always or hardly ever, and how seldom it is lost by proof.

    Example: outrider check my-scenario.toml
    """
    from outrider.cli.console import OUT, print_json, print_warnings
    from outrider.running.promise import how_certifiable, odds, promise_warnings
    from outrider.running.user_code import foreign_code
    from sim.scenario.checks import scenario_warnings
    from sim.scenario.loading import load_scenario

    scenario = load_scenario(file, overrides=changes or ())
    warnings = [
        *scenario_warnings(scenario),
        *promise_warnings(scenario),
        *foreign_code(scenario, changes or ()),
    ]
    certifiable, chances = how_certifiable(scenario), odds(scenario)
    if json:
        print_json(
            {
                "scenario": scenario.name,
                "valid": True,
                "certifiable": certifiable,
                "exceeded_chance": chances.exceeded if chances else {},
                "lost_chance": chances.lost if chances else None,
                "warnings": warnings,
            }
        )
        return
    print_warnings(warnings)
    names = [vehicle.name for vehicle in scenario.vehicles]
    many = f"{len(scenario.uav):,} UAVs and {len(scenario.ugv):,} UGVs"
    vehicles = ", ".join(names) if len(names) <= _LISTED else many
    law = scenario.law.name + (
        "" if certifiable in (None, "always") else f", but sight is certified {certifiable}"
    )
    OUT.print(
        f"{scenario.name}: can be flown ({vehicles}; law {law}; {scenario.duration:g} s, {scenario.ticks} ticks)"
    )
    if chances is not None and chances.line:
        OUT.print(chances.line)
