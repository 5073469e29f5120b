"""Perception of a tick of the closed loop: maps, filters, radio, and tile reports."""

from agents.drivers.tile_map import record_block, record_tiles
from agents.estimation.batch_filter import update as update_estimate
from agents.estimation.map_updates import BLOCK_TILES, decode_tile, map_updates_of, record_tile
from agents.estimation.perception import add_detections
from outrider.envs.closed_loop_state import LoopParameters, LoopState, LoopTables
from outrider.envs.height_tick import occlusion_at
from outrider.envs.vehicle_parts import coverage_of, filter_of, grid_of, reference_of
from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED, Packet
from sim.compiling.compile import inlined
from sim.engine.ground_state import GroundState
from sim.engine.mission import receive_block
from sim.models.field import accumulate


@inlined
def _receive_block(
    tables: LoopTables, state: LoopState, ground: GroundState, world: int, ugv: int, packet: Packet
) -> None:
    """Update a UGV's occupancy grid from a map update."""
    block, across = packet.block, state.map_updates.repeats.shape[3]
    row, column, states = block // across, block % across, state.states[world, :BLOCK_TILES]
    for place in range(BLOCK_TILES):
        states[place] = decode_tile(packet.tiles, place)
    record_block(grid_of(tables, state, world, ugv), row, column, states)
    receive_block(ground, world, ugv, state.batch.ticks[world], (row, column), states)


@inlined
def _sense_ground(
    tables: LoopTables, state: LoopState, ground: GroundState, world: int, ugv: int
) -> None:
    """Update a UGV's occupancy grid from the reports of its own sensor."""
    v = ground.ugvs[ugv]
    columns, count = ground.tiles.shape[2], ground.report_counts[world, v]
    rows = state.places[world, 0, :count]
    across = state.places[world, 1, :count]
    states = state.states[world, :count]
    for n in range(count):
        rows[n], across[n] = ground.seen[world, v, n] // columns, ground.seen[world, v, n] % columns
        states[n] = ground.known[world, v, rows[n], across[n]]
    if count > 0:
        record_tiles(grid_of(tables, state, world, ugv), rows, across, states)


@inlined
def _radio(tables: LoopTables, state: LoopState, ground: GroundState | None, world: int) -> None:
    """Send the radio messages of the previous tick, and receive those that arrive."""
    tick, arrived = state.batch.ticks[world], state.arrived[world]
    arrived[:] = 0
    packets, traces = state.batch.packets, tables.batch.traces
    for u in range(tables.receivers.shape[0]):
        g, come = tables.receivers[u], state.inboxes[world, tables.receivers[u]]
        # radio links follow the links of detections and commands
        link = state.batch.links[world, tables.receivers.shape[0] + tables.action_row.shape[0] + u]
        begin_tick(link, packets, world, traces, tick)
        for k in range(state.outbox.shape[2]):
            packet = state.outbox[world, u, k]
            if packet.stamp >= 0.0:
                send(link, packets, world, traces, packet)
                packet.stamp = -1.0
        for i in range(receive(link, packets, world)):
            packet = packets[world, link.number, ARRIVED, i]
            if packet.block < 0:
                n = arrived[g]
                come[n, 0], come[n, 1], come[n, 2] = (
                    packet.stamp,
                    packet.vector[0],
                    packet.vector[1],
                )
                arrived[g] = n + 1
            elif ground is not None:
                _receive_block(tables, state, ground, world, g, packet)


@inlined
def _record_reports(
    parameters: LoopParameters, state: LoopState, ground: GroundState, world: int, uav: int, v: int
) -> None:
    """Record the tiles reported by a UAV's sensor, for its map updates."""
    if parameters.map_update_ticks > 0:
        columns = ground.tiles.shape[2]
        for n in range(ground.report_counts[world, v]):
            row, column = ground.seen[world, v, n] // columns, ground.seen[world, v, n] % columns
            found = ground.known[world, v, row, column]
            record_tile(map_updates_of(state.map_updates, world, uav), column, row, found)


@inlined
def perceive(
    parameters: LoopParameters,
    tables: LoopTables,
    state: LoopState,
    ground: GroundState | None,
    world: int,
) -> None:
    """Update the map and filters of each UAV and the inbox of each UGV from the messages of this tick."""
    escorts, tick = tables.batch.escorts, state.batch.ticks[world]
    detections = state.detections[world]
    looked = 1 if parameters.own_maps and tick > 0 else 0  # otherwise the world updates the map
    for u in range(escorts.shape[0]):
        vehicle, uav = state.batch.vehicles[world, escorts[u, 0]], state.uavs[world, u]
        here, occlusion = reference_of(vehicle), occlusion_at(tables.heights, uav, u, vehicle)
        if ground is not None:
            _record_reports(parameters, state, ground, world, u, escorts[u, 0])
        arrived = state.batch.links[world, u].arrived
        for n in range(arrived):
            packet = state.batch.packets[world, u, ARRIVED, n]
            detections[n, 0], detections[n, 1], detections[n, 2] = (
                packet.stamp,
                packet.vector[0],
                packet.vector[1],
            )
        if looked > 0:
            grid, dt = coverage_of(parameters, state, world, u), looked * uav.dt
            accumulate(grid, here.p_x, here.p_y, uav.sensor, uav.cell, dt, occlusion)
        if tables.filtered[u]:
            memory = filter_of(tables, state.filters, world, u)
            add_detections(tables.safety[u], memory, tick, here, detections, arrived)
        if tables.estimating[u]:
            numbers, place = tables.kalman[u], (world, u)
            update_estimate(numbers, state.kalman, place, tick, here, detections, arrived)
    if parameters.radio:
        _radio(tables, state, ground, world)
    if ground is not None and state.grids.tiles.shape[2] > 0:
        for g in range(ground.ugvs.shape[0]):
            _sense_ground(tables, state, ground, world, g)
