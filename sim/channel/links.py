"""Radio links in many worlds: records and packets, changes between two ticks, counters, and Python objects."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bus.messages.links import LinkKind, LinkSettings, LinkStatus
from sim.channel.description import check_link, link_parameters, longest_wait
from sim.channel.link import begin_tick, catch_up, receive, send
from sim.channel.link_records import (
    ARRIVED,
    CAUSES,
    FLYING,
    OPPORTUNITIES,
    QUEUE,
    WAITING,
    Link,
    LinkParameters,
    no_packets,
    reset_links,
)
from sim.channel.recorded import RecordedLink
from sim.compiling.compile import FloatArray, IntArray, compiled, constant
from sim.compiling.records import RecordArray, fill, record_type
from sim.models.randomness import Key

PER_TICK = dict.fromkeys(LinkKind, 1) | {LinkKind.OPERATOR: 64, LinkKind.RADIO: 8}
"""Capacity of a link [messages per tick]; a UAV radios at most five."""
_COUNTERS = ("sent", "delivered", "duplicated", "queued", "in_transit")
"""Counters common to a link's record and its status."""

_TRACE_ROWS = ("first_blackout", "end_blackout", "first_row", "end_row")
"""Fields of `LinkParameters` that depend on the other links."""

_WORLD = constant(0)
"""World of links with objects."""


@compiled
def exchange(
    links: RecordArray,
    packets: RecordArray,
    row: int,
    traces: IntArray,
    tick: int,
    stamps: FloatArray,
) -> int:
    """Run one tick of a link of world 0: send a packet for each stamp.

    Returns:
        Number of arrivals.
    """
    link = links[0, row]
    begin_tick(link, packets, _WORLD, traces, tick)
    for k in range(stamps.shape[0]):
        packets[0, row, ARRIVED, 0].stamp = stamps[k]
        send(link, packets, _WORLD, traces, packets[0, row, ARRIVED, 0])
    return receive(link, packets, _WORLD)


@compiled
def _catch_up(links: RecordArray, row: int, traces: IntArray, tick: int) -> None:
    catch_up(links[0, row], traces, tick)


@compiled
def _send_all(
    links: RecordArray, packets: RecordArray, traces: IntArray, every: int, arrivals: IntArray
) -> None:
    """Send message m of a link at tick m * every; write the tick of the first arrival of each, -1: none."""
    arrivals[:] = -1
    link = links[0, 0]
    for tick in range(arrivals.shape[0] * every):
        begin_tick(link, packets, _WORLD, traces, tick)
        if tick % every == 0:
            packet = packets[0, 0, ARRIVED, 0]
            packet.stamp = tick
            send(link, packets, _WORLD, traces, packet)
        for n in range(receive(link, packets, _WORLD)):
            message = packets[0, 0, ARRIVED, n].sent_at // every
            if arrivals[message] < 0:
                arrivals[message] = tick


def place_traces(links: RecordArray, parameters: Sequence[LinkParameters]) -> IntArray:
    """Write the parameters of links into their records.

    Returns:
        Scheduled blackouts and traces of all links, each trace once. Shape (rows, 2).
    """
    parts: list[IntArray] = [np.zeros((0, 2), dtype=np.int64), *(p.blackouts for p in parameters)]
    ends = np.cumsum([len(part) for part in parts]).tolist()
    traces, end = dict[int, int](), ends[-1]
    for row, p in enumerate(parameters):
        if id(p.trace) not in traces:
            traces[id(p.trace)] = end
            parts.append(p.trace)
            end += len(p.trace)
        first = traces[id(p.trace)]
        placed = p._replace(
            first_blackout=ends[row],
            end_blackout=ends[row + 1],
            first_row=first,
            end_row=first + len(p.trace),
        )
        fill(links["parameters"][0, row], placed)
    links["parameters"] = links["parameters"][:1]
    return np.concatenate(parts)


