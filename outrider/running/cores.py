"""The processor cores of a run's processes.

In lockstep they wait for each other thousands of times a second. A process that finds its core as it left it answers
much sooner than one that follows another process there, so the UAVs, which have most to do, get one half of the cores
for themselves.
"""

import contextlib
import os
from collections.abc import Mapping


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


def cores_for(*, is_uav: bool) -> frozenset[int]:
    """The cores of a vehicle's process; empty where the system does not say which there are."""
    if not hasattr(os, "sched_getaffinity"):
        return frozenset()
    return frozenset(halves(os.sched_getaffinity(0))[1 if is_uav else 0])


def keep_apart(pids: Mapping[int, bool]) -> None:
    """Give the processes that are true the second half of this process' cores, and the others the first.

    Where the system has no such thing, or a process has gone, nothing happens.

    Args:
        pids: Process ids, and whether each is a UAV's.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    first, second = halves(os.sched_getaffinity(0))
    for pid, is_uav in pids.items():
        with contextlib.suppress(OSError):
            os.sched_setaffinity(pid, second if is_uav else first)
