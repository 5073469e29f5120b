"""Facts about a run that conversion to ROS 2 needs beside the message itself."""

import math
from dataclasses import dataclass, field

from bus.messages.base import Message, Vector
from bus.messages.ground import GroundMap, Hazard
from bus.messages.telemetry import Geometry, Truth
from outrider_ros2.interfaces import RosMessage
from sim.scene.model import Scene, observed_scene


@dataclass(slots=True)
class PathTrack:
    """The way that a vehicle has come, thinned out: as many points however long it is."""

    times: list[float] = field(default_factory=list)
    """[s]"""
    positions: list[Vector] = field(default_factory=list)
    """[m]"""
    step: float = 0.1
    """Least distance between two points [m]."""

    def add(self, time: float, position: Vector, most: int = 500) -> None:
        """Take a position down if it is far enough from the last.

        Args:
            time: When [s].
            position: Where [m].
            most: Points from which on every second one is forgotten.
        """
        if self.times and time < self.times[-1]:
            self.times, self.positions, self.step = [], [], PathTrack().step  # another flight
        if self.positions and math.dist(self.positions[-1], position) < self.step:
            return
        self.times.append(time)
        self.positions.append(position)
        if len(self.times) > most:
            self.times = self.times[::2]
            self.positions = self.positions[::2]
            self.step = 2.0 * self.step


@dataclass(slots=True, kw_only=True)
class RunView:
    """The facts about a run that conversion needs beside the message itself."""

    scene: Scene
    dt: float
    """Time between two ticks [s]."""
    tracks: dict[str, PathTrack] = field(default_factory=dict)
    hazards: tuple[Hazard, ...] = ()
    """Of the flight: a recording tells them in its first map alone."""
    own: tuple[RosMessage, ...] = ()
    """Diagnostics of the bridge itself."""

    def follow(self, message: Message | None) -> None:
        """Take down what later messages need: the vehicles' positions for their paths, and a flight's hazards."""
        match message:
            case Truth():
                for name, vehicle in message.vehicles.items():
                    self.tracks.setdefault(name, PathTrack()).add(message.time, vehicle.position)
            case GroundMap() if message.hazards:
                self.hazards = message.hazards


def view_of(name: str, geometry: Geometry) -> RunView:
    """The view of a run that observers have.

    Args:
        name: Of the scenario.
        geometry: What they are told of it.
    """
    scene = observed_scene(name, geometry, escorts=geometry.uavs, vehicles=geometry.limits)
    return RunView(scene=scene, dt=geometry.dt)
