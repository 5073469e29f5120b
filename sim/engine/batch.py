"""Many worlds of one scenario at once: arrays with an axis for worlds, and the step of each, compiled.

No laws in here. World k with a seed is, bit for bit, the `World` of that seed and secret under the same commands.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages import LinkKind, LinkStatus
from sim.channel.link import LinkState, receive, send
from sim.channel.link import advance as advance_link
from sim.engine.link_table import BatchLinks, LinkTable, link_of, parameters_of
from sim.engine.links import hold_ticks
from sim.engine.run_keys import derive_keys
from sim.engine.world_tick import (
    WorldParameters,
    WorldState,
    advance,
    bounds_of,
    detect_all,
    escorts_of,
    first_state,
    measure,
    world_parameters,
)
from sim.kernels.compile import FloatArray, IntArray, inlined, released
from sim.kernels.threads import Crew
from sim.models.randomness import COMMAND_LINK, DETECTION_LINK, RUN_PURPOSES, WordArray, key_of
from sim.models.vehicles import brake
from sim.scenario.types import Scenario

TAKEN, LOOK_X, LOOK_Y = range(3)
"""Columns of `BatchState.looks`: the tick at which it was taken, and the noisy p_a - p_g [m]."""


class BatchTables(NamedTuple):
    """What all worlds share and nobody changes."""

    bounds: FloatArray
    """v_max [m/s] and u_max [m/s²]. Shape (vehicles, 2)."""
    escorts: IntArray
    """Rows (UAV, UGV). Shape (UAVs, 2)."""
    perfect_detections: bool
    """Whether no detection is ever late or lost."""
    perfect_commands: bool
    """Likewise of the commands."""
    hold_ticks: int
    """For how long a vehicle goes on with its last command when none comes."""
    ways_in: LinkTable
    """The links of the detections, a row for each UAV."""
    ways_out: LinkTable
    """The links of the commands, a row for each vehicle."""


class BatchState(NamedTuple):
    """What is true in each world. All arrays have an axis for worlds in front."""

    keys: WordArray
    """Of each world's random numbers. Shape (worlds, RUN_PURPOSES, vehicles, 2)."""
    ticks: IntArray
    """Shape (worlds,)."""
    truth: WorldState
    looks: FloatArray
    """What has reached each UAV's computer at this tick, in the order of arrival. Shape (worlds, UAVs, room, 3)."""
    arrived: IntArray
    """How many. Shape (worlds, UAVs)."""
    answered: IntArray
    """The tick that the newest command of each vehicle, as it has arrived, answers; -1: none.

    Shape (worlds, vehicles).
    """
    message: FloatArray
    """Where a message is put together. Shape (worlds, 3)."""
    orders: FloatArray
    """What has arrived at a vehicle: tick answered, acceleration [m/s²]. Shape (worlds, room, 3)."""
    ways_in: LinkState
    ways_out: LinkState


@inlined
def truth_of(truth: WorldState, k: int) -> WorldState:
    """The truth of one world: views, no copies."""
    return WorldState(
        truth.position[k],
        truth.velocity[k],
        truth.acceleration[k],
        truth.commands[k],
        truth.coverage[k],
        truth.detections[k],
        truth.gains[k],
        truth.measures[k],
    )


@inlined
def deliver_detections(t: BatchTables, s: BatchState, k: int) -> None:
    """What the detectors found at this tick sets out, and what has arrived is there."""
    keys, tick, found, looks = s.keys[k], s.ticks[k], s.truth.detections[k], s.looks[k]
    for u in range(found.shape[0]):
        seen = not math.isnan(found[u, 0])
        if t.perfect_detections:
            s.arrived[k, u] = 1 if seen else 0
            looks[u, 0, TAKEN], looks[u, 0, LOOK_X], looks[u, 0, LOOK_Y] = (
                tick,
                found[u, 0],
                found[u, 1],
            )
            continue
        p, link = parameters_of(t.ways_in, u), link_of(s.ways_in, k, u)
        key = key_of(keys, DETECTION_LINK, t.ways_in.vehicles[u])
        advance_link(p, link, key, tick)
        if seen:
            message = s.message[k]
            message[TAKEN], message[LOOK_X], message[LOOK_Y] = tick, found[u, 0], found[u, 1]
            send(p, link, key, message)
        s.arrived[k, u] = receive(link, looks[u])


