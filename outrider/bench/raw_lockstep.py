"""The limit of a lockstep tick: processes that exchange the same payloads over Zenoh and compute nothing.

Run as a module it is one of the peers, or an exchange whose processes are kept apart as a run's are.
"""

import os
import subprocess
import sys
import time

import zenoh

from outrider.running.cores import keep_apart
from outrider.running.run_folder import run_folder

_APART = "apart"


def _settings(mode: str, endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("scouting/delay", "0")
    config.insert_json5("transport/shared_memory/enabled", "false")
    config.insert_json5(
        f"{'listen' if mode == 'router' else 'connect'}/endpoints", f'["{endpoint}"]'
    )
    return config


def _peer(name: str, endpoint: str, answer: bytes) -> None:
    with zenoh.open(_settings("client", endpoint)) as session:
        subscriber = session.declare_subscriber(
            f"raw/{name}/observation", zenoh.handlers.FifoChannel(256)
        )
        publisher = session.declare_publisher(
            f"raw/{name}/command", congestion_control=zenoh.CongestionControl.BLOCK
        )
        publisher.put(b"ready")
        while subscriber.recv().payload.to_bytes() != b"over":
            publisher.put(answer)


def kept_apart(observation: bytes, answer: bytes, ticks: int) -> float:
    """`ticks_per_second` of two peers whose processes have the cores of a run's, in an interpreter of its own."""
    module = [sys.executable, "-P", "-m", "outrider.bench.raw_lockstep", _APART]
    words = [observation.hex(), answer.hex(), str(ticks)]
    return float(subprocess.run([*module, *words], capture_output=True, check=True).stdout)


def ticks_per_second(
    observation: bytes, answer: bytes, ticks: int, *, peers: int = 2, apart: bool = False
) -> float:
    """Lockstep ticks a second that a bare exchange of these payloads reaches.

    Args:
        observation: Sent to each peer at each tick.
        answer: Sent back by each.
        ticks: How many.
        peers: Processes that answer.
        apart: Whether the first has half of the cores for itself, as a run's UAV; this process then stays so.
    """
    names = [f"peer_{k}" for k in range(peers)]
    with run_folder() as folder:
        endpoint = f"unixsock-stream/{folder / 'raw.sock'}"
        with zenoh.open(_settings("router", endpoint)) as session:
            subscriber = session.declare_subscriber(
                "raw/*/command", zenoh.handlers.FifoChannel(256)
            )
            publishers = [
                session.declare_publisher(
                    f"raw/{name}/observation", congestion_control=zenoh.CongestionControl.BLOCK
                )
                for name in names
            ]
            module = [sys.executable, "-P", "-m", "outrider.bench.raw_lockstep"]
            processes = [
                subprocess.Popen([*module, name, endpoint, answer.hex()]) for name in names
            ]
            try:
                for _ in names:
                    subscriber.recv()
                if apart:
                    first, *others = (peer.pid for peer in processes)
                    pids = {os.getpid(): False, first: True} | dict.fromkeys(others, False)
                    keep_apart(pids, lockstep=True)
                started = time.perf_counter()
                for _ in range(ticks):
                    for publisher in publishers:
                        publisher.put(observation)
                    for _ in names:
                        subscriber.recv()
                seconds = time.perf_counter() - started
                for publisher in publishers:
                    publisher.put(b"over")
            finally:
                for peer in processes:
                    try:
                        peer.wait(5.0)
                    except subprocess.TimeoutExpired:
                        peer.kill()
                        peer.wait()
    return ticks / seconds


if __name__ == "__main__" and sys.argv[1] == _APART:
    told, given = (bytes.fromhex(word) for word in sys.argv[2:4])
    sys.stdout.write(f"{ticks_per_second(told, given, int(sys.argv[4]), apart=True)}\n")
elif __name__ == "__main__":
    _peer(sys.argv[1], sys.argv[2], bytes.fromhex(sys.argv[3]))
