"""Typed tables and fields of a scenario.

They are in `sim` because world, engine, environment and server use them; `loading` reads them from TOML, and `checks`
rejects invalid ones. `bus.registry` describes laws, drivers and sensors.
"""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import (
    Line,
    Name,
    NonNegative,
    Positive,
    Seed,
    Share,
    Text,
    Vector,
)
from bus.messages.buildings import MOST_BUILDINGS, AltitudeLimits, Building, Camera
from bus.messages.ground import DEFAULT_SHARE, Hazard
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import (
    Area,
    Estimator,
    Law,
    Origin,
    Region,
    Sensor,
)
from bus.messages.team import Team
from bus.registry import (
    BODIES,
    HAZARDS,
    LAWS,
)
from sim.channel.recorded import RecordedLink
from sim.models.vehicles import raw_switching_radius
from sim.scenario.base import Table
from sim.scenario.ground_types import (
    MOST_HAZARDS,
    AltitudeLaw,
    BuildingField,
    Buildings,
    Ground,
    HazardField,
)
from sim.scenario.vehicle_types import Bound, Uav, Ugv


class Visibility(Table, frozen=True, kw_only=True):
    """Visibility constraint, eq. (5)."""

    radius: Positive = 4.75
    """Visibility radius r_v [m]."""


class Coverage(Table, frozen=True, kw_only=True):
    """Desired coverage and initially covered ground."""

    desired: Positive = 2.0
    """Desired coverage C* of eq. (4) [1]."""
    covered: tuple[Region, ...] = ()
    """Rectangles that are covered from the start."""


class Detections(Table, frozen=True, kw_only=True):
    """Detector of the UGV: always succeeds within r_v, less often beyond, never beyond the sensor's range."""

    noise: NonNegative = 0.0
    """Standard deviation of the noise per axis [m]; with an altitude, it grows with the slant range, and this is the
    value directly below the UAV at `camera.reference_altitude`.
    """
    truncation: Bound = 3.0
    """Truncation of the noise vector's norm, in standard deviations [1]; inf: not truncated."""
    rate: Positive = 20.0
    """Detection attempts per second [1/s]; the period must be a whole number of ticks."""
    dropout: Share = 0.0
    """Share of attempts that fail at random."""


class Wind(Table, frozen=True, kw_only=True):
    """Wind, as an acceleration of each UAV; no vehicle measures it."""

    mean: Vector = (0.0, 0.0)
    """Mean acceleration [m/s²]."""
    gust: NonNegative = 0.0
    """Standard deviation of gusts per axis [m/s²]; each UAV has its own gusts."""
    gust_time: Positive = 2.0
    """Time constant of gusts [s]."""
    limit: NonNegative | None = None
    """Bound of mean and gust together [m/s²]; default: the norm of the mean plus 3 gusts."""

    @property
    def largest(self) -> float:
        """Return the largest acceleration [m/s²]."""
        most = math.hypot(*self.mean) + 3.0 * self.gust
        return most if self.limit is None or most == 0.0 else self.limit


DEFAULT_AGE = 1.0
"""Default of `max_measurement_age` [s]."""


class Certificate(Table, frozen=True, kw_only=True):
    """Bounds declared to the UAVs' safety filters. Ticks at which the network exceeds them are not certified."""

    max_measurement_error: NonNegative | None = None
    """Largest measurement error [m]; default: the largest noise at its truncation, unbounded without one."""
    max_measurement_age: Positive | None = None
    """Largest age of the newest measurement [s]; default: 1 s."""
    max_command_delay: NonNegative | None = None
    """Time from the tick that a command answers to its effect [s]; default: the longest of its link."""
    margin: NonNegative = 0.0
    """Margin subtracted from r_v [m], for effects that the theorem does not cover."""
    max_command_interval: NonNegative | None = None
    """Longest time from the start of one plan to the start of the next [s]. Receivers execute backup trajectories while
    commands are lost. Default: one tick, no command is lost.
    """
    max_tracking_error: NonNegative | None = None
    """Largest tracking error [m]; default: the bound that follows from wind, position_error and tracking, 0 without a
    disturbance. No bound follows for a body other than `point`; measure it and declare it.
    """
    max_building_height: Positive | None = None
    """Largest height of a building [m]; default: the highest possible one of the scenario."""


