"""Perception of a tick of the closed loop: maps, filters, radio, and tile reports."""

from agents.drivers.tile_map import OccupancyGrid, record_block, record_tiles
from agents.estimation.batch_filter import update as update_estimate
from agents.estimation.map_updates import (
    BLOCK_TILES,
    MapUpdateMemory,
    decode_tile,
    map_updates_of,
    record_tile,
)
from agents.uav_tick import perceive as perceive_uav
from outrider.closed_loop.arrays import (
    LoopState,
    LoopTables,
    Pilots,
    constants_of,
    grid_of,
    inputs_of,
    memory_of,
)
from outrider.closed_loop.teams import begin_teams, collect_messages
from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED, Packet
from sim.compiling.compile import FloatArray, IntArray, compiled, inlined
from sim.compiling.records import RecordArray
from sim.engine.ground_state import GroundState, TickArray
from sim.engine.mission import receive_block
from sim.models.ground import TileArray


@compiled
def _receive_block(
    grid: OccupancyGrid, packet: Packet, across: int, states: TileArray
) -> tuple[int, int]:
    """Update a UGV's occupancy grid from a map update.

    Args:
        grid: The occupancy grid; changed.
        packet: The message.
        across: Number of blocks in a row.
        states: States of the block's tiles; changed. Shape (BLOCK_TILES,).

    Returns:
        Row and column of the block.
    """
    row, column = packet.block // across, packet.block % across
    for index in range(BLOCK_TILES):
        states[index] = decode_tile(packet.tiles, index)
    record_block(grid, row, column, states)
    return row, column


@compiled
def _sense_ground(
    grid: OccupancyGrid,
    seen: TickArray,
    known: TileArray,
    positions: IntArray,
    states: TileArray,
) -> None:
    """Update a UGV's occupancy grid from the reports of its own sensor.

    Args:
        grid: The occupancy grid; changed.
        seen: Tiles just reported, as row * columns + column.
        known: States of all tiles as reported by the sensor. Shape (rows, columns).
        positions, states: Work arrays. Shapes (2, room), (room,).
    """
    columns, count = known.shape[1], seen.size
    rows, across = positions[0, :count], positions[1, :count]
    for n in range(count):
        rows[n], across[n] = seen[n] // columns, seen[n] % columns
        states[n] = known[rows[n], across[n]]
    if count > 0:
        record_tiles(grid, rows, across, states[:count])


@inlined
def _radio(
    tables: LoopTables, state: LoopState, pilots: Pilots, ground: GroundState | None, world: int
) -> None:
    """Send the radio messages of the previous tick, and receive those that arrive."""
    batch, pilot_state = state.batch, pilots.state
    outbox, arrived = pilot_state.outbox, pilot_state.arrived[world]
    arrived[:] = 0
    tick, packets, traces = batch.ticks[world], batch.packets, tables.batch.traces
    receivers = pilots.tables.receivers
    # radio links follow the links of detections and commands
    first = receivers.shape[0] + tables.action_row.shape[0]
    for u in range(receivers.shape[0]):
        g = receivers[u]
        link, come = batch.links[world, first + u], pilot_state.inboxes[world, g]
        begin_tick(link, packets, world, traces, tick)
        for k in range(outbox.shape[2]):
            packet = outbox[world, u, k]
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
                grid = grid_of(pilot_state.grids, pilots.tables.late, world, g)
                across, states = pilot_state.map_updates.repeats.shape[3], pilot_state.states[world]
                block = _receive_block(grid, packet, across, states[:BLOCK_TILES])
                receive_block(ground, world, g, tick, block, states[:BLOCK_TILES])


@compiled
def _record_reports(memory: MapUpdateMemory, seen: TickArray, known: TileArray) -> None:
    """Record the tiles reported by a UAV's sensor, for its map updates; arguments as in `_sense_ground`."""
    columns = known.shape[1]
    for n in range(seen.size):
        row, column = seen[n] // columns, seen[n] % columns
        record_tile(memory, column, row, known[row, column])


@compiled
def _add_detections(packets: RecordArray, arrived: int, detections: FloatArray) -> None:
    """Copy the arrived packets: tick, p_delta [m]. Shape (room, 3)."""
    for n in range(arrived):
        packet = packets[n]
        detections[n, 0] = packet.stamp
        detections[n, 1], detections[n, 2] = packet.vector[0], packet.vector[1]


@inlined
def perceive(
    tables: LoopTables, state: LoopState, pilots: Pilots, ground: GroundState | None, world: int
) -> None:
    """Update the map and filters of each UAV and the inbox of each UGV from the messages of this tick."""
    batch, escorts, pilot_state = state.batch, tables.batch.escorts, pilots.state
    parameters, tick, detections = (
        pilots.tables.parameters,
        batch.ticks[world],
        pilot_state.detections[world],
    )
    elapsed = 1 if parameters.own_maps and tick > 0 else 0  # otherwise the world updates the map
    teams, team_tables = pilot_state.teams, pilots.tables.teams
    begin_teams(team_tables, teams, pilots.tables.uavs.team, tables.batch, batch, world)
    for u in range(escorts.shape[0]):
        arrived = batch.links[world, u].arrived
        _add_detections(batch.packets[world, u, ARRIVED], arrived, detections)
        collect_messages(team_tables, teams, batch, world, u)
        inputs = inputs_of(tables, state, pilots, world, u, elapsed)
        constants, memory = constants_of(pilots.tables, world, u), memory_of(pilots, world, u)
        perceive_uav(constants, memory, inputs, pilots.tables.filtered[u] != 0)
        if pilots.tables.estimating[u]:
            row = world, u
            update_estimate(
                constants.kalman[0],
                pilot_state.kalman,
                row,
                tick,
                inputs.own,
                detections,
                arrived,
                inputs.team,
            )
    if parameters.radio:
        _radio(tables, state, pilots, ground, world)
    if ground is not None:
        for u in range(escorts.shape[0] if parameters.map_update_ticks > 0 else 0):
            v = escorts[u, 0]
            updates = map_updates_of(pilot_state.map_updates, world, u)
            seen = ground.seen[world, v, : ground.report_counts[world, v]]
            _record_reports(updates, seen, ground.known[world, v])
        for g in range(ground.ugvs.shape[0]):
            v = ground.ugvs[g]
            _sense_ground(
                grid_of(pilot_state.grids, pilots.tables.late, world, g),
                ground.seen[world, v, : ground.report_counts[world, v]],
                ground.known[world, v],
                pilot_state.positions[world],
                pilot_state.states[world],
            )
