"""A UGV's tick on board, compiled: the drivers' shells call it for one vehicle, batches for many."""

from typing import NamedTuple

from agents.drivers.evade import evade_control
from agents.drivers.navigate import navigate_control
from agents.drivers.parameters import (
    NAVIGATE,
    SCRIPT,
    WANDER,
    WAYPOINTS,
    DriverParameters,
    Route,
)
from agents.drivers.script import script_control
from agents.drivers.tile_map import GroundMemory
from agents.drivers.wander import wander_control
from agents.drivers.waypoints import waypoint_control
from sim.kernels.compile import FloatArray, borrowing
from sim.kernels.records import RecordArray
from sim.models.vehicles import Motion


class UgvMemory(NamedTuple):
    """The memory of a UGV; its arrays change in place."""

    driver: RecordArray
    """`DriverMemory`; from `agents.drivers.compiled.driver_memory`. Shape (1,)."""
    ground: GroundMemory
    """From `agents.drivers.compiled.told_ground`."""


@borrowing
def ugv_tick(
    parameters: DriverParameters,
    route: Route,
    memory: UgvMemory,
    radio: FloatArray,
    received: int,
    tick: int,
    here: Motion,
    flown: int,
) -> tuple[float, float]:
    """The UGV's command [m/s²] under any driver that has a compiled form.

    Args:
        parameters: Of the driver.
        route: Its goals and its script.
        memory: Is changed.
        radio: The tick and p_a - p_g [m] of the messages that have come at this tick, shape (rows, 3).
        received: How many of its rows count.
        tick: Now.
        here: Where the UGV is.
        flown: As in `agents.drivers.navigate.state_ahead`.
    """
    own = memory.driver
    if parameters.driver == WAYPOINTS:
        return waypoint_control(parameters, route.goals, own, here)
    if parameters.driver == WANDER:
        return wander_control(parameters, own, tick, here)
    if parameters.driver == SCRIPT:
        return script_control(parameters, route.script, tick, here)
    if parameters.driver == NAVIGATE:
        if memory.ground.tiles.size == 0:  # there is nothing to go round
            return waypoint_control(parameters, route.goals, own, here)
        return navigate_control(parameters, memory.ground, route.goals, tick, here, flown)
    return evade_control(parameters, own, radio, received, tick, here)
