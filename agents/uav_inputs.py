"""State of one UAV and the messages that it has received in a tick: the inputs of its on-board software."""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages.team import BLOCK_CELLS, MOST_COVERAGE_BLOCKS
from bus.messages.vehicle import UavObservation
from bus.ticks import DetectionRow, detection_array
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.models.altitude import VerticalState
from sim.models.trajectories import NO_TRAJECTORY
from sim.models.vehicles import State

ByteArray = npt.NDArray[np.uint8]
_NO_DETECTIONS: FloatArray = np.zeros((0, len(DetectionRow._fields)))
DETECTION: Any = DetectionRow._make(range(3))
"""Columns of an array of detections."""


class KnownBuildings(NamedTuple):
    """Buildings that a UAV knows.

    A pilot has rows for these only. A batch has the rows of all buildings: only those marked in `known` may be used.
    """

    rows: RecordArray
    """Table as from `sim.models.buildings.building_table`. Shape (buildings,)."""
    corners: FloatArray
    """Corners of the footprints [m]. Shape (corners, 2)."""
    known: npt.NDArray[np.bool_]
    """True for the buildings that the UAV knows. Shape (buildings,)."""
    discovered: IntArray
    """Tick in which the UAV discovered a building; -1: it did not. Shape (buildings,)."""


class TeamPacket:
    """A team message for compiled code, see `bus.messages.team.TeamMessage`."""

    sender: int
    """Row of its UAV in the team."""
    tick: int
    number: int
    role: int
    """Code of a `Role`."""
    certified: bool
    charge: float
    """Flight time that its UAV has left [s]; infinite: unlimited."""
    asks: int
    """Row of the UAV that it asks for relief; -1: none."""
    x: float
    y: float
    """Position of its UAV [m]."""
    measured: int
    """Tick of its newest measurement; NO_TICK: none."""
    g_x: float
    g_y: float
    """Measured position of the UGV [m]."""
    blocks: Annotated[IntArray, (MOST_COVERAGE_BLOCKS,)]
    """Index of each coverage block, row by row; -1: none."""
    cells: Annotated[ByteArray, (MOST_COVERAGE_BLOCKS, BLOCK_CELLS**2)]


class TeamInputs(NamedTuple):
    """Stored number of a UAV, its team-mates' messages and an operator's request of a tick."""

    number: int
    charge: float
    """Flight time left [s]; infinite: unlimited."""
    messages: RecordArray
    """`TeamPacket`. Shape (messages,)."""
    request: int
    """Code of an operator's `Request`; 0: none."""


class UavInputs(NamedTuple):
    """State and messages of one UAV in a tick."""

    tick: int
    elapsed: int
    """Ticks since the last observation; 0: its map is not updated."""
    own: State
    vertical: VerticalState | None
    """Its altitude; None: all UAVs fly in the plane."""
    committed: int
    """First tick of the trajectory executed in the last tick; NO_TRAJECTORY: none."""
    detections: FloatArray
    """Tick and p_delta [m] of each detection, see `DETECTION`. Shape (rows, 3)."""
    received: int
    """Number of valid rows of `detections`."""
    buildings: KnownBuildings | None
    """None: there are none."""
    team: TeamInputs | None
    """None: there are no teams."""


def uav_inputs(
    observation: UavObservation,
    detections: Sequence[DetectionRow],
    *,
    elapsed: int = 0,
    vertical: RecordArray | None = None,
    buildings: KnownBuildings | None = None,
    team: TeamInputs | None = None,
) -> UavInputs:
    """Convert the message of a tick.

    Args:
        observation: The message.
        detections: Its detections, from `bus.ticks.detection_rows`.
        elapsed: Ticks since the last observation.
        vertical: `VerticalState`, in which the altitude is recorded; None: the UAV flies in the plane. Shape (1,).
        buildings: Known buildings.
        team: Number and messages of its team, from `agents.team.messages.team_inputs`.
    """
    if vertical is not None and observation.altitude is not None:
        vertical["altitude"], vertical["rate"] = observation.altitude, observation.climb_rate
    rows, committed = _NO_DETECTIONS, observation.committed_trajectory
    if detections:
        rows = detection_array(detections)
    return UavInputs(
        tick=observation.tick,
        elapsed=elapsed,
        own=State(*observation.position, *observation.velocity),
        vertical=None if vertical is None else vertical[0],
        committed=NO_TRAJECTORY if committed is None else committed,
        detections=rows,
        received=len(rows),
        buildings=buildings,
        team=team,
    )