@inlined
def act_on_commands(
    w: WorldParameters, t: BatchTables, s: BatchState, k: int, commands: FloatArray
) -> None:
    """The commands set out.

    Each vehicle acts on its newest one that has arrived, and brakes where none has come for a while.

    A command that is not a number has not been given: nothing sets out.
    """
    keys, tick, acting = s.keys[k], s.ticks[k], s.truth.commands[k]
    if t.perfect_commands:
        for v in range(commands.shape[0]):
            acting[v, 0], acting[v, 1] = commands[v, 0], commands[v, 1]
        return
    message, orders, answered = s.message[k], s.orders[k], s.answered[k]
    for v in range(commands.shape[0]):
        p, link = parameters_of(t.ways_out, v), link_of(s.ways_out, k, v)
        key = key_of(keys, COMMAND_LINK, t.ways_out.vehicles[v])
        advance_link(p, link, key, tick)
        if not math.isnan(commands[v, 0]):
            message[0], message[1], message[2] = tick, commands[v, 0], commands[v, 1]
            send(p, link, key, message)
        for n in range(receive(link, orders)):
            if orders[n, 0] > answered[v]:
                answered[v], acting[v, 0], acting[v, 1] = (
                    int(orders[n, 0]),
                    orders[n, 1],
                    orders[n, 2],
                )
        if tick - answered[v] > t.hold_ticks:
            v_x, v_y = s.truth.velocity[k, v, 0], s.truth.velocity[k, v, 1]
            acting[v, 0], acting[v, 1] = brake(v_x, v_y, t.bounds[v, 1], w.dt)


@inlined
def begin_world(w: WorldParameters, t: BatchTables, s: BatchState, k: int) -> None:
    """World k, whose arrays are as they are at the start but for its keys, has the first look."""
    detect_all(w, s.keys[k], 0, s.truth.position[k], t.escorts, s.truth.detections[k])
    deliver_detections(t, s, k)


@inlined
def step_world(
    w: WorldParameters, t: BatchTables, s: BatchState, k: int, commands: FloatArray
) -> None:
    """World k advances by one tick under these commands [m/s²], shape (vehicles, 2), once they have crossed their links."""
    act_on_commands(w, t, s, k, commands)
    s.ticks[k] += 1
    truth = truth_of(s.truth, k)
    advance(w, truth, s.keys[k], s.ticks[k], t.bounds, t.escorts, truth.commands)
    deliver_detections(t, s, k)


@released
def _begin_worlds(
    w: WorldParameters, t: BatchTables, s: BatchState, worlds: IntArray, begin: int, end: int
) -> None:
    for n in range(begin, end):
        begin_world(w, t, s, worlds[n])


@released
def _step_worlds(
    w: WorldParameters, t: BatchTables, s: BatchState, commands: FloatArray, begin: int, end: int
) -> None:
    for k in range(begin, end):
        step_world(w, t, s, k, commands[k])


@released
def _measure_worlds(
    w: WorldParameters, t: BatchTables, s: BatchState, begin: int, end: int
) -> None:
    for k in range(begin, end):
        measure(w, s.truth.position[k], t.escorts, s.truth.coverage[k], s.truth.measures[k])


def arrays_of(state: object) -> list[npt.NDArray[Any]]:
    """All arrays of a state, however deep."""
    if isinstance(state, tuple):
        return [array for part in state for array in arrays_of(part)]
    return [state] if isinstance(state, np.ndarray) else []


class Fresh:
    """How every world begins: a copy of the first one's arrays, before anything has happened."""

    def __init__(self, state: object) -> None:
        self._pairs = [(array, array[:1].copy()) for array in arrays_of(state) if array.size]

    def restore(self, worlds: IntArray) -> None:
        """Let these worlds be as they were at the start."""
        for array, first in self._pairs:
            array[worlds] = first


