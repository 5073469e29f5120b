"""Every message, as a frozen struct: the information contract in types.

JSON by msgspec. Unknown fields are refused, numbers carry bounds. SI units; positions are in the world frame,
relative positions are p_delta = p_a - p_g, from the UGV to the UAV. No message to a UAV has a field for the UGV's
velocity, input or goal, and none to a UGV for the UAV's.
"""

import math
from enum import StrEnum
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from bus.registry import DEFAULT_LAW, DEFAULT_SENSOR

Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""A component of a position [m], a velocity [m/s] or an acceleration [m/s²]."""
NonNegative = Annotated[float, Meta(ge=0.0, le=1e12)]
Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
Tick = Annotated[int, Meta(ge=0, le=2**53)]
Name = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,31}$(?!\n)")]
LONGEST_TEXT = 500
"""Letters of a text."""
Text = Annotated[str, Meta(max_length=LONGEST_TEXT)]
Line = Annotated[str, Meta(max_length=LONGEST_TEXT, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$(?!\n)")]
"""A text without control characters."""
PilotKey = Annotated[str, Meta(pattern=r"^[0-9a-f]{32}$(?!\n)")]
"""128 bits: a string, as not every language's JSON keeps whole numbers of more than 53."""
Vector = tuple[Coordinate, Coordinate]
Covariance = tuple[NonNegative, Coordinate, NonNegative]
"""xx, xy and yy of a symmetric 2 x 2 matrix [m²]."""


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every message."""


def or_infinite(bound: float | None) -> float:
    """Return a bound of a message as a number, infinite where there is none."""
    return math.inf if bound is None else float(bound)


def or_none(bound: float) -> float | None:
    """Return a bound as a message carries it: None where it is infinite."""
    return None if math.isinf(bound) else bound


class Limits(Message, frozen=True, kw_only=True):
    """Bounds of a double integrator (1); None where there is none."""

    max_speed: Positive | None
    """v_max [m/s]."""
    max_acceleration: Positive | None
    """u_max [m/s²]."""

    @property
    def numbers(self) -> tuple[float, float]:
        """v_max [m/s] and u_max [m/s²], infinite where there is none."""
        return or_infinite(self.max_speed), or_infinite(self.max_acceleration)


class Area(Message, frozen=True, kw_only=True):
    """Q: the rectangle [0, width] x [0, height] and the grid on it."""

    width: Positive
    height: Positive
    cell: Positive


class Origin(Message, frozen=True, kw_only=True):
    """The place on Earth of the area's lower left corner (WGS 84); x points east and y north."""

    latitude: Annotated[float, Meta(ge=-80.0, le=80.0)] = 49.875
    """[deg]; by default in Darmstadt, where the paper was written."""
    longitude: Annotated[float, Meta(ge=-180.0, le=180.0)] = 8.66
    """[deg]"""
    altitude: Annotated[float, Meta(ge=-500.0, le=9000.0)] = 150.0
    """Of the ground [m]; it is flat."""


class Region(Message, frozen=True, kw_only=True):
    """A rectangle of ground [m] that is covered from the start."""

    lower: Vector
    upper: Vector


class Sensor(Message, frozen=True, kw_only=True):
    """The UAV's downward sensor (2)."""

    model: Name = DEFAULT_SENSOR
    """A row of `bus.registry.SENSORS`."""
    peak: Positive = 1.0
    """M_a [1/s]."""
    range: Positive = 5.0
    """r [m]."""


LawNumber = (
    bool | Annotated[int, Meta(ge=-(2**53), le=2**53)] | Annotated[float, Meta(ge=-1e12, le=1e12)]
)
"""A parameter of a law."""


class Law(Message, frozen=True, kw_only=True):
    """The control law that the UAV flies, and its parameters."""

    name: Name = DEFAULT_LAW
    """A row of `bus.registry.LAWS`."""
    parameters: Annotated[dict[Text, LawNumber], Meta(max_length=64)] = {}
    """By name: fields of `Parameters` in the law's file; those of other laws have no effect."""

    def __hash__(self) -> int:
        return hash((self.name, tuple(sorted(self.parameters.items()))))


