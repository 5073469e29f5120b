"""`outrider scenarios import`: a real town as a scenario."""

from pathlib import Path
from typing import Annotated

import typer

from bus.plugins import needs
from outrider.cli.options import Json


def _numbers(text: str, option: str, allowed: str) -> tuple[float, float]:
    """Return the two numbers of an option."""
    try:
        one, other = (float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{option} {text}: not two numbers; allowed: {allowed}") from error
    return one, other


def _center(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    allowed = "LAT,LON in degrees, such as 60.1661,24.9482"
    latitude, longitude = _numbers(text, "--origin", allowed)
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise typer.BadParameter(f"--origin {text}: out of range; allowed: {allowed}")
    return latitude, longitude


def _size(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    allowed = "X,Y in metres, from 10 to 2000, such as 400,300"
    width, height = _numbers(text, "--size", allowed)
    if not (10.0 <= width <= 2000.0 and 10.0 <= height <= 2000.0):
        raise typer.BadParameter(f"--size {text}: out of range; allowed: {allowed}")
    return width, height


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
    touch are merged, courts are filled, walls are simplified outwards, and the report tells what was done: no wall is
    lost. Heights are from height, building:height, building:levels or num_floors. A UGV drives through the town, and a
    UAV escorts it.

    Example: outrider scenarios import town.geojson --size 400,400
    """
    center, sides = _center(origin), _size(size)
    with needs("geo", "scenarios import"):
        from outrider_geo.town import Options  # noqa: PLC0415 - the extra [geo]
        from outrider_geo.work import write_town  # noqa: PLC0415 - the extra [geo]

    options = Options(center, sides, height, clearance, gap, simplify, min_area)
    write_town(file, out or Path(f"{file.stem}.toml"), options, force=force, json=json)
