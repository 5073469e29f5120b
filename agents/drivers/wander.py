"""A driver without a plan: from one random goal to the next."""

import numpy as np

from agents.drivers.steering import Steering
from agents.drivers.waypoints import goal_control
from bus.messages import UgvBriefing, UgvObservation
from sim.kernels.compile import FloatArray, compiled
from sim.models.randomness import WANDER, Key, uniform, words_of
from sim.models.vehicles import goal_reached, speed_to_stop_within, stopping_distance

_GOAL, _CHOSEN = 0, 2  # rows of the state: the goal (2), whether there is one
WANDER_STATE = 3


def wander_pace(
    width: float, height: float, v_max: float, u_max: float, dt: float
) -> tuple[float, float]:
    """The largest speed of a wanderer [m/s], and how near to the border its goals may be [m].

    Args:
        width, height: Of Q [m].
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    room = 0.25 * min(width, height)
    speed = min(v_max, speed_to_stop_within(0.5 * room, u_max, dt))
    return speed, 2.0 * (stopping_distance(speed, u_max) + speed * dt)


@compiled
def wander_goal(
    tick: int, width: float, height: float, margin: float, key: Key
) -> tuple[float, float]:
    """The goal [m] that is drawn at a tick: evenly over Q without a margin [m] along the border."""
    return (
        margin + (width - 2.0 * margin) * uniform(key, WANDER, tick, 0),
        margin + (height - 2.0 * margin) * uniform(key, WANDER, tick, 1),
    )


@compiled
def wander_control(
    state: FloatArray,
    tick: int,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    speed: float,
    margin: float,
    width: float,
    height: float,
    tolerance: float,
    u_max: float,
    dt: float,
    key: Key,
) -> tuple[float, float]:
    """The acceleration [m/s²] to a random goal, and when that is reached to another one.

    Args:
        state: Of the driver, changed in place; begins as zeros.
        tick: Now.
        p_x, p_y: Position [m].
        v_x, v_y: Velocity [m/s].
        speed, margin: Of `wander_pace` [m/s], [m].
        width, height: Of Q [m].
        tolerance: Nearer than this a goal is reached [m].
        u_max: Bound [m/s²].
        dt: Length of a tick [s].
        key: Of the UGV's own random numbers.
    """
    if state[_CHOSEN] == 0.0 or goal_reached(p_x, p_y, state[_GOAL], state[_GOAL + 1], tolerance):
        state[_GOAL], state[_GOAL + 1] = wander_goal(tick, width, height, margin, key)
        state[_CHOSEN] = 1.0
    return goal_control(p_x, p_y, v_x, v_y, state[_GOAL], state[_GOAL + 1], speed, u_max, dt)


class WanderDriver:
    """Drives to a random goal inside Q, and when it is nearer than the tolerance, to another one.

    A goal is drawn from the UGV's key and the tick at which it is needed, evenly over Q without a margin along the
    border.
    Turning from one goal to the next a UGV drifts outward by no more than v²/u, twice its stopping distance, so
    the margin is
    that and two ticks' way. It is at most a quarter of Q's shorter side: a UGV that needs more drives slower than
    it could.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._steering = wheel = Steering(briefing)
        self._width, self._height = float(briefing.area.width), float(briefing.area.height)
        self._tolerance, self._key = float(briefing.goal_tolerance), words_of(briefing.key)
        self._state = np.zeros(WANDER_STATE)
        speed, margin = wander_pace(self._width, self._height, wheel.v_max, wheel.u_max, wheel.dt)
        self.speed = speed
        """The largest speed that it drives at [m/s]."""
        self.margin = margin
        """Its goals are no nearer to the border than this [m]."""

    @property
    def goal(self) -> tuple[float, float] | None:
        """Where it drives to [m]; None before the first observation."""
        return (
            (float(self._state[_GOAL]), float(self._state[_GOAL + 1]))
            if self._state[_CHOSEN]
            else None
        )

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        (p_x, p_y), (v_x, v_y), tick, key = (
            observation.position,
            observation.velocity,
            observation.tick,
            self._key,
        )
        speed, margin, width, height, tolerance = (
            self.speed,
            self.margin,
            self._width,
            self._height,
            self._tolerance,
        )
        u_max, dt = self._steering.u_max, self._steering.dt
        return wander_control(
            self._state,
            tick,
            p_x,
            p_y,
            v_x,
            v_y,
            speed,
            margin,
            width,
            height,
            tolerance,
            u_max,
            dt,
            key,
        )
