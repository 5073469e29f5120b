"""Typed tables and fields of a scenario.

They are in `sim` because world, engine, environment and server use them; `loading` reads them from TOML, and `checks`
rejects invalid ones. `bus.registry` describes laws, drivers and sensors.
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
"""Bound that may be infinite (TOML: inf)."""


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of the scenario's tables."""


class Visibility(_Table, frozen=True, kw_only=True):
    """Visibility constraint (5)."""

    radius: Positive = 4.75
    """Visibility radius r_v [m]."""


class Coverage(_Table, frozen=True, kw_only=True):
    """Desired coverage, and initially covered ground."""

    desired: Positive = 2.0
    """Desired coverage C* of (4)."""
    covered: tuple[Region, ...] = ()
    """Rectangles that are covered from the start."""


class Detections(_Table, frozen=True, kw_only=True):
    """The UAV's detector of the UGV: certain inside r_v, with a probability that falls to 0 at the sensor's range."""

    noise: NonNegative = 0.0
    """Standard deviation of the noise per axis [m]."""
    truncation: Bound = 3.0
    """The noise vector's norm is truncated at this many standard deviations; inf: not truncated."""
    rate: Positive = 20.0
    """Detections per second [1/s]; their period must be a whole number of ticks."""
    dropout: Share = 0.0
    """Share of detections that fail at random."""


class Wind(_Table, frozen=True, kw_only=True):
    """Wind, as an acceleration of each UAV; the default is no wind. No vehicle can observe it."""

    mean: Vector = (0.0, 0.0)
    """Mean acceleration [m/s²]."""
    gust: NonNegative = 0.0
    """Standard deviation per axis around the mean [m/s²]; gusts are independent for each UAV."""
    gust_time: Positive = 2.0
    """Time constant of the gusts, after which their correlation is 1/e [s]."""
    limit: NonNegative | None = None
    """Largest acceleration of mean and gust together [m/s²]; by default the norm of the mean plus 3 gusts."""

    @property
    def largest(self) -> float:
        """Return the largest acceleration [m/s²]."""
        most = math.hypot(*self.mean) + 3.0 * self.gust
        return most if self.limit is None or most == 0.0 else self.limit


MOST_HAZARDS = 10_000


class HazardField(_Table, frozen=True, kw_only=True):
    """Discs at random positions, different for each seed. A route from each UGV's start to its goals stays open."""

    kind: Name
    """Kind of hazard, a row of `bus.registry.HAZARDS`."""
    count: Annotated[int, Meta(ge=1, le=MOST_HAZARDS)]
    """Number of hazards."""
    radius: tuple[Positive, Positive]
    """Smallest and largest radius [m]."""
    speed_share: SpeedShare | None = None
    """Share of its maximum speed that a vehicle keeps on rough ground; 0.4 by default."""
    clearance: NonNegative = 1.0
    """Smallest distance of a hazard from the starts and goals of all UGVs [m]."""

    @property
    def kept_share(self) -> float:
        """Return the share of its maximum speed that a vehicle keeps on these hazards."""
        return kept_share(self.kind, self.speed_share)


class Ground(_Table, frozen=True, kw_only=True):
    """Ground tiles for reports of hazards, and quality of the sensors; no effect without hazards."""

    tile: Positive = 0.5
    """Side of a tile [m]."""
    rate: Positive = 4.0
    """Updates of each UAV's ground sensor per second [1/s]; their period must be a whole number of ticks."""
    miss: Share = 0.0
    """Probability that a tile with a hazard is reported as clear."""
    false_alarm: Share = 0.0
    """Probability that a clear tile is reported as blocked."""
    sensing_range: NonNegative = 0.75
    """Range of a UGV's own sensor, which makes no errors [m]."""
    touch: Name = TOUCHES[0]
    """Effect on a UGV of touching a blocking hazard: `stuck` (it stops there) or `damage` (it drives on)."""
    map_update_rate: NonNegative = 4.0
    """Map updates of 8 x 8 tiles that a UAV radios to its UGV per second [1/s]."""


