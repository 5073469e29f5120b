"""Work of `outrider drive`."""

import contextlib
from pathlib import Path

from bus.errors import ScenarioError
from bus.keys import Role
from bus.messages.telemetry import Status
from bus.plugins import needs
from bus.session import Session
from outrider.cli.console import ERR
from outrider.cli.joining import join
from outrider.cli.stopping import Stop, stop_on_signals
from outrider.cli.waiting import await_status
from outrider.view.terminal import terminal
from outrider.view.terminal.teleoperation import DriveLink, ugvs_of


def drive(
    connect: str, run: str, credentials: Path | None, vehicle: str, *, speed: float, back: str
) -> int:
    """Drive a UGV of a run until the operator quits or the process receives a signal; return the exit code.

    Raises:
        ScenarioError: If the process has no terminal, or the run no UGV of this name.
    """
    terminal.check_terminal()
    with join(Role.OPERATOR, run, connect, credentials) as session:
        with stop_on_signals() as stop:
            first = _await_run(session, vehicle, stop)
        if first is None:
            return stop.exit_code
        return _drive(session, vehicle, first, speed=speed, back=back)


def _await_run(session: Session, vehicle: str, stop: Stop) -> Status | None:
    """Wait for the first status; return None if a signal arrives first.

    Raises:
        ScenarioError: If the run has no UGV of this name.
    """
    status = await_status(session, stop)
    known = () if status is None else ugvs_of(status)
    if known and vehicle not in known:
        raise ScenarioError(f"--name {vehicle}: no UGV of this run; allowed: {', '.join(known)}")
    return status


def _drive(session: Session, vehicle: str, first: Status, *, speed: float, back: str) -> int:
    """Drive until the operator quits; return the exit code."""
    terminal.know_colours()
    with needs("drive"):
        from outrider.view.terminal.screen import DriveApp  # noqa: PLC0415 - after know_colours

    link = DriveLink(session, vehicle, speed=speed, back=back, status=first)
    app = DriveApp(link, session.run)
    with terminal.ending(link) as end, terminal.quiet_logs() as warnings:
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
