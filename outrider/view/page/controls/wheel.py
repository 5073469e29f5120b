"""The wheel of a UGV, shared by browsers: one at a time holds it, and one that falls silent loses it."""

import math
import time
from collections.abc import Callable, Mapping

from bus.messages import Control, Drive, Limits, Vector
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
        self, control: Callable[[Control], bool], drive: Callable[[str, Drive], bool]
    ) -> None:
        self._helm = Helm(control, drive)
        self._taken = self._alive = self._sent = 0.0
        self.holder = 0
        """The browser that holds it; 0: none."""
        self.name = ""
        self.vehicle = ""
        self.share = 1.0
        """Of the vehicle's largest speed, at full deflection."""
        self.limits: Mapping[str, Limits] = {}
        """The vehicles' bounds, where they are known."""

    def top(self, vehicle: str) -> float:
        """The largest speed that can be asked of a vehicle [m/s]."""
        known = self.limits.get(vehicle)
        return _UNBOUNDED if known is None or known.max_speed is None else known.max_speed

    @property
    def full(self) -> float:
        """Speed of the vehicle that is driven at full deflection [m/s]."""
        return self.share * self.top(self.vehicle)

    def take(self, browser: int, name: str, vehicle: str, drivers: Mapping[str, str]) -> bool:
        """Sit down at a vehicle's wheel; False if somebody sits there."""
        if self.holder not in (0, browser) or not vehicle:
            return False
        if not self._helm.take(vehicle, drivers.get(vehicle, "")):
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

    def hand_back(self, browser: int, drivers: Mapping[str, str]) -> None:
        """Let the driver from before drive on; anybody may, once nobody holds the wheel."""
        if self.holder not in (0, browser):
            return
        self.release()
        for vehicle in self._helm.waiting(drivers):
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

    def check(self, drivers: Mapping[str, str]) -> None:
        """Free the wheel of a browser that has fallen silent, or whose vehicle has got another driver."""
        now = time.monotonic()
        replaced = (
            drivers.get(self.vehicle, "") not in ("", TELEOP) and now - self._taken > _SETTLING
        )
        if self.holder and (replaced or now - self._alive > _PATIENCE):
            self.release()

    def can_be_handed_back(self, drivers: Mapping[str, str]) -> bool:
        """True if a driver from before waits for the wheel."""
        return bool(self._helm.waiting(drivers))

    def strangers(self, drivers: Mapping[str, str]) -> list[str]:
        """The UGVs that obey an operator who is none of ours: another one may drive them."""
        ours = {*self._helm.waiting(drivers), self.vehicle if self.holder else ""}
        return [name for name, driver in drivers.items() if driver == TELEOP and name not in ours]
