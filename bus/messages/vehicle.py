"""Briefings, observations and commands: all messages between the simulator and the vehicles."""

from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import (
    Coordinate,
    Covariance,
    Message,
    Name,
    NonNegative,
    PilotKey,
    Positive,
    Text,
    Tick,
    Ticks,
    Vector,
)
from bus.messages.buildings import AltitudeLimits, Building, Camera
from bus.messages.decision import FilterDecision
from bus.messages.ground import (
    MOST_BLOCKS,
    MOST_CORNERS,
    MapUpdate,
    TileReport,
    UavGround,
    UgvGround,
)
from bus.messages.robot import RobotState
from bus.messages.scenario import (
    Area,
    Detector,
    Estimator,
    Law,
    Limits,
    Origin,
    Region,
    SafetyParameters,
    ScriptStep,
    Sensor,
)
from bus.messages.team import Endurance, Request, Role, Team, TeamMessage
from bus.registry import DEFAULT_KINEMATICS

MOST_CARRIED = 6
"""Maximum number of backup trajectories in one command: its own and earlier ones that have not started. It keeps a
command below one kilobyte.
"""


class BackupTrajectory(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Backup trajectory: the acceleration of one tick, then a plan that ends at rest.

    A command carries it, and the receiver executes it even if later commands are lost. In JSON it is an array of these
    fields, in this order. It is identified by its first tick.
    """

    begins: Tick
    """Tick in which it begins, its identifier; a receiver starts it in no other tick."""
    parent: Annotated[int, Meta(ge=-1, le=2**53)]
    """It begins only if the committed trajectory began in this tick; -1: only if there is none."""
    acceleration: Vector
    """Acceleration in its first tick [m/s²]."""
    turn: Ticks = 0
    """Duration of the turn after the first tick [ticks]."""
    cruise: Ticks = 0
    """Duration at constant velocity after the turn [ticks]."""
    brake: Ticks = 0
    """Duration of braking to rest [ticks]."""
    turning: Vector = (0.0, 0.0)
    """Acceleration during the turn [m/s²]."""
    braking: Vector = (0.0, 0.0)
    """Acceleration during braking [m/s²]."""
    vertical_acceleration: Coordinate = 0.0
    """Vertical acceleration in its first tick [m/s²]; afterwards the vehicle levels off."""


class VehicleBriefing(Message, frozen=True, kw_only=True):
    """Information that a vehicle receives when it joins; when it reconnects, also its own history, in parts."""

    vehicle: Name
    """Name of the vehicle."""
    dt: Positive
    """Length of a tick [s]."""
    area: Area
    """Area of the run."""
    limits: Limits
    """Bounds of the vehicle."""
    key: PilotKey
    """Key of the pilot's own random numbers. With a secret, neither the seed nor any other random number follows from
    it. Without one, it can be found by trying all seeds: then the seed is the secret.
    """
    buildings: tuple[Building, ...] = ()
    """Known buildings; empty: there are none, or the vehicle has no map of them."""
    more: bool = False
    """True if another part of the history follows."""
    episode: Tick = 0
    """Number of the flight."""


class UavBriefing(VehicleBriefing, frozen=True, kw_only=True):
    """Information that a UAV receives when it joins."""

    target_limits: Limits
    """Bounds of the UGV that it escorts."""
    visibility_radius: Positive
    """Visibility radius r_v [m]."""
    sensor: Sensor
    """Its downward sensor."""
    desired_coverage: Positive
    """Desired coverage C* of eq. (4) [1]."""
    covered: tuple[Region, ...] = ()
    """Rectangles that are covered from the start."""
    law: Law
    """Control law at the start."""
    detector: Detector
    """Its detector of the UGV."""
    estimator: Estimator
    """Parameters of its estimator."""
    safety: SafetyParameters = SafetyParameters(max_measurement_error=None, max_measurement_age=1.0)
    """Parameters of its safety filter and certificate."""
    command_timeout: NonNegative = 0.5
    """Time for which a command without a backup trajectory stays in effect when no new one arrives [s]; then the UAV
    brakes.
    """
    ground: UavGround | None = None
    """Its sensor of hazards; None: the scenario has no hazards."""
    altitude: AltitudeLimits | None = None
    """Its vertical bounds; None: it flies in the plane."""
    camera: Camera | None = None
    """Its camera; None: it flies in the plane."""
    marker_height: NonNegative = 0.3
    """Height of the marker of its UGV above the ground [m]."""
    guaranteed_clearance: NonNegative = 0.0
    """Smallest distance from every building that its UGV guarantees to keep under its driver [m]; 0: none."""
    max_building_height: NonNegative | None = None
    """Declared height of the highest building [m]; None: there are no buildings."""
    origin: Origin = Origin()
    """Geographic position of the area's origin, for bridges that use degrees."""
    team: Team | None = None
    """Its team, with a definite `scout_range`; None: it has none."""
    endurance: Endurance | None = None
    """Its endurance; None: unlimited."""
    mates: tuple[Name, ...] = ()
    """All UAVs of its team in name order, itself included; empty: it has none."""
    has_robot: bool = False
    """True: a robot flies it, and its process reports the robot's state."""
    past: "tuple[UavObservation, ...]" = ()
    """Its observations so far in this run, tick by tick; without detections while its process was disconnected."""


class UgvBriefing(VehicleBriefing, frozen=True, kw_only=True):
    """Information that a UGV receives when it joins."""

    driver: Name
    """Controller of the UGV, a row of `bus.registry.DRIVERS`."""
    goals: tuple[Vector, ...]
    """Waypoints in order [m]."""
    goal_tolerance: Positive
    """Distance epsilon below which a goal counts as reached [m]."""
    script: tuple[ScriptStep, ...] = ()
    """Steps of the driver `script`, by increasing time."""
    kinematics: Name = DEFAULT_KINEMATICS
    """Kinematics, one of `bus.registry.KINEMATICS`."""
    track: Positive | None = None
    """Distance between the wheels of a differential drive [m]."""
    max_curvature: Positive | None = None
    """Largest curvature of the path of an Ackermann vehicle [1/m]."""
    command_timeout: NonNegative = 0.5
    """Time for which an operator's last message stays in effect [s]; then the driver `teleop` brakes."""
    ground: UgvGround | None = None
    """Its ground sensor and caution; None: the scenario has no hazards."""
    past: "tuple[UgvObservation, ...]" = ()
    """Its observations so far in this run, tick by tick."""


class Detection(Message, frozen=True, kw_only=True):
    """Noisy detection of the UGV."""

    time: NonNegative
    """Time of the detection [s], a multiple of dt. The estimator rejects and counts any other."""
    relative_position: Vector
    """Measured p_a - p_g [m]."""


class RelativeInformation(Message, frozen=True, kw_only=True):
    """Radio message of a UAV to its UGV: relative position and coverage error."""

    time: NonNegative
    """Time of the estimate [s], a multiple of dt. Any other has no effect."""
    relative_position: Vector
    """Estimated p_a - p_g [m]."""
    coverage_error: NonNegative
    """Coverage error e(t) of eq. (4) on the UAV's own map [m²]."""


class VehicleObservation(Message, frozen=True, kw_only=True):
    """Observation of a vehicle at a tick."""

    tick: Tick
    """Number of the tick."""
    time: NonNegative
    """Simulated time [s]."""
    position: Vector
    """Reference position [m]; with wind or a position error, a UAV's true position differs."""
    velocity: Vector
    """Reference velocity [m/s]."""
    tile_reports: tuple[TileReport, ...] = ()
    """Tiles that its own sensor has reported since the last tick; a UAV reports each tile once, when it is covered
    enough.
    """
    committed_trajectory: Tick | None = None
    """First tick of the trajectory that the vehicle executed in the last tick; None: it executed none."""
    over: bool = False
    """True: the run ends at this tick, and no command is expected."""
    episode: Tick = 0
    """Number of the flight; a reset starts the next."""


class UavObservation(VehicleObservation, frozen=True, kw_only=True):
    """Observation of a UAV at a tick."""

    altitude: Coordinate | None = None
    """Its altitude above the ground [m]; None: it flies in the plane."""
    climb_rate: Coordinate = 0.0
    """Its climb rate [m/s]."""
    detections: tuple[Detection, ...] = ()
    """Detections that arrived at this tick."""
    buildings: tuple[Building, ...] = ()
    """Buildings discovered in this tick: its camera has now seen all their corners."""
    law: Law | None = None
    """Control law from this tick on; None: unchanged."""
    team: tuple[TeamMessage, ...] = ()
    """Messages of its team-mates that arrived at this tick."""
    charge: NonNegative | None = None
    """Flight time that it has left [s]; None: unlimited."""
    number: Tick = 0
    """Its number in the team, as it was stored last; it survives the process. 0: none."""
    request: Request | None = None
    """Request of an operator at this tick; None: none."""


class Teleoperation(Message, frozen=True, kw_only=True):
    """Input of an operator to a UGV: a velocity, a speed and a turn rate, or a goal; none of them: brake."""

    operator: Text
    """Name of the operator."""
    velocity: Vector | None = None
    """Desired velocity [m/s]."""
    speed: Coordinate | None = None
    """Desired speed along the heading [m/s], negative in reverse; only of a UGV that steers."""
    turn_rate: Coordinate = 0.0
    """Desired change of the heading, with `speed` [rad/s]; positive: to the left."""
    goal: Vector | None = None
    """Goal [m]."""


class UgvObservation(VehicleObservation, frozen=True, kw_only=True):
    """Observation of a UGV at a tick."""

    heading: Coordinate | None = None
    """Its heading [rad], from east to north; None: it moves in any direction."""
    radio: tuple[RelativeInformation, ...] = ()
    """Radio messages that arrived at this tick."""
    map_updates: tuple[MapUpdate, ...] = ()
    """Blocks of the UAV's ground map that arrived by radio."""
    operator: tuple[Teleoperation, ...] = ()
    """Operator messages that arrived at this tick, oldest first."""
    driver: Name | None = None
    """Driver from this tick on, a row of `bus.registry.DRIVERS`; None: unchanged."""


class UavReport(Message, frozen=True, kw_only=True):
    """Report of a UAV to observers; no vehicle receives it."""

    estimate: Vector
    """Estimated position of the UGV [m]."""
    covariance: Covariance
    """Covariance of the estimate: xx, xy, yy [m²]."""
    age: NonNegative
    """Time since the newest accepted detection [s]."""
    rejected: Tick
    """Detections that the gate has rejected so far."""
    decision: FilterDecision | None = None
    """Decision of the safety filter; None: the law has no safety filter, or the UAV flies as a scout."""
    role: Role | None = None
    """Role in its team; None: it has none."""


class UavCommand(Message, frozen=True, kw_only=True):
    """Command of a UAV in answer to the observation of the same tick."""

    tick: Tick
    """Tick of the observation."""
    acceleration: Vector
    """Desired acceleration [m/s²]."""
    vertical_acceleration: Coordinate = 0.0
    """Desired vertical acceleration [m/s²], if it has an altitude; for one tick, after which it levels off."""
    backup_trajectories: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """Backup trajectories: the newest one, and earlier ones that the vehicle may have missed, one per tick, oldest
    first. Without any, the acceleration stays in effect until `command_timeout`.
    """
    radio: tuple[RelativeInformation, ...] = ()
    """Radio messages to the UGV."""
    map_updates: Annotated[tuple[MapUpdate, ...], Meta(max_length=MOST_BLOCKS)] = ()
    """Blocks of its ground map for the UGV. A block that contradicts the UAV's sensor is not sent."""
    number: Tick = 0
    """Number in its team that the vehicle is to store; a smaller one than stored has no effect."""
    team: TeamMessage | None = None
    """Message to its team-mates."""
    report: UavReport | None = None
    """Report to observers."""
    robot: RobotState | None = None
    """True state of its robot, if its body is `reported`; it crosses no link, unlike the rest of the command."""


class UgvReport(Message, frozen=True, kw_only=True):
    """Report of a cautious UGV to observers; no vehicle receives it."""

    certified: bool
    """True: the UGV stays on tiles that it knows to be drivable, whatever happens to its commands."""
    uncertified: Text = ""
    """Reason why not."""


class UgvCommand(Message, frozen=True, kw_only=True):
    """Command of a UGV in answer to the observation of the same tick."""

    tick: Tick
    """Tick of the observation."""
    acceleration: Vector
    """Desired acceleration [m/s²]."""
    backup_trajectories: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """The acceleration of one tick, followed by a stop, as of a UAV. Empty: the command stays in effect until
    `command_timeout`.
    """
    route: Annotated[tuple[Vector, ...], Meta(max_length=MOST_CORNERS)] | None = None
    """Planned path from the UGV to its goal, by its corners [m], for observers only; empty: no path known; None:
    unchanged.
    """
    report: UgvReport | None = None
    """Report to observers; None: the UGV certifies nothing."""


Observation = UavObservation | UgvObservation


Command = UavCommand | UgvCommand


Briefing = UavBriefing | UgvBriefing
