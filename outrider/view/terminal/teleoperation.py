"""Teleoperation of one UGV: a thread between keys and bus, so that a slow terminal never delays braking."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from bus.messages.ground import GroundMap
from bus.messages.team import Request
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from bus.registry import TELEOP
from bus.session import Session
from outrider.view.operator import Helm, RunClient, request_of
from outrider.view.terminal.pressed_keys import FIRST, REPEAT, Heading, PressedKeys
from sim.scene.model import Scene, observed_scene

_POLL = 0.05
"""Time between two checks of the bus [s]."""
_SEND, _SEND_FASTEST = 0.1, 0.02
"""Time between two commands to the vehicle [s]: at real time, and the shortest."""
_COMMAND_TIMEOUT = 0.5
"""Simulated time for which a command stays in effect [s], by default."""
_ASK_AGAIN = 1.0
"""Time after which a request without effect is repeated [s]."""
_SETTLE = 1.5
"""Longest wait for the transfer of control at the end [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveView:
    """State of a run, as known to the operator."""

    status: Status | None = None
    truth: Truth | None = None
    coverage: CoverageMap | None = None
    ground: GroundMap | None = None
    age: float = 0.0
    """Time since the simulator's last message [s]."""
    factor: float = 0.0
    """Simulated seconds per second of wall time, recently."""
    connected: bool = True
    present: bool = True
    """True if the simulator is connected."""
    driver: str = ""
    """Current driver of the UGV."""
    mine: bool = False
    """True if this terminal controls the UGV."""
    asked: bool = False
    """True if control was requested but not granted yet."""
    wanted: tuple[float, float] | None = None
    """Desired velocity [m/s]; None: none."""
    speed: float = 0.0
    """Speed of a pressed key [m/s]."""
    fault: str = ""

    @property
    def scene(self) -> Scene | None:
        """Scene of the map; None before the first messages."""
        if self.status is None or self.status.geometry is None or self.truth is None:
            return None
        geometry, vehicles = self.status.geometry, self.truth.vehicles
        return observed_scene(
            self.status.scenario, geometry, escorts=geometry.uavs, vehicles=vehicles
        )


def ugvs_of(status: Status) -> tuple[str, ...]:
    """Return the UGVs named in a run's status."""
    escorted = () if status.geometry is None else status.geometry.uavs.values()
    return tuple(sorted({*status.drivers, *escorted}))


class DriveLink:
    """Link that drives one UGV over the bus.

    Args:
        session: Session of the operator.
        vehicle: Name of the UGV.
        speed: Speed of a pressed key [m/s].
        back: Driver that receives control at the end; empty: the previous driver.
        status: First status.
    """

    def __init__(
        self,
        session: Session,
        vehicle: str,
        *,
        speed: float,
        back: str = "",
        status: Status,
    ) -> None:
        self.vehicle = vehicle
        self._client = RunClient(session, status)
        self._helm = Helm(self._client.control, self._client.drive)
        self._keys = PressedKeys(speed)
        self._lock = threading.Lock()
        self._nudge, self._over = threading.Event(), threading.Event()
        self._back, self._before, self._heir = back, "", ""
        self.leaving = False
        """True after a request to quit."""
        # True if control must be returned, and if it was granted already.
        self._taken = self._granted = False
        # True if a brake command must be sent, and if the last command was a velocity.
        self._braked = self._moving = False
        self._asked = self._sent = -math.inf  # times of the last request and command [s]
        self._keys_from = -math.inf  # time from which on keys count [s]
        self._error: Exception | None = None
        self.handed_to = ""
        """Driver that has confirmed control; empty: none."""
        self._follow()
        session.announce()
        self._thread = threading.Thread(target=self._run, name="outrider-drive", daemon=True)

    def start(self) -> None:
        """Start to read and to send."""
        self._thread.start()

    def leave(self) -> None:
        """Request to return control and quit; may be called from a signal handler."""
        self.leaving = True

    @property
    def over(self) -> bool:
        """True if control is returned and nothing more is sent."""
        return self._over.is_set()

    def wait(self, patience: float | None = None) -> bool:
        """Wait until control is returned; return false after a timeout.

        Raises:
            Exception: If the thread has failed; the thread's error.
        """
        done = self._over.wait(patience)
        if self._error is not None:
            raise self._error
        return done

    def press(self, heading: Heading) -> None:
        """Drive in a direction for a moment; the first call takes control."""
        self._do(lambda: self._press(heading, time.monotonic()))

    def brake(self) -> None:
        """Brake; the first call takes control."""
        self._do(self._release)

    def faster(self, steps: int) -> None:
        """Increase the speed by a number of steps; negative: reduce it."""
        self._do(lambda: self._keys.faster(steps))

    def hand_back(self) -> None:
        """Return control to the previous driver."""
        self._do(self._return)

    def request(self, request: Request) -> None:
        """Call or relieve a UAV of the UGV's team, see `request_of`."""
        control = request_of(self._client.status, self.vehicle, request)
        if control is not None:
            self._client.control(control)

    def farewell(self) -> str:
        """Describe in one line which driver controls the UGV at the end."""
        ugv = self.vehicle
        if self.handed_to:
            return f"{ugv}: control returned to {self.handed_to}"
        if self._heir:
            return f"{ugv}: control offered to {self._heir}, not confirmed yet"
        if self._taken:
            unknown = self._client.simulator.there and not (self._back or self._before)
            why = "name a driver with --back" if unknown else "the simulator disconnected"
            return f"{ugv}: control not returned ({why}); the UGV brakes without an operator"
        if self._driver == TELEOP:
            return f"{ugv}: another operator drives"
        return f"{ugv}: {self._driver or 'its driver'} drives"

    def _do(self, change: Callable[[], object]) -> None:
        with self._lock:
            change()
        self._nudge.set()

    def _press(self, heading: Heading, now: float) -> None:
        if now < self._keys_from:
            self._keys_from = max(self._keys_from, now + REPEAT)
        else:
            self._keys.press(heading, now)

    def _release(self) -> None:
        self._keys.release()
        self._braked = True

    def view(self) -> DriveView:
        """Return the current state."""
        with self._lock:
            client = self._client
            return DriveView(
                status=client.status,
                truth=client.truth,
                coverage=client.coverage,
                ground=client.ground,
                age=client.age,
                factor=client.factor,
                connected=client.connected,
                present=client.simulator.there,
                driver=self._driver,
                mine=self._mine,
                asked=self._taken and not self._mine,
                wanted=self._keys.velocity(time.monotonic()),
                speed=self._keys.speed,
                fault=client.fault,
            )

    def _run(self) -> None:
        try:
            while not self.leaving:
                with self._lock:
                    self._turn(time.monotonic())
                self._nudge.wait(_POLL)
                self._nudge.clear()
            self._finish()
        except Exception as error:  # noqa: BLE001 - raised in `wait`, where it can be reported
            self._error = error
        finally:
            self._client.close()
            self._over.set()

    def _finish(self) -> None:
        """Return control, and wait for the confirmation."""
        with self._lock:
            self._return()
            if not self._heir:
                return
        limit = time.monotonic() + _SETTLE
        while time.monotonic() < limit and self._client.simulator.there and not self.handed_to:
            time.sleep(_POLL / 2)
            with self._lock:
                self._read()

    def _turn(self, now: float) -> None:
        self._read()
        wanted, status = self._keys.velocity(now), self._client.status
        if not self._client.simulator.there or status is None or status.over:
            self._keys.release()
            # No simulator receives commands; the vehicle brakes when its operator is silent.
            self._braked = self._moving = False
            return
        if wanted is not None or self._braked:
            self._request(now)
        if wanted is not None:
            if not self._moving or now - self._sent >= self._period(status):
                self._steer(wanted, now)
        elif self._braked or self._moving:
            self._steer(None, now)

    def _request(self, now: float) -> None:
        self._taken, self._heir, self.handed_to = True, "", ""
        if not self._mine and now - self._asked >= _ASK_AGAIN:
            self._helm.take(self.vehicle, self._driver)
            self._asked = now

    def _return(self) -> None:
        """Return control if it was taken and a driver is known."""
        self._keys.release()
        heir = self._back or self._before
        if not (self._taken and heir and self._client.simulator.there):
            return
        self._steer(None, time.monotonic())
        self._heir = self._helm.hand_back(self.vehicle, heir)
        self._taken = self._granted = False
        self._asked = -math.inf

    def _read(self) -> None:
        for message in self._client.news():
            if isinstance(message, Status):
                self._follow()

    def _follow(self) -> None:
        """Update the current driver: another operator may take control, and the simulator may restart."""
        driver, now = self._driver, time.monotonic()
        if driver == TELEOP:
            self._before = self._before or self._last_driver()
        elif driver:
            self.handed_to = driver if driver == self._heir else self.handed_to
            self._before = driver
        wanted = self._keys.velocity(now) is not None
        if self._mine:
            self._taken = self._granted = not self._heir
        elif driver and self._granted:
            self._lose(now, held=wanted)
        elif driver == TELEOP and self._taken and not wanted and now - self._asked > _ASK_AGAIN:
            self._lose(now, held=False)

    def _lose(self, now: float, *, held: bool) -> None:
        """Leave control to another driver; a key that is still held does not take it back."""
        self._keys.release()
        self._taken = self._granted = self._braked = self._moving = False
        self._asked = -math.inf
        self._keys_from = now + FIRST if held else -math.inf

    def _last_driver(self) -> str:
        """Return the last driver before teleoperation in the status's changes; empty if unknown."""
        status = self._client.status
        controls = [change.control for change in status.changes] if status is not None else []
        found = [one.driver for one in controls if one.vehicle in (None, self.vehicle)]
        return next((driver for driver in reversed(found) if driver and driver != TELEOP), "")

    @property
    def _mine(self) -> bool:
        return self._helm.holds(self._client.status, self.vehicle)

    @property
    def _driver(self) -> str:
        status = self._client.status
        return "" if status is None else status.drivers.get(self.vehicle, "")

    @staticmethod
    def _period(status: Status) -> float:
        """Return the time between commands [s], so that each is still in effect when the next arrives."""
        return min(
            max(_COMMAND_TIMEOUT / 3.0 / max(status.realtime_factor, 1e-3), _SEND_FASTEST), _SEND
        )

    def _steer(self, velocity: tuple[float, float] | None, now: float) -> None:
        self._helm.steer(self.vehicle, Teleoperation(operator=self._client.name, velocity=velocity))
        self._sent, self._moving, self._braked = now, velocity is not None, False
