"""The closed loop in many worlds at once: world, links, filters, laws, drivers and rewards of a tick in one compiled pass.

The pilots' own functions are called, so a vehicle that is flown in here gets the commands that its pilot would give over the bus.
One pass a world, so that its grid stays near the core until the tick is done.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from agents.control.certificate import CERTIFIED as NOTHING_AGAINST
from agents.control.certificate import INNER
from agents.control.guard import (
    GuardState,
    guard,
    guard_state,
    note_detection,
    note_position,
    pack_promise,
    unpack_promise,
)
from agents.control.handover import check_assumptions
from agents.control.laws import (
    CERTIFIED,
    LAWS,
    PATH,
    STATE_SIZE,
    WEIGHTED,
    LawParameters,
    OwnTerms,
    bounded_uav_control,
    law_parameters,
    pack_law,
    unpack_law,
)
from agents.control.visibility import promise_of
from agents.drivers.compiled import (
    COMPILED_DRIVERS,
    driver_goals,
    driver_parameters,
    driver_script,
    fresh_driver_state,
    pack_driver,
    ugv_control,
    unpack_driver,
)
from agents.estimation_history import SPAN
from agents.estimation_twin import (
    AGE,
    KalmanState,
    kalman_estimate,
    kalman_parameters,
    kalman_state,
    kalman_step,
    pack_kalman,
    unpack_kalman,
)
from agents.uav import RADIO_PERIOD
from bus.errors import ScenarioError
from bus.layout import GradientCue, UavRow, UgvRow
from bus.messages import LinkKind, LinkStatus, UavBriefing, UgvBriefing
from sim.batch import (
    LOOK_X,
    LOOK_Y,
    TAKEN,
    Batch,
    BatchState,
    BatchTables,
    Fresh,
    arrays_of,
    begin_world,
    step_world,
)
from sim.briefing import briefing
from sim.compile import FloatArray, compiling, inlined, released
from sim.env.patch import CoveragePatch, sample
from sim.env.rewards import RewardWeights, full_error, uav_terms, ugv_terms
from sim.env.seats import turn
from sim.field import accumulate, coverage_error, coverage_gradient
from sim.link import LinkState, receive, send
from sim.link import advance as advance_link
from sim.link_table import BatchLinks, LinkTable, link_of, parameters_of
from sim.prefetch import fetch_disc
from sim.randomness import pilot_key
from sim.scenario import Scenario
from sim.tick import IntArray, WorldParameters, first_state
from sim.vehicles import brake, norm

_TRACK = 120.0
"""A detection older than this is of no use to the safety filter [s]: `agents.control.guard` keeps the track no longer."""

UAV_ROW = len(UavRow._fields) + len(GradientCue._fields)
"""Numbers of a UAV's row: `UavRow`, then `GradientCue`."""

(NEWEST, WAS_LOST, LOST, DISTANCE, MAX_DISTANCE, VIOLATIONS, ERROR, ERROR_SUM, INTERVENED, CERTIFIED_TICKS, SHIELDED) = range(11)
ACTED, SURE, BOUND = range(11, 14)
"""Columns of `LoopState.uav_seats`: tick of the newest detection (-1: none); whether sight was and is lost; distance now and at
most [m]; ticks out of sight; e(t) now and summed over the ticks so far [m²]; ticks in which the safety filter acted, which were
certified, and which it was asked; of the last tick, whether it acted, whether certified, and the distance that it bounds [m]."""

REACHED, ARRIVALS, NEARER, TO_GO = range(4)
"""Columns of `LoopState.ugv_seats`: goals reached, those of this tick, how much nearer it came [m], way to the next one [m]."""

_PENDING, _SENT_X, _SENT_Y = range(3)

_NO_SEEDS = np.zeros(0, dtype=np.int64)
_NO_ACTIONS = np.zeros((0, 0, 2))


class LoopParameters(NamedTuple):
    """What the loop does, as plain numbers."""

    w: WorldParameters
    ticks: int
    """Of an episode."""
    error: bool
    """Whether e(t) is needed at every tick."""
    estimate: bool
    """Whether the rows have the filter's estimate in the place of the raw detection."""
    gradient: bool
    """Whether the rows have the gradient."""
    end_on_sight_lost: bool
    end_on_goals: bool
    own_maps: bool
    """Whether each UAV has a map of its own; else all that is seen is its own."""
    radio: bool
    """Whether any UGV listens to the radio."""
    perfect_radio: bool
    radio_ticks: int
    full: float
    """`full_error` [m²]."""
    meters_per_pixel: float


