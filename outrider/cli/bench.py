"""`outrider bench`: the speed of each layer, with its limit measured in the same run."""

from pathlib import Path
from typing import Annotated

import typer

from bus.errors import ScenarioError
from outrider.cli.options import Json


def command(
    only: Annotated[list[str] | None, typer.Option(help="Only this row; may be repeated.")] = None,
    repeats: Annotated[
        int, typer.Option(help="Measurements of each row; the median is shown.", min=1)
    ] = 5,
    scaling: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png",
            help="Instead of the rows: the speed over 1 to 4,096 worlds, over grids and over vehicles, as a "
            "picture, and beside it the numbers as FILE.json. Some minutes, and 2 GB of memory.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Measure each layer's speed, and its limit in the same run.

    Example: outrider bench --only lockstep
    """
    from outrider.cli.console import OUT, print_json, print_table, share_progress

    if scaling is not None and (only or scaling.suffix.lower() != ".png"):
        raise ScenarioError(f"--scaling {scaling}: needs a file that ends in .png, and no --only")
    if scaling is not None:
        from outrider.bench.scaling import make_scaling

        with share_progress("measuring") as tell:
            points = make_scaling(scaling, on_progress=tell)
        if json:
            print_json({"file": str(scaling), "points": points})
        else:
            OUT.tell(f"{scaling}\n{scaling.with_suffix('.json')}")
        return
    from outrider.bench.measured import measure

    with share_progress("measuring") as tell:
        rows = measure(only or [], repeats, on_progress=tell)
    if json:
        print_json({"rows": rows})
        return
    told = []
    for row in rows:
        other = "" if row.reference_value is None else f"{row.reference_value:,.6g}"
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        told.append((row.name, f"{row.value:,.6g}", row.unit, row.reference, other, ratio))
    headings = ("row", "value", "unit", "beside", "value", "ratio")
    print_table(headings, told, title="Speed, medians", right=("value", "ratio"))
