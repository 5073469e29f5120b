"""End of a tick: in lockstep once all vehicles have responded, in real time at the time of the clock."""

import time
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

from bus.errors import PeerLost
from bus.messages.vehicle import Command, Observation, UavObservation
from bus.session import Session
from sim.scenario.types import Run
from sim.server.sessions import Sessions

_CHECK_INTERVAL = 0.2
"""Interval at which a waiting pace checks connections and requests to stop [s]."""
_GRACE = 0.3
"""Time without a session after which a connected router's vehicle counts as disconnected [s].

A router that dies removes all liveliness tokens, and Zenoh may report these first."""
_LONGEST_SLEEP = 0.05
"""Longest single sleep of the clock [s]."""
_BEHIND = 1.0
"""Delay beyond which the clock is reset [s of wall time].

A burst of late ticks would leave the vehicles no time to respond.
"""
_FIRST_GRACE = 2.0
"""Grace time in the first tick [s]: the launcher of a vehicle that fails at once can still stop the run."""
_COMPILING = 6.0
"""Deadlines that a vehicle may use for its first command, and after a change of its law or driver: it may compile."""
_COMPILING_TEAM = 30.0
"""The same for the first command in a scenario with teams: their UAVs compile much more, all at once."""
_LATE = 0.5
"""Share of its duration by which a tick may end late without being counted."""

Idle = Callable[[], bool]
"""Callback of a waiting pace; returns True if the run has been ended."""


def _nothing() -> None:
    """Do nothing."""


class _Wait(NamedTuple):
    """Start and limit of the wait for a vehicle [s]."""

    since: float
    limit: float
    patient: bool
    """True if the pace also waits while the vehicle is disconnected."""


class Lockstep:
    """Pace that waits for every vehicle's command, and otherwise runs as fast as possible.

    Args:
        session: The simulator's session.
        sessions: The vehicles' sessions.
        timing: Deadlines, and whether to wait for disconnected vehicles.
        on_event: Called with one line for the user.
        teamed: True if the UAVs form teams.
    """

    factor: float | None = None
    """None: as fast as possible."""
    late_ticks = 0
    """Always 0: there is no clock."""

    def __init__(
        self,
        session: Session,
        sessions: Sessions,
        timing: Run,
        on_event: Callable[[str], None],
        *,
        teamed: bool = False,
    ) -> None:
        self._session = session
        self._sessions = sessions
        self._first = _COMPILING_TEAM if teamed else _COMPILING
        self._deadline = timing.deadline
        self._join_timeout = timing.join_timeout
        self._respawn = timing.respawn
        self._on_event = on_event
        self._check_interval = min(timing.deadline, _CHECK_INTERVAL)
        self._grace = min(timing.deadline, _GRACE)
        self._first_grace = min(timing.deadline, _FIRST_GRACE)
        self._observations: Mapping[str, Observation] = {}
        self._awaited: dict[str, _Wait] = {}
        self._due: set[str] = set()  # vehicles that have responded, or been late, once
        self._given_up: set[str] = set()
        self._flying: set[str] = set()  # vehicles present at the start of this tick
        self._reconnecting: dict[str, float] = {}
        """Vehicles that disconnected with their router, and the time limit for their return [s]."""
        self._routers = session.routers
        self._alone_since: float | None = None

    def restart(self) -> None:
        """Do nothing: lockstep has no clock."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Send each vehicle its observation."""
        self._observations = observations
        given = self._sessions.send(observations)
        now = time.monotonic()
        self._given_up -= given
        self._awaited = {
            name: _Wait(now, self._limit(name, observations[name]), patient=False) for name in given
        }
        if len(given) < len(observations):
            self._await_absent(observations.keys() - given - self._given_up, now)
        self._flying = set(self._awaited)

    def _limit(self, name: str, observation: Observation) -> float:
        """Return the time limit for a vehicle's command [s]."""
        driven = observation.law if isinstance(observation, UavObservation) else observation.driver
        if name not in self._due:
            return self._deadline * self._first
        return self._deadline * (_COMPILING if driven is not None else 1.0)

    def _await_absent(self, names: Collection[str], now: float) -> None:
        """Wait for vehicles that could not receive this tick's observation, if they may return."""
        for name in names:
            if self._respawn:
                self._awaited[name] = _Wait(now, self._join_timeout, patient=True)
            elif name in self._reconnecting:
                self._awaited[name] = _Wait(now, self._reconnecting[name] - now, patient=True)
            elif name in self._flying:
                self._awaited[name] = _Wait(now, self._grace, patient=True)

    def collect(
        self, tick: int, idle: Idle, meanwhile: Callable[[], None] = _nothing
    ) -> dict[str, Command]:
        """Wait for the commands of all vehicles that received this tick's observation, up to their time limits.

        The simulator shares its core with vehicles that have little to compute, and would delay them. Its own work
        therefore runs after the first command has arrived.

        Args:
            tick: Current tick.
            idle: Called repeatedly while waiting.
            meanwhile: Work to do while the vehicles compute; called at most once.

        Returns:
            Newest command of each vehicle with a new one.
        """
        commands: dict[str, Command] = {}
        awaited, timeout = self._awaited, self._check_interval
        next_check = time.monotonic() + timeout
        while awaited:
            envelope = self._sessions.commands.receive(timeout)
            if envelope is not None:
                if self._sessions.accept(envelope, tick, commands, oldest=tick):
                    awaited.pop(envelope.sender, None)
                    self._due.add(envelope.sender)
                    self._reconnecting.pop(envelope.sender, None)
                    if not awaited:
                        break
                    meanwhile()
                    meanwhile = _nothing
                # a flood of messages must not prevent the checks
                if time.monotonic() < next_check:
                    continue
            self._sessions.follow()
            if idle():
                break
            timeout = self._check_interval
            if self._router_is_connected():
                self._handle_absent(tick)
                self._give_up(tick)
                limits = (wait.since + wait.limit for wait in awaited.values())
                rest = min(limits, default=0.0) - time.monotonic()
                timeout = min(timeout, max(rest, 0.0))
            next_check = time.monotonic() + timeout
        return commands

    def _router_is_connected(self) -> bool:
        """Return False while the router is disconnected: the clock then stops, and no vehicle counts as late.

        Raises:
            PeerLost: If it does not return in time.
        """
        now, routers = time.monotonic(), self._session.routers
        if not routers:
            if self._alone_since is None:
                self._alone_since = now
                self._on_event("router disconnected; the simulation is paused")
            if now - self._alone_since > self._join_timeout:
                raise PeerLost(f"the router has been disconnected for {self._join_timeout:g} s")
            return False
        if self._alone_since is not None or routers != self._routers:
            self._alone_since, self._routers = None, routers
            self._on_event("router reconnected")
            # the vehicles have to reconnect to it too
            self._reconnecting = dict.fromkeys(self._flying, now + self._join_timeout)
            for name in self._awaited:
                self._awaited[name] = _Wait(now, self._join_timeout, patient=True)
        return True

    def _handle_absent(self, tick: int) -> None:
        """Wait for disconnected vehicles or continue without them; send those that returned what they missed."""
        now = time.monotonic()
        grace = self._grace if tick else self._first_grace
        for name in self._awaited.keys() & set(self._sessions.absent):
            if not self._awaited[name].patient:
                limit = self._join_timeout if self._may_return(name) else grace
                self._awaited[name] = _Wait(now, limit, patient=True)
        back = [name for name in self._sessions.unbriefed if name in self._awaited]
        for name in self._sessions.send({name: self._observations[name] for name in back}):
            # it has its whole past to process
            self._awaited[name] = _Wait(now, self._join_timeout, patient=self._may_return(name))

    def _may_return(self, name: str) -> bool:
        """True if the clock stops for this disconnected vehicle."""
        return self._respawn or name in self._reconnecting

    def _give_up(self, tick: int) -> None:
        now = time.monotonic()
        late = [name for name, wait in self._awaited.items() if now - wait.since >= wait.limit]
        absent = set(self._sessions.absent)
        for name in late:
            waited = now - self._awaited.pop(name).since
            self._due.add(name)
            if name in absent:
                self._given_up.add(name)
                if self._may_return(name):
                    self._on_event(
                        f"{name} did not reconnect within {waited:.1f} s; it brakes and the run continues"
                    )
            else:
                self._sessions.report_late(name, tick, waited)