class LoopTables(NamedTuple):
    """What all worlds share and nobody changes."""

    batch: BatchTables
    place: IntArray
    """For each vehicle its row among the UAVs, or -1 - its row among the UGVs. Shape (vehicles,)."""
    hand: IntArray
    """For each vehicle its row in the actions from outside; -1: it is flown in here. Shape (vehicles,)."""
    ugv_rows: IntArray
    """Rows of the UGVs. Shape (UGVs,)."""
    thinking: IntArray
    """For each UAV whether its estimate is needed. Shape (UAVs,)."""
    guarded: IntArray
    """For each UAV whether the safety filter watches over it. Shape (UAVs,)."""
    faults: IntArray
    """For each UAV whether its certificate's assumptions fail. Shape (UAVs,)."""
    delays: IntArray
    """For each UAV the declared delay of its commands [ticks]. Shape (UAVs,)."""
    listeners: IntArray
    """For each UAV the row among the UGVs of the one that hears it. Shape (UAVs,)."""
    laws: FloatArray
    kalman: FloatArray
    promises: FloatArray
    drivers: FloatArray
    tolerances: FloatArray
    """Goal tolerance of each UGV [m]. Shape (UGVs,)."""
    goals: FloatArray
    """The goals of all UGVs [m]. Shape (any, 2)."""
    goal_rows: IntArray
    """Where each UGV's begin. Shape (UGVs + 1,)."""
    scripts: FloatArray
    script_rows: IntArray
    weights: FloatArray
    """The numbers of `RewardWeights`, in its order."""
    ways: LinkTable
    """Of the radio, a row for each UAV."""


class LoopState(NamedTuple):
    """Everything that changes. All arrays have an axis for worlds in front."""

    batch: BatchState
    maps: FloatArray
    """The UAVs' own maps, where they differ from the world's. Shape (worlds, UAVs or 0, rows, columns)."""
    keys: IntArray
    """Of the pilots' random numbers. Shape (worlds, vehicles)."""
    commands: FloatArray
    """What each vehicle answered last [m/s²]. Shape (worlds, vehicles, 2)."""
    laws: FloatArray
    kalman: KalmanState
    guards: GuardState
    drivers: FloatArray
    outbox: FloatArray
    """The radio message that each UAV has just said: whether there is one, p_delta [m]. Shape (worlds, UAVs, 3)."""
    ways: LinkState
    inbox: FloatArray
    """What has arrived by one radio link: time [s], p_delta [m]. Shape (worlds, room, 3)."""
    heard: FloatArray
    """What each UGV hears at this tick. Shape (worlds, UGVs, room, 3)."""
    hearing: IntArray
    """How many. Shape (worlds, UGVs)."""
    uav_seats: FloatArray
    ugv_seats: FloatArray
    uav_rows: FloatArray
    """What each UAV observes. Shape (worlds, UAVs, UAV_ROW)."""
    ugv_rows: FloatArray
    """What each UGV observes. Shape (worlds, UGVs, 8)."""
    patches: FloatArray
    """Pictures of the UAVs' own maps. Shape (worlds, UAVs or 0, pixels, pixels)."""
    rewards: FloatArray
    """Of the last tick. Shape (worlds, vehicles)."""
    terminated: IntArray
    truncated: IntArray
    """Shape (worlds,)."""


@inlined
def _guard_of(t: LoopTables, s: GuardState, k: int, u: int) -> GuardState:
    pending = s.pending[k, u, : t.delays[u]]
    return GuardState(s.detections[k, u], s.plan[k, u], pending, s.track[k, u], s.track_ticks[k, u], s.flags[k, u])


@inlined
def _kalman_of(s: KalmanState, k: int, u: int) -> KalmanState:
    return KalmanState(s.numbers[k, u], s.history[k, u])


