"""Context of a run for the conversion of its messages to ROS 2."""

import math
from dataclasses import dataclass, field

from bus.messages.base import Message
from bus.messages.ground import GroundMap, Hazard
from bus.messages.telemetry import Geometry, Truth
from outrider_ros2.headings import TurnRate
from outrider_ros2.interfaces import RosMessage
from outrider_ros2.places import Vector3, place_of
from sim.scene.model import Scene, observed_scene


@dataclass(slots=True)
class PathTrack:
    """Path of a vehicle so far, thinned out to a bounded number of points."""

    times: list[float] = field(default_factory=list)
    """Time of each point [s]."""
    positions: list[Vector3] = field(default_factory=list)
    """Position of each point [m]; on the ground for vehicles without an altitude."""
    headings: list[float | None] = field(default_factory=list)
    """Heading at each point [rad]; None: the vehicle has none."""
    step: float = 0.1
    """Minimum distance between two points [m]."""

    def add(
        self, time: float, position: Vector3, heading: float | None = None, most: int = 500
    ) -> None:
        """Add a position if it is far enough from the last point.

        Args:
            time: Simulated time [s].
            position: Position [m].
            heading: Heading [rad]; None: the vehicle has none.
            most: Number of points beyond which every second one is dropped.
        """
        if self.times and time < self.times[-1]:
            self.times, self.positions, self.headings = [], [], []  # another run
            self.step = PathTrack().step
        if self.positions and math.dist(self.positions[-1], position) < self.step:
            return
        self.times.append(time)
        self.positions.append(position)
        self.headings.append(heading)
        if len(self.times) > most:
            self.times = self.times[::2]
            self.positions = self.positions[::2]
            self.headings = self.headings[::2]
            self.step = 2.0 * self.step


@dataclass(slots=True, kw_only=True)
class RunView:
    """Context of a run for the conversion of its messages."""

    scene: Scene
    dt: float
    """Time between two ticks [s]."""
    tracks: dict[str, PathTrack] = field(default_factory=dict)
    turn_rates: dict[str, TurnRate] = field(default_factory=dict)
    """Turn rate of each vehicle."""
    hazards: tuple[Hazard, ...] = ()
    """Hazards of the run; only the first map of a recording contains them."""
    own: tuple[RosMessage, ...] = ()
    """Diagnostic statuses of the bridge itself."""

    def follow(self, message: Message | None) -> None:
        """Store the vehicles' motion and the hazards for the conversion of this message and later ones."""
        match message:
            case Truth():
                for name, vehicle in message.vehicles.items():
                    time, heading = message.time, vehicle.heading
                    self.tracks.setdefault(name, PathTrack()).add(time, place_of(vehicle), heading)
                    self.turn_rates.setdefault(name, TurnRate()).update(time, heading)
            case GroundMap() if message.hazards:
                self.hazards = message.hazards


def view_of(name: str, geometry: Geometry) -> RunView:
    """Return the context of a run for observers.

    Args:
        name: Name of the scenario.
        geometry: Geometry sent to observers.
    """
    scene = observed_scene(name, geometry, escorts=geometry.uavs, vehicles=geometry.limits)
    return RunView(scene=scene, dt=geometry.dt)
