"""One tick of the closed loop, compiled: world, links, filters, laws, drivers and rewards in one pass.

The pilots' own functions are called, so a vehicle that is flown in here gets the commands that its pilot would
give over the bus. One pass a world, so that its grid stays near the core until the tick is done.
"""

from agents.control.certificate import CERTIFIED as NOTHING_AGAINST
from agents.control.certificate import INNER
from agents.control.guard import GuardState, guard
from agents.control.laws import OwnTerms
from agents.control.uav_tick import Motion, UavMemory, uav_perceive, uav_tick
from agents.drivers.parameters import Route
from agents.drivers.ugv_tick import ugv_tick
from agents.estimation.twin import AGE, KalmanState, kalman_estimate, kalman_step
from outrider.envs.closed_loop_state import (
    ACTED,
    ARRIVALS,
    BOUND,
    BROKEN,
    CERTIFIED_TICKS,
    DISTANCE,
    ERROR,
    ERROR_SUM,
    FALSE_TICKS,
    INTERVENED,
    LOST,
    MAX_DISTANCE,
    NEARER,
    NEWEST,
    OBEYED,
    REACHED,
    SHIELDED,
    SURE,
    TO_GO,
    VIOLATIONS,
    WAS_LOST,
    LoopParameters,
    LoopState,
    LoopTables,
)
from sim.channel.link import advance as begin_tick
from sim.channel.link import receive, send
from sim.engine.link_arrays import link_of
from sim.engine.world_state import ANSWERED, LOOK_X, LOOK_Y, TAKEN, U_X, U_Y, WorldState
from sim.engine.world_tick import begin_world, world_tick
from sim.env.patch import sample
from sim.env.rewards import uav_terms, ugv_terms
from sim.env.rows import turn
from sim.kernels.compile import FloatArray, IntArray, inlined, released
from sim.kernels.prefetch import fetch_disc, fetch_rows
from sim.models.field import coverage_error, coverage_gradient
from sim.models.randomness import key_of
from sim.models.vehicles import norm

_SAID, _SENT_X, _SENT_Y = range(3)


@inlined
def _guard_of(t: LoopTables, s: GuardState, k: int, u: int) -> GuardState:
    course = s.course[k, u, : t.delays[u] + 1]
    return GuardState(
        s.detections[k, u], s.plan[k, u], course, s.track[k, u], s.track_ticks[k, u], s.flags[k, u]
    )


@inlined
def _kalman_of(s: KalmanState, k: int, u: int) -> KalmanState:
    return KalmanState(s.numbers[k, u], s.history[k, u])


@inlined
def _memory_of(p: LoopParameters, t: LoopTables, s: LoopState, k: int, u: int) -> UavMemory:
    coverage = s.maps[k, u] if p.own_maps else s.batch.truth.coverage[k]
    return UavMemory(coverage, s.law_states[k, u], _guard_of(t, s.guards, k, u))


@inlined
def _motion_of(truth: WorldState, k: int, v: int) -> Motion:
    return Motion(
        truth.position[k, v, 0],
        truth.position[k, v, 1],
        truth.velocity[k, v, 0],
        truth.velocity[k, v, 1],
    )


