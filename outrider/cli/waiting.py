"""Waiting for a run's simulator, and for a router that is away."""

import time
from typing import TYPE_CHECKING

from bus.keys import STATUS
from bus.messages.telemetry import Status
from outrider.cli.stopping import Stop

if TYPE_CHECKING:
    from bus.session import Session

AWAY = 3.0
"""The time after which a party that is away has gone for good [s]."""


class RouterTimer:
    """Tells a router that has gone from one that is away for a moment."""

    def __init__(self, session: "Session") -> None:
        self._session = session
        self._since: float | None = None

    def has_gone(self) -> bool:
        """True once the router was away at every look for `AWAY`."""
        if self._session.connected:
            self._since = None
            return False
        self._since = self._since or time.monotonic()
        return time.monotonic() - self._since > AWAY


def tell_waiting(run: str) -> None:
    """Say that nothing comes before the simulator does."""
    from outrider.cli.console import ERR  # a vehicle's process must not load a scenario

    ERR.tell(f"waiting for the simulator of the run {run}; Ctrl-C leaves")


def await_status(session: "Session", stop: Stop) -> Status | None:
    """The first status that tells of the vehicles; None if a signal came before it."""
    statuses, told = session.inbox(STATUS), False
    while not stop:
        envelope = statuses.receive(0.5 if told else 1.0)
        status = None if envelope is None else envelope.message
        if isinstance(status, Status) and status.geometry is not None:
            session.forget(statuses)
            return status
        if not (told or stop):
            told = True
            tell_waiting(session.run)
    return None
