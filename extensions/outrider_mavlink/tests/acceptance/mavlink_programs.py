"""`outrider mavlink` with third-party programs: MAVSDK watches and flies, MAVProxy connects and logs.

Both live in an environment of their own, `.venv-mavlink`, which the first call creates. The test takes three
minutes:
make bridge-test ARGS=mavlink
"""

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bridge_checks import (
    Row,
    await_text,
    called,
    environment,
    free_port,
    json_of,
    output,
    outrider,
    report,
    started,
)

FOREIGN = Path(__file__).resolve().parent / "foreign"
MODEL = FOREIGN.parents[1] / "vehicle_model.py"

NEEDED = ("mavsdk>=4,<5", "MAVProxy>=1.8.70,<2", "pymavlink>=2.4.49,<3")
DURATION = 100.0
"""Simulated duration of the run [s]; at twice real time, the checks finish before its end."""


def log_of_mavproxy(python: Path, folder: Path) -> Iterator[Row]:
    """Check the log of MAVProxy with a tool of pymavlink."""
    tool = python.with_name("mavlogdump.py")
    read = called(python, tool, "--types", "HEARTBEAT", "--show-source", folder / "flight.tlog")
    lines = [line for line in read.stdout.splitlines() if "HEARTBEAT" in line]
    both = all(any(f"srcSystem={n} " in line for line in lines) for n in (1, 2))
    yield Row("MAVProxy logs heartbeats of both", f"{len(lines)} in its log", both)
    word = "Detected vehicle 1:1"
    log = (folder / "mavproxy.out").read_text()
    yield Row("and reports that they are there", word, word in log)


def unanswered(folder: Path) -> Iterator[Row]:
    """Fly in lockstep without any reply from a ground station: the same bits as with the run's own pilot.

    Raises:
        SystemExit: If a process does not start.
    """
    router = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    ports = [free_port(socket.SOCK_DGRAM) for _ in range(2)]
    begin = ("--listen", router, "--duration", 20, "--out", folder / "unanswered", "--json")
    to = ("--connect", router)
    log = folder / "unanswered.log"
    with ExitStack() as stack:
        simulator = stack.enter_context(started(log, outrider("simulator", "escort", *begin)))
        await_text(log, "listening on")
        uav = ("--vehicle", "uav_0", "--in", f"udpin:127.0.0.1:{ports[0]}")
        for name, words in (
            ("unanswered-uav", outrider("mavlink", *uav, *to)),
            ("unanswered-ugv", outrider("ugv", *to)),
            (
                "unanswered-gateway",
                outrider("mavlink", *to, "--to", f"udpout:127.0.0.1:{ports[1]}"),
            ),
        ):
            stack.enter_context(started(folder / f"{name}.log", words))
        simulator.wait(120.0)
    there = json.loads((folder / "unanswered.out").read_text())
    here = json_of("run", "escort", "--duration", 20, "--in-process", "--no-files", "--json")
    same = there["trajectory_sha256"] == here["trajectory_sha256"]
    yield Row("unanswered in lockstep: the same bits", there["trajectory_sha256"][:16], same)


