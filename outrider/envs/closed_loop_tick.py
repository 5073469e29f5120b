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
from agents.drivers.ugv_tick import UgvMemory, ugv_tick
from agents.estimation.batch_filter import estimate
from agents.estimation.batch_filter import update as update_estimate
from outrider.envs.closed_loop_state import (
    GRADIENT_X,
    GRADIENT_Y,
    GUARD_METRICS,
    LoopParameters,
    LoopState,
    LoopTables,
)
from sim.channel.link import advance as begin_tick
from sim.channel.link import receive, send
from sim.engine.certificate_counts import (
    CertificateClaim,
    count_tracking,
    note_action,
    note_arrival,
    note_end,
    note_report,
    note_sent,
)
from sim.engine.link_arrays import link_of
from sim.engine.mission import goals_of, note_claim, receive_block
from sim.engine.world_state import (
    COMMAND,
    LOOK,
    TRUE_ERROR,
    Told,
)
from sim.engine.world_tick import begin_world, measure, truth_of, world_tick
from sim.env.rows import UAV, UAV_METRICS, advance_rows, observe_rows
from sim.kernels.compile import FloatArray, IntArray, inlined, released
from sim.kernels.prefetch import fetch_disc, fetch_rows
from sim.models.field import coverage_gradient, sample
from sim.models.randomness import key_of
from sim.models.vehicles import Motion, norm

_SAID, _BLOCK, _SENT = range(3)
"""Columns of a message by radio: the tick, the block of tiles (-1: of none), and where its content begins."""
_RELATIVE, _GROUND = range(2)
"""Rows of `LoopState.outbox`."""


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
    coverage = state.maps[world, uav] if parameters.own_maps else state.batch.truth.coverage[world]
    ahead = state.lookaheads
    lookahead = LookaheadMemory(
        ahead.state[world, uav], ahead.velocities[world, uav], ahead.kept[world, uav]
    )
    return UavMemory(
        coverage,
        state.law_states[world, uav],
        lookahead,
        _guard_of(tables, state.guards, world, uav),
    )


