"""One tick of a world, compiled: the same functions serve a single world and each of many."""

import math

import numpy as np

from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED
from sim.engine.ground_tick import drive_on, keep_before, perceive_ground
from sim.engine.mission import note_mission
from sim.engine.world_state import (
    COMMAND,
    BatchState,
    BatchTables,
    WorldState,
)
from sim.kernels.compile import FloatArray, IntArray, borrowing, inlined
from sim.kernels.records import RecordArray
from sim.models.detection import detect
from sim.models.field import accumulate, accumulate_with_gain, coverage_error
from sim.models.inner_loop import step_error
from sim.models.motion import NO_MOTION, follow_on, motion_command
from sim.models.randomness import DETECTION_CHANCE, DETECTION_NOISE, DISTURBANCE, key_of
from sim.models.vehicles import brake, norm, step_vehicle, within_walls
from sim.models.wind import draw_disturbance


@inlined
def _move(tables: BatchTables, state: BatchState, world: int) -> None:
    """Every vehicle moves to where its command leads, (1)."""
    parameters, pace = tables.world[0], state.ground.pace[world]
    position, velocity = state.told.position[world], state.told.velocity[world]
    acceleration, commands = state.truth.acceleration[world], state.truth.commands[world]
    for k in range(position.shape[0]):
        speed = tables.bounds[k, 0]
        if pace.shape[0] > 0 and pace[k] < 1.0:
            speed = speed * pace[k] if pace[k] > 0.0 else 0.0  # which may be infinite
        p_x, p_y, v_x, v_y, u_x, u_y = step_vehicle(
            position[k, 0],
            position[k, 1],
            velocity[k, 0],
            velocity[k, 1],
            commands[k, 0],
            commands[k, 1],
            speed,
            tables.bounds[k, 1],
            parameters.dt,
        )
        position[k, 0], velocity[k, 0] = within_walls(p_x, v_x, parameters.width)
        position[k, 1], velocity[k, 1] = within_walls(p_y, v_y, parameters.height)
        acceleration[k, 0], acceleration[k, 1] = u_x, u_y


@inlined
def _see(tables: BatchTables, state: BatchState, world: int) -> None:
    """Every UAV's sensor looks at the ground, (3)."""
    parameters, position = tables.world[0], state.truth.position[world]
    coverage, gains = state.truth.coverage[world], state.truth.gains[world]
    for k in range(tables.escorts.shape[0]):
        a, g = tables.escorts[k, 0], tables.escorts[k, 1]
        if parameters.gains:
            gains[k] = accumulate_with_gain(
                coverage,
                position[a, 0],
                position[a, 1],
                position[g, 0],
                position[g, 1],
                parameters.r_o,
                parameters.desired,
                parameters.sensor,
                parameters.peak,
                parameters.reach,
                parameters.cell,
                parameters.dt,
            )
        else:
            accumulate(
                coverage,
                position[a, 0],
                position[a, 1],
                parameters.sensor,
                parameters.peak,
                parameters.reach,
                parameters.cell,
                parameters.dt,
            )


@inlined
def _detect(tables: BatchTables, state: BatchState, world: int) -> None:
    """Every UAV's detector looks for its UGV, where it is due at this tick."""
    parameters, keys, tick = tables.world[0], state.keys[world], state.ticks[world]
    position, detections = state.truth.position[world], state.truth.detections[world]
    for k in range(tables.escorts.shape[0]):
        a, g = tables.escorts[k, 0], tables.escorts[k, 1]
        detections[k, 0], detections[k, 1] = np.nan, np.nan
        if tick % parameters.period == 0:
            _, detections[k, 0], detections[k, 1] = detect(
                position[a, 0] - position[g, 0],
                position[a, 1] - position[g, 1],
                parameters.r_v,
                parameters.reach,
                parameters.dropout,
                parameters.sigma,
                parameters.cut,
                key_of(keys, DETECTION_NOISE, a),
                key_of(keys, DETECTION_CHANCE, a),
                tick,
            )


