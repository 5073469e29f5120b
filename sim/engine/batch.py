"""Batch of many worlds of one scenario: arrays with a leading axis for worlds, and a compiled tick.

Control laws are not included. World k with a seed is, bit for bit, the `World` of that seed and secret under the same
commands: a single world is a batch of one.
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
from sim.compiling.records import fill
from sim.compiling.threads import WorkerThreads
from sim.engine.bodies import bodies_of
from sim.engine.briefing import ugv_carries, ugv_delay
from sim.engine.ground_state import CONSTANTS, GroundState, ground_of, strides_of
from sim.engine.run_keys import check_seed, derive_keys, keys_of_places
from sim.engine.scenario_links import ENGINE_LINKS, key_rows, links_of, vehicles_with
from sim.engine.space_state import buildings_of, town_of
from sim.engine.world_state import (
    BatchState,
    BatchTables,
    batch_tables,
    disturbances_of,
    first_coverage,
    first_vehicles,
    world_parameters,
)
from sim.engine.world_tick import BEGIN, END, WHOLE, begin_world, begin_world_tick, end_world_tick
from sim.models.randomness import BUILDING_FIELDS, HAZARD_FIELDS, TEAM_LINK
from sim.models.trajectories import no_trajectories
from sim.scenario.building_tables import run_buildings
from sim.scenario.ground_tables import (
    first_corner,
    ground_tables,
    place_buildings,
    place_fields,
    world_tables,
)
from sim.scenario.safety import safety_parameters
from sim.scenario.types import Scenario

_START = 3
"""Start of a run, in place of a part of a tick."""


@released
def _run_worlds(
    tables: BatchTables,
    state: BatchState,
    ground: GroundState | None,
    worlds: IntArray,
    part: int,
    linked: bool,
    begin: int,
    end: int,
) -> None:
    """Start worlds, or advance them by one tick or a part of it."""
    for n in range(begin, end):
        if part == _START:
            begin_world(tables, state, ground, worlds[n])
            continue
        if part != END:
            begin_world_tick(tables, state, ground, worlds[n], linked)
        if part != BEGIN:
            end_world_tick(tables, state, ground, worlds[n])


def arrays_of(state: object) -> list[npt.NDArray[Any]]:
    """Return all arrays of a nested state."""
    if isinstance(state, tuple):
        return [array for part in state for array in arrays_of(part)]
    return [state] if isinstance(state, np.ndarray) else []


class Fresh:
    """Initial state of every world: a copy of the first world's arrays before the start."""

    def __init__(self, state: object) -> None:
        self._pairs = [(array, array[:1].copy()) for array in arrays_of(state) if array.size]

    def restore(self, worlds: IntArray) -> None:
        """Reset these worlds to the initial state."""
        for array, first in self._pairs:
            array[worlds] = first


