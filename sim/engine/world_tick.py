"""Compiled tick of a world, used for single worlds and for batches."""

import math

import numpy as np

from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import IntArray, compiled, inlined
from sim.compiling.records import RecordArray, row_of
from sim.engine.ground_state import GroundState
from sim.engine.ground_tick import drive_on, perceive_ground, store_positions
from sim.engine.mission import record_mission
from sim.engine.motion import move_vehicles
from sim.engine.space_tick import (
    climb_all,
    discover,
    measure_sight,
    run_detector,
    store_uav_positions,
    update_coverage,
)
from sim.engine.world_state import BatchState, BatchTables, Rows, Vehicle, WorldParameters
from sim.models.field import coverage_error
from sim.models.inner_loop import step_error
from sim.models.randomness import DISTURBANCE, key_of
from sim.models.trajectories import NO_TRAJECTORY, follow_on, trajectory_command, waited
from sim.models.vehicles import brake, norm
from sim.models.wind import draw_disturbance

WHOLE, BEGIN, END = range(3)
"""Parts of a tick: both at once, or each of `begin_world_tick` and `end_world_tick` around Python's bodies."""


@compiled
def apply_disturbance(vehicle: Vehicle) -> None:
    """Apply the disturbance: true state = reference state + tracking error."""
    off = vehicle.disturbance
    for i in range(2):
        vehicle.position[i] = vehicle.reference_position[i] + off.error[i]
        vehicle.velocity[i] = vehicle.reference_velocity[i] + off.error_rate[i]


@compiled
def _reset_to_reference(vehicle: Vehicle) -> None:
    """Set the true state of a vehicle without disturbances to its reference state."""
    for i in range(2):
        vehicle.position[i] = vehicle.reference_position[i]
        vehicle.velocity[i] = vehicle.reference_velocity[i]


@compiled
def measure(tables: BatchTables, state: BatchState, world: int, error: bool) -> None:
    """Measure the distance [m], the radius of sight [m], and e(t) (4) with the true p_g [m²], of each UAV of a world.

    Args:
        tables, state: Worlds; `distance`, `sight_radius` and `coverage_error` are changed.
        world: Index of the world.
        error: False: set e(t) to 0.
    """
    numbers = tables.world[row_of(tables.world.shape[0], world)]
    escorts, vehicles = tables.escorts, state.vehicles
    for k in range(escorts.shape[0]):
        uav, ugv = vehicles[world, escorts[k, 0]], vehicles[world, escorts[k, 1]]
        uav.distance = norm(uav.position[0] - ugv.position[0], uav.position[1] - ugv.position[1])
        measure_sight(numbers, state.buildings, world, tables.cameras, k, uav, ugv)
        uav.coverage_error = 0.0
        if error:
            uav.coverage_error = coverage_error(
                state.coverage[world],
                ugv.position[0],
                ugv.position[1],
                numbers.r_o,
                numbers.desired,
                numbers.cell,
            )


@compiled
def _record_arrival(
    trajectories: RecordArray, world: int, vehicle: int, last: int, carried: int
) -> None:
    """Mark the trajectories of a received command; they start in the tick `last` and the ticks before it.

    Trajectories that have started, or whose row holds a later one, stay unmarked.
    """
    rows = trajectories.shape[2]
    for begins in range(max(0, last - min(carried, rows) + 1), last + 1):
        trajectory = trajectories[world, vehicle, begins % rows]
        if trajectory.begins == begins:
            trajectory.arrived = 1


@inlined
def _follow_trajectory(numbers: WorldParameters, state: BatchState, world: int, v: int) -> bool:
    """Execute this tick's trajectory if it has arrived and follows the active one, else the rest of the active one.

    Returns:
        False if commands without a trajectory are in effect.
    """
    vehicle, tick = state.vehicles[world, v], state.ticks[world]
    if state.trajectories[world, v, tick % state.trajectories.shape[2]].arrived == 1:
        follow_on(state.trajectories[world, v], state.flown[world, v], tick)
    flown = state.flown[world, v, 0]
    if flown.plain == 1:
        return False
    vehicle.command[0], vehicle.command[1] = trajectory_command(
        flown,
        vehicle.reference_velocity[0],
        vehicle.reference_velocity[1],
        vehicle.max_acceleration,
        numbers.dt,
    )
    first = flown.begins >= 0 and flown.age == 0
    vehicle.vertical.command = flown.vertical_acceleration if first else math.nan
    flown.age += 1
    return True


