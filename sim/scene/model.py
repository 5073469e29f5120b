"""Scene as plain data: ground, vehicles with their colors, circles around them, and escorts.

All pictures are drawn from it: the picture and film of a run, the environment's `render`, the paper's figures, the
Foxglove view, the terminal and the page. Values that change with time (positions, paths, coverage, estimates) are
passed to the drawing code.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

from bus.messages.buildings import Building, Camera
from bus.messages.telemetry import Geometry, VehicleTruth
from sim.scene.colors import LIMIT, UAV, UGV, color

LABELS = {"r_v": "visibility radius", "r_s": "switching radius", "r": "sensing range"}
"""Meaning of the circles, by the symbol of their radius."""
_LOOKS = {"r_v": (1.6, False), "r_s": (1.2, True), "r": (0.8, False)}
"""Width of their lines [pt], and True if dashed."""
Point = tuple[float, float]
"""x and y [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneVehicle:
    """One vehicle."""

    name: str
    flies: bool
    """True for a UAV, False for a UGV."""
    color: str
    steers: bool = False
    """True for a UGV that moves along its heading, which pictures show."""
    goals: tuple[Point, ...] = ()
    """Goals of a UGV [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ring:
    """Circle that moves with a vehicle."""

    around: str
    """Name of the vehicle."""
    symbol: str
    """Symbol of the radius: r_v, r_s or r."""
    label: str
    radius: float
    """Radius [m]."""
    color: str
    width: float
    """Line width [pt]."""
    dashed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """Third dimension of a scene: buildings, and the camera of UAVs with an altitude."""

    buildings: tuple[Building, ...] = ()
    camera: Camera | None = None
    """Camera; None: the UAVs fly in the plane."""
    markers: Mapping[str, float] = field(default_factory=dict)
    """Height of each UGV's marker [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """State of the vehicles at a moment, beyond their paths."""

    altitudes: Mapping[str, float] = field(default_factory=dict)
    """Altitude of each UAV that has one [m]."""
    headings: Mapping[str, float] = field(default_factory=dict)
    """Heading of each UGV that steers [rad], from east to north."""
    hidden: Collection[str] = ()
    """UAVs from which their UGV is not visible at any distance."""


def headings_of(vehicles: Mapping[str, VehicleTruth]) -> dict[str, float]:
    """Return the heading of each UGV that steers [rad]."""
    return {name: one.heading for name, one in vehicles.items() if one.heading is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Constant content of a run's pictures."""

    title: str
    width: float
    """Width of the ground [m]."""
    height: float
    vehicles: tuple[SceneVehicle, ...]
    """UGVs, then UAVs, each in name order: UAVs are drawn on top."""
    escorts: tuple[tuple[str, str], ...]
    """Pairs (UAV, escorted UGV)."""
    rings: tuple[Ring, ...] = ()
    space: Space = field(default_factory=Space)
    teams: tuple[tuple[str, ...], ...] = ()
    """UAVs of each team, in name order."""

    def with_rings(self, *symbols: str) -> "Scene":
        """Return the scene with only the circles of these symbols."""
        return replace(self, rings=tuple(ring for ring in self.rings if ring.symbol in symbols))

    def color_of(self, name: str) -> str:
        """Return the color of a vehicle.

        Raises:
            KeyError: If there is none of this name.
        """
        return {vehicle.name: vehicle.color for vehicle in self.vehicles}[name]


def observed_scene(
    title: str,
    geometry: Geometry | None,
    *,
    escorts: Mapping[str, str],
    vehicles: Iterable[str],
    ground: Point = (40.0, 40.0),
) -> Scene:
    """Return the scene for an observer, who does not know the scenario.

    Args:
        title: Name of the scenario.
        geometry: Geometry from the simulator; None: draw no circles.
        escorts: Escorted UGV of each UAV.
        vehicles: Names of all vehicles.
        ground: Width and height of the ground without a geometry [m].
    """
    ugvs = sorted(set(vehicles) - set(escorts))
    if geometry is None:
        return assembled(title, ground, escorts, ugvs)
    r_v, r_s = geometry.visibility_radius, geometry.switching_radius
    return assembled(
        title,
        (geometry.area.width, geometry.area.height),
        escorts,
        ugvs,
        steering=geometry.max_turn_rates,
        goals=geometry.goals,
        radii=(r_v, geometry.sensor_range),
        inner=dict.fromkeys(ugvs, r_s if r_s is not None and 0.0 < r_s < r_v else None),
        space=Space(
            buildings=geometry.buildings,
            camera=geometry.camera,
            markers=geometry.marker_heights,
        ),
        teams=geometry.teams,
    )


def assembled(
    title: str,
    size: Point,
    escorts: Mapping[str, str],
    ugvs: Iterable[str],
    *,
    steering: Collection[str] = (),
    goals: Mapping[str, tuple[Point, ...]] | None = None,
    radii: Point | None = None,
    inner: Mapping[str, float | None] | None = None,
    space: Space | None = None,
    teams: tuple[tuple[str, ...], ...] = (),
) -> Scene:
    """Return a scene from its parts.

    Args:
        title: Name of the scenario.
        size: Width and height of the ground [m].
        escorts: Escorted UGV of each UAV.
        ugvs: Names of all UGVs, in order.
        steering: UGVs that steer.
        goals: Goals of each UGV [m].
        radii: r_v and the sensor's range [m]; None: no circles.
        inner: r_s around each UGV [m]; None: no circle.
        space: Buildings and camera; None: neither.
        teams: UAVs of each team.
    """
    uavs, ugvs = sorted(escorts), list(ugvs)
    vehicles = [
        *(
            SceneVehicle(
                name=name,
                flies=False,
                color=color(UGV, k),
                steers=name in steering,
                goals=(goals or {}).get(name, ()),
            )
            for k, name in enumerate(ugvs)
        ),
        *(SceneVehicle(name=name, flies=True, color=color(UAV, k)) for k, name in enumerate(uavs)),
    ]
    rings: list[Ring] = []
    if radii is not None:
        r_v, sensing_range = radii
        escorted = [name for name in ugvs if name in escorts.values()]
        limits = {name: (inner or {}).get(name) for name in escorted}
        rings += [_ring(name, "r_v", r_v) for name in escorted]
        rings += [_ring(name, "r_s", r_s) for name, r_s in limits.items() if r_s is not None]
        rings += [_ring(one.name, "r", sensing_range, one.color) for one in vehicles if one.flies]
    return Scene(
        title=title,
        width=size[0],
        height=size[1],
        vehicles=tuple(vehicles),
        escorts=tuple((uav, escorts[uav]) for uav in uavs),
        rings=tuple(rings),
        space=space or Space(),
        teams=teams,
    )


def _ring(around: str, symbol: str, radius: float, color: str = LIMIT) -> Ring:
    """Return a circle [m] around a vehicle, in the style of its symbol."""
    width, dashed = _LOOKS[symbol]
    return Ring(
        around=around,
        symbol=symbol,
        label=LABELS[symbol],
        radius=radius,
        color=color,
        width=width,
        dashed=dashed,
    )