class Uav(_Table, frozen=True, kw_only=True):
    """A UAV: initial state, bounds and disturbances."""

    name: Name = "uav_0"
    escorts: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.6
    max_acceleration: Bound = 0.3
    position_error: NonNegative = 0.0
    """Largest error of its own position [m]. The error drifts; the inner loop cannot distinguish it from a tracking
    error.
    """
    position_error_time: Positive = 30.0
    """Time constant of this error, after which its correlation is 1/e [s]."""
    tracking: InnerLoop = InnerLoop()
    """Inner loop, which tracks the reference state against wind and position errors."""


class Ugv(_Table, frozen=True, kw_only=True):
    """A UGV: initial state, bounds and task."""

    name: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.2
    max_acceleration: Bound = 0.1
    driver: Name = DEFAULT_DRIVER
    """Driver, a row of `bus.registry.DRIVERS`; or a saved policy such as `fmu:FILE.fmu`, short for the driver `policy`
    with `custom.policy`.
    """
    goals: tuple[Vector, ...] = ()
    goal_tolerance: Positive = 0.05
    script: tuple[ScriptStep, ...] = ()
    """Steps for the driver `script`: the desired velocity from each time on, ordered by time."""
    trajectory: Text = ""
    """File trajectory.csv of an earlier run, whose trajectory of this UGV is repeated; an alternative to a script."""
    caution: Name = CAUTIONS[0]
    """Behavior on unknown ground: `cautious` (slow enough to stop before it) or `bold` (at normal speed)."""


DEFAULT_AGE = 1.0
"""Default of `max_measurement_age` [s]."""


class Certificate(_Table, frozen=True, kw_only=True):
    """Declared bounds for the safety filter of the UAVs.

    If the network is worse, ticks are reported as not certified.
    """

    max_measurement_error: NonNegative | None = None
    """Largest error of a detection [m]; by default the truncated noise, and no bound without truncation."""
    max_measurement_age: Positive | None = None
    """Largest age of the newest received detection [s]; 1 s by default."""
    max_command_delay: NonNegative | None = None
    """Longest time from the tick that a command answers to the tick in which it takes effect [s]; by default the
    longest of its link.
    """
    margin: NonNegative = 0.0
    """Distance subtracted from r_v [m], to cover effects outside the assumptions of the guarantee."""
    max_command_interval: NonNegative | None = None
    """Longest time from the start of one plan to the start of the next [s]; receivers continue a plan while commands
    are lost. The default is one tick: no command is lost.
    """
    max_tracking_error: NonNegative | None = None
    """Largest distance between a UAV's true and reference positions [m]; by default the largest that wind,
    position_error and tracking allow: 0 without wind and position_error.
    """


class Custom(_Table, frozen=True, kw_only=True):
    """User functions, as `module:function`.

    Each is loaded only by its vehicle's process and never sent.
    """

    weighting: Text = ""
    """Weighting function for the law `weighted`: (distance, r_s) -> (alpha, beta)."""
    path: Text = ""
    """Path for the law `path`, relative to the UGV: t -> ((x, y), (x'', y''))."""
    policy: Text = ""
    """Policy for the driver `policy`: (observation, briefing) -> (acceleration x, y) [m/s²]."""
    uav_policy: Text = ""
    """Policy for the law `policy`, and for `certified`: observations of a batch -> accelerations (worlds, 2) [m/s²]."""


class _Links(_Table, frozen=True, kw_only=True):
    """Settings of each kind of link."""

    detections: LinkSettings = LinkSettings()
    """From a UAV's detector to its computer."""
    commands: LinkSettings = LinkSettings()
    """From a vehicle's computer to its actuators."""
    operator: LinkSettings = LinkSettings()
    """From the operator to a UGV."""
    radio: LinkSettings = LinkSettings()
    """From a UAV to its UGV."""


class VehicleLinks(_Links, frozen=True, kw_only=True):
    """Links of one vehicle that differ from the common ones."""

    vehicle: Name


