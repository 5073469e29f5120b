"""Teleoperation of a UGV, shared by browsers: one at a time has control, and loses it when it falls silent."""

import math
import time
from collections.abc import Callable

from bus.messages.base import Vector
from bus.messages.control import Control
from bus.messages.telemetry import Status
from bus.messages.vehicle import Teleoperation
from bus.registry import TELEOP
from outrider.view.operator import Helm

_TIMEOUT = 3.0
"""Time without a message after which a browser loses control [s]."""
_DRIVER_CHANGE_TIME = 2.0
"""Maximum time in which the simulator changes the driver [s]."""
_UNBOUNDED = 1.0
"""Maximum speed of a vehicle without a known bound [m/s]."""
_MIN_PERIOD = 0.04
"""Minimum wall time between two commands to the vehicle [s]."""


class SharedTeleoperation:
    """Control of a UGV by one browser at a time.

    Args:
        control: Sends a command to the simulator.
        drive: Sends a velocity to a UGV, by name.
    """

    def __init__(
        self, control: Callable[[Control], bool], drive: Callable[[str, Teleoperation], bool]
    ) -> None:
        self._helm = Helm(control, drive)
        self._taken = self._alive = self._sent = 0.0
        self.holder = 0
        """Number of the browser that has control; 0: none."""
        self.name = ""
        """Name of this browser; empty: none."""
        self.vehicle = ""
        """Vehicle controlled last; empty: none yet."""
        self.speed_share = 1.0
        """Speed at full deflection, as a share of the vehicle's maximum speed."""
        self._status: Status | None = None
        self._drivers: dict[str, str] = {}  # last driver of each UGV other than an operator

    def update(self, status: Status) -> None:
        """Update the drivers and the vehicles' bounds."""
        self._status = status
        self._drivers |= {name: one for name, one in status.drivers.items() if one != TELEOP}

    def max_speed(self, vehicle: str) -> float:
        """Return the maximum speed of a vehicle [m/s]."""
        geometry = None if self._status is None else self._status.geometry
        known = None if geometry is None else geometry.limits.get(vehicle)
        return _UNBOUNDED if known is None or known.max_speed is None else known.max_speed

    @property
    def full_speed(self) -> float:
        """Speed of the controlled vehicle at full deflection [m/s]."""
        return self.speed_share * self.max_speed(self.vehicle)

    def take_control(self, browser: int, name: str, vehicle: str) -> bool:
        """Give a browser control of a vehicle; return False if another browser has it or the run is over."""
        over = self._status is not None and self._status.over
        if self.holder not in (0, browser) or not vehicle or over:
            return False
        if not self._helm.take(vehicle, self._drivers.get(vehicle, "")):
            return False
        self.holder, self.name, self.vehicle = browser, name, vehicle
        self._taken = self._alive = time.monotonic()
        return True

    def steer(self, browser: int, deflection: Vector | None) -> None:
        """Send the velocity for a deflection, as a share of the full speed; None: brake."""
        if browser != self.holder:
            return
        now = time.monotonic()
        if deflection is not None and now - self._sent < _MIN_PERIOD:
            return
        self._sent = now
        velocity: Vector | None = None
        if deflection is not None and all(map(math.isfinite, deflection)):
            x, y = deflection
            scale = self.full_speed / max(math.hypot(x, y), 1.0)
            velocity = (x * scale, y * scale)
        self._helm.steer(self.vehicle, Teleoperation(operator=self.name, velocity=velocity))

    def hand_back(self, browser: int) -> None:
        """Return control to the previous driver; any browser may do so if no other has control."""
        if self.holder not in (0, browser):
            return
        self.release()
        for vehicle in self._helm.waiting(self._status):
            self._helm.hand_back(vehicle)

    def release(self) -> None:
        """Brake the vehicle and release control."""
        if self.holder:
            self._helm.steer(self.vehicle, Teleoperation(operator=self.name))
            self.holder, self.name = 0, ""

    def leave(self, browser: int) -> None:
        """Release control if a disconnected browser had it."""
        if browser == self.holder:
            self.release()

    def mark_alive(self, browser: int) -> None:
        """Restart the timeout of a browser after a message from it."""
        if browser == self.holder:
            self._alive = time.monotonic()

    def check(self) -> None:
        """Release control if its browser is silent or the vehicle has another driver."""
        now = time.monotonic()
        if self.holder and self._replaced() and now - self._taken > _DRIVER_CHANGE_TIME:
            self.holder, self.name = 0, ""  # do not brake the new driver
        if self.holder and now - self._alive > _TIMEOUT:
            self.release()

    def _replaced(self) -> bool:
        driver = "" if self._status is None else self._status.drivers.get(self.vehicle, "")
        other = driver not in ("", TELEOP)
        return other or self._helm.displaced(self._status, self.vehicle)

    def can_be_handed_back(self) -> bool:
        """Return True if control can be returned to a previous driver."""
        return bool(self._helm.waiting(self._status))

    def other_operators(self) -> list[str]:
        """Return the UGVs controlled by an operator outside this page."""
        drivers = {} if self._status is None else self._status.drivers
        ours = {*self._helm.waiting(self._status), self.vehicle if self.holder else ""}
        return [name for name, driver in drivers.items() if driver == TELEOP and name not in ours]
