"""Telemetry messages for observers of a run."""

from typing import Annotated

from msgspec import Meta

from bus.messages.base import (
    Coordinate,
    Message,
    Name,
    NonNegative,
    Positive,
    Seed,
    Share,
    Text,
    Tick,
    Vector,
)
from bus.messages.buildings import Building, Camera
from bus.messages.control import Change, Rejection
from bus.messages.decision import NotCertified
from bus.messages.links import LinkStatus
from bus.messages.scenario import Area, Limits, Origin
from bus.messages.team import Role
from bus.messages.vehicle import UavReport
from bus.registry import DEFAULT_LAW


class VehicleTruth(Message, frozen=True, kw_only=True):
    """True state of one vehicle."""

    position: Vector
    """True position [m]."""
    velocity: Vector
    """True velocity [m/s]."""
    acceleration: Vector
    """Acceleration applied since the last tick, after the bounds [m/s²]."""
    command: Vector
    """Commanded acceleration since the last tick, before the bounds [m/s²]; without a command, its replacement."""
    altitude: Coordinate | None = None
    """Altitude of a UAV above the ground [m]; None: it flies in the plane, or is a UGV."""
    climb_rate: Coordinate = 0.0
    """Its climb rate [m/s]."""
    vertical_acceleration: Coordinate = 0.0
    """Its vertical acceleration since the last tick, after the bounds [m/s²]."""
    heading: Coordinate | None = None
    """Heading of a UGV that steers [rad], from east to north; None: it moves in any direction, or is a UAV."""
    known: bool = True
    """False: a robot flies it whose state is unknown; its position is the last known one."""


class EscortTruth(Message, frozen=True, kw_only=True):
    """True relation of a UAV to the UGV that it escorts."""

    uav: Name
    """Name of the UAV."""
    ugv: Name
    """Name of the UGV."""
    distance: NonNegative
    """Distance |p_a - p_g| [m]."""
    sight_radius: NonNegative | None = None
    """Distance within which the UGV is visible [m], 0 while a building hides it; None: always r_v."""
    teamed: bool = False
    """True if the UAV belongs to a team, which sees the UGV if one of its UAVs does."""
    coverage_error: NonNegative
    """Coverage error e(t) of eq. (4) with the true p_g [m²]."""
    detection: Vector | None
    """Detected relative position at this tick [m]; None: no detection."""
    report: UavReport | None
    """Report of the UAV at the last tick."""
    revoked: NotCertified | None = None
    """Reason why the certificate in this report does not hold, which the UAV cannot know; None: no such reason."""


class Truth(Message, frozen=True, kw_only=True):
    """True state of the run except the maps, for observers."""

    tick: Tick
    """Number of the tick."""
    time: NonNegative
    """Simulated time [s]."""
    vehicles: dict[Name, VehicleTruth]
    """State of each vehicle, by name."""
    escorts: tuple[EscortTruth, ...]
    """One entry for each UAV."""


class CoverageMap(Message, frozen=True, kw_only=True):
    """Coverage map, one byte for each cell."""

    tick: Tick
    """Number of the tick."""
    columns: Annotated[int, Meta(ge=1)]
    """Cells along x."""
    rows: Annotated[int, Meta(ge=1)]
    """Cells along y."""
    cell: Positive
    """Side of a cell [m]."""
    cells: bytes
    """255 min(C / C*, 1) of each cell, row by row from y = 0 (base64 in JSON)."""


class UgvGuarantee(Message, frozen=True, kw_only=True):
    """Certificates of a cautious UGV so far, compared with the true state (docs/explanation/ground.md)."""

    entered_unknown_tile: Tick
    """Ticks in which it drove on a tile that it did not know to be drivable."""
    ticks: Tick
    """Ticks in which it reported a certificate."""
    certified: Tick
    """Ticks in which it was certified."""
    uncertified: dict[Text, Tick] = {}
    """Ticks in which it was not certified, by reason."""
    certificate_broken: Tick
    """Certified ticks after which the certificate or the known tiles were lost, although all assumptions held. Any but
    0 disproves the guarantee.
    """
    near_building: Tick = 0
    """Ticks in which it came nearer to a building than its `building_clearance`, between ticks too."""
    near_building_excused: Tick = 0
    """Ticks among them under a driver that guarantees no distance. Any further tick disproves what the UGV declares."""