class LinkTable(_Links, frozen=True, kw_only=True):
    """Settings of the radio links, by kind.

    In TOML, `profile` names a preset, for one kind or for all.
    """

    only: tuple[VehicleLinks, ...] = ()
    """Vehicles with different links; settings that are not given are the common ones."""
    traces: tuple[RecordedLink, ...] = ()
    """Files of all traces with their content: added when the scenario is read, not to be written by the user."""

    def of(self, vehicle: str, kind: LinkKind) -> LinkSettings:
        """Return the settings of this vehicle's link of this kind."""
        own = next((row for row in self.only if row.vehicle == vehicle), self)
        settings: LinkSettings = getattr(own, kind)
        return settings

    def path_of(self, vehicle: str, kind: LinkKind) -> str:
        """Return the field with these settings, such as `links.commands` or `links.only.0.commands`."""
        own = next((f"only.{k}." for k, row in enumerate(self.only) if row.vehicle == vehicle), "")
        return f"links.{own}{kind}"

    def changed(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> "LinkTable":
        """Return the table with new settings for the link of one vehicle, or of all vehicles (None)."""
        if vehicle is None:
            rows = tuple(msgspec.structs.replace(row, **{kind: settings}) for row in self.only)
            return msgspec.structs.replace(self, only=rows, **{kind: settings})
        kinds = {other: self.of(vehicle, other) for other in LinkKind}
        new = VehicleLinks(vehicle=vehicle, **{**kinds, kind: settings})
        rows = tuple(new if row.vehicle == vehicle else row for row in self.only)
        return msgspec.structs.replace(self, only=rows if new in rows else (*rows, new))


class Run(_Table, frozen=True, kw_only=True):
    """Pace and deadlines of a run with processes; an environment, or a run in one process, has none."""

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
"""Title of a scenario without UAVs, in place of a law."""


class Scenario(_Table, frozen=True, kw_only=True):
    """One scenario, in SI units; the area's lower left corner is the origin."""

    name: Text = ""
    """Name of the scenario; by default the file's name without suffix."""
    title: Line = ""
    seed: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0
    duration: Positive = 160.0
    """Duration of the run [s], a whole number of ticks."""
    dt: Positive = 0.05
    """Duration of a tick [s]."""
    command_timeout: NonNegative = 0.5
    """Time for which the last command stays in effect when no new one arrives [s]; then the vehicle brakes."""
    area: Area = DEFAULT_AREA
    origin: Origin = Origin()
    """Geographic position of the area's lower left corner; it does not affect the motion."""
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
    """The UAVs; without any, the UGVs drive without an escort."""
    ugv: Annotated[tuple[Ugv, ...], Meta(min_length=1)]

    @property
    def ticks(self) -> int:
        """Return the number of ticks of the whole run."""
        return round(self.duration / self.dt)

    @property
    def vehicles(self) -> tuple[Uav | Ugv, ...]:
        """Return all vehicles in name order, the order of every array."""
        return tuple(sorted((*self.uav, *self.ugv), key=lambda vehicle: vehicle.name))

    @property
    def disturbed(self) -> bool:
        """True if wind or a position error disturbs a UAV."""
        return any(self.wind.largest > 0.0 or uav.position_error > 0.0 for uav in self.uav)

    @property
    def detection_period(self) -> int:
        """Return the number of ticks between two detections."""
        return max(1, round(1.0 / (self.detections.rate * self.dt)))

    @property
    def rough_share(self) -> float:
        """Return the smallest share of its maximum speed that a vehicle keeps on rough ground."""
        rough: tuple[Hazard | HazardField, ...] = (*self.hazard, *self.hazard_field)
        slow = (one.kept_share for one in rough if HAZARDS[one.kind].slows)
        return min(slow, default=DEFAULT_SHARE)

    @property
    def has_ground(self) -> bool:
        """True if the scenario has hazards, or fields of hazards."""
        return bool(self.hazard or self.hazard_field)

    @property
    def ground_period(self) -> int:
        """Return the number of ticks between two updates of a UAV's ground sensor."""
        return max(1, round(1.0 / (self.ground.rate * self.dt)))


def switching_radius(scenario: Scenario, uav: Uav, ugv: Ugv) -> float:
    """Return the switching radius r_s of (18) [m], of either sign."""
    bounds = uav.max_speed, ugv.max_speed, uav.max_acceleration
    return float(raw_switching_radius(scenario.visibility.radius, *bounds))
