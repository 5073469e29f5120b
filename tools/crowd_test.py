"""Attacks of a crowd at the router's port, and of a vehicle with credentials, against a real run, as a table.

Each row is a run on the wall clock with a simulator, a UAV and a UGV as processes over loopback. While it flies,
the attack is made, and then an observer joins. The table tells how long that took, what the simulator's memory was
and became, and how many ticks were late. `make crowd-test`, or `python tools/crowd_test.py ATTACK ...`; exit code 1
where a limit is not kept.
"""

import argparse
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import zenoh

from bus.access import (
    Credential,
    CredentialSet,
    client_settings,
    new_credentials,
    write_credentials,
)

RUN, SECONDS, PORT = "crowd", 15.0, 17461
ENDPOINT = f"tcp/127.0.0.1:{PORT}"
"""A run is stopped after so many seconds, or when its attack is over."""
JOIN_LIMIT, GROWTH_LIMIT, LATE_LIMIT = 2.0, 150.0, 0.1
"""An observer joins within so many seconds; the simulator grows by no more MB; no larger share of the ticks is late."""
Attack = Callable[["Run"], contextlib.AbstractContextManager[None]]


class Run:
    """The run that is attacked."""

    def __init__(self, given: CredentialSet, simulator: int) -> None:
        self.given, self.simulator = given, simulator
        self.rogue = given.of("ugv_0")
        self.endpoint = ENDPOINT

    @contextlib.contextmanager
    def session(self, credential: Credential, patience: float = 30.0) -> Iterator[zenoh.Session]:
        """A session that asks nobody's leave; `patience` is how long it tries to connect [s]."""
        settings: dict[str, Any] = {
            "mode": "client",
            "connect/endpoints": [self.endpoint],
            "connect/timeout_ms": int(1000 * patience),
            "connect/exit_on_failure": True,
            "connect/retry": {
                "period_init_ms": 50,
                "period_max_ms": 200,
                "period_increase_factor": 2,
            },
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "scouting/delay": 0,
        } | client_settings(credential)
        config = zenoh.Config()
        for path, value in settings.items():
            config.insert_json5(path, json.dumps(value))
        with zenoh.open(config) as opened:
            yield opened

    def memory(self, field: str) -> float:
        """VmRSS or VmHWM of the simulator [MB]."""
        for line in Path(f"/proc/{self.simulator}/status").read_text(encoding="ascii").splitlines():
            if line.startswith(field):
                return int(line.split()[1]) / 1024
        raise SystemExit(f"no {field} in the simulator's status")


@contextlib.contextmanager
def nothing(_run: Run) -> Iterator[None]:
    """The reference of all others."""
    yield


def connections(count: int, said: bytes) -> Attack:
    """Connections without a password that say no more than this."""

    @contextlib.contextmanager
    def attack(_run: Run) -> Iterator[None]:
        with contextlib.ExitStack() as stack:
            for _ in range(count):
                with contextlib.suppress(OSError):
                    opened = stack.enter_context(socket.create_connection(("127.0.0.1", PORT), 2.0))
                    opened.sendall(said)
            yield

    return attack