class Batch:
    """Worlds of one scenario; call `begin` first.

    Args:
        scenario: Scenario of each world.
        worlds: Number of worlds.
        gains: True to compute the decrease of e(t) by each sensor update.
        threads: Processor cores for the worlds; by default all that this process may use.
        secret: Secret of all random numbers, combined with each world's seed; empty: none.
        others: Kinds of links in addition to detections and commands, which the engine handles.
        differ: True if worlds may differ from the scenario by `set_world`, which needs as much memory as it or less.

    Raises:
        ValueError: If `worlds` is below 1.
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
        differ: bool = False,
    ) -> None:
        if worlds < 1:
            raise ValueError(f"worlds = {worlds}: too few; allowed: 1 or more")
        self.scenario = scenario
        self.worlds = worlds
        self._secret = secret
        self.parameters = world_parameters(scenario, gains=gains)
        self.workers = WorkerThreads(threads)
        """Threads that share the worlds."""
        self._shared = self.workers.shares(worlds)
        self._all = np.arange(worlds)
        self.links = links_of(scenario, (*ENGINE_LINKS, *others), worlds)
        """Links for detections, for commands, then of the other kinds."""
        self._key_rows = key_rows(scenario, self.links)
        self.link_table = scenario.links
        """Current settings of the links, in the form of a scenario."""
        rows = worlds if differ else 1
        self.ground = ground_of(scenario, worlds, rows)
        """State of the ground; None: no hazards."""
        buildings = buildings_of(scenario, self.ground)
        self.tables = batch_tables(scenario, self.parameters, self.links.traces, rows)
        self.bodies = bodies_of(scenario, worlds, secret)
        """Bodies outside the compiled tick; None: there are none."""
        vehicles = first_vehicles(scenario)
        self.state = BatchState(
            ticks=np.zeros(worlds, dtype=np.int64),
            vehicles=np.repeat(vehicles[None], worlds, axis=0),
            coverage=np.repeat(first_coverage(scenario)[None], worlds, axis=0),
            trajectories=no_trajectories(worlds, len(vehicles), self._trajectory_rows()),
            flown=no_trajectories(worlds, len(vehicles), 1),
            links=self.links.records,
            buildings=buildings,
            town=town_of(scenario, buildings),
            packets=self.links.packets,
        )
        changing = self.ground._asdict() if self.ground is not None else {}
        changing |= self.state._asdict()
        # the buildings are rows of the ground; unused packet arrays are created with the links
        for constant in (*CONSTANTS, "buildings", "packets"):
            changing.pop(constant, None)
        self.fresh = Fresh(tuple(changing.values()))
        """Initial state of every world."""

    def _trajectory_rows(self) -> int:
        """Return the buffer size for pending backup trajectories of a receiver; 1 if there are none."""
        scenario = self.scenario
        delays = [safety_parameters(scenario, uav.name).max_command_delay for uav in scenario.uav]
        delays += [
            ugv_delay(scenario, ugv.name) for ugv in scenario.ugv if ugv_carries(scenario, ugv)
        ]
        return max((2 + first_tick_from(delay, scenario.dt) for delay in delays), default=1)

    def begin(
        self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None = None
    ) -> None:
        """Start worlds with new seeds.

        Args:
            seeds: Seed of each of these worlds.
            worlds: Indices of the worlds; all by default.
        """
        which = self.restore(seeds, worlds)
        self._run(which, _START)

    def restore(
        self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None
    ) -> IntArray:
        """Reset worlds to the initial state, with the keys of these seeds, before the first sensor update.

        Args:
            seeds, worlds: As in `begin`.

        Returns:
            Indices of the worlds.

        Raises:
            ValueError: If the number of seeds is wrong, or one is not a whole number from 0 to 2**53 - 1.
        """
        which = np.arange(self.worlds) if worlds is None else np.asarray(worlds, dtype=np.int64)
        given = [check_seed(seed) for seed in seeds]
        if self.link_table is not self.scenario.links:
            raise ValueError("worlds cannot be restarted: their links have been changed")
        if len(given) != which.size:
            raise ValueError(f"{len(given)} seeds for {which.size} worlds")
        self.fresh.restore(which)
        keys = derive_keys(given, len(self.scenario.vehicles), self._secret)
        self.state.vehicles["keys"][which] = keys.swapaxes(1, 2)
        purposes, vehicles = self._key_rows
        others = len(purposes) - purposes.count(TEAM_LINK)  # links of teams come last
        self.links.records["key"][which, :others] = keys[:, purposes[:others], vehicles[:others]]
        if others < len(purposes):
            places = [(TEAM_LINK, vehicle) for vehicle in vehicles[others:]]
            words = keys_of_places(given, places, self._secret)
            self.links.records["key"][which, others:] = words
        self._draw_ground(which)
        if self.bodies is not None:
            self.bodies.begin(self.state, which, given)
        return which

    def _draw_ground(self, worlds: IntArray) -> None:
        """Draw the buildings and hazards of the scenario's fields; they differ with every seed."""
        scenario, ground = self.scenario, self.ground
        if ground is None or not (scenario.building_field or scenario.hazard_field):
            return
        tables = ground_tables(scenario)
        for k in worlds.tolist():
            keys = self.state.vehicles["keys"][k, 0]
            own = world_tables(tables, ground.hazards[k], ground.corners, ground.tiles[k])
            if scenario.building_field:
                first, second = keys[BUILDING_FIELDS]
                buildings = run_buildings(scenario, (first, second))
                own = place_buildings(scenario, own, buildings, first_corner(scenario, tables, k))
            if scenario.hazard_field:
                first, second = keys[HAZARD_FIELDS]
                place_fields(scenario, own, (first, second))

    def set_world(self, world: int, scenario: Scenario) -> None:
        """Give a restored world the numbers of this scenario, which needs arrays of the same shapes."""
        own, vehicles = first_vehicles(scenario), self.state.vehicles[world]
        for name in ("max_speed", "max_acceleration", "delay_ticks", "interval_ticks"):
            vehicles[name] = own[name]
        parameters = world_parameters(scenario, gains=self.parameters.gains)
        fill(self.tables.world[world], parameters)
        self.tables.disturbances[world] = disturbances_of(scenario)
        self.links.set_world(
            world, [scenario.links.of(name, kind) for kind, name in self.links.names]
        )
        if self.ground is not None:
            self.ground.strides[world] = strides_of(scenario)

    def advance(self, *, linked: bool = True) -> None:
        """Advance all worlds by one tick under the outgoing commands, or under `command` of each vehicle.

        Args:
            linked: True if commands cross their links.
        """
        if self.bodies is None:
            self._run(self._all, WHOLE, linked=linked)
            return
        self._run(self._all, BEGIN, linked=linked)
        self.bodies.step(self.state, self._all)
        self._run(self._all, END, linked=linked)

    def _run(self, worlds: IntArray, part: int, *, linked: bool = True) -> None:
        given = self.tables, self.state, self.ground, worlds, part, linked
        if self._shared:
            self.workers.share(_run_worlds, len(worlds), *given)
        else:
            _run_worlds(*given, 0, len(worlds))

    def change_links(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Change the settings of links in all worlds, between two ticks; packets in transit keep their arrival time.

        Worlds cannot be restarted afterwards.

        Args:
            kind: Kind of the links.
            vehicle: Name of the vehicle; None: all with such a link.
            settings: New settings.

        Raises:
            ScenarioError: If the settings are invalid, or this vehicle has no such link.
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