@compiled
def _acts_bare(state: BatchState, world: int, v: int, begins: int) -> bool:
    """Return whether the newest command acts as a bare acceleration on arrival.

    A command without a trajectory does. One whose trajectory is late does so only after the declared command interval;
    before that, the trajectory is void.
    """
    if begins < 0:
        return True
    vehicle, tick = state.vehicles[world, v], state.ticks[world]
    flown = state.flown[world, v, 0].begins
    wait = waited(tick, flown, vehicle.delay_ticks)
    return bool(begins < tick and wait > vehicle.interval_ticks)


@inlined
def _exchange_commands(state: BatchState, traces: IntArray, world: int, v: int, row: int) -> None:
    """Send the command of a vehicle over its link, and apply the newest one that has arrived."""
    vehicle, link = state.vehicles[world, v], state.links[world, row]
    begin_tick(link, state.packets, world, traces, state.ticks[world])
    vehicle.vertical.command = math.nan  # without a new one, it levels off
    if vehicle.outgoing_tick >= 0:
        packet = state.packets[world, row, ARRIVED, 0]
        packet.stamp = vehicle.outgoing_tick
        packet.vector[0], packet.vector[1] = vehicle.outgoing[0], vehicle.outgoing[1]
        packet.vertical = vehicle.vertical.outgoing
        packet.plan, packet.plans = vehicle.outgoing_trajectory, vehicle.outgoing_trajectories
        send(link, state.packets, world, traces, packet)
        vehicle.outgoing_tick = vehicle.outgoing_trajectory = -1
        vehicle.outgoing_trajectories = 0
    for n in range(receive(link, state.packets, world)):
        packet = state.packets[world, row, ARRIVED, n]
        if vehicle.follows_trajectories and packet.plan >= 0:
            _record_arrival(state.trajectories, world, v, packet.plan, packet.plans)
        if packet.stamp > vehicle.command_tick:
            vehicle.command_tick = int(packet.stamp)
            vehicle.command[0], vehicle.command[1] = packet.vector[0], packet.vector[1]
            vehicle.vertical.command = packet.vertical
            if vehicle.follows_trajectories and _acts_bare(state, world, v, int(packet.plan)):
                flown = state.flown[world, v, 0]
                flown.begins, flown.plain = NO_TRAJECTORY, 1


@inlined
def receive_commands(tables: BatchTables, state: BatchState, world: int) -> None:
    """Send the commands; each vehicle executes the newest one that has arrived.

    Without a new one it levels off, and after the command timeout it brakes. A receiver of trajectories starts each in
    its own tick if its parent is active then. Otherwise it continues the active trajectory, and rests at its end.
    """
    numbers = tables.world[row_of(tables.world.shape[0], world)]
    uavs = tables.escorts.shape[0]
    for v in range(state.vehicles.shape[1]):
        vehicle = state.vehicles[world, v]
        _exchange_commands(state, tables.traces, world, v, uavs + v)
        if vehicle.follows_trajectories and _follow_trajectory(numbers, state, world, v):
            continue
        if state.ticks[world] - vehicle.command_tick > numbers.timeout_ticks:
            velocity = vehicle.reference_velocity
            vehicle.command[0], vehicle.command[1] = brake(
                velocity[0], velocity[1], vehicle.max_acceleration, numbers.dt
            )
            vehicle.vertical.command = math.nan


@inlined
def draw_disturbances(tables: BatchTables, state: BatchState, world: int) -> None:
    """Draw the disturbances of each UAV for the next tick."""
    row = row_of(tables.disturbances.shape[0], world)
    for u in range(tables.disturbances.shape[1]):
        uav = state.vehicles[world, tables.escorts[u, 0]]
        key = key_of(uav.keys, DISTURBANCE)
        draw_disturbance(tables.disturbances[row, u], uav.disturbance, key, state.ticks[world])


@inlined
def _perceive(
    tables: BatchTables, state: BatchState, ground: GroundState | None, world: int
) -> None:
    """Run the vehicles' ground sensors, and the UAVs' detectors; UAVs discover buildings.

    A ground sensor observes from its vehicle's reference position: the time of a report then depends only on the
    vehicle's own trajectory, so that no UAV can infer the wind from it.
    """
    numbers = tables.world[row_of(tables.world.shape[0], world)]
    if ground is not None:
        perceive_ground(tables, ground, state, world)
        record_mission(tables, state, ground, world)
    for u in range(tables.escorts.shape[0]):
        uav = state.vehicles[world, tables.escorts[u, 0]]
        ugv = state.vehicles[world, tables.escorts[u, 1]]
        uav.detection[0], uav.detection[1] = np.nan, np.nan
        tick = state.ticks[world]
        rows = Rows(world, u, tables.escorts[u, 0])
        if numbers.discovers:
            discover(state.town, state.buildings, tables.cameras, numbers, rows, tick, uav)
        if tick % numbers.period == 0 and not uav.disturbance.unknown:
            run_detector(tables.cameras, numbers, state.buildings, rows, tick, uav, ugv)


