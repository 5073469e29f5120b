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
from agents.drivers.parameters import Route
from agents.drivers.tile_map import GroundMemory, note_block, note_tiles
from agents.drivers.ugv_tick import UgvMemory, ugv_tick
from agents.estimation.filtering import KalmanState, kalman_estimate
from agents.estimation.twin import kalman_step
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
    note_action,
    note_arrival,
    note_report,
    note_sent,
)
from sim.engine.link_arrays import link_of
from sim.engine.mission import goals_of, receive_block
from sim.engine.world_state import (
    COMMAND,
    LOOK,
    Told,
)
from sim.engine.world_tick import begin_world, measure, truth_of, world_tick
from sim.env.patch import sample
from sim.env.rows import UAV, UAV_METRICS, advance_rows, observe_rows
from sim.kernels.compile import FloatArray, IntArray, inlined, released
from sim.kernels.prefetch import fetch_disc, fetch_rows
from sim.models.field import coverage_gradient
from sim.models.randomness import key_of
from sim.models.vehicles import Motion

_SAID, _BLOCK, _SENT = range(3)
"""Columns of a message by radio: the tick, the block of tiles (-1: of none), and where its content begins."""
_RELATIVE, _GROUND = range(2)
"""Rows of `LoopState.outbox`."""


@inlined
def _guard_of(t: LoopTables, s: GuardState, k: int, u: int) -> GuardState:
    course = s.course[k, u, : t.delays[u] + 1]
    w, rows = s.underway, t.delays[u] + 2
    sent = Underway(w.sent[k, u, :rows], w.flown[k, u], w.expected[k, u])
    return GuardState(s.detections[k, u], s.plan[k, u], course, s.track[k, u], s.flags[k, u], sent)


@inlined
def _kalman_of(s: KalmanState, k: int, u: int) -> KalmanState:
    return KalmanState(s.belief[k, u], s.counts[k, u], s.step[k, u], s.past[k, u], s.before[k, u])


@inlined
def _ground_of(t: LoopTables, s: LoopState, k: int, g: int) -> GroundMemory:
    m = s.grounds
    return GroundMemory(
        m.tiles[k, g],
        m.sure[k, g],
        m.draft[k, g],
        m.way[k, g],
        m.cost[k, g],
        m.heap[k, g],
        m.place[k, g],
        m.commands[k, g, : t.late[g]],
        m.flags[k, g],
    )


@inlined
def _memory_of(p: LoopParameters, t: LoopTables, s: LoopState, k: int, u: int) -> UavMemory:
    coverage = s.maps[k, u] if p.own_maps else s.batch.truth.coverage[k]
    ahead = s.lookaheads
    lookahead = LookaheadMemory(ahead.state[k, u], ahead.velocities[k, u], ahead.kept[k, u])
    return UavMemory(coverage, s.law_states[k, u], lookahead, _guard_of(t, s.guards, k, u))


@inlined
def _motion_of(told: Told, k: int, v: int) -> Motion:
    return Motion(
        told.position[k, v, 0],
        told.position[k, v, 1],
        told.velocity[k, v, 0],
        told.velocity[k, v, 1],
    )


