"""The drivers that compiled loops can call: one function for all of them, and what each needs as plain numbers.

The drivers' classes are shells around the same functions. A driver that listens to a person or to
a policy has no compiled form.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.drivers.evade import EVADE_STATE, begin_evade, evade_control, evade_lead
from agents.drivers.script import driver_script, script_control
from agents.drivers.steering import Steering
from agents.drivers.wander import wander_control, wander_pace
from agents.drivers.waypoints import WAYPOINT_STATE, driver_goals, waypoint_control
from bus.errors import ScenarioError
from bus.messages import UgvBriefing
from bus.registry import DRIVERS
from sim.kernels.compile import FloatArray, compiled
from sim.models.randomness import Key, words_of

__all__ = [
    "COMPILED_DRIVERS",
    "DRIVER_STATE",
    "EVADE",
    "SCRIPT",
    "WANDER",
    "WAYPOINTS",
    "DriverParameters",
    "begin_driver",
    "driver_goals",
    "driver_parameters",
    "driver_script",
    "fresh_driver_state",
    "pack_driver",
    "ugv_control",
    "unpack_driver",
]

COMPILED_DRIVERS = {row.name: row.code for row in DRIVERS.values() if row.code is not None}
"""Codes of the drivers that have a compiled form, by name."""
WAYPOINTS = COMPILED_DRIVERS["waypoints"]
WANDER = COMPILED_DRIVERS["wander"]
SCRIPT = COMPILED_DRIVERS["script"]
EVADE = COMPILED_DRIVERS["evade"]

DRIVER_STATE = max(WAYPOINT_STATE, EVADE_STATE)
"""Size of the state of any of them; the wanderer's is part of the evader's."""


class DriverParameters(NamedTuple):
    """What a driver needs to know, as plain numbers: SI units, infinite where there is no bound."""

    driver: int
    dt: float
    width: float
    height: float
    v_max: float
    u_max: float
    tolerance: float
    speed: float
    margin: float
    lead: float
    key: Key


def driver_parameters(briefing: UgvBriefing, driver: str) -> DriverParameters:
    """The numbers of one driver for one UGV.

    Raises:
        ScenarioError: If the driver has no compiled form.
    """
    if driver not in COMPILED_DRIVERS:
        raise ScenarioError(
            f"driver = {driver!r}: has no compiled form; allowed: {', '.join(COMPILED_DRIVERS)}"
        )
    wheel, limits = Steering(briefing), briefing.limits
    width, height = float(briefing.area.width), float(briefing.area.height)
    speed, margin = wander_pace(width, height, wheel.v_max, wheel.u_max, wheel.dt)
    unbounded = DRIVERS[driver].unbounded
    return DriverParameters(
        driver=COMPILED_DRIVERS[driver],
        dt=wheel.dt,
        width=width,
        height=height,
        v_max=float(limits.max_speed or math.inf) if unbounded else wheel.v_max,
        u_max=float(limits.max_acceleration or math.inf) if unbounded else wheel.u_max,
        tolerance=float(briefing.goal_tolerance),
        speed=float(speed),
        margin=float(margin),
        lead=float(evade_lead(speed, wheel.u_max)),
        key=words_of(briefing.key),
    )


@compiled
def begin_driver(state: FloatArray) -> None:
    """Set the state to that of a driver that has not driven yet, whichever it is; in place."""
    begin_evade(state)  # zeros, but for the evader's own rows: what the others begin with


def fresh_driver_state() -> FloatArray:
    """The state of a driver that has not driven yet. Shape (DRIVER_STATE,)."""
    state = np.empty(DRIVER_STATE)
    begin_driver(state)
    return state


@compiled
def ugv_control(
    parameters: DriverParameters,
    goals: FloatArray,
    script: FloatArray,
    state: FloatArray,
    radio: FloatArray,
    heard: int,
    tick: int,
    time: float,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
) -> tuple[float, float]:
    """The UGV's command [m/s²] under any driver that has a compiled form.

    Args:
        parameters: Of the driver.
        goals: The waypoints [m], in order, shape (goals, 2).
        script: Time [s], v_x and v_y [m/s] of each step, in the order of time, shape (steps, 3).
        state: The driver's state, changed in place.
        radio: Time [s] and p_a - p_g [m] of the messages that have come at this tick, shape (rows, 3).
        heard: How many of its rows count.
        tick: Now.
        time: Now [s]: tick times dt.
        p_x, p_y: Position of the UGV [m].
        v_x, v_y: Its velocity [m/s].
    """
    c = parameters
    if c.driver == WAYPOINTS:
        return waypoint_control(
            goals, state, p_x, p_y, v_x, v_y, c.tolerance, c.v_max, c.u_max, c.dt
        )
    if c.driver == WANDER:
        return wander_control(
            state,
            tick,
            p_x,
            p_y,
            v_x,
            v_y,
            c.speed,
            c.margin,
            c.width,
            c.height,
            c.tolerance,
            c.u_max,
            c.dt,
            c.key,
        )
    if c.driver == SCRIPT:
        return script_control(script, time, v_x, v_y, c.v_max, c.u_max, c.dt)
    return evade_control(
        state,
        radio,
        heard,
        tick,
        time,
        p_x,
        p_y,
        v_x,
        v_y,
        c.speed,
        c.margin,
        c.lead,
        c.width,
        c.height,
        c.tolerance,
        c.v_max,
        c.u_max,
        c.dt,
        c.key,
    )


def pack_driver(parameters: DriverParameters) -> FloatArray:
    """The parameters as a row of numbers, for tables of many worlds; all but the key. Shape (10,)."""
    return np.array(parameters[:-1], dtype=np.float64)


@compiled
def unpack_driver(row: FloatArray, key: Key) -> DriverParameters:
    """The parameters of a row of `pack_driver`, with the key of this world's driver."""
    return DriverParameters(
        driver=int(row[0]),
        dt=row[1],
        width=row[2],
        height=row[3],
        v_max=row[4],
        u_max=row[5],
        tolerance=row[6],
        speed=row[7],
        margin=row[8],
        lead=row[9],
        key=key,
    )