@borrowing
def measure(
    world: RecordArray,
    position: FloatArray,
    escorts: IntArray,
    coverage: FloatArray,
    measures: FloatArray,
    error: bool,
) -> None:
    """Distance [m] and e(t) (4) with the true p_g [m²] of each UAV, into `measures`; `world` as in `BatchTables`.

    e(t) is left out, and 0, where `error` is not asked for.
    """
    parameters = world[0]
    for k in range(escorts.shape[0]):
        a, g = escorts[k, 0], escorts[k, 1]
        measures[k, 0] = norm(position[a, 0] - position[g, 0], position[a, 1] - position[g, 1])
        measures[k, 1] = 0.0
        if error:
            measures[k, 1] = coverage_error(
                coverage,
                position[g, 0],
                position[g, 1],
                parameters.r_o,
                parameters.desired,
                parameters.cell,
            )


@inlined
def truth_of(truth: WorldState, world: int) -> WorldState:
    """The truth of one world: views, no copies."""
    return WorldState(
        truth.position[world],
        truth.velocity[world],
        truth.acceleration[world],
        truth.commands[world],
        truth.coverage[world],
        truth.detections[world],
        truth.gains[world],
        truth.measures[world],
    )


@borrowing
def _note_arrival(motions: RecordArray, last: int, carried: int) -> None:
    """A command has arrived that carries the motions that begin in the tick `last` and in those before it.

    Of one that has begun already, or whose row holds a later one by now, nothing comes.
    """
    rows = motions.shape[0]
    for begins in range(max(0, last - min(carried, rows) + 1), last + 1):
        if motions[begins % rows].begins == begins:
            motions[begins % rows].arrived = 1


@inlined
def _fly_motion(tables: BatchTables, state: BatchState, world: int, vehicle: int) -> bool:
    """Fly the motion of this tick if it has come and goes on from the one that is flown, else the rest of that one.

    False where commands act that carry none.
    """
    motions, flown = state.motions[world, vehicle], state.flown[world, vehicle]
    tick, velocity = state.ticks[world], state.told.velocity[world, vehicle]
    if motions[tick % motions.shape[0]].arrived == 1:
        follow_on(motions, flown, tick)
    if flown[0].plain == 1:
        return False
    u_x, u_y = motion_command(
        flown[0], velocity[0], velocity[1], tables.bounds[vehicle, 1], tables.world[0].dt
    )
    acting = state.truth.commands[world, vehicle]
    acting[0], acting[1] = u_x, u_y
    flown[0].age += 1
    return True


@inlined
def receive_commands(tables: BatchTables, state: BatchState, world: int) -> None:
    """Send the commands out; each vehicle acts on its newest one that has arrived.

    Where none has come for a while, it brakes. A receiver of motions begins each in its own tick, and flies on what it
    flies where none begins.
    """
    parameters, tick = tables.world[0], state.ticks[world]
    acting = state.truth.commands[world]
    sent = state.sent[world]
    answered = state.answered[world]
    for v in range(sent.shape[0]):
        row = tables.escorts.shape[0] + v
        link = state.links[world, row]
        begin_tick(link, state.packets, world, tables.traces, tick)
        if sent[v, COMMAND.answered] >= 0.0:
            packet = state.packets[world, row, ARRIVED, 0]
            packet.stamp = sent[v, COMMAND.answered]
            packet.vector[0], packet.vector[1] = sent[v, COMMAND.u_x], sent[v, COMMAND.u_y]
            packet.plan, packet.plans = int(sent[v, COMMAND.last]), int(sent[v, COMMAND.carried])
            send(link, state.packets, world, tables.traces, packet)
            sent[v, COMMAND.answered] = -1.0
        for n in range(receive(link, state.packets, world)):
            packet = state.packets[world, row, ARRIVED, n]
            if tables.receivers[v] and packet.plan >= 0:
                _note_arrival(state.motions[world, v], packet.plan, packet.plans)
            if packet.stamp > answered[v]:
                answered[v] = int(packet.stamp)
                acting[v, 0], acting[v, 1] = packet.vector[0], packet.vector[1]
                if tables.receivers[v] and packet.plan < 0:
                    flown = state.flown[world, v, 0]
                    flown.begins, flown.plain = NO_MOTION, 1
        if tables.receivers[v] and _fly_motion(tables, state, world, v):
            continue
        if tick - answered[v] > parameters.hold_ticks:
            v_x, v_y = state.told.velocity[world, v, 0], state.told.velocity[world, v, 1]
            acting[v, 0], acting[v, 1] = brake(v_x, v_y, tables.bounds[v, 1], parameters.dt)


