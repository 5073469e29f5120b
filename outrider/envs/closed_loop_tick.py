"""One tick of the closed loop, compiled: world, links, filters, laws, drivers and rewards in one pass.

The pilots' own functions are called, so a vehicle that is flown in here gets the commands that its pilot would
give over the bus. One pass a world, so that its grid stays near the core until the tick is done.
"""

from agents.control.certificate import CERTIFIED as NOTHING_AGAINST
from agents.control.certificate import INNER
from agents.control.guard import GuardState, guard
from agents.control.laws import OwnTerms
from agents.control.lookahead import LookaheadMemory, Target
from agents.control.telling import (
    BLOCK_TILES,
    block_words,
    next_block,
    note_tile,
    telling_of,
    word_state,
)
from agents.control.uav_tick import UavMemory, uav_perceive, uav_tick
from agents.control.underway import Underway, hand_over
from agents.drivers.navigate import PLAIN, hand_over_stops
from agents.drivers.parameters import Route
from agents.drivers.tile_map import GroundMemory, note_block, note_tiles
from agents.drivers.ugv_tick import ugv_tick
from agents.estimation.batch_filter import estimate
from agents.estimation.batch_filter import update as update_estimate
from outrider.envs.closed_loop_state import (
    GUARD_METRICS,
    LoopParameters,
    LoopState,
    LoopTables,
)
from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED, Packet
from sim.engine.certificate_counts import (
    CertificateClaim,
    count_tracking,
    note_action,
    note_arrival,
    note_end,
    note_report,
    note_sent,
)
from sim.engine.ground_state import GroundState
from sim.engine.mission import goals_of, note_claim, receive_block
from sim.engine.world_state import Vehicle
from sim.engine.world_tick import begin_world, measure, world_tick
from sim.env.rows import UAV_METRICS, advance_rows, observe_rows
from sim.kernels.compile import FloatArray, IntArray, compiled, inlined, released
from sim.models.field import coverage_gradient, sample
from sim.models.vehicles import Motion, norm

_RELATIVE, _GROUND = range(2)
"""Messages in `LoopState.outbox`."""


@inlined
def _guard_of(tables: LoopTables, state: GuardState, world: int, uav: int) -> GuardState:
    delay, underway = tables.promises[uav].delay_ticks, state.underway
    course = state.course[world, uav, : delay + 1]
    sent = Underway(
        underway.sent[world, uav, : delay + 2],
        underway.flown[world, uav],
        underway.expected[world, uav],
    )
    return GuardState(
        state.detections[world, uav],
        state.plan[world, uav],
        course,
        state.track[world, uav],
        state.flags[world, uav],
        sent,
    )


@inlined
def _ground_of(tables: LoopTables, state: LoopState, world: int, ugv: int) -> GroundMemory:
    grounds = state.grounds
    return GroundMemory(
        grounds.tiles[world, ugv],
        grounds.sure[world, ugv],
        grounds.draft[world, ugv],
        grounds.way[world, ugv],
        grounds.cost[world, ugv],
        grounds.heap[world, ugv],
        grounds.place[world, ugv],
        grounds.sent[world, ugv, : tables.late[ugv]],
        grounds.flown[world, ugv],
        grounds.flags[world, ugv],
    )


@inlined
def _memory_of(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int, uav: int
) -> UavMemory:
    coverage = state.maps[world, uav] if parameters.own_maps else state.batch.coverage[world]
    return UavMemory(
        coverage,
        state.law_states[world, uav],
        _guard_of(tables, state.guards, world, uav),
    )


@inlined
def _lookahead_of(lookaheads: LookaheadMemory, world: int, uav: int) -> LookaheadMemory:
    return LookaheadMemory(
        lookaheads.state[world, uav], lookaheads.velocities[world, uav], lookaheads.kept[world, uav]
    )


@compiled
def _reference_of(vehicle: Vehicle) -> Motion:
    place, velocity = vehicle.reference_position, vehicle.reference_velocity
    return Motion(place[0], place[1], velocity[0], velocity[1])


