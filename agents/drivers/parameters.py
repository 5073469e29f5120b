"""The numbers of the compiled drivers."""

from typing import NamedTuple

import numpy as np

from bus.registry import DRIVERS
from sim.kernels.compile import FloatArray

COMPILED_DRIVERS = {row.name: row.code for row in DRIVERS.values() if row.code is not None}
"""Codes of the drivers that have a compiled form, by name."""
WAYPOINTS = COMPILED_DRIVERS["waypoints"]
WANDER = COMPILED_DRIVERS["wander"]
SCRIPT = COMPILED_DRIVERS["script"]
EVADE = COMPILED_DRIVERS["evade"]
NAVIGATE = COMPILED_DRIVERS["navigate"]


class DriverParameters(NamedTuple):
    """The numbers of a driver: SI units, infinite where there is no bound."""

    driver: int
    """A value of `COMPILED_DRIVERS`."""
    dt: float
    width: float
    height: float
    v_max: float
    u_max: float
    tolerance: float
    """Nearer than this a goal is reached [m]."""
    speed: float
    margin: float
    """Of the wanderer: its largest speed [m/s], and how near to the border its goals may be [m]."""
    lead: float
    """Of the evader: how far it looks ahead [s]."""
    forgotten: int
    dash: int
    """Of the evader: `agents.drivers.evade.evade_ticks`."""
    key_0: np.uint64
    key_1: np.uint64
    """The UGV's own random numbers."""
    tile: float
    """Side of a tile of the ground [m]; this and what follows is of the driver that navigates."""
    bold: int
    """1: it trusts its bumper on ground that nobody has seen; 0: it is cautious."""
    share: float
    """Of its largest speed that it has at least on rough ground."""
    plan_ticks: int
    """Between two plans pass at least so many ticks, if the goal is the same and the UGV has not left the old one."""
    plan_tiles: int
    """Planning settles at most so many tiles a tick."""


class DriverMemory(NamedTuple):
    """The memory of the drivers without a plan, a row of an array of one; all zeros but where it says so."""

    goal: int
    """Of the driver of waypoints: number of the goal that it drives to."""
    chosen: int
    """Of the wanderer: 1 if it has a goal."""
    goal_x: float
    goal_y: float
    """That goal [m]."""
    received: float
    """Of the evader: the tick at which the newest message came; at first minus infinity."""
    at: float
    """The tick of what that tells."""
    uav_x: float
    uav_y: float
    """Where the UAV was then [m]."""
    uav_v_x: float
    uav_v_y: float
    """Its smoothed velocity [m/s]."""
    out_x: float
    out_y: float
    """Direction out of a corner."""
    out_end: float
    """First tick for which that counts no more; at first minus infinity."""


class Route(NamedTuple):
    """The goal or velocity that a UGV has been told."""

    goals: FloatArray
    """Waypoints [m], in order. Shape (goals, 2)."""
    script: FloatArray
    """First tick, v_x and v_y [m/s] of each step, in the order of time. Shape (steps, 3)."""
