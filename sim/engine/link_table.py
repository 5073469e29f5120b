"""The links of many worlds in arrays.

What each link does in one table, what it remembers with axes for worlds and links.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.messages import LinkKind, LinkStatus
from sim.channel.description import check_link, link_parameters, link_status
from sim.channel.link import LinkParameters, LinkState, link_state
from sim.engine.links import PER_TICK, owners
from sim.kernels.compile import FloatArray, IntArray, inlined
from sim.scenario.types import Scenario


class LinkTable(NamedTuple):
    """What the links of one kind do, one row a link."""

    numbers: FloatArray
    """Everything but the planned blackouts, in the order of `LinkParameters`; then which blackouts.

    Shape (links, 27).
    """
    blackouts: IntArray
    """The planned blackouts of all links, one after the other. Shape (any, 2)."""
    vehicles: IntArray
    """The vehicle that each belongs to, for its key. Shape (links,)."""


_BLACKOUTS = LinkParameters._fields.index("blackouts")


def _table(parameters: Sequence[LinkParameters], vehicles: Sequence[int]) -> LinkTable:
    first, rows, blackouts = 0, [], [np.zeros((0, 2), dtype=np.int64)]
    for p in parameters:
        last = first + len(p.blackouts)
        numbers = (value for k, value in enumerate(p) if k != _BLACKOUTS)
        rows.append([*numbers, first, last])
        blackouts.append(p.blackouts)
        first = last
    return LinkTable(
        np.array(rows, dtype=np.float64),
        np.concatenate(blackouts),
        np.array(vehicles, dtype=np.int64),
    )


@inlined
def parameters_of(table: LinkTable, link: int) -> LinkParameters:
    """What one link of the table does."""
    r = table.numbers[link]
    return LinkParameters(
        r[0] != 0.0,
        r[1],
        r[2],
        r[3],
        int(r[4]),
        r[5],
        r[6],
        r[7],
        r[8],
        r[9],
        r[10],
        r[11],
        r[12] != 0.0,
        r[13],
        r[14],
        r[15],
        r[16],
        table.blackouts[int(r[25]) : int(r[26])],
        r[17],
        r[18],
        r[19],
        r[20],
        int(r[21]),
        r[22] != 0.0,
        int(r[23]),
        int(r[24]),
    )


class BatchLinks:
    """The links of one kind in many worlds.

    Args:
        scenario: What is flown.
        kind: Which links.
        width: Numbers in a message.
        worlds: How many.
    """

    def __init__(self, scenario: Scenario, kind: LinkKind, width: int, worlds: int) -> None:
        self.names = owners(scenario, kind)
        """Whose link each row is."""
        rows = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
        settings = [
            check_link(scenario.links.of(name, kind), f"{name}/{kind}") for name in self.names
        ]
        self._settings = settings
        self._parameters = [
            link_parameters(one, scenario.dt, per_tick=PER_TICK[kind]) for one in settings
        ]
        self.perfect = all(p.perfect for p in self._parameters)
        """Whether none of them does anything to a message."""
        self.longest = max((p.longest for p in self._parameters), default=0)
        """The longest delay of any of them [ticks]."""
        self.table = _table(self._parameters, [rows[name] for name in self.names])
        room = max((p.room for p in self._parameters), default=1)
        one = [link_state(p, width, room=room, wheel=self.longest + 1) for p in self._parameters]
        fresh = [np.stack(arrays) for arrays in zip(*one, strict=True)]
        self.states = LinkState._make(np.repeat(array[None], worlds, axis=0) for array in fresh)
        """What they remember. Arrays with axes for worlds and links."""
        self.room = room
        """Messages that may arrive at once, at most."""

    def status(self, world: int) -> dict[str, LinkStatus]:
        """How each link of one world has done so far, by vehicle."""
        found: dict[str, LinkStatus] = {}
        for k, name in enumerate(self.names):
            state = LinkState._make(array[world, k] for array in self.states)
            found[name] = link_status(self._parameters[k], state, self._settings[k])
        return found


@inlined
def link_of(states: LinkState, world: int, link: int) -> LinkState:
    """The state of one link in one world: views, no copies."""
    return LinkState(
        states.slots[world, link],
        states.payload[world, link],
        states.buckets[world, link],
        states.counts[world, link],
        states.numbers[world, link],
    )
