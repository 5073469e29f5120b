"""Certificate counters under kills, stops and restarts of vehicles, router and simulator in random order.

Flies `minefield` in four processes around a router of its own. Each sequence disturbs some of them, alone or together,
and ends when all are back: the simulator must then count no violation. At the end of each run, the UAV and the UGV lie
once about their certificates, and the UAV flies out of sight while it claims to be certified: the summary must count
all of it. Exit code 0 if there was no false alarm and no lie was missed.

Example: python tests/acceptance/counters.py --sequences 300 --seed 1
"""

import argparse
import contextlib
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from agents.process import fly, uav_maker, ugv_maker
from bus.errors import BusError
from bus.joining import open_session
from bus.keys import OBSERVER_NAME, STATUS, Party, Role
from bus.messages.decision import NotCertified
from bus.messages.telemetry import Status
from bus.messages.vehicle import UgvReport
from sim.models.ground import UNCERTIFIED

RUN = "run"
TICKS, LAST = 5000, 1000
"""Ticks of a run, and of its end, in which the vehicles lie."""
_ROOM = 1300
"""Ticks that a sequence may last."""
_PAUSE = 0.005
"""Wait of the UAV after each command, so that a run holds several sequences [s]."""
SCENARIO = ("minefield", f"--duration={TICKS * 0.05:g}", "--set", "area.cell=0.5")
PATIENCE = 120.0
"""Longest wait for a recovery [s]."""
KILLS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM)
PARTS = ("uav_0", "ugv_0", "router", "simulator")
WEIGHTS = (3, 3, 3, 1)
"""Relative frequency of faults of each part; without its simulator, a run starts again."""
_FALSE = UgvReport(certified=False, uncertified=next(iter(UNCERTIFIED.values())))


class Liar:
    """Pilot that lies once about the end of its certificate, and then, in a UAV, about its distance.

    Args:
        pilot: Pilot that flies honestly.
        on_lie: Called at the first lie.
    """

    def __init__(self, pilot: Any, on_lie: Callable[[], None]) -> None:
        self._pilot, self._on_lie = pilot, on_lie
        self._before: Any = None
        self._lied, self._tick = False, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._pilot, name)

    def act(self, observation: Any) -> Any:
        command = self._pilot.act(observation)
        report, before = command.report, self._before
        self._tick = tick = observation.tick
        honest = report if isinstance(report, UgvReport | None) else report.decision
        self._before = honest if tick < TICKS - LAST or not self._lied else None
        if tick < TICKS - LAST or honest is None:
            return command
        if not self._lied and before is not None and before.certified and honest.certified:
            self._lied = True
            self._on_lie()
            return self._with(command, certified=False)
        if self._lied and not isinstance(report, UgvReport) and tick > TICKS - LAST // 2:
            return self._with(msgspec.structs.replace(command, **_AWAY), certified=True)
        return command

    def prepare(self) -> None:
        """Slow the run down, except when the vehicles lie."""
        if hasattr(self._pilot, "prepare"):
            self._pilot.prepare()
        if self._tick < TICKS - LAST:
            time.sleep(_PAUSE)

    @staticmethod
    def _with(command: Any, *, certified: bool) -> Any:
        if isinstance(command.report, UgvReport):
            return msgspec.structs.replace(command, report=_FALSE)
        reason = None if certified else NotCertified.NO_PLAN
        decision = msgspec.structs.replace(command.report.decision, reason=reason)
        report = msgspec.structs.replace(command.report, decision=decision)
        return msgspec.structs.replace(command, report=report)


_AWAY: dict[str, Any] = {"acceleration": (-0.2, -0.2), "backup_trajectories": ()}


def vehicle(name: str, endpoint: str) -> None:
    """Fly a vehicle that lies at the end of the run; print a line at its lie."""
    role = Role(name[:3])
    make = uav_maker() if role is Role.UAV else ugv_maker()

    def liar(briefing: Any) -> Liar:
        return Liar(make(briefing), lambda: print("lied", flush=True))

    fly(Party(role=role, name=name), liar, connect=endpoint, run=RUN, join_timeout=PATIENCE)


class Fault(NamedTuple):
    """Fault of one part during a sequence."""

    part: str
    begins: float
    """Start after the start of the sequence [s]."""
    lasts: float
    """Time until the part is started again, or continues [s]."""
    kind: signal.Signals


_FIRST = [Fault("ugv_0", 0.0, 9.0, signal.SIGKILL), Fault("router", 3.0, 2.0, signal.SIGTERM)]
"""The UAV rejoins after its answer to a tick in which the UGV is absent, and reports next at the tick after."""


