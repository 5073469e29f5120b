"""`outrider scenarios`: list, text and copies of shipped scenarios."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from bus.files import writing
from outrider.cli.console import OUT, print_json, print_table
from outrider.cli.options import Json
from outrider.cli.standard_files import print_text
from sim.scenario.laws import law_title
from sim.scenario.loading import load_scenario, scenario_names, schema_text, shipped_text

Name = Annotated[str, typer.Argument(help="Name of a shipped scenario.")]
SCHEMA_FILE = "scenario.schema.json"
"""File name of the JSON Schema beside a new scenario, for editors."""

app = typer.Typer(invoke_without_command=True, add_completion=False, rich_markup_mode=None)


@app.callback()
def command(
    context: typer.Context,
    json: Json = False,
) -> None:
    """List, show or create scenarios.

    The schema is for editors that support JSON Schema.

    Example: outrider scenarios, or outrider scenarios show escort
    """
    if context.invoked_subcommand is not None:
        return

    shipped = [load_scenario(name) for name in scenario_names()]
    if json:
        rows = [
            {
                "name": s.name,
                "title": s.title,
                "law": law_title(s),
                "duration": s.duration,
                "seed": s.seed,
            }
            for s in shipped
        ]
        print_json({"scenarios": rows})
        return
    listed = [(s.name, law_title(s), f"{s.duration:g} s", s.title) for s in shipped]
    whole = ("name", "law", "time")
    print_table((*whole, "title"), listed, right=("time",), whole=whole)


@app.command()
def show(name: Name = "escort") -> None:
    """Print the file of a shipped scenario.

    Example: outrider scenarios show figure-3-switching
    """
    print_text(shipped_text(name))


@app.command()
def new(
    file: Annotated[Path, typer.Argument(help="File to write.")],
    base: Annotated[str, typer.Option("--from", help="Copy this shipped scenario.")] = "escort",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    schema: Annotated[bool, typer.Option(help=f"Write {SCHEMA_FILE} for editors, too.")] = True,
) -> None:
    """Create a scenario as a copy of a shipped one.

    Editors with JSON Schema for TOML (taplo, Even Better TOML) complete its fields and mark errors.

    Example: outrider scenarios new mine.toml, then outrider check mine.toml and outrider run mine.toml
    """
    if file.suffix != ".toml":
        raise typer.BadParameter(f"{file}: wrong ending; allowed: {file.name}.toml")
    if file.stem in scenario_names():
        raise typer.BadParameter(f"{file}: name of a shipped scenario; allowed: another name")
    text = shipped_text(base)
    if file.exists() and not force:
        raise typer.BadParameter(f"{file}: exists already; --force replaces it")
    with writing(file):
        if schema:
            text = f"#:schema {SCHEMA_FILE}\n{text}"
            file.with_name(SCHEMA_FILE).write_text(schema_text(), encoding="utf-8")
        file.write_text(text, encoding="utf-8")
    OUT.tell(f"{file}: written; validate it with outrider check {shlex.quote(str(file))}")


@app.command()
def schema() -> None:
    """Print the JSON Schema of a scenario's file.

    Example: outrider scenarios schema > scenario.schema.json
    """
    print_text(schema_text())