def new_links(
    links: Sequence[LinkParameters], worlds: int = 1
) -> tuple[RecordArray, RecordArray, IntArray]:
    """Return new links without messages; their keys are zero.

    Returns:
        Records of type `Link`, shape (worlds, links); their packets, shape (worlds, links, 3, room); their traces.
    """
    records = np.zeros((worlds, len(links)), dtype=record_type(Link))
    reset_links(records)
    records["number"], records["room"] = np.arange(len(links)), [p.room for p in links]
    room = max((p.room for p in links), default=1)
    return records, no_packets(worlds, len(links), 3, room), place_traces(records, links)


def first_arrivals(
    parameters: LinkParameters, key: Key, messages: int, *, every: int = 1
) -> IntArray:
    """Return the tick of the first arrival of each message sent at the ticks 0, every, 2 every, ...

    -1: lost, or still in transit at the end.

    Args:
        parameters: The link.
        key: Key of its random numbers.
        messages: Number of messages.
        every: Ticks between two messages.
    """
    links, packets, traces = new_links([parameters])
    links["key"] = key
    arrivals = np.empty(messages, dtype=np.int64)
    _send_all(links, packets, traces, every, arrivals)
    return arrivals


def link_status(link: Any, settings: LinkSettings | None = None) -> LinkStatus:  # noqa: ANN401 - a record
    """Return the counters of a link so far, with its settings if given."""
    dt, ages = float(link["parameters"]["dt"]), int(link["ages"])
    lost = dict(zip(CAUSES, link["lost"].tolist(), strict=True))
    known = int(link["originals"]) + sum(lost.values())
    return LinkStatus(
        **{name: int(link[name]) for name in _COUNTERS},
        lost=lost,
        delivery_ratio=int(link["originals"]) / known if known else None,
        age=(int(link["tick"]) - float(link["newest"])) * dt if ages else None,
        mean_age=float(link["age_sum"]) / ages * dt if ages else None,
        max_age=float(link["age_max"]) * dt if ages else None,
        degraded=not link["parameters"]["perfect"],
        settings=settings,
    )


def _change_link(link: Any, lists: RecordArray, new: LinkParameters) -> tuple[Any, Any]:  # noqa: ANN401 - a record
    """Prepare a link for new parameters; return the queued packets and those in transit, in order.

    Args:
        link: Record at the end of a tick; changed, except for its parameters and rings.
        lists: Packets of the link. Shape (3, room).
        new: Parameters from the next tick on.
    """
    old, room = link["parameters"], int(link["room"])
    granted = new.replay == OPPORTUNITIES
    continues = (
        old["replay"] == new.replay
        and old["settings"]["message_bytes"] == new.settings.message_bytes
    )
    if not (granted and continues):
        link["granted"] = 0
    partial, waiting = int(link["granted"] > 0), int(link["queued"])
    queued = lists[WAITING, (link["first_waiting"] + np.arange(waiting)) % room]
    keeps, queue = np.arange(waiting) - partial, new.settings.queue
    if new.spacing > 0.0 or granted:
        surplus = keeps < waiting - partial - queue if new.newest else keeps >= queue
        surplus &= keeps >= 0
        link["lost"][QUEUE] += surplus.sum()
        queued = queued[~surplus]
    flying = lists[FLYING, (link["first"] + np.arange(link["span"])) % room]
    if new.spacing != old["spacing"] and link["served"] > 0:
        link["busy_since"] += (link["served"] - 1) * old["spacing"]
        link["served"] = 1
    _change_channel(link, new)
    return queued, flying[flying["due"] >= 0]


def _change_channel(link: Any, new: LinkParameters) -> None:  # noqa: ANN401 - a record
    """Continue a burst or blackout if there still are any; redraw the next blackout if its distribution has changed."""
    old_up, old_down = link["parameters"]["up"], link["parameters"]["down"]
    link["blackout"] = False
    if not new.bursts:
        link["bad"] = -1
    if new.memory == 0.0:
        link["score"] = np.nan
    if (old_up, old_down) == (new.up, new.down):
        return
    if new.up == 0.0 or old_up == 0.0:
        link["blackout_begin"] = link["blackout_end"] = -1.0
    elif link["blackout_begin"] > link["tick"]:
        link["blackout_begin"] = link["blackout_end"] = link["tick"]


