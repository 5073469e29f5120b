"""Many worlds of one scenario at once: arrays with an axis for worlds, and the tick of each, compiled.

No laws in here. World k with a seed is, bit for bit, the `World` of that seed and secret under the same commands:
a single world is a batch of one.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.errors import ScenarioError
from bus.messages.links import LinkKind, LinkSettings
from bus.ticks import first_tick_from
from sim.channel.description import check_link
from sim.compiling.compile import IntArray, released
from sim.compiling.threads import WorkerThreads
from sim.engine.briefing import safety_parameters, ugv_carries, ugv_delay
from sim.engine.ground_state import CONSTANTS, GroundState, ground_of
from sim.engine.run_keys import derive_keys
from sim.engine.scenario_links import ENGINE_LINKS, key_rows, links_of, vehicles_with
from sim.engine.world_state import (
    BatchState,
    BatchTables,
    batch_tables,
    first_coverage,
    first_vehicles,
    world_parameters,
)
from sim.engine.world_tick import begin_world, world_tick
from sim.models.motion import no_motions
from sim.models.randomness import HAZARD_FIELDS
from sim.scenario.ground_tables import ground_tables, place_fields
from sim.scenario.types import Scenario


@released
def _run_worlds(
    tables: BatchTables,
    state: BatchState,
    ground: GroundState | None,
    worlds: IntArray,
    beginning: bool,
    linked: bool,
    begin: int,
    end: int,
) -> None:
    """Begin worlds, or advance them by one tick."""
    for n in range(begin, end):
        if beginning:
            begin_world(tables, state, ground, worlds[n])
        else:
            world_tick(tables, state, ground, worlds[n], linked)


def arrays_of(state: object) -> list[npt.NDArray[Any]]:
    """All arrays of a state, however deep."""
    if isinstance(state, tuple):
        return [array for part in state for array in arrays_of(part)]
    return [state] if isinstance(state, np.ndarray) else []


class Fresh:
    """The start of every world: a copy of the first one's arrays, before anything has happened."""

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
        others: Kinds of links beside those of detections and commands, which the engine carries.

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
        others: Sequence[LinkKind] = (),
    ) -> None:
        if worlds < 1:
            raise ValueError(f"worlds = {worlds}: must be 1 or more")
        self.scenario = scenario
        self.worlds = worlds
        self._secret = secret
        self.parameters = world_parameters(scenario, gains=gains)
        self.workers = WorkerThreads(threads)
        """The threads that share the worlds."""
        self._shared = self.workers.shares(worlds)
        self._all = np.arange(worlds)
        self.links = links_of(scenario, (*ENGINE_LINKS, *others), worlds)
        """Links of detections, of commands, then of the other kinds."""
        self._key_rows = key_rows(scenario, self.links)
        self.link_table = scenario.links
        """The links' settings now, as a scenario would write them."""
        self.tables = batch_tables(scenario, self.parameters, self.links.traces)
        vehicles = first_vehicles(scenario)
        self.state = BatchState(
            ticks=np.zeros(worlds, dtype=np.int64),
            vehicles=np.repeat(vehicles[None], worlds, axis=0),
            coverage=np.repeat(first_coverage(scenario)[None], worlds, axis=0),
            motions=no_motions(worlds, len(vehicles), self._motion_rows()),
            flown=no_motions(worlds, len(vehicles), 1),
            links=self.links.records,
            packets=self.links.packets,
        )
        self.ground = ground_of(scenario, worlds)
        """The ground; None if there are no hazards."""
        changing = self.ground._asdict() if self.ground is not None else {}
        changing |= self.state._asdict()
        for constant in (*CONSTANTS, "packets"):  # links without any packets are new
            changing.pop(constant, None)
        self.fresh = Fresh(tuple(changing.values()))
        """The start of every world."""

    def _motion_rows(self) -> int:
        """Motions that each receiver has room for: those that may be under way at once; one where there are none."""
        scenario = self.scenario
        delays = [safety_parameters(scenario, uav.name).max_command_delay for uav in scenario.uav]
        delays += [
            ugv_delay(scenario, ugv.name) for ugv in scenario.ugv if ugv_carries(scenario, ugv)
        ]
        return max((2 + first_tick_from(delay, scenario.dt) for delay in delays), default=1)

    def begin(
        self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None = None
    ) -> None:
        """Begin worlds anew.

        Args:
            seeds: One for each of them.
            worlds: Which; all by default.
        """
        which = self.restore(seeds, worlds)
        self._run(which, beginning=True)

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
        if self.link_table is not self.scenario.links:
            raise ValueError("a world cannot begin anew: its links have been changed")
        if given.shape != which.shape:
            raise ValueError(f"{given.size} seeds for {which.size} worlds")
        self.fresh.restore(which)
        keys = derive_keys(given.tolist(), len(self.scenario.vehicles), self._secret)
        self.state.vehicles["keys"][which] = keys.swapaxes(1, 2)
        purposes, vehicles = self._key_rows
        self.links.records["key"][which] = keys[:, purposes, vehicles]
        if self.scenario.hazard_field:
            self._place_hazards(which)
        return which

    def _place_hazards(self, worlds: IntArray) -> None:
        """Draw the hazards of the scenario's fields; every seed has others."""
        if self.ground is None:
            return
        tables = ground_tables(self.scenario)
        for k in worlds.tolist():
            first, second = self.state.vehicles["keys"][k, 0, HAZARD_FIELDS]
            own = tables._replace(hazards=self.ground.hazards[k], tiles=self.ground.tiles[k])
            place_fields(self.scenario, own, (first, second))

    def advance(self, *, linked: bool = True) -> None:
        """Advance all worlds by one tick under the outgoing commands, or under `command` of each vehicle.

        Args:
            linked: Whether commands cross their links.
        """
        self._run(self._all, linked=linked)

    def _run(self, worlds: IntArray, *, beginning: bool = False, linked: bool = True) -> None:
        given = self.tables, self.state, self.ground, worlds, beginning, linked
        if self._shared:
            self.workers.share(_run_worlds, len(worlds), *given)
        else:
            _run_worlds(*given, 0, len(worlds))

    def change_links(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Give links other settings in all worlds, between two ticks: packets on their way arrive as they would have.

        No world can begin anew afterwards.

        Args:
            kind: The kind of the links.
            vehicle: The vehicle; None: all that have such a link.
            settings: The new settings.

        Raises:
            ScenarioError: If the settings are impossible, or this vehicle has no such link.
        """
        names = vehicles_with(self.scenario, kind)
        if vehicle is not None and vehicle not in names:
            raise ScenarioError(
                f"vehicle = {vehicle!r}: has no link for its {kind}; allowed: {', '.join(names)}"
            )
        check_link(settings, str(kind), self.link_table.traces)
        for name in names if vehicle is None else (vehicle,):
            self.links.change(self.links.row(kind, name), settings)
        self.link_table = self.link_table.changed(kind, vehicle, settings)
        self.tables = self.tables._replace(traces=self.links.traces)
        self.state = self.state._replace(packets=self.links.packets)