@inlined
def _wanted(p: LoopParameters, t: LoopTables, s: LoopState, k: int, v: int, u: int) -> tuple[float, float]:
    """What the law of UAV u, vehicle v, wants [m/s²]; before the first detection it stays where it is."""
    law, tick = unpack_law(t.laws[u], s.keys[k, v]), s.batch.ticks[k]
    position, velocity = s.batch.truth.position[k], s.batch.truth.velocity[k]
    known, g_x, g_y = kalman_estimate(_kalman_of(s.kalman, k, u))
    if not known:
        return brake(velocity[v, 0], velocity[v, 1], law.u_max, law.dt)
    return bounded_uav_control(
        law,
        OwnTerms(1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        s.maps[k, u] if p.own_maps else s.batch.truth.coverage[k],
        s.laws[k, u],
        tick,
        position[v, 0],
        position[v, 1],
        velocity[v, 0],
        velocity[v, 1],
        g_x,
        g_y,
    )


@inlined
def _fly(p: LoopParameters, t: LoopTables, s: LoopState, k: int, v: int, u: int, actions: FloatArray) -> None:
    """The command of UAV u, vehicle v, and what it radios."""
    tick, seat = s.batch.ticks[k], s.uav_seats[k, u]
    position, velocity = s.batch.truth.position[k], s.batch.truth.velocity[k]
    if t.hand[v] >= 0:
        u_x, u_y = actions[t.hand[v], 0], actions[t.hand[v], 1]
    else:
        u_x, u_y = _wanted(p, t, s, k, v, u)
    if t.guarded[u]:
        promise = unpack_promise(t.promises[u])
        u_x, u_y, acts, code, seat[BOUND] = guard(
            promise,
            _guard_of(t, s.guards, k, u),
            tick,
            position[v, 0],
            position[v, 1],
            velocity[v, 0],
            velocity[v, 1],
            u_x,
            u_y,
        )
        seat[ACTED] = 1.0 if acts != INNER else 0.0
        seat[SURE] = 1.0 if code == NOTHING_AGAINST and t.faults[u] == 0 else 0.0
        seat[SHIELDED] += 1.0
        seat[INTERVENED] += seat[ACTED]
        seat[CERTIFIED_TICKS] += seat[SURE]
    s.commands[k, v, 0], s.commands[k, v, 1] = u_x, u_y
    if p.radio:
        known, g_x, g_y = kalman_estimate(_kalman_of(s.kalman, k, u))
        says = known and tick % p.radio_ticks == 0
        s.outbox[k, u, _PENDING] = 1.0 if says else 0.0
        s.outbox[k, u, _SENT_X], s.outbox[k, u, _SENT_Y] = position[v, 0] - g_x, position[v, 1] - g_y


@inlined
def _drive(p: LoopParameters, t: LoopTables, s: LoopState, k: int, v: int, g: int, actions: FloatArray) -> None:
    """The command of UGV g, vehicle v."""
    if t.hand[v] >= 0:
        s.commands[k, v, 0], s.commands[k, v, 1] = actions[t.hand[v], 0], actions[t.hand[v], 1]
        return
    tick, position, velocity = s.batch.ticks[k], s.batch.truth.position[k], s.batch.truth.velocity[k]
    s.commands[k, v, 0], s.commands[k, v, 1] = ugv_control(
        unpack_driver(t.drivers[g], s.keys[k, v]),
        t.goals[t.goal_rows[g] : t.goal_rows[g + 1]],
        t.scripts[t.script_rows[g] : t.script_rows[g + 1]],
        s.drivers[k, g],
        s.heard[k, g],
        s.hearing[k, g],
        tick,
        tick * p.w.dt,
        position[v, 0],
        position[v, 1],
        velocity[v, 0],
        velocity[v, 1],
    )


@inlined
def _listen(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """What the UAVs have said at the tick before sets out, and what has arrived is heard."""
    tick, seed, hearing = s.batch.ticks[k], s.batch.seeds[k], s.hearing[k]
    hearing[:] = 0
    for u in range(t.listeners.shape[0]):
        g, outbox, message = t.listeners[u], s.outbox[k, u], s.batch.message[k]
        heard = s.heard[k, g]
        if p.perfect_radio:
            if outbox[_PENDING] != 0.0:
                n = hearing[g]
                heard[n, 0], heard[n, 1], heard[n, 2] = (tick - 1) * p.w.dt, outbox[_SENT_X], outbox[_SENT_Y]
                hearing[g] = n + 1
            continue
        ways, link = parameters_of(t.ways, u), link_of(s.ways, k, u)
        advance_link(ways, link, seed, t.ways.ids[u], tick)
        if outbox[_PENDING] != 0.0:
            message[0], message[1], message[2] = tick - 1, outbox[_SENT_X], outbox[_SENT_Y]
            send(ways, link, seed, t.ways.ids[u], message)
        inbox = s.inbox[k]
        for i in range(receive(link, inbox)):
            n = hearing[g]
            heard[n, 0], heard[n, 1], heard[n, 2] = inbox[i, 0] * p.w.dt, inbox[i, 1], inbox[i, 2]
            hearing[g] = n + 1
        outbox[_PENDING] = 0.0


@inlined
def _perceive(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Every UAV takes what has reached it at this tick into its map and its filters; the UGVs listen."""
    w, escorts, tick = p.w, t.batch.escorts, s.batch.ticks[k]
    position, looks, arrived = s.batch.truth.position[k], s.batch.looks[k], s.batch.arrived[k]
    for u in range(escorts.shape[0]):
        x, y = position[escorts[u, 0], 0], position[escorts[u, 0], 1]
        if p.own_maps and tick > 0:
            accumulate(s.maps[k, u], x, y, w.sensor, w.peak, w.reach, w.cell, w.dt)
        if t.guarded[u]:
            promise, memory = unpack_promise(t.promises[u]), _guard_of(t, s.guards, k, u)
            note_position(memory, tick, x, y)
            for n in range(arrived[u]):
                taken = int(looks[u, n, TAKEN])
                note_detection(promise, memory, taken, tick, looks[u, n, LOOK_X], looks[u, n, LOOK_Y], x, y)
        if t.thinking[u]:
            kalman_step(unpack_kalman(t.kalman[u]), _kalman_of(s.kalman, k, u), tick, x, y, looks[u], arrived[u])
    if p.radio:
        _listen(p, t, s, k)


@inlined
def _seat_uav(p: LoopParameters, t: LoopTables, s: LoopState, k: int, u: int) -> None:
    """How UAV u truly stands at this tick, and the newest detection that has reached it."""
    w, truth, seat = p.w, s.batch.truth, s.uav_seats[k, u]
    a, g = t.batch.escorts[u, 0], t.batch.escorts[u, 1]
    position = truth.position[k]
    distance = norm(position[a, 0] - position[g, 0], position[a, 1] - position[g, 1])
    lost = distance >= w.r_v
    seat[WAS_LOST], seat[LOST] = seat[LOST], 1.0 if lost else 0.0
    seat[DISTANCE], seat[MAX_DISTANCE] = distance, max(seat[MAX_DISTANCE], distance)
    seat[VIOLATIONS] += seat[LOST]
    if p.error:
        seat[ERROR] = coverage_error(truth.coverage[k], position[g, 0], position[g, 1], w.r_o, w.desired, w.cell)
        seat[ERROR_SUM] += seat[ERROR]
    looks = s.batch.looks[k, u]
    for n in range(s.batch.arrived[k, u]):
        seat[NEWEST] = max(seat[NEWEST], looks[n, TAKEN])


@inlined
def _observe_uav(p: LoopParameters, t: LoopTables, s: LoopState, k: int, u: int) -> None:
    """Write the row of UAV u."""
    w, truth, tick, row = p.w, s.batch.truth, s.batch.ticks[k], s.uav_rows[k, u]
    a, time, looks = t.batch.escorts[u, 0], tick * w.dt, s.batch.looks[k, u]
    x, y = truth.position[k, a, 0], truth.position[k, a, 1]
    row[0], row[1], row[2], row[3], row[4] = time, x, y, truth.velocity[k, a, 0], truth.velocity[k, a, 1]
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
    row[0], row[1], row[2] = s.batch.ticks[k] * p.w.dt, truth.position[k, v, 0], truth.position[k, v, 1]
    row[3], row[4] = truth.velocity[k, v, 0], truth.velocity[k, v, 1]
    row[5], row[6], row[7] = 1.0 if reached < last else 0.0, 0.0, 0.0
    if last > first:
        goal = min(reached, last - 1)
        row[6], row[7] = t.goals[goal, 0], t.goals[goal, 1]


@inlined
def _pay(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Whether the episode is over, and everybody's reward of this tick."""
    w, r, truth, any_lost, goals_left, goals_given = p.w, t.weights, s.batch.truth, False, 0, 0
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
            nearer, goal, effort = ugv_terms(r[4], r[5], r[6], seat[NEARER], int(seat[ARRIVALS]), u_x, u_y, w.dt)
            s.rewards[k, v] = 0.0 + nearer + goal + effort


@inlined
def _observe(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Everybody's row, and the UAVs' pictures."""
    w, position, escorts = p.w, s.batch.truth.position[k], t.batch.escorts
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
def _begin(p: LoopParameters, t: LoopTables, s: LoopState, k: int, seed: int) -> None:
    """World k, whose arrays are as they are at the start, takes its seed; everybody has a first look."""
    begin_world(p.w, t.batch, s.batch, k, seed)
    for v in range(t.place.shape[0]):
        s.keys[k, v] = pilot_key(seed, v)
    for g in range(t.ugv_rows.shape[0]):
        v, seat, goals = t.ugv_rows[g], s.ugv_seats[k, g], t.goals[t.goal_rows[g] : t.goal_rows[g + 1]]
        x, y = s.batch.truth.position[k, v, 0], s.batch.truth.position[k, v, 1]
        seat[REACHED], seat[TO_GO] = turn(goals, 0, t.tolerances[g], x, y)
        seat[ARRIVALS] = seat[REACHED]


@inlined
def _step(p: LoopParameters, t: LoopTables, s: LoopState, k: int, actions: FloatArray) -> None:
    """Everybody answers, and world k advances by one tick."""
    for v in range(t.place.shape[0]):
        if t.place[v] >= 0:
            _fly(p, t, s, k, v, t.place[v], actions)
        else:
            _drive(p, t, s, k, v, -1 - t.place[v], actions)
    step_world(p.w, t.batch, s.batch, k, s.commands[k])


@inlined
def _fetch(p: LoopParameters, t: LoopTables, s: LoopState, k: int) -> None:
    """Bring the part of world k's grid that its next tick will touch near the core."""
    w, position, coverage = p.w, s.batch.truth.position[k], s.batch.truth.coverage[k]
    for u in range(t.batch.escorts.shape[0]):
        a, g = t.batch.escorts[u, 0], t.batch.escorts[u, 1]
        if p.error:
            fetch_disc(coverage, position[g, 0], position[g, 1], w.r_o, w.cell)
        fetch_disc(coverage, position[a, 0], position[a, 1], w.reach, w.cell)
        if p.own_maps:
            fetch_disc(s.maps[k, u], position[a, 0], position[a, 1], w.reach, w.cell)


@released
def _run_worlds(
    p: LoopParameters,
    t: LoopTables,
    s: LoopState,
    worlds: IntArray,
    seeds: IntArray,
    actions: FloatArray,
    ticks: int,
    begin: int,
    end: int,
) -> None:
    """Begin these worlds, if there are seeds for them, or fly each on for so many ticks or to the end of its episode.

    World by world, so that a grid stays near its core for a whole flight. One function for all, as each compiles for long.
    """
    for n in range(begin, end):
        k, beginning = worlds[n], seeds.shape[0] > 0
        if n + 1 < end:
            _fetch(p, t, s, worlds[n + 1])
        if beginning:
            _begin(p, t, s, k, seeds[n])
        for tick in range(1 if beginning else ticks):
            if not beginning:
                if tick > 0 and (s.terminated[k] or s.truncated[k]):
                    break
                _step(p, t, s, k, actions[k])
            _perceive(p, t, s, k)
            for u in range(t.batch.escorts.shape[0]):
                _seat_uav(p, t, s, k, u)
            if not beginning:
                for g in range(t.ugv_rows.shape[0]):
                    _seat_ugv(p, t, s, k, g)
                _pay(p, t, s, k)
            if tick == ticks - 1 or s.terminated[k] or s.truncated[k] or beginning:
                _observe(p, t, s, k)


def _repeated(state: tuple[npt.NDArray[Any], ...], worlds: int, of_each: int) -> list[npt.NDArray[Any]]:
    """The arrays of one memory for each of `of_each` vehicles in each world."""
    return [np.broadcast_to(array, (worlds, of_each, *array.shape)).copy() for array in state]


def _joined(arrays: Sequence[FloatArray], columns: int) -> tuple[FloatArray, IntArray]:
    """Arrays one after the other, and where each begins."""
    edges = np.cumsum([0, *(len(array) for array in arrays)]).astype(np.int64)
    return np.concatenate([np.zeros((0, columns)), *arrays]), edges


def pilot_names(scenario: Scenario, vehicle: str) -> tuple[str, ...]:
    """Who can fly or drive a vehicle in here, by name."""
    if any(uav.name == vehicle for uav in scenario.uav):
        return tuple(name for name, code in LAWS.items() if code not in (WEIGHTED, PATH))
    return tuple(COMPILED_DRIVERS)


class ClosedLoop:
    """Many worlds of one scenario with everybody in them.

    Args:
        scenario: What is flown in each.
        worlds: How many.
        external: Vehicles whose actions come from outside, in the order of the actions.
        pilots: Who flies or drives the others, by name, instead of the scenario's law and drivers.
        rewards: What the vehicles are paid for; e(t) is computed at every tick only if `uncovered` is paid, or `error` is set.
        error: Whether e(t) is computed at every tick in any case.
        estimate: Whether the UAVs' rows have the filter's estimate in the place of the raw detection.
        gradient: Whether the UAVs' rows end with `GradientCue`.
        patch: Pictures of the UAVs' own maps.
        safety_filter: Whether actions from outside go through the safety filter, as those of the law `certified` do.
        end_on_sight_lost: Whether an episode terminates when sight is lost.
        end_on_goals_reached: Whether it terminates when every UGV with goals has reached them all.
        threads: Processor cores that share the worlds; by default all that this process may use.

    Raises:
        ScenarioError: If a vehicle has a law or a driver that cannot be flown in here.
        ValueError: If another argument is not allowed.
    """

    def __init__(
        self,
        scenario: Scenario,
        worlds: int,
        *,
        external: Collection[str] = (),
        pilots: Mapping[str, str] | None = None,
        rewards: RewardWeights | None = None,
        error: bool = False,
        estimate: bool = False,
        gradient: bool = False,
        patch: CoveragePatch | None = None,
        safety_filter: bool = False,
        end_on_sight_lost: bool = True,
        end_on_goals_reached: bool = False,
        threads: int | None = None,
    ) -> None:
        self.scenario = scenario
        self.worlds = worlds
        self.names = tuple(vehicle.name for vehicle in scenario.vehicles)
        """Vehicles in the order of every array."""
        self.uavs = tuple(name for name in self.names if name in {uav.name for uav in scenario.uav})
        """UAVs in the order of theirs."""
        self.ugvs = tuple(name for name in self.names if name not in self.uavs)
        """UGVs in the order of theirs."""
        self.external = tuple(external)
        """Whose actions come from outside."""
        weights = rewards or RewardWeights()
        numbers = [getattr(weights, name) for name in _WEIGHTS]
        chosen = dict(pilots or {})
        for name in (*self.external, *chosen):
            if name not in self.names:
                raise ValueError(f"vehicle = {name!r}; allowed: {', '.join(self.names)}")
        crew = _Crew(scenario, self.uavs, self.ugvs, set(self.external), chosen, shield=safety_filter)
        self.batch = Batch(scenario, worlds, gains=weights.seen > 0.0, threads=threads)
        ways = self._ways = BatchLinks(scenario, LinkKind.RADIO, 3, worlds)
        listening = crew.radio
        thinking = crew.thinking | (estimate or gradient or listening)
        dt = scenario.dt
        self.parameters = LoopParameters(
            w=self.batch.parameters,
            ticks=scenario.ticks,
            error=error or weights.uncovered > 0.0,
            estimate=estimate,
            gradient=gradient,
            end_on_sight_lost=end_on_sight_lost,
            end_on_goals=end_on_goals_reached,
            own_maps=len(self.uavs) > 1,
            radio=listening,
            perfect_radio=ways.perfect,
            radio_ticks=max(1, round(RADIO_PERIOD / dt)),
            full=full_error(scenario.visibility.radius + scenario.sensor.range, scenario.coverage.desired),
            meters_per_pixel=float(patch.meters_per_pixel) if patch else 1.0,
        )
        goals, goal_rows = _joined(crew.goals, 2)
        scripts, script_rows = _joined(crew.scripts, 3)
        index = {name: k for k, name in enumerate(self.names)}
        self.tables = LoopTables(
            batch=self.batch.tables,
            place=np.array(
                [self.uavs.index(n) if n in self.uavs else -1 - self.ugvs.index(n) for n in self.names], dtype=np.int64
            ),
            hand=np.array([self.external.index(n) if n in self.external else -1 for n in self.names], dtype=np.int64),
            ugv_rows=np.array([index[n] for n in self.ugvs], dtype=np.int64),
            thinking=thinking.astype(np.int64),
            guarded=crew.guarded.astype(np.int64),
            faults=crew.faults.astype(np.int64),
            delays=crew.delays,
            listeners=np.array([self.ugvs.index(self.names[g]) for g in self.batch.tables.escorts[:, 1]], dtype=np.int64),
            laws=crew.laws,
            kalman=crew.kalman,
            promises=crew.promises,
            drivers=crew.drivers,
            tolerances=np.array([ugv.goal_tolerance for ugv in crew.told_ugvs], dtype=np.float64),
            goals=goals,
            goal_rows=goal_rows,
            scripts=scripts,
            script_rows=script_rows,
            weights=np.array(numbers, dtype=np.float64),
            ways=ways.table,
        )
        late = self.batch.ways_in.longest
        kalman = kalman_state(min(late, round(SPAN / dt)) + 1)
        guards = guard_state(crew.slowest, min(late + 1, max(1, math.ceil(_TRACK / dt))))
        uavs, ugvs, vehicles = len(self.uavs), len(self.ugvs), len(self.names)
        room = ways.room * uavs if listening else 1
        coverage = self.batch.state.truth.coverage
        pixels = patch.pixels if patch else 1
        self.state = LoopState(
            batch=self.batch.state,
            maps=np.zeros((worlds, uavs if self.parameters.own_maps else 0, *coverage.shape[1:])),
            keys=np.zeros((worlds, vehicles), dtype=np.int64),
            commands=np.zeros((worlds, vehicles, 2)),
            laws=np.zeros((worlds, uavs, STATE_SIZE)),
            kalman=KalmanState._make(_repeated(kalman, worlds, uavs)),
            guards=GuardState._make(_repeated(guards, worlds, uavs)),
            drivers=_repeated((fresh_driver_state(),), worlds, ugvs)[0],
            outbox=np.zeros((worlds, uavs, 3)),
            ways=ways.states,
            inbox=np.zeros((worlds, ways.room if listening else 1, 3)),
            heard=np.zeros((worlds, ugvs, room, 3)),
            hearing=np.zeros((worlds, ugvs), dtype=np.int64),
            uav_seats=np.zeros((worlds, uavs, BOUND + 1)),
            ugv_seats=np.zeros((worlds, ugvs, TO_GO + 1)),
            uav_rows=np.zeros((worlds, uavs, UAV_ROW)),
            ugv_rows=np.zeros((worlds, ugvs, len(UgvRow._fields))),
            patches=np.zeros((worlds, uavs if patch else 0, pixels, pixels)),
            rewards=np.zeros((worlds, vehicles)),
            terminated=np.zeros(worlds, dtype=np.int64),
            truncated=np.zeros(worlds, dtype=np.int64),
        )
        self.state.uav_seats[:, :, NEWEST] = -1.0
        if self.parameters.own_maps:
            self.state.maps[:] = first_state(scenario).coverage
        self._fresh = Fresh(self.state[1:])  # all but the batch, which knows its own
        self._all = np.arange(worlds)
        with compiling():  # one process does, the others wait
            self.begin([scenario.seed], [0])

    @property
    def degraded(self) -> bool:
        """Whether any link does anything to a message."""
        return not (self.batch.ways_in.perfect and self.batch.ways_out.perfect and self._ways.perfect)

    def begin(self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None = None) -> None:
        """Begin worlds anew.

        Args:
            seeds: One for each of them, from 0 to 2**53 - 1.
            worlds: Which; all by default.
        """
        which = np.arange(self.worlds) if worlds is None else np.asarray(worlds, dtype=np.int64)
        given = np.asarray(seeds, dtype=np.int64)
        if given.shape != which.shape:
            raise ValueError(f"{given.size} seeds for {which.size} worlds")
        self.batch.fresh.restore(which)
        self._fresh.restore(which)
        self._run(which, given, _NO_ACTIONS, 0)

    def step(self, actions: FloatArray) -> None:
        """All worlds advance by one tick.

        Args:
            actions: Accelerations [m/s²] of the vehicles in `external`, finite. Shape (worlds, len(external), 2).
        """
        self._run(self._all, _NO_SEEDS, actions, 1)

    def fly(self, ticks: int | None = None) -> None:
        """Fly every world on, each until its episode is over, or so many ticks.

        Raises:
            ValueError: If actions are to come from outside.
        """
        if self.external:
            raise ValueError(f"the actions of {', '.join(self.external)} come from outside: use step")
        none, most = np.zeros((self.worlds, 0, 2)), self.scenario.ticks if ticks is None else ticks
        self._run(self._all, _NO_SEEDS, none, most)

    def _run(self, worlds: IntArray, seeds: IntArray, actions: FloatArray, ticks: int) -> None:
        self.batch.crew.share(_run_worlds, len(worlds), self.parameters, self.tables, self.state, worlds, seeds, actions, ticks)

    def metrics(self, uav: str) -> dict[str, FloatArray]:
        """How a UAV has truly done in this episode, in each world; arrays of shape (worlds,).

        `mean_error` is the mean of e(t) [m²] over the ticks so far, the first included; NaN where e(t) is not computed.
        """
        seats, ticks = self.state.uav_seats[:, self.uavs.index(uav)], self.state.batch.ticks
        shielded = np.maximum(seats[:, SHIELDED], 1.0)
        counted = np.where(self.parameters.error, 1.0, np.nan)
        return {
            "ticks": ticks.astype(np.float64),
            "distance": seats[:, DISTANCE].copy(),
            "max_distance": seats[:, MAX_DISTANCE].copy(),
            "visibility_violations": seats[:, VIOLATIONS].copy(),
            "coverage_error": seats[:, ERROR] * counted,
            "mean_error": seats[:, ERROR_SUM] / (ticks + 1) * counted,
            "intervened": seats[:, INTERVENED] / shielded,
            "certified": seats[:, CERTIFIED_TICKS] / shielded,
        }

    def links(self, world: int) -> dict[str, LinkStatus]:
        """How each link of one world has done so far, by `vehicle/kind`."""
        radio = {f"{name}/{LinkKind.RADIO}": one for name, one in self._ways.status(world).items()}
        return self.batch.links(world) | radio

    def bytes_per_world(self) -> int:
        """Memory that one more world needs [bytes]."""
        return sum(array.nbytes for array in arrays_of(self.state)) // self.worlds

    def close(self) -> None:
        """End the threads."""
        self.batch.crew.close()


_WEIGHTS = ("uncovered", "seen", "sight_lost", "out_of_sight", "progress", "goal", "effort")
"""The order of `LoopTables.weights`."""


class _Crew:
    """The pilots' numbers in tables."""

    def __init__(
        self,
        scenario: Scenario,
        uavs: Sequence[str],
        ugvs: Sequence[str],
        external: set[str],
        chosen: Mapping[str, str],
        *,
        shield: bool,
    ) -> None:
        told = {name: briefing(scenario, name, 0) for name in (*uavs, *ugvs)}
        told_uavs = [one for name in uavs if isinstance(one := told[name], UavBriefing)]
        self.told_ugvs = [one for name in ugvs if isinstance(one := told[name], UgvBriefing)]
        laws = [self._law(one, chosen.get(one.vehicle), outside=one.vehicle in external) for one in told_uavs]
        promises = [promise_of(one) for one in told_uavs]
        self.laws = np.stack([pack_law(law) for law in laws])
        self.slowest = max(promises, key=lambda promise: promise.delay)
        self.delays = np.array([round(promise.delay / promise.dt) for promise in promises], dtype=np.int64)
        self.promises = np.stack([pack_promise(promise) for promise in promises])
        self.faults = np.array([bool(check_assumptions(promise)) for promise in promises])
        self.kalman = np.stack(
            [
                pack_kalman(kalman_parameters(detector=one.detector, target=one.target_limits, dt=one.dt, settings=one.estimator))
                for one in told_uavs
            ]
        )
        outside = np.array([name in external for name in uavs])
        self.guarded = np.array([law.law == CERTIFIED for law in laws]) & ~outside | outside & shield
        self.thinking = ~outside
        drivers = [self._driver(one, chosen.get(one.vehicle), outside=one.vehicle in external) for one in self.told_ugvs]
        self.drivers = np.stack(
            [pack_driver(driver_parameters(one, name)) for one, name in zip(self.told_ugvs, drivers, strict=True)]
        )
        self.goals = [driver_goals(one) for one in self.told_ugvs]
        self.scripts = [driver_script(one) for one in self.told_ugvs]
        self.radio = any(
            name == "evade" and one.vehicle not in external for name, one in zip(drivers, self.told_ugvs, strict=True)
        )

    @staticmethod
    def _law(told: UavBriefing, name: str | None, *, outside: bool) -> LawParameters:
        law = told.law if name is None else msgspec.structs.replace(told.law, name=name)
        if outside:
            law = msgspec.structs.replace(law, name="tracking")  # never asked
        elif law.name in ("weighted", "path"):
            raise ScenarioError(f"{told.vehicle}: law.name = {law.name!r} is a function of your own and cannot be compiled")
        return law_parameters(told, law)

    @staticmethod
    def _driver(told: UgvBriefing, name: str | None, *, outside: bool) -> str:
        return "waypoints" if outside else name or told.driver
