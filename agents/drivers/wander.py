"""Wandering driver: from one random goal to the next.

It drives to a random goal inside Q until the goal is nearer than the tolerance, then draws the next. A goal is drawn
from the UGV's key and the current tick, uniformly over Q without a margin along the border. Turning to the next goal, a
UGV drifts outward by at most v²/u, twice its stopping distance. The margin is this distance plus two ticks of driving.
It is limited to a quarter of Q's shorter side; a UGV that needs more drives slower than its maximum speed.
"""

from typing import Any

import msgspec
import numpy as np

from agents.drivers.parameters import DriverInputs, UgvParameters
from agents.drivers.steering import goal_control
from bus.messages.base import Vector
from bus.messages.vehicle import UgvBriefing
from sim.compiling.compile import compiled
from sim.models.kinematics import UgvState
from sim.models.randomness import FIRST, SECOND, WANDER, uniform
from sim.models.vehicles import goal_reached, speed_to_stop_within, stopping_distance


def wander_pace(
    width: float, height: float, v_max: float, u_max: float, dt: float
) -> tuple[float, float]:
    """Return the largest speed of a wandering UGV [m/s], and the least distance of its goals from the border [m].

    Args:
        width, height: Size of Q [m].
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    room = 0.25 * min(width, height)
    speed = min(v_max, speed_to_stop_within(0.5 * room, u_max, dt))
    return speed, 2.0 * (stopping_distance(speed, u_max) + speed * dt)


class Parameters(msgspec.Struct, frozen=True, kw_only=True):
    """Parameters of the driver."""

    speed: float
    """Maximum speed [m/s]."""
    margin: float
    """Least distance of goals from the border [m]."""


class Memory:
    """Memory of the driver."""

    has_goal: bool
    goal: Vector
    """Current goal [m]."""
    key_0: np.uint64
    key_1: np.uint64
    """Random number key of the UGV."""


def parameters(ugv: UgvParameters, briefing: UgvBriefing) -> Parameters:
    """Return the parameters of a UGV's driver."""
    speed, margin = wander_pace(ugv.width, ugv.height, ugv.max_speed, ugv.max_acceleration, ugv.dt)
    return Parameters(speed=float(speed), margin=float(margin))


@compiled
def wander_command(
    ugv: UgvParameters, driver: Parameters, memory: Memory, tick: int, own: UgvState
) -> tuple[float, float]:
    """Return the command [m/s²] to a random goal; draw the next goal when it is reached.

    Arguments as in `command`.
    """
    goal: Any = memory.goal
    if not memory.has_goal or goal_reached(own.p_x, own.p_y, goal[0], goal[1], ugv.goal_tolerance):
        key, margin = (memory.key_0, memory.key_1), driver.margin
        goal[0] = margin + (ugv.width - 2.0 * margin) * uniform(key, WANDER, tick, FIRST)
        goal[1] = margin + (ugv.height - 2.0 * margin) * uniform(key, WANDER, tick, SECOND)
        memory.has_goal = True
    return goal_control(ugv, own, goal[0], goal[1], driver.speed)


@compiled
def command(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    inputs: DriverInputs,
) -> tuple[float, float]:
    """Return the acceleration that drives to random points [m/s²]."""
    return wander_command(ugv, driver, memory, inputs.tick, inputs.own)
