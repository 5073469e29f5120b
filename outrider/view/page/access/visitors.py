"""The pages that NiceGUI has built: those that nobody opens go soon, and their memory goes back to the system.

NiceGUI keeps what it has built for a browser until that has been away for a while; a page whose browser never opens its
channel, as that of `curl`, takes 0.3 MB for a minute. What is deleted are rings of objects, which Python finds late in
a process of this size, and the C library keeps their memory for later: what was taken at most stays taken, so that few
may be there at once.
"""

import asyncio
import contextlib
import ctypes
import gc
from collections.abc import Callable
from typing import Any

from nicegui import Client, ui

_UNOPENED = 16
"""So many pages may wait for their browsers; then the oldest goes, and its browser asks again."""
_GARBAGE = 16
"""So many pages that have gone are looked for at once, without waiting for the next look."""
_PATIENCE = 20.0
"""So long a page waits for its browser [s]."""
_PERIOD = 5.0
"""Wall time between two looks [s]."""


class Visitors:
    """Looks after the pages from when they are built until they are gone."""

    def __init__(self) -> None:
        self._unopened: dict[str, Client] = {}
        self._gone = 0
        self._trim = _trimmer()

    @property
    def unopened(self) -> int:
        """Pages that wait for their browsers."""
        return len(self._unopened)

    def welcome(self) -> None:
        """A page is built: make room for it."""
        while len(self._unopened) >= _UNOPENED:
            next(iter(self._unopened.values())).delete()
        if self._gone >= _GARBAGE:
            self._collect()
        client = ui.context.client
        self._unopened[client.id] = client
        client.on_connect(self._opened)
        client.on_delete(self._deleted)

    def _opened(self, client: Client) -> None:
        self._unopened.pop(client.id, None)

    def _deleted(self, client: Client) -> None:
        self._unopened.pop(client.id, None)
        self._gone += 1

    def tidy(self, now: float) -> None:
        """Delete the pages that nobody has opened, and give back the memory of all that have gone.

        Args:
            now: By the clock of the day [s].
        """
        for client in [
            client for client in self._unopened.values() if client.created <= now - _PATIENCE
        ]:
            client.delete()
        if self._gone:
            self._collect()

    def _collect(self) -> None:
        self._gone = 0
        gc.collect()
        self._trim(0)

    async def follow(self, clock: Callable[[], float]) -> None:
        """Tidy from time to time, until cancelled.

        Args:
            clock: The time of day [s].
        """
        gc.collect()
        gc.freeze()  # what is there now stays: looking for rings in it would hold up the frames
        while True:
            await asyncio.sleep(_PERIOD)
            self.tidy(clock())


def _trimmer() -> Callable[[int], Any]:
    """The C library's `malloc_trim`, where it has one."""
    with contextlib.suppress(OSError, AttributeError):
        found: Callable[[int], Any] = ctypes.CDLL(None).malloc_trim
        return found
    return lambda _keep: None
