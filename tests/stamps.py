"""Stamps of ROS 2, for tests."""

from typing import Any


def seconds_of(time: Any) -> float:
    """A stamp [s]."""
    return float(time.sec) + 1e-9 * float(time.nanosec)
