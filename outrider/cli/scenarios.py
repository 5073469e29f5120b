"""`outrider scenarios`: what is shipped, what it says, and a file of one's own to begin with."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from bus.files import writing
from outrider.cli.console import OUT, print_json, print_table
from outrider.cli.options import Json
from outrider.cli.standard_files import print_text
from sim.scenario.loading import load_scenario, scenario_names, schema_text, shipped_text

Name = Annotated[str, typer.Argument(help="A shipped scenario's name.")]
SCHEMA_FILE = "scenario.schema.json"
"""Written beside a new scenario, for editors that know JSON Schema."""

app = typer.Typer(invoke_without_command=True, add_completion=False, rich_markup_mode=None)


@app.callback()
def command(
    context: typer.Context,
    json: Json = False,
) -> None:
    """List the shipped scenarios, show one, or begin your own.

    The schema is for an editor that knows JSON Schema.

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
                "law": s.law.name,
                "duration": s.duration,
                "seed": s.seed,
            }
            for s in shipped
        ]
        print_json({"scenarios": rows})
        return
    told = [(s.name, s.law.name, f"{s.duration:g} s", s.title) for s in shipped]
    whole = ("name", "law", "time")
    print_table((*whole, "what it is"), told, right=("time",), whole=whole)


@app.command()
def show(name: Name = "escort") -> None:
    """Print a shipped scenario's file.

    Example: outrider scenarios show figure-3-switching
    """
    print_text(shipped_text(name))


@app.command()
def new(
    file: Annotated[Path, typer.Argument(help="The file to be written.")],
    base: Annotated[
        str, typer.Option("--from", help="The shipped scenario that it begins as.")
    ] = "escort",
    force: Annotated[
        bool, typer.Option("--force", help="Replace a file that is there already.")
    ] = False,
    schema: Annotated[
        bool, typer.Option(help=f"Write {SCHEMA_FILE} beside it, for the editor.")
    ] = True,
) -> None:
    """Begin a scenario of one's own as a copy of a shipped one.

    Editors that know TOML with JSON Schema (taplo, Even Better TOML) complete its fields and mark what is wrong.

    Example: outrider scenarios new mine.toml, then outrider check mine.toml and outrider run mine.toml
    """
    if file.suffix != ".toml":
        raise typer.BadParameter(f"{file}: a scenario's file ends in .toml: {file.name}.toml")
    if file.stem in scenario_names():
        raise typer.BadParameter(f"{file}: {file.stem} is a shipped scenario; choose another name")
    text = shipped_text(base)
    if file.exists() and not force:
        raise typer.BadParameter(f"{file}: is there already; --force replaces it")
    with writing(file):
        if schema:
            text = f"#:schema {SCHEMA_FILE}\n{text}"
            file.with_name(SCHEMA_FILE).write_text(schema_text(), encoding="utf-8")
        file.write_text(text, encoding="utf-8")
    OUT.tell(
        f"{file}: written; outrider check {shlex.quote(str(file))} says whether it can be flown"
    )


@app.command()
def schema() -> None:
    """Print the JSON Schema of a scenario's file.

    Example: outrider scenarios schema > scenario.schema.json
    """
    print_text(schema_text())
