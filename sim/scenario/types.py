"""A run described: the tables of a scenario and their fields, typed.

They stand in `sim`, since world, engine, environment and server are made from them; `loading` reads them from TOML
and `checks` refuses what is impossible. What these need to know of laws, drivers and sensors is in `bus.registry`.
"""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Line, Name, NonNegative, Positive, Text, Vector
from bus.messages.ground import DEFAULT_SHARE, Hazard, SpeedShare, kept_share
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Area, Estimator, Law, Origin, Region, ScriptStep, Sensor
from bus.registry import CAUTIONS, DEFAULT_DRIVER, HAZARDS, TOUCHES
from sim.channel.recorded import RecordedLink
from sim.models.inner_loop import InnerLoop
from sim.models.vehicles import raw_switching_radius

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Bound = Annotated[float, Meta(gt=0.0)]
"""A bound that may be infinite (TOML: inf)."""


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of the scenario's tables."""


class Visibility(_Table, frozen=True, kw_only=True):
    """The constraint (5)."""

    radius: Positive = 4.75
    """r_v [m]."""


class Coverage(_Table, frozen=True, kw_only=True):
    """The coverage that is wanted, and the ground that has it already."""

    desired: Positive = 2.0
    """C* of (4)."""
    covered: tuple[Region, ...] = ()
    """Rectangles that are covered from the start."""


class Detections(_Table, frozen=True, kw_only=True):
    """The UAV's detector of the UGV: certain inside r_v, falling to nothing at the sensor's range."""

    noise: NonNegative = 0.0
    """Standard deviation per axis [m]."""
    truncation: Bound = 3.0
    """The noise vector's norm is cut at this many standard deviations; inf: not cut."""
    rate: Positive = 20.0
    """Looks per second [1/s]; a whole number of ticks must fit between two."""
    dropout: Share = 0.0
    """Share of looks that fail for no reason."""


class Wind(_Table, frozen=True, kw_only=True):
    """The wind, as it accelerates each UAV; without a mean and gusts there is none. No vehicle is told of it."""

    mean: Vector = (0.0, 0.0)
    """[m/s²]"""
    gust: NonNegative = 0.0
    """Standard deviation per axis around the mean [m/s²]; each UAV has gusts of its own."""
    gust_time: Positive = 2.0
    """After this time a third of a gust is left [s]."""
    limit: NonNegative | None = None
    """Largest acceleration [m/s²], at which mean and gust together are cut; by default that of the mean and 3 gusts."""

    @property
    def largest(self) -> float:
        """The largest acceleration [m/s²]."""
        most = math.hypot(*self.mean) + 3.0 * self.gust
        return most if self.limit is None or most == 0.0 else self.limit


MOST_HAZARDS = 10_000


class HazardField(_Table, frozen=True, kw_only=True):
    """Discs at random places, others with each seed. They never close the last way from a UGV's start to its goals."""

    kind: Name
    """A row of `bus.registry.HAZARDS`."""
    count: Annotated[int, Meta(ge=1, le=MOST_HAZARDS)]
    """Number of hazards."""
    radius: tuple[Positive, Positive]
    """Smallest and largest [m]."""
    speed_share: SpeedShare | None = None
    """If they are rough: of its largest speed that a vehicle keeps on one; by default 0.4."""
    clearance: NonNegative = 1.0
    """So far from the starts and goals of all UGVs they stay [m]."""

    @property
    def kept_share(self) -> float:
        """Of its largest speed that a vehicle keeps on one."""
        return kept_share(self.kind, self.speed_share)


class Ground(_Table, frozen=True, kw_only=True):
    """The tiles in which hazards are seen and told, and how well; without hazards nothing of it matters."""

    tile: Positive = 0.5
    """Side of a tile [m]."""
    rate: Positive = 4.0
    """Looks of each UAV at the ground per second [1/s]; a whole number of ticks must fit between two."""
    miss: Share = 0.0
    """Chance that a tile with a hazard is seen as clear."""
    false_alarm: Share = 0.0
    """Chance that a clear tile is seen as blocked."""
    sensing_range: NonNegative = 0.75
    """Range of a UGV's own sensor, which makes no errors [m]."""
    touch: Name = TOUCHES[0]
    """Effect of touching a blocking hazard on a UGV: it is `stuck`, or drives on with `damage`."""
    map_update_rate: NonNegative = 4.0
    """Blocks of 8 x 8 tiles that a UAV radios to its UGV per second [1/s]."""


