"""Briefings, observations and commands: all that the simulator and the vehicles exchange."""

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
"""Motions that one command carries at most: its own and those before it that have not begun, so that it fits a
kilobyte.
"""


class BackupTrajectory(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A backup trajectory: the acceleration of one tick, then a plan that ends at rest.

    A command carries it, and a receiver flies it even where later commands are lost. In JSON it is an array of these
    fields, in this order. Its name is the tick in which it begins.
    """

    begins: Tick
    """The tick in which it begins; the receiver lets it begin in no other."""
    parent: Annotated[int, Meta(ge=-1, le=2**53)]
    """It begins only if the motion that is flown then is the one that began in this tick; -1: none is flown."""
    acceleration: Vector
    """In its first tick [m/s²]."""
    turn: Ticks = 0
    cruise: Ticks = 0
    brake: Ticks = 0
    """Lengths of the plan after it, to turn, cruise and brake [ticks]; then the vehicle rests."""
    turning: Vector = (0.0, 0.0)
    braking: Vector = (0.0, 0.0)
    """Accelerations while it turns and brakes [m/s²]."""


class VehicleBriefing(Message, frozen=True, kw_only=True):
    """All a vehicle is told when it joins.

    One that joins again is told its own past too, in parts: each is a briefing of its own.
    """

    vehicle: Name
    dt: Positive
    """Time between two ticks [s]."""
    area: Area
    limits: Limits
    key: PilotKey
    """Of the pilot's own random numbers.

    Where the run has a secret it leads to nothing else: not to the seed, nor to any other
    draw. Where it has none, whoever tries all seeds finds the run's: there the seed is the secret."""
    more: bool = False
    """True if another part of the past follows."""
    episode: Tick = 0
    """Number of the flight that this is for."""


class UavBriefing(VehicleBriefing, frozen=True, kw_only=True):
    """All a UAV is told when it joins."""

    target_limits: Limits
    """The bounds of the UGV it escorts."""
    visibility_radius: Positive
    """r_v [m]."""
    sensor: Sensor
    desired_coverage: Positive
    """C* of (4)."""
    covered: tuple[Region, ...] = ()
    """Ground covered from the start."""
    law: Law
    detector: Detector
    estimator: Estimator
    safety: SafetyParameters = SafetyParameters(max_measurement_error=None, max_measurement_age=1.0)
    command_timeout: NonNegative = 0.5
    """Time for which a command without a motion stays in effect when no new one arrives [s]; then the UAV brakes."""
    ground: UavGround | None = None
    """None: there are no hazards, and nothing is told of the ground."""
    origin: Origin = Origin()
    """Place on Earth that its positions are counted from, for bridges to programs that count in degrees."""
    past: "tuple[UavObservation, ...]" = ()
    """Its observations so far in this run, tick by tick; where its process was away, without detections."""


class UgvBriefing(VehicleBriefing, frozen=True, kw_only=True):
    """All a UGV is told when it joins."""

    driver: Name
    """A row of `bus.registry.DRIVERS`."""
    goals: tuple[Vector, ...]
    """Waypoints [m], in order."""
    goal_tolerance: Positive
    """epsilon: a goal counts as reached nearer than this [m]."""
    script: tuple[ScriptStep, ...] = ()
    """The steps of the driver `script`, in the order of time."""
    command_timeout: NonNegative = 0.5
    """Time that an operator's last word counts [s]; then the driver `teleop` brakes."""
    ground: UgvGround | None = None
    """None: there are no hazards, and nothing is told of the ground."""
    past: "tuple[UgvObservation, ...]" = ()
    """As a UAV's."""


class Detection(Message, frozen=True, kw_only=True):
    """One noisy look of the UAV at the UGV."""

    time: NonNegative
    """Time at which it was taken [s]: a tick times dt. One between two ticks is refused by the filter, and counted."""
    relative_position: Vector
    """p_a - p_g with noise [m]."""


class RelativeInformation(Message, frozen=True, kw_only=True):
    """The radio message of a UAV to its UGV: relative information, and how much it has seen."""

    time: NonNegative
    """Time at which it was estimated [s]: a tick times dt. One between two ticks is used for nothing."""
    relative_position: Vector
    """The estimate of p_a - p_g [m]."""
    coverage_error: NonNegative
    """e(t) of (4) on the UAV's own map [m²]."""


class VehicleObservation(Message, frozen=True, kw_only=True):
    """The perception of a vehicle at a tick."""

    tick: Tick
    time: NonNegative
    position: Vector
    """Its reference position [m]: in wind or with a position error not quite the true one of a UAV."""
    velocity: Vector
    """Its reference velocity [m/s]."""
    tile_reports: tuple[TileReport, ...] = ()
    """Tiles that its own sensor has reported since the tick before; a UAV's each once, when covered enough."""
    committed_trajectory: Tick | None = None
    """The motion that the vehicle flew in the tick before: that in which it began; None: it flew none."""
    over: bool = False
    """True: the run has ended at this tick and no command is awaited."""
    episode: Tick = 0
    """Number of the flight; a reset begins the next."""


class UavObservation(VehicleObservation, frozen=True, kw_only=True):
    """The perception of a UAV at a tick."""

    detections: tuple[Detection, ...] = ()
    law: Law | None = None
    """The law to fly from this tick on; None: the one before."""


class Teleoperation(Message, frozen=True, kw_only=True):
    """The wish of an operator at a UGV's wheel: a velocity, or a goal; neither means to brake."""

    operator: Text
    """The operator's name."""
    velocity: Vector | None = None
    """Desired velocity [m/s]."""
    goal: Vector | None = None
    """The goal [m]."""


class UgvObservation(VehicleObservation, frozen=True, kw_only=True):
    """The perception of a UGV at a tick."""

    radio: tuple[RelativeInformation, ...] = ()
    map_updates: tuple[MapUpdate, ...] = ()
    """The blocks that have come by radio, of the ground that the UAV has seen."""
    operator: tuple[Teleoperation, ...] = ()
    """The operators' messages that have come to the vehicle at this tick, the oldest first."""
    driver: Name | None = None
    """The driver from this tick on, a row of `bus.registry.DRIVERS`; None: the one before."""


class UavReport(Message, frozen=True, kw_only=True):
    """The report of a UAV to observers; no vehicle reads it."""

    estimate: Vector
    """Place at which it believes the UGV to be [m]."""
    covariance: Covariance
    """Of that estimate [m²]."""
    age: NonNegative
    """Time since the newest detection that was believed [s]."""
    rejected: Tick
    """Detections refused by the gate so far."""
    decision: FilterDecision | None = None
    """Decision of the safety filter; None: no filter watches over this law."""


class UavCommand(Message, frozen=True, kw_only=True):
    """A UAV's answer to its observation of the same tick."""

    tick: Tick
    acceleration: Vector
    backup_trajectories: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """The motions to be flown from the tick on in which the last of them begins, and before it those that it may
    have missed, one a tick, the oldest first. Without one the vehicle holds the acceleration, and brakes when no
    command comes.
    """
    radio: tuple[RelativeInformation, ...] = ()
    map_updates: Annotated[tuple[MapUpdate, ...], Meta(max_length=MOST_BLOCKS)] = ()
    """The blocks that it radios, of the ground that it has seen. One that says of a tile what its sensor has not said
    is not sent."""
    report: UavReport | None = None


class UgvReport(Message, frozen=True, kw_only=True):
    """The report of a cautious UGV to observers; no vehicle reads it."""

    certified: bool
    """True if it is certified to stay on tiles that it knows to be drivable, whatever becomes of its commands."""
    uncertified: Text = ""
    """Why not."""


class UgvCommand(Message, frozen=True, kw_only=True):
    """A UGV's answer to its observation of the same tick."""

    tick: Tick
    acceleration: Vector
    backup_trajectories: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """As of a UAV: the acceleration of a tick, and the stop that follows it. None: the command is held."""
    route: Annotated[tuple[Vector, ...], Meta(max_length=MOST_CORNERS)] | None = None
    """For observers, no vehicle reads it: the way that it plans to its goal, by its corners [m], from where it is; none
    where it knows none. None: as before.
    """
    report: UgvReport | None = None
    """None: it does not promise to stay on tiles that it knows."""


Observation = UavObservation | UgvObservation


Command = UavCommand | UgvCommand


Briefing = UavBriefing | UgvBriefing
