"""Decides when a tick is over: in lockstep, when all have answered; in real time, when the clock says so."""

import time
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

from bus.errors import PeerLost
from bus.messages.vehicle import Command, Observation, UavObservation
from bus.session import Session
from sim.scenario.types import Run
from sim.server.sessions import Slots

_LOOK_AROUND = 0.2
"""While it waits, a pace looks this often [s] at who is still there and whether somebody wants the end."""
_GRACE = 0.3
"""A vehicle is only gone if it has been for so long [s] while the router was there.

A router that dies takes all tokens with it, and Zenoh may tell of those first."""
_NAP = 0.05
"""Longest sleep of the clock in one piece [s]."""
_BEHIND = 1.0
"""A clock that is further behind than this [s] of wall time starts anew.

A burst of ticks would leave nobody time to answer.
"""
_FIRST_GRACE = 2.0
"""So long [s] in the first tick: whoever has started a vehicle that fails at once can still end the run unflown."""
_COMPILING = 6.0
"""A vehicle may take this many deadlines for its first answer, and for that after a change of its law or driver: the
first time on a machine it compiles then."""
_LATE = 0.5
"""A tick that ends later than it should by more than this share of its length is late."""

Idle = Callable[[], bool]
"""Called now and then while a pace waits; returns whether the flight has been ended."""


def _nothing() -> None:
    """There is no work."""


class _Wait(NamedTuple):
    """Since when a vehicle is awaited, and how long it may take [s]."""

    since: float
    limit: float
    patient: bool
    """True if it is waited for also where it is not there."""


class Lockstep:
    """Waits for every vehicle's command, as fast as they answer.

    Args:
        session: The simulator's session.
        slots: The vehicles' places.
        timing: How long it waits, and for whom.
        on_event: Called with one line for a person.
    """

    factor: float | None = None
    """It keeps none: as fast as it goes."""
    late_ticks = 0
    """There is no clock that it could fail to keep."""

    def __init__(
        self,
        session: Session,
        slots: Slots,
        timing: Run,
        on_event: Callable[[str], None],
    ) -> None:
        self._session = session
        self._slots = slots
        self._deadline = timing.deadline
        self._patience = timing.join_timeout
        self._respawn = timing.respawn
        self._on_event = on_event
        self._look_around = min(timing.deadline, _LOOK_AROUND)
        self._grace = min(timing.deadline, _GRACE)
        self._first_grace = min(timing.deadline, _FIRST_GRACE)
        self._observations: Mapping[str, Observation] = {}
        self._awaited: dict[str, _Wait] = {}
        self._due: set[str] = set()  # vehicles that have answered, or have been late once
        self._given_up: set[str] = set()
        self._flying: set[str] = set()  # vehicles that were there when this tick began
        self._cut_off: dict[str, float] = {}
        """Vehicles that went with their router, and until when they may take to find it again."""
        self._routers = session.routers
        self._alone_since: float | None = None

    def restart(self) -> None:
        """Nothing: lockstep has no clock."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle its observation."""
        self._observations = observations
        given = self._slots.send(observations)
        now = time.monotonic()
        self._given_up -= given
        self._awaited = {
            name: _Wait(now, self._limit(name, observations[name]), patient=False) for name in given
        }
        if len(given) < len(observations):
            self._await_absent(observations.keys() - given - self._given_up, now)
        self._flying = set(self._awaited)

    def _limit(self, name: str, observation: Observation) -> float:
        """Return how long a vehicle may take for its answer [s]."""
        driven = observation.law if isinstance(observation, UavObservation) else observation.driver
        compiles = driven is not None or name not in self._due
        return self._deadline * (_COMPILING if compiles else 1.0)

    def _await_absent(self, names: Collection[str], now: float) -> None:
        """Wait for those who could not be given this tick's observation, if they may come back."""
        for name in names:
            if self._respawn:
                self._awaited[name] = _Wait(now, self._patience, patient=True)
            elif name in self._cut_off:
                self._awaited[name] = _Wait(now, self._cut_off[name] - now, patient=True)
            elif name in self._flying:
                self._awaited[name] = _Wait(now, self._grace, patient=True)

    def collect(
        self, tick: int, idle: Idle, meanwhile: Callable[[], None] = _nothing
    ) -> dict[str, Command]:
        """Wait for the commands of all who were given this tick's observation, each no longer than it may take.

        The simulator shares its core with the vehicles that have least to do, and they would wait for its own work: it
        is done once the first of them has answered.

        Args:
            tick: Now.
            idle: Called now and then meanwhile.
            meanwhile: Work that may be done while the vehicles think; may be called, once.

        Returns:
            The newest command of each vehicle that has a new one.
        """
        commands: dict[str, Command] = {}
        awaited, patience = self._awaited, self._look_around
        look = time.monotonic() + patience
        while awaited:
            envelope = self._slots.commands.receive(patience)
            if envelope is not None:
                if self._slots.take(envelope, tick, commands, oldest=tick):
                    awaited.pop(envelope.sender, None)
                    self._due.add(envelope.sender)
                    self._cut_off.pop(envelope.sender, None)
                    if not awaited:
                        break
                    meanwhile()
                    meanwhile = _nothing
                # a flood of messages must not keep us from looking around
                if time.monotonic() < look:
                    continue
            self._slots.follow()
            if idle():
                break
            patience = self._look_around
            if self._bus_is_there():
                self._mind_the_absent(tick)
                self._give_up(tick)
                limits = (wait.since + wait.limit for wait in awaited.values())
                rest = min(limits, default=0.0) - time.monotonic()
                patience = min(patience, max(rest, 0.0))
            look = time.monotonic() + patience
        return commands

    def _bus_is_there(self) -> bool:
        """False while the router is away: without it nobody can be blamed, and the clock stands still.

        Raises:
            PeerLost: If it does not come back.
        """
        now, routers = time.monotonic(), self._session.routers
        if not routers:
            if self._alone_since is None:
                self._alone_since = now
                self._on_event("the router is lost; the clock stands still")
            if now - self._alone_since > self._patience:
                raise PeerLost(f"the router has been away for {self._patience:g} s")
            return False
        if self._alone_since is not None or routers != self._routers:
            self._alone_since, self._routers = None, routers
            self._on_event("the router is back")
            # the vehicles have to find it again too
            self._cut_off = dict.fromkeys(self._flying, now + self._patience)
            for name in self._awaited:
                self._awaited[name] = _Wait(now, self._patience, patient=True)
        return True

    def _mind_the_absent(self, tick: int) -> None:
        """Do without those who have gone, or wait for them; give those who are back what they have missed."""
        now = time.monotonic()
        grace = self._grace if tick else self._first_grace
        for name in self._awaited.keys() & set(self._slots.absent):
            if not self._awaited[name].patient:
                limit = self._patience if self._is_waited_for(name) else grace
                self._awaited[name] = _Wait(now, limit, patient=True)
        back = [name for name in self._slots.unbriefed if name in self._awaited]
        for name in self._slots.send({name: self._observations[name] for name in back}):
            # it has all its past to work through
            self._awaited[name] = _Wait(now, self._patience, patient=self._is_waited_for(name))

    def _is_waited_for(self, name: str) -> bool:
        """True if the clock stands still for a vehicle that has gone."""
        return self._respawn or name in self._cut_off

    def _give_up(self, tick: int) -> None:
        now = time.monotonic()
        late = [name for name, wait in self._awaited.items() if now - wait.since >= wait.limit]
        absent = set(self._slots.absent)
        for name in late:
            waited = now - self._awaited.pop(name).since
            self._due.add(name)
            if name in absent:
                self._given_up.add(name)
                if self._is_waited_for(name):
                    self._on_event(
                        f"{name} has not come back within {waited:.1f} s; it brakes and the run goes on"
                    )
            else:
                self._slots.name_late(name, tick, waited)


