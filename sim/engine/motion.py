"""Motion of the vehicles' reference states in a tick, (1): UAVs and UGVs, on even and on rough ground."""

from sim.compiling.compile import compiled, inlined
from sim.compiling.records import RecordArray
from sim.engine.ground_state import GroundState
from sim.engine.world_state import Vehicle, WorldParameters
from sim.models.kinematics import POINT, UgvState, step_ugv, ugv_within_walls
from sim.models.vehicles import step_vehicle, within_walls


@compiled
def ugv_state(vehicle: Vehicle) -> UgvState:
    """Return the state of a UGV."""
    position, velocity = vehicle.reference_position, vehicle.reference_velocity
    return UgvState(position[0], position[1], velocity[0], velocity[1], vehicle.heading)


@compiled
def _steer(numbers: WorldParameters, vehicle: Vehicle, max_speed: float) -> None:
    """Advance a UGV that steers by one tick; `max_speed`: on the ground where it is [m/s]."""
    before, dt = ugv_state(vehicle), numbers.dt
    after = step_ugv(
        vehicle.kinematics,
        before,
        vehicle.command[0],
        vehicle.command[1],
        (vehicle.max_speed, vehicle.max_acceleration),
        max_speed,
        dt,
    )
    vehicle.acceleration[0] = (after.v_x - before.v_x) / dt
    vehicle.acceleration[1] = (after.v_y - before.v_y) / dt
    after = ugv_within_walls(vehicle.kinematics, after, numbers.width, numbers.height)
    position, velocity = vehicle.reference_position, vehicle.reference_velocity
    position[0], position[1], velocity[0], velocity[1], vehicle.heading = after


@compiled
def _step(numbers: WorldParameters, vehicle: Vehicle, max_speed: float) -> None:
    """Advance the reference state of a vehicle by one tick, (1); `max_speed`: on the ground where it is [m/s]."""
    if vehicle.kinematics.kind != POINT:
        _steer(numbers, vehicle, max_speed)
        return
    position, velocity = vehicle.reference_position, vehicle.reference_velocity
    p_x, p_y, v_x, v_y, u_x, u_y = step_vehicle(
        position[0],
        position[1],
        velocity[0],
        velocity[1],
        vehicle.command[0],
        vehicle.command[1],
        max_speed,
        vehicle.max_acceleration,
        numbers.dt,
    )
    position[0], velocity[0] = within_walls(p_x, v_x, numbers.width)
    position[1], velocity[1] = within_walls(p_y, v_y, numbers.height)
    vehicle.acceleration[0], vehicle.acceleration[1] = u_x, u_y


@inlined
def move_vehicles(
    numbers: WorldParameters, vehicles: RecordArray, ground: GroundState | None, world: int
) -> None:
    """Move every vehicle under its command, (1)."""
    for v in range(vehicles.shape[1]):
        vehicle = vehicles[world, v]
        speed = vehicle.max_speed
        if ground is not None:
            pace = ground.pace[world, v]
            if pace < 1.0:
                speed = speed * pace if pace > 0.0 else 0.0  # the speed may be infinite
        _step(numbers, vehicle, speed)