class Custom(Table, frozen=True, kw_only=True):
    """Functions of the user, as `module:function`. Each is loaded by its vehicle's process only and is never sent."""

    weighting: Text = ""
    """Function (distance, r_s) -> (alpha, beta) of the law `weighted`."""
    path: Text = ""
    """Function t -> ((x, y), (x'', y'')) relative to the UGV, of the law `path`."""
    policy: Text = ""
    """Function (observation, briefing) -> (acceleration x, y) of the driver `policy`."""
    uav_policy: Text = ""
    """Function from observations of a batch to accelerations (worlds, 2), of the law `policy` and inside `certified`.
    """


class _Links(Table, frozen=True, kw_only=True):
    """Settings of each kind of link."""

    detections: LinkSettings = LinkSettings()
    """From a UAV's detector to its computer."""
    commands: LinkSettings = LinkSettings()
    """From a vehicle's computer to its actuators."""
    operator: LinkSettings = LinkSettings()
    """From the operator to a UGV."""
    radio: LinkSettings = LinkSettings()
    """From a UAV to its UGV."""
    team: LinkSettings = LinkSettings()
    """From a UAV to the other UAVs of its team."""


class VehicleLinks(_Links, frozen=True, kw_only=True):
    """Links of one vehicle that differ from the common ones."""

    vehicle: Name
    """Name of the vehicle."""


class LinkTable(_Links, frozen=True, kw_only=True):
    """Settings of the links, by kind. In TOML each kind, and the table itself, may start from a `profile`."""

    only: tuple[VehicleLinks, ...] = ()
    """Vehicles with links of their own; omitted settings are the common ones."""
    traces: tuple[RecordedLink, ...] = ()
    """Files named by any `trace`, with their content; filled in by the loader, not by the user."""

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


class Run(Table, frozen=True, kw_only=True):
    """Pace and timeouts of a run over processes; environments and runs in one process do not use them."""

    realtime: Annotated[float, Meta(ge=0.0, le=1e4)] = 0.0
    """Simulated seconds per second of wall time [1]; 0: lockstep, as fast as possible."""
    deadline: Annotated[float, Meta(ge=0.01)] = 10.0
    """Lockstep: time to wait for the commands of one tick [s]."""
    join_timeout: NonNegative = 120.0
    """Time to wait for all vehicles at the start, for a vehicle that reconnects, and for the router [s]."""
    respawn: bool = False
    """Restart a vehicle's process if it exits; lockstep pauses meanwhile."""


DEFAULT_AREA = Area(width=40.0, height=40.0, cell=0.25)
NO_UAV = "no UAV"
"""Title of a scenario without UAVs, in place of a law."""