class Uav(_Table, frozen=True, kw_only=True):
    """A UAV at the start."""

    name: Name = "uav_0"
    escorts: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.6
    max_acceleration: Bound = 0.3
    position_error: NonNegative = 0.0
    """Largest error of its own position [m]. The error drifts; the inner loop cannot tell it from one of its own."""
    position_error_time: Positive = 30.0
    """After this time a third of that error is left [s]."""
    tracking: InnerLoop = InnerLoop()
    """Its inner loop, which holds it to its commands' track, where wind or a wrong own position take it off."""


class Ugv(_Table, frozen=True, kw_only=True):
    """A UGV at the start, and its task."""

    name: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.2
    max_acceleration: Bound = 0.1
    driver: Name = DEFAULT_DRIVER
    """A row of `bus.registry.DRIVERS`; or a saved policy, as `fmu:FILE.fmu`, which stands for `policy` with it as
    `custom.policy`.
    """
    goals: tuple[Vector, ...] = ()
    goal_tolerance: Positive = 0.05
    script: tuple[ScriptStep, ...] = ()
    """For the driver `script`: its velocity from each time on, in the order of time."""
    trajectory: Text = ""
    """Instead of a script: the trajectory.csv of an earlier run, whose track of this UGV is driven again."""
    caution: Name = CAUTIONS[0]
    """Towards ground that nobody has seen: `cautious`, so slow that it can stop, or `bold`, as fast as on any."""


DEFAULT_AGE = 1.0
"""Largest age of the newest detection where none is given [s]."""


class Certificate(_Table, frozen=True, kw_only=True):
    """The bounds that are declared to the UAVs for the law `certified`.

    A network that is worse is told as uncertified, tick by tick.
    """

    max_measurement_error: NonNegative | None = None
    """Largest error of a detection [m]; by default the noise at its cut, and without a cut none."""
    max_measurement_age: Positive | None = None
    """Largest age of the newest detection that has arrived [s]; by default 1 s."""
    max_command_delay: NonNegative | None = None
    """From the tick that a command answers to the one in which it acts [s]; by default the longest of its link."""
    margin: NonNegative = 0.0
    """Taken off r_v [m], for what the theorem does not cover."""
    max_command_interval: NonNegative | None = None
    """Longest time from the start of a UAV's motion to the start of the next, B [s]: receivers fly a motion on while
    commands are lost. By default one tick: no command is lost.
    """
    max_tracking_error: NonNegative | None = None
    """Largest true distance of a UAV from where it is told that it is, w [m]; by default what wind, position_error and
    tracking can bring about: 0 without wind and position_error.
    """


class Custom(_Table, frozen=True, kw_only=True):
    """Functions of the user's own, as `module:function`.

    Each is loaded by its vehicle's process alone and never travels.
    """

    weighting: Text = ""
    """(distance, r_s) -> (alpha, beta), for the law `weighted`."""
    path: Text = ""
    """t -> ((x, y), (x'', y'')), relative to the UGV, for the law `path`."""
    policy: Text = ""
    """(observation, briefing) -> (acceleration x, y), for the driver `policy`."""
    uav_policy: Text = ""
    """Observations of a batch in, accelerations (worlds, 2) out; for the law `policy`, and inside `certified`."""


class _Links(_Table, frozen=True, kw_only=True):
    """A field for each `LinkKind`, under its name."""

    detections: LinkSettings = LinkSettings()
    """From a UAV's detector to its computer."""
    commands: LinkSettings = LinkSettings()
    """From a vehicle's computer to its actuators."""
    operator: LinkSettings = LinkSettings()
    """From an operator to a UGV."""
    radio: LinkSettings = LinkSettings()
    """From a UAV to its UGV."""


class VehicleLinks(_Links, frozen=True, kw_only=True):
    """The links of one vehicle, where they are not as everybody's."""

    vehicle: Name


