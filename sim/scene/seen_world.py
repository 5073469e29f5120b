"""One world of many as pictures read it."""

import numpy as np

from sim.engine.batch import Batch
from sim.engine.ground_state import CONSTANTS, GroundState
from sim.engine.world_tick import measure
from sim.kernels.compile import FloatArray


class SeenWorld:
    """World k of a batch, with the attributes of `sim.world.World` that a picture needs; it stays up to date.

    Args:
        batch: The batch.
        k: The number of the world.
    """

    def __init__(self, batch: Batch, k: int) -> None:
        self._batch, self._k = batch, k
        self.scenario = batch.scenario
        self.parameters = batch.parameters
        self.names = tuple(vehicle.name for vehicle in batch.scenario.vehicles)
        self.escorts = batch.tables.escorts

    @property
    def ground(self) -> GroundState | None:
        """The ground as that of a batch of one; None if there are no hazards."""
        ground, k = self._batch.ground, self._k
        if ground is None:
            return None
        changing = (name for name in GroundState._fields if name not in CONSTANTS)
        return ground._replace(**{name: getattr(ground, name)[k : k + 1] for name in changing})

    @property
    def position(self) -> FloatArray:
        """True positions [m]. Shape (vehicles, 2)."""
        position: FloatArray = self._batch.state.vehicles["position"][self._k]
        return position

    @property
    def coverage(self) -> FloatArray:
        """C of (3) on the grid. Shape (rows, columns)."""
        coverage: FloatArray = self._batch.state.coverage[self._k]
        return coverage

    @property
    def tick(self) -> int:
        """The tick that it is at."""
        return int(self._batch.state.ticks[self._k])

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.tick * self.parameters.dt

    def measure(self) -> FloatArray:
        """Distance [m] and e(t) (4) [m²] of each UAV at this tick. Shape (UAVs, 2)."""
        tables, state = self._batch.tables, self._batch.state
        measure(tables.world, state.vehicles, tables.escorts, state.coverage, self._k, True)
        uavs = state.vehicles[self._k, self.escorts[:, 0]]
        return np.stack((uavs["distance"], uavs["coverage_error"]), axis=1)