def change_links(
    links: RecordArray, packets: RecordArray, row: int, new: LinkParameters
) -> RecordArray:
    """Change the parameters of one link in all worlds, between two ticks.

    Packets in transit keep their arrival times. Queued packets stay, except those that a shorter queue drops; the new
    spacing applies from the last packet transmitted. A partly granted packet starts again, unless the opportunities
    continue with the same message size. Counters stay.

    Args:
        links: Records; changed, except for the parameters, which `place_traces` writes.
        packets: Packets of the links; changed.
        row: Index of the link.
        new: Parameters from the next tick on.

    Returns:
        The packets, in a larger array if they need more capacity.
    """
    moved = [
        _change_link(link, lists, new)
        for link, lists in zip(links[:, row], packets[:, row], strict=True)
    ]
    rooms = [new.room + 2 * len(queued) + len(flying) for queued, flying in moved]
    if max(rooms) > packets.shape[3]:
        grown = no_packets(*packets.shape[:3], max(rooms))
        grown[..., : packets.shape[3]] = packets
        packets = grown
    for w, (queued, flying) in enumerate(moved):
        packets[w, row, WAITING, : len(queued)] = queued
        packets[w, row, FLYING, : len(flying)] = flying
    for name, values in (
        ("room", rooms),
        ("queued", [len(queued) for queued, _ in moved]),
        ("in_transit", [len(flying) for _, flying in moved]),
        ("span", [len(flying) for _, flying in moved]),
    ):
        links[name][:, row] = values
    links["first"][:, row] = links["first_waiting"][:, row] = 0
    return packets


