"""Contract of a driver: a compiled function `command(ugv, driver, memory, inputs)`.

It returns the acceleration [m/s²]. Its arguments are `UgvParameters`; the `Parameters` of the driver; its `Memory`,
changed in place; and `DriverInputs`.
"""

from typing import Any, NamedTuple

import msgspec

from agents.asking import LARGEST
from bus.errors import ScenarioError
from bus.messages.vehicle import UgvBriefing
from bus.registry import DRIVERS, module_of
from sim.compiling.compile import FloatArray
from sim.models.kinematics import Kinematics, UgvState, kinematics_of


class UgvParameters(msgspec.Struct, frozen=True, kw_only=True):
    """Constants of one UGV that any driver may need; a missing bound is infinite."""

    dt: float
    """[s]"""
    width: float
    height: float
    """Q [m]."""
    max_speed: float
    """v_g [m/s]."""
    max_acceleration: float
    """u_g [m/s²]."""
    goal_tolerance: float
    """Distance below which a goal counts as reached [m]."""
    kinematics: Kinematics
    """Kinematics: it moves in any direction, or along its heading."""


class DriverInputs(NamedTuple):
    """Knowledge of one UGV in a tick: its state, goals and script, and the messages received."""

    tick: int
    own: UgvState
    """Its position [m], velocity [m/s] and heading [rad]."""
    goals: FloatArray
    """Waypoints [m], in order. Shape (goals, 2)."""
    script: FloatArray
    """First tick, v_x and v_y [m/s] of each step, in chronological order. Shape (steps, 3)."""
    radio: FloatArray
    """Tick and p_a - p_g [m] of each message received in this tick. Shape (rows, 3)."""
    received: int
    """Number of valid rows of `radio`."""
    ground: Any
    """`OccupancyGrid` of the UGV, changed in place. None without hazards."""
    committed: int
    """First tick of the committed trajectory; see `agents.drivers.pending_stops.state_ahead`."""


def ugv_parameters(briefing: UgvBriefing, *, unbounded: bool) -> UgvParameters:
    """Return the constants of a UGV from its briefing; `unbounded` keeps infinite bounds."""
    v_max, u_max = briefing.limits.numbers
    if not unbounded:
        v_max, u_max = min(v_max, LARGEST), min(u_max, LARGEST)
    return UgvParameters(
        dt=float(briefing.dt),
        width=float(briefing.area.width),
        height=float(briefing.area.height),
        max_speed=v_max,
        max_acceleration=u_max,
        goal_tolerance=float(briefing.goal_tolerance),
        kinematics=kinematics_of(briefing),
    )


def driver_parameters(briefing: UgvBriefing, driver: str) -> Any:  # noqa: ANN401 - the driver's class
    """Return the parameters of a UGV's driver, as its file declares them.

    Raises:
        ScenarioError: If the driver has no compiled form.
    """
    row = DRIVERS.get(driver)
    if row is None or not row.module:
        allowed = ", ".join(one.name for one in DRIVERS.values() if one.module)
        raise ScenarioError(f"driver = {driver!r}: has no compiled form; allowed: {allowed}")
    module = module_of(row)
    make = getattr(module, "parameters", None)
    if make is None:
        return module.Parameters()
    return make(ugv_parameters(briefing, unbounded=row.unbounded), briefing)
