"""Run controls of the operator."""

from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from bus.messages.base import Message, Name, Tick
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law


class Action(StrEnum):
    """Action of a `Control`."""

    PAUSE = "pause"
    RESUME = "resume"
    STEP = "step"
    SPEED = "speed"
    RESET = "reset"
    LAW = "law"
    DRIVER = "driver"
    LINK = "link"


class Control(Message, frozen=True, kw_only=True):
    """Request from an operator to the simulator; it takes effect at the next tick.

    Only the fields of its action are read.
    """

    action: Action
    ticks: Annotated[int, Meta(ge=1, le=1_000_000)] = 1
    """STEP: number of ticks to advance."""
    factor: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    """SPEED: simulated seconds per second of wall time; None: lockstep, as fast as possible."""
    seed: Tick | None = None
    """RESET: seed of the new run; None: the same seed again."""
    law: Law | None = None
    """LAW: control law for the UAVs."""
    vehicle: Name | None = None
    """DRIVER: the UGV; LINK: the vehicle. None: all of them."""
    driver: Name | None = None
    """DRIVER: new driver."""
    operator: Name | None = None
    """DRIVER: name of the operator who takes control, for a driver that follows an operator. Each operator has a unique
    name.
    """
    link: LinkKind | None = None
    """LINK: kind of link."""
    settings: LinkSettings | None = None
    """LINK: new settings of the link."""

    def in_words(self) -> str:
        """Return a short description of the request for the user."""
        match self.action:
            case Action.LAW if self.law is not None:
                return f"law {self.law.name}"
            case Action.DRIVER:
                return f"driver {self.driver} in {self.vehicle or 'every UGV'}"
            case Action.LINK:
                settings = self.settings or LinkSettings()
                changed = [f"{name} {value}" for name, value in settings.changes().items()]
                whose = self.vehicle or "every vehicle"
                return f"link {self.link} of {whose}: {', '.join(changed) or 'perfect'}"
            case Action.SPEED:
                factor = self.factor
                return "lockstep" if factor is None else f"{factor:g} times real time"
            case Action.STEP:
                return f"step {self.ticks}"
            case _:
                return str(self.action)


class Change(Message, frozen=True, kw_only=True):
    """Control that has taken effect, and its tick."""

    tick: Tick
    control: Control