class LinkKind(StrEnum):
    """The kinds of messages that cross a link."""

    DETECTIONS = "detections"
    """From a UAV's detector to its computer."""
    COMMANDS = "commands"
    """From a vehicle's computer to its actuators."""
    OPERATOR = "operator"
    """From an operator to a UGV."""
    RADIO = "radio"
    """From a UAV to the UGV it escorts."""


Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Seconds = Annotated[float, Meta(ge=0.0, le=1e6)]


class LinkSettings(Message, frozen=True, kw_only=True):
    """The settings of one link, all that it does to messages; the default is a perfect one."""

    delay: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    """[s]"""
    jitter: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    """Scale of the extra delay [s]."""
    jitter_shape: Name = "uniform"
    """A row of `sim.channel.jitter.SHAPES`, which says what the scale means."""
    jitter_cut: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.0
    """The extra delay lies between -delay and this [s], as if drawn again until it does; 0: five times the jitter."""
    loss: Share = 0.0
    """Share of messages that are lost, each on its own."""
    burst_length: Seconds = 0.0
    """Mean length of the bad state (Gilbert-Elliott) [s]; 0: no bursts."""
    burst_interval: Seconds = 0.0
    """Mean time in the good state between two [s]."""
    burst_loss: Share = 1.0
    """Share of messages that are lost in the bad state."""
    blackouts: Annotated[tuple[tuple[Seconds, Seconds], ...], Meta(max_length=1000)] = ()
    """Start and length of planned ones [s]: nothing that leaves then gets through."""
    blackout_interval: Seconds = 0.0
    """Mean time between the end of a random blackout and the start of the next [s]; 0: none."""
    blackout_length: Seconds = 0.0
    """Length of each random one [s]."""
    duplicates: Share = 0.0
    """Share of messages that arrive twice; the copy has a delay of its own."""
    reorder: Share = 0.0
    """Share of messages that are held back."""
    reorder_delay: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    """By how much [s]."""
    bandwidth: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """Messages per second [1/s]; 0: no limit."""
    queue: Annotated[int, Meta(ge=1, le=10_000)] = 10
    """Messages that can wait at the sender."""
    keep: Name = "newest"
    """The messages that a full queue keeps, of `KEEPS`."""
    trace: Text = ""
    """A recorded link that is played in a loop instead of drawing: a Mahimahi file, or a CSV table of sent and delay.

    The file lies beside the scenario's or below. Beside a Mahimahi file, which says when bytes may leave, stands all
    but bandwidth; beside a table, which says what became of each message, stand delay and blackouts alone."""
    message_bytes: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000
    """Size of a message where a Mahimahi file is played [bytes]: each of its lines lets 1,500 bytes leave."""

    def unlike(self, other: "LinkSettings | None" = None) -> dict[str, Any]:
        """The fields in which it differs from another link, by default a perfect one, as plain values."""
        theirs = msgspec.to_builtins(other or LinkSettings())
        mine = msgspec.to_builtins(self)
        return {name: value for name, value in mine.items() if value != theirs[name]}


class LinkStatus(Message, frozen=True, kw_only=True):
    """The counters of a link: sent + duplicated = delivered + lost + waiting + flying."""

    sent: Tick
    delivered: Tick
    """Copies among them."""
    duplicated: Tick
    """Copies that were made."""
    waiting: Tick
    """At the sender."""
    flying: Tick
    lost: dict[Text, Tick]
    """By cause, of `sim.channel.link.CAUSES`."""
    delivery_ratio: Share | None = None
    """Of the messages whose fate is known, the share that was not lost."""
    age: NonNegative | None = None
    """Of the newest information delivered, at the last tick [s]; None before the first."""
    mean_age: NonNegative | None = None
    """Over the ticks since then."""
    max_age: NonNegative | None = None
    degraded: bool = False
    """True if its settings do anything to a message."""
    settings: LinkSettings | None = None


