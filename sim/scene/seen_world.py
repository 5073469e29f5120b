"""One world of many as pictures read it."""

from typing import Any

import numpy as np

from sim.engine.batch import Batch
from sim.engine.world_state import BatchState, BatchTables
from sim.engine.world_tick import measure
from sim.kernels.compile import FloatArray


def _of_world(state: Any, k: int) -> Any:  # noqa: ANN401 - arrays, however deep
    """The state of one world as that of a batch of one: views."""
    if isinstance(state, np.ndarray):
        return state[k : k + 1]
    return state._make(_of_world(part, k) for part in state)


class SeenWorld:
    """World k of a batch, with the attributes of `sim.world.World` that a picture needs; it stays up to date.

    Args:
        batch: Of which.
        k: Which.
    """

    def __init__(self, batch: Batch, k: int) -> None:
        self.scenario = batch.scenario
        self.parameters = batch.parameters
        self.names = tuple(vehicle.name for vehicle in batch.scenario.vehicles)
        state: BatchState = _of_world(batch.state, k)
        self.arrays: tuple[BatchTables, BatchState] = batch.tables, state
        """As a batch of one."""
        self.escorts = batch.tables.escorts
        self.position = state.truth.position[0]
        self.coverage = state.truth.coverage[0]

    @property
    def tick(self) -> int:
        """The tick that it is at."""
        return int(self.arrays[1].ticks[0])

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.tick * self.parameters.dt

    def measure(self) -> FloatArray:
        """Distance [m] and e(t) (4) [m²] of each UAV at this tick. Shape (UAVs, 2)."""
        measures: FloatArray = np.zeros((len(self.escorts), 2))
        tables, _ = self.arrays
        measure(tables.world, self.position, self.escorts, self.coverage, measures, True)
        return measures