@inlined
def draw_disturbances(tables: BatchTables, state: BatchState, world: int) -> None:
    """Draw what acts on each UAV beside its commands in the coming tick."""
    for u in range(tables.disturbances.shape[0]):
        key = key_of(state.keys[world], DISTURBANCE, tables.escorts[u, 0])
        draw_disturbance(tables.disturbances, state.tracking[world], u, key, state.ticks[world])


@inlined
def put_off(state: BatchState, escorts: IntArray, world: int) -> None:
    """Let every vehicle truly be where it is told that it is, and every UAV off that by its error.

    Args:
        state: Of all worlds; `truth` is changed.
        escorts: Rows (UAV, UGV). Shape (UAVs, 2).
        world: The world.
    """
    position, velocity = state.truth.position[world], state.truth.velocity[world]
    for v in range(position.shape[0]):
        for i in range(2):
            position[v, i] = state.told.position[world, v, i]
            velocity[v, i] = state.told.velocity[world, v, i]
    for u in range(escorts.shape[0]):
        a, off = escorts[u, 0], state.tracking[world, u]
        position[a, 0] += off.x
        position[a, 1] += off.y
        velocity[a, 0] += off.v_x
        velocity[a, 1] += off.v_y


@inlined
def _perceive(tables: BatchTables, state: BatchState, world: int) -> None:
    """The vehicles' sensors look at the ground, and the UAVs' detectors at their UGVs.

    A sensor of the ground looks from where its vehicle is told that it is: when a tile is told depends on nothing but
    the vehicle's own track, so that no UAV finds the wind by it.
    """
    if tables.ground.parameters.shape[0] > 0:
        perceive_ground(tables, state, world)
        note_mission(tables, state, world)
    _detect(tables, state, world)


@inlined
def move(tables: BatchTables, state: BatchState, world: int) -> None:
    """To the next tick: everybody moves (1), the UAVs look at the ground (3) and at their UGVs.

    Commands lead to where the vehicles are told that they are; a UAV that wind or a wrong own position takes from there
    is truly elsewhere.
    """
    grounded = tables.ground.parameters.shape[0] > 0
    state.ticks[world] += 1
    if grounded:
        keep_before(tables, state, world)
    _move(tables, state, world)
    if grounded:
        drive_on(tables, state, world)
    if tables.disturbances.shape[0] > 0:
        for u in range(tables.disturbances.shape[0]):
            step_error(tables.disturbances[u], state.tracking[world], u, tables.world[0].dt)
        put_off(state, tables.escorts, world)
    _see(tables, state, world)
    _perceive(tables, state, world)


@inlined
def deliver_detections(tables: BatchTables, state: BatchState, world: int) -> None:
    """Send this tick's detections out, and receive those that arrive."""
    tick = state.ticks[world]
    found, position = state.truth.detections[world], state.truth.position[world]
    for u in range(found.shape[0]):
        link = state.links[world, u]
        begin_tick(link, state.packets, world, tables.traces, tick)
        if not math.isnan(found[u, 0]):
            a, g = tables.escorts[u, 0], tables.escorts[u, 1]
            packet = state.packets[world, u, ARRIVED, 0]
            packet.stamp = tick
            packet.vector[0], packet.vector[1] = found[u, 0], found[u, 1]
            packet.error = norm(
                found[u, 0] - (position[a, 0] - position[g, 0]),
                found[u, 1] - (position[a, 1] - position[g, 1]),
            )
            send(link, state.packets, world, tables.traces, packet)
        receive(link, state.packets, world)


@inlined
def begin_world(tables: BatchTables, state: BatchState, world: int) -> None:
    """World k, whose arrays are as they are at the start but for its keys, has the first look."""
    _perceive(tables, state, world)
    deliver_detections(tables, state, world)


@inlined
def world_tick(tables: BatchTables, state: BatchState, world: int, linked: bool) -> None:
    """World k advances by one tick.

    Args:
        tables: What all worlds share.
        state: Is changed.
        world: The world.
        linked: Whether commands cross their links; else everybody acts on what stands in `truth.commands`.
    """
    if linked:
        receive_commands(tables, state, world)
    draw_disturbances(tables, state, world)
    move(tables, state, world)
    deliver_detections(tables, state, world)
