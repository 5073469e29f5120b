"""Server of the simulator process: a world behind the bus."""

import time
from collections.abc import Callable, Mapping

from bus.errors import PeerLost
from bus.messages.control import Action, Change
from bus.messages.telemetry import Status, VehicleStatus
from bus.messages.vehicle import Command, Observation
from bus.session import Session
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from sim.server.operator_controls import OperatorControls
from sim.server.pace import Lockstep, Pace, RealTime
from sim.server.sessions import Sessions
from sim.server.telemetry import Telemetry, Warn


class Server:
    """Run of one scenario whose vehicles are other processes.

    Args:
        session: The simulator's session.
        scenario: Scenario to run.
        seed: Seed of all random numbers, together with the secret.
        timing: Pace and deadlines.
        secret: Secret of the run, never sent; empty: none.
        on_event: Called with one line for the user: a vehicle joined, disconnected or is late.
        stop: Called repeatedly; returns True to end the run.
        warn: Returns one line for each assumption of the certificate that the present links violate; sent to observers.
    """

    def __init__(
        self,
        session: Session,
        scenario: Scenario,
        seed: int,
        *,
        secret: str = "",
        on_event: Callable[[str], None] = lambda _line: None,
        stop: Callable[[], bool] = lambda: False,
        warn: Warn = lambda _scenario, _links: (),
    ) -> None:
        self.flight = Flight(scenario, seed, secret=secret, on_notice=on_event)
        self.started = 0.0
        """Wall clock at the first tick [s]; in lockstep after all first commands, because pilots compile before
        them.
        """
        self._started = False
        self._join_timeout = scenario.run.join_timeout
        self._stop = stop
        self._sessions = Sessions(session, self.flight, on_event)

        def make_pace(factor: float | None) -> Pace:
            if factor is not None:
                return RealTime(self._sessions, dt=scenario.dt, factor=factor, on_event=on_event)
            teamed = scenario.team is not None
            return Lockstep(session, self._sessions, scenario.run, on_event, teamed=teamed)

        self._operators = OperatorControls(
            session, self.flight, make_pace, scenario.run.realtime or None, on_event
        )
        self._telemetry = Telemetry(
            session, self.flight, self._sessions, self._operators, warn, on_event
        )
        session.announce()

    def join(self) -> None:
        """Wait until every vehicle has joined, and send its briefing.

        Raises:
            PeerLost: If a vehicle does not join in time; the message names it.
        """
        limit = time.monotonic() + self._join_timeout
        while not self._idle():
            self._sessions.follow()
            for name in self._sessions.unbriefed:
                self._sessions.brief(name)
            missing = self._sessions.absent
            if not missing:
                return
            if time.monotonic() > limit:
                raise PeerLost(
                    f"{' and '.join(missing)} did not join within {self._join_timeout:g} s"
                )
            self._sessions.commands.receive(0.2)

    def _idle(self) -> bool:
        """Check for a request to stop and send telemetry while waiting; return True at the end of the run."""
        if self._stop():
            self.flight.stop()
        self._telemetry.refresh()
        return self.flight.over

    def begin(self, tick: int) -> None:
        """Apply operators' requests, and wait while the run is paused."""
        operators = self._operators
        operators.apply()
        if operators.paused and not self.flight.over:
            if not operators.steps:
                self._wait_while_paused()
            operators.steps = max(0, operators.steps - 1)
        operators.listen()

    def _wait_while_paused(self) -> None:
        operators = self._operators
        self._telemetry.refresh(at_once=True)
        while operators.paused and not operators.steps and not self._idle():
            operators.apply(timeout=0.2)
        operators.pace.restart()

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Send each connected vehicle its observation of this tick, and observers the telemetry."""
        self._operators.pace.publish(observations)
        self._telemetry.send_tick()

    def collect(self, tick: int) -> dict[str, Command]:
        """Return the commands for this tick, once it is over."""
        if self._stop():
            self.flight.stop()
        commands = self._operators.pace.collect(tick, self._idle, self.flight.take_down)
        if not self._started:
            self._started = True
            if self._operators.pace.factor is None:
                self.started = time.perf_counter()
        return commands

    def status(self, now: float) -> Status:
        """Return the status of the run at `now` on the monotonic clock [s]."""
        return self._telemetry.status(now)

    def vehicles(self) -> dict[str, VehicleStatus]:
        """Return the status of each vehicle's process so far."""
        self._sessions.follow()
        return self._sessions.statuses()

    @property
    def changes(self) -> tuple[Change, ...]:
        """Return the operators' changes in this episode so far, with their ticks."""
        changes = self._operators.changes
        first = max(
            (n + 1 for n, change in enumerate(changes) if change.control.action is Action.RESET),
            default=0,
        )
        return tuple(changes[first:])

    @property
    def telemetry_faults(self) -> dict[str, int]:
        """Return the number of telemetry messages that could not be made or sent, by topic."""
        return dict(self._telemetry.faults)

    @property
    def late_ticks(self) -> int:
        """Return the number of ticks that ran late."""
        return self._operators.late_ticks

    def fly(self, *, on_tick: Callable[[], None] | None = None) -> Flight:
        """Wait for the vehicles, simulate to the end (or to `flight.stop()`), and notify observers.

        Raises:
            PeerLost: If a vehicle does not join, or the router does not return.
        """
        self.join()
        self.started = time.perf_counter()
        while not self.flight.over:
            self.flight.fly(self, on_tick=on_tick)
            again = self._operators.next_flight()
            if again is not None:
                self.flight = again
                self._sessions.fly(again)
                self._telemetry.fly(again)
                self._operators.pace.restart()
                self.started, self._started = time.perf_counter(), False
        self._telemetry.refresh(at_once=True)
        return self.flight