class Scenario(Table, frozen=True, kw_only=True):
    """One run. SI units; the origin is the lower left corner of the area."""

    name: Text = ""
    """Name; default: the file's name without its suffix."""
    title: Line = ""
    """Title in one line."""
    seed: Seed = 0
    """Seed of all random numbers."""
    duration: Positive = 160.0
    """Duration [s], a whole number of ticks."""
    dt: Positive = 0.05
    """Duration of a tick [s]."""
    command_timeout: NonNegative = 0.5
    """Time for which the last command stays in effect when no new one arrives [s]; then the vehicle brakes."""
    area: Area = DEFAULT_AREA
    """Area and coverage grid."""
    origin: Origin = Origin()
    """Geographic position of the area's lower left corner; no vehicle's motion depends on it."""
    sensor: Sensor = Sensor()
    """Downward sensor of the UAVs."""
    visibility: Visibility = Visibility()
    """Visibility constraint."""
    coverage: Coverage = Coverage()
    """Desired coverage."""
    detections: Detections = Detections()
    """Detector of the UGV."""
    wind: Wind = Wind()
    """Wind."""
    estimator: Estimator = Estimator()
    """Estimator of the relative position."""
    links: LinkTable = LinkTable()
    """Links between the processes."""
    certificate: Certificate = Certificate()
    """Declared bounds of the visibility certificate."""
    law: Law = Law()
    """Control law of the UAVs without a law of their own."""
    custom: Custom = Custom()
    """Functions of the user."""
    run: Run = Run()
    """Pace and timeouts."""
    ground: Ground = Ground()
    """Tiles and sensors of the ground."""
    hazard: Annotated[tuple[Hazard, ...], Meta(max_length=MOST_HAZARDS)] = ()
    """Hazards at given positions."""
    hazard_field: tuple[HazardField, ...] = ()
    """Hazards at random positions."""
    buildings: Buildings = Buildings()
    """Map of the buildings."""
    building: Annotated[tuple[Building, ...], Meta(max_length=MOST_BUILDINGS)] = ()
    """Buildings at given positions."""
    building_field: tuple[BuildingField, ...] = ()
    """Buildings at random positions."""
    camera: Camera = Camera()
    """Camera of the UAVs that have an altitude."""
    altitude: AltitudeLaw = AltitudeLaw()
    """Altitude of the UAVs that have one."""
    team: Team | None = None
    """Cooperation of the UAVs that escort the same UGV; default: none, each escorts it for itself."""
    uav: tuple[Uav, ...] = ()
    """UAVs; none: the UGVs drive without an escort."""
    ugv: Annotated[tuple[Ugv, ...], Meta(min_length=1)]
    """UGVs."""

    @property
    def ticks(self) -> int:
        """Return the number of ticks of the whole run."""
        return round(self.duration / self.dt)

    @property
    def vehicles(self) -> tuple[Uav | Ugv, ...]:
        """Return all vehicles in name order, the order of every array."""
        return tuple(sorted((*self.uav, *self.ugv), key=lambda vehicle: vehicle.name))

    def law_of(self, uav: Uav) -> Law:
        """Return the control law of a UAV: its own, with the scenario's for all that it leaves out."""
        own, common = uav.law, self.law
        if own is None:
            return common
        return Law(name=own.name or common.name, parameters=common.parameters | own.parameters)

    def filters(self, uav: Uav) -> bool:
        """Return whether a UAV has a safety filter: its law has one, or it forms a team, whose guards have one."""
        return self.team is not None or LAWS[self.law_of(uav).name].watched

    @property
    def filtered(self) -> bool:
        """True if a safety filter acts; without a UAV, if the law has one."""
        return any(map(self.filters, self.uav)) if self.uav else LAWS[self.law.name].watched

    @property
    def disturbed(self) -> bool:
        """True if wind, a position error or its body displaces a UAV from its reference."""
        return any(
            self.wind.largest > 0.0 or uav.position_error > 0.0 or BODIES[uav.body].make
            for uav in self.uav
        )

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
        """True if the scenario has hazards or buildings, at given or at random positions."""
        return bool(self.hazard or self.hazard_field or self.has_buildings)

    @property
    def has_altitude(self) -> bool:
        """True if the UAVs have an altitude."""
        return any(uav.initial_altitude is not None for uav in self.uav)

    @property
    def has_buildings(self) -> bool:
        """True if the scenario has buildings, or fields of buildings."""
        return bool(self.building or self.building_field)

    @property
    def only_known_buildings(self) -> bool:
        """True if the only hazards are buildings, and the vehicles have the map."""
        hazards = self.hazard or self.hazard_field
        return self.has_buildings and self.buildings.known and not hazards

    @property
    def max_building_clearance(self) -> float:
        """Return the largest `building_clearance` of all UGVs [m]."""
        return max(ugv.building_clearance for ugv in self.ugv)

    @property
    def ground_period(self) -> int:
        """Return the number of ticks between two updates of a UAV's ground sensor."""
        return max(1, round(1.0 / (self.ground.rate * self.dt)))


def switching_radius(scenario: Scenario, uav: Uav, ugv: Ugv) -> float:
    """Return the switching radius r_s of (18) [m], of either sign."""
    bounds = uav.max_speed, ugv.max_speed, uav.max_acceleration
    return float(raw_switching_radius(scenario.visibility.radius, *bounds))


def altitude_limits(scenario: Scenario, uav: Uav) -> AltitudeLimits | None:
    """Return a UAV's vertical bounds in the form of a message; None: it flies in the plane."""
    if uav.initial_altitude is None:
        return None
    given = ((name, getattr(uav, name, None)) for name in AltitudeLimits.__struct_fields__)
    known = {name: value for name, value in given if value is not None}
    return AltitudeLimits(**known | {"law": scenario.altitude.law})
