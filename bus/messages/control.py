"""Run controls of the operator."""

from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from bus.messages.base import Message, Name, Seed, Text, Tick
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from bus.messages.team import Request


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
    REQUEST = "request"


class Control(Message, frozen=True, kw_only=True):
    """Request of an operator to the simulator; takes effect at the next tick. Each action reads its own fields only."""

    action: Action
    """Kind of the request."""
    ticks: Annotated[int, Meta(ge=1, le=1_000_000)] = 1
    """STEP: number of ticks."""
    factor: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    """SPEED: simulated seconds per second of wall time [1]; None: lockstep, as fast as possible."""
    seed: Seed | None = None
    """RESET: seed of the new flight; None: the same seed."""
    law: Law | None = None
    """LAW: new control law of the UAVs."""
    vehicle: Name | None = None
    """DRIVER: the UGV; LINK: the vehicle; None: all. REQUEST: the UAV."""
    driver: Name | None = None
    """DRIVER: new driver."""
    operator: Name | None = None
    """DRIVER: name of the operator whose input the driver follows."""
    link: LinkKind | None = None
    """LINK: kind of the link."""
    settings: LinkSettings | None = None
    """LINK: new settings."""
    request: Request | None = None
    """REQUEST: request to a UAV of a team."""

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
            case Action.REQUEST:
                return f"request {self.request} to {self.vehicle}"
            case Action.SPEED:
                factor = self.factor
                return "lockstep" if factor is None else f"{factor:g} times real time"
            case Action.STEP:
                return f"step {self.ticks}"
            case _:
                return str(self.action)


class Change(Message, frozen=True, kw_only=True):
    """Control that has taken effect."""

    tick: Tick
    """Tick at which it took effect."""
    control: Control
    """The control."""


class Rejection(Message, frozen=True, kw_only=True):
    """Control that was rejected."""

    tick: Tick
    """Tick at which it was rejected."""
    action: Action
    """Kind of the request."""
    reason: Text
    """Field, value, and what is allowed."""

    @property
    def text(self) -> str:
        """Return the rejection as one line."""
        return f"tick {self.tick}: {self.action} rejected: {self.reason}"
