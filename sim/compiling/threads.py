"""Threads for many worlds: each repeatedly runs a compiled loop over a range of worlds.

Python threads, not numba's: compiled code releases the interpreter's lock, the compile cache works as elsewhere, and
processes that fork or spawn inherit no thread pool of a library.
"""

import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

_LEAST = 16
"""Smallest number of worlds for a call from a thread."""
_PARTS = 8
"""Ranges per thread: a temporarily slow core delays the others by at most one range."""


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class WorkerThreads:
    """Threads that share the worlds of a batch; the caller is one of them.

    Args:
        threads: Number of threads; by default one per core that this process may use.

    Raises:
        ValueError: If it is below 1.
    """

    def __init__(self, threads: int | None = None) -> None:
        if threads is not None and not (threads >= 1 and threads % 1 == 0):
            raise ValueError(f"threads = {threads}: too few; allowed: a whole number, 1 or more")
        self.threads = threads or cores()
        self._pool: ThreadPoolExecutor | None = None
        self._owner = -1  # a forked process has the pool's object, but not its threads
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type["WorkerThreads"], tuple[int]]:
        return WorkerThreads, (self.threads,)  # a copy has its own threads

    def shares(self, count: int) -> bool:
        """Return whether this number of worlds is worth more than one thread."""
        return count >= 2 * _LEAST and self.threads > 1

    def share(self, work: Callable[..., object], count: int, *arguments: object) -> None:
        """Call `work(*arguments, begin, end)` for ranges that cover 0 to `count`, and wait for all of them.

        Each free thread takes the next range, because cores and episodes differ in speed and length.

        Raises:
            Exception: Raised by any of the calls.
        """
        if not self.shares(count):
            work(*arguments, 0, count)
            return
        parts = min(_PARTS * self.threads, count // _LEAST)
        edges = [count * part // parts for part in range(parts + 1)]
        ranges = iter(list(itertools.pairwise(edges)))

        def take() -> None:
            for begin, end in ranges:  # a list's iterator yields each range to one thread
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
