"""World: the true state of all vehicles and of the ground, as a named view of a batch of one.

Arrays have an axis for vehicles, in name order. One seed, one secret and the same commands give the same bits.
"""

from collections.abc import Sequence
from typing import Self

import numpy as np

from bus.messages.buildings import Building
from bus.messages.ground import TILE_LETTERS, MapUpdate, TileReport
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.telemetry import CoverageMap, MissionResult
from bus.messages.vehicle import BackupTrajectory, Detection, UgvReport
from sim.channel.link_records import ARRIVED
from sim.channel.links import Links
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.engine.batch import Batch
from sim.engine.ground_state import CONSTANTS, GroundState
from sim.engine.mission import keeps_clearance, mission_of, receive_block, record_claim
from sim.engine.run_keys import check_seed
from sim.engine.world_state import BatchState, BatchTables, world_parameters
from sim.engine.world_tick import measure
from sim.models.ground import (
    CERTIFIED,
    NO_CLAIM,
    PATH_UNKNOWN,
    UNCERTIFIED,
    TileArray,
    block_letters,
    tile_states,
)
from sim.models.kinematics import POINT
from sim.models.randomness import BUILDING_FIELDS
from sim.models.trajectories import NO_TRAJECTORY, keep_trajectory, received_trajectory
from sim.scenario.building_tables import run_buildings
from sim.scenario.types import LinkTable, Scenario
from sim.scenario.vehicle_types import Uav

_CODES = {text: code for code, text in UNCERTIFIED.items()}