class MissionResult(Message, frozen=True, kw_only=True):
    """Result of the UGVs' mission on ground with hazards; for evaluation, no vehicle receives it."""

    arrived: bool
    """True if every UGV with goals has reached them all."""
    mission_time: NonNegative | None
    """Time at which the last UGV reached its last goal [s]; None: not yet, or no UGV has a goal."""
    hazards_hit: Tick
    """Blocking hazards touched, each once by each UGV."""
    near_misses: Tick
    """Blocking hazards that a UGV passed within 0.2 m without touching them."""
    hazards_on_path: Tick
    """Hazards, blocking or rough, that a UGV passed within 2 m."""
    warned: Tick
    """Hazards on the path that the UGV knew before it came within 2 m."""
    mean_warning_time: NonNegative | None
    """Mean time between knowing such a hazard and coming within 2 m [s]; None: no such hazard."""
    reported_share: Share | None
    """Share of the driven path over tiles reported by radio beforehand; None: no UGV has moved."""
    ground_certified_share: Share | None = None
    """Share of the reporting ticks at which cautious UGVs were certified; None: no reports."""
    entered_unknown_tile: Tick = 0
    """Ticks in which a UGV drove on a tile that it did not know to be drivable, over all UGVs."""
    ground_certificate_broken: Tick = 0
    """Sum of `UgvGuarantee.certificate_broken` over all UGVs."""
    near_building: Tick | None = None
    """Sum of `UgvGuarantee.near_building` over all UGVs; None: no UGV declares a distance."""
    near_building_excused: Tick | None = None
    """Sum of `UgvGuarantee.near_building_excused` over all UGVs; None: no UGV declares a distance."""
    guarantees: dict[Name, UgvGuarantee] = {}
    """Guarantee of each UGV, by name."""
    stationary_time: NonNegative
    """Time for which UGVs stood still before arrival [s]."""
    finds: Tick
    """Objects to find."""
    found: Tick
    """Objects that a vehicle's sensor has reported."""


class VehicleStatus(Message, frozen=True, kw_only=True):
    """State of a vehicle's process and its faults so far."""

    present: bool
    """True while the process is connected."""
    missing_commands: Tick = 0
    """Ticks without a new command."""
    stale_commands: Tick = 0
    """Commands used after the tick that they answer."""
    shortened_commands: Tick = 0
    """Commands that exceeded the vehicle's bound."""
    unreported_ticks: Tick = 0
    """Ticks without a valid state of its robot, with the body `reported`."""
    lost: Tick = 0
    """Times that its process disconnected."""
    rejoined: Tick = 0
    """Times that it reconnected."""
    rejected: dict[Text, Tick] = {}
    """Rejected messages and sessions, by cause."""
    last_fault: Text = ""
    """Latest fault in plain English."""


class Geometry(Message, frozen=True, kw_only=True):
    """Constants of a run for its display."""

    area: Area
    """Area of the run."""
    visibility_radius: Positive
    """Visibility radius r_v [m]."""
    sensor_range: Positive
    """Range r of the UAVs' sensor [m]."""
    switching_radius: Coordinate | None
    """Switching radius r_s of the first escort, eq. (18) [m]; None: no finite value."""
    dt: Positive
    """Length of a tick [s]."""
    limits: dict[Name, Limits] = {}
    """Bounds of each vehicle, by name."""
    max_turn_rates: dict[Name, Positive] = {}
    """Largest turn rate of each UGV that steers [rad/s]; other vehicles move in any direction."""
    uavs: dict[Name, Name]
    """UGV of each UAV, by name."""
    goals: dict[Name, tuple[Vector, ...]] = {}
    """First goals of each UGV with a goal-seeking driver [m], at most 100 each."""
    origin: Origin = Origin()
    """Geographic position of the area's origin."""
    buildings: tuple[Building, ...] = ()
    """Buildings of the run."""
    camera: Camera | None = None
    """Camera of the UAVs with an altitude; None: they fly in the plane."""
    marker_heights: dict[Name, NonNegative] = {}
    """Height of each UGV's marker above the ground [m], at which a camera detects it."""
    teams: tuple[tuple[Name, ...], ...] = ()
    """UAVs of each team, in name order; empty: there are none."""
    endurances: dict[Name, Positive] = {}
    """Flight time with a full charge of each UAV in a team that has an endurance [s]."""