class RealTime:
    """Pace that follows the wall clock without waiting, and uses the newest commands.

    Tick k ends (k + 1) dt / F after the start: computed, never summed, so that it does not drift.

    Args:
        sessions: The vehicles' sessions.
        dt: Duration of a tick [s].
        factor: F, simulated seconds per second of wall time.
        on_event: Called with one line for the user.
    """

    def __init__(
        self, sessions: Sessions, *, dt: float, factor: float, on_event: Callable[[str], None]
    ) -> None:
        self.factor: float | None = factor
        """Simulated seconds per second of wall time."""
        self.late_ticks = 0
        """Ticks that ran late."""
        self._sessions = sessions
        self._period = dt / factor
        self._on_event = on_event
        self._start: float | None = None
        """Start time of tick `_first` [s]; None: the next tick starts now."""
        self._first = 0

    def restart(self) -> None:
        """Restart the clock after a pause."""
        self._start = None

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Send each vehicle its observation; a long past is sent in parts, one per tick."""
        self._sessions.follow()
        self._sessions.send(observations, parts=1)

    def _due(self, tick: int) -> float:
        """Return the time at which this tick ends [s], on the monotonic clock."""
        now = time.monotonic()
        if self._start is None:
            self._start, self._first = now, tick
        due = self._start + (tick + 1 - self._first) * self._period
        if now - due > _BEHIND:
            self._on_event(
                f"the clock is {now - due:.1f} s behind at tick {tick}; the clock is reset"
            )
            self._start, self._first = now, tick
            due = now + self._period
            self.late_ticks += 1
        return due

    def collect(
        self, tick: int, idle: Idle, meanwhile: Callable[[], None] = _nothing
    ) -> dict[str, Command]:
        """Sleep until the end of the tick, then return the newest commands; arguments as in `Lockstep.collect`."""
        meanwhile()
        commands: dict[str, Command] = {}
        due = self._due(tick)
        while not idle():
            self._accept_all(tick, commands)
            rest = due - time.monotonic()
            if rest <= 0.0:
                break
            time.sleep(min(rest, _LONGEST_SLEEP))
        if time.monotonic() - due > _LATE * self._period:
            self.late_ticks += 1
        self._accept_all(tick, commands)
        return commands

    def _accept_all(self, tick: int, commands: dict[str, Command]) -> None:
        while (envelope := self._sessions.commands.next_waiting()) is not None:
            self._sessions.accept(envelope, tick, commands)


Pace = Lockstep | RealTime
"""Pace of a run: sends observations, and collects commands, tick by tick."""
