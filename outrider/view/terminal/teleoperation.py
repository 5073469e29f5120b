"""Teleoperation of one UGV: a thread between keys and bus, so that a slow terminal never holds up a brake."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.registry import TELEOP
from bus.session import Session
from outrider.view.operator import Helm, RunClient
from outrider.view.terminal.pressed_keys import FIRST, REPEAT, Heading, PressedKeys
from sim.scene.model import Scene, observed_scene

_LOOK = 0.05
"""Time between two looks at the bus [s]."""
_SEND, _SEND_FASTEST = 0.1, 0.02
"""Time between two messages to the vehicle [s], in real time and at most."""
_HOLD = 0.5
"""The time for which a message counts for a vehicle [s], simulated, unless the scenario says otherwise."""
_ASK_AGAIN = 1.0
"""Time after which a control that shows no effect is sent anew [s]."""
_SETTLE = 1.5
"""The longest wait for the hand-back [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveView:
    """All that is known of a run at one moment."""

    status: Status | None = None
    truth: Truth | None = None
    coverage: CoverageMap | None = None
    ground: GroundMap | None = None
    age: float = 0.0
    """Time since the simulator has told something [s]."""
    factor: float = 0.0
    """Simulated seconds per second of wall time, lately."""
    connected: bool = True
    present: bool = True
    """True if the simulator is there."""
    driver: str = ""
    """The UGV's driver."""
    mine: bool = False
    """True if it obeys this terminal."""
    asked: bool = False
    """True if the wheel has been asked for and not been given yet."""
    wanted: tuple[float, float] | None = None
    """The velocity that is wanted [m/s]."""
    speed: float = 0.0
    """The speed that a pressed key asks for [m/s]."""
    fault: str = ""

    @property
    def scene(self) -> Scene | None:
        """The map's scene; None before it is known."""
        if self.status is None or self.status.geometry is None or self.truth is None:
            return None
        geometry, vehicles = self.status.geometry, self.truth.vehicles
        return observed_scene(
            self.status.scenario, geometry, escorts=geometry.uavs, vehicles=vehicles
        )


def ugvs_of(status: Status) -> tuple[str, ...]:
    """The UGVs of a run, as far as its status tells."""
    escorted = () if status.geometry is None else status.geometry.uavs.values()
    return tuple(sorted({*status.drivers, *escorted}))


class DriveLink:
    """Drives one UGV over the bus.

    Args:
        session: The operator's.
        vehicle: Which UGV.
        speed: How fast a pressed key drives [m/s].
        back: Who gets the wheel in the end; empty: who had it before.
        status: The first one.
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
        """True if the end has been asked for."""
        # Whether the wheel must be handed back, and whether it was ours already.
        self._taken = self._granted = False
        # Whether a brake must be sent, and whether the last message was a velocity.
        self._braked = self._moving = False
        self._asked = self._sent = -math.inf  # when the wheel was asked for, a message sent [s]
        self._keys_from = -math.inf  # from when on keys count [s]
        self._error: Exception | None = None
        self.handed_to = ""
        """Returns the driver that is known to have got the wheel back."""
        self._follow()
        session.announce()
        self._thread = threading.Thread(target=self._run, name="outrider-drive", daemon=True)

    def start(self) -> None:
        """Begin to read and to send."""
        self._thread.start()

    def leave(self) -> None:
        """Ask for the end, the wheel handed back; may be called from a signal's handler."""
        self.leaving = True

    @property
    def over(self) -> bool:
        """True if all is handed back and nothing more is sent."""
        return self._over.is_set()

    def wait(self, patience: float | None = None) -> bool:
        """Wait until all is handed back; whether it is.

        Raises:
            Exception: If the thread has failed, with what.
        """
        done = self._over.wait(patience)
        if self._error is not None:
            raise self._error
        return done

    def press(self, heading: Heading) -> None:
        """Drive there for a moment; the first time, take the wheel."""
        self._do(lambda: self._press(heading, time.monotonic()))

    def brake(self) -> None:
        """Brake; also takes the wheel."""
        self._do(self._release)

    def faster(self, steps: int) -> None:
        """Set the speed higher by so many steps, or lower."""
        self._do(lambda: self._keys.faster(steps))

    def hand_back(self) -> None:
        """Let the driver from before drive on."""
        self._do(self._return)

    def farewell(self) -> str:
        """A line that tells how it ended."""
        ugv = self.vehicle
        if self.handed_to:
            return f"{ugv} is handed back to {self.handed_to}"
        if self._heir:
            return f"{ugv} was to be handed back to {self._heir}; nobody has confirmed it yet"
        if self._taken:
            unknown = self._client.simulator.there and not (self._back or self._before)
            why = "say --back DRIVER" if unknown else "the simulator has gone"
            return f"{ugv} could not be handed back ({why}); it brakes without an operator"
        if self._driver == TELEOP:
            return f"{ugv} was left to another operator"
        return f"{ugv} was left to {self._driver or 'its driver'}"

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
        """All that is known now."""
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
                self._nudge.wait(_LOOK)
                self._nudge.clear()
            self._finish()
        except Exception as error:  # noqa: BLE001 - is raised where it can be told: in `wait`
            self._error = error
        finally:
            self._client.close()
            self._over.set()

    def _finish(self) -> None:
        """Hand the wheel back, and see it taken."""
        with self._lock:
            self._return()
            if not self._heir:
                return
        limit = time.monotonic() + _SETTLE
        while time.monotonic() < limit and self._client.simulator.there and not self.handed_to:
            time.sleep(_LOOK / 2)
            with self._lock:
                self._read()

    def _turn(self, now: float) -> None:
        self._read()
        wanted, status = self._keys.velocity(now), self._client.status
        if not self._client.simulator.there or status is None or status.over:
            self._keys.release()
            # Nobody listens; the vehicle brakes when its operator is silent.
            self._braked = self._moving = False
            return
        if wanted is not None or self._braked:
            self._take(now)
        if wanted is not None:
            if not self._moving or now - self._sent >= self._period(status):
                self._steer(wanted, now)
        elif self._braked or self._moving:
            self._steer(None, now)

    def _take(self, now: float) -> None:
        self._taken, self._heir, self.handed_to = True, "", ""
        if not self._mine and now - self._asked >= _ASK_AGAIN:
            self._helm.take(self.vehicle, self._driver)
            self._asked = now

    def _return(self) -> None:
        """Hand the wheel back, if it was taken and there is somebody to take it."""
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
        """Keep up with who drives: somebody else may take the wheel, and a simulator may be started anew."""
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
        """Leave the wheel to another driver: a key that is still held does not take it back."""
        self._keys.release()
        self._taken = self._granted = self._braked = self._moving = False
        self._asked = -math.inf
        self._keys_from = now + FIRST if held else -math.inf

    def _last_driver(self) -> str:
        """The driver before an operator who has not handed the wheel back, as far as the status still tells."""
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
        """So often that a message still counts when the next one comes, whatever the pace of simulated time."""
        return min(max(_HOLD / 3.0 / max(status.realtime_factor, 1e-3), _SEND_FASTEST), _SEND)

    def _steer(self, velocity: tuple[float, float] | None, now: float) -> None:
        self._helm.steer(self.vehicle, self._client.name, velocity)
        self._sent, self._moving, self._braked = now, velocity is not None, False
