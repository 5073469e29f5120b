"""The links of many worlds in arrays.

What each link does in one table, what it remembers with axes for worlds and links.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.messages import LinkKind, LinkSettings, LinkStatus
from sim.channel.description import (
    check_link,
    link_parameters,
    link_status,
    link_table,
    longest_wait,
    relink,
)
from sim.channel.link import LinkState, link_state
from sim.kernels.compile import inlined
from sim.models.randomness import COMMAND_LINK, DETECTION_LINK, OPERATOR_LINK, RADIO_LINK
from sim.scenario.types import Scenario, Uav, Ugv

PURPOSES = {
    LinkKind.DETECTIONS: DETECTION_LINK,
    LinkKind.COMMANDS: COMMAND_LINK,
    LinkKind.OPERATOR: OPERATOR_LINK,
    LinkKind.RADIO: RADIO_LINK,
}
"""Of the links' keys."""
PER_TICK = {LinkKind.DETECTIONS: 1, LinkKind.COMMANDS: 1, LinkKind.OPERATOR: 64, LinkKind.RADIO: 16}
"""Messages that a link has room for in every tick; what is more is lost."""
_OWNERS = {
    LinkKind.DETECTIONS: Uav,
    LinkKind.COMMANDS: Uav | Ugv,
    LinkKind.OPERATOR: Ugv,
    LinkKind.RADIO: Uav,
}
"""The vehicles that have such a link."""


def owners(scenario: Scenario, kind: LinkKind) -> tuple[str, ...]:
    """The vehicles that have a link of this kind, in name order."""
    return tuple(one.name for one in scenario.vehicles if isinstance(one, _OWNERS[kind]))


class LinkArrays:
    """The links of some kinds in many worlds.

    Args:
        scenario: What is flown.
        kinds: Which links: all of the first kind, in name order, then those of the next.
        width: Numbers in a message.
        worlds: How many.
    """

    def __init__(
        self, scenario: Scenario, kinds: Sequence[LinkKind], width: int, worlds: int
    ) -> None:
        vehicles = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
        self.names = [(kind, name) for kind in kinds for name in owners(scenario, kind)]
        """Kind and vehicle of each row."""
        self._dt = scenario.dt
        self._owners = [(PURPOSES[kind], vehicles[name]) for kind, name in self.names]
        self._traces = scenario.links.traces
        self._settings = [
            check_link(scenario.links.of(name, kind), f"{name}/{kind}", self._traces)
            for kind, name in self.names
        ]
        self._parameters = [
            link_parameters(one, scenario.dt, per_tick=PER_TICK[kind], traces=self._traces)
            for (kind, _), one in zip(self.names, self._settings, strict=True)
        ]
        self.table = link_table(self._parameters, self._owners)
        self.room = max((p.room for p in self._parameters), default=1)
        """Messages that may arrive at once by one link, at most."""
        wheel = max((p.longest for p in self._parameters), default=0) + 1
        kept = self._parameters or [link_parameters(LinkSettings(), scenario.dt)]  # for the shapes
        one = [link_state(p, width, room=self.room, wheel=wheel) for p in kept]
        fresh = [_stacked(arrays)[: len(self.names)] for arrays in zip(*one, strict=True)]
        self.states = LinkState._make(np.repeat(array[None], worlds, axis=0) for array in fresh)
        """Their states. Arrays with axes for worlds and links."""

    @property
    def perfect(self) -> bool:
        """True if none of them does anything to a message."""
        return all(p.perfect for p in self._parameters)

    def longest(self, kind: LinkKind) -> int:
        """The longest time from a sending to an arrival by a link of this kind, with the wait in its queue [ticks]."""
        links = zip(self.names, self._parameters, strict=True)
        times = (p.longest + longest_wait(p) for (one, _), p in links if one is kind)
        return max(times, default=0)

    def change(self, kind: LinkKind, vehicle: str, settings: LinkSettings) -> None:
        """Go on with other settings of one link from the next tick on, in new arrays; see `relink`."""
        row, old = self.names.index((kind, vehicle)), list(self._parameters)
        checked = check_link(settings, f"{vehicle}/{kind}", self._traces)
        self._settings[row] = checked
        self._parameters[row] = link_parameters(
            checked, self._dt, per_tick=PER_TICK[kind], traces=self._traces
        )
        room = wheel = 1
        for _ in range(2):  # once to see how much room they need, once with the same for all
            states = [
                [
                    relink(was, self._state_of(world, k), now, room=room, wheel=wheel)
                    for k, (was, now) in enumerate(zip(old, self._parameters, strict=True))
                ]
                for world in range(len(self.states.lost))
            ]
            every = [state for links in states for state in links]
            room = max(len(state.slots) for state in every)
            wheel = max(len(state.buckets) for state in every) - 1
        self.room = room
        self.table = link_table(self._parameters, self._owners)
        by_world = [[_stacked(arrays) for arrays in zip(*links, strict=True)] for links in states]
        self.states = LinkState._make(_stacked(arrays) for arrays in zip(*by_world, strict=True))

    def _state_of(self, world: int, link: int) -> LinkState:
        return LinkState._make(array[world, link] for array in self.states)

    def status(self, world: int) -> dict[str, LinkStatus]:
        """Counters of each link of one world so far, by `vehicle/kind`."""
        return {
            f"{name}/{kind}": link_status(
                self._parameters[k], self._state_of(world, k), self._settings[k]
            )
            for k, (kind, name) in enumerate(self.names)
        }


@inlined
def link_of(states: LinkState, world: int, link: int) -> LinkState:
    """The state of one link in one world: views, no copies."""
    return LinkState(
        states.slots[world, link],
        states.payload[world, link],
        states.buckets[world, link],
        states.memory[world, link],
        states.lost[world, link],
    )


def _stacked(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Arrays of one type on a new first axis; `np.stack` by itself would leave structured ones no records."""
    return np.stack(arrays, dtype=arrays[0].dtype)
