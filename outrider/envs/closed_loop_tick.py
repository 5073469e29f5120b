"""One tick of the closed loop, compiled: world, links, filters, laws, drivers and rewards in one pass.

The pilots' own functions are called, so a vehicle that is flown in here gets the commands that its pilot would
give over the bus. One pass a world, so that its grid stays near the core until the tick is done.
"""

from agents.drivers.dispatch import driver_command
from agents.drivers.parameters import DriverInputs
from agents.drivers.pending_stops import PLAIN, hand_over_stops
from agents.drivers.tile_map import GroundMemory, note_block, note_tiles
from agents.estimation.batch_filter import estimate
from agents.estimation.batch_filter import update as update_estimate
from agents.estimation.map_updates import (
    BLOCK_TILES,
    block_words,
    next_block,
    note_tile,
    telling_of,
    word_state,
)
from agents.estimation.perception import uav_perceive
from agents.laws.dispatch import nominal_command
from agents.safety.decision import CERTIFIED, NOMINAL, decide
from agents.safety.memory import FilterMemory
from agents.safety.pending import PendingCommands, hand_over
from agents.uav_parameters import Target
from outrider.envs.closed_loop_state import (
    LoopParameters,
    LoopState,
    LoopTables,
)
from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED, Packet
from sim.compiling.compile import FloatArray, IntArray, compiled, inlined, released
from sim.compiling.records import RecordArray
from sim.engine.ground_state import GroundState
from sim.engine.mission import goals_of, note_claim, receive_block
from sim.engine.monitor import (
    NEVER,
    Claim,
    record_arrival,
    record_decision,
    record_end,
    record_interval,
    record_tracking_error,
)
from sim.engine.world_state import Vehicle
from sim.engine.world_tick import begin_world, measure, world_tick
from sim.env.rows import UAV_METRICS, advance_rows, observe_rows
from sim.models.field import coverage_gradient, sample
from sim.models.vehicles import Motion, norm

_RELATIVE, _GROUND = range(2)
"""Messages in `LoopState.outbox`."""


