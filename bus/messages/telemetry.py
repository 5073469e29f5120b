"""What observers of a run receive."""

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
    """The true state of one vehicle."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    """Applied since the last tick, after the bounds."""
    command: Vector
    """The command that it was asked for since the last tick, before the bounds [m/s²].

    Where it was silent, what stood in for it.
    """


class EscortTruth(Message, frozen=True, kw_only=True):
    """The true relation of one UAV to the UGV it escorts."""

    uav: Name
    ugv: Name
    distance: NonNegative
    """|p_a - p_g| [m]."""
    coverage_error: NonNegative
    """e(t) of (4) with the true p_g [m²]."""
    detection: Vector | None
    """The relative position detected at this tick [m], if any."""
    report: UavReport | None
    """The UAV's report at the last tick."""


class Truth(Message, frozen=True, kw_only=True):
    """Everything but the grid, for observers."""

    tick: Tick
    time: NonNegative
    vehicles: dict[Name, VehicleTruth]
    escorts: tuple[EscortTruth, ...]


class CoverageMap(Message, frozen=True, kw_only=True):
    """The coverage as bytes: 255 is the desired coverage or more."""

    tick: Tick
    columns: Annotated[int, Meta(ge=1)]
    rows: Annotated[int, Meta(ge=1)]
    cell: Positive
    cells: bytes
    """Row by row from y = 0 (base64 in JSON)."""


class UgvGuarantee(Message, frozen=True, kw_only=True):
    """Certificates of a cautious UGV so far, compared with the truth (docs/explanation/ground.md)."""

    entered_unknown_tile: Tick
    """Ticks in which it drove over a tile that it did not know to be drivable."""
    ticks: Tick
    """Ticks in which it reported whether it is certified to stay on tiles that it knows."""
    certified: Tick
    """Ticks in which it was."""
    uncertified: dict[Text, Tick] = {}
    """Ticks in which it was not, by reason."""
    certificate_broken: Tick
    """Certified ticks after which it was not certified, or in which it entered such a tile, although all assumptions
    hold: the guarantee is wrong if there is one."""


class MissionResult(Message, frozen=True, kw_only=True):
    """The UGVs' way through ground with hazards, all together: for measuring, no vehicle is told."""

    arrived: bool
    """True if every UGV that has goals has reached them all."""
    mission_time: NonNegative | None
    """Time at which the last of them had [s]; None: not yet, or nobody has a goal."""
    hazards_hit: Tick
    """Blocking hazards that were touched, each once by each UGV."""
    near_misses: Tick
    """Blocking hazards that a UGV came nearer to than 0.2 m without touching them."""
    hazards_on_path: Tick
    """Hazards, blocking or rough, that a UGV came nearer to than 2 m."""
    warned: Tick
    """Those of them that it knew of before it came so near."""
    mean_warning_time: NonNegative | None
    """Time from then until it came so near, in the mean of those [s]; None: there are none."""
    reported_share: Share | None
    """Share of the way that led over tiles which had come by radio before; None: nobody has moved."""
    ground_certified_share: Share | None = None
    """Share of the ticks at which cautious UGVs were certified, of those in which they reported it; None: none did."""
    entered_unknown_tile: Tick = 0
    """Ticks in which a UGV drove over a tile that it did not know to be drivable, of all UGVs."""
    ground_certificate_broken: Tick = 0
    """As `UgvGuarantee.certificate_broken`, of all UGVs."""
    guarantees: dict[Name, UgvGuarantee] = {}
    """Guarantee of each UGV, by name."""
    stationary_time: NonNegative
    """Time that the UGVs stood still before they had arrived [s]."""
    finds: Tick
    """Things to be found."""
    found: Tick
    """Those that a vehicle's sensor has told of."""


class VehicleStatus(Message, frozen=True, kw_only=True):
    """The state of a vehicle's process, and what has gone wrong with it so far."""

    present: bool
    missing_commands: Tick = 0
    """Ticks for which no new command was there."""
    stale_commands: Tick = 0
    """Commands that were used after the tick they answer."""
    shortened_commands: Tick = 0
    """Commands that were longer than the vehicle's bound."""
    lost: Tick = 0
    """Number of times that its process went away during the run."""
    rejoined: Tick = 0
    """Number of times that it came back."""
    rejected: dict[Text, Tick] = {}
    """Messages and sessions that were refused, by cause."""
    last_fault: Text = ""


