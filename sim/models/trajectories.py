"""Trajectories in commands, planned by the pilot and executed by the vehicle's receiver.

A trajectory is the acceleration of its first tick and the plan that follows: a turn, a cruise and a brake, each of a
number of ticks under one acceleration (zero for the cruise). Afterwards the vehicle comes to rest and stays there. It
is identified by its first tick: a pilot starts at most one per tick. See docs/explanation/proof.md, "Definitions".
"""

import math

import msgspec
import numpy as np

from bus.messages.base import Vector
from bus.messages.vehicle import BackupTrajectory
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, records
from sim.models.vehicles import brake

NO_TRAJECTORY = -1
"""Value of `begins` without a trajectory: the vehicle comes to rest."""


class CheckedTrajectory(BackupTrajectory, frozen=True):
    """Backup trajectory with local state of the pilot or the receiver, which is never sent."""

    age: int = 0
    """Ticks since its start, if it is active."""
    arrived: int = 0
    """1 (set by the receiver) once a command with this trajectory has arrived."""
    plain: int = 0
    """1 (set by the receiver) while commands without a trajectory act, or (set by the pilot) if it is not its own."""
    checked: int = 0
    """1 (set by the pilot) if the UGV stays visible on it, provided that the next one starts in time."""
    end: Vector = (0.0, 0.0)
    end_radius: float = math.inf
    end_tick: int = 0
    """Disc around its end that certainly contained the UGV in that tick [m]; infinite: none is known."""
    floor: float = -math.inf
    """Altitude above which it was checked [m]."""


NO_CHECKED = records(
    CheckedTrajectory,
    [CheckedTrajectory(begins=NO_TRAJECTORY, parent=NO_TRAJECTORY, acceleration=(0.0, 0.0))],
)
"""Empty row of `CheckedTrajectory`. Shape (1,)."""
_LOCAL = NO_CHECKED[0].tolist()[: -len(BackupTrajectory.__struct_fields__)]
"""Values of the fields that are not sent; they come first."""


def no_trajectories(*shape: int) -> RecordArray:
    """Return empty rows of `CheckedTrajectory`."""
    rows: RecordArray = np.empty(shape, dtype=NO_CHECKED.dtype)
    rows[...] = NO_CHECKED[0]
    return rows


@compiled
def clear_trajectories(rows: RecordArray) -> None:
    """Empty all rows."""
    for k in range(rows.shape[0]):
        rows[k] = NO_CHECKED[0]


@compiled
def trajectory_command(
    trajectory: CheckedTrajectory, v_x: float, v_y: float, u_max: float, dt: float
) -> tuple[float, float]:
    """Return the acceleration [m/s²] of a vehicle that executes this trajectory, at its age.

    Args:
        trajectory: Row of a table. If `begins` is NO_TRAJECTORY, the vehicle comes to rest.
        v_x, v_y: Velocity of the vehicle [m/s], used to come to rest.
        u_max: Maximum acceleration of the vehicle [m/s²].
        dt: Duration of a tick [s].
    """
    if trajectory.begins >= 0:
        if trajectory.age == 0:
            return trajectory.acceleration[0], trajectory.acceleration[1]
        if trajectory.age <= trajectory.turn:
            return trajectory.turning[0], trajectory.turning[1]
        if trajectory.age <= trajectory.turn + trajectory.cruise:
            return 0.0, 0.0
        if trajectory.age <= trajectory.turn + trajectory.cruise + trajectory.brake:
            return trajectory.braking[0], trajectory.braking[1]
    return brake(v_x, v_y, u_max, dt)


@compiled
def waited(tick: int, begins: int, delay_ticks: int) -> int:
    """Return the time since the start of the active trajectory at a tick [ticks].

    Args:
        tick: The tick.
        begins: First tick of the active trajectory; NO_TRAJECTORY: the vehicle is at rest, from just before the first
            may start.
        delay_ticks: Ticks from a command to the start of its trajectory.
    """
    return tick - (begins if begins >= 0 else delay_ticks - 1)


@compiled
def follow_on(trajectories: RecordArray, flown: RecordArray, tick: int) -> bool:
    """Start this tick's trajectory if its parent is active; return whether it did.

    Args:
        trajectories: The trajectory that starts in tick k is in row k % rows.
        flown: Active trajectory, a table of one row; changed.
        tick: Current tick.
    """
    due = trajectories[tick % trajectories.shape[0]]
    if due.begins != tick or due.parent != flown[0].begins:
        return False
    flown[0] = due
    flown[0].age = 0
    return True


@compiled
def keep_trajectory(trajectories: RecordArray, trajectory: CheckedTrajectory, tick: int) -> None:
    """Store a sent trajectory until its start; one that is stored already stays unchanged.

    A trajectory beyond the buffer, or whose first tick has passed, is ignored.

    Args:
        trajectories: The trajectory that starts in tick k is in row k % rows; changed.
        trajectory: Row of a table.
        tick: Current tick.
    """
    begins, rows = trajectory.begins, trajectories.shape[0]
    if tick <= begins < tick + rows and trajectories[begins % rows].begins != begins:
        trajectories[begins % rows] = trajectory
        trajectories[begins % rows].arrived = 0


def received_trajectory(trajectory: BackupTrajectory) -> RecordArray:
    """Return a trajectory from a message as a table of one row."""
    row: RecordArray = NO_CHECKED.copy()
    row[0] = (*_LOCAL, *msgspec.structs.astuple(trajectory))
    return row
