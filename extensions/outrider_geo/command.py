"""`outrider scenarios import`: a real town as a scenario."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from bus.plugins import needs
from outrider.cli.options import Json


class _Pair(NamedTuple):
    """Option of two numbers."""

    option: str
    allowed: str
    lower: tuple[float, float]
    upper: tuple[float, float]

    def read(self, text: str | None) -> tuple[float, float] | None:
        """Return the two numbers; None: the option is not given.

        Raises:
            typer.BadParameter: If the text is not two numbers within the bounds.
        """
        if text is None:
            return None
        try:
            one, other = (float(part) for part in text.split(","))
        except ValueError as error:
            wrong = f"{self.option} {text}: not two numbers; allowed: {self.allowed}"
            raise typer.BadParameter(wrong) from error
        given = one, other
        if not all(a <= b <= c for a, b, c in zip(self.lower, given, self.upper, strict=True)):
            raise typer.BadParameter(f"{self.option} {text}: out of range; allowed: {self.allowed}")
        return given


_ORIGIN = _Pair(
    "--origin", "LAT,LON in degrees, such as 60.1661,24.9482", (-90.0, -180.0), (90.0, 180.0)
)
_SIZE = _Pair(
    "--size", "X,Y in metres, from 10 to 2000, such as 400,300", (10.0, 10.0), (2000.0, 2000.0)
)


def command(
    file: Annotated[Path, typer.Argument(help="GeoJSON file with buildings.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write this scenario; default: FILE.toml here."),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON", help="Centre the area here; default: the data's centre."),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="X,Y", help="Clip to this size [m]; default: all buildings."),
    ] = None,
    height: Annotated[
        float,
        typer.Option(help="Assume this height of buildings without one [m].", min=0.1, max=1000.0),
    ] = 6.0,
    clearance: Annotated[
        float,
        typer.Option(help="Keep the UGV this far from buildings [m].", min=0.1, max=100.0),
    ] = 2.0,
    gap: Annotated[
        float,
        typer.Option(help="Close gaps between buildings narrower than this [m].", min=0, max=100.0),
    ] = 1.0,
    simplify: Annotated[
        float,
        typer.Option(help="Move walls outwards by at most this [m].", min=0.05, max=10.0),
    ] = 0.3,
    min_area: Annotated[
        float,
        typer.Option(help="Drop merged buildings smaller than this [m²].", min=0, max=1e6),
    ] = 0.0,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    json: Json = False,
) -> None:
    """Import the buildings of a real town from GeoJSON.

    The file is an export from OpenStreetMap (Overpass turbo, osmtogeojson) or Overture, in degrees. Buildings that
    touch are merged, courts are filled, walls are simplified outwards, and a report lists the changes: no wall is
    lost. Heights are from height, building:height, building:levels or num_floors. A UGV drives through the town, and a
    UAV escorts it.

    Example: outrider scenarios import town.geojson --size 400,400
    """
    center, sides = _ORIGIN.read(origin), _SIZE.read(size)
    with needs("geo", "scenarios import"):
        from outrider_geo.town import Options  # noqa: PLC0415 - the extra [geo]
        from outrider_geo.work import write_town  # noqa: PLC0415 - the extra [geo]

    options = Options(center, sides, height, clearance, gap, simplify, min_area)
    write_town(file, out or Path(f"{file.stem}.toml"), options, force=force, json=json)
