"""Operator controls of a run; each takes effect between two ticks."""

from collections import deque
from collections.abc import Callable

import msgspec

from bus.errors import ScenarioError
from bus.keys import CONTROL, OPERATOR
from bus.messages.base import fitted
from bus.messages.control import Action, Change, Control, Rejection
from bus.messages.vehicle import Teleoperation
from bus.registry import DRIVERS
from bus.session import Session
from sim.scenario.checks import check_scenario
from sim.scenario.laws import with_law
from sim.server.flight import Flight
from sim.server.pace import Pace

_REJECTIONS = 5
"""Number of rejected requests kept for the status."""

MakePace = Callable[[float | None], Pace]
"""Function that makes the pace for a factor; None: lockstep."""


class OperatorControls:
    """Execution of operators' requests: rejects invalid ones, and keeps those that took effect.

    Pause, step and speed change the pace of simulated time, never the trajectory.

    Args:
        session: The simulator's session.
        flight: The run.
        make_pace: Makes the pace for a factor.
        factor: Initial factor; None: lockstep.
        on_event: Called with one line for the user.
    """

    def __init__(
        self,
        session: Session,
        flight: Flight,
        make_pace: MakePace,
        factor: float | None,
        on_event: Callable[[str], None],
    ) -> None:
        self.pace = make_pace(factor)
        self.paused = False
        self.steps = 0
        """Remaining ticks to step through before the clock stops again."""
        self.changes: list[Change] = []
        """Controls that have taken effect, oldest first."""
        self.rejections = deque[Rejection](maxlen=_REJECTIONS)
        """Most recent rejected requests, with the reason."""
        self.operators: dict[str, str] = {}
        """Current operator of each UGV, if the operator gave a name."""
        self._late_before = 0
        self._flight, self._make_pace, self._on_event = flight, make_pace, on_event
        self._ugvs = {ugv.name: OPERATOR for ugv in flight.scenario.ugv}
        self._teleoperation = session.inbox_of_all(self._ugvs)
        self._controls = session.inbox(CONTROL)
        self._next_seed: int | None = None

    @property
    def late_ticks(self) -> int:
        """Ticks that ran late, at all factors."""
        return self._late_before + self.pace.late_ticks

    def next_flight(self) -> Flight | None:
        """Return the run that replaces this one after a reset; None: no reset was requested."""
        if self._next_seed is None:
            return None
        old = self._flight
        self._flight = Flight(
            old.scenario,
            self._next_seed,
            secret=old.secret,
            episode=old.episode + 1,
            on_notice=old.on_notice,
        )
        self._next_seed = None
        self.operators.clear()
        return self._flight

    def apply(self, *, timeout: float | None = None) -> None:
        """Execute the requests received since the last call.

        Args:
            timeout: Time to wait for a request [s]; None: do not wait.
        """
        envelope = (
            self._controls.next_waiting() if timeout is None else self._controls.receive(timeout)
        )
        while envelope is not None:
            if isinstance(envelope.message, Control):
                self._do(envelope.message)
            envelope = self._controls.next_waiting()

    def listen(self) -> None:
        """Forward the operators' teleoperation messages: they are received at this tick."""
        while (envelope := self._teleoperation.next_waiting()) is not None:
            if isinstance(envelope.message, Teleoperation):
                self._flight.teleoperate(envelope.sender, envelope.message)

    def _do(self, control: Control) -> None:
        try:
            self._carry_out(control)
        except ScenarioError as error:
            tick, reason = self._flight.world.tick, fitted(str(error))
            self.rejections.append(Rejection(tick=tick, action=control.action, reason=reason))
            self._on_event(f"an operator's {control.action} is rejected: {error}")
            return
        self.changes.append(Change(tick=self._flight.world.tick, control=control))
        if control.action is not Action.STEP:
            self._on_event(f"operator: {control.in_words()} at tick {self._flight.world.tick}")

    def _carry_out(self, control: Control) -> None:
        match control.action:
            case Action.PAUSE:
                self.paused, self.steps = True, 0
            case Action.RESUME:
                self.paused, self.steps = False, 0
            case Action.STEP:
                self.paused, self.steps = True, control.ticks
            case Action.SPEED:
                self._late_before += self.pace.late_ticks
                self.pace = self._make_pace(control.factor)
            case Action.RESET:
                self._next_seed = self._flight.seed if control.seed is None else control.seed
                self._flight.abandon()
            case Action.LAW:
                self._law(control)
            case Action.DRIVER:
                self._driver(control)
            case Action.LINK:
                if control.link is None or control.settings is None:
                    raise ScenarioError("link, settings: missing; both are required")
                self._flight.degrade(control.link, control.vehicle, control.settings)

            case Action.REQUEST:
                if control.vehicle is None or control.request is None:
                    raise ScenarioError("vehicle, request: missing; both are required")
                self._flight.request(control.vehicle, control.request)

    def _law(self, control: Control) -> None:
        if control.law is None:
            raise ScenarioError("law: missing; a law is required")
        if not self._flight.world.uavs:
            raise ScenarioError(
                f"law = {control.law.name!r}: the scenario has no UAV; allowed: scenarios with a UAV"
            )
        check_scenario(with_law(self._flight.scenario, control.law), source="law")
        self._flight.order(control.law)

    def _driver(self, control: Control) -> None:
        names = [control.vehicle] if control.vehicle is not None else list(self._ugvs)
        if control.vehicle is not None and control.vehicle not in self._ugvs:
            raise ScenarioError(
                f"vehicle = {control.vehicle!r}: unknown; allowed: {', '.join(self._ugvs)}"
            )
        allowed = [row.name for row in DRIVERS.values() if not row.outside]
        if control.driver not in allowed:
            raise ScenarioError(
                f"driver = {control.driver!r}: cannot be assigned; allowed: {', '.join(allowed)}"
            )
        scenario = self._flight.scenario
        assigned = [
            msgspec.structs.replace(ugv, driver=control.driver) if ugv.name in names else ugv
            for ugv in scenario.ugv
        ]
        check_scenario(msgspec.structs.replace(scenario, ugv=tuple(assigned)), source="driver")
        for name in names:
            self._flight.assign_driver(name, control.driver)
            self.operators.pop(name, None)
            if control.operator is not None and DRIVERS[control.driver].operated:
                self.operators[name] = control.operator