def puts(count: int, size: int, sessions: int = 1) -> Attack:
    """Payloads of so many bytes on the UGV's own key, by its own credentials."""

    @contextlib.contextmanager
    def attack(run: Run) -> Iterator[None]:
        payload = bytes(size)

        def send() -> None:
            with run.session(run.rogue) as opened, contextlib.suppress(zenoh.ZError):
                for _ in range(count // sessions):
                    opened.put(
                        f"outrider/{RUN}/ugv_0/command",
                        payload,
                        congestion_control=zenoh.CongestionControl.BLOCK,
                    )

        threads = [threading.Thread(target=send, daemon=True) for _ in range(sessions)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(20.0)
        yield

    return attack


def tokens(key: str, count: int, *, kept: bool) -> Attack:
    """Liveliness tokens of the UGV, kept, or each taken back at once."""

    @contextlib.contextmanager
    def attack(run: Run) -> Iterator[None]:
        with run.session(run.rogue) as opened:
            held = []
            for number in range(count):
                token = opened.liveliness().declare_token(
                    f"outrider/{RUN}/ugv_0/{key.format(number)}"
                )
                held.append(token) if kept else token.undeclare()
            yield

    return attack


ATTACKS: dict[str, Attack] = {
    "none": nothing,
    "idle-400": connections(400, b""),
    "garbage-400": connections(400, b"\xff\xff" + b"\xa5" * 300),
    "idle-1900": connections(1900, b""),
    "put-900MB": puts(1, 900_000_000),
    "puts-36x32MB": puts(36, 32_000_000, 4),
    "puts-400x1.9MB": puts(400, 1_900_000, 4),
    "puts-4000x64kB": puts(4000, 65_536, 4),
    "tokens-20000": tokens("alive/{}", 20_000, kept=True),
    "tokens-one-key": tokens("alive/7", 20_000, kept=True),
    "tokens-flapping": tokens("alive/7", 20_000, kept=False),
}


def measure(name: str) -> dict[str, Any]:
    """Fly a run, attack it, and say what happened."""
    given = new_credentials(RUN, ["uav_0"], ["ugv_0"])
    with (
        tempfile.TemporaryDirectory(prefix="outrider-crowd-") as folder,
        contextlib.ExitStack() as stack,
    ):
        files = write_credentials(given, Path(folder) / "credentials")
        endpoint = ENDPOINT

        def start(*arguments: str) -> "subprocess.Popen[str]":
            command = [sys.executable, "-m", "outrider", *arguments, "--run", RUN]
            log = stack.enter_context(
                (Path(folder) / f"{arguments[0]}.log").open("w+", encoding="utf-8")
            )
            return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)

        pace = ["--realtime", "1", "--duration", "3600", "--json"]
        simulator = start(
            "simulator",
            "escort",
            "--listen",
            endpoint,
            "--credentials",
            str(files["router"]),
            *pace,
        )
        children = [simulator]
        try:
            for role in ("uav", "ugv"):
                children.append(
                    start(role, "--connect", endpoint, "--credentials", str(files[f"{role}_0"]))
                )
            run = Run(given, simulator.pid)
            with run.session(given.of("observer"), 60.0) as watching:
                status = watching.declare_subscriber(
                    f"outrider/{RUN}/status", zenoh.handlers.RingChannel(1)
                )
                tick = 0
                while tick < 20:
                    if simulator.poll() is not None:
                        raise SystemExit(
                            f"the simulator has ended: {(Path(folder) / 'simulator.log').read_text()[-500:]}"
                        )
                    sample = status.try_recv()
                    tick = tick if sample is None else json.loads(sample.payload.to_bytes())["tick"]
                    time.sleep(0.05)
            before = run.memory("VmRSS")
            began = started = time.monotonic()
            with ATTACKS[name](run):
                attacked, started = time.monotonic() - started, time.monotonic()
                try:
                    with run.session(given.of("observer"), 20.0) as late:
                        received = late.declare_subscriber(
                            f"outrider/{RUN}/status", zenoh.handlers.RingChannel(1)
                        )
                        joined = time.monotonic() - started
                        received.recv()
                except zenoh.ZError:
                    joined = float("inf")
                after = run.memory("VmRSS")
            time.sleep(max(0.0, began + SECONDS - time.monotonic()))
            peak = run.memory("VmHWM")
            simulator.send_signal(signal.SIGINT)
            summary = json.loads(simulator.communicate(timeout=120.0)[0] or "null")
        finally:
            for child in children:
                if child.poll() is None:
                    child.kill()
                child.wait()
                if child.stdout is not None:
                    child.stdout.close()
    return {
        "attack": name,
        "seconds": attacked,
        "join_seconds": joined,
        "memory_before_mb": before,
        "memory_after_mb": after,
        "memory_peak_mb": peak,
        "ticks": summary["ticks"],
        "late_ticks": summary["late_ticks"],
        "missing": summary["missing_commands"],
        "faults": summary["faults"],
    }


def kept(row: dict[str, Any]) -> bool:
    """True if the limits are kept."""
    grown = row["memory_peak_mb"] - row["memory_before_mb"]
    late = row["late_ticks"] / row["ticks"]
    return bool(row["join_seconds"] <= JOIN_LIMIT and grown <= GROWTH_LIMIT and late <= LATE_LIMIT)


def main() -> int:
    """Attacks on a run by a crowd at its port, or by a vehicle with credentials, as a table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("names", metavar="NAME", nargs="*", help=", ".join(ATTACKS))
    names = parser.parse_args().names
    unknown = [name for name in names if name not in ATTACKS]
    if unknown:
        parser.error(f"{' '.join(unknown)}: unknown; allowed: {', '.join(ATTACKS)}")
    failed = 0
    limits = f"join {JOIN_LIMIT:g} s, +{GROWTH_LIMIT:g} MB, {LATE_LIMIT:.0%} of ticks late"
    sys.stdout.write(
        f"{os.cpu_count()} cores; limits: {limits}\n{'attack':18}{'took s':>8}{'join s':>8}{'MB before':>11}"
    )
    sys.stdout.write(f"{'after':>8}{'peak':>8}{'late':>6}{'of':>6}  missing commands, faults\n")
    warm = [sys.executable, "-m", "outrider", "run", "escort", "--duration", "1", "--no-files"]
    subprocess.run(warm, check=True, capture_output=True)  # nobody must wait for a compiler
    for name in names or list(ATTACKS):
        row = measure(name)
        failed += not kept(row)
        sys.stdout.write(
            f"{name:18}{row['seconds']:8.1f}{row['join_seconds']:8.2f}{row['memory_before_mb']:11.0f}{row['memory_after_mb']:8.0f}"
            f"{row['memory_peak_mb']:8.0f}{row['late_ticks']:6}{row['ticks']:6}  {row['missing']} {row['faults']}"
            f"{'' if kept(row) else '  NOT KEPT'}\n"
        )
        sys.stdout.flush()
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