class Detector(Message, frozen=True, kw_only=True):
    """The UAV's knowledge of its own detector of the UGV."""

    noise: NonNegative = 0.0
    """Standard deviation per axis [m]."""
    cut: Positive | None = 3.0
    """Noise vectors are cut at this many standard deviations; None: not cut."""
    period: Positive
    """Time between two looks [s]."""


MOST_CARRIED = 6
"""Motions that one command carries at most: its own and those before it that have not begun, so that it fits a
kilobyte.
"""

Ticks = Annotated[int, Meta(ge=0, le=1_000_000)]


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


TILE_LETTERS = "?.~#*"
"""Names of the states of a tile in messages: not seen, clear, rough, blocked, and clear with a find on it."""
BLOCK_SIDE = 8
"""Tiles along each side of a `GroundBlock`."""
MOST_BLOCKS = 4
"""Blocks that one command carries at most."""

MOST_CORNERS = 128
"""Corners of a route that one command carries at most: what turns more often is shown up to there."""

Place = Annotated[int, Meta(ge=0, le=1_000_000)]


class SeenTile(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A tile of the ground as a vehicle's own sensor sees it; in JSON an array of these fields, in this order."""

    column: Place
    row: Place
    """The tile from x = column * tile and y = row * tile [m] on."""
    state: Annotated[str, Meta(pattern=r"^[.~#*]$(?!\n)")]
    """One of `TILE_LETTERS`."""


class GroundBlock(Message, frozen=True, kw_only=True):
    """A UAV's radio message of the ground to its UGV: the states of a block of tiles, as its sensor has told them."""

    column: Place
    row: Place
    """Of the block: that of its first tile divided by `BLOCK_SIDE`."""
    tiles: Annotated[str, Meta(pattern=r"^[?.~#*]{64}$(?!\n)")]
    """The state of each tile, of `TILE_LETTERS`, row by row from the least y on; beyond the area they are not seen."""


class UavGround(Message, frozen=True, kw_only=True):
    """A UAV's sensor of hazards, as its briefing tells."""

    tile: Positive
    """Width of a tile [m]."""
    telling: NonNegative
    """Blocks that it radios to its UGV in a second [1/s]."""


class UgvGround(Message, frozen=True, kw_only=True):
    """A UGV's sensor of the ground and its caution, as its briefing tells."""

    tile: Positive
    """Width of a tile [m]."""
    bumper: NonNegative
    """Range of its own sensor [m]: it sees each tile that has a point so near."""
    caution: Name
    """Its caution on ground that it does not know: one of `bus.registry.CAUTIONS`."""
    delay: NonNegative = 0.0
    """From the tick that a command answers to the one in which it acts [s]."""
    share: Annotated[float, Meta(gt=0.0, le=1.0)]
    """Of its largest speed that it has at least on rough ground."""
    carries: bool = False
    """True if its receiver flies the motions that commands carry: a command acts in its own tick or not at all, and the
    vehicle brakes where none does."""


class SafetyParameters(Message, frozen=True, kw_only=True):
    """Parameters of a UAV's safety filter and of its certificate (docs/explanation/certificate.md)."""

    max_measurement_error: NonNegative | None
    """Largest error of a detection, as a vector's norm [m]; None: no bound, and nothing can be certified."""
    max_measurement_age: Positive
    """Largest age of the newest detection that has arrived [s]."""
    max_command_delay: NonNegative = 0.0
    """Time from the tick that a command answers to the start of its plan [s]."""
    max_command_interval: NonNegative = 0.0
    """Longest time from the start of one plan to the start of the next [s]; one tick at least."""
    max_tracking_error: NonNegative | None = 0.0
    """Largest distance of the UAV from its reference position [m]; None: no bound."""
    margin: NonNegative = 0.0
    """Taken off r_v [m], for what the theorem does not cover."""


class Estimator(Message, frozen=True, kw_only=True):
    """The Kalman filter on the detections."""

    enabled: bool = True
    """False: the newest detection is taken as it is and held."""
    gate: Positive = 18.4
    """Largest normalized innovation squared that is believed (chi-square, 2 degrees: 1 in 10,000)."""
    patience: Annotated[int, Meta(ge=1, le=1_000_000)] = 5
    """Detections refused in a row after which the filter starts anew from the newest."""
    manoeuvre: Positive = 0.7
    """Standard deviation of the UGV's acceleration per axis, as a share of its bound."""


class UavBriefing(Message, frozen=True, kw_only=True):
    """All a UAV is told when it joins.

    One that joins again is told its own past too, in parts: each is a briefing of its own.
    """

    vehicle: Name
    dt: Positive
    """Time between two ticks [s]."""
    area: Area
    limits: Limits
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
    hold: NonNegative = 0.5
    """Time for which a command without a motion stays in effect when no new one arrives [s]; then the UAV brakes."""
    ground: UavGround | None = None
    """None: there are no hazards, and nothing is told of the ground."""
    origin: Origin = Origin()
    """Place on Earth that its positions are counted from, for bridges to programs that count in degrees."""
    key: PilotKey
    """Of the pilot's own random numbers.

    Where the run has a secret it leads to nothing else: not to the seed, nor to any other
    draw. Where it has none, whoever tries all seeds finds the run's: there the seed is the secret."""
    past: "tuple[UavObservation, ...]" = ()
    """Its observations so far in this run, tick by tick; where its process was away, without detections."""
    more: bool = False
    """True if another part of the past follows."""
    episode: Tick = 0
    """Number of the flight that this is for."""


class ScriptStep(Message, frozen=True, kw_only=True):
    """The velocity that a scripted UGV wants from a time on."""

    time: NonNegative
    """[s]"""
    velocity: Vector
    """[m/s]"""


class UgvBriefing(Message, frozen=True, kw_only=True):
    """All a UGV is told when it joins; its past as a UAV's."""

    vehicle: Name
    dt: Positive
    area: Area
    limits: Limits
    driver: Name
    """A row of `bus.registry.DRIVERS`."""
    goals: tuple[Vector, ...]
    """Waypoints [m], in order."""
    goal_tolerance: Positive
    """epsilon: a goal counts as reached nearer than this [m]."""
    script: tuple[ScriptStep, ...] = ()
    """The steps of the driver `script`, in the order of time."""
    hold: NonNegative = 0.5
    """Time that an operator's last word counts [s]; then the driver `teleop` brakes."""
    ground: UgvGround | None = None
    """None: there are no hazards, and nothing is told of the ground."""
    key: PilotKey
    past: "tuple[UgvObservation, ...]" = ()
    more: bool = False
    episode: Tick = 0


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


class UavObservation(Message, frozen=True, kw_only=True):
    """The perception of a UAV at a tick."""

    tick: Tick
    time: NonNegative
    position: Vector
    """Its place as its inner loop believes and steers it [m]: in wind or with a wrong own position not quite the
    true one.
    """
    velocity: Vector
    """Likewise [m/s]."""
    detections: tuple[Detection, ...] = ()
    flown: Tick | None = None
    """The motion that the vehicle flew in the tick before: that in which it began; None: it flew none."""
    ground: tuple[SeenTile, ...] = ()
    """Tiles that its sensor has told of since the tick before: each once, when it has been looked at enough."""
    law: Law | None = None
    """The law to fly from this tick on; None: the one before."""
    over: bool = False
    """True: the run has ended at this tick and no command is awaited."""
    episode: Tick = 0
    """Number of the flight; a reset begins the next."""


class Drive(Message, frozen=True, kw_only=True):
    """The wish of an operator at a UGV's wheel: a velocity, or a goal; neither means to brake."""

    driver: Text
    """The operator's name."""
    velocity: Vector | None = None
    """Desired velocity [m/s]."""
    goal: Vector | None = None
    """The goal [m]."""


class UgvObservation(Message, frozen=True, kw_only=True):
    """The perception of a UGV at a tick."""

    tick: Tick
    time: NonNegative
    position: Vector
    velocity: Vector
    radio: tuple[RelativeInformation, ...] = ()
    blocks: tuple[GroundBlock, ...] = ()
    """The blocks that have come by radio, of the ground that the UAV has seen."""
    ground: tuple[SeenTile, ...] = ()
    """Tiles that its own bumper has seen since the tick before."""
    operator: tuple[Drive, ...] = ()
    """The operators' messages that have come to the vehicle at this tick, the oldest first."""
    driver: Name | None = None
    """The driver from this tick on, a row of `bus.registry.DRIVERS`; None: the one before."""
    flown: Tick | None = None
    """The motion that the vehicle flew in the tick before: that in which it began; None: it flew none."""
    over: bool = False
    episode: Tick = 0


class UavReport(Message, frozen=True, kw_only=True):
    """The report of a UAV to observers; no vehicle reads it."""

    estimate: Vector
    """Place at which it believes the UGV to be [m]."""
    covariance: Covariance
    """Of that estimate [m²]."""
    age: NonNegative
    """Time since the newest detection that was believed [s]."""
    refused: Tick
    """Detections refused by the gate so far."""
    certified: bool | None = None
    """True if sight is certified to be kept from here on; None: no filter watches over this law."""
    uncertified: Text = ""
    """Why not."""
    intervened: bool = False
    """True if the safety filter acted instead of the law."""
    certified_distance: NonNegative | None = None
    """The UGV is surely no farther than this [m]."""


class UavCommand(Message, frozen=True, kw_only=True):
    """A UAV's answer to its observation of the same tick."""

    tick: Tick
    acceleration: Vector
    motions: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """The motions to be flown from the tick on in which the last of them begins, and before it those that it may
    have missed, one a tick, the oldest first. Without one the vehicle holds the acceleration, and brakes when no
    command comes.
    """
    radio: tuple[RelativeInformation, ...] = ()
    blocks: Annotated[tuple[GroundBlock, ...], Meta(max_length=MOST_BLOCKS)] = ()
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
    motions: Annotated[tuple[BackupTrajectory, ...], Meta(max_length=MOST_CARRIED)] = ()
    """As of a UAV: the acceleration of a tick, and the stop that follows it. None: the command is held."""
    route: Annotated[tuple[Vector, ...], Meta(max_length=MOST_CORNERS)] | None = None
    """For observers, no vehicle reads it: the way that it plans to its goal, by its corners [m], from where it is; none
    where it knows none. None: as before.
    """
    report: UgvReport | None = None
    """None: it does not promise to stay on tiles that it knows."""


class Action(StrEnum):
    """The actions of a `Control`."""

    PAUSE = "pause"
    RESUME = "resume"
    STEP = "step"
    SPEED = "speed"
    RESET = "reset"
    LAW = "law"
    DRIVER = "driver"
    LINK = "link"


class Control(Message, frozen=True, kw_only=True):
    """An operator's request to the simulator; takes effect at the next tick. Only the fields of its action count."""

    action: Action
    ticks: Annotated[int, Meta(ge=1, le=1_000_000)] = 1
    """STEP: how far."""
    factor: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    """SPEED: simulated seconds per second of wall time; None: lockstep, as fast as it goes."""
    seed: Tick | None = None
    """RESET: of the new flight; None: the same again."""
    law: Law | None = None
    """LAW: what the UAVs fly."""
    vehicle: Name | None = None
    """DRIVER: which UGV; LINK: whose. None: every one."""
    driver: Name | None = None
    """DRIVER: who takes its wheel."""
    operator: Name | None = None
    """DRIVER: the operator who takes it, where the driver obeys one; each has a name of its own."""
    link: LinkKind | None = None
    """LINK: which."""
    settings: LinkSettings | None = None
    """LINK: what it does to messages from now on."""

    def in_words(self) -> str:
        """Tells a person what was asked for."""
        match self.action:
            case Action.LAW if self.law is not None:
                return f"law {self.law.name}"
            case Action.DRIVER:
                return f"driver {self.driver} in {self.vehicle or 'every UGV'}"
            case Action.LINK:
                settings = self.settings or LinkSettings()
                changed = [f"{name} {value}" for name, value in settings.unlike().items()]
                whose = self.vehicle or "every vehicle"
                return f"link {self.link} of {whose}: {', '.join(changed) or 'perfect'}"
            case Action.SPEED:
                factor = self.factor
                return "lockstep" if factor is None else f"{factor:g} times real time"
            case Action.STEP:
                return f"step {self.ticks}"
            case _:
                return str(self.action)


class Change(Message, frozen=True, kw_only=True):
    """A control that has taken effect, and when."""

    tick: Tick
    control: Control


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
    hazards_on_way: Tick
    """Hazards, blocking or rough, that a UGV came nearer to than 2 m."""
    warned: Tick
    """Those of them that it knew of before it came so near."""
    warned_before: NonNegative | None
    """Time from then until it came so near, in the mean of those [s]; None: there are none."""
    seen_ahead: Share | None
    """Share of the way that led over tiles which had come by radio before; None: nobody has moved."""
    entered_unknown_tile: Tick = 0
    """Ticks in which a UGV drove over a tile that it did not know to be drivable, of all UGVs."""
    ground_certificate_broken: Tick = 0
    """As `UgvGuarantee.certificate_broken`, of all UGVs."""
    guarantees: dict[Name, UgvGuarantee] = {}
    """Guarantee of each UGV, by name."""
    still_time: NonNegative
    """Time that the UGVs stood still before they had arrived [s]."""
    finds: Tick
    """Things to be found."""
    found: Tick
    """Those that a vehicle's sensor has told of."""


class HazardOutline(Message, frozen=True, kw_only=True):
    """A hazard as it truly lies on the ground, a disc or a polygon."""

    kind: Name
    """A row of `bus.registry.HAZARDS`."""
    center: Vector = (0.0, 0.0)
    radius: NonNegative = 0.0
    """Of the disc [m]; 0: it is a polygon."""
    corners: tuple[Vector, ...] = ()
    """Of the polygon, in order round it [m]."""


class GroundMap(Message, frozen=True, kw_only=True):
    """The ground for observers: its hazards as they truly are, and what the UGVs know of it."""

    tick: Tick
    columns: Annotated[int, Meta(ge=1)]
    rows: Annotated[int, Meta(ge=1)]
    tile: Positive
    """Width of a tile [m]."""
    tiles: bytes
    """Each tile as the UGVs know it, all together, row by row from y = 0 (base64 in JSON).

    Its place in `TILE_LETTERS`; 5 where a UAV has seen it and has not told it yet.
    """
    states: bytes
    """Of each hazard: 0, no UGV knows of it, or nobody has found it; 1, one does; 2, one has hit it."""
    routes: dict[Name, tuple[Vector, ...]] = {}
    """The way that each UGV plans to its goal, by its corners [m], from where it is; no vehicle is told."""
    hazards: tuple[HazardOutline, ...] = ()
    """In a recording only in a flight's first map: they stay where they are."""


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
    refused: dict[Text, Tick] = {}
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
    intervened: Tick
    """Those in which a filter acted instead of the law."""
    uncertified: dict[Text, Tick] = {}
    """Those that were not certified, by reason."""
    certified_while_lost: Tick = 0
    """Those that were certified although the UGV was out of sight: the certificate is wrong if there is one."""
    certificate_broken: Tick = 0
    """Those that were not certified although the one before was and all assumptions hold: likewise."""
    outage: NonNegative | None = None
    """Longest time from the start of a motion to the start of the next, as it is declared, B [s]."""
    longest_outage: NonNegative | None = None
    """The longest so far [s]."""
    tracking: NonNegative | None = None
    """Largest true distance of a UAV from where it is told that it is, as it is declared, w [m]; None: nothing takes it
    from there, or w has no bound.
    """
    tracking_error: NonNegative | None = None
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
    wanted_factor: NonNegative | None = None
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
    uncertified: dict[Name, Text] = {}
    """Why not, by UAV."""
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


Observation = UavObservation | UgvObservation
Command = UavCommand | UgvCommand
Briefing = UavBriefing | UgvBriefing
