"""`outrider bench`: the speed of each layer, with its limit measured in the same run."""

from typing import Annotated

import typer


def command(
    only: Annotated[list[str] | None, typer.Option(help="Only this row; may be repeated.")] = None,
    repeats: Annotated[int, typer.Option(help="Measurements of each row; the median is shown.", min=1)] = 5,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Measure each layer, and in the same run the limit that it stands beside.

    Example: outrider bench --only lockstep
    """
    from rich.progress import Progress
    from rich.table import Table

    from outrider.bench import measure
    from outrider.cli.console import ERR, OUT, print_json

    with Progress(console=ERR, transient=True) as progress:
        task = progress.add_task("measuring", total=1.0)
        rows = measure(
            only or [], repeats, on_progress=lambda what, share: progress.update(task, description=what, completed=share)
        )
    if json:
        print_json({"rows": rows})
        return
    table = Table(title="Speed, medians", title_justify="left")
    for heading in ("row", "value", "unit", "beside", "value", "ratio"):
        table.add_column(heading, justify="right" if heading in ("value", "ratio") else "left")
    for row in rows:
        other = "" if row.reference_value is None else f"{row.reference_value:,.6g}"
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        table.add_row(row.name, f"{row.value:,.6g}", row.unit, row.reference, other, ratio)
    OUT.print(table)