@inlined
def move_references(
    tables: BatchTables, state: BatchState, ground: GroundState | None, world: int
) -> None:
    """Advance the reference states to the next tick, (1)."""
    numbers = tables.world[row_of(tables.world.shape[0], world)]
    state.ticks[world] += 1
    if ground is not None:
        store_positions(ground, state, world)
    store_uav_positions(state, tables.cameras, tables.escorts, world)
    move_vehicles(numbers, state.vehicles, ground, world)
    climb_all(numbers, state, tables.cameras, tables.escorts, world)
    if ground is not None:
        drive_on(numbers, ground, state, world)


@inlined
def observe(tables: BatchTables, state: BatchState, ground: GroundState | None, world: int) -> None:
    """Apply the tracking errors; UAVs observe the ground (3) and their UGVs."""
    numbers = tables.world[row_of(tables.world.shape[0], world)]
    for v in range(state.vehicles.shape[1]):
        _reset_to_reference(state.vehicles[world, v])
    row = row_of(tables.disturbances.shape[0], world)
    for u in range(tables.disturbances.shape[1]):
        disturbed = state.vehicles[world, tables.escorts[u, 0]]
        if not tables.disturbances[row, u].outside:
            step_error(tables.disturbances[row, u].loop, disturbed.disturbance, numbers.dt)
        apply_disturbance(disturbed)
    for u in range(tables.escorts.shape[0]):
        rows, vehicles = Rows(world, u, tables.escorts[u, 0]), state.vehicles[world]
        uav, ugv = vehicles[rows.vehicle], vehicles[tables.escorts[u, 1]]
        if not uav.disturbance.unknown:
            update_coverage(numbers, state, tables.cameras, rows, uav, ugv)
    _perceive(tables, state, ground, world)


@inlined
def move(tables: BatchTables, state: BatchState, ground: GroundState | None, world: int) -> None:
    """Advance to the next tick: vehicles move (1), and UAVs observe the ground (3) and their UGVs."""
    move_references(tables, state, ground, world)
    observe(tables, state, ground, world)


@compiled
def deliver_detections(tables: BatchTables, state: BatchState, world: int) -> None:
    """Send this tick's detections, and receive those that arrive."""
    for u in range(tables.escorts.shape[0]):
        link = state.links[world, u]
        begin_tick(link, state.packets, world, tables.traces, state.ticks[world])
        uav = state.vehicles[world, tables.escorts[u, 0]]
        if not math.isnan(uav.detection[0]):
            ugv = state.vehicles[world, tables.escorts[u, 1]]
            packet = state.packets[world, u, ARRIVED, 0]
            packet.stamp = state.ticks[world]
            packet.vector[0], packet.vector[1] = uav.detection[0], uav.detection[1]
            packet.error = norm(
                uav.detection[0] - (uav.position[0] - ugv.position[0]),
                uav.detection[1] - (uav.position[1] - ugv.position[1]),
            )
            send(link, state.packets, world, tables.traces, packet)
        receive(link, state.packets, world)


@inlined
def begin_world(
    tables: BatchTables, state: BatchState, ground: GroundState | None, world: int
) -> None:
    """Make the first observations of a world that was reset."""
    _perceive(tables, state, ground, world)
    deliver_detections(tables, state, world)


@inlined
def begin_world_tick(
    tables: BatchTables, state: BatchState, ground: GroundState | None, world: int, linked: bool
) -> None:
    """Begin the next tick of a world: execute the commands, and move the references.

    Args:
        tables: Constants of all worlds.
        state: State of all worlds; changed.
        ground: Ground of all worlds; changed. None: no hazards, and nothing is compiled for them.
        world: Index of the world.
        linked: True if commands cross their links; else every vehicle executes its `command`.
    """
    if linked:
        receive_commands(tables, state, world)
    draw_disturbances(tables, state, world)
    move_references(tables, state, ground, world)


@inlined
def end_world_tick(
    tables: BatchTables, state: BatchState, ground: GroundState | None, world: int
) -> None:
    """End the tick: bodies outside it have set their tracking errors; the vehicles observe. Arguments as above."""
    observe(tables, state, ground, world)
    deliver_detections(tables, state, world)
