"""The simulator process: the world behind the bus."""

import time
from collections.abc import Callable, Mapping

from bus.errors import PeerLost
from bus.keys import CONTROL
from bus.messages import Action, Command, Control, Observation, Status, VehicleStatus
from bus.session import Session
from sim.flight import Flight
from sim.pace import Lockstep, Pace, RealTime
from sim.scenario import Scenario
from sim.seats import Seats
from sim.telemetry import Telemetry


class Server:
    """Flies one scenario with vehicles that are other processes.

    Args:
        session: The simulator's session.
        scenario: What is flown.
        seed: Of all random numbers.
        realtime: Simulated seconds per second of wall time; None: lockstep, as fast as the vehicles answer.
        deadline: In lockstep, how long to wait for the commands of one tick [s].
        join_timeout: How long to wait for all vehicles at the start, for one that is to come back, and for the router [s].
        respawn: In lockstep, whether the clock stands still for a vehicle that was lost.
        on_event: Called with one line for a person: who joined, who was lost, who is late.
        stop: Asked now and then whether somebody wants the run to end.
    """

    def __init__(
        self,
        session: Session,
        scenario: Scenario,
        seed: int,
        *,
        realtime: float | None = None,
        deadline: float = 10.0,
        join_timeout: float = 30.0,
        respawn: bool = False,
        on_event: Callable[[str], None] = lambda _line: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.flight = Flight(scenario, seed)
        self.started = 0.0
        """Wall clock at the first tick [s]."""
        self._join_timeout = join_timeout
        self._stop = stop
        self._seats = Seats(session, self.flight, on_event)
        self._pace: Pace = (
            Lockstep(session, self._seats, deadline=deadline, patience=join_timeout, respawn=respawn, on_event=on_event)
            if realtime is None
            else RealTime(self._seats, dt=scenario.dt, factor=realtime, on_event=on_event)
        )
        self._controls = session.inbox(CONTROL)
        self._paused = False
        self._steps = 0
        """Ticks that are still to be stepped through before the clock stands still again."""
        self._telemetry = Telemetry(session, self.flight, self._seats, self._pace, lambda: self._paused)
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
                raise PeerLost(f"{' and '.join(missing)} did not join within {self._join_timeout:g} s")
            self._seats.commands.receive(0.2)

    def _idle(self) -> bool:
        """While the simulator waits for whatever it is: heed who wants the end, and tell observers how it stands."""
        if self._stop():
            self.flight.stop()
        self._telemetry.refresh()
        return self.flight.over

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle that is there its observation of this tick, and observers what they listen to."""
        self._heed_controls()
        self._pace.publish(observations)
        self._telemetry.tell()

    def collect(self, tick: int) -> dict[str, Command]:
        """The commands for this tick, once it is over."""
        if self._stop():
            self.flight.stop()
        return self._pace.collect(tick, self._idle)

    def _heed_controls(self) -> None:
        """Take in what operators want, and stand still for as long as they want it."""
        while (letter := self._controls.next_waiting()) is not None:
            self._heed(letter.message)
        if self._paused and not self.flight.over:
            if not self._steps:
                self._stand_still()
            self._steps = max(0, self._steps - 1)

    def _stand_still(self) -> None:
        self._telemetry.refresh(at_once=True)
        while self._paused and not self._steps and not self._idle():
            letter = self._controls.receive(0.2)
            if letter is not None:
                self._heed(letter.message)
        self._pace.restart()

    def _heed(self, control: object) -> None:
        if isinstance(control, Control):
            self._paused = control.action is not Action.RESUME
            self._steps = control.ticks if control.action is Action.STEP else 0

    def status(self, now: float) -> Status:
        """How the run stands, `now` on the monotonic clock [s]."""
        return self._telemetry.status(now)

    def vehicles(self) -> dict[str, VehicleStatus]:
        """How each vehicle's process has done so far."""
        self._seats.follow()
        return self._seats.statuses()

    @property
    def late_ticks(self) -> int:
        """Ticks that the clock could not keep."""
        return self._pace.late_ticks

    def fly(self, *, on_tick: Callable[[], None] | None = None) -> Flight:
        """Wait for the vehicles, fly to the end (or to `flight.stop()`), and tell everybody that it is over.

        Raises:
            PeerLost: If a vehicle does not join, or the router goes away for good.
        """
        self.join()
        self.started = time.perf_counter()
        if not self.flight.over:
            self.flight.fly(self, on_tick=on_tick)
            self._telemetry.refresh(at_once=True)
        return self.flight
