"""`outrider render`: picture or film of a recording."""

from pathlib import Path
from typing import Annotated

import typer

from outrider.cli.console import ERR, share_progress
from outrider.cli.options import FlightNumber


def command(
    file: Annotated[Path, typer.Argument(help="Recording; it may be incomplete.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Write this file: .png, .gif or .mp4 (needs ffmpeg).",
        ),
    ],
    fps: Annotated[
        int, typer.Option(help="Set the frames per second of a film.", min=1, max=50)
    ] = 20,
    realtime: Annotated[
        float,
        typer.Option(
            "--realtime",
            metavar="F",
            help="Show F simulated seconds per second of a film.",
            min=0.01,
            max=10_000.0,
        ),
    ] = 10.0,
    flight: FlightNumber = None,
) -> None:
    """Draw a recorded flight as a picture or a film.

    Writes a picture of the whole flight as PNG, or a film seen from above as GIF or MP4.

    Example: outrider render run.mcap -o run.gif --realtime 20
    """
    from outrider.view.film import render_file  # noqa: PLC0415 - matplotlib, and the extra [record]

    with share_progress("drawing") as show:
        render_file(
            file,
            out,
            flight=flight,
            fps=fps,
            speed=realtime,
            on_frame=lambda done, total: show("drawing", done / total),
        )
    ERR.tell(f"{out}: {out.stat().st_size / 1e6:.2f} MB")
