"""ROS 2 time stamps, for tests."""

from typing import Any


def seconds_of(time: Any) -> float:
    """Return a time stamp [s]."""
    return float(time.sec) + 1e-9 * float(time.nanosec)
