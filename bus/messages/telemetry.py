"""Telemetry messages for observers of a run."""

from typing import Annotated

from msgspec import Meta

from bus.messages.base import (
    Coordinate,
    Message,
    Name,
    NonNegative,
    Positive,
    Share,
    Text,
    Tick,
    Vector,
)
from bus.messages.control import Change
from bus.messages.decision import NotCertified
from bus.messages.links import LinkStatus
from bus.messages.scenario import Area, Limits, Origin
from bus.messages.vehicle import UavReport
from bus.registry import DEFAULT_LAW


class VehicleTruth(Message, frozen=True, kw_only=True):
    """True state of one vehicle."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    """Acceleration applied since the last tick, after the bounds [m/s²]."""
    command: Vector
    """Commanded acceleration since the last tick, before the bounds [m/s²].

    If no command arrived, its substitute.
    """


class EscortTruth(Message, frozen=True, kw_only=True):
    """True state of one UAV relative to the UGV that it escorts."""

    uav: Name
    ugv: Name
    distance: NonNegative
    """|p_a - p_g| [m]."""
    coverage_error: NonNegative
    """Coverage error e(t) of (4) with the true p_g [m²]."""
    detection: Vector | None
    """Relative position detected at this tick [m]; None: no detection."""
    report: UavReport | None
    """Report of the UAV at the last tick."""


class Truth(Message, frozen=True, kw_only=True):
    """Complete true state, except for the coverage grid."""

    tick: Tick
    time: NonNegative
    vehicles: dict[Name, VehicleTruth]
    escorts: tuple[EscortTruth, ...]


class CoverageMap(Message, frozen=True, kw_only=True):
    """Coverage of the ground as bytes: 255 is the desired coverage or more."""

    tick: Tick
    columns: Annotated[int, Meta(ge=1)]
    rows: Annotated[int, Meta(ge=1)]
    cell: Positive
    cells: bytes
    """Coverage of each cell, row by row from y = 0 (base64 in JSON)."""


class UgvGuarantee(Message, frozen=True, kw_only=True):
    """Certificates of a cautious UGV so far, compared with the true state (docs/explanation/ground.md)."""

    entered_unknown_tile: Tick
    """Ticks in which it drove over a tile that it did not know to be drivable."""
    ticks: Tick
    """Ticks in which it reported whether it is certified to stay on known tiles."""
    certified: Tick
    """Ticks certified."""
    uncertified: dict[Text, Tick] = {}
    """Ticks not certified, by reason."""
    certificate_broken: Tick
    """Violations: certified ticks after which the UGV was not certified, or in which it entered an unknown tile,
    although all assumptions hold. Any value above 0 shows an error in the guarantee.
    """


class MissionResult(Message, frozen=True, kw_only=True):
    """Mission results over ground with hazards, for all UGVs together; for evaluation only, sent to no vehicle."""

    arrived: bool
    """True if every UGV with goals has reached all of them."""
    mission_time: NonNegative | None
    """Time at which the last UGV reached its last goal [s]; None: not yet, or no UGV has a goal."""
    hazards_hit: Tick
    """Blocking hazards touched; each UGV counts a hazard once."""
    near_misses: Tick
    """Blocking hazards that a UGV approached to less than 0.2 m without touching them."""
    hazards_on_path: Tick
    """Blocking or rough hazards that a UGV approached to less than 2 m."""
    warned: Tick
    """Number of these hazards that the UGV knew before it came within 2 m."""
    mean_warning_time: NonNegative | None
    """Mean time from the first knowledge of a hazard until the UGV came within 2 m [s]; None: no such hazard."""
    reported_share: Share | None
    """Share of the driven distance on tiles that were received by radio beforehand; None: no UGV has moved."""
    ground_certified_share: Share | None = None
    """Share of reported ticks in which cautious UGVs were certified; None: no reports."""
    entered_unknown_tile: Tick = 0
    """Ticks in which a UGV drove over a tile that it did not know to be drivable, summed over all UGVs."""
    ground_certificate_broken: Tick = 0
    """`UgvGuarantee.certificate_broken`, summed over all UGVs."""
    guarantees: dict[Name, UgvGuarantee] = {}
    """Guarantee of each UGV, by name."""
    stationary_time: NonNegative
    """Time that UGVs stood still before arrival [s]."""
    finds: Tick
    """Objects to find."""
    found: Tick
    """Objects reported by a vehicle's sensor."""


