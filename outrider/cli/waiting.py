"""Waiting for a run's simulator, and for a disconnected router."""

import time

from bus.keys import STATUS
from bus.messages.telemetry import Status
from bus.session import Session
from outrider.cli.console import ERR
from outrider.cli.stopping import Stop

AWAY = 3.0
"""Time after which a disconnected party counts as lost [s]."""


class RouterTimer:
    """Timer that distinguishes a lost router from a brief disconnection."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._since: float | None = None

    def has_gone(self) -> bool:
        """Return true if the router was disconnected at every call for at least `AWAY`."""
        if self._session.connected:
            self._since = None
            return False
        self._since = self._since or time.monotonic()
        return time.monotonic() - self._since > AWAY


def print_waiting(run: str) -> None:
    """Print that the command waits for the simulator."""
    ERR.tell(f"waiting for the simulator of the run {run}; Ctrl-C quits")


def await_status(session: Session, stop: Stop) -> Status | None:
    """Wait for the first status with the vehicles' geometry; return None if a signal arrives first."""
    statuses, is_announced = session.inbox(STATUS), False
    while not stop:
        envelope = statuses.receive(0.5 if is_announced else 1.0)
        status = None if envelope is None else envelope.message
        if isinstance(status, Status) and status.geometry is not None:
            session.forget(statuses)
            return status
        if not (is_announced or stop):
            is_announced = True
            print_waiting(session.run)
    return None
