"""Signals as requests to stop: any number of them, at any moment."""

import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any

import pytest

from outrider.cli.stopping import Stop, stop_on_signals


def test_a_signal_inside_the_handler_of_another_is_counted() -> None:
    """At each line of the handler, and of all that it calls, another signal arrives."""
    arrived = 0

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal arrived
        if event == "line" and stop.count and arrived < 50:
            arrived += 1
            stop.handle(signal.SIGTERM, frame)
        return trace

    def deliver() -> None:
        sys.settrace(trace)
        stop.handle(signal.SIGINT, None)
        sys.settrace(None)

    stop = Stop()
    thread = threading.Thread(target=deliver, daemon=True)  # a deadlock must not end the test run
    thread.start()
    thread.join(10.0)
    assert not thread.is_alive()
    assert stop.count == arrived + 1 > 1
    stop.wait()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_burst_of_signals_ends_the_wait() -> None:
    with stop_on_signals() as stop:
        threading.Timer(0.2, _burst).start()
        stop.wait()
        time.sleep(0.2)
    assert stop
    assert stop.exit_code == 128 + signal.SIGTERM


def _burst() -> None:
    for _ in range(100):
        os.kill(os.getpid(), signal.SIGTERM)
