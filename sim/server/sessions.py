"""Sessions of the vehicles in a run: the active one, the data still to be sent to it, and its faults."""

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import msgspec

from bus.keys import BRIEFING, COMMAND, OBSERVATION, Key, Role
from bus.messages.base import fitted
from bus.messages.telemetry import VehicleStatus
from bus.messages.vehicle import Command, Observation, UavCommand, UgvCommand
from bus.session import Envelope, Outbox, Session
from sim.engine.briefing import briefing
from sim.scenario.vehicle_types import Uav
from sim.server.flight import Flight

PART = 1000
"""Ticks of a vehicle's past in one briefing: below 300 kB, a few milliseconds of work."""

UNREADABLE = "does not decode"
ANOTHER_TICK = "answers another tick"
TWICE = "answers a tick twice"
SECOND_SESSION = "comes from a second session"


_QUIET = 10.0
"""Time between two log lines about one late vehicle [s]."""


@dataclass(slots=True, kw_only=True)
class VehicleSessions:
    """Sessions of one vehicle. The first to join is active until it leaves; then the next one becomes active."""

    name: str
    role: Role
    briefings: Outbox
    observations: Outbox
    sessions: dict[int, int] = field(default_factory=dict)
    """Numbers of the present sessions in order of arrival, each with the count of arrivals under this number."""
    owed: int | None = None
    """First tick of the past still to be sent to the active session; None: fully briefed."""
    newest: int = -1
    """Tick that its newest command answers."""
    missed: set[int] = field(default_factory=set)
    """Ticks whose observation could not be sent."""
    lost: int = 0
    rejoined: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    fault: str = ""
    late: int = 0
    """Deadlines missed."""
    late_reported: float = -math.inf
    """Time of the latest log line about it [s]."""

    @property
    def present(self) -> bool:
        """True if a session is present."""
        return bool(self.sessions)

    @property
    def holder(self) -> int | None:
        """Return the number of the active session, the earliest present; None: no session."""
        return next(iter(self.sessions), None)


