"""`outrider replay`: summary of a recording, and comparison with a second flight of its commands."""

from pathlib import Path
from typing import Annotated

import typer

from outrider.cli.main import call_command
from outrider.cli.options import Companions, FlightNumber, Json
from outrider.running.companions import parse_companion


def command(
    file: Annotated[
        Path,
        typer.Argument(help="Recording; it may be incomplete."),
    ],
    refly: Annotated[
        bool,
        typer.Option(
            "--refly",
            help="Fly the recorded commands again and compare every tick.",
        ),
    ] = False,
    realtime: Annotated[
        float | None,
        typer.Option(
            "--realtime",
            metavar="F",
            help="Play the recording at F simulated seconds per second.",
            min=0.01,
            max=1e6,
        ),
    ] = None,
    companions: Companions = None,
    flight: FlightNumber = None,
    json: Json = False,
) -> None:
    """Print the summary of a recorded run, or fly the run again.

    Reports if the file is incomplete. --refly sends the recorded commands through the simulator again, without pilots.
    It exits with 0 if every position, velocity and applied command is identical to the last bit. Otherwise it names
    the first difference and exits with 1.

    Example: outrider replay run.mcap --refly
    """
    if companions and (refly or json):
        raise typer.BadParameter("--with cannot be combined with --refly or --json; leave one out")
    if companions:
        _play_with(companions, file, flight, realtime)
        return
    from outrider.cli.work.replay import replay  # noqa: PLC0415 - the extra [record]

    replay(file, flight, again=refly, realtime=realtime, json=json)


def _play_with(asked: list[str], file: Path, flight: int | None, realtime: float | None) -> None:

    if len(asked) > 1:
        raise typer.BadParameter("--with: several companions; allowed: one")
    name, words, companion = parse_companion(asked[0])
    if not companion.replays:
        raise typer.BadParameter(f"--with {name}: this companion cannot play recordings")
    given = {"--replay": file.absolute(), "--flight": flight, "--realtime": realtime}
    arguments = [
        word
        for option, value in given.items()
        if value is not None
        for word in (option, str(value))
    ]
    call_command(name, [*arguments, *words])