class VehicleStatus(Message, frozen=True, kw_only=True):
    """State of a vehicle's process, and its faults so far."""

    present: bool
    missing_commands: Tick = 0
    """Ticks without a new command."""
    stale_commands: Tick = 0
    """Commands used after the tick that they answer."""
    shortened_commands: Tick = 0
    """Commands shortened to the vehicle's bound."""
    lost: Tick = 0
    """Number of times that the vehicle's process disconnected during the run."""
    rejoined: Tick = 0
    """Number of times that it reconnected."""
    rejected: dict[Text, Tick] = {}
    """Rejected messages and sessions, by cause."""
    last_fault: Text = ""


class Geometry(Message, frozen=True, kw_only=True):
    """Constant facts for a picture of the run."""

    area: Area
    visibility_radius: Positive
    """Visibility radius r_v [m]."""
    sensor_range: Positive
    """Sensor range r [m]."""
    switching_radius: Coordinate | None
    """Switching radius r_s of (18) of the first escort [m]; None: no finite value."""
    dt: Positive
    """Duration of a tick [s]."""
    limits: dict[Name, Limits] = {}
    """Bounds of each vehicle, by name."""
    uavs: dict[Name, Name]
    """The escorted UGV of each UAV, by name of the UAV."""
    goals: dict[Name, tuple[Vector, ...]] = {}
    """First goals of each UGV whose driver uses goals [m]; at most 100 each."""
    origin: Origin = Origin()
    """Geographic position of the origin."""


class CertificateStatus(Message, frozen=True, kw_only=True):
    """Certificates of all UAVs' safety filters so far, compared with the true state."""

    ticks: Tick
    """Ticks supervised by a safety filter, summed over all UAVs."""
    certified: Tick
    """Ticks certified."""
    overridden: Tick
    """Ticks in which a filter overrode the control law."""
    uncertified: dict[NotCertified, Tick] = {}
    """Ticks not certified, by reason."""
    certified_while_lost: Tick = 0
    """Certified ticks in which the UGV was out of sight. Any value above 0 shows an error in the certificate."""
    certificate_broken: Tick = 0
    """Ticks not certified although the previous tick was and all assumptions hold. Any value above 0 shows an error in
    the certificate.
    """
    max_command_interval: NonNegative | None = None
    """Declared bound on the time from the start of one plan to the start of the next [s]."""
    longest_command_interval: NonNegative | None = None
    """Longest such time so far [s]."""
    max_tracking_error: NonNegative | None = None
    """Declared bound on a UAV's distance from its reference position [m]; None: no disturbance acts, or no bound is
    declared.
    """
    largest_tracking_error: NonNegative | None = None
    """Largest such distance so far [m]; None: no disturbance acts."""


class Status(Message, frozen=True, kw_only=True):
    """State of the run, sent to observers a few times per second."""

    scenario: Text
    seed: int
    tick: Tick
    ticks: Tick
    """Total ticks of the run."""
    time: NonNegative
    realtime_factor: NonNegative
    """Recent pace: simulated seconds per second of wall time."""
    target_factor: NonNegative | None = None
    """Target pace: simulated seconds per second of wall time; None: lockstep, as fast as possible."""
    late_ticks: Tick = 0
    """Ticks that ran late."""
    paused: bool = False
    law: Name = DEFAULT_LAW
    """Current control law of the UAVs."""
    drivers: dict[Name, Name] = {}
    """Current driver of each UGV."""
    operators: dict[Name, Name] = {}
    """Current operator of each UGV, from the latest `Control.operator`; only where known."""
    changes: tuple[Change, ...] = ()
    """Most recent controls that took effect, newest last; at most 20."""
    refusals: tuple[Text, ...] = ()
    """Most recent rejected operator requests, with the reason; at most 5."""
    geometry: Geometry | None = None
    certified: dict[Name, bool] = {}
    """True if visibility is certified, by UAV; only UAVs with a safety filter."""
    uncertified: dict[Name, NotCertified] = {}
    """Reason for the missing certificate, by UAV."""
    certificates: CertificateStatus | None = None
    """Counts of certified ticks so far; None: no safety filter has been active."""
    mission: MissionResult | None = None
    """Mission results of the UGVs; None: no hazards in the scenario."""
    warnings: tuple[Text, ...] = ()
    """Assumptions of the certificate that the present links violate, one line each."""
    links: dict[Text, LinkStatus] = {}
    """Counters of each link, by `vehicle/kind`."""
    vehicles: dict[Name, VehicleStatus]
    over: bool = False
