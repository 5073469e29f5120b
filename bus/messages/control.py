"""The operator's controls of a run."""

from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from bus.messages.base import Message, Name, Tick
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law


class Action(StrEnum):
    """The actions of a `Control`."""

    PAUSE = "pause"
    RESUME = "resume"
    STEP = "step"
    SPEED = "speed"
    RESET = "reset"
    LAW = "law"
    DRIVER = "driver"
    LINK = "link"


class Control(Message, frozen=True, kw_only=True):
    """An operator's request to the simulator; takes effect at the next tick. Only the fields of its action count."""

    action: Action
    ticks: Annotated[int, Meta(ge=1, le=1_000_000)] = 1
    """STEP: how far."""
    factor: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    """SPEED: simulated seconds per second of wall time; None: lockstep, as fast as it goes."""
    seed: Tick | None = None
    """RESET: of the new flight; None: the same again."""
    law: Law | None = None
    """LAW: what the UAVs fly."""
    vehicle: Name | None = None
    """DRIVER: which UGV; LINK: whose. None: every one."""
    driver: Name | None = None
    """DRIVER: who takes its wheel."""
    operator: Name | None = None
    """DRIVER: the operator who takes it, where the driver obeys one; each has a name of its own."""
    link: LinkKind | None = None
    """LINK: which."""
    settings: LinkSettings | None = None
    """LINK: what it does to messages from now on."""

    def in_words(self) -> str:
        """Tells a person what was asked for."""
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
    """A control that has taken effect, and when."""

    tick: Tick
    control: Control
