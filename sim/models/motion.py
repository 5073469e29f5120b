"""Motions that commands carry, as the pilot plans them and the vehicle's receiver flies them.

A motion is the acceleration of its first tick and the plan that follows it: a turn, a cruise and a brake, each of so
many ticks under one acceleration (none while it cruises). After it the vehicle comes to rest and stays there. Its name
is the tick in which it begins: one pilot begins no two at once. See docs/explanation/proof.md,
"Definitions".
"""

import math

import msgspec
import numpy as np

from bus.messages.base import Vector
from bus.messages.vehicle import BackupTrajectory
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, records
from sim.models.vehicles import brake

NO_MOTION = -1
"""In `begins`: none is flown, and the vehicle comes to rest."""


class CheckedTrajectory(BackupTrajectory, frozen=True):
    """A backup trajectory with the notes of its keeper, the pilot or the receiver; the notes never travel."""

    age: int = 0
    """Ticks since it began, if it is flown."""
    arrived: int = 0
    """The receiver sets 1 once a command that carries it has arrived."""
    plain: int = 0
    """The receiver sets 1 where commands without a trajectory act, the pilot where it is not its own."""
    checked: int = 0
    """The pilot sets 1 if the UGV stays visible on it, as long as the next one begins in time."""
    end: Vector = (0.0, 0.0)
    end_radius: float = math.inf
    end_tick: int = 0
    """Disc around its end that surely held the UGV in that tick [m]; infinite: none is known."""


NO_CHECKED = records(
    CheckedTrajectory,
    [CheckedTrajectory(begins=NO_MOTION, parent=NO_MOTION, acceleration=(0.0, 0.0))],
)
"""The empty row of `CheckedTrajectory`. Shape (1,)."""
_TRAVELS = list(BackupTrajectory.__struct_fields__)


def no_motions(*shape: int) -> RecordArray:
    """Return empty rows of `CheckedTrajectory`."""
    rows: RecordArray = np.empty(shape, dtype=NO_CHECKED.dtype)
    rows[...] = NO_CHECKED[0]
    return rows


@compiled
def clear_motions(rows: RecordArray) -> None:
    """Empty all rows."""
    for k in range(rows.shape[0]):
        rows[k] = NO_CHECKED[0]


@compiled
def motion_command(
    motion: CheckedTrajectory, v_x: float, v_y: float, u_max: float, dt: float
) -> tuple[float, float]:
    """The acceleration [m/s²] of a vehicle that flies this motion, at its age.

    Args:
        motion: A row of a table. Where `begins` is NO_MOTION the vehicle comes to rest.
        v_x, v_y: Velocity of the vehicle [m/s], for the rest at the end.
        u_max: Its largest acceleration [m/s²].
        dt: Length of a tick [s].
    """
    if motion.begins >= 0:
        if motion.age == 0:
            return motion.acceleration[0], motion.acceleration[1]
        if motion.age <= motion.turn:
            return motion.turning[0], motion.turning[1]
        if motion.age <= motion.turn + motion.cruise:
            return 0.0, 0.0
        if motion.age <= motion.turn + motion.cruise + motion.brake:
            return motion.braking[0], motion.braking[1]
    return brake(v_x, v_y, u_max, dt)


@compiled
def waited(tick: int, begins: int, delay_ticks: int) -> int:
    """The vehicle's waiting time for its next motion at a tick [ticks].

    Args:
        tick: Which.
        begins: When the motion began that is flown; NO_MOTION: the vehicle rests since just before the first may begin.
        delay_ticks: From a command to the tick in which its motion begins.
    """
    return tick - (begins if begins >= 0 else delay_ticks - 1)


@compiled
def follow_on(motions: RecordArray, flown: RecordArray, tick: int) -> bool:
    """True if the motion of this tick goes on from the one that is flown; then it is the one that is flown, at age 0.

    Args:
        motions: The one that begins in tick k is in row k % rows, if there is one.
        flown: A table of one row, changed.
        tick: Now.
    """
    due = motions[tick % motions.shape[0]]
    if due.begins != tick or due.parent != flown[0].begins:
        return False
    flown[0] = due
    flown[0].age = 0
    return True


@compiled
def keep_motion(motions: RecordArray, motion: CheckedTrajectory, tick: int) -> None:
    """Keep a motion that sets out at this tick until it begins; one that is there already stays as it is.

    One that begins too late for the room there is, or should have begun already, is left out.

    Args:
        motions: The one that begins in tick k is in row k % rows.
        motion: A row of a table.
        tick: Now.
    """
    begins, rows = motion.begins, motions.shape[0]
    if tick <= begins < tick + rows and motions[begins % rows].begins != begins:
        motions[begins % rows] = motion
        motions[begins % rows].arrived = 0


def received_motion(trajectory: BackupTrajectory) -> RecordArray:
    """Return a trajectory from a message as a table of one row."""
    row = no_motions(1)
    row[_TRAVELS] = msgspec.structs.astuple(trajectory)
    return row
