"""Cores: the UAVs' half, the others' half."""

import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import PROPERTY

from outrider.running.cores import can_be_kept_apart, cores_for, halves, keep_apart


@given(st.sets(st.integers(0, 255), min_size=1))
@PROPERTY
def test_halves_share_nothing_and_leave_nothing(cores: set[int]) -> None:
    first, second = halves(cores)
    assert first | second == cores
    assert len(first) - len(second) in (0, 1)
    assert not first & second or len(cores) == 1


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_a_uav_gets_other_cores_than_the_simulator() -> None:
    children = [
        subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) for _ in range(2)
    ]
    try:
        keep_apart({children[0].pid: True, children[1].pid: False})
        uav, other = (os.sched_getaffinity(child.pid) for child in children)
        assert uav
        assert other
        assert not uav & other
    finally:
        for child in children:
            child.communicate(b"\n")


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_a_process_that_has_gone_keeps_no_other_from_its_cores() -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as there:
        keep_apart({gone.pid: True, there.pid: True})
        found = os.sched_getaffinity(there.pid)
        there.communicate(b"\n")
    assert found == cores_for(is_uav=True) < os.sched_getaffinity(0)


def test_few_vehicles_are_kept_apart_and_many_are_not() -> None:
    cores = os.cpu_count() or 1
    assert can_be_kept_apart(2)
    assert can_be_kept_apart(2 * cores)
    assert not can_be_kept_apart(2 * cores + 1)