def drawn(rng: random.Random) -> list[Fault]:
    """Draw the faults of a sequence, in which each part has at most one."""
    parts = {*rng.choices(PARTS, WEIGHTS, k=rng.randint(1, 4))}
    return [
        Fault(
            part,
            rng.uniform(0.0, 3.0),
            rng.uniform(0.1, 3.0),
            rng.choice((*KILLS, signal.SIGSTOP, signal.SIGSTOP)),
        )
        for part in sorted(parts)
    ]


class Parts:
    """Processes around the router.

    Args:
        folder: Folder of the endpoint and of the processes' output.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self.endpoint = folder, f"unixsock-stream/{folder / 'bus.sock'}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.runs = 0
        """Number of simulators started."""

    def out(self, part: str) -> Path:
        """Return the file with a part's standard output; a simulator has one for each start."""
        number = self.runs if part == "simulator" else 0
        return self._folder / f"{part}-{number}.out"

    def start(self, part: str) -> None:
        """Start a process in place of the former one."""
        joining = ["--run", RUN, "--connect", self.endpoint]
        if part == "router":
            Path(self.endpoint.partition("/")[2]).unlink(missing_ok=True)
            words = ["-m", "outrider", "router", "--run", RUN, "--listen", self.endpoint]
        elif part == "simulator":
            self.runs += 1
            options = ["--respawn", f"--join-timeout={PATIENCE:g}", "--json"]
            words = ["-m", "outrider", "simulator", *SCENARIO, *options, *joining]
        else:
            words = [__file__, "--vehicle", part, "--endpoint", self.endpoint]
        with self.out(part).open("ab") as out, (self._folder / f"{part}.err").open("ab") as err:
            self.processes[part] = subprocess.Popen(
                [sys.executable, *words], stdout=out, stderr=err
            )

    def finish(self, part: str) -> None:
        """Wait for the end of a process; kill a vehicle that has missed the end of the run."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.processes[part].wait(3.0)
        self.send(part, signal.SIGKILL)

    def revive(self) -> None:
        """Start the parts that have ended by themselves, except a simulator at the end of its run."""
        for part, process in self.processes.items():
            if process.poll() is not None and (part != "simulator" or not self.ended):
                self.start(part)

    @property
    def ended(self) -> bool:
        """True if the simulator has printed its summary."""
        simulator = self.processes["simulator"]
        return simulator.poll() is not None and self.out("simulator").stat().st_size > 0

    def send(self, part: str, kind: signal.Signals) -> None:
        """Send a signal to a process, and wait until a kill has ended it."""
        self.processes[part].send_signal(kind)
        if kind in KILLS:
            self.processes[part].wait()

    def close(self) -> None:
        """Kill all processes."""
        for process in self.processes.values():
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            process.wait()

    def disturb(self, faults: list[Fault]) -> None:
        """Cause these faults at their times, and end them."""
        events = [(one.begins, False, one) for one in faults]
        events += [(one.begins + one.lasts, True, one) for one in faults]
        started = time.monotonic()
        for at, ends, fault in sorted(events):
            time.sleep(max(0.0, started + at - time.monotonic()))
            if self.processes[fault.part].poll() is not None and not (ends and fault.kind in KILLS):
                continue  # ended by itself, or with its run
            if not ends:
                self.send(fault.part, fault.kind)
            elif fault.kind is signal.SIGSTOP:
                self.send(fault.part, signal.SIGCONT)
            elif not (fault.part == "simulator" and self.ended):
                self.start(fault.part)


class Watch:
    """Status of the run, as an observer sees it. The observer joins again whenever its router was replaced."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def after(self, tick: int) -> Status | None:
        """Wait for a status with all vehicles present, `tick` ticks later than the first one; None: the run is over."""
        limit, first = time.monotonic() + PATIENCE, None
        party = Party(role=Role.OBSERVER, name=OBSERVER_NAME)
        with open_session(party, RUN, connect=self._parts.endpoint, join_timeout=PATIENCE) as one:
            inbox = one.inbox(STATUS)
            while time.monotonic() < limit:
                envelope = inbox.receive(0.5)
                self._parts.revive()
                if self._parts.ended:
                    return None
                if envelope is None or not isinstance(status := envelope.message, Status):
                    continue
                whole = all(vehicle.present for vehicle in status.vehicles.values())
                first = status.tick if first is None or status.tick < first else first
                if whole and status.tick >= first + tick:
                    return status
        raise BusError(f"the run did not recover within {PATIENCE:g} s")