class LinkTable(_Links, frozen=True, kw_only=True):
    """The settings of the radio links, kind by kind.

    In TOML each may name a `profile` that it starts from, and so may all.
    """

    only: tuple[VehicleLinks, ...] = ()
    """Vehicles whose links are other ones; what is not given is as everybody's."""
    traces: tuple[RecordedLink, ...] = ()
    """The files that any `trace` names, with their content: filled in where the scenario is read, and not to be
    written.
    """

    def of(self, vehicle: str, kind: LinkKind) -> LinkSettings:
        """The settings of this vehicle's link of this kind."""
        own = next((row for row in self.only if row.vehicle == vehicle), self)
        settings: LinkSettings = getattr(own, kind)
        return settings

    def path_of(self, vehicle: str, kind: LinkKind) -> str:
        """The field of the scenario that holds these settings, such as `links.commands` or `links.only.0.commands`."""
        own = next((f"only.{k}." for k, row in enumerate(self.only) if row.vehicle == vehicle), "")
        return f"links.{own}{kind}"

    def changed(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> "LinkTable":
        """The table with other settings for one vehicle's link of this kind, or for everybody's (None)."""
        if vehicle is None:
            rows = tuple(msgspec.structs.replace(row, **{kind: settings}) for row in self.only)
            return msgspec.structs.replace(self, only=rows, **{kind: settings})
        kinds = {other: self.of(vehicle, other) for other in LinkKind}
        new = VehicleLinks(vehicle=vehicle, **{**kinds, kind: settings})
        rows = tuple(new if row.vehicle == vehicle else row for row in self.only)
        return msgspec.structs.replace(self, only=rows if new in rows else (*rows, new))


class Run(_Table, frozen=True, kw_only=True):
    """Pace and patience of a run over processes; an environment and a run in one process have none."""

    realtime: Annotated[float, Meta(ge=0.0, le=1e4)] = 0.0
    """Simulated seconds per second of wall time; 0: lockstep, as fast as the vehicles answer."""
    deadline: Annotated[float, Meta(ge=0.01)] = 10.0
    """In lockstep, time to wait for the commands of one tick [s]."""
    join_timeout: NonNegative = 120.0
    """Time to wait for all vehicles at the start, for a vehicle that reconnects, and for the router [s]."""
    respawn: bool = False
    """True: a vehicle's process that exits is restarted, and in lockstep the simulation is paused meanwhile."""


DEFAULT_AREA = Area(width=40.0, height=40.0, cell=0.25)
NO_UAV = "no UAV"
"""Instead of a law, for a person, where there is nobody to fly one."""


class Scenario(_Table, frozen=True, kw_only=True):
    """One run. SI units; the area's lower left corner is the origin."""

    name: Text = ""
    """The file's name without its ending, where none is given."""
    title: Line = ""
    seed: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0
    duration: Positive = 160.0
    """[s], a whole number of ticks."""
    dt: Positive = 0.05
    """Length of a tick [s]."""
    command_timeout: NonNegative = 0.5
    """For so long the last command is held when none comes [s]; then the vehicle brakes."""
    area: Area = DEFAULT_AREA
    origin: Origin = Origin()
    """The place on Earth of the area's lower left corner; no vehicle's motion depends on it."""
    sensor: Sensor = Sensor()
    visibility: Visibility = Visibility()
    coverage: Coverage = Coverage()
    detections: Detections = Detections()
    wind: Wind = Wind()
    estimator: Estimator = Estimator()
    links: LinkTable = LinkTable()
    certificate: Certificate = Certificate()
    law: Law = Law()
    custom: Custom = Custom()
    run: Run = Run()
    ground: Ground = Ground()
    hazard: Annotated[tuple[Hazard, ...], Meta(max_length=MOST_HAZARDS)] = ()
    hazard_field: tuple[HazardField, ...] = ()
    uav: tuple[Uav, ...] = ()
    """None: the UGVs drive without an escort."""
    ugv: Annotated[tuple[Ugv, ...], Meta(min_length=1)]

    @property
    def ticks(self) -> int:
        """Number of ticks of the whole run."""
        return round(self.duration / self.dt)

    @property
    def vehicles(self) -> tuple[Uav | Ugv, ...]:
        """All vehicles in name order, which is the order of every array."""
        return tuple(sorted((*self.uav, *self.ugv), key=lambda vehicle: vehicle.name))

    @property
    def disturbed(self) -> bool:
        """True if wind or a wrong own position takes a UAV from where it is told that it is."""
        return any(self.wind.largest > 0.0 or uav.position_error > 0.0 for uav in self.uav)

    @property
    def detection_period(self) -> int:
        """Ticks between two looks of the detector."""
        return max(1, round(1.0 / (self.detections.rate * self.dt)))

    @property
    def rough_share(self) -> float:
        """Of its largest speed that a vehicle keeps at least on rough ground."""
        rough: tuple[Hazard | HazardField, ...] = (*self.hazard, *self.hazard_field)
        slow = (one.kept_share for one in rough if HAZARDS[one.kind].slows)
        return min(slow, default=DEFAULT_SHARE)

    @property
    def has_ground(self) -> bool:
        """True if there are hazards on the ground, or there may be."""
        return bool(self.hazard or self.hazard_field)

    @property
    def ground_period(self) -> int:
        """Ticks between two looks of a UAV at the ground."""
        return max(1, round(1.0 / (self.ground.rate * self.dt)))


def switching_radius(scenario: Scenario, uav: Uav, ugv: Ugv) -> float:
    """r_s of (18) [m], whatever its sign."""
    bounds = uav.max_speed, ugv.max_speed, uav.max_acceleration
    return float(raw_switching_radius(scenario.visibility.radius, *bounds))
