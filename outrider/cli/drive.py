"""`outrider drive`: teleoperation of a UGV in a terminal."""

import contextlib
from typing import TYPE_CHECKING, Annotated

import typer

from bus.errors import ScenarioError
from bus.keys import Role
from bus.messages.telemetry import Status
from bus.plugins import needs
from outrider.cli import options
from outrider.cli.stopping import Stop, stop_on_signals
from outrider.cli.waiting import await_status

if TYPE_CHECKING:
    from bus.session import Session


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
        from outrider.view.terminal.terminal import check_terminal
    except ImportError as error:
        raise ScenarioError(
            f"drive: the module {error.name} is missing; allowed: a Unix terminal"
        ) from error
    check_terminal()
    with options.join(Role.OPERATOR, run, connect, credentials) as session:
        with stop_on_signals() as stop:
            first = _await_run(session, name, stop)
        if first is None:
            raise typer.Exit(stop.exit_code)
        code = _drive(session, name, first, speed=speed, back=back)
    if code:
        raise typer.Exit(code)


def _await_run(session: "Session", vehicle: str, stop: Stop) -> Status | None:
    """Wait for the first status; return None if a signal arrives first.

    Raises:
        ScenarioError: If the run has no UGV of this name.
    """
    from outrider.view.terminal.teleoperation import ugvs_of

    status = await_status(session, stop)
    known = () if status is None else ugvs_of(status)
    if known and vehicle not in known:
        raise ScenarioError(f"--name {vehicle}: no UGV of this run; allowed: {', '.join(known)}")
    return status


def _drive(session: "Session", vehicle: str, first: Status, *, speed: float, back: str) -> int:
    """Drive until the operator quits; return the exit code."""
    from outrider.cli.console import ERR
    from outrider.view.terminal.terminal import ending, know_colours, quiet_logs

    know_colours()
    with needs("drive"):
        from outrider.view.terminal.screen import DriveApp
    from outrider.view.terminal.teleoperation import DriveLink

    link = DriveLink(session, vehicle, speed=speed, back=back, status=first)
    app = DriveApp(link, session.run)
    with ending(link) as end, quiet_logs() as warnings:
        link.start()
        try:
            app.run(mouse=False)
        except OSError:
            if not end.code:
                raise
        finally:
            link.leave()
            link.wait(5.0)
    with contextlib.suppress(OSError):  # the terminal may be closed
        for line in (*dict.fromkeys(warnings), link.farewell()):
            ERR.tell(line)
    return end.code or app.return_value or app.return_code or 0
