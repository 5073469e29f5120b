"""A UGV's tick on board, compiled: the drivers' shells call it for one vehicle, batches for many."""

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
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray
from sim.models.vehicles import Motion


@compiled
def ugv_tick(
    parameters: DriverParameters,
    route: Route,
    own: RecordArray,
    ground: GroundMemory | None,
    radio: FloatArray,
    received: int,
    tick: int,
    here: Motion,
    flown: int,
) -> tuple[float, float]:
    """Return the UGV's command [m/s²] under any driver that has a compiled form.

    Args:
        parameters: Of the driver.
        route: Its goals and its script.
        own: `DriverMemory`, changed. Shape (1,).
        ground: Its memory of the ground, changed. None: there are no hazards, and nothing is compiled to avoid them.
        radio: The tick and p_a - p_g [m] of the messages that have come at this tick, shape (rows, 3).
        received: How many of its rows count.
        tick: Now.
        here: Where the UGV is.
        flown: As in `agents.drivers.navigate.state_ahead`.
    """
    if parameters.driver == WAYPOINTS:
        return waypoint_control(parameters, route.goals, own, here)
    if parameters.driver == WANDER:
        return wander_control(parameters, own, tick, here)
    if parameters.driver == SCRIPT:
        return script_control(parameters, route.script, tick, here)
    if parameters.driver == NAVIGATE:
        if ground is None:
            return waypoint_control(parameters, route.goals, own, here)
        return navigate_control(parameters, ground, route.goals, tick, here, flown)
    return evade_control(parameters, own, radio, received, tick, here)
