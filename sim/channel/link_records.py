"""Records of radio links: parameters, state and counters of a link, and its packets."""

import math
from typing import Annotated, NamedTuple

import numpy as np

from bus.messages.base import Vector
from bus.messages.links import LinkSettings
from sim.compiling.compile import IntArray
from sim.compiling.records import RecordArray, record_type
from sim.models.randomness import WordArray

FLYING, WAITING, ARRIVED = range(3)
"""Lists of packets of a link."""

CAUSES = ("loss", "burst", "blackout", "queue", "full", "trace")
"""Causes of losses; `full`: the link's capacity was exceeded, impossible for one message per tick; `trace`: lost in the
trace.
"""
LOSS, BURST, BLACKOUT, QUEUE, FULL, TRACE = range(6)

NOTHING, DELAYS, OPPORTUNITIES = range(3)
"""Kinds of traces: none, a table of delays, or delivery opportunities."""


class LinkParameters(NamedTuple):
    """Parameters of one link: its settings, and values derived from them for a given tick duration.

    Made by `sim.channel.description.link_parameters`. The record holds the numeric settings.
    """

    settings: LinkSettings
    perfect: bool
    """True if the link delivers every message at once."""
    dt: float
    """Duration of a tick [s]."""
    jitter_shape: int
    """A value of `sim.channel.jitter.SHAPES`."""
    least: float
    most: float
    """Bounds of the extra delay [s]."""
    low: float
    high: float
    """Shares of the unbounded extra delays below these bounds. Sampling between them is equivalent to rejection
    sampling.
    """
    bursts: bool
    bad_share: float
    bad_stay: float
    bad_enter: float
    """Probability of the bad state at the start, after a bad tick, and after a good tick."""
    memory: float
    """Correlation of the delays' normal scores from one tick to the next; 0: each delay is independent."""
    innovation: float
    """Standard deviation of their change, given the last score."""
    blackouts: IntArray
    """Rows (first tick of a blackout, first tick after it), in order and disjoint."""
    up: float
    down: float
    """Mean time between two random blackouts, and their duration [ticks]; `up` is 0: none."""
    spacing: float
    """Time between two transmitted packets [ticks]; 0: no limit."""
    newest: bool
    """True if a full queue keeps the newest packets."""
    longest: int
    """Longest delay [ticks]."""
    room: int
    """Maximum number of packets queued or in transit."""
    replay: int
    """Kind of trace: `NOTHING`, `DELAYS` or `OPPORTUNITIES`."""
    trace: IntArray
    """Rows of the trace in order of time. Delays: (first tick, delay in ticks or -1); opportunities: (time in ms,
    0).
    """
    period: int
    """Period of the trace [ticks or ms]; the last opportunity is at its end."""
    opportunity: int
    """Bytes that can leave at each opportunity."""
    first_blackout: int = 0
    end_blackout: int = 0
    """Range of its blackouts in the array of all traces."""
    first_row: int = 0
    end_row: int = 0
    """Range of its trace there."""


class Link:
    """Parameters, state and counters of one link in one world; times in ticks."""

    parameters: LinkParameters
    number: int
    """Index among the links of its world."""
    room: int
    """Size of its rings."""
    key: Annotated[WordArray, (2,)]
    """Key of its random numbers."""
    tick: int
    index: int
    """Messages sent in this tick."""
    first: int
    span: int
    """Start and length of the ring of packets in transit. It includes arrived packets behind ones that are still in
    transit.
    """
    in_transit: int
    first_waiting: int
    queued: int
    """Start and length of the sender's queue."""
    arrived: int
    """Packets that arrived at the last tick."""
    bad: int
    """State of the channel: 1: bad, 0: good, -1: not drawn yet."""
    blackout: bool
    """True during a blackout."""
    served: int
    """Packets transmitted since the sender was last idle."""
    renewals: int
    """Random blackouts drawn."""
    granted: int
    """Bytes granted to the first queued packet."""
    sent: int
    delivered: int
    duplicated: int
    originals: int
    """Messages delivered, without copies."""
    ages: int
    """Ticks summed in `age_sum`."""
    busy_since: float
    """Time since which the sender has been busy."""
    blackout_begin: float
    blackout_end: float
    """Start and end of the random blackout; -1: none drawn yet."""
    score: float
    """Normal score of the extra delay at this tick, if delays are correlated; NaN: not drawn yet."""
    newest: float
    """Newest received stamp; NaN: none."""
    age_sum: float
    age_max: float
    """Sum and maximum over the ticks of the newest stamp's age."""
    lost: Annotated[IntArray, (len(CAUSES),)]
    """Messages lost, by cause, in the order of `CAUSES`."""


class Packet:
    """One message on a link. Each kind of link uses some of the first eight fields."""

    stamp: float
    """Tick of its content. In a list of messages to send, -1: none."""
    vector: Vector
    """Relative position p_a - p_g [m], or acceleration [m/s²]."""
    vertical: float
    """Vertical acceleration of a UAV's command [m/s²]."""
    error: float
    """True error of a detection [m], for the counters; not sent to vehicles."""
    plan: int
    """First tick of the last trajectory in a command; -1: none."""
    plans: int
    """Trajectories in a command; they start in the tick `plan` and the ticks before it."""
    block: int
    """Number of the block of tiles in a map update; -1: relative position."""
    tiles: Annotated[IntArray, (4,)]
    """States of its tiles, from `agents.estimation.map_updates.encode_block`."""
    due: int
    """Tick of arrival; -1: has arrived."""
    sent_at: int
    number: int
    """Number within the tick at which it was sent."""
    copy: bool


def reset_links(links: RecordArray) -> None:
    """Reset links to the state before any message; parameters, numbers, capacities and keys stay."""
    for name in links.dtype.names or ():
        if name not in ("parameters", "number", "room", "key"):
            links[name] = 0
    for name in ("tick", "bad", "blackout_begin", "blackout_end"):
        links[name] = -1
    links["newest"] = links["score"] = math.nan


def no_packets(*shape: int) -> RecordArray:
    """Return an array of packets, all zero."""
    return np.zeros(shape, dtype=record_type(Packet))
