"""Adapter of the compiled drivers for a single vehicle.

Drivers that depend on an operator or on a policy have no compiled form.
"""

from typing import Any, NamedTuple

import numpy as np

from agents.drivers.building_map import map_buildings
from agents.drivers.dispatch import chosen_driver, drive
from agents.drivers.parameters import DriverInputs, driver_parameters
from agents.drivers.pending_stops import PLAIN
from agents.drivers.planning import path_corners
from agents.drivers.steering import own_state
from agents.drivers.tile_map import (
    EXTRA_ROWS,
    IndexArray,
    OccupancyGrid,
    forget_plan,
    forget_sent,
    occupancy_grid,
    record_block,
    record_tiles,
)
from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.ground import MOST_CORNERS
from bus.messages.vehicle import (
    MOST_CARRIED,
    BackupTrajectory,
    UgvBriefing,
    UgvObservation,
    UgvReport,
)
from bus.numbers import exact
from bus.ticks import detection_array, detection_rows, first_tick_from
from sim.compiling.compile import FloatArray
from sim.compiling.records import struct_of
from sim.models.ground import CERTIFIED, NO_CLAIM, UNCERTIFIED, tile_index, tile_states, tiles_shape
from sim.models.hazards import TOUCH
from sim.models.trajectories import NO_TRAJECTORY

MOST_TILES = 1_000_000
"""Largest number of tiles in a UGV's occupancy grid."""


class Route(NamedTuple):
    """Goals and scripted velocities of a UGV."""

    goals: FloatArray
    """Waypoints [m], in order. Shape (goals, 2)."""
    script: FloatArray
    """First tick, v_x and v_y [m/s] of each step, in the order of time. Shape (steps, 3)."""


def briefed_route(briefing: UgvBriefing) -> Route:
    """Return the goals and the script of a briefing; of two steps at the same time, the later in the list wins."""
    steps = sorted(briefing.script, key=lambda step: step.time)
    script = [(first_tick_from(step.time, briefing.dt), *step.velocity) for step in steps]
    return Route(
        goals=np.array(briefing.goals, dtype=np.float64).reshape(-1, 2),
        script=np.array(script, dtype=np.float64).reshape(-1, 3),
    )


def pending_rows(briefing: UgvBriefing) -> int:
    """Return the number of pending commands in the occupancy grid of a UGV: the command delay in ticks, plus 2."""
    ground = briefing.ground
    return EXTRA_ROWS + (0 if ground is None else first_tick_from(ground.delay, briefing.dt))


def briefed_grid(briefing: UgvBriefing) -> OccupancyGrid:
    """Return the initial occupancy grid of a UGV, with the known buildings; without tiles if there are no hazards.

    Raises:
        ScenarioError: If the area has too many tiles.
    """
    ground, area = briefing.ground, briefing.area
    if ground is None:
        return occupancy_grid(0, 0)
    shape = tiles_shape(area.width, area.height, ground.tile)
    if shape[0] * shape[1] > MOST_TILES:
        raise ScenarioError(
            f"ground.tile = {exact(ground.tile)}: divides the area into {shape[0] * shape[1]:,} tiles; "
            f"allowed: at most {MOST_TILES:,}"
        )
    kept = ground.tile_clearance
    memory = occupancy_grid(
        *shape,
        pending_rows(briefing) - EXTRA_ROWS,
        clearance=(kept + TOUCH) / ground.tile if kept > 0.0 else -1.0,
    )
    map_buildings(memory, briefing)
    return memory


def update_grid(memory: OccupancyGrid, observation: UgvObservation) -> None:
    """Update the occupancy grid from the map updates and tile reports of an observation."""
    for block in observation.map_updates:
        record_block(memory, block.row, block.column, tile_states(block.tiles))
    if observation.tile_reports:
        positions = np.array(
            [(one.row, one.column) for one in observation.tile_reports], dtype=np.int64
        )
        states = tile_states("".join(one.state for one in observation.tile_reports))
        rows, columns = np.ascontiguousarray(positions.T)
        record_tiles(memory, rows, columns, states)


