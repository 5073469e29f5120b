"""Typed tables of the vehicles of a scenario."""

from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Coordinate, Name, NonNegative, Positive, Text, Vector
from bus.messages.buildings import Altitude
from bus.messages.scenario import LawNumber, ScriptStep
from bus.registry import CAUTIONS, DEFAULT_BODY, DEFAULT_DRIVER, DEFAULT_KINEMATICS
from sim.models.inner_loop import InnerLoop
from sim.scenario.base import Table

Bound = Annotated[float, Meta(gt=0.0)]
"""Bound that may be infinite (TOML: inf)."""


class OwnLaw(Table, frozen=True, kw_only=True):
    """Control law of one UAV, where it differs from the scenario's."""

    name: Name | None = None
    """Name, a row of `bus.registry.LAWS`; default: the scenario's."""
    parameters: Annotated[dict[Text, LawNumber], Meta(max_length=64)] = msgspec.field(
        default_factory=dict
    )
    """Parameters that differ from `law.parameters`."""

    def __hash__(self) -> int:
        return hash((self.name, tuple(sorted(self.parameters.items()))))


class Uav(Table, frozen=True, kw_only=True):
    """UAV and its initial state."""

    name: Name = "uav_0"
    """Unique name."""
    escorts: Name = "ugv_0"
    """Name of the UGV that it escorts."""
    position: Vector
    """Initial position [m]."""
    velocity: Vector = (0.0, 0.0)
    """Initial velocity [m/s]."""
    max_speed: Bound = 0.6
    """Maximum speed v_a [m/s]; inf: unbounded."""
    max_acceleration: Bound = 0.3
    """Maximum acceleration u_a [m/s²]; inf: unbounded."""
    position_error: NonNegative = 0.0
    """Largest error of its position measurement [m]; it drifts, and the inner loop cannot observe it."""
    position_error_time: Positive = 30.0
    """Time constant of this error [s]."""
    body: Name = DEFAULT_BODY
    """Model of its true motion, a row of `bus.registry.BODIES`: `point`, `reported` by its own process, or one of an
    extension such as `quadrotor`.
    """
    tracking: InnerLoop = InnerLoop()
    """Inner loop of the body `point`, which tracks the reference state against wind and position errors."""
    law: OwnLaw | None = None
    """Control law of this UAV; default: the scenario's."""
    search: bool = True
    """True: inside the safety filter, it searches for a UGV out of sight on a spiral; False: it waits at the newest
    measurement.
    """
    endurance: Positive | None = None
    """Flight time with a full charge [s], at the start and after charging; default: unlimited. Only in a team."""
    charge_time: Positive = 300.0
    """Time to charge fully at its base [s]."""
    base: Vector | None = None
    """Position at which it charges [m]."""
    initial_altitude: Altitude | None = None
    """Initial altitude above the ground [m]; default: none, the UAV flies in the plane."""
    min_altitude: Altitude | None = None
    """Lowest altitude [m]; default: 1 m."""
    max_altitude: Altitude | None = None
    """Highest altitude [m]; default: 120 m."""
    max_climb_rate: Positive | None = None
    """Largest rate of climb and of descent [m/s]; default: 1 m/s."""
    max_vertical_acceleration: Positive | None = None
    """Largest vertical acceleration [m/s²]; default: 1 m/s²."""
    vertical_clearance: NonNegative | None = None
    """Smallest height above the roof of a building while over it [m]; default: 1 m."""


class Ugv(Table, frozen=True, kw_only=True):
    """UGV, its initial state and its task."""

    name: Name = "ugv_0"
    """Unique name."""
    position: Vector
    """Initial position [m]."""
    velocity: Vector = (0.0, 0.0)
    """Initial velocity [m/s]."""
    max_speed: Bound = 0.2
    """Maximum speed v_g [m/s]; inf: unbounded."""
    max_acceleration: Bound = 0.1
    """Maximum acceleration u_g [m/s²]; inf: unbounded."""
    kinematics: Name = DEFAULT_KINEMATICS
    """Kinematics: `point` moves in any direction, `differential` and `ackermann` along the heading only."""
    track: Positive | None = None
    """Distance between the wheels of a `differential` drive [m]; each wheel keeps max_speed."""
    max_curvature: Positive | None = None
    """Largest curvature of the path of an `ackermann` vehicle [1/m]: 1 / its smallest turning radius."""
    heading: Coordinate | None = None
    """Initial heading of a vehicle that steers [rad], from east to north; default: along its velocity, else towards its
    first goal, else east.
    """
    driver: Name = DEFAULT_DRIVER
    """Controller, a row of `bus.registry.DRIVERS`; or a saved policy such as `fmu:FILE.fmu`, which sets the driver
    `policy` and `custom.policy`.
    """
    goals: tuple[Vector, ...] = ()
    """Waypoints [m], in order."""
    goal_tolerance: Positive = 0.05
    """Distance epsilon below which a goal counts as reached [m]."""
    script: tuple[ScriptStep, ...] = ()
    """Steps of the driver `script`, by increasing time."""
    trajectory: Text = ""
    """Instead of a script: trajectory.csv of an earlier run, whose trajectory of this UGV is repeated."""
    caution: Name = CAUTIONS[0]
    """Behaviour towards unknown ground: `cautious`, slow enough to stop before it, or `bold`, at full speed."""
    marker_height: NonNegative = 0.3
    """Height of its marker, which cameras detect, above the ground [m]."""
    building_clearance: NonNegative = 0.0
    """Smallest distance from every building that it declares to keep [m]; 0: none. The largest of all UGVs must leave
    every UGV a route to its goals. The cautious driver `navigate` keeps it; from unknown buildings only with
    `ground.miss` = 0 and `ground.false_alarm` = 0.
    """
    keeps_clearance: bool = False
    """True: your own program (driver `external` or `policy`, or external actions) keeps `building_clearance`."""
