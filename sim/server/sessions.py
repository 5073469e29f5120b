"""The vehicles' places in a run: who holds each, what it was told, and what has gone wrong with it."""

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import msgspec

from bus.keys import BRIEFING, COMMAND, OBSERVATION, Key, Role
from bus.messages.base import LONGEST_TEXT
from bus.messages.telemetry import VehicleStatus
from bus.messages.vehicle import Command, Observation, UavCommand, UgvCommand
from bus.session import Envelope, Outbox, Session
from sim.engine.briefing import briefing
from sim.scenario.types import Uav
from sim.server.flight import Flight

PART = 1000
"""Ticks of a vehicle's past in one briefing: below 300 kB, a few milliseconds of work."""

UNREADABLE = "does not decode"
ANOTHER_TICK = "answers another tick"
TWICE = "answers a tick twice"
SECOND_SESSION = "comes from a second session"


_QUIET = 10.0
"""Time between two lines about one vehicle that is late [s]."""


@dataclass(slots=True, kw_only=True)
class VehicleSlot:
    """One vehicle's place. The first session that comes holds it until it goes; then the next one does."""

    name: str
    role: Role
    briefings: Outbox
    observations: Outbox
    sessions: dict[int, int] = field(default_factory=dict)
    """Places of those that are there, in the order in which they came, and how often each place had been taken by then.
    """
    owed: int | None = None
    """First tick of the past that the holder has yet to be told; None once it is briefed."""
    newest: int = -1
    """The tick that its newest command answers."""
    missed: set[int] = field(default_factory=set)
    """Ticks whose observation nobody was there to receive."""
    lost: int = 0
    rejoined: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    fault: str = ""
    late: int = 0
    """Deadlines that it has not kept."""
    late_told: float = -math.inf
    """Time at which that was told last [s]."""

    @property
    def present(self) -> bool:
        """True while a session is there."""
        return bool(self.sessions)

    @property
    def holder(self) -> int | None:
        """The session that came first of those that are there; None: nobody is there."""
        return next(iter(self.sessions), None)


