"""The limit of a lockstep tick: processes that exchange the same payloads over Zenoh and compute nothing.

Run as a module it is one of the peers.
"""

import subprocess
import sys
import time

import zenoh

from outrider.running.run_folder import run_folder


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


def ticks_per_second(observation: bytes, answer: bytes, ticks: int, *, peers: int = 2) -> float:
    """Lockstep ticks a second that a bare exchange of these payloads reaches.

    Args:
        observation: Sent to each peer at each tick.
        answer: Sent back by each.
        ticks: How many.
        peers: Processes that answer.
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


if __name__ == "__main__":
    _peer(sys.argv[1], sys.argv[2], bytes.fromhex(sys.argv[3]))
