"""Briefings, observations and commands: all messages between the simulator and the vehicles."""

from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import (
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
from bus.messages.decision import FilterDecision
from bus.messages.ground import (
    MOST_BLOCKS,
    MOST_CORNERS,
    MapUpdate,
    TileReport,
    UavGround,
    UgvGround,
)
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
    """First tick; the receiver starts the trajectory in no other tick."""
    parent: Annotated[int, Meta(ge=-1, le=2**53)]
    """First tick of the trajectory that must be active when this one starts; -1: none may be active."""
    acceleration: Vector
    """Acceleration in the first tick [m/s²]."""
    turn: Ticks = 0
    cruise: Ticks = 0
    brake: Ticks = 0
    """Durations of the plan's phases: turn, cruise and brake [ticks]; then the vehicle rests."""
    turning: Vector = (0.0, 0.0)
    braking: Vector = (0.0, 0.0)
    """Accelerations of the turn and brake phases [m/s²]."""


class VehicleBriefing(Message, frozen=True, kw_only=True):
    """Data that a vehicle receives when it joins.

    A vehicle that rejoins also receives its own past, in parts: each part is a separate briefing.
    """

    vehicle: Name
    dt: Positive
    """Duration of a tick [s]."""
    area: Area
    limits: Limits
    key: PilotKey
    """Key of the pilot's own random numbers.

    If the run has a secret, the key reveals neither the seed nor any other random number. Without a secret, the run's
    seed can be found by trying all seeds: the seed itself is then the secret."""
    more: bool = False
    """True if another part of the past follows."""
    episode: Tick = 0
    """Number of the episode."""


class UavBriefing(VehicleBriefing, frozen=True, kw_only=True):
    """Data that a UAV receives when it joins."""

    target_limits: Limits
    """Bounds of the UGV that it escorts."""
    visibility_radius: Positive
    """Visibility radius r_v [m]."""
    sensor: Sensor
    desired_coverage: Positive
    """Desired coverage C* of (4)."""
    covered: tuple[Region, ...] = ()
    """Ground covered from the start."""
    law: Law
    detector: Detector
    estimator: Estimator
    safety: SafetyParameters = SafetyParameters(max_measurement_error=None, max_measurement_age=1.0)
    command_timeout: NonNegative = 0.5
    """Time for which the last command without a backup trajectory stays in effect when no new one arrives [s]; then the
    UAV brakes.
    """
    ground: UavGround | None = None
    """Hazard sensor; None: no hazards in the scenario, and no reports of the ground."""
    origin: Origin = Origin()
    """Geographic position of the origin, for bridges to software that uses degrees."""
    past: "tuple[UavObservation, ...]" = ()
    """Its observations so far in this run, tick by tick; without detections for ticks at which its process was
    disconnected.
    """


class UgvBriefing(VehicleBriefing, frozen=True, kw_only=True):
    """Data that a UGV receives when it joins."""

    driver: Name
    """Driver, a row of `bus.registry.DRIVERS`."""
    goals: tuple[Vector, ...]
    """Waypoints in order [m]."""
    goal_tolerance: Positive
    """Goal tolerance epsilon: a goal is reached at a smaller distance [m]."""
    script: tuple[ScriptStep, ...] = ()
    """Steps of the driver `script`, ordered by time."""
    command_timeout: NonNegative = 0.5
    """Time for which the operator's last message stays in effect [s]; then the driver `teleop` brakes."""
    ground: UgvGround | None = None
    """Ground sensor; None: no hazards in the scenario, and no reports of the ground."""
    past: "tuple[UgvObservation, ...]" = ()
    """Its observations so far in this run, tick by tick."""


class Detection(Message, frozen=True, kw_only=True):
    """One noisy detection of the UGV by the UAV."""

    time: NonNegative
    """Time of the detection [s], a multiple of dt. The estimator rejects and counts detections between two ticks."""
    relative_position: Vector
    """Relative position p_a - p_g with noise [m]."""


class RelativeInformation(Message, frozen=True, kw_only=True):
    """Radio message from a UAV to its UGV: relative position, and coverage progress."""

    time: NonNegative
    """Time of the estimate [s], a multiple of dt. The UGV ignores a message between two ticks."""
    relative_position: Vector
    """Estimate of p_a - p_g [m]."""
    coverage_error: NonNegative
    """Coverage error e(t) of (4) on the UAV's own map [m²]."""


class VehicleObservation(Message, frozen=True, kw_only=True):
    """Perception of a vehicle at a tick."""

    tick: Tick
    time: NonNegative
    position: Vector
    """Reference position [m]; with wind or a position error, a UAV's true position differs from it."""
    velocity: Vector
    """Reference velocity [m/s]."""
    tile_reports: tuple[TileReport, ...] = ()
    """Tiles that its own sensor has reported since the previous tick; a UAV reports each tile once, when it is covered
    enough.
    """
    committed_trajectory: Tick | None = None
    """First tick of the trajectory that the vehicle executed in the previous tick; None: it executed none."""
    over: bool = False
    """True: the run has ended at this tick, and no command is expected."""
    episode: Tick = 0
    """Number of the episode; a reset starts the next."""


class UavObservation(VehicleObservation, frozen=True, kw_only=True):
    """Perception of a UAV at a tick."""

    detections: tuple[Detection, ...] = ()
    law: Law | None = None
    """Control law from this tick on; None: unchanged."""


class Teleoperation(Message, frozen=True, kw_only=True):
    """Request of an operator who steers a UGV: a velocity or a goal; without either, the UGV brakes."""

    operator: Text
    """Name of the operator."""
    velocity: Vector | None = None
    """Desired velocity [m/s]."""
    goal: Vector | None = None
    """Desired goal [m]."""


class UgvObservation(VehicleObservation, frozen=True, kw_only=True):
    """Perception of a UGV at a tick."""

    radio: tuple[RelativeInformation, ...] = ()
    map_updates: tuple[MapUpdate, ...] = ()
    """Map updates received by radio, from the UAV's sensor."""
    operator: tuple[Teleoperation, ...] = ()
    """Operators' messages received at this tick, oldest first."""
    driver: Name | None = None
    """Driver from this tick on, a row of `bus.registry.DRIVERS`; None: unchanged."""


class UavReport(Message, frozen=True, kw_only=True):
    """Report of a UAV to observers; sent to no vehicle."""

    estimate: Vector
    """Estimated position of the UGV [m]."""
    covariance: Covariance
    """Covariance of the estimate [m²]."""
    age: NonNegative
    """Time since the newest accepted detection [s]."""
    rejected: Tick
    """Detections rejected by the gate so far."""
    decision: FilterDecision | None = None
    """Decision of the safety filter; None: the control law has no safety filter."""


class UavCommand(Message, frozen=True, kw_only=True):
    """Response of a UAV to its observation of the same tick."""

    tick: Tick
    acceleration: Vector
    backup_trajectories: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """Backup trajectories, one per tick, oldest first: the last starts the command's plan, the earlier ones replace
    trajectories that the vehicle may have missed. Without one, the vehicle holds the acceleration, and brakes after
    `command_timeout`.
    """
    radio: tuple[RelativeInformation, ...] = ()
    map_updates: Annotated[tuple[MapUpdate, ...], Meta(max_length=MOST_BLOCKS)] = ()
    """Map updates to send by radio. The simulator drops an update that contradicts the reports of the UAV's sensor."""
    report: UavReport | None = None


class UgvReport(Message, frozen=True, kw_only=True):
    """Report of a cautious UGV to observers; sent to no vehicle."""

    certified: bool
    """True if it is certified to stay on tiles known to be drivable, even if commands are lost."""
    uncertified: Text = ""
    """Reason if it is not certified."""


class UgvCommand(Message, frozen=True, kw_only=True):
    """Response of a UGV to its observation of the same tick."""

    tick: Tick
    acceleration: Vector
    backup_trajectories: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """Backup trajectories as in `UavCommand`: the acceleration of a tick, and the stop that follows. Without one, the
    vehicle holds the acceleration.
    """
    route: Annotated[tuple[Vector, ...], Meta(max_length=MOST_CORNERS)] | None = None
    """Planned route to the goal, for observers only: its corners, from the vehicle's position on [m]; empty: no route
    known; None: unchanged.
    """
    report: UgvReport | None = None
    """Certificate of the tick; None: the UGV does not guarantee to stay on known tiles."""


Observation = UavObservation | UgvObservation


Command = UavCommand | UgvCommand


Briefing = UavBriefing | UgvBriefing
