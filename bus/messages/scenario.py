"""What a scenario and a briefing describe in the same words: limits, area, sensor, law, detector, safety."""

from typing import Annotated

from msgspec import Meta

from bus.messages.base import Message, Name, NonNegative, Positive, Text, Vector, or_infinite
from bus.registry import DEFAULT_LAW, DEFAULT_SENSOR


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


class Detector(Message, frozen=True, kw_only=True):
    """The UAV's knowledge of its own detector of the UGV."""

    noise: NonNegative = 0.0
    """Standard deviation per axis [m]."""
    truncation: Positive | None = 3.0
    """Noise vectors are cut at this many standard deviations; None: not cut."""
    period: Positive
    """Time between two looks [s]."""


class SafetyParameters(Message, frozen=True, kw_only=True):
    """Parameters of a UAV's safety filter and of its certificate (docs/explanation/guarantee.md)."""

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
    max_rejections: Annotated[int, Meta(ge=1, le=1_000_000)] = 5
    """Detections refused in a row after which the filter starts anew from the newest."""
    acceleration_share: Positive = 0.7
    """Standard deviation of the UGV's acceleration per axis, as a share of its bound."""


class ScriptStep(Message, frozen=True, kw_only=True):
    """The velocity that a scripted UGV wants from a time on."""

    time: NonNegative
    """[s]"""
    velocity: Vector
    """[m/s]"""
