"""Settings and counters of a radio link."""

from enum import StrEnum
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Seconds, Share, Text, Tick


class LinkKind(StrEnum):
    """Kind of messages that a link carries."""

    DETECTIONS = "detections"
    """From the UAV's detector to its computer."""
    COMMANDS = "commands"
    """From the vehicle's computer to its actuators."""
    OPERATOR = "operator"
    """From the operator to a UGV."""
    RADIO = "radio"
    """From a UAV to the UGV that it escorts."""
    TEAM = "team"
    """From a UAV to the other UAVs of its team."""


class LinkSettings(Message, frozen=True, kw_only=True):
    """Settings of one link; the default is a perfect link."""

    delay: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    """Constant delay [s]."""
    jitter: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    """Scale of the random extra delay [s]."""
    jitter_shape: Name = "uniform"
    """Distribution of the extra delay, a row of `sim.channel.jitter.SHAPES`."""
    max_jitter: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.0
    """Upper bound of the extra delay [s], as if redrawn until in range; lower bound: -delay. 0: 5 x jitter."""
    jitter_time: Seconds = 0.0
    """Correlation time of the extra delay [s]: consecutive messages are late together, as behind one queue. 0: each
    delay is independent.
    """
    loss: Share = 0.0
    """Share of messages lost, independently."""
    burst_length: Seconds = 0.0
    """Mean duration of the bad state (Gilbert-Elliott) [s]; 0: no bursts."""
    burst_interval: Seconds = 0.0
    """Mean duration of the good state [s]."""
    burst_loss: Share = 1.0
    """Share of messages lost in the bad state."""
    blackouts: Annotated[tuple[tuple[Seconds, Seconds], ...], Meta(max_length=1000)] = ()
    """Start and duration of planned blackouts [s]; messages sent in a blackout are lost."""
    blackout_interval: Seconds = 0.0
    """Mean time from the end of a random blackout to the start of the next [s]; 0: none."""
    blackout_length: Seconds = 0.0
    """Duration of each random blackout [s]."""
    duplicates: Share = 0.0
    """Share of messages that arrive twice; the copy has its own delay."""
    reorder: Share = 0.0
    """Share of messages held back."""
    reorder_delay: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    """Extra delay of messages held back [s]."""
    bandwidth: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """Messages per second [1/s]; 0: unlimited."""
    queue: Annotated[int, Meta(ge=1, le=10_000)] = 10
    """Capacity of the sender's queue [messages]."""
    keep: Name = "newest"
    """Messages that a full queue keeps, one of `KEEPS`."""
    trace: Text = ""
    """Trace that is replayed in a loop instead of random draws: a Mahimahi file, or a CSV table of sent and delay. The
    file lies in the scenario's folder or below. A Mahimahi file replaces the bandwidth only; a table allows no other
    settings but delay and blackouts.
    """
    message_bytes: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000
    """Size of a message with a Mahimahi trace [bytes]; each line of the trace lets 1,500 bytes leave."""

    def changes(self) -> dict[str, Any]:
        """Return the fields that differ from a perfect link, as plain values."""
        theirs = msgspec.to_builtins(LinkSettings())
        mine = msgspec.to_builtins(self)
        return {name: value for name, value in mine.items() if value != theirs[name]}


class LinkStatus(Message, frozen=True, kw_only=True):
    """Counters of a link: sent + duplicated = delivered + lost + queued + in_transit."""

    sent: Tick
    """Messages sent."""
    delivered: Tick
    """Messages delivered, copies included."""
    duplicated: Tick
    """Copies made by the link."""
    queued: Tick
    """Messages waiting at the sender."""
    in_transit: Tick
    """Messages on the link."""
    lost: dict[Text, Tick]
    """Messages lost, by cause (`sim.channel.link_records.CAUSES`)."""
    delivery_ratio: Share | None = None
    """Share of messages delivered, of those delivered or lost."""
    age: NonNegative | None = None
    """Age of the newest delivered information at the last tick [s]; None before the first delivery."""
    mean_age: NonNegative | None = None
    """Mean age since the first delivery [s]."""
    max_age: NonNegative | None = None
    """Largest age since the first delivery [s]."""
    degraded: bool = False
    """True if the settings affect any message."""
    settings: LinkSettings | None = None
    """Current settings."""
