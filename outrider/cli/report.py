"""`outrider report`: results of sweeps as pictures, a page and a table."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from bus.plugins import require
from outrider.cli.console import ERR, OUT, print_json, print_warnings
from outrider.cli.options import Json
from outrider.cli.standard_files import print_text


def command(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Folders of sweeps, finished or not; common points are merged."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write page and pictures to this folder; default: FOLDER/report, or ./report.",
        ),
    ] = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the tables as Markdown on stdout.")
    ] = False,
    json: Json = False,
) -> None:
    """Draw the results of sweeps.

    Shows how often sight was lost, with confidence intervals, the margin, and the cost of the network.

    Writes pictures (PNG) and report.html, a self-contained page. With several folders, they go to ./report. Needs the
    extra [sweep].

    Example: outrider report sweeps/network --markdown
    """
    require("sweep")
    if markdown and json:
        raise typer.BadParameter("--markdown and --json both write to stdout; leave one out")

    with ERR.status("reading and drawing"):
        from outrider.experiments.report.files import write_report  # noqa: PLC0415 - matplotlib

        report = write_report(
            folders,
            out,
            shlex.join(["outrider", *sys.argv[1:]]),
            lambda line: print_warnings([line]),
        )
    material, pictures = report.material, report.pictures
    if markdown:
        print_text(report.markdown())
        return
    if json:
        files = {name: str(path) for name, path in pictures.items()}
        counts = {"rows": material.rows, "failed": material.failed, "missing": material.missing}
        print_json({**counts, "page": str(report.page), "pictures": files})
        return
    if material.missing:
        ERR.tell(
            Text.assemble(("not finished:", "yellow"), f" {material.missing:,} runs are missing")
        )
    OUT.tell(f"{material.rows:,} runs, {material.failed:,} failed\n  {report.page}")
    for path in pictures.values():
        OUT.tell(f"  {path}")
