"""The simulator process: the world behind the bus."""

import time
from collections.abc import Callable, Mapping

from bus.errors import PeerLost
from bus.messages import Action, Change, Command, Observation, Status, VehicleStatus
from bus.session import Session
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from sim.server.operator_controls import Desk
from sim.server.pace import Lockstep, Pace, RealTime
from sim.server.sessions import Seats
from sim.server.telemetry import Telemetry, Warn, no_warnings


class Server:
    """Flies one scenario with vehicles that are other processes.

    Args:
        session: The simulator's session.
        scenario: What is flown.
        seed: Of all random numbers, with the secret.
        secret: Of the run, which stays in this process; empty: none.
        realtime: Simulated seconds per second of wall time; None: lockstep, as fast as the vehicles answer.
        deadline: In lockstep, how long to wait for the commands of one tick [s].
        join_timeout: How long to wait for all vehicles at the start, for one that is to come back, and for the
            router [s].
        respawn: In lockstep, whether the clock stands still for a vehicle that was lost.
        on_event: Called with one line for a person: who joined, who was lost, who is late.
        stop: Asked now and then whether somebody wants the run to end.
        warn: What cannot be promised of a scenario whose links are now these, a line each: observers are told.
    """

    def __init__(
        self,
        session: Session,
        scenario: Scenario,
        seed: int,
        *,
        secret: str = "",
        realtime: float | None = None,
        deadline: float = 10.0,
        join_timeout: float = 30.0,
        respawn: bool = False,
        on_event: Callable[[str], None] = lambda _line: None,
        stop: Callable[[], bool] = lambda: False,
        warn: Warn = no_warnings,
    ) -> None:
        self.flight = Flight(scenario, seed, secret=secret)
        self.started = 0.0
        """Wall clock at the first tick [s]."""
        self._join_timeout = join_timeout
        self._stop = stop
        self._seats = Seats(session, self.flight, on_event)

        def make_pace(factor: float | None) -> Pace:
            if factor is not None:
                return RealTime(self._seats, dt=scenario.dt, factor=factor, on_event=on_event)
            return Lockstep(
                session,
                self._seats,
                deadline=deadline,
                patience=join_timeout,
                respawn=respawn,
                on_event=on_event,
            )

        self._desk = Desk(session, self.flight, make_pace, realtime, on_event)
        self._telemetry = Telemetry(session, self.flight, self._seats, self._desk, warn)
        session.announce()

    def join(self) -> None:
        """Wait until every vehicle has joined, and brief each.

        Raises:
            PeerLost: If one does not come in time; it is named.
        """
        limit = time.monotonic() + self._join_timeout
        while not self._idle():
            self._seats.follow()
            for name in self._seats.unbriefed:
                self._seats.brief(name)
            missing = self._seats.absent
            if not missing:
                return
            if time.monotonic() > limit:
                raise PeerLost(
                    f"{' and '.join(missing)} did not join within {self._join_timeout:g} s"
                )
            self._seats.commands.receive(0.2)

    def _idle(self) -> bool:
        """While the simulator waits for whatever it is: heed who wants the end, and tell observers how it stands."""
        if self._stop():
            self.flight.stop()
        self._telemetry.refresh()
        return self.flight.over

    def begin(self, tick: int) -> None:
        """Do what operators want, and stand still for as long as they want it."""
        desk = self._desk
        desk.heed()
        if desk.paused and not self.flight.over:
            if not desk.steps:
                self._stand_still()
            desk.steps = max(0, desk.steps - 1)
        desk.listen()

    def _stand_still(self) -> None:
        desk = self._desk
        self._telemetry.refresh(at_once=True)
        while desk.paused and not desk.steps and not self._idle():
            desk.heed(patience=0.2)
        desk.pace.restart()

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle that is there its observation of this tick, and observers what they listen to."""
        self._desk.pace.publish(observations)
        self._telemetry.tell()

    def collect(self, tick: int) -> dict[str, Command]:
        """The commands for this tick, once it is over."""
        if self._stop():
            self.flight.stop()
        return self._desk.pace.collect(tick, self._idle)

    def status(self, now: float) -> Status:
        """How the run stands, `now` on the monotonic clock [s]."""
        return self._telemetry.status(now)

    def vehicles(self) -> dict[str, VehicleStatus]:
        """How each vehicle's process has done so far."""
        self._seats.follow()
        return self._seats.statuses()

    @property
    def changes(self) -> tuple[Change, ...]:
        """What operators have changed in this flight so far, and when."""
        changes = self._desk.changes
        begun = max(
            (n + 1 for n, change in enumerate(changes) if change.control.action is Action.RESET),
            default=0,
        )
        return tuple(changes[begun:])

    @property
    def late_ticks(self) -> int:
        """Ticks that the clock could not keep."""
        return self._desk.late_ticks

    def fly(self, *, on_tick: Callable[[], None] | None = None) -> Flight:
        """Wait for the vehicles, fly to the end (or to `flight.stop()`), and tell everybody that it is over.

        Raises:
            PeerLost: If a vehicle does not join, or the router goes away for good.
        """
        self.join()
        self.started = time.perf_counter()
        while not self.flight.over:
            self.flight.fly(self, on_tick=on_tick)
            again = self._desk.next_flight()
            if again is not None:
                self.flight = again
                self._seats.fly(again)
                self._telemetry.fly(again)
                self._desk.pace.restart()
                self.started = time.perf_counter()
        self._telemetry.refresh(at_once=True)
        return self.flight
