"""A radio link: its settings and its counters."""

from enum import StrEnum
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Seconds, Share, Text, Tick


class LinkKind(StrEnum):
    """The kinds of messages that cross a link."""

    DETECTIONS = "detections"
    """From a UAV's detector to its computer."""
    COMMANDS = "commands"
    """From a vehicle's computer to its actuators."""
    OPERATOR = "operator"
    """From an operator to a UGV."""
    RADIO = "radio"
    """From a UAV to the UGV it escorts."""


class LinkSettings(Message, frozen=True, kw_only=True):
    """The settings of one link, all that it does to messages; the default is a perfect one."""

    delay: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    """[s]"""
    jitter: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    """Scale of the extra delay [s]."""
    jitter_shape: Name = "uniform"
    """A row of `sim.channel.jitter.SHAPES`, which says what the scale means."""
    max_jitter: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.0
    """The extra delay lies between -delay and this [s], as if drawn again until it does; 0: five times the jitter."""
    loss: Share = 0.0
    """Share of messages that are lost, each on its own."""
    burst_length: Seconds = 0.0
    """Mean length of the bad state (Gilbert-Elliott) [s]; 0: no bursts."""
    burst_interval: Seconds = 0.0
    """Mean time in the good state between two [s]."""
    burst_loss: Share = 1.0
    """Share of messages that are lost in the bad state."""
    blackouts: Annotated[tuple[tuple[Seconds, Seconds], ...], Meta(max_length=1000)] = ()
    """Start and length of planned ones [s]: nothing that leaves then gets through."""
    blackout_interval: Seconds = 0.0
    """Mean time between the end of a random blackout and the start of the next [s]; 0: none."""
    blackout_length: Seconds = 0.0
    """Length of each random one [s]."""
    duplicates: Share = 0.0
    """Share of messages that arrive twice; the copy has a delay of its own."""
    reorder: Share = 0.0
    """Share of messages that are held back."""
    reorder_delay: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    """By how much [s]."""
    bandwidth: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """Messages per second [1/s]; 0: no limit."""
    queue: Annotated[int, Meta(ge=1, le=10_000)] = 10
    """Messages that can wait at the sender."""
    keep: Name = "newest"
    """The messages that a full queue keeps, of `KEEPS`."""
    trace: Text = ""
    """A recorded link that is played in a loop instead of drawing: a Mahimahi file, or a CSV table of sent and delay.

    The file lies beside the scenario's or below. Beside a Mahimahi file, which says when bytes may leave, stands all
    but bandwidth; beside a table, which says what became of each message, stand delay and blackouts alone."""
    message_bytes: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000
    """Size of a message where a Mahimahi file is played [bytes]: each of its lines lets 1,500 bytes leave."""

    def changes(self) -> dict[str, Any]:
        """Return the fields in which it differs from a perfect link, as plain values."""
        theirs = msgspec.to_builtins(LinkSettings())
        mine = msgspec.to_builtins(self)
        return {name: value for name, value in mine.items() if value != theirs[name]}


class LinkStatus(Message, frozen=True, kw_only=True):
    """The counters of a link: sent + duplicated = delivered + lost + waiting + flying."""

    sent: Tick
    delivered: Tick
    """Copies among them."""
    duplicated: Tick
    """Copies that were made."""
    queued: Tick
    """At the sender."""
    in_transit: Tick
    lost: dict[Text, Tick]
    """By cause, of `sim.channel.link.CAUSES`."""
    delivery_ratio: Share | None = None
    """Of the messages whose fate is known, the share that was not lost."""
    age: NonNegative | None = None
    """Of the newest information delivered, at the last tick [s]; None before the first."""
    mean_age: NonNegative | None = None
    """Over the ticks since then."""
    max_age: NonNegative | None = None
    degraded: bool = False
    """True if its settings do anything to a message."""
    settings: LinkSettings | None = None