class Batch:
    """Many worlds of one scenario; `begin` them first.

    Args:
        scenario: What is flown in each.
        worlds: How many.
        gains: Whether the fall of e(t) by each look is counted.
        threads: Processor cores that share the worlds; by default all that this process may use.
        secret: Of all their random numbers, with each one's seed; empty: none.

    Raises:
        ValueError: If there are no worlds.
    """

    def __init__(
        self,
        scenario: Scenario,
        worlds: int,
        *,
        gains: bool = False,
        threads: int | None = None,
        secret: str = "",
    ) -> None:
        if worlds < 1:
            raise ValueError(f"worlds = {worlds}: must be 1 or more")
        self.scenario = scenario
        self.worlds = worlds
        self._secret = secret
        self.parameters = world_parameters(scenario, gains=gains)
        self.crew = Crew(threads)
        """The threads that share the worlds."""
        self.ways_in = BatchLinks(scenario, LinkKind.DETECTIONS, 3, worlds)
        self.ways_out = BatchLinks(scenario, LinkKind.COMMANDS, 3, worlds)
        first, escorts, vehicles = (
            first_state(scenario),
            escorts_of(scenario),
            len(scenario.vehicles),
        )
        self.tables = BatchTables(
            bounds=bounds_of(scenario),
            escorts=escorts,
            perfect_detections=self.ways_in.perfect,
            perfect_commands=self.ways_out.perfect,
            hold_ticks=hold_ticks(scenario),
            ways_in=self.ways_in.table,
            ways_out=self.ways_out.table,
        )
        self.state = BatchState(
            keys=np.zeros((worlds, RUN_PURPOSES, vehicles, 2), dtype=np.uint64),
            ticks=np.zeros(worlds, dtype=np.int64),
            truth=WorldState._make(np.repeat(array[None], worlds, axis=0) for array in first),
            looks=np.zeros(
                (worlds, len(escorts), 1 if self.ways_in.perfect else self.ways_in.room, 3)
            ),
            arrived=np.zeros((worlds, len(escorts)), dtype=np.int64),
            answered=np.full((worlds, vehicles), -1, dtype=np.int64),
            message=np.zeros((worlds, 3)),
            orders=np.zeros((worlds, 1 if self.ways_out.perfect else self.ways_out.room, 3)),
            ways_in=self.ways_in.states,
            ways_out=self.ways_out.states,
        )
        self.fresh = Fresh(self.state)
        """How every world begins."""

    def begin(
        self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None = None
    ) -> None:
        """Begin worlds anew.

        Args:
            seeds: One for each of them.
            worlds: Which; all by default.
        """
        which = self.restore(seeds, worlds)
        self.crew.share(_begin_worlds, len(which), self.parameters, self.tables, self.state, which)

    def restore(
        self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None
    ) -> IntArray:
        """Let worlds be as they were at the start, with the keys of these seeds; before the first look.

        Args:
            seeds, worlds: As in `begin`.

        Returns:
            Which they are.
        """
        which = np.arange(self.worlds) if worlds is None else np.asarray(worlds, dtype=np.int64)
        given = np.asarray(seeds, dtype=np.int64)
        if given.shape != which.shape:
            raise ValueError(f"{given.size} seeds for {which.size} worlds")
        self.fresh.restore(which)
        self.state.keys[which] = derive_keys(
            given.tolist(), len(self.scenario.vehicles), self._secret
        )
        return which

    def step(self, commands: npt.NDArray[np.float64]) -> None:
        """All worlds advance by one tick.

        Args:
            commands: Accelerations [m/s²], shape (worlds, vehicles, 2), finite; they cross the links, then (1)
                bounds them.
        """
        self.crew.share(
            _step_worlds, self.worlds, self.parameters, self.tables, self.state, commands
        )

    def measure(self) -> FloatArray:
        """Distance [m] and e(t) [m²] of each UAV in each world, with the true p_g. Shape (worlds, UAVs, 2); a view."""
        self.crew.share(_measure_worlds, self.worlds, self.parameters, self.tables, self.state)
        return self.state.truth.measures

    def links(self, world: int) -> dict[str, LinkStatus]:
        """How each link of one world has done so far, by `vehicle/kind`."""
        kinds = {LinkKind.DETECTIONS: self.ways_in, LinkKind.COMMANDS: self.ways_out}
        return {
            f"{name}/{kind}": one
            for kind, links in kinds.items()
            for name, one in links.status(world).items()
        }
