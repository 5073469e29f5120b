"""Compiled tick of altitude, camera and buildings; planar scenarios compile only its planar variants."""

import math

from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.dispatch import unless_none
from sim.compiling.records import RecordArray
from sim.engine.space_state import TownState, TownTables, building_rows
from sim.engine.world_state import BatchState, Rows, Vehicle, WorldParameters
from sim.models.altitude import VerticalLimits, level_off, step_altitude
from sim.models.buildings import CameraPosition, line_of_sight, path_meets_building, sees_corner
from sim.models.camera import (
    CameraParameters,
    noise_at,
    range_at,
    sensor_at,
    visibility_radius_at,
)
from sim.models.detection import detect
from sim.models.field import Demand, accumulate, accumulate_with_gain
from sim.models.polygons import distance_to_polygon
from sim.models.randomness import DETECTION_CHANCE, DETECTION_NOISE, key_of
from sim.models.sensor import SensorParameters
from sim.models.shadows import Occlusion, all_known
from sim.models.vehicles import norm

_OFF_WALL = 1e-6
"""Distance from a wall at which a UAV that flies against it stops [m]."""


@unless_none
@compiled
def occlusion_of(buildings: TownTables, world: int, z: float) -> Occlusion:
    """Return the buildings of a world as a camera at altitude z sees them; None without buildings."""
    seen: Occlusion = all_known(building_rows(buildings, world), buildings.corners, z)
    return seen


@unless_none
@compiled
def discover(
    town: TownState,
    buildings: TownTables,
    cameras: RecordArray,
    numbers: WorldParameters,
    rows: Rows,
    tick: int,
    uav: Vehicle,
) -> None:
    """Record the buildings of which a UAV has now seen all corners; do nothing without buildings.

    Like a ground sensor, its camera observes from the reference position.
    """
    world, k = rows.world, rows.uav
    if not uav.vertical.flies:
        return
    x, y, z = uav.reference_position[0], uav.reference_position[1], uav.vertical.altitude
    sensing_range = range_at(numbers.sensor.sensing_range, cameras[k].tangent, z)
    table, corners = building_rows(buildings, world), buildings.corners
    camera = CameraPosition(x, y, z)
    known, sighted = town.known[world, k], town.sighted[world, k]
    for n in range(table.shape[0]):
        row = table[n]
        if row["height"] == 0.0 or known[n]:
            continue
        d_x, d_y, far = row["x"] - x, row["y"] - y, row["bounding_radius"] + sensing_range
        if d_x * d_x + d_y * d_y > far * far:
            continue
        missing = 0
        for i in range(row["corners"]):
            if not sighted[n, i]:
                corner = row["first"] + i
                sighted[n, i] = sees_corner(table, corners, n, corner, camera, sensing_range)
            missing += 0 if sighted[n, i] else 1
        if missing == 0:
            known[n] = True
            town.found[world, k, n] = tick


@compiled
def _sees(
    buildings: TownTables | None, world: int, camera: CameraParameters, uav: Vehicle, ugv: Vehicle
) -> bool:
    """Return whether no building hides the UGV's marker from a UAV."""
    if buildings is None:
        return True
    return bool(
        line_of_sight(
            building_rows(buildings, world),
            buildings.corners,
            uav.position[0],
            uav.position[1],
            uav.vertical.altitude,
            ugv.position[0],
            ugv.position[1],
            camera.marker_height,
        )
    )


@compiled
def measure_sight(
    numbers: WorldParameters,
    buildings: TownTables | None,
    world: int,
    cameras: RecordArray | None,
    k: int,
    uav: Vehicle,
    ugv: Vehicle,
) -> None:
    """Set the distance within which the k-th UAV sees its UGV: r_v at its altitude, or 0 while a building hides it."""
    if cameras is None:
        uav.sight_radius = numbers.r_v
    else:
        camera = cameras[k]
        radius = visibility_radius_at(
            numbers.r_v, camera.tangent, camera.marker_height, uav.vertical.altitude
        )
        uav.sight_radius = radius if _sees(buildings, world, camera, uav, ugv) else 0.0


@compiled
def update_coverage(
    numbers: WorldParameters,
    state: BatchState,
    cameras: RecordArray | None,
    rows: Rows,
    uav: Vehicle,
    ugv: Vehicle,
) -> None:
    """Update the coverage with a UAV's sensor at its altitude, (3); hidden cells gain nothing.

    Args:
        numbers: Parameters of the world.
        state: State of all worlds; coverage and the UAV's gain are changed.
        cameras: `CameraParameters` of each UAV; None: they fly in the plane.
        rows: Rows of the UAV.
        uav, ugv: The UAV and its UGV in the world.
    """
    world, k = rows.world, rows.uav
    coverage = state.coverage[world]
    sensor, occlusion = view_of(cameras, numbers, state.buildings, world, k, uav)
    x, y = uav.position[0], uav.position[1]
    if numbers.gains:
        demand = Demand(ugv.position[0], ugv.position[1], numbers.r_o, numbers.desired)
        uav.gain = accumulate_with_gain(
            coverage, x, y, demand, sensor, numbers.cell, numbers.dt, occlusion
        )
    else:
        accumulate(coverage, x, y, sensor, numbers.cell, numbers.dt, occlusion)