class World:
    """True state of one run.

    Args:
        scenario: Scenario of the run.
        seed: Seed of all random numbers, together with the secret.
        secret: Secret of the run, as `sim.engine.run_keys.check_secret` returns it; empty: none.

    Raises:
        ValueError: If the seed is not a whole number from 0 to 2**53 - 1.
    """

    def __init__(self, scenario: Scenario, seed: int, *, secret: str = "") -> None:
        carried = (LinkKind.OPERATOR, LinkKind.RADIO, LinkKind.TEAM)
        batch = Batch(scenario, 1, threads=1, secret=secret, others=carried)
        batch.begin((seed,))
        self._show(batch, 0, check_seed(seed), scenario)

    @classmethod
    def of_batch(
        cls, batch: Batch, number: int, seed: int, scenario: Scenario | None = None
    ) -> Self:
        """Return a view of one world of a batch; the batch's owner advances it.

        Args:
            batch: The batch.
            number: Index of the world.
            seed: Seed of the world's random numbers.
            scenario: Scenario of the world; None: the batch's.
        """
        world = cls.__new__(cls)
        world._show(batch, number, seed, scenario or batch.scenario)
        return world

    def _show(self, batch: Batch, number: int, seed: int, scenario: Scenario) -> None:
        self.scenario, self.seed = scenario, seed
        self._batch, self._number = batch, number
        self.names: tuple[str, ...] = tuple(vehicle.name for vehicle in scenario.vehicles)
        """Names of the vehicles, in the order of every array."""
        self.uavs: tuple[Uav, ...] = tuple(
            vehicle for vehicle in scenario.vehicles if isinstance(vehicle, Uav)
        )
        self.robots = {} if batch.bodies is None else batch.bodies.reported(number)
        """Bodies that robots fly, by UAV; their processes report the true states."""
        self.parameters = world_parameters(scenario, gains=batch.parameters.gains)

    @property
    def tick(self) -> int:
        """Current tick."""
        return self._batch.state.ticks.item(self._number)

    @property
    def vehicles(self) -> RecordArray:
        """`sim.engine.world_state.Vehicle` of each vehicle. Shape (vehicles,)."""
        vehicles: RecordArray = self._batch.state.vehicles[self._number]
        return vehicles

    @property
    def escorts(self) -> IntArray:
        """Rows (UAV, UGV), one for each UAV, in name order. Shape (UAVs, 2)."""
        return self._batch.tables.escorts

    @property
    def position(self) -> FloatArray:
        """True positions [m]. Shape (vehicles, 2)."""
        return self.vehicles["position"]

    @property
    def velocity(self) -> FloatArray:
        """True velocities [m/s]. Shape (vehicles, 2)."""
        return self.vehicles["velocity"]

    @property
    def reference_position(self) -> FloatArray:
        """Reference positions [m]; without wind and position errors, the true ones. Shape (vehicles, 2)."""
        return self.vehicles["reference_position"]

    @property
    def reference_velocity(self) -> FloatArray:
        """Reference velocities [m/s]. Shape (vehicles, 2)."""
        return self.vehicles["reference_velocity"]

    @property
    def acceleration(self) -> FloatArray:
        """Accelerations applied in the last tick, after the bounds [m/s²]. Shape (vehicles, 2)."""
        return self.vehicles["acceleration"]

    @property
    def vertical(self) -> RecordArray:
        """`sim.models.altitude.VerticalState` of each vehicle. Shape (vehicles,)."""
        vertical: RecordArray = self.vehicles["vertical"]
        return vertical

    def heading(self, row: int) -> float | None:
        """Return the heading of a vehicle [rad]; None: it moves in any direction."""
        vehicle = self.vehicles[row]
        if vehicle["kinematics"]["kind"] == POINT:
            return None
        return float(vehicle["heading"])

    def headings(self) -> dict[str, float]:
        """Return the headings of the UGVs that steer [rad]."""
        found = ((name, self.heading(row)) for row, name in enumerate(self.names))
        return {name: heading for name, heading in found if heading is not None}

    def vertical_truth(self) -> dict[str, dict[str, float]]:
        """Return the fields of `VehicleTruth` of the vertical motion, by UAV; empty in the plane."""
        if not self.scenario.has_altitude:
            return {}
        rows = self.vertical[self.escorts[:, 0]]
        names = {
            "altitude": "altitude",
            "climb_rate": "rate",
            "vertical_acceleration": "acceleration",
        }
        return {
            uav.name: {field: float(row[column]) for field, column in names.items()}
            for uav, row in zip(self.uavs, rows, strict=True)
        }

    @property
    def commands(self) -> FloatArray:
        """Commands executed in the last tick, before the bounds [m/s²]. Shape (vehicles, 2)."""
        return self.vehicles["command"]

    @property
    def detections(self) -> FloatArray:
        """Relative position that each UAV has detected at this tick [m]; NaN: none. Shape (UAVs, 2)."""
        return self.vehicles["detection"][self.escorts[:, 0]]

    @property
    def coverage(self) -> FloatArray:
        """C of (3) on the grid, summed over all UAVs. Shape (rows, columns)."""
        coverage: FloatArray = self._batch.state.coverage[self._number]
        return coverage

    @property
    def ground(self) -> GroundState | None:
        """Ground in the form of a batch of one; None: no hazards."""
        ground, k = self._batch.ground, self._number
        if ground is None or self._batch.worlds == 1:
            return ground
        changing = (name for name in GroundState._fields if name not in CONSTANTS)
        return ground._replace(**{name: getattr(ground, name)[k : k + 1] for name in changing})

    @property
    def buildings(self) -> tuple[Building, ...]:
        """Buildings of the run; no vehicle receives them, except as a map that the scenario gives it."""
        first, second = self.vehicles["keys"][0, BUILDING_FIELDS]
        return run_buildings(self.scenario, (first, second))

    def move_to(self, tick: int) -> None:
        """Set the tick, without any other change."""
        self._batch.state.ticks[self._number] = tick

    @property
    def time(self) -> float:
        """Simulated time [s]: tick times dt, never a sum."""
        return self.tick * self.parameters.dt

    @property
    def links(self) -> Links:
        """All links of the run."""
        return self._batch.links

    @property
    def link_table(self) -> LinkTable:
        """Current settings of the links, in the form of a scenario."""
        return self._batch.link_table

    def change_links(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Change the settings of links; see `Batch.change_links`."""
        self._batch.change_links(kind, vehicle, settings)

    @property
    def arrays(self) -> tuple[BatchTables, BatchState]:
        """Tables and state of the batch, for compiled functions."""
        return self._batch.tables, self._batch.state

    def received(self, uav: int) -> tuple[Detection, ...]:
        """Return the detections that have reached a UAV's computer at this tick, in order of arrival."""
        state, dt = self._batch.state, self.parameters.dt
        k = self._number
        packets = state.packets[k, uav, ARRIVED, : state.links[k, uav]["arrived"]]
        if not packets.size:
            return ()
        rows = zip(packets["stamp"].tolist(), packets["vector"].tolist(), strict=True)
        return tuple(
            [Detection(time=stamp * dt, relative_position=(x, y)) for stamp, (x, y) in rows]
        )

    def send(
        self,
        vehicle: int,
        answered: int,
        acceleration: tuple[float, float],
        trajectories: Sequence[BackupTrajectory] = (),
        vertical: float = 0.0,
    ) -> None:
        """Send a vehicle's command to its actuators in the next tick; at most one per tick.

        Args:
            vehicle: Row of the vehicle.
            answered: Tick whose observation it answers.
            acceleration: Acceleration [m/s²].
            trajectories: Backup trajectories in the command, one per tick, oldest first. Without a receiver for them,
                the acceleration is executed.
            vertical: Vertical acceleration of a UAV with an altitude [m/s²].
        """
        row = self.vehicles[vehicle]
        row["outgoing_tick"], row["outgoing"] = answered, acceleration
        row["outgoing_trajectory"] = trajectories[-1].begins if trajectories else -1
        row["outgoing_trajectories"] = len(trajectories)
        row["vertical"]["outgoing"] = vertical
        kept = self._batch.state.trajectories[self._number, vehicle]
        for trajectory in trajectories:
            keep_trajectory(kept, received_trajectory(trajectory)[0], self.tick)

    def seen_ground(self, vehicle: int) -> tuple[TileReport, ...]:
        """Return the tiles that a vehicle's own sensor has reported since the previous tick."""
        ground = self.ground
        if ground is None:
            return ()
        columns = ground.tiles.shape[2]
        tiles = ground.seen[0, vehicle, : ground.report_counts.item(0, vehicle)].tolist()
        states = (ground.known.item(0, vehicle, *divmod(tile, columns)) for tile in tiles)
        return tuple(
            TileReport(tile % columns, tile // columns, TILE_LETTERS[state])
            for tile, state in zip(tiles, states, strict=True)
        )

    def discovered(self, uav: int) -> tuple[Building, ...]:
        """Return the buildings that a UAV has discovered in this tick."""
        state, k = self._batch.state, self._number
        buildings, town = state.buildings, state.town
        if buildings is None or town is None or not self.parameters.discovers:
            return ()
        rows, corners = buildings.hazards[k, buildings.first : buildings.end], buildings.corners
        return tuple(
            Building(
                polygon=tuple((x, y) for x, y in corners[first : first + count].tolist()),
                height=height,
            )
            for first, count, height in rows[town.found[k, uav] == self.tick][
                ["first", "corners", "height"]
            ].tolist()
        )

    def receive_block(self, vehicle: int, block: MapUpdate) -> None:
        """Record a map update that a UGV has received by radio, to measure warning times."""
        if self.ground is not None:
            n = int(np.flatnonzero(self.ground.ugvs == vehicle)[0])
            receive_block(
                self.ground, 0, n, self.tick, (block.row, block.column), tile_states(block.tiles)
            )

    @property
    def mission(self) -> MissionResult | None:
        """Mission results of the UGVs so far; None: no hazards."""
        if self.ground is None:
            return None
        names = [self.names[k] for k in self.ground.ugvs]
        goal_rows = self._batch.tables.goal_rows
        return mission_of(goal_rows, self.ground, 0, self.parameters.dt, names)

    def record_claim(self, vehicle: int, report: UgvReport | None) -> None:
        """Record a UGV's claim at this tick to stay on known tiles; None: no claim."""
        if self.ground is None:
            return
        claim = NO_CLAIM
        if report is not None:
            claim = CERTIFIED if report.certified else _CODES.get(report.uncertified, PATH_UNKNOWN)
        ugv = int(np.flatnonzero(self.ground.ugvs == vehicle)[0])
        record_claim(self.ground.missions[0], ugv, claim)

    def guarantee_clearance(self, vehicle: int, *, kept: bool) -> None:
        """Set whether the driver in control of a UGV guarantees its distance from buildings."""
        if self.ground is not None:
            self.ground.clearances["guaranteed"][self.ground.ugvs == vehicle] = kept

    def keeps_clearance(self, uav: int) -> bool:
        """Return whether a UAV's UGV keeps the distance from buildings that certificates assume."""
        if self.ground is None:
            return True
        ugv = int(np.flatnonzero(self.ground.ugvs == self.escorts[uav, 1])[0])
        return bool(keeps_clearance(self.ground.clearances, self.ground.missions[0], ugv))

    @property
    def tiles(self) -> TileArray:
        """True state of each tile of the ground. Shape (rows, columns), (0, 0) without hazards."""
        return np.zeros((0, 0), np.uint8) if self.ground is None else self.ground.tiles[0]

    def known_block(self, vehicle: int, row: int, column: int) -> str:
        """Return a block of tiles as reported by a vehicle's own sensor, as `TILE_LETTERS`; unknown beyond the area."""
        known = self.tiles if self.ground is None else self.ground.known[0, vehicle]
        return block_letters(known, row, column)

    def flown(self, vehicle: int) -> int | None:
        """Return the first tick of the trajectory that a vehicle executes; None: no trajectory."""
        begins = int(self._batch.state.flown[self._number, vehicle, 0]["begins"])
        return None if begins == NO_TRAJECTORY else begins

    def advance(self) -> None:
        """Advance by one tick: send the commands; each vehicle executes the newest one that has arrived.

        Without one, the last command stays in effect for a while; then the vehicle brakes.
        """
        self._batch.advance(linked=True)

    def step(self, commands: FloatArray) -> None:
        """Advance by one tick in which all vehicles execute these commands, independent of the links.

        Args:
            commands: Accelerations [m/s²], shape (vehicles, 2), float64, finite; the bounds of (1) are applied here.
        """
        self.commands[:] = commands
        self._batch.advance(linked=False)

    def measure(self) -> FloatArray:
        """Measure the distance [m], and e(t) (4) with the true p_g [m²], of each escort at this tick.

        Shape (UAVs, 2). Separate from the tick, because it is needed only after the vehicles have responded.
        """
        tables, state = self.arrays
        measure(tables, state, self._number, True)
        uavs = self.vehicles[self.escorts[:, 0]]
        return np.stack((uavs["distance"], uavs["coverage_error"]), axis=1)

    def coverage_map(self, scratch: FloatArray | None = None) -> CoverageMap:
        """Return the coverage for observers, one byte per cell: 255 is fully covered.

        Args:
            scratch: Array of the grid's shape; changed. Without it one is allocated, which costs more than the
                computation.
        """
        rows, columns = self.coverage.shape
        share = np.multiply(self.coverage, 255.0 / self.parameters.desired, out=scratch)
        cells = np.minimum(share, 255.0, out=share).astype(np.uint8).tobytes()
        return CoverageMap(
            tick=self.tick, rows=rows, columns=columns, cell=self.parameters.cell, cells=cells
        )