@inlined
def _filter_of(tables: LoopTables, filters: FilterMemory, world: int, uav: int) -> FilterMemory:
    delay, pending = tables.safety[uav].delay_ticks, filters.pending
    return FilterMemory(
        filters.discs[world, uav],
        filters.plan[world, uav],
        filters.track[world, uav],
        filters.flags[world, uav],
        PendingCommands(
            pending.sent[world, uav, : delay + 2],
            pending.flown[world, uav],
            pending.expected[world, uav],
        ),
        filters.decision[world, uav],
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
def _coverage_of(parameters: LoopParameters, state: LoopState, world: int, uav: int) -> FloatArray:
    coverage: FloatArray = (
        state.maps[world, uav] if parameters.own_maps else state.batch.coverage[world]
    )
    return coverage


@compiled
def _reference_of(vehicle: Vehicle) -> Motion:
    place, velocity = vehicle.reference_position, vehicle.reference_velocity
    return Motion(place[0], place[1], velocity[0], velocity[1])


@inlined
def _fly(
    parameters: LoopParameters,
    tables: LoopTables,
    state: LoopState,
    world: int,
    vehicle: int,
    uav: int,
    actions: FloatArray,
) -> None:
    """The command of a UAV, and what it radios."""
    tick, row = state.batch.ticks[world], state.rows.uavs[world, uav]
    one = state.batch.vehicles[world, vehicle]
    here = _reference_of(one)
    filtered = tables.filtered[uav] != 0
    target = estimate(state.kalman, world, uav)
    flown = state.batch.flown[world, vehicle, 0].begins
    if tables.hand[vehicle] < 0:
        coverage = _coverage_of(parameters, state, world, uav)
        u_x, u_y = nominal_command(
            tables.laws, state.laws, (world, uav), coverage, tick, here, target
        )
    else:
        u_x, u_y = actions[tables.hand[vehicle], 0], actions[tables.hand[vehicle], 1]
    if filtered:
        memory = _filter_of(tables, state.filters, world, uav)
        decide(tables.safety[uav], memory, tick, here, u_x, u_y, flown)
        decision = memory.decision[0]
        u_x, u_y = decision.acceleration[0], decision.acceleration[1]
        certified, overridden = decision.reason == CERTIFIED, decision.source != NOMINAL
        # a pilot that has seen nothing reports nothing
        reports = target.known or tables.hand[vehicle] >= 0
        said = Claim(certified, reports and overridden, row[UAV_METRICS.lost] != 0.0, True)
        record_decision(tables.monitored[uav], state.certificates[world, uav], tick, said)
    one.outgoing_tick, one.outgoing[0], one.outgoing[1] = tick, u_x, u_y
    if filtered:
        one.outgoing_motion, one.outgoing_motions = hand_over(
            tables.safety[uav],
            _filter_of(tables, state.filters, world, uav).pending,
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
    one.outgoing_tick = tick
    if tables.hand[vehicle] >= 0:
        one.outgoing[0] = actions[tables.hand[vehicle], 0]
        one.outgoing[1] = actions[tables.hand[vehicle], 1]
        return
    script = tables.scripts[tables.script_rows[ugv] : tables.script_rows[ugv + 1]]
    goals = goals_of(tables.batch.goals, tables.batch.goal_rows, ugv)
    radio, arrived = state.inboxes[world, ugv], state.arrived[world, ugv]
    place, here = (world, ugv), _reference_of(one)
    if ground is None:
        inputs = DriverInputs(goals, script, radio, arrived, None, PLAIN)
        one.outgoing[0], one.outgoing[1] = driver_command(
            tables.drivers, state.drivers, place, inputs, tick, here
        )
    else:
        memory = _ground_of(tables, state, world, ugv)
        flown = state.batch.flown[world, vehicle, 0].begins if one.follows_motions else PLAIN
        inputs = DriverInputs(goals, script, radio, arrived, memory, flown)
        one.outgoing[0], one.outgoing[1] = driver_command(
            tables.drivers, state.drivers, place, inputs, tick, here
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
        if looked > 0 or tables.filtered[u]:
            uav_perceive(
                tables.laws.uavs[u],
                tables.safety[u],
                tables.filtered[u] != 0,
                _coverage_of(parameters, state, world, u),
                _filter_of(tables, state.filters, world, u),
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
def _add_pictures(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int
) -> None:
    """Put the UAVs' estimates and gradients into their rows, and make their pictures."""
    world_parameters = tables.batch.world[0]
    escorts = tables.batch.escorts
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
    v, bounds = tables.batch.escorts[uav, 0], tables.monitored[uav]
    flown = state.batch.flown[world, v, 0]
    bare = state.batch.vehicles[world, v].command_tick if flown.plain == 1 else NEVER
    record_interval(bounds, state.certificates[world, uav], tick, flown.begins, bare)


@inlined
def _note_evidence(tables: LoopTables, state: LoopState, world: int, uav: int) -> None:
    """Count how wrong the detections are that have reached a UAV at this tick, and how far it is off its reference."""
    bounds, counts, batch = tables.monitored[uav], state.certificates[world, uav], state.batch
    for n in range(batch.links[world, uav].arrived):
        packet = batch.packets[world, uav, ARRIVED, n]
        record_arrival(bounds, counts, int(packet.stamp), packet.error)
    if tables.batch.disturbances.shape[0] > 0:
        v = tables.batch.escorts[uav, 0]
        true = batch.vehicles[world, v].position
        reference = batch.vehicles[world, v].reference_position
        off = norm(true[0] - reference[0], true[1] - reference[1])
        record_tracking_error(tables.monitored, state.certificates[world], uav, off)


@compiled
def _obey(
    vehicles: RecordArray, hand: IntArray, world: int, tick: int, actions: FloatArray
) -> None:
    """The commands of all vehicles, from outside; the backup plans that they carry are there already."""
    for v in range(hand.shape[0]):
        one = vehicles[world, v]
        one.outgoing_tick = tick
        one.outgoing[0], one.outgoing[1] = actions[hand[v], 0], actions[hand[v], 1]


@inlined
def _command(
    parameters: LoopParameters,
    tables: LoopTables,
    state: LoopState,
    ground: GroundState | None,
    world: int,
    actions: FloatArray,
) -> None:
    """The commands of all vehicles, of their pilots or from outside."""
    for v in range(tables.rows.place.shape[0]):
        place = tables.rows.place[v]
        if place >= 0:
            _fly(parameters, tables, state, world, v, place, actions)
        else:
            _drive(tables, state, ground, world, v, -1 - place, actions)


@inlined
def _note_actions(tables: LoopTables, state: LoopState, world: int, tick: int) -> None:
    """Count the actions of the UAVs that a safety filter watches over."""
    for u in range(tables.batch.escorts.shape[0]):
        if tables.filtered[u]:
            _note_action(tables, state, world, u, tick)


@inlined
def _note_tick(tables: LoopTables, state: LoopState, world: int, over: bool) -> None:
    """Count what the UAVs' certificates have come to at this tick."""
    for u in range(tables.batch.escorts.shape[0]):
        if over:
            lost = state.rows.uavs[world, u, UAV_METRICS.lost] != 0.0
            record_end(state.certificates[world, u], lost)
        elif tables.filtered[u]:
            _note_evidence(tables, state, world, u)


@released
def run_worlds(
    parameters: LoopParameters | None,
    tables: LoopTables,
    state: LoopState,
    ground: GroundState | None,
    worlds: IntArray,
    actions: FloatArray,
    ticks: int,
    begin: int,
    end: int,
) -> None:
    """Fly each of these worlds for a number of ticks or to the end of its episode; 0 ticks: begin it.

    World by world, so that a grid stays near its core for a whole flight. Without parameters every action comes from
    outside, tables and state are `CommandedTables` and `CommandedState`, and nothing of pilots, estimates and pictures
    is compiled.
    """
    batch, beginning = state.batch, ticks == 0
    for n in range(begin, end):
        k = worlds[n]
        if beginning:
            begin_world(tables.batch, batch, ground, k)
        for tick in range(1 if beginning else ticks):
            if tick > 0 and (state.rows.terminated[k] or state.rows.truncated[k]):
                break
            begun = batch.ticks[k]
            if not beginning:
                if parameters is None:
                    _obey(batch.vehicles, tables.hand, k, begun, actions[k])
                else:
                    _command(parameters, tables, state, ground, k, actions[k])
                world_tick(tables.batch, batch, ground, k, True)
            if parameters is not None:
                if not beginning:
                    _note_actions(tables, state, k, begun)
                _perceive(parameters, tables, state, ground, k)
            error = tables.rows.episode[0].error
            escorts = tables.batch.escorts
            measure(tables.batch.world, batch.vehicles, escorts, batch.coverage, k, error)
            advance_rows(tables.batch, batch, ground, tables.rows, state.rows, k, beginning)
            over = state.rows.terminated[k] or state.rows.truncated[k]
            if parameters is not None:
                _note_tick(tables, state, k, over)
            if tick == ticks - 1 or over or beginning:
                observe_rows(tables.batch, batch, tables.rows, state.rows, k)
                if parameters is not None:
                    _add_pictures(parameters, tables, state, k)