class CertificateStatus(Message, frozen=True, kw_only=True):
    """Certificates of all UAVs' safety filters so far, compared with the truth."""

    ticks: Tick
    """Ticks monitored, over all UAVs."""
    certified: Tick
    """Certified ticks."""
    overridden: Tick
    """Ticks in which a safety filter overrode the law."""
    uncertified: dict[NotCertified, Tick] = {}
    """Ticks that were not certified, by reason."""
    certified_while_lost: Tick = 0
    """Ticks certified although the UGV was out of sight. Any but 0 disproves the certificate."""
    lost_without_clearance: Tick | None = None
    """Ticks that a UAV reported as certified with the UGV out of sight, while the UGV kept no distance from buildings:
    explained by its driver. None: no certificate was revoked for this reason.
    """
    certificate_broken: Tick = 0
    """Uncertified ticks after a certified one, although all assumptions held. Any but 0 disproves the certificate."""
    max_command_interval: NonNegative | None = None
    """Declared longest time from the start of one plan to the start of the next [s]."""
    longest_command_interval: NonNegative | None = None
    """Longest such time so far [s]."""
    max_tracking_error: NonNegative | None = None
    """Declared largest tracking error [m]; None: no disturbance, or no bound."""
    largest_tracking_error: NonNegative | None = None
    """Largest tracking error so far [m]; None: no disturbance."""
    tracking_exceeded: Tick | None = None
    """Ticks in which the tracking error exceeded its declared bound; None: no disturbance."""


class TeamStatus(Message, frozen=True, kw_only=True):
    """Guarantee and traffic of the teams so far (docs/explanation/teams.md)."""

    team_certified_share: Share
    """Share of the ticks in which a guard was certified, over all teams."""
    team_out_of_sight: Tick
    """Ticks in which no UAV of a team saw its UGV."""
    team_certified_while_lost: Tick = 0
    """Ticks in which a guard was certified, but no UAV of its team saw the UGV. Any but 0 disproves the guarantee."""
    team_certificate_broken: Tick = 0
    """Ticks in which a UAV with one of the largest stored numbers did not guard. Any but 0 disproves the guarantee."""
    handovers: Tick = 0
    """Changes of the UAV with the largest number."""
    extra_guard_share: Share = 0.0
    """Share of the ticks with more guards than wanted."""
    left_without_relief: Tick = 0
    """Times that a guard with one of the largest numbers left for its base, as its charge was exhausted."""
    separation_violations: Tick = 0
    """Ticks in which two UAVs with an altitude were nearer than `team.separation`. Any but 0 disproves that their
    altitude bands keep them apart.
    """
    team_traffic: NonNegative = 0.0
    """Mean size of the messages that each UAV sends to its team, as JSON [B/s]."""
    charges: dict[Name, NonNegative] = {}
    """Flight time that each UAV with an endurance has left [s]."""
    numbers: dict[Name, Tick] = {}
    """Stored number of each UAV in a team; 0: it has never guarded."""
    refused_messages: Tick = 0
    """Messages that the simulator has not sent: wrong sender, tick, number, rate, measurement or request."""


class Status(Message, frozen=True, kw_only=True):
    """State of the run for observers, sent a few times per second."""

    scenario: Text
    """Name of the scenario."""
    seed: Seed
    """Seed of the flight."""
    tick: Tick
    """Number of the tick."""
    ticks: Tick
    """Ticks of the whole run."""
    time: NonNegative
    """Simulated time [s]."""
    realtime_factor: NonNegative
    """Recent pace: simulated seconds per second of wall time [1]."""
    target_factor: NonNegative | None = None
    """Target pace [1]; None: lockstep, as fast as possible."""
    late_ticks: Tick = 0
    """Ticks that missed the wall clock."""
    paused: bool = False
    """True while the run is paused."""
    law: Name = DEFAULT_LAW
    """Control law of the UAVs, as selected last."""
    laws: dict[Name, Name] = {}
    """Current control law of each UAV that flies another one."""
    drivers: dict[Name, Name] = {}
    """Current driver of each UGV."""
    operators: dict[Name, Name] = {}
    """Operator of each UGV, by the latest `Control.operator`, where known."""
    changes: tuple[Change, ...] = ()
    """Latest controls that took effect, newest last, at most 20."""
    rejections: tuple[Rejection, ...] = ()
    """Latest controls that were rejected, newest last, at most 5."""
    geometry: Geometry | None = None
    """Constants for the display."""
    certified: dict[Name, bool] = {}
    """True if visibility is certified, by UAV with a safety filter."""
    uncertified: dict[Name, NotCertified] = {}
    """Reason for the missing certificate, by UAV."""
    certificates: CertificateStatus | None = None
    """Counts of certificates so far; None: no safety filter."""
    roles: dict[Name, Role] = {}
    """Role of each UAV in a team."""
    team: TeamStatus | None = None
    """Counts of the teams so far; None: there are none."""
    mission: MissionResult | None = None
    """Result of the mission so far; None: no hazards."""
    warnings: tuple[Text, ...] = ()
    """Assumptions of the certificate that the current links or drivers can violate, one line each, at most 50; a longer
    line is shortened in the middle.
    """
    links: dict[Text, LinkStatus] = {}
    """Counters of each link, by `vehicle/kind`."""
    vehicles: dict[Name, VehicleStatus]
    """State of each vehicle's process, by name."""
    over: bool = False
    """True when the run has ended."""
