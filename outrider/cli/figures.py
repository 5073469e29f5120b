"""`outrider figures`: the paper's figures and their claims."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from outrider.cli.console import OUT, print_json, print_table, share_progress
from outrider.cli.options import Json


def command(
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the pictures.")] = Path(
        "figures"
    ),
    json: Json = False,
) -> None:
    """Draw the paper's figures 1 to 5, and check their claims.

    Prints a table of the claims with the measured numbers. Exits with 1 if a claim does not hold.

    Example: outrider figures --out figures
    """
    from outrider.experiments.paper_figures import make_figures  # noqa: PLC0415 - matplotlib

    with share_progress("drawing") as show:
        claims = make_figures(out, on_progress=show)
    if json:
        print_json({"claims": claims, "folder": str(out)})
    else:
        holds = {True: Text("yes", style="green"), False: Text("no", style="red")}
        print_table(
            ("figure", "claim", "found", "holds"),
            [(one.figure, one.claim, one.value, holds[one.holds]) for one in claims],
            title="Claims of the paper's figures",
            whole=("figure", "holds"),
        )
        OUT.tell(f"  {out}/figure-1.png ... figure-5.png")
    if not all(claim.holds for claim in claims):
        raise typer.Exit(1)
