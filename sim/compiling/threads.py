"""Many worlds on several cores: compiled loops over a range of worlds, each thread takes ranges until none is left.

Threads of Python, not of numba: compiled code gives the interpreter away while it runs, so nothing else is needed,
the compile cache works as everywhere, and processes that fork or spawn meet no thread pool of a library.
"""

import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

_LEAST = 16
"""Worlds that are worth a call from a thread."""
_PARTS = 8
"""Ranges for each thread: a core that is slow for a while holds up the others by one of them at most."""


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class WorkerThreads:
    """Threads that share the worlds of a batch; the caller is one of them.

    Args:
        threads: How many; by default one for each core that this process may use.

    Raises:
        ValueError: If it is less than 1.
    """

    def __init__(self, threads: int | None = None) -> None:
        if threads is not None and not (threads >= 1 and threads % 1 == 0):
            raise ValueError(f"threads = {threads}: must be a whole number, 1 or more")
        self.threads = threads or cores()
        self._pool: ThreadPoolExecutor | None = None
        self._owner = -1  # a process that was forked has the pool's object, but not its threads
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type["WorkerThreads"], tuple[int]]:
        return WorkerThreads, (self.threads,)  # a copy has threads of its own

    def shares(self, count: int) -> bool:
        """True if so many worlds are worth more than one thread."""
        return count >= 2 * _LEAST and self.threads > 1

    def share(self, work: Callable[..., object], count: int, *arguments: object) -> None:
        """Call `work(*arguments, begin, end)` so that the ranges cover 0 to `count`, and wait for all of them.

        Whichever thread is free takes the next range: cores are not equally fast, and flights not equally long.

        Raises:
            Exception: One that any of them raised.
        """
        if not self.shares(count):
            work(*arguments, 0, count)
            return
        parts = min(_PARTS * self.threads, count // _LEAST)
        edges = [count * part // parts for part in range(parts + 1)]
        ranges = iter(list(itertools.pairwise(edges)))

        def take() -> None:
            for begin, end in ranges:  # a list's iterator gives each to one thread
                work(*arguments, begin, end)

        helpers = min(self.threads, parts) - 1
        others = [self._executor().submit(take) for _ in range(helpers)]
        try:
            take()
        finally:
            for other in others:
                other.exception()  # waits
        for other in others:
            other.result()

    def _executor(self) -> ThreadPoolExecutor:
        with self._lock:
            if self._pool is None or self._owner != os.getpid():
                self._pool = ThreadPoolExecutor(
                    self.threads - 1, thread_name_prefix="outrider-worlds"
                )
                self._owner = os.getpid()
            return self._pool

    def close(self) -> None:
        """End the threads."""
        with self._lock:
            if self._pool is not None and self._owner == os.getpid():
                self._pool.shutdown()
            self._pool = None