def alarms(status: Status) -> tuple[int, int, int]:
    """Return the violations counted: UAV out of sight, certificate of the UAV broken, certificate of the UGV broken."""
    uav, ground = status.certificates, status.mission
    return (
        0 if uav is None else uav.certified_while_lost,
        0 if uav is None else uav.certificate_broken,
        0 if ground is None else ground.ground_certificate_broken,
    )


class Tally(NamedTuple):
    """Results, all to be compared with 0 but the sequences and the lies."""

    sequences: int = 0
    false_alarms: int = 0
    lies: int = 0
    missed: int = 0


def judged(parts: Parts, tally: Tally) -> Tally:
    """Compare the summary of a run that has ended with the lies of its vehicles."""
    summary = json.loads(parts.out("simulator").read_text(encoding="utf-8"))
    lied = {part: parts.out(part).read_text(encoding="utf-8").count("lied") for part in PARTS[:2]}
    found = Counter(
        uav_0=summary["certificate_broken"], ugv_0=summary["mission"]["ground_certificate_broken"]
    )
    missed = sum(max(0, lied[part] - found[part]) for part in lied)
    missed += bool(lied["uav_0"]) and not summary["certified_while_lost"]
    false = sum(max(0, found[part] - lied[part]) for part in lied)
    print(
        f"  run {parts.runs}: lies {lied}, found {dict(found)}, certified while lost "
        f"{summary['certified_while_lost']}, hash {summary['trajectory_sha256'][:8]}"
    )
    for part in lied:
        parts.out(part).write_text("", encoding="utf-8")
    return tally._replace(
        false_alarms=tally.false_alarms + false,
        lies=tally.lies + sum(lied.values()) + bool(lied["uav_0"]),
        missed=tally.missed + missed,
    )


def attack(parts: Parts, rng: random.Random, wanted: int, limit: float) -> Tally:
    """Disturb the parts until there were enough sequences, or the time is over [s]."""
    for part in ("router", "simulator", "uav_0", "ugv_0"):
        parts.start(part)
    watch, tally, started = Watch(parts), Tally(), time.monotonic()
    status = watch.after(20)
    while tally.sequences < wanted and time.monotonic() - started < limit:
        if status is None or status.tick > TICKS - LAST - _ROOM:
            while not parts.ended:
                parts.revive()
                time.sleep(0.1)
            tally = judged(parts, tally)
            for part in ("simulator", "uav_0", "ugv_0"):
                parts.finish(part)
                parts.start(part)
            status = watch.after(20)
            continue
        faults = drawn(rng) if tally.sequences else _FIRST
        parts.disturb(faults)
        status = watch.after(20)
        tally = tally._replace(sequences=tally.sequences + 1)
        found = (0, 0, 0) if status is None or status.tick > TICKS - LAST else alarms(status)
        tally = tally._replace(false_alarms=tally.false_alarms + sum(found))
        what = ", ".join(
            f"{one.kind.name} {one.part} {one.begins:.1f}+{one.lasts:.1f} s"
            for one in sorted(faults, key=lambda one: one.begins)
        )
        print(
            f"{tally.sequences:4d}  tick {status.tick if status else TICKS:5d}  {found}  {what}",
            flush=True,
        )
    return tally


def main() -> int:
    """Disturb, lie, and count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sequences", type=int, default=300, help="number of sequences")
    parser.add_argument("--minutes", type=float, default=600.0, help="end after this wall time")
    parser.add_argument("--seed", type=int, default=1, help="of the disturbances")
    parser.add_argument("--vehicle", default="", help=argparse.SUPPRESS)
    parser.add_argument("--endpoint", default="", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.vehicle:
        vehicle(options.vehicle, options.endpoint)
        return 0
    with (
        tempfile.TemporaryDirectory(prefix="o-") as folder,
        contextlib.closing(Parts(Path(folder))) as parts,
    ):
        try:
            tally = attack(
                parts, random.Random(options.seed), options.sequences, 60.0 * options.minutes
            )
        except Exception:
            for log in sorted(Path(folder).glob("*.err")):
                sys.stderr.write(f"{log.name}: {log.read_text(errors='replace')[-2000:]}\n")
            raise
    print(
        f"{tally.sequences} sequences: {tally.false_alarms} false alarms; {tally.lies} lies, {tally.missed} missed"
    )
    return 1 if tally.false_alarms or tally.missed else 0


if __name__ == "__main__":
    sys.exit(main())