def autopilot_run(
    folder: Path, name: str, seconds: float, autopilot: Callable[[int], tuple[object, ...]]
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Fly in real time with an autopilot; return the summary and the outputs of `outrider mavlink` and the autopilot.

    Args:
        folder: Folder for logs.
        name: Name of the run, for its files.
        seconds: Duration of the run [s].
        autopilot: Returns the command line of the autopilot for the port that it sends to.

    Raises:
        SystemExit: If a process does not start.
    """
    router = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    port, log = free_port(socket.SOCK_DGRAM), folder / f"{name}.log"
    changes = ("uav.0.body=reported", "certificate.max_tracking_error=0.3", "detections.dropout=0")
    begin = ("--listen", router, "--out", folder / name, "--realtime", 1, "--duration", seconds)
    sets = [word for change in changes for word in ("--set", change)]
    to = ("--connect", router)
    uav = ("--autopilot", "uav_0", "--in", f"udpin:127.0.0.1:{port}", "--json")
    with ExitStack() as stack:
        words = outrider("simulator", "escort", *begin, *sets, "--json")
        simulator = stack.enter_context(started(log, words))
        await_text(log, "listening on")
        stack.enter_context(started(folder / f"{name}-ugv.log", outrider("ugv", *to)))
        words = outrider("mavlink", *uav, *to)
        process = stack.enter_context(started(folder / f"{name}-uav.log", words))
        stack.enter_context(started(folder / f"{name}-autopilot.log", autopilot(port)))
        simulator.wait(seconds + 120.0)
        process.wait(20.0)
    ours, theirs = (f"{name}.out", f"{name}-uav.out"), folder / f"{name}-autopilot.out"
    summary, sent = (json.loads((folder / file).read_text()) for file in ours)
    received = json.loads(theirs.read_text().splitlines()[-1])
    return summary, sent, received


def along(folder: Path, python: Path) -> Iterator[Row]:
    """Fly with an autopilot: MAVLink by MAVSDK's server, dynamics by a stand-in of ours."""

    def autopilot(port: int) -> tuple[object, ...]:
        return python, FOREIGN / "mavsdk_autopilot.py", f"udpout://127.0.0.1:{port}"

    summary, sent, received = autopilot_run(folder, "along", 15.0, autopilot)
    yield Row("MAVSDK's server takes setpoints", received["setpoints"], received["setpoints"] > 200)
    yield Row("and its telemetry is accepted", sent["reports"], sent["reports"] > 200)
    off, waiting = sent["largest_deviation"], sent["held_ticks"]
    value = f"at most {off:.3f} m off, waited for in {waiting} of {sent['ticks']} ticks"
    yield Row("it tracks its setpoints", value, off < 0.3 and waiting < sent["ticks"] / 10)
    yield Row("sight kept", f"at most {summary['max_distance']:.2f} m", _kept(summary))


def _kept(summary: dict[str, Any]) -> bool:
    """Return whether sight was kept, and no counter shows an error in the certificate."""
    names = ("visibility_violations", "certified_while_lost", "certificate_broken")
    return not any(summary[name] for name in names)


def modelled(folder: Path) -> Iterator[Row]:
    """Fly with a vehicle model in gusts and a mean wind of 2 m/s, whose state is the UAV's true state."""

    def autopilot(port: int) -> tuple[object, ...]:
        wind = ("--wind", 1.5, 1.3, "--gust", 0.5)
        return sys.executable, MODEL, f"127.0.0.1:{port}", *wind

    summary, sent, _ = autopilot_run(folder, "model", 60.0, autopilot)
    unreported = summary["faults"].get("uav_0", {}).get("no state of its robot", 0)
    off, exceeded = summary["largest_tracking_error"], summary["tracking_exceeded"]
    value = f"at most {off:.3f} m off, beyond 0.3 m in {exceeded} of {summary['ticks']} ticks"
    yield Row("vehicle model in wind, 60 s: the true UAV", value, off > 0.0)
    share = f"{100.0 * summary['certified_share']:.1f} %"
    value = f"{share} of the ticks; {unreported} without its state, {sent['held_ticks']} waiting"
    # the first ticks have no detection or no state; a busy machine may miss further ones
    yield Row("certified", value, summary["certified_share"] > 0.9)
    lost = summary["visibility_violations"]
    value = f"{lost} ticks out of sight, at most {summary['max_distance']:.2f} m"
    yield Row("sight kept", value, _kept(summary))


def watched_and_flown(folder: Path, python: Path) -> Iterator[Row]:
    """Watch both vehicles and fly the UAV with MAVSDK, while MAVProxy logs."""
    keys = folder / "credentials"
    output(*outrider("credentials", keys, "--scenario", "escort"))
    router = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    watched, logged, flown = (free_port(socket.SOCK_DGRAM) for _ in range(3))
    changes = ("--realtime", 2, "--duration", DURATION, "--json")

    def joined(name: str) -> tuple[object, ...]:
        return ("--connect", router, "--credentials", keys / f"{name}.json")

    with ExitStack() as stack:
        simulator = stack.enter_context(
            started(
                folder / "simulator.log",
                outrider(
                    "simulator", "escort", "--listen", router, "--credentials", keys / "router.json",
                    *changes, "--out", folder / "flight",
                ),
            )
        )  # fmt: skip
        await_text(folder / "simulator.log", "listening on")
        start = [
            ("ugv", outrider("ugv", *joined("ugv_0"))),
            (
                "uav",
                outrider(
                    "mavlink", "--vehicle", "uav_0", *joined("uav_0"), "--first-system", 11, "--json",
                    "--to", f"udpout:127.0.0.1:{flown}",
                ),
            ),
            (
                "gateway",
                outrider(
                    "mavlink", *joined("operator"), "--json",
                    "--to", f"udpout:127.0.0.1:{watched}", "--to", f"udpout:127.0.0.1:{logged}",
                ),
            ),
        ]  # fmt: skip
        ours = {
            name: stack.enter_context(started(folder / f"{name}.log", words))
            for name, words in start
        }
        await_text(folder / "gateway.log", "system 1 is uav_0")
        proxy = (
            *(python, python.with_name("mavproxy.py"), f"--master=udpin:127.0.0.1:{logged}"),
            *("--non-interactive", "--daemon", "--default-modules=", f"--state-basedir={folder}"),
            f"--logfile={folder / 'flight.tlog'}",
        )
        mavproxy = stack.enter_context(
            started(folder / "mavproxy.log", proxy, stdin=subprocess.DEVNULL, cwd=folder)
        )
        addresses = [f"udpin://127.0.0.1:{port}" for port in (watched, flown)]
        station = output(python, FOREIGN / "mavsdk_station.py", *addresses, patience=120.0)
        yield from (Row(**one) for one in json.loads(station.splitlines()[-1]))
        mavproxy.terminate()
        mavproxy.wait(10.0)
        yield from log_of_mavproxy(python, folder)
        simulator.wait(DURATION)
        ended = {name: process.wait(20.0) for name, process in ours.items()}
    summary = json.loads((folder / "simulator.out").read_text())
    kept = summary["visibility_violations"] == 0 and summary["certified_while_lost"] == 0
    yield Row("the simulator: sight kept", f"at most {summary['max_distance']:.2f} m", kept)
    share, broken = summary["certified_share"], summary["certificate_broken"]
    # a tick that a busy machine misses is reported as not certified
    yield Row("no certificate broken", f"certified {100.0 * share:.1f} % of the ticks", broken == 0)
    for name in ("uav", "gateway"):
        refused = json.loads((folder / f"{name}.out").read_text())["refused"]
        yield Row(f"{name} ends in order", f"refused: {refused}", ended[name] == 0)


def findings(folder: Path) -> Iterator[Row]:
    """Run all checks, with real processes."""
    python = environment("mavlink", NEEDED) / "python"
    yield from unanswered(folder)
    yield from modelled(folder)
    yield from along(folder, python)
    yield from watched_and_flown(folder, python)


if __name__ == "__main__":
    sys.exit(report(findings, __doc__))