class RealTime:
    """Keeps the wall clock, waits for nobody, and takes the newest command that has arrived.

    The end of tick k is due at (k + 1) dt / F after the start: computed, never summed, so it does not drift.

    Args:
        slots: The vehicles' places.
        dt: Length of a tick [s].
        factor: F, simulated seconds per second of wall time.
        on_event: Called with one line for a person.
    """

    def __init__(
        self, slots: Slots, *, dt: float, factor: float, on_event: Callable[[str], None]
    ) -> None:
        self.factor: float | None = factor
        """Simulated seconds per second that it keeps."""
        self.late_ticks = 0
        """Ticks that the clock could not keep."""
        self._slots = slots
        self._period = dt / factor
        self._on_event = on_event
        self._start: float | None = None
        """Time at which the tick `_first` began [s]; None: the next one begins now."""
        self._first = 0

    def restart(self) -> None:
        """The clock has stood still: count from now."""
        self._start = None

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle its observation; a long past goes out in parts, one a tick."""
        self._slots.follow()
        self._slots.send(observations, parts=1)

    def _due(self, tick: int) -> float:
        """The time at which this tick's end is due [s], on the monotonic clock."""
        now = time.monotonic()
        if self._start is None:
            self._start, self._first = now, tick
        due = self._start + (tick + 1 - self._first) * self._period
        if now - due > _BEHIND:
            self._on_event(
                f"the clock is {now - due:.1f} s behind at tick {tick}; it goes on from here"
            )
            self._start, self._first = now, tick
            due = now + self._period
            self.late_ticks += 1
        return due

    def collect(
        self, tick: int, idle: Idle, meanwhile: Callable[[], None] = _nothing
    ) -> dict[str, Command]:
        """Sleep until the tick is over; then take what has come. Arguments as of `Lockstep.collect`."""
        meanwhile()
        commands: dict[str, Command] = {}
        due = self._due(tick)
        while not idle():
            self._take(tick, commands)
            rest = due - time.monotonic()
            if rest <= 0.0:
                break
            time.sleep(min(rest, _NAP))
        if time.monotonic() - due > _LATE * self._period:
            self.late_ticks += 1
        self._take(tick, commands)
        return commands

    def _take(self, tick: int, commands: dict[str, Command]) -> None:
        while (envelope := self._slots.commands.next_waiting()) is not None:
            self._slots.take(envelope, tick, commands)


Pace = Lockstep | RealTime
"""The course of time from tick to tick: gives observations out, and brings commands back."""
