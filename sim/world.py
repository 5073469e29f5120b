"""The world: the true state of all vehicles and of the ground. A batch of one, with names.

Arrays have an axis for vehicles, in name order. One seed, one secret and the same commands give the same bits.
"""

from collections.abc import Sequence
from typing import Self

import numpy as np

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
from sim.engine.mission import mission_of, note_claim, receive_block
from sim.engine.world_state import BatchState, BatchTables
from sim.engine.world_tick import measure
from sim.models.ground import (
    CERTIFIED,
    NO_CLAIM,
    UNCERTIFIED,
    WAY_UNKNOWN,
    TileArray,
    block_letters,
    tile_states,
)
from sim.models.motion import NO_MOTION, keep_motion, received_motion
from sim.scenario.types import LinkTable, Scenario, Uav

_CODES = {words: code for code, words in UNCERTIFIED.items()}


class World:
    """The true state of one run.

    Args:
        scenario: What is flown.
        seed: Of all random numbers, with the secret.
        secret: Of the run, as `sim.engine.run_keys.check_secret` returns it; empty: none.
    """

    def __init__(self, scenario: Scenario, seed: int, *, secret: str = "") -> None:
        carried = (LinkKind.OPERATOR, LinkKind.RADIO)
        batch = Batch(scenario, 1, threads=1, secret=secret, others=carried)
        batch.begin((seed,))
        self._show(batch, 0, seed)

    @classmethod
    def of_batch(cls, batch: Batch, number: int, seed: int) -> Self:
        """View one world of a batch, as it is at any time; the batch's owner advances it.

        Args:
            batch: The batch.
            number: Of the world.
            seed: Of the world's random numbers.
        """
        world = cls.__new__(cls)
        world._show(batch, number, seed)
        return world

    def _show(self, batch: Batch, number: int, seed: int) -> None:
        scenario = batch.scenario
        self.scenario, self.seed = scenario, seed
        self._batch, self._number = batch, number
        self.names: tuple[str, ...] = tuple(vehicle.name for vehicle in scenario.vehicles)
        """Vehicles in the order of every array."""
        self.uavs: tuple[Uav, ...] = tuple(
            vehicle for vehicle in scenario.vehicles if isinstance(vehicle, Uav)
        )
        self.parameters = self._batch.parameters

    @property
    def tick(self) -> int:
        """The tick that it is at."""
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
        """Positions to which the commands lead [m]; without wind and errors of the own position, the true ones."""
        return self.vehicles["reference_position"]

    @property
    def reference_velocity(self) -> FloatArray:
        """Velocities to which the commands lead [m/s]."""
        return self.vehicles["reference_velocity"]

    @property
    def acceleration(self) -> FloatArray:
        """Accelerations applied in the last tick, after their bounds [m/s²]. Shape (vehicles, 2)."""
        return self.vehicles["acceleration"]

    @property
    def commands(self) -> FloatArray:
        """Commands that acted in the last tick, before the bounds [m/s²]. Shape (vehicles, 2)."""
        return self.vehicles["command"]

    @property
    def detections(self) -> FloatArray:
        """Relative position that each UAV has detected at this tick [m]; NaN: none. Shape (UAVs, 2)."""
        return self.vehicles["detection"][self.escorts[:, 0]]

    @property
    def coverage(self) -> FloatArray:
        """C of (3) on the grid, all UAVs together. Shape (rows, columns)."""
        coverage: FloatArray = self._batch.state.coverage[self._number]
        return coverage

    @property
    def ground(self) -> GroundState | None:
        """The ground as that of a batch of one; None if there are no hazards."""
        ground, k = self._batch.ground, self._number
        if ground is None or self._batch.worlds == 1:
            return ground
        changing = (name for name in GroundState._fields if name not in CONSTANTS)
        return ground._replace(**{name: getattr(ground, name)[k : k + 1] for name in changing})

    def move_to(self, tick: int) -> None:
        """Be at another tick, with everything as it is."""
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
        """The links' settings now, as a scenario would write them."""
        return self._batch.link_table

    def change_links(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Give links other settings; see `Batch.change_links`."""
        self._batch.change_links(kind, vehicle, settings)

    @property
    def arrays(self) -> tuple[BatchTables, BatchState]:
        """The batch of one, for compiled functions."""
        return self._batch.tables, self._batch.state

    def received(self, uav: int) -> tuple[Detection, ...]:
        """The detections that have reached a UAV's computer at this tick, in the order of arrival."""
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
        motions: Sequence[BackupTrajectory] = (),
    ) -> None:
        """A vehicle's command sets out to its actuators in the coming tick; one a tick.

        Args:
            vehicle: Its row in every array.
            answered: The tick whose observation it answers.
            acceleration: [m/s²]
            motions: That it carries, one a tick, the oldest first. Without a receiver for them the acceleration acts.
        """
        row = self.vehicles[vehicle]
        row["outgoing_tick"], row["outgoing"] = answered, acceleration
        row["outgoing_motion"] = motions[-1].begins if motions else -1
        row["outgoing_motions"] = len(motions)
        kept = self._batch.state.motions[self._number, vehicle]
        for motion in motions:
            keep_motion(kept, received_motion(motion)[0], self.tick)

    def seen_ground(self, vehicle: int) -> tuple[TileReport, ...]:
        """The tiles of which a vehicle's own sensor has told since the tick before."""
        ground = self.ground
        if ground is None:
            return ()
        columns = ground.tiles.shape[2]
        places = ground.seen[0, vehicle, : ground.told.item(0, vehicle)].tolist()
        states = (ground.known.item(0, vehicle, *divmod(place, columns)) for place in places)
        return tuple(
            TileReport(place % columns, place // columns, TILE_LETTERS[state])
            for place, state in zip(places, states, strict=True)
        )

    def receive_block(self, vehicle: int, block: MapUpdate) -> None:
        """A UGV is told of a block of tiles by radio: for measuring how long before it knew of what was on its way."""
        if self.ground is not None:
            n = int(np.flatnonzero(self.ground.ugvs == vehicle)[0])
            place = block.row, block.column
            receive_block(self.ground, 0, n, self.tick, place, tile_states(block.tiles))

    @property
    def mission(self) -> MissionResult | None:
        """The UGVs' way through so far; None where there are no hazards."""
        if self.ground is None:
            return None
        names = [self.names[k] for k in self.ground.ugvs]
        goal_rows = self._batch.tables.goal_rows
        return mission_of(goal_rows, self.ground, 0, self.parameters.dt, names)

    def note_claim(self, vehicle: int, report: UgvReport | None) -> None:
        """Take in what a UGV claims at this tick of staying on tiles that it knows; None: nothing."""
        if self.ground is None:
            return
        claim = NO_CLAIM
        if report is not None:
            claim = CERTIFIED if report.certified else _CODES.get(report.uncertified, WAY_UNKNOWN)
        ugv = int(np.flatnonzero(self.ground.ugvs == vehicle)[0])
        note_claim(self.ground.missions[0], ugv, claim)

    @property
    def tiles(self) -> TileArray:
        """True state of each tile of the ground. Shape (rows, columns), (0, 0) without hazards."""
        return np.zeros((0, 0), np.uint8) if self.ground is None else self.ground.tiles[0]

    def known_block(self, vehicle: int, row: int, column: int) -> str:
        """A block of tiles as a vehicle's own sensor has told them, by `TILE_LETTERS`; not seen beyond the area."""
        known = self.tiles if self.ground is None else self.ground.known[0, vehicle]
        return block_letters(known, row, column)

    def flown(self, vehicle: int) -> int | None:
        """The motion that a vehicle flies, by the tick in which it began; None: none."""
        begins = int(self._batch.state.flown[self._number, vehicle, 0]["begins"])
        return None if begins == NO_MOTION else begins

    def advance(self) -> None:
        """Advance by one tick: what was sent sets out, and each vehicle acts on its newest command that has arrived.

        Where none comes, the last one is held for a while; then the vehicle brakes.
        """
        self._batch.advance(linked=True)

    def step(self, commands: FloatArray) -> None:
        """Advance by one tick in which everybody acts on these commands, whatever the links do.

        Args:
            commands: Accelerations [m/s²], shape (vehicles, 2), float64, finite; the bounds of (1) are applied here.
        """
        self.commands[:] = commands
        self._batch.advance(linked=False)

    def measure(self) -> FloatArray:
        """Distance [m] and e(t) (4) with the true p_g [m²] of each escort at this tick.

        Shape (UAVs, 2). Apart from the tick, because nobody needs it before the vehicles have answered.
        """
        tables, state = self.arrays
        measure(tables.world, state.vehicles, tables.escorts, state.coverage, self._number, True)
        uavs = self.vehicles[self.escorts[:, 0]]
        return np.stack((uavs["distance"], uavs["coverage_error"]), axis=1)

    def coverage_map(self, scratch: FloatArray | None = None) -> CoverageMap:
        """The coverage for observers, a byte a cell: 255 where nothing is left to be seen.

        Args:
            scratch: As large as the grid, changed; without it an array is made, which costs more than the sums in it.
        """
        rows, columns = self.coverage.shape
        share = np.multiply(self.coverage, 255.0 / self.parameters.desired, out=scratch)
        cells = np.minimum(share, 255.0, out=share).astype(np.uint8).tobytes()
        return CoverageMap(
            tick=self.tick, rows=rows, columns=columns, cell=self.parameters.cell, cells=cells
        )