class Geometry(Message, frozen=True, kw_only=True):
    """The facts that a picture of the run needs and that do not change."""

    area: Area
    visibility_radius: Positive
    """r_v [m]."""
    sensor_range: Positive
    """r [m]."""
    switching_radius: Coordinate | None
    """r_s of (18) of the first escort [m]; None where it has no finite value."""
    dt: Positive
    """[s]"""
    limits: dict[Name, Limits] = {}
    """Each vehicle's bounds."""
    uavs: dict[Name, Name]
    """Each UAV, and the UGV it escorts."""
    goals: dict[Name, tuple[Vector, ...]] = {}
    """The first goals of each UGV that may drive to them [m]; not more than 100 each."""
    origin: Origin = Origin()
    """Place on Earth that the positions are counted from."""


class CertificateStatus(Message, frozen=True, kw_only=True):
    """The words of all UAVs' safety filters so far, held against the truth."""

    ticks: Tick
    """Ticks that a filter watched over, of each UAV."""
    certified: Tick
    """Those that were certified."""
    overridden: Tick
    """Those in which a filter acted instead of the law."""
    uncertified: dict[NotCertified, Tick] = {}
    """Those that were not certified, by reason."""
    certified_while_lost: Tick = 0
    """Those that were certified although the UGV was out of sight: the certificate is wrong if there is one."""
    certificate_broken: Tick = 0
    """Those that were not certified although the one before was and all assumptions hold: likewise."""
    max_command_interval: NonNegative | None = None
    """Longest time from the start of a motion to the start of the next, as it is declared, B [s]."""
    longest_command_interval: NonNegative | None = None
    """The longest so far [s]."""
    max_tracking_error: NonNegative | None = None
    """Largest true distance of a UAV from where it is told that it is, as it is declared, w [m]; None: nothing takes it
    from there, or w has no bound.
    """
    largest_tracking_error: NonNegative | None = None
    """And the farthest so far [m]; None: nothing takes it from there."""


class Status(Message, frozen=True, kw_only=True):
    """The state of the run, for observers, a few times a second."""

    scenario: Text
    seed: int
    tick: Tick
    ticks: Tick
    """Ticks that the run will have."""
    time: NonNegative
    realtime_factor: NonNegative
    """Simulated seconds per second of wall time, lately."""
    target_factor: NonNegative | None = None
    """The pace that the clock is to keep; None: lockstep, as fast as it goes."""
    late_ticks: Tick = 0
    """Ticks that the clock could not keep."""
    paused: bool = False
    law: Name = DEFAULT_LAW
    """The law that the UAVs fly now."""
    drivers: dict[Name, Name] = {}
    """The driver of each UGV now."""
    operators: dict[Name, Name] = {}
    """The operator at the wheel of each UGV, by the `Control.operator` that took it last; where that is known."""
    changes: tuple[Change, ...] = ()
    """The last controls that have taken effect, the newest last; not more than 20."""
    refusals: tuple[Text, ...] = ()
    """The last wishes of operators that were refused, and why; not more than 5."""
    geometry: Geometry | None = None
    certified: dict[Name, bool] = {}
    """True if sight is certified to be kept, by UAV; only those that a safety filter watches over."""
    uncertified: dict[Name, NotCertified] = {}
    """Reason why not, by UAV."""
    certificates: CertificateStatus | None = None
    """Counts of what has been certified so far; None where no safety filter has watched over anything."""
    mission: MissionResult | None = None
    """The UGVs' way through; None where there are no hazards."""
    warnings: tuple[Text, ...] = ()
    """Assumptions of the certificate that the links cannot keep as they are now, a line each."""
    links: dict[Text, LinkStatus] = {}
    """Counters of each link, by `vehicle/kind`."""
    vehicles: dict[Name, VehicleStatus]
    over: bool = False
