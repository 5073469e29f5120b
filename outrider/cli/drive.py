"""`outrider drive`: teleoperation of a UGV in a terminal."""

from typing import Annotated

import typer

from bus.errors import ScenarioError
from outrider.cli import options


def command(
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    name: Annotated[str, typer.Option(help="Name of the UGV in the scenario.")] = "ugv_0",
    speed: Annotated[
        float, typer.Option(help="Set the speed of a pressed key, in m/s.", min=0.05, max=20.0)
    ] = 0.2,
    back: Annotated[
        str,
        typer.Option(
            metavar="DRIVER",
            help="Return control to this driver at the end; default: the previous one.",
        ),
    ] = "",
) -> None:
    """Drive a UGV from this terminal, and watch its escort.

    Works over SSH and in containers, too (`ssh -t`, `docker run -it`).

    Watching changes nothing. The first press of WASD, an arrow key or space takes control. A held key drives in its
    direction; two keys pressed at once drive diagonally. A terminal does not report the release of a key. A press
    therefore lasts 0.7 s, and repeats prolong it; then the UGV brakes. The UGV also brakes when its operator is silent.

    Space brakes, + and - set the speed, z shows the whole area, h returns control, and q or Ctrl-C returns control and
    quits.

    In lockstep, simulated time runs about 100 times too fast for an operator: start the simulator with --realtime 1.

    Example: outrider drive --connect tcp/127.0.0.1:17447 --credentials credentials/operator.json
    """
    try:
        from outrider.cli.work.drive import drive  # noqa: PLC0415 - the extra [drive], termios
    except ImportError as error:
        raise ScenarioError(
            f"drive: the module {error.name} is missing; allowed: a Unix terminal"
        ) from error
    code = drive(connect, run, credentials, name, speed=speed, back=back)
    if code:
        raise typer.Exit(code)