@inlined
def _fly(
    p: LoopParameters, t: LoopTables, s: LoopState, k: int, v: int, u: int, actions: FloatArray
) -> None:
    """The command of UAV u, vehicle v, and what it radios."""
    tick, row = s.batch.ticks[k], s.rows.uavs[k, u]
    here, law, guarded = _motion_of(s.batch.told, k, v), s.laws[k, u], t.guarded[u] != 0
    memory, target = _memory_of(p, t, s, k, u), kalman_estimate(_kalman_of(s.kalman, k, u))
    flown = s.batch.flown[k, v, 0].begins
    if t.hand[v] < 0:
        own = OwnTerms(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        u_x, u_y, acts, code, bound = uav_tick(
            law, t.promises[u], guarded, memory, own, tick, here, target, flown
        )
    else:
        u_x, u_y = actions[t.hand[v], 0], actions[t.hand[v], 1]
        acts, code, bound = INNER, NOTHING_AGAINST, 0.0
        if guarded:
            u_x, u_y, acts, code, bound = guard(
                t.promises[u], memory.guard, tick, here, u_x, u_y, flown
            )
    if guarded:
        row[GUARD_METRICS.bound] = bound
        row[GUARD_METRICS.acted] = 1.0 if acts != INNER else 0.0
        sure = code == NOTHING_AGAINST and t.faults[u] == 0
        row[GUARD_METRICS.sure] = 1.0 if sure else 0.0
        reports = target.known or t.hand[v] >= 0  # a pilot that has seen nothing reports nothing
        said = CertificateClaim(sure, reports and acts != INNER, row[UAV_METRICS.lost] != 0.0, True)
        note_report(t.bounds[u], s.certificates[k, u], tick, said)
    sent = s.batch.sent[k, v]
    sent[COMMAND.answered], sent[COMMAND.u_x], sent[COMMAND.u_y] = tick, u_x, u_y
    sent[COMMAND.last], sent[COMMAND.carried] = -1.0, 0.0
    if guarded and t.promises[u].carries:
        sent[COMMAND.last], sent[COMMAND.carried] = hand_over(
            t.promises[u], memory.guard.underway, tick, s.batch.motions[k, v]
        )
    if p.radio:
        _speak(p, s, k, u, tick, here, target)


@inlined
def _speak(
    p: LoopParameters,
    s: LoopState,
    k: int,
    u: int,
    tick: int,
    here: Motion,
    target: Target,
) -> None:
    """Radio messages of UAV u at this tick."""
    known, g_x, g_y, out = target.known, target.p_x, target.p_y, s.outbox[k, u]
    out[_RELATIVE, _SAID] = tick if known and tick % p.radio_ticks == 0 else -1.0
    out[_RELATIVE, _BLOCK] = -1.0
    out[_RELATIVE, _SENT], out[_RELATIVE, _SENT + 1] = here.p_x - g_x, here.p_y - g_y
    out[_GROUND, _SAID] = -1.0
    if p.telling_ticks > 0 and known and tick % p.telling_ticks == 0:
        memory = telling_of(s.telling, k, u)
        row, column = next_block(memory, p.tile, tick, g_x, g_y)
        if row >= 0:
            out[_GROUND, _SAID] = tick
            out[_GROUND, _BLOCK] = row * memory.news.shape[1] + column
            block_words(memory.tiles, row, column, out[_GROUND, _SENT:])


@inlined
def _drive(t: LoopTables, s: LoopState, k: int, v: int, g: int, actions: FloatArray) -> None:
    """The command of UGV g, vehicle v."""
    tick, sent = s.batch.ticks[k], s.batch.sent[k, v]
    sent[COMMAND.answered] = tick
    if t.hand[v] >= 0:
        sent[COMMAND.u_x], sent[COMMAND.u_y] = actions[t.hand[v], 0], actions[t.hand[v], 1]
        return
    script = t.scripts[t.script_rows[g] : t.script_rows[g + 1]]
    route = Route(goals_of(t.batch.mission, g), script)
    sent[COMMAND.u_x], sent[COMMAND.u_y] = ugv_tick(
        s.drivers[k, g],
        route,
        UgvMemory(s.driver_states[k, g], _ground_of(t, s, k, g)),
        s.inboxes[k, g],
        s.arrived[k, g],
        tick,
        _motion_of(s.batch.told, k, v),
    )


@inlined
def _receive_block(t: LoopTables, s: LoopState, k: int, g: int, message: FloatArray) -> None:
    """UGV g is told of a block of tiles by radio."""
    block, across, words = int(message[_BLOCK]), s.telling.news.shape[3], message[_SENT:]
    row, column, states = block // across, block % across, s.states[k, :BLOCK_TILES]
    for place in range(BLOCK_TILES):
        states[place] = word_state(words, place)
    note_block(_ground_of(t, s, k, g), row, column, states)
    b, tick = s.batch, s.batch.ticks[k]
    receive_block(t.batch.ground, b.ground, b.mission, k, g, tick, (row, column), states)


@inlined
def _feel_ground(t: LoopTables, s: LoopState, k: int, g: int) -> None:
    """UGV g takes in the tiles that its bumper tells of."""
    v, ground = t.batch.ground.ugvs[g], s.batch.ground
    columns, count = ground.tiles.shape[2], ground.told[k, v]
    rows, across, states = s.places[k, 0, :count], s.places[k, 1, :count], s.states[k, :count]
    for n in range(count):
        rows[n], across[n] = ground.seen[k, v, n] // columns, ground.seen[k, v, n] % columns
        states[n] = ground.known[k, v, rows[n], across[n]]
    if count > 0:
        note_tiles(_ground_of(t, s, k, g), rows, across, states)


@inlined
def _radio(t: LoopTables, s: LoopState, k: int) -> None:
    """Send out the radio messages of the tick before, and receive those that arrive."""
    tick, arrived = s.batch.ticks[k], s.arrived[k]
    arrived[:] = 0
    for u in range(t.receivers.shape[0]):
        g, outbox, inbox = t.receivers[u], s.outbox[k, u], s.inbox[k]
        come, link = s.inboxes[k, g], link_of(s.radio, k, u)
        key = key_of(s.batch.keys[k], t.radio.owners[u, 0], t.radio.owners[u, 1])
        begin_tick(t.radio, u, link, key, tick)
        for row in range(outbox.shape[0]):
            if outbox[row, _SAID] >= 0.0:
                send(t.radio, u, link, key, outbox[row])
                outbox[row, _SAID] = -1.0
        for i in range(receive(link, inbox)):
            if inbox[i, _BLOCK] >= 0.0:
                _receive_block(t, s, k, g, inbox[i])
                continue
            n = arrived[g]
            come[n, 0], come[n, 1], come[n, 2] = inbox[i, 0], inbox[i, 2], inbox[i, 3]
            arrived[g] = n + 1


@inlined
def _perceive(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Every UAV takes what has reached it at this tick into its map and its filters, every UGV its radio."""
    escorts, tick = t.batch.escorts, s.batch.ticks[k]
    looks, arrived = s.batch.received[k], s.batch.arrived[k]
    looked = 1 if p.own_maps and tick > 0 else 0  # else the world has done it
    for u in range(escorts.shape[0]):
        here = _motion_of(s.batch.told, k, escorts[u, 0])
        if p.telling_ticks > 0:
            v, ground = escorts[u, 0], s.batch.ground
            columns = ground.tiles.shape[2]
            for n in range(ground.told[k, v]):
                row, column = ground.seen[k, v, n] // columns, ground.seen[k, v, n] % columns
                state = ground.known[k, v, row, column]
                note_tile(telling_of(s.telling, k, u), column, row, state)
        uav_perceive(
            s.laws[k, u],
            t.promises[u],
            t.guarded[u] != 0,
            _memory_of(p, t, s, k, u),
            looked,
            tick,
            here,
            looks[u],
            arrived[u],
        )
        if t.guarded[u]:
            for n in range(arrived[u]):
                note_arrival(t.bounds[u], s.certificates[k, u], int(looks[u, n, LOOK.taken]), 0.0)
        if t.thinking[u]:
            kalman = _kalman_of(s.kalman, k, u)
            kalman_step(t.kalman[u], kalman, tick, here.p_x, here.p_y, looks[u], arrived[u])
    if p.radio:
        _radio(t, s, k)
    if s.grounds.tiles.shape[2] > 0:
        for g in range(t.batch.ground.ugvs.shape[0]):
            _feel_ground(t, s, k, g)


@inlined
def _add_cues(p: LoopParameters, t: LoopTables, s: LoopState, k: int, u: int) -> None:
    """Put the estimate and the gradient into the row of UAV u, where they are asked for and known."""
    w, row = t.batch.world[0], s.rows.uav_rows[k, u]
    row[GRADIENT_X], row[GRADIENT_Y] = 0.0, 0.0
    target = kalman_estimate(_kalman_of(s.kalman, k, u))
    if not target.known:
        return
    g_x, g_y = target.p_x, target.p_y
    x, y = row[UAV.x], row[UAV.y]
    if p.estimate:
        row[UAV.detected], row[UAV.relative_x], row[UAV.relative_y] = 1.0, x - g_x, y - g_y
        row[UAV.age] = s.kalman.belief[k, u, 0].age * w.dt
    if p.gradient:
        u_x, u_y, size = coverage_gradient(
            s.maps[k, u] if p.own_maps else s.batch.truth.coverage[k],
            x,
            y,
            g_x,
            g_y,
            w.r_o,
            w.desired,
            w.sensor,
            w.peak,
            w.reach,
            w.cell,
        )
        if size > 0.0:
            row[GRADIENT_X], row[GRADIENT_Y] = u_x / size, u_y / size


@inlined
def _observe(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Everybody's row, and the UAVs' pictures."""
    w, position, escorts = t.batch.world[0], s.batch.told.position[k], t.batch.escorts
    observe_rows(t.batch, s.batch, t.rows, s.rows, k)
    if p.estimate or p.gradient:
        for u in range(escorts.shape[0]):
            _add_cues(p, t, s, k, u)
    for u in range(s.patches.shape[1]):
        x, y = position[escorts[u, 0], 0], position[escorts[u, 0], 1]
        sample(
            s.maps[k, u] if p.own_maps else s.batch.truth.coverage[k],
            x,
            y,
            w.desired,
            w.cell,
            p.meters_per_pixel,
            s.patches[k, u],
        )


@inlined
def _note_action(t: LoopTables, s: LoopState, k: int, u: int, tick: int) -> None:
    """Count the action of UAV u in this tick, which has just been flown."""
    v, b = t.batch.escorts[u, 0], t.bounds[u]
    sent, command, acts = (
        s.sent[k, u, : b.delay + 1],
        s.batch.sent[k, v],
        s.batch.truth.commands[k, v],
    )
    note_sent(sent, tick, command[COMMAND.u_x], command[COMMAND.u_y])
    begins = s.batch.flown[k, v, 0].begins
    note_action(b, s.certificates[k, u], sent, tick, acts[0], acts[1], begins)


@inlined
def _fetch_ground(t: LoopTables, s: LoopState, k: int, part: int) -> None:
    """Bring a quarter of the tiles that the next tick of world k will touch near the core, where there are any."""
    if t.batch.ground.parameters.shape[0] == 0:
        return
    ground, position = s.batch.ground, s.batch.truth.position[k]
    tile, period = t.batch.ground.parameters[0].tile, t.batch.ground.parameters[0].period
    for u in range(t.batch.escorts.shape[0]):
        a = t.batch.escorts[u, 0]
        if (s.batch.ticks[k] + 1) % period == 0:
            x, y = position[a, 0], position[a, 1]
            fetch_disc(ground.looked[k, u], x, y, tile, t.looked, part, 4)
            fetch_disc(ground.known[k, a], x, y, tile, t.looked, part, 4)
    for g in range(t.batch.ground.ugvs.shape[0]):
        v = t.batch.ground.ugvs[g]
        x, y = position[v, 0], position[v, 1]
        fetch_disc(ground.known[k, v], x, y, tile, t.felt, part, 4)
        fetch_disc(ground.tiles[k], x, y, tile, t.felt, part, 4)


@inlined
def _fetch(p: LoopParameters, t: LoopTables, s: LoopState, k: int, part: int) -> None:
    """Bring a quarter of what the next tick of world k will touch of its grid near the core; of no world if k < 0."""
    if k < 0:
        return
    w, position, coverage = t.batch.world[0], s.batch.truth.position[k], s.batch.truth.coverage[k]
    for u in range(t.batch.escorts.shape[0]):
        a, g = t.batch.escorts[u, 0], t.batch.escorts[u, 1]
        if p.error:
            fetch_disc(coverage, position[g, 0], position[g, 1], w.cell, t.around, part, 4)
        fetch_disc(coverage, position[a, 0], position[a, 1], w.cell, t.seen, part, 4)
        if p.own_maps:
            fetch_disc(s.maps[k, u], position[a, 0], position[a, 1], w.cell, t.seen, part, 4)
    _fetch_ground(t, s, k, part)


@inlined
def _fetch_rows(s: LoopState, k: int) -> None:
    """Bring what every tick of world k needs beside the grid near the core; of no world if k < 0."""
    if k < 0:
        return
    b, truth = s.batch, s.batch.truth
    fetch_rows(
        (
            b.keys,
            b.ticks,
            b.received,
            b.arrived,
            truth.velocity,
            truth.acceleration,
            truth.commands,
        ),
        k,
    )  # type: ignore[call-arg]
    fetch_rows(
        (truth.detections, truth.gains, truth.measures, s.rows.uavs, s.rows.ugvs),
        k,
    )
    fetch_rows((s.kalman.belief, s.kalman.step), k)
    fetch_rows((s.laws, s.drivers, s.law_states, s.driver_states, s.certificates), k)
    fetch_rows((b.sent, s.rows.terms, s.rows.rewards, s.rows.terminated, s.rows.truncated), k)
    fetch_rows((b.ground.told, b.ground.pace, b.ground.before, b.mission.ugvs), k)


@released
def run_worlds(
    p: LoopParameters,
    t: LoopTables,
    s: LoopState,
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
        after = (
            worlds[n + 1] if n + 1 < end else -1
        )  # while this world is computed, the next one's cells come
        if beginning:
            begin_world(t.batch, s.batch, k)
        for tick in range(1 if beginning else ticks):
            if tick > 0 and (s.rows.terminated[k] or s.rows.truncated[k]):
                break
            for part in range(4):  # in a loop, as each call that is written would be compiled anew
                _fetch(p, t, s, after, part)
                if part == 0 and not beginning:
                    for v in range(t.rows.place.shape[0]):
                        if t.rows.place[v] >= 0:
                            _fly(p, t, s, k, v, t.rows.place[v], actions[k])
                        else:
                            _drive(t, s, k, v, -1 - t.rows.place[v], actions[k])
                    begun = s.batch.ticks[k]
                    world_tick(t.batch, s.batch, k, True)
                    for u in range(t.batch.escorts.shape[0]):
                        if t.guarded[u]:
                            _note_action(t, s, k, u, begun)
                elif part == 1:
                    _perceive(p, t, s, k)
                elif part == 2:
                    _fetch_rows(s, after)
                    truth = truth_of(s.batch.truth, k)
                    measure(
                        t.batch.world,
                        truth.position,
                        t.batch.escorts,
                        truth.coverage,
                        truth.measures,
                        p.error,
                    )
                    advance_rows(t.batch, s.batch, t.rows, s.rows, k, beginning)
                elif part == 3:
                    over = s.rows.terminated[k] or s.rows.truncated[k]
                    if tick == ticks - 1 or over or beginning:
                        _observe(p, t, s, k)
            after = -1
