"""`outrider scenarios`: what is shipped."""

from typing import Annotated

import typer


def command(
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """List the shipped scenarios.

    Example: outrider scenarios
    """
    from rich.table import Table

    from outrider.cli.console import OUT, print_json
    from sim.scenario.loading import load_scenario, scenario_names

    shipped = [load_scenario(name) for name in scenario_names()]
    if json:
        rows = [
            {
                "name": s.name,
                "title": s.title,
                "law": s.law.name,
                "duration": s.duration,
                "seed": s.seed,
            }
            for s in shipped
        ]
        print_json({"scenarios": rows})
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("name", "law", "time", "what it is"):
        table.add_column(
            heading,
            justify="right" if heading == "time" else "left",
            no_wrap=heading != "what it is",
        )
    for scenario in shipped:
        table.add_row(scenario.name, scenario.law.name, f"{scenario.duration:g} s", scenario.title)
    OUT.print(table)
