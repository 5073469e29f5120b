"""Worker processes on all cores that return results in the order of the calls."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Self, TypeVar

from bus.errors import PeerLost
from outrider.running.workers import interrupts_masked, open_pool

_Result = TypeVar("_Result")

_AHEAD = 3
"""Pending tasks per worker."""
_LOOK = 0.1
"""Interval between checks for a request to stop [s]."""


class Workers:
    """Worker processes; with one job everything runs in this process.

    Args:
        jobs: Number of processes.
        warm: Function that each process calls first.
    """

    def __init__(self, jobs: int, warm: Callable[[], None]) -> None:
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        if jobs == 1:
            warm()
        else:
            self._pool = open_pool(jobs, warm)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def stream(
        self,
        function: Callable[..., _Result],
        calls: Iterable[tuple[Any, ...]],
        ends: Callable[[], bool],
    ) -> Iterator[_Result]:
        """Yield the results of these calls, in order.

        Args:
            function: Function of a module, so that workers can import it.
            calls: Arguments of each call.
            ends: Return true to stop; finished calls are still yielded.

        Raises:
            PeerLost: If a worker dies.
        """
        if self._pool is None:
            yield from (function(*call) for call in calls if not ends())
            return
        try:
            yield from self._answers(self._pool, function, iter(calls), ends)
        except BrokenProcessPool as error:
            raise PeerLost(
                "a worker process died: perhaps out of memory; try fewer --jobs"
            ) from error

    def _answers(
        self,
        pool: ProcessPoolExecutor,
        function: Callable[..., _Result],
        calls: Iterator[tuple[Any, ...]],
        ends: Callable[[], bool],
    ) -> Iterator[_Result]:
        asked: deque[Future[_Result]] = deque()
        while True:
            while len(asked) < _AHEAD * self._jobs and not ends():
                call = next(calls, None)
                if call is None:
                    break
                with interrupts_masked():
                    asked.append(pool.submit(function, *call))
            if not asked:
                return
            while not asked[0].done() and not ends():
                wait((asked[0],), timeout=_LOOK)
            if ends():
                yield from (
                    future.result() for future in asked if not future.cancel() and future.done()
                )
                return
            yield asked.popleft().result()