@inlined
def _motion_of(told: Told, world: int, vehicle: int) -> Motion:
    return Motion(
        told.position[world, vehicle, 0],
        told.position[world, vehicle, 1],
        told.velocity[world, vehicle, 0],
        told.velocity[world, vehicle, 1],
    )


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
    here = _motion_of(state.batch.told, world, vehicle)
    law = state.laws[world, uav]
    guarded = tables.guarded[uav] != 0
    memory = _memory_of(parameters, tables, state, world, uav)
    target = estimate(state.kalman, world, uav)
    flown = state.batch.flown[world, vehicle, 0].begins
    if tables.hand[vehicle] < 0:
        own = OwnTerms(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        u_x, u_y, acts, code, bound = uav_tick(
            law, tables.promises[uav], guarded, memory, own, tick, here, target, flown
        )
    else:
        u_x, u_y = actions[tables.hand[vehicle], 0], actions[tables.hand[vehicle], 1]
        acts, code, bound = INNER, NOTHING_AGAINST, 0.0
        if guarded:
            u_x, u_y, acts, code, bound = guard(
                tables.promises[uav], memory.guard, tick, here, u_x, u_y, flown
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
    sent = state.batch.sent[world, vehicle]
    sent[COMMAND.answered], sent[COMMAND.u_x], sent[COMMAND.u_y] = tick, u_x, u_y
    sent[COMMAND.last], sent[COMMAND.carried] = -1.0, 0.0
    if guarded and tables.promises[uav].carries:
        sent[COMMAND.last], sent[COMMAND.carried] = hand_over(
            tables.promises[uav], memory.guard.underway, tick, state.batch.motions[world, vehicle]
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
    known, g_x, g_y, out = target.known, target.p_x, target.p_y, state.outbox[world, uav]
    out[_RELATIVE, _SAID] = tick if known and tick % parameters.radio_ticks == 0 else -1.0
    out[_RELATIVE, _BLOCK] = -1.0
    out[_RELATIVE, _SENT], out[_RELATIVE, _SENT + 1] = here.p_x - g_x, here.p_y - g_y
    out[_GROUND, _SAID] = -1.0
    if parameters.telling_ticks > 0 and known and tick % parameters.telling_ticks == 0:
        memory = telling_of(state.telling, world, uav)
        row, column = next_block(memory, parameters.tile, tick, g_x, g_y)
        if row >= 0:
            out[_GROUND, _SAID] = tick
            out[_GROUND, _BLOCK] = row * memory.news.shape[1] + column
            block_words(memory.tiles, row, column, out[_GROUND, _SENT:])


@inlined
def _drive(
    tables: LoopTables, state: LoopState, world: int, vehicle: int, ugv: int, actions: FloatArray
) -> None:
    """The command of a UGV."""
    tick, sent = state.batch.ticks[world], state.batch.sent[world, vehicle]
    sent[COMMAND.answered] = tick
    sent[COMMAND.last], sent[COMMAND.carried] = -1.0, 0.0
    if tables.hand[vehicle] >= 0:
        sent[COMMAND.u_x] = actions[tables.hand[vehicle], 0]
        sent[COMMAND.u_y] = actions[tables.hand[vehicle], 1]
        return
    script = tables.scripts[tables.script_rows[ugv] : tables.script_rows[ugv + 1]]
    route = Route(goals_of(tables.batch.mission, ugv), script)
    carries = tables.batch.receivers[vehicle] == 1
    ground = _ground_of(tables, state, world, ugv)
    sent[COMMAND.u_x], sent[COMMAND.u_y] = ugv_tick(
        state.drivers[world, ugv],
        route,
        UgvMemory(state.driver_states[world, ugv], ground),
        state.inboxes[world, ugv],
        state.arrived[world, ugv],
        tick,
        _motion_of(state.batch.told, world, vehicle),
        state.batch.flown[world, vehicle, 0].begins if carries else PLAIN,
    )
    if ground.tiles.size > 0:
        note_claim(state.batch.mission.ugvs[world], ugv, ground.flags[0].claim)
    if carries:
        motions = state.batch.motions[world, vehicle]
        sent[COMMAND.last], sent[COMMAND.carried] = hand_over_stops(ground, tick, motions)


@inlined
def _receive_block(
    tables: LoopTables, state: LoopState, world: int, ugv: int, message: FloatArray
) -> None:
    """A UGV is told of a block of tiles by radio."""
    block, across, words = int(message[_BLOCK]), state.telling.news.shape[3], message[_SENT:]
    row, column, states = block // across, block % across, state.states[world, :BLOCK_TILES]
    for place in range(BLOCK_TILES):
        states[place] = word_state(words, place)
    note_block(_ground_of(tables, state, world, ugv), row, column, states)
    batch, tick = state.batch, state.batch.ticks[world]
    receive_block(
        tables.batch.ground, batch.ground, batch.mission, world, ugv, tick, (row, column), states
    )


@inlined
def _feel_ground(tables: LoopTables, state: LoopState, world: int, ugv: int) -> None:
    """A UGV takes in the tiles that its bumper tells of."""
    v, ground = tables.batch.ground.ugvs[ugv], state.batch.ground
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
def _radio(tables: LoopTables, state: LoopState, world: int) -> None:
    """Send out the radio messages of the tick before, and receive those that arrive."""
    tick, arrived = state.batch.ticks[world], state.arrived[world]
    arrived[:] = 0
    for u in range(tables.receivers.shape[0]):
        g, outbox, inbox = tables.receivers[u], state.outbox[world, u], state.inbox[world]
        come, link = state.inboxes[world, g], link_of(state.radio, world, u)
        key = key_of(state.batch.keys[world], tables.radio.owners[u, 0], tables.radio.owners[u, 1])
        begin_tick(tables.radio, u, link, key, tick)
        for row in range(outbox.shape[0]):
            if outbox[row, _SAID] >= 0.0:
                send(tables.radio, u, link, key, outbox[row])
                outbox[row, _SAID] = -1.0
        for i in range(receive(link, inbox)):
            if inbox[i, _BLOCK] >= 0.0:
                _receive_block(tables, state, world, g, inbox[i])
                continue
            n = arrived[g]
            come[n, 0], come[n, 1], come[n, 2] = inbox[i, 0], inbox[i, 2], inbox[i, 3]
            arrived[g] = n + 1


@inlined
def _perceive(parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int) -> None:
    """Every UAV takes what has reached it at this tick into its map and its filters, every UGV its radio."""
    escorts, tick = tables.batch.escorts, state.batch.ticks[world]
    looks, arrived = state.batch.received[world], state.batch.arrived[world]
    looked = 1 if parameters.own_maps and tick > 0 else 0  # else the world has done it
    for u in range(escorts.shape[0]):
        here = _motion_of(state.batch.told, world, escorts[u, 0])
        if parameters.telling_ticks > 0:
            v, ground = escorts[u, 0], state.batch.ground
            columns = ground.tiles.shape[2]
            for n in range(ground.told[world, v]):
                row = ground.seen[world, v, n] // columns
                column = ground.seen[world, v, n] % columns
                found = ground.known[world, v, row, column]
                note_tile(telling_of(state.telling, world, u), column, row, found)
        uav_perceive(
            state.laws[world, u],
            tables.promises[u],
            tables.guarded[u] != 0,
            _memory_of(parameters, tables, state, world, u),
            looked,
            tick,
            here,
            looks[u],
            arrived[u],
        )
        if tables.thinking[u]:
            numbers, place = tables.kalman[u], (world, u)
            update_estimate(numbers, state.kalman, place, tick, here, looks[u], arrived[u])
    if parameters.radio:
        _radio(tables, state, world)
    if state.grounds.tiles.shape[2] > 0:
        for g in range(tables.batch.ground.ugvs.shape[0]):
            _feel_ground(tables, state, world, g)


@inlined
def _add_cues(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int, uav: int
) -> None:
    """Put the estimate and the gradient into the row of a UAV, where they are asked for and known."""
    world_parameters, row = tables.batch.world[0], state.rows.uav_rows[world, uav]
    row[GRADIENT_X], row[GRADIENT_Y] = 0.0, 0.0
    target = estimate(state.kalman, world, uav)
    if not target.known:
        return
    g_x, g_y = target.p_x, target.p_y
    x, y = row[UAV.x], row[UAV.y]
    if parameters.estimate:
        row[UAV.detected], row[UAV.relative_x], row[UAV.relative_y] = 1.0, x - g_x, y - g_y
        row[UAV.age] = state.kalman[world, uav, 0].age * world_parameters.dt
    if parameters.gradient:
        u_x, u_y, size = coverage_gradient(
            state.maps[world, uav] if parameters.own_maps else state.batch.truth.coverage[world],
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
            row[GRADIENT_X], row[GRADIENT_Y] = u_x / size, u_y / size


@inlined
def _observe(parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int) -> None:
    """Everybody's row, and the UAVs' pictures."""
    world_parameters = tables.batch.world[0]
    position = state.batch.told.position[world]
    escorts = tables.batch.escorts
    observe_rows(tables.batch, state.batch, tables.rows, state.rows, world)
    if parameters.estimate or parameters.gradient:
        for u in range(escorts.shape[0]):
            _add_cues(parameters, tables, state, world, u)
    for u in range(state.patches.shape[1]):
        x, y = position[escorts[u, 0], 0], position[escorts[u, 0], 1]
        sample(
            state.maps[world, u] if parameters.own_maps else state.batch.truth.coverage[world],
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
    sent, command, acts = (
        state.sent[world, uav],
        state.batch.sent[world, v],
        state.batch.truth.commands[world, v],
    )
    note_sent(sent, tick, command[COMMAND.u_x], command[COMMAND.u_y])
    begins = state.batch.flown[world, v, 0].begins
    note_action(bounds, state.certificates[world, uav], sent, tick, acts[0], acts[1], begins)


@inlined
def _note_evidence(tables: LoopTables, state: LoopState, world: int, uav: int) -> None:
    """Count how wrong the detections are that have reached a UAV at this tick, and how far it is off its reference."""
    bounds, counts, batch = tables.bounds[uav], state.certificates[world, uav], state.batch
    for n in range(batch.arrived[world, uav]):
        look = batch.received[world, uav, n]
        note_arrival(bounds, counts, int(look[LOOK.taken]), look[TRUE_ERROR])
    if tables.batch.disturbances.shape[0] > 0:
        v = tables.batch.escorts[uav, 0]
        true, reference = batch.truth.position[world, v], batch.told.position[world, v]
        off = norm(true[0] - reference[0], true[1] - reference[1])
        count_tracking(tables.bounds, state.certificates[world], uav, off)


@inlined
def _fetch_ground(tables: LoopTables, state: LoopState, world: int, part: int) -> None:
    """Bring a quarter of the tiles that the next tick of a world will touch near the core, where there are any."""
    if tables.batch.ground.parameters.shape[0] == 0:
        return
    ground, position = state.batch.ground, state.batch.truth.position[world]
    tile, period = tables.batch.ground.parameters[0].tile, tables.batch.ground.parameters[0].period
    for u in range(tables.batch.escorts.shape[0]):
        a = tables.batch.escorts[u, 0]
        if (state.batch.ticks[world] + 1) % period == 0:
            x, y = position[a, 0], position[a, 1]
            fetch_disc(ground.looked[world, u], x, y, tile, tables.looked, part, 4)
            fetch_disc(ground.known[world, a], x, y, tile, tables.looked, part, 4)
    for g in range(tables.batch.ground.ugvs.shape[0]):
        v = tables.batch.ground.ugvs[g]
        x, y = position[v, 0], position[v, 1]
        fetch_disc(ground.known[world, v], x, y, tile, tables.felt, part, 4)
        fetch_disc(ground.tiles[world], x, y, tile, tables.felt, part, 4)


@inlined
def _fetch(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int, part: int
) -> None:
    """Bring a quarter of what the next tick of a world will touch of its grid near the core; of none if `world` < 0."""
    if world < 0:
        return
    cell, position = tables.batch.world[0].cell, state.batch.truth.position[world]
    coverage = state.batch.truth.coverage[world]
    for u in range(tables.batch.escorts.shape[0]):
        a, g = tables.batch.escorts[u, 0], tables.batch.escorts[u, 1]
        if parameters.error:
            fetch_disc(coverage, position[g, 0], position[g, 1], cell, tables.around, part, 4)
        x, y = position[a, 0], position[a, 1]
        fetch_disc(coverage, x, y, cell, tables.seen, part, 4)
        if parameters.own_maps:
            fetch_disc(state.maps[world, u], x, y, cell, tables.seen, part, 4)
    _fetch_ground(tables, state, world, part)


@inlined
def _fetch_rows(state: LoopState, world: int) -> None:
    """Bring what every tick of a world needs beside the grid near the core; of none if `world` < 0."""
    if world < 0:
        return
    batch, truth = state.batch, state.batch.truth
    fetch_rows(
        (
            batch.keys,
            batch.ticks,
            batch.received,
            batch.arrived,
            truth.velocity,
            truth.acceleration,
            truth.commands,
        ),
        world,
    )  # type: ignore[call-arg]
    fetch_rows(
        (truth.detections, truth.gains, truth.measures, state.rows.uavs, state.rows.ugvs),
        world,
    )
    fetch_rows(
        (state.laws, state.drivers, state.law_states, state.driver_states, state.certificates),
        world,
    )
    fetch_rows(
        (
            batch.sent,
            state.rows.terms,
            state.rows.rewards,
            state.rows.terminated,
            state.rows.truncated,
        ),
        world,
    )
    fetch_rows(
        (batch.ground.told, batch.ground.pace, batch.ground.before, batch.mission.ugvs), world
    )


@released
def run_worlds(
    parameters: LoopParameters,
    tables: LoopTables,
    state: LoopState,
    worlds: IntArray,
    beginning: bool,
    actions: FloatArray,
    ticks: int,
    begin: int,
    end: int,
) -> None:
    """Begin these worlds, or fly each on for so many ticks or to the end of its episode.

    World by world, so that a grid stays near its core for a whole flight. One function for all, as each compiles
    for long; what is inlined into what is inlined takes longest, so the tick's parts stand here themselves.
    """
    for n in range(begin, end):
        k = worlds[n]
        # while this world is computed, the next one's cells come
        after = worlds[n + 1] if n + 1 < end else -1
        if beginning:
            begin_world(tables.batch, state.batch, k)
        for tick in range(1 if beginning else ticks):
            if tick > 0 and (state.rows.terminated[k] or state.rows.truncated[k]):
                break
            for part in range(4):  # in a loop, as each call that is written would be compiled anew
                _fetch(parameters, tables, state, after, part)
                if part == 0 and not beginning:
                    for v in range(tables.rows.place.shape[0]):
                        if tables.rows.place[v] >= 0:
                            _fly(parameters, tables, state, k, v, tables.rows.place[v], actions[k])
                        else:
                            _drive(tables, state, k, v, -1 - tables.rows.place[v], actions[k])
                    begun = state.batch.ticks[k]
                    world_tick(tables.batch, state.batch, k, True)
                    for u in range(tables.batch.escorts.shape[0]):
                        if tables.guarded[u]:
                            _note_action(tables, state, k, u, begun)
                elif part == 1:
                    _perceive(parameters, tables, state, k)
                elif part == 2:
                    _fetch_rows(state, after)
                    truth = truth_of(state.batch.truth, k)
                    measure(
                        tables.batch.world,
                        truth.position,
                        tables.batch.escorts,
                        truth.coverage,
                        truth.measures,
                        parameters.error,
                    )
                    advance_rows(tables.batch, state.batch, tables.rows, state.rows, k, beginning)
                elif part == 3:
                    over = state.rows.terminated[k] or state.rows.truncated[k]
                    for u in range(tables.batch.escorts.shape[0]):
                        if over:
                            lost = state.rows.uavs[k, u, UAV_METRICS.lost] != 0.0
                            note_end(state.certificates[k, u], lost)
                        elif tables.guarded[u]:
                            _note_evidence(tables, state, k, u)
                    if tick == ticks - 1 or over or beginning:
                        _observe(parameters, tables, state, k)
            after = -1
