"""Motions that commands carry, as the pilot plans them and the vehicle's receiver flies them.

A motion is the acceleration of its first tick and the plan that follows it: a turn, a cruise and a brake, each of so
many ticks under one acceleration (none while it cruises). After it the vehicle comes to rest and stays there. Its name
is the tick in which it begins: one pilot begins no two at once. See docs/explanation/certificate.md, "Commands that
carry a motion".
"""

from typing import NamedTuple

import numpy as np

from bus.messages import MotionPlan
from sim.kernels.compile import compiled
from sim.kernels.records import RecordArray, record_type
from sim.models.vehicles import brake

NO_MOTION = -1
"""In `begins`: none is flown, and the vehicle comes to rest."""


class MotionRecord(NamedTuple):
    """The columns of a table of motions, and of what the one who keeps it notes beside each."""

    begins: int
    """The tick in which it begins; NO_MOTION: the row is empty."""
    parent: int
    """It begins only if this one is flown then; NO_MOTION: if none is."""
    first_x: float
    first_y: float
    """Acceleration in its first tick [m/s²]."""
    turn: int
    cruise: int
    brake: int
    """Lengths of the plan after it [ticks]."""
    turn_x: float
    turn_y: float
    brake_x: float
    brake_y: float
    """Accelerations of its turn and its brake [m/s²]."""
    age: int
    """Of one that is flown: ticks since it began."""
    arrived: int
    """By the receiver: 1 once a command that carries it has arrived."""
    plain: int
    """Of what is flown: by the receiver 1 where commands that carry no motion act, by the pilot where it is not its
    own.
    """
    checked: int
    """By the pilot: 1 if sight is kept on it, as long as the next one begins in time."""
    end_x: float
    end_y: float
    end_radius: float
    end_tick: int
    """By the pilot: the disc around where it ends, in which the UGV surely was in that tick [m]; infinite: none is
    known.
    """


def no_motions(*shape: int) -> RecordArray:
    """Empty rows of `MotionRecord`."""
    rows = np.zeros(shape, dtype=record_type(MotionRecord))
    rows["begins"] = rows["parent"] = NO_MOTION
    rows["end_radius"] = np.inf
    return rows


@compiled
def motion_command(
    motion: MotionRecord, v_x: float, v_y: float, u_max: float, dt: float
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
            return motion.first_x, motion.first_y
        if motion.age <= motion.turn:
            return motion.turn_x, motion.turn_y
        if motion.age <= motion.turn + motion.cruise:
            return 0.0, 0.0
        if motion.age <= motion.turn + motion.cruise + motion.brake:
            return motion.brake_x, motion.brake_y
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
def keep_motion(motions: RecordArray, motion: MotionRecord, tick: int) -> None:
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


def motion_row(motion: MotionPlan) -> RecordArray:
    """A motion as it comes in a message, as a table of one row."""
    row = no_motions(1)
    row["begins"], row["parent"] = motion.begins, motion.parent
    row["first_x"], row["first_y"] = motion.acceleration
    row["turn"], row["cruise"], row["brake"] = motion.turn, motion.cruise, motion.brake
    row["turn_x"], row["turn_y"] = motion.turning
    row["brake_x"], row["brake_y"] = motion.braking
    return row


def motion_plan(row: RecordArray) -> MotionPlan:
    """A motion of a table of one row, as it goes into a message."""
    (m,) = (MotionRecord._make(one) for one in row.tolist())
    return MotionPlan(
        m.begins,
        m.parent,
        (m.first_x, m.first_y),
        m.turn,
        m.cruise,
        m.brake,
        (m.turn_x, m.turn_y),
        (m.brake_x, m.brake_y),
    )
