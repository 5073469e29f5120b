"""The simulator process: the world behind the bus, in lockstep."""

import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bus.errors import PeerLost
from bus.keys import BRIEFING, COMMAND, COVERAGE, OBSERVATION, STATUS, TRUTH, Key, Role
from bus.messages import Command, CoverageMap, Observation, Status, UavCommand, UgvCommand, VehicleStatus
from bus.session import Letter, Outbox, Session
from sim.briefing import briefing
from sim.flight import Flight
from sim.scenario import Scenario, Uav

_TELEMETRY_PERIOD = 0.2
"""Wall time between two status messages, and between two maps [s]."""


@dataclass(slots=True, kw_only=True)
class _Seat:
    """One vehicle's place in the run."""

    role: Role
    briefings: Outbox
    observations: Outbox
    present: bool = False
    refused: int = 0
    fault: str = ""


class Server:
    """Flies one scenario with vehicles that are other processes.

    Args:
        session: The simulator's session.
        scenario: What is flown.
        seed: Of all random numbers.
        deadline: How long to wait for the commands of one tick [s].
        join_timeout: How long to wait for all vehicles at the start [s].
        on_event: Called with one line for a person: who joined, who was lost, who is late.
        stop: Asked now and then whether somebody wants the run to end.
    """

    def __init__(
        self,
        session: Session,
        scenario: Scenario,
        seed: int,
        *,
        deadline: float = 10.0,
        join_timeout: float = 30.0,
        on_event: Callable[[str], None] = lambda _line: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.flight = Flight(scenario, seed)
        self.started = 0.0
        """Wall clock at the first tick [s]."""
        self._deadline = deadline
        self._patience = min(deadline, 0.2)  # between two looks at who is still there
        self._awaited: set[str] = set()
        self._join_timeout = join_timeout
        self._on_event = on_event
        self._stop = stop
        self._changes: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._seats = {
            vehicle.name: self._seat(session, vehicle.name, Role.UAV if isinstance(vehicle, Uav) else Role.UGV)
            for vehicle in scenario.vehicles
        }
        keys: dict[str, Key] = {name: COMMAND[seat.role] for name, seat in self._seats.items()}
        self._commands = session.inbox_of_all(keys)
        self._truth, self._map, self._status = (session.outbox(key) for key in (TRUTH, COVERAGE, STATUS))
        self._telemetry_due = 0.0
        self._last_status = (0.0, 0)
        session.watch("*", self._note)
        session.announce()

    @staticmethod
    def _seat(session: Session, name: str, role: Role) -> _Seat:
        return _Seat(
            role=role,
            briefings=session.outbox(BRIEFING[role], name),
            observations=session.outbox(OBSERVATION[role], name),
        )

    def _note(self, name: str, present: bool) -> None:
        """A vehicle comes or goes; called from a thread of Zenoh's."""
        self._changes.put((name, present))
        self._commands.poke()

    def _follow_changes(self) -> None:
        while not self._changes.empty():
            name, present = self._changes.get()
            seat = self._seats.get(name)
            if seat is None or seat.present == present:
                continue
            seat.present = present
            if present:
                seat.briefings.send(briefing(self.flight.scenario, name, self.flight.seed))
            elif not self.flight.over:
                self._on_event(f"{name} is lost at tick {self.flight.world.tick}; it brakes and the run goes on")

    def join(self) -> None:
        """Wait until every vehicle has joined, and brief each.

        Raises:
            PeerLost: If one does not come in time; it is named.
        """
        limit = time.monotonic() + self._join_timeout
        while not self.flight.over:
            self._follow_changes()
            missing = [name for name, seat in self._seats.items() if not seat.present]
            if not missing:
                return
            if time.monotonic() > limit:
                raise PeerLost(f"{' and '.join(missing)} did not join within {self._join_timeout:g} s")
            self._commands.receive(0.2)
            self._heed_stop()

    def _heed_stop(self) -> None:
        if self._stop():
            self.flight.stop()

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle that is there its observation of this tick."""
        self._awaited = set()
        for name, observation in observations.items():
            seat = self._seats[name]
            if seat.present:
                seat.observations.send(observation)
                self._awaited.add(name)
        self._inform()

    def collect(self, tick: int) -> dict[str, Command]:
        """Wait for the command of every vehicle that was given this tick's observation, or for the deadline."""
        commands: dict[str, Command] = {}
        awaited = self._awaited
        started = time.monotonic()
        patience = self._patience
        self._heed_stop()
        while awaited:
            letter = self._commands.receive(patience)
            if letter is not None:
                self._take(letter, tick, commands)
                continue
            self._follow_changes()
            self._heed_stop()
            awaited.intersection_update(name for name, seat in self._seats.items() if seat.present)
            late = time.monotonic() - started
            patience = min(self._patience, max(0.0, self._deadline - late))
            if self.flight.over:
                break
            if awaited and late >= self._deadline:
                self._name_late(sorted(awaited), tick, late)
                break
        return commands

    def _take(self, letter: Letter, tick: int, commands: dict[str, Command]) -> None:
        name, command = letter.sender, letter.message
        if not isinstance(command, UavCommand | UgvCommand) or command.tick != tick:
            self._refuse(name, f"answered tick {getattr(command, 'tick', None)} at tick {tick}")
        elif name in commands:
            self._refuse(name, f"answered tick {tick} twice")
        else:
            commands[name] = command
            self._awaited.discard(name)

    def _refuse(self, name: str, fault: str) -> None:
        self._seats[name].refused += 1
        self._seats[name].fault = fault

    def _name_late(self, names: list[str], tick: int, late: float) -> None:
        for name in names:
            self._seats[name].fault = f"no command for tick {tick} after {late:.1f} s"
            self._on_event(f"{name} is late: {self._seats[name].fault}")

    def _inform(self) -> None:
        """Telemetry for whoever listens, while the vehicles think."""
        if self._truth.wanted:
            self._truth.send(self.flight.truth())
        now = time.monotonic()
        if now < self._telemetry_due:
            return
        self._telemetry_due = now + _TELEMETRY_PERIOD
        if self._status.wanted:
            self._status.send(self.status(now))
        if self._map.wanted:
            self._map.send(self._coverage_map())

    def status(self, now: float) -> Status:
        """How the run stands, `now` on the monotonic clock [s]."""
        flight, world = self.flight, self.flight.world
        before, tick = self._last_status
        self._last_status = (now, world.tick)
        factor = (world.tick - tick) * flight.scenario.dt / (now - before) if before else 0.0
        return Status(
            scenario=flight.scenario.name,
            seed=flight.seed,
            tick=world.tick,
            ticks=flight.scenario.ticks,
            time=world.time,
            realtime_factor=factor,
            vehicles={name: self._vehicle_status(name) for name in self._seats},
            over=flight.over,
        )

    def _vehicle_status(self, name: str) -> VehicleStatus:
        seat = self._seats[name]
        return VehicleStatus(
            present=seat.present,
            missing_commands=self.flight.missing[name],
            refused_messages=seat.refused + self._commands.refused[name],
            last_fault=seat.fault or self._commands.fault[name],
        )

    def _coverage_map(self) -> CoverageMap:
        world = self.flight.world
        rows, columns = world.coverage.shape
        share = (world.coverage * (255.0 / world.parameters.desired)).clip(0.0, 255.0).astype("u1")
        return CoverageMap(tick=world.tick, rows=rows, columns=columns, cell=world.parameters.cell, cells=share.tobytes())

    def fly(self, *, on_tick: Callable[[], None] | None = None) -> Flight:
        """Wait for the vehicles, fly to the end (or to `flight.stop()`), and tell everybody that it is over.

        Raises:
            PeerLost: If a vehicle does not join.
        """
        self.join()
        self.started = time.perf_counter()
        if not self.flight.over:
            self.flight.fly(self, on_tick=on_tick)
        return self.flight