class Slots:
    """All vehicles' places, and the inbox that their commands come to.

    Args:
        session: The simulator's session.
        flight: What is flown.
        on_event: Called with one line for a person.
    """

    def __init__(self, session: Session, flight: Flight, on_event: Callable[[str], None]) -> None:
        self._flight = flight
        self._on_event = on_event
        self._gate = threading.Lock()
        self._arrivals: Counter[tuple[str, int]] = Counter()
        """Number of arrivals at each place of each vehicle."""
        self._changes: dict[tuple[str, int], bool] = {}
        """Arrivals (True) and departures (False) by place, since they were last taken in."""
        self._slots: dict[str, VehicleSlot] = {}
        for vehicle in flight.scenario.vehicles:
            role = Role.UAV if isinstance(vehicle, Uav) else Role.UGV
            session.offer(vehicle.name, role)
            self._slots[vehicle.name] = VehicleSlot(
                name=vehicle.name,
                role=role,
                briefings=session.outbox(BRIEFING[role], vehicle.name),
                observations=session.outbox(OBSERVATION[role], vehicle.name),
            )
        keys: dict[str, Key] = {name: COMMAND[slot.role] for name, slot in self._slots.items()}
        self.commands = session.inbox_of_all(keys)
        session.watch("*", self._note)

    def fly(self, flight: Flight) -> None:
        """Another flight begins: everybody is briefed anew."""
        self._flight = flight
        for slot in self._slots.values():
            slot.newest = -1
            slot.missed.clear()
            slot.owed = 0 if slot.sessions else None

    def _note(self, name: str, place: int, present: bool) -> None:
        """A session comes or goes; called from a thread of Zenoh's.

        However often that happens, it is kept once for each place: a flood of it must neither fill the memory nor
        stop the clock.
        """
        if name not in self._slots:
            return
        with self._gate:
            self._arrivals[name, place] += present
            known = (name, place) in self._changes
            self._changes[name, place] = present
        if not known:
            self.commands.poke()

    def follow(self) -> None:
        """Take in who has come and gone since the last call, and name what did not decode."""
        with self._gate:
            changes = [
                (name, place, self._arrivals[name, place], there)
                for (name, place), there in self._changes.items()
            ]
            self._changes.clear()
        for name, place, arrivals, present in changes:
            slot = self._slots[name]
            if place in slot.sessions and not (present and slot.sessions[place] == arrivals):
                self._leave(slot, place)
            if present and place not in slot.sessions:
                self._arrive(slot, place, arrivals)
        for name, slot in self._slots.items():
            unreadable = self.commands.refused[name] - slot.refused[UNREADABLE]
            if unreadable > 0:
                self._refuse(slot, UNREADABLE, self.commands.fault[name], unreadable)

    def _arrive(self, slot: VehicleSlot, place: int, arrivals: int) -> None:
        slot.sessions[place] = arrivals
        if len(slot.sessions) > 1:
            self._refuse(
                slot,
                SECOND_SESSION,
                f"a second session (number {place}) has come; "
                f"the first (number {slot.holder}) keeps the slot",
            )
            return
        self._begin(slot)

    def _begin(self, slot: VehicleSlot) -> None:
        """A session takes the slot."""
        slot.owed = 0
        if slot.lost:
            slot.rejoined += 1
            self._flight.rejoin(slot.name)
            self._on_event(f"{slot.name} has joined again at tick {self._flight.world.tick}")

    def _leave(self, slot: VehicleSlot, place: int) -> None:
        held = slot.holder == place
        del slot.sessions[place]
        if not held:
            return
        if not self._flight.over:
            slot.lost += 1
            self._on_event(f"{slot.name} is lost at tick {self._flight.world.tick}")
        if slot.sessions:
            self._begin(slot)

    def _refuse(self, slot: VehicleSlot, cause: str, fault: str, count: int = 1) -> None:
        if not slot.refused[cause]:
            self._on_event(f"{slot.name}: {cause}: {fault}; refused, and from now on only counted")
        slot.refused[cause] += count
        slot.fault = fault[:LONGEST_TEXT]

    @property
    def absent(self) -> list[str]:
        """Vehicles that nobody sits in, in name order."""
        return [name for name, slot in self._slots.items() if not slot.present]

    @property
    def unbriefed(self) -> list[str]:
        """Vehicles that somebody sits in who does not know all yet."""
        return [
            name for name, slot in self._slots.items() if slot.present and slot.owed is not None
        ]

    def brief(self, name: str, *, parts: int | None = None) -> bool:
        """Send a vehicle what it is owed.

        Args:
            name: The vehicle.
            parts: At most so many messages; None: all.

        Returns:
            Whether it knows all now.
        """
        slot, now = self._slots[name], self._flight.world.tick
        sent = 0
        while slot.owed is not None and (parts is None or sent < parts):
            end = min(slot.owed + PART, now)
            told = briefing(self._flight.scenario, name, self._flight.seed, self._flight.secret)
            past = self._flight.past(name, slot.owed, end, slot.missed)
            slot.briefings.send(
                msgspec.structs.replace(
                    told, past=past, more=end < now, episode=self._flight.episode
                )
            )
            sent += 1
            slot.owed = end if end < now else None
        return slot.owed is None

    def send(
        self, observations: Mapping[str, Observation], *, parts: int | None = None
    ) -> set[str]:
        """Give each vehicle that is there and briefed its observation of this tick.

        Args:
            observations: Of every vehicle.
            parts: How many messages of a briefing may go out before it; None: all.

        Returns:
            Who was given one.
        """
        given = set()
        for name, observation in observations.items():
            slot = self._slots[name]
            if slot.sessions and (slot.owed is None or self.brief(name, parts=parts)):
                slot.observations.send(observation)
                slot.missed.discard(observation.tick)
                given.add(name)
            else:
                slot.missed.add(observation.tick)
        return given

    def take(
        self,
        envelope: Envelope,
        tick: int,
        commands: dict[str, Command],
        *,
        oldest: int | None = None,
    ) -> bool:
        """Put a command among those of this tick, or refuse it.

        Args:
            envelope: What has come.
            tick: Now.
            commands: Those of this tick.
            oldest: The earliest tick that may be answered; None: any that the vehicle has not answered yet.

        Returns:
            Whether it was taken.
        """
        slot, command = self._slots[envelope.sender], envelope.message
        if not isinstance(command, UavCommand | UgvCommand):
            return False
        answered = command.tick
        if envelope.place is not None and slot.present and envelope.place != slot.holder:
            self._refuse(
                slot,
                SECOND_SESSION,
                f"a command for tick {answered} from a second session (number {envelope.place}); "
                f"the first (number {slot.holder}) keeps the slot",
            )
        elif answered == slot.newest:
            self._refuse(slot, TWICE, f"tick {answered} once more at tick {tick}")
        elif (
            answered > tick or answered < slot.newest or (oldest is not None and answered < oldest)
        ):
            self._refuse(slot, ANOTHER_TICK, f"tick {answered} at tick {tick}")
        else:
            slot.newest = answered
            commands[envelope.sender] = command
            return True
        return False

    def name_late(self, name: str, tick: int, late: float) -> None:
        """Say that a vehicle has not answered by the deadline."""
        slot, now = self._slots[name], time.monotonic()
        slot.fault = f"no command for tick {tick} after {late:.1f} s"
        slot.late += 1
        if now - slot.late_told >= _QUIET:
            slot.late_told = now
            often = f", for the {slot.late}th time" if slot.late > 1 else ""
            self._on_event(f"{name} is late{often}: {slot.fault}")

    def statuses(self) -> dict[str, VehicleStatus]:
        """The status of each vehicle."""
        answers = self._flight.answers
        return {
            name: msgspec.structs.replace(
                answers.counted(name),
                present=slot.present,
                lost=slot.lost,
                rejoined=slot.rejoined,
                rejected=dict(slot.refused),
                last_fault=slot.fault,
            )
            for name, slot in self._slots.items()
        }
