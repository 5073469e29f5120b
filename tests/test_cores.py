"""Cores: the UAVs' half, the others' half."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import PROPERTY

from outrider.running.cores import can_be_kept_apart, halves, keep_apart

THREADS = """
import threading
threading.Thread(target=threading.Event().wait, daemon=True).start()
print(flush=True)
input()
"""
needs_two_cores = pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")


@given(st.sets(st.integers(0, 255), min_size=1))
@PROPERTY
def test_halves_share_nothing_and_leave_nothing(cores: set[int]) -> None:
    first, second = halves(cores)
    assert first | second == cores
    assert len(first) - len(second) in (0, 1)
    assert not first & second or len(cores) == 1


@contextmanager
def _on_cores(count: int) -> Iterator[None]:
    """This process, and what it starts, on so many cores at most."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def _processes(count: int) -> Iterator[list[int]]:
    """Processes of two threads each, by their ids."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    children = [subprocess.Popen([sys.executable, "-c", THREADS], **pipes) for _ in range(count)]
    try:
        for child in children:
            assert child.stdout is not None
            child.stdout.readline()
        yield [child.pid for child in children]
    finally:
        for child in children:
            child.communicate(b"\n")


def _standing(pid: int) -> tuple[set[int], set[int]]:
    """The cores of a process' threads, and how they are scheduled; all threads alike."""
    threads = [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]
    assert len(threads) == 2
    (cores,) = {frozenset(os.sched_getaffinity(thread)) for thread in threads}
    return set(cores), {os.sched_getscheduler(thread) for thread in threads}


@needs_two_cores
@pytest.mark.parametrize("lockstep", [True, False])
def test_all_threads_of_a_uav_get_other_cores_than_the_others_who_share_one_as_a_batch_in_lockstep(
    lockstep: bool,
) -> None:
    with _on_cores(2), _processes(2) as (uav, simulator):
        keep_apart({uav: True, simulator: False}, lockstep=lockstep)
        first, second = halves(os.sched_getaffinity(0))
        assert _standing(uav) == (second, {os.SCHED_OTHER})
        kind = os.SCHED_BATCH if lockstep else os.SCHED_OTHER
        assert _standing(simulator) == (first, {kind})


def test_on_a_single_core_nobody_is_a_batch() -> None:
    with _on_cores(1), _processes(2) as (uav, simulator):
        keep_apart({uav: True, simulator: False}, lockstep=True)
        for pid in (uav, simulator):
            assert _standing(pid) == (os.sched_getaffinity(0), {os.SCHED_OTHER})


@needs_two_cores
def test_a_process_that_has_gone_keeps_no_other_from_its_cores() -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    with _processes(1) as (there,):
        keep_apart({gone.pid: True, there: True})
        assert _standing(there)[0] == halves(os.sched_getaffinity(0))[1]


def test_few_vehicles_are_kept_apart_and_many_are_not() -> None:
    cores = os.cpu_count() or 1
    assert can_be_kept_apart(2)
    assert can_be_kept_apart(2 * cores)
    assert not can_be_kept_apart(2 * cores + 1)
