"""The wheel of a UGV, shared by browsers: one at a time holds it, and one that falls silent loses it."""

import math
import time
from collections.abc import Callable

from bus.messages.base import Vector
from bus.messages.control import Control
from bus.messages.telemetry import Status
from bus.messages.vehicle import Teleoperation
from bus.registry import TELEOP
from outrider.view.operator import Helm

_PATIENCE = 3.0
"""So long a browser at the wheel may be silent [s]."""
_SETTLING = 2.0
"""So long the simulator may take to change the driver [s]."""
_UNBOUNDED = 1.0
"""The largest speed of a vehicle that has no bound, or none that is known [m/s]."""
_GAP = 0.04
"""Wall time between two words to the vehicle at least [s]."""


class SharedWheel:
    """Gives the wheel to one browser, and sends what it wants.

    Args:
        control: Says something to the simulator.
        drive: Says something to a UGV: its name, and what is wanted.
    """

    def __init__(
        self, control: Callable[[Control], bool], drive: Callable[[str, Teleoperation], bool]
    ) -> None:
        self._helm = Helm(control, drive)
        self._taken = self._alive = self._sent = 0.0
        self.holder = 0
        """The browser that holds it; 0: none."""
        self.name = ""
        self.vehicle = ""
        self.share = 1.0
        """Of the vehicle's largest speed, at full deflection."""
        self._status: Status | None = None
        self._drivers: dict[str, str] = {}  # the last one of each UGV that was no operator

    def follow(self, status: Status) -> None:
        """Update who drives, and the vehicles' bounds."""
        self._status = status
        self._drivers |= {name: one for name, one in status.drivers.items() if one != TELEOP}

    def top(self, vehicle: str) -> float:
        """The largest speed that can be asked of a vehicle [m/s]."""
        geometry = None if self._status is None else self._status.geometry
        known = None if geometry is None else geometry.limits.get(vehicle)
        return _UNBOUNDED if known is None or known.max_speed is None else known.max_speed

    @property
    def full(self) -> float:
        """Speed of the vehicle that is driven at full deflection [m/s]."""
        return self.share * self.top(self.vehicle)

    def take(self, browser: int, name: str, vehicle: str) -> bool:
        """Sit down at a vehicle's wheel; False if another browser sits there, or the run is over."""
        over = self._status is not None and self._status.over
        if self.holder not in (0, browser) or not vehicle or over:
            return False
        if not self._helm.take(vehicle, self._drivers.get(vehicle, "")):
            return False
        self.holder, self.name, self.vehicle = browser, name, vehicle
        self._taken = self._alive = time.monotonic()
        return True

    def steer(self, browser: int, deflection: Vector | None) -> None:
        """Send what the hand at the wheel does: where to, as a share of the full speed; None is to brake."""
        if browser != self.holder:
            return
        now = time.monotonic()
        if deflection is not None and now - self._sent < _GAP:
            return
        self._sent = now
        velocity: Vector | None = None
        if deflection is not None and all(map(math.isfinite, deflection)):
            x, y = deflection
            scale = self.full / max(math.hypot(x, y), 1.0)
            velocity = (x * scale, y * scale)
        self._helm.steer(self.vehicle, self.name, velocity)

    def hand_back(self, browser: int) -> None:
        """Let the driver from before drive on; anybody may, once nobody holds the wheel."""
        if self.holder not in (0, browser):
            return
        self.release()
        for vehicle in self._helm.waiting(self._status):
            self._helm.hand_back(vehicle)

    def release(self) -> None:
        """Take the hand off: the vehicle brakes, and the wheel is free."""
        if self.holder:
            self._helm.steer(self.vehicle, self.name, None)
            self.holder, self.name = 0, ""

    def leave(self, browser: int) -> None:
        """Free the wheel of a browser that has gone."""
        if browser == self.holder:
            self.release()

    def keep(self, browser: int) -> None:
        """Note that a browser has given a sign of life."""
        if browser == self.holder:
            self._alive = time.monotonic()

    def check(self) -> None:
        """Free the wheel of a browser that has fallen silent, or whose vehicle has got another driver."""
        now = time.monotonic()
        if self.holder and self._replaced() and now - self._taken > _SETTLING:
            self.holder, self.name = 0, ""  # who drives now is not braked
        if self.holder and now - self._alive > _PATIENCE:
            self.release()

    def _replaced(self) -> bool:
        driver = "" if self._status is None else self._status.drivers.get(self.vehicle, "")
        other = driver not in ("", TELEOP)
        return other or self._helm.displaced(self._status, self.vehicle)

    def can_be_handed_back(self) -> bool:
        """True if a driver from before waits for the wheel."""
        return bool(self._helm.waiting(self._status))

    def strangers(self) -> list[str]:
        """The UGVs that obey an operator who is none of ours: another one may drive them."""
        drivers = {} if self._status is None else self._status.drivers
        ours = {*self._helm.waiting(self._status), self.vehicle if self.holder else ""}
        return [name for name, driver in drivers.items() if driver == TELEOP and name not in ours]