@inlined
def _fly(
    parameters: LoopParameters,
    tables: LoopTables,
    state: LoopState,
    lookaheads: LookaheadMemory | None,
    world: int,
    vehicle: int,
    uav: int,
    actions: FloatArray,
) -> None:
    """The command of a UAV, and what it radios."""
    tick, row = state.batch.ticks[world], state.rows.uavs[world, uav]
    one = state.batch.vehicles[world, vehicle]
    here = _reference_of(one)
    guarded = tables.guarded[uav] != 0
    target = estimate(state.kalman, world, uav)
    flown = state.batch.flown[world, vehicle, 0].begins
    acts, code, bound = INNER, NOTHING_AGAINST, 0.0
    if tables.hand[vehicle] < 0:
        own = OwnTerms(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        law, promise = state.laws[world, uav], tables.promises[uav]
        memory = _memory_of(parameters, tables, state, world, uav)
        if lookaheads is None:
            u_x, u_y, acts, code, bound = uav_tick(
                law, promise, guarded, memory, None, own, tick, here, target, flown
            )
        else:
            ahead = _lookahead_of(lookaheads, world, uav)
            u_x, u_y, acts, code, bound = uav_tick(
                law, promise, guarded, memory, ahead, own, tick, here, target, flown
            )
    else:
        u_x, u_y = actions[tables.hand[vehicle], 0], actions[tables.hand[vehicle], 1]
        if guarded:
            held = _guard_of(tables, state.guards, world, uav)
            u_x, u_y, acts, code, bound = guard(
                tables.promises[uav], held, tick, here, u_x, u_y, flown
            )
    if guarded:
        row[GUARD_METRICS.bound] = bound
        row[GUARD_METRICS.acted] = 1.0 if acts != INNER else 0.0
        sure = code == NOTHING_AGAINST and tables.faults[uav] == 0
        row[GUARD_METRICS.sure] = 1.0 if sure else 0.0
        # a pilot that has seen nothing reports nothing
        reports = target.known or tables.hand[vehicle] >= 0
        said = CertificateClaim(sure, reports and acts != INNER, row[UAV_METRICS.lost] != 0.0, True)
        note_report(tables.bounds[uav], state.certificates[world, uav], tick, said)
    one.outgoing_tick, one.outgoing[0], one.outgoing[1] = tick, u_x, u_y
    one.outgoing_motion, one.outgoing_motions = -1, 0
    if guarded and tables.promises[uav].carries:
        one.outgoing_motion, one.outgoing_motions = hand_over(
            tables.promises[uav],
            _guard_of(tables, state.guards, world, uav).underway,
            tick,
            state.batch.motions[world, vehicle],
        )
    if parameters.radio:
        _speak(parameters, state, world, uav, tick, here, target)


@inlined
def _speak(
    parameters: LoopParameters,
    state: LoopState,
    world: int,
    uav: int,
    tick: int,
    here: Motion,
    target: Target,
) -> None:
    """Radio messages of a UAV at this tick."""
    known, g_x, g_y = target.known, target.p_x, target.p_y
    relative, ground = state.outbox[world, uav, _RELATIVE], state.outbox[world, uav, _GROUND]
    relative.stamp = tick if known and tick % parameters.radio_ticks == 0 else -1.0
    relative.block = -1
    relative.vector[0], relative.vector[1] = here.p_x - g_x, here.p_y - g_y
    ground.stamp = -1.0
    if parameters.telling_ticks > 0 and known and tick % parameters.telling_ticks == 0:
        memory = telling_of(state.telling, world, uav)
        row, column = next_block(memory, parameters.tile, tick, g_x, g_y)
        if row >= 0:
            ground.stamp = tick
            ground.block = row * memory.news.shape[1] + column
            block_words(memory.tiles, row, column, ground.tiles)


@inlined
def _drive(
    tables: LoopTables,
    state: LoopState,
    ground: GroundState | None,
    world: int,
    vehicle: int,
    ugv: int,
    actions: FloatArray,
) -> None:
    """The command of a UGV."""
    tick, one = state.batch.ticks[world], state.batch.vehicles[world, vehicle]
    one.outgoing_tick, one.outgoing_motion, one.outgoing_motions = tick, -1, 0
    if tables.hand[vehicle] >= 0:
        one.outgoing[0] = actions[tables.hand[vehicle], 0]
        one.outgoing[1] = actions[tables.hand[vehicle], 1]
        return
    script = tables.scripts[tables.script_rows[ugv] : tables.script_rows[ugv + 1]]
    route = Route(goals_of(tables.batch.goals, tables.batch.goal_rows, ugv), script)
    driver, own, radio = (
        state.drivers[world, ugv],
        state.driver_states[world, ugv],
        state.inboxes[world, ugv],
    )
    arrived, here = state.arrived[world, ugv], _reference_of(one)
    if ground is None:
        one.outgoing[0], one.outgoing[1] = ugv_tick(
            driver, route, own, None, radio, arrived, tick, here, PLAIN
        )
    else:
        memory = _ground_of(tables, state, world, ugv)
        flown = state.batch.flown[world, vehicle, 0].begins if one.follows_motions else PLAIN
        one.outgoing[0], one.outgoing[1] = ugv_tick(
            driver, route, own, memory, radio, arrived, tick, here, flown
        )
        note_claim(ground.missions[world], ugv, memory.flags[0].claim)
        if one.follows_motions:
            motions = state.batch.motions[world, vehicle]
            one.outgoing_motion, one.outgoing_motions = hand_over_stops(memory, tick, motions)


@inlined
def _receive_block(
    tables: LoopTables, state: LoopState, ground: GroundState, world: int, ugv: int, packet: Packet
) -> None:
    """A UGV is told of a block of tiles by radio."""
    block, across = packet.block, state.telling.news.shape[3]
    row, column, states = block // across, block % across, state.states[world, :BLOCK_TILES]
    for place in range(BLOCK_TILES):
        states[place] = word_state(packet.tiles, place)
    note_block(_ground_of(tables, state, world, ugv), row, column, states)
    receive_block(ground, world, ugv, state.batch.ticks[world], (row, column), states)


@inlined
def _feel_ground(
    tables: LoopTables, state: LoopState, ground: GroundState, world: int, ugv: int
) -> None:
    """A UGV takes in the tiles that its bumper tells of."""
    v = ground.ugvs[ugv]
    columns, count = ground.tiles.shape[2], ground.told[world, v]
    rows = state.places[world, 0, :count]
    across = state.places[world, 1, :count]
    states = state.states[world, :count]
    for n in range(count):
        rows[n], across[n] = ground.seen[world, v, n] // columns, ground.seen[world, v, n] % columns
        states[n] = ground.known[world, v, rows[n], across[n]]
    if count > 0:
        note_tiles(_ground_of(tables, state, world, ugv), rows, across, states)


@inlined
def _radio(tables: LoopTables, state: LoopState, ground: GroundState | None, world: int) -> None:
    """Send out the radio messages of the tick before, and receive those that arrive."""
    tick, arrived = state.batch.ticks[world], state.arrived[world]
    arrived[:] = 0
    packets, traces = state.batch.packets, tables.batch.traces
    for u in range(tables.receivers.shape[0]):
        g, come = tables.receivers[u], state.inboxes[world, tables.receivers[u]]
        # behind the links of detections and commands
        link = state.batch.links[world, tables.receivers.shape[0] + tables.hand.shape[0] + u]
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
def _see_ground(
    parameters: LoopParameters, state: LoopState, ground: GroundState, world: int, uav: int, v: int
) -> None:
    """Keep the tiles that a UAV's sensor has reported, to radio them."""
    if parameters.telling_ticks > 0:
        columns = ground.tiles.shape[2]
        for n in range(ground.told[world, v]):
            row, column = ground.seen[world, v, n] // columns, ground.seen[world, v, n] % columns
            found = ground.known[world, v, row, column]
            note_tile(telling_of(state.telling, world, uav), column, row, found)


@inlined
def _perceive(
    parameters: LoopParameters,
    tables: LoopTables,
    state: LoopState,
    ground: GroundState | None,
    world: int,
) -> None:
    """Every UAV takes what has reached it at this tick into its map and its filters, every UGV its radio."""
    escorts, tick = tables.batch.escorts, state.batch.ticks[world]
    looks = state.looks[world]
    looked = 1 if parameters.own_maps and tick > 0 else 0  # else the world has done it
    for u in range(escorts.shape[0]):
        here = _reference_of(state.batch.vehicles[world, escorts[u, 0]])
        if ground is not None:
            _see_ground(parameters, state, ground, world, u, escorts[u, 0])
        arrived = state.batch.links[world, u].arrived
        for n in range(arrived):
            packet = state.batch.packets[world, u, ARRIVED, n]
            looks[n, 0], looks[n, 1], looks[n, 2] = packet.stamp, packet.vector[0], packet.vector[1]
        if looked > 0 or tables.guarded[u]:
            uav_perceive(
                state.laws[world, u],
                tables.promises[u],
                tables.guarded[u] != 0,
                _memory_of(parameters, tables, state, world, u),
                looked,
                tick,
                here,
                looks,
                arrived,
            )
        if tables.thinking[u]:
            numbers, place = tables.kalman[u], (world, u)
            update_estimate(numbers, state.kalman, place, tick, here, looks, arrived)
    if parameters.radio:
        _radio(tables, state, ground, world)
    if ground is not None and state.grounds.tiles.shape[2] > 0:
        for g in range(ground.ugvs.shape[0]):
            _feel_ground(tables, state, ground, world, g)


@inlined
def _add_cues(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int, uav: int
) -> None:
    """Put the estimate and the gradient into the row of a UAV, where they are asked for and known."""
    world_parameters, row = tables.batch.world[0], state.rows.uav_rows[world, uav]
    row.gradient_x, row.gradient_y = 0.0, 0.0
    target = estimate(state.kalman, world, uav)
    if not target.known:
        return
    g_x, g_y = target.p_x, target.p_y
    x, y = row.x, row.y
    if parameters.estimate:
        row.detected, row.relative_x, row.relative_y = 1.0, x - g_x, y - g_y
        row.age = state.kalman[world, uav, 0].age * world_parameters.dt
    if parameters.gradient:
        u_x, u_y, size = coverage_gradient(
            state.maps[world, uav] if parameters.own_maps else state.batch.coverage[world],
            x,
            y,
            g_x,
            g_y,
            world_parameters.r_o,
            world_parameters.desired,
            world_parameters.sensor,
            world_parameters.peak,
            world_parameters.reach,
            world_parameters.cell,
        )
        if size > 0.0:
            row.gradient_x, row.gradient_y = u_x / size, u_y / size


@inlined
def _observe(parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int) -> None:
    """Everybody's row, and the UAVs' pictures."""
    world_parameters = tables.batch.world[0]
    escorts = tables.batch.escorts
    observe_rows(tables.batch, state.batch, tables.rows, state.rows, world)
    if parameters.estimate or parameters.gradient:
        for u in range(escorts.shape[0]):
            _add_cues(parameters, tables, state, world, u)
    for u in range(state.patches.shape[1]):
        place = state.batch.vehicles[world, escorts[u, 0]].reference_position
        x, y = place[0], place[1]
        sample(
            state.maps[world, u] if parameters.own_maps else state.batch.coverage[world],
            x,
            y,
            world_parameters.desired,
            world_parameters.cell,
            parameters.meters_per_pixel,
            state.patches[world, u],
        )


@inlined
def _note_action(tables: LoopTables, state: LoopState, world: int, uav: int, tick: int) -> None:
    """Count the action of a UAV in this tick, which has just been flown."""
    v, bounds = tables.batch.escorts[uav, 0], tables.bounds[uav]
    sent, one = state.sent[world, uav], state.batch.vehicles[world, v]
    note_sent(sent, tick, one.outgoing[0], one.outgoing[1])
    begins, acts = state.batch.flown[world, v, 0].begins, one.command
    note_action(bounds, state.certificates[world, uav], sent, tick, acts[0], acts[1], begins)


@inlined
def _note_evidence(tables: LoopTables, state: LoopState, world: int, uav: int) -> None:
    """Count how wrong the detections are that have reached a UAV at this tick, and how far it is off its reference."""
    bounds, counts, batch = tables.bounds[uav], state.certificates[world, uav], state.batch
    for n in range(batch.links[world, uav].arrived):
        packet = batch.packets[world, uav, ARRIVED, n]
        note_arrival(bounds, counts, int(packet.stamp), packet.error)
    if tables.batch.disturbances.shape[0] > 0:
        v = tables.batch.escorts[uav, 0]
        true = batch.vehicles[world, v].position
        reference = batch.vehicles[world, v].reference_position
        off = norm(true[0] - reference[0], true[1] - reference[1])
        count_tracking(tables.bounds, state.certificates[world], uav, off)


@released
def run_worlds(
    parameters: LoopParameters,
    tables: LoopTables,
    state: LoopState,
    ground: GroundState | None,
    lookaheads: LookaheadMemory | None,
    worlds: IntArray,
    actions: FloatArray,
    ticks: int,
    begin: int,
    end: int,
) -> None:
    """Fly each of these worlds for a number of ticks or to the end of its episode; 0 ticks: begin it.

    World by world, so that a grid stays near its core for a whole flight.
    """
    batch, beginning = state.batch, ticks == 0
    for n in range(begin, end):
        k = worlds[n]
        if beginning:
            begin_world(tables.batch, batch, ground, k)
        for tick in range(1 if beginning else ticks):
            if tick > 0 and (state.rows.terminated[k] or state.rows.truncated[k]):
                break
            if not beginning:
                for v in range(tables.rows.place.shape[0]):
                    if tables.rows.place[v] >= 0:
                        uav = tables.rows.place[v]
                        _fly(parameters, tables, state, lookaheads, k, v, uav, actions[k])
                    else:
                        _drive(tables, state, ground, k, v, -1 - tables.rows.place[v], actions[k])
                begun = batch.ticks[k]
                world_tick(tables.batch, batch, ground, k, True)
                for u in range(tables.batch.escorts.shape[0]):
                    if tables.guarded[u]:
                        _note_action(tables, state, k, u, begun)
            _perceive(parameters, tables, state, ground, k)
            measure(
                tables.batch.world,
                batch.vehicles,
                tables.batch.escorts,
                batch.coverage,
                k,
                parameters.error,
            )
            advance_rows(tables.batch, batch, ground, tables.rows, state.rows, k, beginning)
            over = state.rows.terminated[k] or state.rows.truncated[k]
            for u in range(tables.batch.escorts.shape[0]):
                if over:
                    lost = state.rows.uavs[k, u, UAV_METRICS.lost] != 0.0
                    note_end(state.certificates[k, u], lost)
                elif tables.guarded[u]:
                    _note_evidence(tables, state, k, u)
            if tick == ticks - 1 or over or beginning:
                _observe(parameters, tables, state, k)