@inlined
def _fly(
    p: LoopParameters, t: LoopTables, s: LoopState, k: int, v: int, u: int, actions: FloatArray
) -> None:
    """The command of UAV u, vehicle v, and what it radios."""
    tick, seat = s.batch.ticks[k], s.uav_seats[k, u]
    here, law, guarded = _motion_of(s.batch.truth, k, v), s.laws[k, u], t.guarded[u] != 0
    memory, target = _memory_of(p, t, s, k, u), kalman_estimate(_kalman_of(s.kalman, k, u))
    if t.hand[v] < 0:
        own = OwnTerms(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        u_x, u_y, acts, code, bound = uav_tick(
            law, t.promises[u], guarded, memory, own, tick, here, target
        )
    else:
        u_x, u_y = actions[t.hand[v], 0], actions[t.hand[v], 1]
        acts, code, bound = INNER, NOTHING_AGAINST, 0.0
        if guarded:
            u_x, u_y, acts, code, bound = guard(
                t.promises[u], memory.guard, tick, here.p_x, here.p_y, here.v_x, here.v_y, u_x, u_y
            )
    if guarded:
        seat[BOUND] = bound
        seat[ACTED] = 1.0 if acts != INNER else 0.0
        before, seat[SURE] = (
            seat[SURE],
            1.0 if code == NOTHING_AGAINST and t.faults[u] == 0 else 0.0,
        )
        if seat[SURE] != 0.0:
            seat[FALSE_TICKS] += seat[LOST]
        elif before != 0.0 and seat[OBEYED] != 0.0 and tick - seat[NEWEST] <= t.ages[u]:
            seat[BROKEN] += t.bounded[u]
        seat[SHIELDED] += 1.0
        seat[INTERVENED] += seat[ACTED]
        seat[CERTIFIED_TICKS] += seat[SURE]
    sent = s.batch.sent[k, v]
    sent[ANSWERED], sent[U_X], sent[U_Y] = tick, u_x, u_y
    if p.radio:
        known, g_x, g_y = target
        says = known and tick % p.radio_ticks == 0
        s.outbox[k, u, _SAID] = tick if says else -1.0
        s.outbox[k, u, _SENT_X], s.outbox[k, u, _SENT_Y] = (
            here.p_x - g_x,
            here.p_y - g_y,
        )


@inlined
def _drive(
    p: LoopParameters, t: LoopTables, s: LoopState, k: int, v: int, g: int, actions: FloatArray
) -> None:
    """The command of UGV g, vehicle v."""
    tick, sent = s.batch.ticks[k], s.batch.sent[k, v]
    sent[ANSWERED] = tick
    if t.hand[v] >= 0:
        sent[U_X], sent[U_Y] = actions[t.hand[v], 0], actions[t.hand[v], 1]
        return
    here = _motion_of(s.batch.truth, k, v)
    route = Route(
        t.goals[t.goal_rows[g] : t.goal_rows[g + 1]],
        t.scripts[t.script_rows[g] : t.script_rows[g + 1]],
    )
    sent[U_X], sent[U_Y] = ugv_tick(
        s.drivers[k, g],
        route,
        s.driver_states[k, g],
        s.heard[k, g],
        s.hearing[k, g],
        tick,
        here.p_x,
        here.p_y,
        here.v_x,
        here.v_y,
    )


@inlined
def _listen(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """What the UAVs have said at the tick before sets out, and what has arrived is with the UGVs."""
    dt, tick, hearing = t.batch.world[0].dt, s.batch.ticks[k], s.hearing[k]
    hearing[:] = 0
    for u in range(t.listeners.shape[0]):
        g, outbox, inbox = t.listeners[u], s.outbox[k, u], s.inbox[k]
        heard, link = s.heard[k, g], link_of(s.radio, k, u)
        key = key_of(s.batch.keys[k], t.radio.owners[u, 0], t.radio.owners[u, 1])
        begin_tick(t.radio, u, link, key, tick)
        if outbox[_SAID] >= 0.0:
            send(t.radio, u, link, key, outbox)
            outbox[_SAID] = -1.0
        for i in range(receive(link, inbox)):
            n = hearing[g]
            heard[n, 0], heard[n, 1], heard[n, 2] = inbox[i, 0] * dt, inbox[i, 1], inbox[i, 2]
            hearing[g] = n + 1


@inlined
def _perceive(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Every UAV takes what has reached it at this tick into its map and its filters; the UGVs listen."""
    escorts, tick = t.batch.escorts, s.batch.ticks[k]
    looks, arrived = s.batch.received[k], s.batch.arrived[k]
    looked = 1 if p.own_maps and tick > 0 else 0  # else the world has done it
    for u in range(escorts.shape[0]):
        here = _motion_of(s.batch.truth, k, escorts[u, 0])
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
        if t.thinking[u]:
            kalman = _kalman_of(s.kalman, k, u)
            kalman_step(t.kalman[u], kalman, tick, here.p_x, here.p_y, looks[u], arrived[u])
    if p.radio:
        _listen(p, t, s, k)


@inlined
def _seat_uav(p: LoopParameters, t: LoopTables, s: LoopState, k: int, u: int) -> None:
    """How UAV u truly stands at this tick, and the newest detection that has reached it."""
    w, truth, seat = t.batch.world[0], s.batch.truth, s.uav_seats[k, u]
    a, g = t.batch.escorts[u, 0], t.batch.escorts[u, 1]
    position = truth.position[k]
    distance = norm(position[a, 0] - position[g, 0], position[a, 1] - position[g, 1])
    lost = distance >= w.r_v
    seat[WAS_LOST], seat[LOST] = seat[LOST], 1.0 if lost else 0.0
    seat[DISTANCE], seat[MAX_DISTANCE] = distance, max(seat[MAX_DISTANCE], distance)
    seat[VIOLATIONS] += seat[LOST]
    if p.error:
        seat[ERROR] = coverage_error(
            truth.coverage[k], position[g, 0], position[g, 1], w.r_o, w.desired, w.cell
        )
        seat[ERROR_SUM] += seat[ERROR]
    looks = s.batch.received[k, u]
    for n in range(s.batch.arrived[k, u]):
        seat[NEWEST] = max(seat[NEWEST], looks[n, TAKEN])


@inlined
def _observe_uav(p: LoopParameters, t: LoopTables, s: LoopState, k: int, u: int) -> None:
    """Write the row of UAV u."""
    w, truth, tick, row = t.batch.world[0], s.batch.truth, s.batch.ticks[k], s.uav_rows[k, u]
    a, time, looks = t.batch.escorts[u, 0], tick * w.dt, s.batch.received[k, u]
    x, y = truth.position[k, a, 0], truth.position[k, a, 1]
    row[0], row[1], row[2], row[3], row[4] = (
        time,
        x,
        y,
        truth.velocity[k, a, 0],
        truth.velocity[k, a, 1],
    )
    row[5], row[6], row[7] = 0.0, 0.0, 0.0
    newest = s.uav_seats[k, u, NEWEST]
    row[8] = p.ticks * w.dt if newest < 0.0 else time - newest * w.dt
    best = -1
    for n in range(s.batch.arrived[k, u]):
        if best < 0 or looks[n, TAKEN] > looks[best, TAKEN]:
            best = n
    if best >= 0:
        row[5], row[6], row[7] = 1.0, looks[best, LOOK_X], looks[best, LOOK_Y]
        row[8] = time - looks[best, TAKEN] * w.dt
    row[9], row[10] = 0.0, 0.0
    if not (p.estimate or p.gradient):
        return
    known, g_x, g_y = kalman_estimate(_kalman_of(s.kalman, k, u))
    if not known:
        return
    if p.estimate:
        row[5], row[6], row[7], row[8] = 1.0, x - g_x, y - g_y, s.kalman.numbers[k, u, AGE] * w.dt
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
            row[9], row[10] = u_x / size, u_y / size


@inlined
def _seat_ugv(p: LoopParameters, t: LoopTables, s: LoopState, k: int, g: int) -> None:
    """UGV g turns to the next goal where it has reached one."""
    v, seat, position = t.ugv_rows[g], s.ugv_seats[k, g], s.batch.truth.position[k]
    goals = t.goals[t.goal_rows[g] : t.goal_rows[g + 1]]
    x, y, reached = position[v, 0], position[v, 1], int(seat[REACHED])
    seat[NEARER], seat[ARRIVALS] = 0.0, 0.0
    if reached < goals.shape[0]:
        seat[NEARER] = seat[TO_GO] - norm(x - goals[reached, 0], y - goals[reached, 1])
        now, seat[TO_GO] = turn(goals, reached, t.tolerances[g], x, y)
        seat[ARRIVALS], seat[REACHED] = now - reached, now


@inlined
def _observe_ugv(p: LoopParameters, t: LoopTables, s: LoopState, k: int, g: int) -> None:
    """Write the row of UGV g."""
    v, row, truth = t.ugv_rows[g], s.ugv_rows[k, g], s.batch.truth
    first, last = t.goal_rows[g], t.goal_rows[g + 1]
    reached = first + int(s.ugv_seats[k, g, REACHED])
    row[0], row[1], row[2] = (
        s.batch.ticks[k] * t.batch.world[0].dt,
        truth.position[k, v, 0],
        truth.position[k, v, 1],
    )
    row[3], row[4] = truth.velocity[k, v, 0], truth.velocity[k, v, 1]
    row[5], row[6], row[7] = 1.0 if reached < last else 0.0, 0.0, 0.0
    if last > first:
        goal = min(reached, last - 1)
        row[6], row[7] = t.goals[goal, 0], t.goals[goal, 1]


@inlined
def _pay(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Whether the episode is over, and everybody's reward of this tick."""
    w, r, truth, any_lost, goals_left, goals_given = (
        t.batch.world[0],
        t.weights,
        s.batch.truth,
        False,
        0,
        0,
    )
    for u in range(t.batch.escorts.shape[0]):
        any_lost = any_lost or s.uav_seats[k, u, LOST] != 0.0
    for g in range(t.ugv_rows.shape[0]):
        given = t.goal_rows[g + 1] - t.goal_rows[g]
        goals_given += given
        goals_left += given - int(s.ugv_seats[k, g, REACHED])
    left = p.ticks - s.batch.ticks[k]
    lost = p.end_on_sight_lost and any_lost
    arrived = p.end_on_goals and goals_given > 0 and goals_left == 0
    s.terminated[k], s.truncated[k] = 1 if lost or arrived else 0, 1 if left <= 0 else 0
    for v in range(t.place.shape[0]):
        u_x, u_y = truth.acceleration[k, v, 0], truth.acceleration[k, v, 1]
        if t.place[v] >= 0:
            u = t.place[v]
            seat = s.uav_seats[k, u]
            first, second, third, fourth, fifth = uav_terms(
                r[0],
                r[1],
                r[2],
                r[3],
                r[6],
                seat[ERROR],
                truth.gains[k, u],
                p.full,
                seat[LOST] != 0.0,
                seat[WAS_LOST] != 0.0,
                1 + left if lost else 1,
                u_x,
                u_y,
                w.dt,
            )
            s.rewards[k, v] = 0.0 + first + second + third + fourth + fifth
        else:
            seat = s.ugv_seats[k, -1 - t.place[v]]
            nearer, goal, effort = ugv_terms(
                r[4], r[5], r[6], seat[NEARER], int(seat[ARRIVALS]), u_x, u_y, w.dt
            )
            s.rewards[k, v] = 0.0 + nearer + goal + effort


@inlined
def _observe(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Everybody's row, and the UAVs' pictures."""
    w, position, escorts = t.batch.world[0], s.batch.truth.position[k], t.batch.escorts
    for u in range(escorts.shape[0]):
        _observe_uav(p, t, s, k, u)
    for g in range(t.ugv_rows.shape[0]):
        _observe_ugv(p, t, s, k, g)
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
def _begin(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """World k, whose arrays are as they are at the start but for its keys: everybody has a first look."""
    begin_world(t.batch, s.batch, k)
    for g in range(t.ugv_rows.shape[0]):
        v, seat, goals = (
            t.ugv_rows[g],
            s.ugv_seats[k, g],
            t.goals[t.goal_rows[g] : t.goal_rows[g + 1]],
        )
        x, y = s.batch.truth.position[k, v, 0], s.batch.truth.position[k, v, 1]
        seat[REACHED], seat[TO_GO] = turn(goals, 0, t.tolerances[g], x, y)
        seat[ARRIVALS] = seat[REACHED]


@inlined
def _note_obedience(t: LoopTables, s: LoopState, k: int, u: int, tick: int) -> None:
    """Whether UAV u acted in this tick, which has just been flown, on the command that was due.

    That is the one of as many ticks ago as is declared; before the first there is none, and nothing acts.
    """
    v, size, sent = t.batch.escorts[u, 0], t.delays[u] + 1, s.sent[k, u]
    now, due, acting = tick % size, (tick + 1) % size, s.batch.truth.commands[k, v]
    sent[now, 0], sent[now, 1] = s.batch.sent[k, v, U_X], s.batch.sent[k, v, U_Y]
    same = sent[due, 0] == acting[0] and sent[due, 1] == acting[1]
    s.uav_seats[k, u, OBEYED] = 1.0 if same else 0.0


@inlined
def _step(p: LoopParameters, t: LoopTables, s: LoopState, k: int, actions: FloatArray) -> None:
    """Everybody answers, and world k advances by one tick."""
    for v in range(t.place.shape[0]):
        if t.place[v] >= 0:
            _fly(p, t, s, k, v, t.place[v], actions)
        else:
            _drive(p, t, s, k, v, -1 - t.place[v], actions)
    tick = s.batch.ticks[k]
    world_tick(t.batch, s.batch, k, True)
    for u in range(t.batch.escorts.shape[0]):
        if t.guarded[u]:
            _note_obedience(t, s, k, u, tick)


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
    fetch_rows((truth.detections, truth.gains, s.kalman.numbers, s.uav_seats, s.ugv_seats), k)
    fetch_rows((s.laws, s.drivers, s.law_states, s.driver_states), k)
    fetch_rows((b.sent, s.uav_rows, s.ugv_rows, s.rewards, s.terminated, s.truncated), k)


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
    for long.
    """
    for n in range(begin, end):
        k = worlds[n]
        after = (
            worlds[n + 1] if n + 1 < end else -1
        )  # while this world is computed, the next one's cells come
        if beginning:
            _begin(p, t, s, k)
        for tick in range(1 if beginning else ticks):
            if not beginning:
                if tick > 0 and (s.terminated[k] or s.truncated[k]):
                    break
                _fetch(p, t, s, after, 0)
                _step(p, t, s, k, actions[k])
            _fetch(p, t, s, after, 1)
            _perceive(p, t, s, k)
            _fetch(p, t, s, after, 2)
            _fetch_rows(s, after)
            for u in range(t.batch.escorts.shape[0]):
                _seat_uav(p, t, s, k, u)
            if not beginning:
                for g in range(t.ugv_rows.shape[0]):
                    _seat_ugv(p, t, s, k, g)
                _pay(p, t, s, k)
            _fetch(p, t, s, after, 3)
            after = -1
            if tick == ticks - 1 or s.terminated[k] or s.truncated[k] or beginning:
                _observe(p, t, s, k)
