"""A run described: typed, read from TOML, refused where it is impossible."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages import Area, Coordinate, Estimator, Law, Name, NonNegative, Positive, Region, Sensor, Text, Vector

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
    """What is to be seen, and what has been already."""

    desired: Positive = 2.0
    """C* of (4)."""
    covered: tuple[Region, ...] = ()
    """Rectangles that are covered from the start."""


class Detections(_Table, frozen=True, kw_only=True):
    """The UAV's detector of the UGV: certain inside r_v, falling to nothing at the sensor's range."""

    noise: NonNegative = 0.0
    """Standard deviation per axis [m]."""
    cut: Annotated[float, Meta(ge=0.0)] = 3.0
    """The noise vector's norm is cut at this many standard deviations; 0 switches the cut off."""
    rate: Positive = 20.0
    """Looks per second [1/s]; a whole number of ticks must fit between two."""
    dropout: Share = 0.0
    """Share of looks that fail for no reason."""


class Uav(_Table, frozen=True, kw_only=True):
    """A UAV at the start."""

    name: Name = "uav_0"
    escorts: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.6
    max_acceleration: Bound = 0.3


class Ugv(_Table, frozen=True, kw_only=True):
    """A UGV at the start, and its task."""

    name: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.2
    max_acceleration: Bound = 0.1
    driver: Name = "waypoints"
    goals: tuple[Vector, ...] = ()
    goal_tolerance: Positive = 0.05


class Custom(_Table, frozen=True, kw_only=True):
    """Functions of the user's own, as `module:function`; they are loaded by the UAV's process alone and never travel."""

    weighting: Text = ""
    """(distance, r_s) -> (alpha, beta), for the law `weighted`."""
    path: Text = ""
    """t -> ((x, y), (x'', y'')), relative to the UGV, for the law `path`."""


class Scenario(_Table, frozen=True, kw_only=True):
    """One run. SI units; the area's lower left corner is the origin."""

    name: Text = ""
    """The file's name without its ending, where none is given."""
    title: Text = ""
    seed: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0
    duration: Positive = 160.0
    """[s], a whole number of ticks."""
    dt: Positive = 0.05
    """Length of a tick [s]."""
    hold: NonNegative = 0.5
    """How long the last command is held when none comes [s]; then the vehicle brakes."""
    area: Area = Area(width=40.0, height=40.0, cell=0.25)
    sensor: Sensor = Sensor()
    visibility: Visibility = Visibility()
    coverage: Coverage = Coverage()
    detections: Detections = Detections()
    estimator: Estimator = Estimator()
    law: Law = Law()
    custom: Custom = Custom()
    uav: Annotated[tuple[Uav, ...], Meta(min_length=1)]
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
    def detection_period(self) -> int:
        """Ticks between two looks of the detector."""
        return max(1, round(1.0 / (self.detections.rate * self.dt)))

    @property
    def noise_cut(self) -> float:
        """The cut of the detection noise in standard deviations; infinite where it is switched off."""
        return self.detections.cut or math.inf
