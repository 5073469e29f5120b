"""Bare lockstep exchange: three processes send the payloads of a tick over Zenoh and compute nothing.

As a program it is one of the two clients.
"""

import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import zenoh

OBSERVATION, COMMAND = bytes(273), bytes(343)
"""Payloads of the same length as the UAV's in `escort`."""
_CLIENTS = ("uav", "ugv")
_OVER = b"over"


def _config(mode: str, endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("scouting/delay", "0")
    config.insert_json5("transport/shared_memory/enabled", "false")
    endpoints = "listen/endpoints" if mode == "router" else "connect/endpoints"
    config.insert_json5(endpoints, f'["{endpoint}"]')
    return config


def _publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    return session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)


def _answer(name: str, endpoint: str) -> None:
    """Answer each observation with a command until the exchange ends."""
    with zenoh.open(_config("client", endpoint)) as session:
        observations = session.declare_subscriber(
            f"bare/{name}/observation", zenoh.handlers.FifoChannel(256)
        )
        commands = _publisher(session, f"bare/{name}/command")
        commands.put(COMMAND)
        while observations.recv().payload.to_bytes() != _OVER:
            commands.put(COMMAND)


def ticks_per_second(ticks: int) -> float:
    """Return the rate of a lockstep exchange with two clients, each a process."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="o-"))
        endpoint = f"unixsock-stream/{Path(folder) / 'bare.sock'}"
        session = stack.enter_context(zenoh.open(_config("router", endpoint)))
        commands = session.declare_subscriber("bare/*/command", zenoh.handlers.FifoChannel(256))
        observations = [_publisher(session, f"bare/{name}/observation") for name in _CLIENTS]
        for name in _CLIENTS:
            client = subprocess.Popen([sys.executable, "-P", __file__, name, endpoint])
            stack.callback(client.wait)
            stack.callback(client.terminate)
        for _ in _CLIENTS:
            commands.recv()
        started = time.perf_counter()
        for _ in range(ticks):
            for observation in observations:
                observation.put(OBSERVATION)
            for _ in _CLIENTS:
                commands.recv()
        return ticks / (time.perf_counter() - started)


if __name__ == "__main__":
    _answer(*sys.argv[1:])
