"""The link: a thread between the wheel and the bus, so that a slow terminal never keeps a brake from being told."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from bus.errors import BusError
from bus.keys import CONTROL, COVERAGE, GLANCE, OPERATOR, SIMULATOR_NAME, STATUS
from bus.messages import Action, Control, CoverageMap, Drive, Message, Status, Truth
from bus.registry import TELEOP
from bus.session import Inbox, Session
from outrider.view.terminal.pressed_keys import Heading, Wheel

_LOOK = 0.05
"""Time between two looks at the bus [s]."""
_SEND, _SEND_FASTEST = 0.1, 0.02
"""Time between two words to the vehicle [s], in real time and at most."""
_HOLD = 0.5
"""How long a word counts for a vehicle [s], simulated, unless the scenario says otherwise."""
_ASK_AGAIN = 1.0
"""Time after which a control that shows no effect is sent anew [s]."""
_SETTLE = 1.5
"""How long the hand-back is waited for [s]."""
STALE = 2.0
"""A status older than this is no news [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """What is known at one moment."""

    status: Status | None = None
    truth: Truth | None = None
    coverage: CoverageMap | None = None
    age: float = 0.0
    """Time since the newest status [s]."""
    connected: bool = True
    present: bool = True
    """Whether the simulator is there."""
    driver: str = ""
    """Who is at the wheel."""
    asked: bool = False
    """Whether the wheel has been asked for and not been given yet."""
    wanted: tuple[float, float] | None = None
    """The velocity that is wanted [m/s]."""
    speed: float = 0.0
    """How fast a pressed key drives [m/s]."""
    fault: str = ""

    @property
    def mine(self) -> bool:
        """Whether the operator is at the wheel."""
        return self.driver == TELEOP


def ugvs_of(status: Status, truth: Truth | None = None) -> tuple[str, ...]:
    """The UGVs of a run, as far as these two tell."""
    found = set(status.drivers)
    if status.geometry is not None:
        found |= set(status.geometry.uavs.values())
    if truth is not None:
        found |= {escort.ugv for escort in truth.escorts}
    return tuple(sorted(found))


def _newest(inbox: Inbox) -> Message | None:
    found: Message | None = None
    while (letter := inbox.next_waiting()) is not None:
        found = letter.message
    return found


class Link:
    """Drives one UGV over the bus.

    Args:
        session: The operator's.
        vehicle: Which UGV.
        speed: How fast a pressed key drives [m/s].
        back: Who gets the wheel in the end; empty: who had it before.
        status: The first one, if it has been read already.
    """

    def __init__(
        self,
        session: Session,
        vehicle: str,
        *,
        speed: float,
        back: str = "",
        status: Status | None = None,
    ) -> None:
        self.vehicle = vehicle
        self._session = session
        self._drives, self._controls = session.outbox(OPERATOR, vehicle), session.outbox(CONTROL)
        self._statuses, self._truths, self._maps = (
            session.inbox(key) for key in (STATUS, GLANCE, COVERAGE)
        )
        self._wheel = Wheel(speed)
        self._lock = threading.Lock()
        self._nudge = threading.Event()
        self._over = threading.Event()
        self._simulators: set[int] = set()
        self._status = status
        self._truth: Truth | None = None
        self._map: CoverageMap | None = None
        self._heard = time.monotonic()
        self._back, self._before = back, ""
        self._leaving = False
        self._taken = self._granted = (
            False  # whether the wheel must be handed back, and whether it was ours already
        )
        self._braked = self._moving = (
            False  # whether a brake must be told, and whether the last word was a velocity
        )
        self._asked = self._sent = (
            self._left
        ) = -math.inf  # when the wheel was asked for, a word said, the wheel left [s]
        self._fault = ""
        self._error: Exception | None = None
        self.handed_to = ""
        """Who is known to have got the wheel back."""
        self._follow()
        session.watch(SIMULATOR_NAME, self._see)
        session.announce()
        self._thread = threading.Thread(target=self._run, name="outrider-drive", daemon=True)

    def _see(self, _name: str, place: int, present: bool) -> None:
        (self._simulators.add if present else self._simulators.discard)(place)

    def start(self) -> None:
        """Begin to listen and to speak."""
        self._thread.start()

    def leave(self) -> None:
        """Ask for the end, the wheel handed back; may be called from a signal's handler."""
        self._leaving = True

    @property
    def leaving(self) -> bool:
        """Whether the end has been asked for."""
        return self._leaving

    @property
    def over(self) -> bool:
        """Whether all is handed back and nothing more is said."""
        return self._over.is_set()

    def wait(self, patience: float | None = None) -> bool:
        """Wait until all is handed back; whether it is.

        Raises:
            Exception: If the link has failed, with what.
        """
        done = self._over.wait(patience)
        if self._error is not None:
            raise self._error
        return done

    def press(self, heading: Heading) -> None:
        """Drive there for a moment; the first time, take the wheel."""
        self._do(lambda: self._wheel.press(heading, time.monotonic()))

    def brake(self) -> None:
        """Brake; also takes the wheel."""
        self._do(self._release)

    def faster(self, steps: int) -> None:
        """Set the speed higher by so many steps, or lower."""
        self._do(lambda: self._wheel.faster(steps))

    def hand_back(self) -> None:
        """Let the driver from before drive on."""
        self._do(self._return)

    def farewell(self) -> str:
        """How it ended, in a line."""
        if self.handed_to:
            return f"{self.vehicle} is handed back to {self.handed_to}"
        if self._left > self._asked:
            return f"{self.vehicle} was to be handed back to {self._heir()}; nobody has confirmed it yet"
        if self._taken:
            why = (
                "say --back DRIVER"
                if self._simulators and not self._heir()
                else "the simulator has gone"
            )
            return f"{self.vehicle} could not be handed back ({why}); it brakes without an operator"
        return f"{self.vehicle} was left to {self._driver() or 'its driver'}"

    def _do(self, deed: Callable[[], object]) -> None:
        with self._lock:
            deed()
        self._nudge.set()

    def _release(self) -> None:
        self._wheel.release()
        self._braked = True

    def view(self) -> View:
        """What is known now."""
        with self._lock:
            return View(
                status=self._status,
                truth=self._truth,
                coverage=self._map,
                age=time.monotonic() - self._heard,
                connected=self._session.connected,
                present=bool(self._simulators),
                driver=self._driver(),
                asked=self._taken and self._driver() != TELEOP,
                wanted=self._wheel.velocity(time.monotonic()),
                speed=self._wheel.speed,
                fault=self._fault,
            )

    def _run(self) -> None:
        try:
            while not self._leaving:
                with self._lock:
                    self._turn(time.monotonic())
                self._nudge.wait(_LOOK)
                self._nudge.clear()
            self._finish()
        except Exception as error:  # noqa: BLE001 - is raised where it can be told: in `wait`
            self._error = error
        finally:
            self._over.set()

    def _finish(self) -> None:
        """Hand the wheel back, and see it taken."""
        with self._lock:
            if not self._return():
                return
        limit = self._left + _SETTLE
        while time.monotonic() < limit and self._simulators and not self.handed_to:
            time.sleep(_LOOK / 2)
            with self._lock:
                self._read(time.monotonic())
                if self._heard > self._left and self._driver() == self._heir():
                    self.handed_to = self._driver()

    def _turn(self, now: float) -> None:
        self._read(now)
        wanted = self._wheel.velocity(now)
        if not self._simulators or self._status is None or self._status.over:
            self._wheel.release()
            self._braked = self._moving = (
                False  # nobody hears; the vehicle brakes when its operator is silent
            )
            return
        if wanted is not None or self._braked:
            self._take(now)
        if wanted is not None:
            if not self._moving or now - self._sent >= self._period():
                self._say(wanted, now)
        elif self._braked or self._moving:
            self._say(None, now)

    def _take(self, now: float) -> None:
        self._taken = True
        if self._driver() != TELEOP and now - self._asked >= _ASK_AGAIN:
            self._control(TELEOP)
            self._asked = now

    def _return(self) -> bool:
        """Hand the wheel back, if it was taken and there is somebody to take it; whether it was."""
        self._wheel.release()
        if not (self._taken and self._heir() and self._simulators):
            return False
        self._left = time.monotonic()
        self._say(None, self._left)
        self._control(self._heir())
        self._taken = self._granted = False
        self._asked = -math.inf
        return True

    def _heir(self) -> str:
        return self._back or self._before

    def _read(self, now: float) -> None:
        try:
            status, truth, coverage = (
                _newest(inbox) for inbox in (self._statuses, self._truths, self._maps)
            )
        except BusError as error:
            self._fault = str(error)
            return
        if isinstance(truth, Truth):
            self._truth = truth
        if isinstance(coverage, CoverageMap):
            self._map = coverage
        if isinstance(status, Status):
            self._status, self._heard = status, now
            self._follow()

    def _follow(self) -> None:
        """Keep up with who is at the wheel: somebody else may take it, and a simulator may be started anew."""
        driver = self._driver()
        if driver == TELEOP:
            self._granted = self._taken
            self._before = self._before or self._last_driver()
        elif driver:
            self._before = driver
            self._taken = self._taken and not self._granted
            self._granted = False

    def _last_driver(self) -> str:
        """Who drove before an operator who has not handed the wheel back, as far as the status still tells."""
        changes = () if self._status is None else self._status.changes
        mine = [
            change.control.driver
            for change in changes
            if change.control.vehicle in (None, self.vehicle)
        ]
        return next((driver for driver in reversed(mine) if driver and driver != TELEOP), "")

    def _driver(self) -> str:
        return "" if self._status is None else self._status.drivers.get(self.vehicle, "")

    def _period(self) -> float:
        """So often that a word still counts when the next one comes, whatever the pace of simulated time."""
        factor = self._status.realtime_factor if self._status is not None else 1.0
        return min(max(_HOLD / 3.0 / max(factor, 1e-3), _SEND_FASTEST), _SEND)

    def _control(self, driver: str) -> None:
        self._send(
            lambda: self._controls.send(
                Control(action=Action.DRIVER, vehicle=self.vehicle, driver=driver)
            )
        )

    def _say(self, velocity: tuple[float, float] | None, now: float) -> None:
        self._send(
            lambda: self._drives.send(Drive(driver=self._session.party.name, velocity=velocity))
        )
        self._sent, self._moving, self._braked = now, velocity is not None, False

    def _send(self, deed: Callable[[], None]) -> None:
        try:
            deed()
            self._fault = ""
        except (BusError, ValueError) as error:
            self._fault = str(error)