@compiled
def run_detector(
    cameras: RecordArray | None,
    numbers: WorldParameters,
    buildings: TownTables | None,
    rows: Rows,
    tick: int,
    uav: Vehicle,
    ugv: Vehicle,
) -> None:
    """Run a UAV's detector of its UGV at its altitude; a hidden UGV is not detected.

    Args:
        cameras: `CameraParameters` of each UAV; None: they fly in the plane.
        numbers: Parameters of the world.
        buildings: Buildings; None: there are none.
        rows: Rows of the UAV.
        tick: The tick.
        uav, ugv: The UAV, whose detection is changed, and its UGV.
    """
    world, k = rows.world, rows.uav
    x, y = uav.position[0] - ugv.position[0], uav.position[1] - ugv.position[1]
    radius, sensing_range, noise = numbers.r_v, numbers.sensor.sensing_range, numbers.sigma
    if cameras is not None:
        camera, z = cameras[k], uav.vertical.altitude
        if not _sees(buildings, world, camera, uav, ugv):
            return
        radius = visibility_radius_at(numbers.r_v, camera.tangent, camera.marker_height, z)
        sensing_range = range_at(numbers.sensor.sensing_range, camera.tangent, z)
        noise = noise_at(numbers.sigma, camera.reference_height, norm(x, y), z)
    _, uav.detection[0], uav.detection[1] = detect(
        x,
        y,
        radius,
        sensing_range,
        numbers.dropout,
        noise,
        numbers.cut,
        key_of(uav.keys, DETECTION_NOISE),
        key_of(uav.keys, DETECTION_CHANCE),
        tick,
    )


@compiled
def _roof_below(
    buildings: RecordArray, corners: FloatArray, uav: Vehicle, x: float, y: float
) -> float:
    """Return the lowest altitude over the buildings at a point that a UAV above them may fly at [m]; 0 beside them."""
    lowest = 0.0
    for k in range(buildings.shape[0]):
        row = buildings[k]
        height, d_x, d_y = row["height"], x - row["x"], y - row["y"]
        if height <= 0.0 or d_x * d_x + d_y * d_y > row["bounding_radius"] * row["bounding_radius"]:
            continue
        if distance_to_polygon(corners, row["first"], row["corners"], x, y) == 0.0:
            lowest = max(lowest, height + uav.vertical.clearance)
    return lowest


@compiled
def store_uav_positions(
    state: BatchState, cameras: RecordArray | None, escorts: IntArray, world: int
) -> None:
    """Store the positions of UAVs with an altitude before they move."""
    if cameras is not None:
        for k in range(escorts.shape[0]):
            uav = state.vehicles[world, escorts[k, 0]]
            for i in range(2):
                uav.vertical.before[i] = uav.reference_position[i]


@compiled
def _climb(
    numbers: WorldParameters, buildings: TownTables | None, world: int, uav: Vehicle
) -> None:
    """Advance the vertical motion of a UAV by one tick, and stop it at roofs and walls.

    A UAV over a building does not sink below the roof plus its vertical clearance. One that flies against a building
    that is too high for its altitude stops in front of the wall.

    Args:
        numbers: Parameters of the world.
        buildings: Buildings; None: there are none.
        world: Index of the world.
        uav: The UAV, after its horizontal motion.
    """
    vertical = uav.vertical
    start = vertical.before[0], vertical.before[1]
    command = vertical.command
    if math.isnan(command):
        command = level_off(vertical.rate, vertical.max_acceleration, numbers.dt)
    limits = VerticalLimits(
        vertical.lowest, vertical.highest, vertical.max_rate, vertical.max_acceleration
    )
    vertical.altitude, vertical.rate, vertical.acceleration = step_altitude(
        vertical.altitude, vertical.rate, command, limits, numbers.dt
    )
    if buildings is None:
        return
    rows, corners = building_rows(buildings, world), buildings.corners
    roof = _roof_below(rows, corners, uav, start[0], start[1])
    if vertical.altitude < roof:
        vertical.altitude, vertical.rate = roof, max(vertical.rate, 0.0)
        vertical.contacts += 1
    position = uav.reference_position
    end = position[0], position[1]
    height = vertical.altitude - vertical.clearance
    share = path_meets_building(rows, corners, start, end, height)
    if share <= 1.0:
        length = norm(end[0] - start[0], end[1] - start[1])
        share = max(0.0, share - _OFF_WALL / length) if length > 0.0 else 0.0
        for i in range(2):
            position[i] = start[i] + share * (end[i] - start[i])
            uav.reference_velocity[i] = 0.0
        vertical.contacts += 1


@compiled
def climb_all(
    numbers: WorldParameters,
    state: BatchState,
    cameras: RecordArray | None,
    escorts: IntArray,
    world: int,
) -> None:
    """Advance the vertical motion of all UAVs, after their horizontal one."""
    if cameras is not None:
        for k in range(escorts.shape[0]):
            uav = state.vehicles[world, escorts[k, 0]]
            if uav.vertical.flies:
                _climb(numbers, state.buildings, world, uav)


@compiled
def view_of(
    cameras: RecordArray | None,
    numbers: WorldParameters,
    buildings: TownTables | None,
    world: int,
    k: int,
    uav: Vehicle,
) -> tuple[SensorParameters, Occlusion | None]:
    """Return the sensor of the k-th UAV at its altitude, and the buildings as it sees them; None: there are none."""
    plain, z = numbers.sensor, uav.vertical.altitude
    sensor = SensorParameters(plain.model, plain.peak, plain.sensing_range)
    if cameras is not None:
        sensor = sensor_at(sensor, cameras[k], z)
    return sensor, occlusion_of(buildings, world, z)