class CompiledDriver:
    """Driver that runs a compiled driver file.

    Args:
        briefing: Briefing of the UGV.
        name: Name of the driver, a row of the registry with a file.
        grid: Occupancy grid of the vehicle, which its pilot updates; the driver keeps its tiles and forgets its plan.
            None: the driver's own, updated in `drive`.

    Raises:
        ScenarioError: If the driver has no compiled form, or the area has too many tiles.
    """

    def __init__(
        self, briefing: UgvBriefing, name: str, *, grid: OccupancyGrid | None = None
    ) -> None:
        self.parameters = driver_parameters(briefing, name)
        """Parameters of the driver, as its file declares them."""
        self._chosen, self._name = chosen_driver(briefing, name, self.parameters), name
        self._owns_grid = grid is None
        self.ground = briefed_grid(briefing) if grid is None else grid
        """Occupancy grid; without tiles if there are no hazards."""
        forget_plan(self.ground)
        self._route, self._dt = briefed_route(briefing), float(briefing.dt)
        self._executes_trajectories = (
            briefing.ground is not None and briefing.ground.executes_trajectories
        )

    @property
    def memory(self) -> Any:  # noqa: ANN401 - the driver's own record
        """Memory record of the driver."""
        return self._chosen.memory[self._name][0]

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """Return the acceleration [m/s²] for this observation."""
        if self._owns_grid:
            update_grid(self.ground, observation)
        committed = (
            NO_TRAJECTORY
            if observation.committed_trajectory is None
            else observation.committed_trajectory
        )
        radio = detection_array(detection_rows(observation.radio, self._dt))
        inputs = DriverInputs(
            tick=observation.tick,
            own=own_state(observation),
            goals=self._route.goals,
            script=self._route.script,
            radio=radio,
            received=len(radio),
            ground=self.ground if self.ground.tiles.size else None,
            committed=committed if self._executes_trajectories else PLAIN,
        )
        u_x, u_y = drive(self._chosen, inputs)
        return u_x, u_y


class NavigateDriver(CompiledDriver):
    """Driver that navigates between goals over the known ground, see `agents.drivers.navigate`."""

    def __init__(
        self, briefing: UgvBriefing, name: str = "navigate", *, grid: OccupancyGrid | None = None
    ) -> None:
        super().__init__(briefing, name, grid=grid)
        self._plans = 0
        self._reported: tuple[Vector, ...] = ()
        self._corners: IndexArray = np.zeros(MOST_CORNERS, dtype=np.int32)

    def backup_trajectories(self, tick: int) -> tuple[BackupTrajectory, ...]:
        """Return the backup trajectories of this tick's command: its own, and earlier ones that may still begin."""
        if not self._executes_trajectories:
            return ()
        sent = self.ground.sent
        last = tick + len(sent) - 2
        first = max(tick, last - MOST_CARRIED + 1)
        rows = [sent[begins % len(sent)] for begins in range(first, last + 1)]
        return tuple(
            struct_of(BackupTrajectory, row)
            for begins, row in zip(range(first, last + 1), rows, strict=True)
            if row["begins"] == begins
        )

    def report(self) -> UgvReport | None:
        """Return the certificate of this tick's command; None if the UGV is never certified."""
        claim = int(self.ground.flags[0]["claim"])
        if claim == NO_CLAIM:
            return None
        return UgvReport(certified=claim == CERTIFIED, uncertified=UNCERTIFIED.get(claim, ""))

    def forget_commands(self) -> None:
        """Forget the commands so far: they were not sent, or another process sent them."""
        forget_sent(self.ground)

    def new_route(self, position: Vector) -> tuple[Vector, ...] | None:
        """Return the corners of the planned path from a position to the goal [m], for observers; empty without a path.

        Args:
            position: Position of the UGV [m].

        Returns:
            None if the path has not changed since the last call, except for the part already driven.
        """
        memory, tile = self.ground, self.parameters.tile
        flags = memory.flags[0]
        if flags["plans"] == self._plans:
            return None
        self._plans = int(flags["plans"])
        (rows, columns), route = memory.tiles.shape, self._route
        goal_x, goal_y = route.goals[flags["goal"]].tolist()
        start, goal = (
            tile_index(y, tile, rows) * columns + tile_index(x, tile, columns)
            for x, y in (position, (goal_x, goal_y))
        )
        count = path_corners(memory.path, columns, start, self._corners)
        turns = self._corners[:count].tolist()
        ahead = [((n % columns + 0.5) * tile, (n // columns + 0.5) * tile) for n in turns[1:]]
        if turns and turns[-1] == goal:
            ahead[-1:] = [(goal_x, goal_y)]
        if tuple(ahead) == self._reported[len(self._reported) - len(ahead) :] and (
            ahead or not self._reported
        ):
            return None
        self._reported = tuple(ahead)
        return (position, *ahead) if ahead else ()