class Sessions:
    """Sessions of all vehicles, and the inbox of their commands.

    Args:
        session: The simulator's session.
        flight: The run.
        on_event: Called with one line for the user.
    """

    def __init__(self, session: Session, flight: Flight, on_event: Callable[[str], None]) -> None:
        self._flight = flight
        self._on_event = on_event
        self._gate = threading.Lock()
        self._arrivals: Counter[tuple[str, int]] = Counter()
        """Number of arrivals of each session number, by vehicle."""
        self._changes: dict[tuple[str, int], bool] = {}
        """Arrivals (True) and departures (False) since the last `follow`, by vehicle and session number."""
        self._sessions: dict[str, VehicleSessions] = {}
        for vehicle in flight.scenario.vehicles:
            role = Role.UAV if isinstance(vehicle, Uav) else Role.UGV
            session.offer(vehicle.name, role)
            self._sessions[vehicle.name] = VehicleSessions(
                name=vehicle.name,
                role=role,
                briefings=session.outbox(BRIEFING[role], vehicle.name),
                observations=session.outbox(OBSERVATION[role], vehicle.name),
            )
        keys: dict[str, Key] = {name: COMMAND[entry.role] for name, entry in self._sessions.items()}
        self.commands = session.inbox_of_all(keys)
        session.watch("*", self._record)

    def fly(self, flight: Flight) -> None:
        """Start another run: every vehicle receives a new briefing."""
        self._flight = flight
        for entry in self._sessions.values():
            entry.newest = -1
            entry.missed.clear()
            entry.owed = 0 if entry.sessions else None

    def _record(self, name: str, number: int, present: bool) -> None:
        """Record that a session joined or left; called from a thread of Zenoh.

        Only the latest event of each session number is kept: a flood must neither fill the memory nor stop the clock.
        """
        if name not in self._sessions:
            return
        with self._gate:
            self._arrivals[name, number] += present
            known = (name, number) in self._changes
            self._changes[name, number] = present
        if not known:
            self.commands.poke()

    def follow(self) -> None:
        """Process sessions that joined or left since the last call, and count messages that did not decode."""
        with self._gate:
            changes = [
                (name, number, self._arrivals[name, number], there)
                for (name, number), there in self._changes.items()
            ]
            self._changes.clear()
        for name, number, arrivals, present in changes:
            entry = self._sessions[name]
            if number in entry.sessions and not (present and entry.sessions[number] == arrivals):
                self._leave(entry, number)
            if present and number not in entry.sessions:
                self._arrive(entry, number, arrivals)
        for name, entry in self._sessions.items():
            unreadable = self.commands.refused[name] - entry.refused[UNREADABLE]
            if unreadable > 0:
                self._refuse(entry, UNREADABLE, self.commands.fault[name], unreadable)

    def _arrive(self, entry: VehicleSessions, number: int, arrivals: int) -> None:
        entry.sessions[number] = arrivals
        if len(entry.sessions) > 1:
            self._refuse(
                entry,
                SECOND_SESSION,
                f"a second session (number {number}) joined; "
                f"the first (number {entry.holder}) stays active",
            )
            return
        self._begin(entry)

    def _begin(self, entry: VehicleSessions) -> None:
        """Make a session active."""
        entry.owed = 0
        if entry.lost:
            entry.rejoined += 1
            self._flight.rejoin(entry.name)
            self._on_event(f"{entry.name} rejoined at tick {self._flight.world.tick}")

    def _leave(self, entry: VehicleSessions, number: int) -> None:
        is_holder = entry.holder == number
        del entry.sessions[number]
        if not is_holder:
            return
        if not self._flight.over:
            entry.lost += 1
            self._on_event(f"{entry.name} disconnected at tick {self._flight.world.tick}")
        if entry.sessions:
            self._begin(entry)

    def _refuse(self, entry: VehicleSessions, cause: str, fault: str, count: int = 1) -> None:
        if not entry.refused[cause]:
            self._on_event(
                f"{entry.name}: {cause}: {fault}; rejected, further ones are only counted"
            )
        entry.refused[cause] += count
        entry.fault = fitted(fault)

    @property
    def absent(self) -> list[str]:
        """Return the vehicles without a session, in name order."""
        return [name for name, entry in self._sessions.items() if not entry.present]

    @property
    def unbriefed(self) -> list[str]:
        """Return the vehicles whose active session is not fully briefed."""
        return [
            name
            for name, entry in self._sessions.items()
            if entry.present and entry.owed is not None
        ]

    def brief(self, name: str, *, parts: int | None = None) -> bool:
        """Send a vehicle the remaining parts of its briefing.

        Args:
            name: Name of the vehicle.
            parts: Maximum number of messages; None: all.

        Returns:
            True if the vehicle is fully briefed now.
        """
        entry, now = self._sessions[name], self._flight.world.tick
        sent = 0
        while entry.owed is not None and (parts is None or sent < parts):
            end = min(entry.owed + PART, now)
            first = briefing(self._flight.scenario, name, self._flight.seed, self._flight.secret)
            past = self._flight.past(name, entry.owed, end, entry.missed)
            entry.briefings.send(
                msgspec.structs.replace(
                    first, past=past, more=end < now, episode=self._flight.episode
                )
            )
            sent += 1
            entry.owed = end if end < now else None
        return entry.owed is None

    def send(
        self, observations: Mapping[str, Observation], *, parts: int | None = None
    ) -> set[str]:
        """Send each connected and briefed vehicle its observation of this tick.

        Args:
            observations: Observation of every vehicle.
            parts: Maximum number of briefing messages sent first; None: all.

        Returns:
            Names of the vehicles that received their observation.
        """
        given = set()
        for name, observation in observations.items():
            entry = self._sessions[name]
            if entry.sessions and (entry.owed is None or self.brief(name, parts=parts)):
                entry.observations.send(observation)
                entry.missed.discard(observation.tick)
                given.add(name)
            else:
                entry.missed.add(observation.tick)
        return given

    def accept(
        self,
        envelope: Envelope,
        tick: int,
        commands: dict[str, Command],
        *,
        oldest: int | None = None,
    ) -> bool:
        """Add a command to the commands of this tick, or reject it.

        Args:
            envelope: Received message.
            tick: Current tick.
            commands: Commands of this tick; changed.
            oldest: Earliest tick that may be answered; None: any later than the last answered one.

        Returns:
            True if the command was accepted.
        """
        entry, command = self._sessions[envelope.sender], envelope.message
        if not isinstance(command, UavCommand | UgvCommand):
            return False
        answered = command.tick
        if envelope.number is not None and entry.present and envelope.number != entry.holder:
            self._refuse(
                entry,
                SECOND_SESSION,
                f"a command for tick {answered} from a second session (number {envelope.number}); "
                f"the first (number {entry.holder}) stays active",
            )
        elif answered == entry.newest:
            self._refuse(entry, TWICE, f"tick {answered} again at tick {tick}")
        elif (
            answered > tick or answered < entry.newest or (oldest is not None and answered < oldest)
        ):
            self._refuse(entry, ANOTHER_TICK, f"tick {answered} at tick {tick}")
        else:
            entry.newest = answered
            commands[envelope.sender] = command
            return True
        return False

    def report_late(self, name: str, tick: int, late: float) -> None:
        """Report that a vehicle has missed its deadline."""
        entry, now = self._sessions[name], time.monotonic()
        entry.fault = f"no command for tick {tick} after {late:.1f} s"
        entry.late += 1
        if now - entry.late_reported >= _QUIET:
            entry.late_reported = now
            often = f", for the {entry.late}th time" if entry.late > 1 else ""
            self._on_event(f"{name} is late{often}: {entry.fault}")

    def statuses(self) -> dict[str, VehicleStatus]:
        """Return the status of each vehicle."""
        found = {name: self._flight.answers.counted(name) for name in self._sessions}
        return {
            name: msgspec.structs.replace(
                found[name],
                present=entry.present,
                lost=entry.lost,
                rejoined=entry.rejoined,
                rejected=found[name].rejected | entry.refused,
                last_fault=entry.fault or found[name].last_fault,
            )
            for name, entry in self._sessions.items()
        }
