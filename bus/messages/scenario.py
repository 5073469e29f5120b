"""Structs shared by scenarios and briefings: limits, area, sensor, law, detector, safety parameters."""

from typing import Annotated

from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Positive, Text, Vector, or_infinite
from bus.registry import DEFAULT_LAW, DEFAULT_SENSOR


class Limits(Message, frozen=True, kw_only=True):
    """Bounds of a vehicle's double integrator, eq. (1); None: unbounded."""

    max_speed: Positive | None
    """Maximum speed v_max [m/s]."""
    max_acceleration: Positive | None
    """Maximum acceleration u_max [m/s²]."""

    @property
    def numbers(self) -> tuple[float, float]:
        """Return v_max [m/s] and u_max [m/s²]; infinite if unbounded."""
        return or_infinite(self.max_speed), or_infinite(self.max_acceleration)


class Area(Message, frozen=True, kw_only=True):
    """Area Q = [0, width] x [0, height] with its coverage grid."""

    width: Positive
    """Width, along x [m]."""
    height: Positive
    """Height, along y [m]."""
    cell: Positive
    """Side of a cell of the coverage grid [m]."""


class Origin(Message, frozen=True, kw_only=True):
    """Geographic position of the area's lower left corner (WGS 84); x points east, y north."""

    latitude: Annotated[float, Meta(ge=-80.0, le=80.0)] = 49.875
    """Latitude [deg]; default: Darmstadt, where the paper was written."""
    longitude: Annotated[float, Meta(ge=-180.0, le=180.0)] = 8.66
    """Longitude [deg]."""
    altitude: Annotated[float, Meta(ge=-500.0, le=9000.0)] = 150.0
    """Altitude of the ground, which is flat [m]."""


class Region(Message, frozen=True, kw_only=True):
    """Rectangle that is covered from the start."""

    lower: Vector
    """Lower left corner [m]."""
    upper: Vector
    """Upper right corner [m]."""


class Sensor(Message, frozen=True, kw_only=True):
    """Downward sensor of a UAV, eq. (2)."""

    model: Name = DEFAULT_SENSOR
    """Sensor model, a row of `bus.registry.SENSORS`."""
    peak: Positive = 1.0
    """Peak coverage rate M_a [1/s]."""
    range: Positive = 5.0
    """Range r [m]."""


LawNumber = (
    bool | Annotated[int, Meta(ge=-(2**53), le=2**53)] | Annotated[float, Meta(ge=-1e12, le=1e12)]
)
"""Value of a law's parameter."""


class Law(Message, frozen=True, kw_only=True):
    """Control law of the UAVs and its parameters."""

    name: Name = DEFAULT_LAW
    """Name, a row of `bus.registry.LAWS`."""
    parameters: Annotated[dict[Text, LawNumber], Meta(max_length=64)] = {}
    """Parameters by name, fields of the class in the law's row; parameters of other laws have no effect."""

    def __hash__(self) -> int:
        return hash((self.name, tuple(sorted(self.parameters.items()))))


class Detector(Message, frozen=True, kw_only=True):
    """Properties of the UAV's detector, as the UAV knows them."""

    noise: NonNegative = 0.0
    """Standard deviation of the noise per axis [m]; with an altitude, directly below at the initial altitude."""
    truncation: Positive | None = 3.0
    """Noise vectors are truncated at this many standard deviations [1]; None: not truncated."""
    period: Positive
    """Time between two detection attempts [s]."""


class SafetyParameters(Message, frozen=True, kw_only=True):
    """Parameters of a UAV's safety filter and of its certificate (docs/explanation/guarantee.md)."""

    max_measurement_error: NonNegative | None
    """Largest norm of a measurement error [m]; None: unbounded, and nothing can be certified."""
    max_measurement_age: Positive
    """Largest age of the newest measurement [s]."""
    max_command_delay: NonNegative = 0.0
    """Longest time from the tick that a command answers to the start of its plan [s]."""
    max_command_interval: NonNegative = 0.0
    """Longest time from the start of one plan to the start of the next [s]; at least one tick."""
    max_tracking_error: NonNegative | None = 0.0
    """Largest distance between reference and true position [m]; None: unbounded."""
    margin: NonNegative = 0.0
    """Margin subtracted from r_v [m], for effects that the theorem does not cover."""
    search: bool = False
    """True: if the UGV may be out of sight, the UAV searches for it; False: it waits at the newest measurement."""


class Estimator(Message, frozen=True, kw_only=True):
    """Kalman filter of the relative position."""

    enabled: bool = True
    """False: use the newest detection unfiltered."""
    gate: Positive = 18.4
    """Largest accepted normalized innovation squared [1] (chi-square, 2 degrees of freedom: 1 in 10,000 exceeds 18.4).
    """
    max_rejections: Annotated[int, Meta(ge=1, le=1_000_000)] = 5
    """Reinitialize the estimate after this many consecutive rejected measurements."""
    acceleration_share: Positive = 0.7
    """Standard deviation of the UGV's acceleration per axis, as a share of its bound [1]."""


class ScriptStep(Message, frozen=True, kw_only=True):
    """Velocity of a scripted UGV from a time on."""

    time: NonNegative
    """Start [s]."""
    velocity: Vector
    """Desired velocity [m/s]."""
