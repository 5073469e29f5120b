"""The scene as plain data: ground, vehicles with their colours, circles around them, and who escorts whom.

Every picture of ours draws from it: the flight's picture and film, the environment's `render`, the paper's figures, the
recording's view for Foxglove, the terminal and the page. What changes from tick to tick (places, tracks, coverage,
estimates) is handed to whatever draws.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from bus.messages.telemetry import Geometry
from sim.scene.colors import LIMIT, UAV, UGV, color

LABELS = {"r_v": "limit of sight", "r_s": "only tracking", "r": "range of the sensor"}
"""The meaning of the circles, by the symbol of their radius."""
_LOOKS = {"r_v": (1.6, False), "r_s": (1.2, True), "r": (0.8, False)}
"""Width of their lines [pt], and whether they are dashed."""
Point = tuple[float, float]
"""x and y [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneVehicle:
    """One vehicle."""

    name: str
    flies: bool
    """A UAV; otherwise a UGV."""
    color: str
    goals: tuple[Point, ...] = ()
    """Of a UGV."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ring:
    """A circle that moves with a vehicle."""

    around: str
    """Name of the vehicle."""
    symbol: str
    """Of the radius: r_v, r_s or r."""
    label: str
    radius: float
    """[m]"""
    color: str
    width: float
    """[pt]"""
    dashed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """All that stays as it is while a run is flown."""

    title: str
    width: float
    """Of the ground [m]."""
    height: float
    vehicles: tuple[SceneVehicle, ...]
    """UGVs, then UAVs, each in name order: what flies is drawn on top."""
    escorts: tuple[tuple[str, str], ...]
    """Each UAV, and the UGV it escorts."""
    rings: tuple[Ring, ...] = ()

    def with_rings(self, *symbols: str) -> "Scene":
        """The scene with the circles of these symbols alone."""
        return replace(self, rings=tuple(ring for ring in self.rings if ring.symbol in symbols))

    def color_of(self, name: str) -> str:
        """The colour of a vehicle.

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
    """The scene as an observer has it, who is told no scenario.

    Args:
        title: Name of the scenario.
        geometry: What the simulator tells of it; without it there are no circles.
        escorts: Each UAV, and the UGV it escorts.
        vehicles: Names of all vehicles.
        ground: Width and height of the ground [m] where no geometry tells it.
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
        goals=geometry.goals,
        radii=(r_v, geometry.sensor_range),
        inner=dict.fromkeys(ugvs, r_s if r_s is not None and 0.0 < r_s < r_v else None),
    )


def assembled(
    title: str,
    size: Point,
    escorts: Mapping[str, str],
    ugvs: Iterable[str],
    *,
    goals: Mapping[str, tuple[Point, ...]] | None = None,
    radii: Point | None = None,
    inner: Mapping[str, float | None] | None = None,
) -> Scene:
    """A scene from its parts.

    Args:
        title: Name of the scenario.
        size: Width and height of the ground [m].
        escorts: Each UAV, and the UGV it escorts.
        ugvs: Names of all UGVs, in order.
        goals: Of each UGV [m].
        radii: r_v and the sensor's range [m]; None: no circles.
        inner: r_s around each UGV [m]; None where it is no circle of its own.
    """
    uavs, ugvs = sorted(escorts), list(ugvs)
    vehicles = [
        *(
            SceneVehicle(
                name=name, flies=False, color=color(UGV, k), goals=(goals or {}).get(name, ())
            )
            for k, name in enumerate(ugvs)
        ),
        *(SceneVehicle(name=name, flies=True, color=color(UAV, k)) for k, name in enumerate(uavs)),
    ]
    rings: list[Ring] = []
    if radii is not None:
        r_v, reach = radii
        escorted = [name for name in ugvs if name in escorts.values()]
        limits = {name: (inner or {}).get(name) for name in escorted}
        rings += [_ring(name, "r_v", r_v) for name in escorted]
        rings += [_ring(name, "r_s", r_s) for name, r_s in limits.items() if r_s is not None]
        rings += [_ring(one.name, "r", reach, one.color) for one in vehicles if one.flies]
    return Scene(
        title=title,
        width=size[0],
        height=size[1],
        vehicles=tuple(vehicles),
        escorts=tuple((uav, escorts[uav]) for uav in uavs),
        rings=tuple(rings),
    )


def _ring(around: str, symbol: str, radius: float, color: str = LIMIT) -> Ring:
    """A circle [m] around a vehicle, as those of its symbol look."""
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
