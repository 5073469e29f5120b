"""Pools of worker processes, for sweeps and searches."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker


def _do_nothing() -> None:
    pass


def open_pool(jobs: int, prepare: Callable[[], None] = _do_nothing) -> ProcessPoolExecutor:
    """Return a pool of spawned processes that end when this process ends, even if it is killed.

    Args:
        jobs: Number of worker processes.
        prepare: Module-level function, called first in each worker.
    """
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin, initargs=(prepare,))


def _begin(prepare: Callable[[], None]) -> None:
    threading.Thread(target=_end_with_parent, name="outrider-watchdog", daemon=True).start()
    prepare()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def interrupts_masked() -> Iterator[None]:
    """Mask SIGINT in processes started here: a terminal sends it to all, but their parent ends them."""
    # Otherwise it starts with the first process and unblocks SIGINT again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
