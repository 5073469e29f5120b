"""The processor cores of a run's processes.

In lockstep they wait for each other thousands of times a second. A process that finds its core as it left it answers
much sooner than one that follows another process there, so the UAVs, which have most to do, get one half of the cores
for themselves.
"""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path


def halves(cores: set[int]) -> tuple[set[int], set[int]]:
    """The cores in two halves, the first not smaller; twice all of them where there is only one."""
    ordered = sorted(cores)
    if len(ordered) < 2:
        return set(ordered), set(ordered)
    middle = (len(ordered) + 1) // 2
    return set(ordered[:middle]), set(ordered[middle:])


def can_be_kept_apart(vehicles: int) -> bool:
    """True for so few that each finds its core as it left it; many are divided better by the system."""
    return vehicles <= 2 * (os.cpu_count() or 1)


def keep_apart(pids: Mapping[int, bool], *, lockstep: bool = False) -> None:
    """Give the processes that are true the second half of this process' cores, and the others the first.

    In lockstep, where the others share one core, each is left to finish what it does there: they are scheduled as a
    batch, or every message would interrupt another of them.

    Where the system has no such thing, or a process has gone, nothing happens.

    Args:
        pids: Process ids, and whether each is a UAV's.
        lockstep: Whether none of them keeps the wall clock.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    first, second = halves(os.sched_getaffinity(0))
    as_batch = lockstep and len(first) == 1 and first != second and hasattr(os, "SCHED_BATCH")
    for pid, is_uav in pids.items():
        for thread in _threads(pid):
            with contextlib.suppress(OSError):
                os.sched_setaffinity(thread, second if is_uav else first)
                if as_batch and not is_uav:
                    os.sched_setscheduler(thread, os.SCHED_BATCH, os.sched_param(0))


def _threads(pid: int) -> list[int]:
    """The main thread of a process, from which those that are still to come inherit, and then the others."""
    others: set[int] = set()
    with contextlib.suppress(OSError):
        others = {int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()}
    return [pid, *(others - {pid})]