class Links:
    """Radio links with their settings.

    Compiled code sends packets on them. With one world they also carry Python objects: call `send_object` any number of
    times, then `arrivals`, for every tick from 0 on.

    Args:
        settings: Settings of each link, by kind and vehicle.
        dt: Duration of a tick [s].
        worlds: Number of worlds.
        traces: Traces that the settings may name, now or after a change.

    Raises:
        ScenarioError: If settings are invalid.
    """

    def __init__(
        self,
        settings: Mapping[tuple[LinkKind, str], LinkSettings],
        *,
        dt: float,
        worlds: int = 1,
        traces: Sequence[RecordedLink] = (),
    ) -> None:
        self.names = tuple(settings)
        """Kind and vehicle of each link."""
        self._dt, self._recorded = dt, traces
        self._settings = [self._check(*name, one) for name, one in settings.items()]
        self._parameters = [self._parameters_of(row) for row in range(len(self.names))]
        self.records, self.packets, self.traces = new_links(self._parameters, worlds)
        self._own: dict[int, Sequence[LinkSettings]] = {}  # by world
        self._ticks = [0] * len(self.names)  # next tick of `arrivals`
        self._outgoing: list[list[float]] = [
            [] for _ in self.names
        ]  # stamps of this tick's messages
        self._objects: list[dict[tuple[int, int], Any]] = [{} for _ in self.names]

    def _check(self, kind: LinkKind, vehicle: str, settings: LinkSettings) -> LinkSettings:
        return check_link(settings, f"{vehicle}/{kind}", self._recorded)

    def _parameters_of(self, row: int) -> LinkParameters:
        per_tick = PER_TICK[self.names[row][0]]
        settings = self._settings[row]
        return link_parameters(settings, self._dt, per_tick=per_tick, traces=self._recorded)

    @property
    def degraded(self) -> bool:
        """True if any link differs from a perfect one."""
        return not all(p.perfect for p in self._parameters)

    def row(self, kind: LinkKind, vehicle: str) -> int:
        """Return the row of a vehicle's link in the arrays."""
        return self.names.index((kind, vehicle))

    def longest(self, kind: LinkKind) -> int:
        """Return the longest time from sending to arrival on links of a kind, including the queue [ticks]."""
        links = zip(self.names, self._parameters, strict=True)
        times = (p.longest + longest_wait(p) for (one, _), p in links if one is kind)
        return max(times, default=0)

    def change(self, row: int, settings: LinkSettings) -> None:
        """Change the settings of a link from the next tick on, in all worlds; see `change_links`.

        `packets` and `traces` may be new arrays afterwards.

        Raises:
            ScenarioError: If the settings are invalid.
        """
        self._settings[row] = self._check(*self.names[row], settings)
        self._catch_up(row)
        new = self._parameters[row] = self._parameters_of(row)
        self.packets = change_links(self.records, self.packets, row, new)
        self.traces = place_traces(self.records, self._parameters)

    def set_world(self, world: int, settings: Sequence[LinkSettings]) -> None:
        """Set checked settings of each link in a world at its start, which need no more memory than the common ones."""
        self._own[world] = settings
        for row, one in enumerate(settings):
            if one == self._settings[row]:
                continue
            parameters = self.records["parameters"][world, row]
            given = link_parameters(
                one, self._dt, per_tick=PER_TICK[self.names[row][0]], traces=self._recorded
            )
            trace_rows: dict[str, Any] = {name: int(parameters[name]) for name in _TRACE_ROWS}
            fill(parameters, given._replace(**trace_rows))

    def status(self, world: int = 0) -> dict[str, LinkStatus]:
        """Return the counters of each link of a world so far, by `vehicle/kind`."""
        for row in range(len(self.names)):
            self._catch_up(row)
        settings = self._own.get(world, self._settings)
        rows = zip(self.names, self.records[world], settings, strict=True)
        return {f"{name}/{kind}": link_status(link, one) for (kind, name), link, one in rows}

    def send_object(self, row: int, tick: int, message: Any, stamp: float) -> None:  # noqa: ANN401 - any object
        """Send a Python object on a link; the link counts it when `arrivals` is called.

        Args:
            row: Index of the link.
            tick: Tick of the next `arrivals`.
            message: The object; delivered unchanged, and twice if the link duplicates it.
            stamp: Tick of its content.
        """
        self._check_order(row, tick)
        self._objects[row][tick, len(self._outgoing[row])] = message
        self._outgoing[row].append(stamp)

    def arrivals(self, row: int, tick: int) -> list[Any]:
        """Return the objects that arrive on a link at this tick, in order; call once per tick."""
        self._check_order(row, tick)
        self._ticks[row] = tick + 1
        objects = self._objects[row]
        if not objects:
            return []
        stamps = np.array(self._outgoing[row], dtype=np.float64)
        self._outgoing[row].clear()
        count = exchange(self.records, self.packets, row, self.traces, tick, stamps)
        arrived = [objects[one] for one in _numbers(self.packets[0, row, ARRIVED, :count])]
        self._forget(row)
        return arrived

    def _forget(self, row: int) -> None:
        """Drop objects that can no longer arrive."""
        link, (flying, waiting, _) = self.records[0, row], self.packets[0, row]
        left = int(link["in_transit"]) + int(link["queued"])
        if left == 0:
            self._objects[row].clear()
        elif left != len(self._objects[row]):
            room = int(link["room"])
            ring = flying[(link["first"] + np.arange(link["span"])) % room]
            queue = waiting[(link["first_waiting"] + np.arange(link["queued"])) % room]
            numbers = {*_numbers(ring[ring["due"] >= 0]), *_numbers(queue)}
            self._objects[row] = {one: self._objects[row][one] for one in numbers}

    def _check_order(self, row: int, tick: int) -> None:
        if tick != self._ticks[row]:
            raise ValueError(
                f"tick = {tick}: the link is at tick {self._ticks[row]}; allowed: every tick once, in order"
            )

    def _catch_up(self, row: int) -> None:
        """Advance a link over ticks without messages."""
        if self._ticks[row] > 0:
            _catch_up(self.records, row, self.traces, self._ticks[row] - 1)


def _numbers(packets: RecordArray) -> list[tuple[int, int]]:
    """Return the tick of sending of each packet, and its number within this tick."""
    return list(zip(packets["sent_at"].tolist(), packets["number"].tolist(), strict=True))
