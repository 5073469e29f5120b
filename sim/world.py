"""The world: the true state of all vehicles and of the ground. A batch of one, with names.

Arrays have an axis for vehicles, in name order. One seed, one secret and the same commands give the same bits.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bus.messages import (
    TILE_LETTERS,
    CoverageMap,
    Detection,
    GroundBlock,
    LinkKind,
    LinkSettings,
    Mission,
    MotionPlan,
    SeenTile,
    UgvReport,
)
from sim.channel.link_records import ARRIVED
from sim.channel.links import Links
from sim.engine.batch import Batch
from sim.engine.mission import mission_of, note_claim, receive_block
from sim.engine.world_state import (
    COMMAND,
    BatchState,
    BatchTables,
    Told,
    WorldState,
)
from sim.engine.world_tick import measure
from sim.kernels.compile import FloatArray, entry_point
from sim.kernels.packing import NUMBER, writer
from sim.models.ground import (
    CERTIFIED,
    NO_CLAIM,
    UNCERTIFIED,
    WAY_UNKNOWN,
    TileArray,
    block_letters,
    tile_states,
)
from sim.models.motion import NO_MOTION, keep_motion, motion_row
from sim.scenario.types import LinkTable, Scenario, Uav

_KEPT = ("scenario", "seed", "_batch", "names", "uavs", "parameters", "tick")
"""The attributes that a copy takes over; it makes views of its own."""

_ROW = len(COMMAND) * NUMBER
"""Bytes of a command."""
_write_command, _write_carried = writer(COMMAND.last), writer(2)
"""The numbers of a `CommandRow`: those that every command has, and those of one that carries motions."""

_CODES = {words: code for code, words in UNCERTIFIED.items()}


class World:
    """The true state of one run.

    Args:
        scenario: What is flown.
        seed: Of all random numbers, with the secret.
        secret: Of the run, as `sim.engine.run_keys.check_secret` returns it; empty: none.
        gains: Whether the fall of e(t) by each look is counted, in `state.gains`.
    """

    def __init__(
        self, scenario: Scenario, seed: int, *, secret: str = "", gains: bool = False
    ) -> None:
        self.scenario = scenario
        self.seed = seed
        carried = (LinkKind.OPERATOR, LinkKind.RADIO)
        self._batch = Batch(scenario, 1, gains=gains, threads=1, secret=secret, others=carried)
        self._batch.begin((seed,))
        self.names: tuple[str, ...] = tuple(vehicle.name for vehicle in scenario.vehicles)
        """Vehicles in the order of every array."""
        self.uavs: tuple[Uav, ...] = tuple(
            vehicle for vehicle in scenario.vehicles if isinstance(vehicle, Uav)
        )
        self.parameters = self._batch.parameters
        self.tick = 0
        """The tick that it is at; `move_to` changes it."""
        self._bind()

    def _bind(self) -> None:
        """Name the batch's arrays: views, which stay the same ones."""
        state, tables = self._batch.state, self._batch.tables
        self._sent, self._motions = state.sent[0], state.motions[0]
        self._begun = state.flown["begins"][0, :, 0]
        self.carries = bool(tables.receivers.any())
        """True if a vehicle flies the motions that its commands carry."""
        self.escorts = tables.escorts
        """Rows (UAV, UGV), one for each UAV, in name order."""
        self.bounds = tables.bounds
        """v_max [m/s] and u_max [m/s²] of each vehicle."""
        self.state = WorldState._make(array[0] for array in state.truth)
        """Everything that is true but for the links."""
        self.position = self.state.position
        """Positions [m], shape (vehicles, 2)."""
        self.velocity = self.state.velocity
        """Velocities [m/s], shape (vehicles, 2)."""
        self.acceleration = self.state.acceleration
        """Accelerations that were applied in the last tick, after their bounds [m/s²], shape (vehicles, 2)."""
        self.told = Told(state.told.position[0], state.told.velocity[0])
        """The positions that the vehicles are told: where their commands lead. Without wind and own_error, the truth.
        """
        self.coverage = self.state.coverage
        """C of (3) on the grid, all UAVs together. Shape (rows, columns)."""
        self.detections = self.state.detections
        """The relative position each UAV has detected at this tick [m]; NaN where none. Shape (UAVs, 2)."""
        self.commands: FloatArray = self.state.commands
        """The commands that acted in the last tick, before the bounds [m/s²], shape (vehicles, 2)."""
        measured = self.position, self.escorts, self.coverage, self.state.measures
        self._measured = tables.world, *measured, True

    @functools.cached_property
    def _measure(self) -> Callable[..., None]:
        return entry_point(measure, *self._measured)

    def __getstate__(self) -> dict[str, Any]:
        return {name: self.__dict__[name] for name in _KEPT}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept)
        self._bind()

    def move_to(self, tick: int) -> None:
        """Be at another tick, with everything as it is."""
        self.tick = self._batch.state.ticks[0] = tick

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
        packets = state.packets[0, uav, ARRIVED, : state.links[0, uav]["arrived"]]
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
        motions: Sequence[MotionPlan] = (),
    ) -> None:
        """A vehicle's command sets out to its actuators in the coming tick; one a tick.

        Args:
            vehicle: Its row in every array.
            answered: The tick whose observation it answers.
            acceleration: [m/s²]
            motions: That it carries, one a tick, the oldest first. Without a receiver for them the acceleration acts.
        """
        row = vehicle * _ROW
        u_x, u_y = acceleration
        _write_command(self._sent, row, answered, u_x, u_y)
        if self.carries:
            last = motions[-1].begins if motions else -1
            _write_carried(self._sent, row + COMMAND.last * NUMBER, last, len(motions))
            for motion in motions:
                keep_motion(self._motions[vehicle], motion_row(motion)[0], self.tick)

    def seen_ground(self, vehicle: int) -> tuple[SeenTile, ...]:
        """The tiles of which a vehicle's own sensor has told since the tick before."""
        ground = self._batch.state.ground
        if not ground.told.size:
            return ()
        columns = ground.tiles.shape[2]
        places = ground.seen[0, vehicle, : ground.told.item(0, vehicle)].tolist()
        states = (ground.known.item(0, vehicle, *divmod(place, columns)) for place in places)
        return tuple(
            SeenTile(place % columns, place // columns, TILE_LETTERS[state])
            for place, state in zip(places, states, strict=True)
        )

    def receive_block(self, vehicle: int, block: GroundBlock) -> None:
        """A UGV is told of a block of tiles by radio: for measuring how long before it knew of what was on its way."""
        tables, state = self.arrays
        n = int(np.flatnonzero(tables.ground.ugvs == vehicle)[0])
        told = tables.ground, state.ground, state.mission, 0, n, self.tick
        receive_block(*told, (block.row, block.column), tile_states(block.tiles))

    @property
    def mission(self) -> Mission | None:
        """The UGVs' way through so far; None where there are no hazards."""
        tables, state = self.arrays
        if not len(tables.ground.parameters):
            return None
        told = tables.mission, state.ground, state.mission, 0, self.parameters.dt
        names = [self.names[k] for k in tables.ground.ugvs]
        return mission_of(*told, names)

    def note_claim(self, vehicle: int, report: UgvReport | None) -> None:
        """Take in what a UGV claims at this tick of staying on tiles that it knows; None: nothing."""
        tables, state = self.arrays
        if not len(tables.ground.parameters):
            return
        claim = NO_CLAIM
        if report is not None:
            claim = CERTIFIED if report.certified else _CODES.get(report.uncertified, WAY_UNKNOWN)
        ugv = int(np.flatnonzero(tables.ground.ugvs == vehicle)[0])
        note_claim(state.mission.ugvs[0], ugv, claim)

    @property
    def tiles(self) -> TileArray:
        """The true state of each tile of the ground; none where there are no hazards. Shape (rows, columns)."""
        tiles: TileArray = self._batch.state.ground.tiles[0]
        return tiles

    def known_block(self, vehicle: int, row: int, column: int) -> str:
        """A block of tiles as a vehicle's own sensor has told them, by `TILE_LETTERS`; not seen beyond the area."""
        return block_letters(self._batch.state.ground.known[0, vehicle], row, column)

    def flown(self, vehicle: int) -> int | None:
        """The motion that a vehicle flies, by the tick in which it began; None: none."""
        begins = self._begun.item(vehicle) if self.carries else NO_MOTION
        return begins if begins >= 0 else None

    def advance(self) -> None:
        """Advance by one tick: what was sent sets out, and each vehicle acts on its newest command that has arrived.

        Where none comes, the last one is held for a while; then the vehicle brakes.
        """
        self._batch.advance(linked=True)
        self.tick += 1

    def step(self, commands: FloatArray) -> None:
        """Advance by one tick in which everybody acts on these commands, whatever the links do.

        Args:
            commands: Accelerations [m/s²], shape (vehicles, 2), float64, finite; the bounds of (1) are applied here.
        """
        self.commands[:] = commands
        self._batch.advance(linked=False)
        self.tick += 1

    def measure(self) -> FloatArray:
        """Distance [m] and e(t) (4) with the true p_g [m²] of each escort at this tick.

        Shape (UAVs, 2); a view, overwritten next time.

        Apart from the tick, because nobody needs it before the vehicles have answered.
        """
        self._measure(*self._measured)
        return self.state.measures

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
