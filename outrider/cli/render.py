"""`outrider render`: a recording as a picture or a film."""

from pathlib import Path
from typing import Annotated

import typer

from outrider.cli.console import ERR, share_progress
from outrider.cli.options import FlightNumber


def command(
    file: Annotated[Path, typer.Argument(help="A recording, also one whose process was killed.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="What to make, by its ending: .png, .gif, or .mp4 (needs ffmpeg).",
        ),
    ],
    fps: Annotated[int, typer.Option(help="Frames per second of a film.", min=1, max=50)] = 20,
    realtime: Annotated[
        float,
        typer.Option(
            "--realtime",
            metavar="F",
            help="F simulated seconds a second of a film.",
            min=0.01,
            max=10_000.0,
        ),
    ] = 10.0,
    flight: FlightNumber = None,
) -> None:
    """Draw a recorded flight as a picture or a film.

    The picture of a whole run as PNG, or a film from above as GIF or MP4.

    Example: outrider render run.mcap -o run.gif --realtime 20
    """
    from outrider.recording.reader import flight_of
    from outrider.view.film import check_output, render

    check_output(out)
    recording = flight_of(file, flight)
    with share_progress("drawing") as tell:
        render(
            recording,
            out,
            fps=fps,
            speed=realtime,
            on_frame=lambda done, total: tell("drawing", done / total),
        )
    ERR.tell(f"{out}: {out.stat().st_size / 1e6:.2f} MB")
