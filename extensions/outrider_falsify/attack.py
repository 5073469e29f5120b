"""An attack on the certificate.

The project's own world, links and counting, the UAV's filter, and adversaries in everything else.

The adversary knows the truth and the code. It is the inner control, the UGV, the errors of the detections, which of
them are made at all, and what becomes of commands. Everything is drawn from the seed and the run's number, so any run
can be flown again alone.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.control.tracking import tracking_output, tracking_step
from agents.safety.decision import CERTIFIED, NOMINAL, decide
from agents.safety.discs import KEPT, NEVER, bound_of, certified_distance, newest_disc
from agents.safety.memory import (
    FilterMemory,
    add_measurement,
    add_position,
    filter_memory,
    invalidate_plans,
    reset_memory,
)
from bus.messages.links import LinkKind
from bus.ticks import DUST
from outrider_falsify.conditions import (
    ANY,
    AREAS,
    BLACKOUTS,
    DISTURBANCES,
    ERRORS,
    GUARDS,
    INNERS,
    UGVS,
    WINDS,
    Conditions,
    scenario_of,
)
from outrider_falsify.draws import Words, next_share
from outrider_falsify.lost_motions import ALIVE, LOSSES, Pending, loses
from outrider_falsify.opponents import (
    UAV,
    UGV,
    Plot,
    choose,
    detection_error,
    direction,
    disturb,
    draw_creep,
    draw_direction,
    inner_command,
    jump,
    redraw,
    ugv_command,
)
from outrider_falsify.tick_distance import largest_between
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, compiled, released
from sim.compiling.records import RecordArray, record_type
from sim.engine.batch import Batch
from sim.engine.monitor import NEVER as NEVER_SEEN
from sim.engine.monitor import (
    Claim,
    certificate_counters,
    record_arrival,
    record_decision,
    record_end,
    record_interval,
    reset_counters,
    reset_filter,
)
from sim.engine.world_state import (
    BatchState,
    BatchTables,
)
from sim.engine.world_tick import (
    begin_world,
    deliver_detections,
    move,
    receive_commands,
)
from sim.models.motion import keep_motion
from sim.models.randomness import FIRST, draw
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion, clip_norm, norm

_ATTACK = 1001  # purpose of the draws
_RING = 8
"""Commands that are remembered: so many ticks at most are they late."""
_A_C, _B_C, _C_C, _D_C = -3.0, -3.0, -8.0 / 3.0, -3.0  # (15) with the paper's closed loop (s + 1)^3


class AttackResult(NamedTuple):
    """The columns of what is found, a row each run."""

    max_distance: float
    """Largest distance [m]."""
    max_excess: float
    """Largest d - d_cert [m]."""
    intervened: float
    """Share of ticks with an intervention."""
    uncertified: float
    """Share of the ticks since the first detection arrived that are not certified."""
    mean_distance: float
    """[m]"""
    max_age: float
    """Largest age of the newest detection [s]."""
    certified_lost: float
    """Ticks certified with a distance of r_v or more at them or, if A5' holds, until the next."""
    broken: float
    """Ticks at which the certificate is lost although its assumptions hold, as the simulator counts them."""
    max_certified: float
    """Largest distance while certified [m]."""


class Trouble(NamedTuple):
    """The trouble that the adversary makes now, in ticks; a row of an array of one."""

    dark: int
    """For so long nothing is detected yet."""
    seen: int
    """1 if there was a detection in the last tick."""
    silent: int
    """For so long no command comes yet."""
    late: int
    """Commands set out so much later than they should."""
    away: int
    """For so long the UAV's process is away yet."""


class Room(NamedTuple):
    """The memory of a run, beside the world's and the filter's; arrays that change in place."""

    plots: RecordArray
    """`Plot`. (2,)"""
    trouble: RecordArray
    """`Trouble`. (1,)"""
    before: RecordArray
    now: RecordArray
    """`Motion` of UAV and UGV as they truly are, at the last tick and now. (2,)"""
    ring: FloatArray
    """The commands of the last ticks [m/s²], and 1 for each that carries a motion. (_RING, 3)"""
    counts: RecordArray
    """`CertificateCounters`. (1,)"""


def empty_room() -> Room:
    """Room for runs, one after the other."""
    return Room(
        plots=np.zeros(2, record_type(Plot)),
        trouble=np.zeros(1, record_type(Trouble)),
        before=np.zeros(2, record_type(Motion)),
        now=np.zeros(2, record_type(Motion)),
        ring=np.zeros((_RING, 3)),
        counts=certificate_counters(1),
    )


@compiled
def _keep_states(state: BatchState, states: RecordArray) -> None:
    for k in range(states.shape[0]):
        row, vehicle = states[k], state.vehicles[0, k]
        row.p_x, row.p_y = vehicle.position[0], vehicle.position[1]
        row.v_x, row.v_y = vehicle.velocity[0], vehicle.velocity[1]


@compiled
def _place(conditions: Conditions, tables: BatchTables, state: BatchState, random: Words) -> None:
    """Put UGV and UAV where the run begins, and let the UAV move where the conditions ask for it."""
    parameters, vehicles = tables.world[0], state.vehicles
    if conditions.start_speed > 0.0:
        speed = conditions.start_speed * vehicles[0, UAV].max_speed
        e_x, e_y = draw_direction(random)
        vehicles[0, UAV].velocity[0], vehicles[0, UAV].velocity[1] = speed * e_x, speed * e_y
    if conditions.area == AREAS.open:
        vehicles[0, UGV].position[0], vehicles[0, UGV].position[1] = (
            0.5 * parameters.width,
            0.5 * parameters.height,
        )
    elif conditions.area == AREAS.wall:
        _place_at_wall(conditions, parameters.width, state, random)
        return
    elif conditions.area == AREAS.corner:
        vehicles[0, UGV].position[0] = conditions.r_v * next_share(random)
        vehicles[0, UGV].position[1] = conditions.r_v * next_share(random)
    else:
        vehicles[0, UGV].position[0] = parameters.width * next_share(random)
        vehicles[0, UGV].position[1] = parameters.height * next_share(random)
    e_x, e_y = draw_direction(random)
    far = conditions.r_v * (0.1 if next_share(random) < 0.5 else 0.5)
    vehicles[0, UAV].position[0] = min(
        max(vehicles[0, UGV].position[0] + far * e_x, 0.0), parameters.width
    )
    vehicles[0, UAV].position[1] = min(
        max(vehicles[0, UGV].position[1] + far * e_y, 0.0), parameters.height
    )


@compiled
def _place_at_wall(conditions: Conditions, width: float, state: BatchState, random: Words) -> None:
    """Put UGV and UAV on the wall y = 0, some in its corner, or between a picometre and ten micrometres from it.

    Half of the UAVs start with a velocity as small as what rounding leaves.
    """
    vehicles = state.vehicles
    corner = next_share(random) < 0.25
    vehicles[0, UGV].position[0] = 0.0 if corner else 0.5 * width
    far = conditions.r_v * (next_share(random) - 0.5)
    vehicles[0, UAV].position[0] = abs(far) if corner else 0.5 * width + far
    for k in (UGV, UAV):
        off = 10.0 ** (7.0 * next_share(random) - 12.0)
        vehicles[0, k].position[1] = off if next_share(random) < 0.5 else 0.0
        if corner and next_share(random) < 0.5:
            vehicles[0, k].position[0] = 10.0 ** (7.0 * next_share(random) - 12.0)
    if next_share(random) < 0.5:
        vehicles[0, UAV].velocity[0], vehicles[0, UAV].velocity[1] = draw_creep(random)


@compiled
def _begin_plots(room: Room, random: Words, u_a: float, u_g: float) -> None:
    """Let the adversaries begin, who may accelerate so much [m/s²]."""
    plots, trouble, ring = room.plots, room.trouble[0], room.ring
    redraw(random, plots, UAV, u_a)
    redraw(random, plots, UGV, u_g)
    for k in (UAV, UGV):
        plots[k].output_x, plots[k].output_y = 0.0, 0.0
        plots[k].heading_x, plots[k].heading_y = 0.0, 0.0
        plots[k].error_x, plots[k].error_y, plots[k].wind = 0.0, 0.0, 0.0
    plots[UAV].heading_x, plots[UAV].heading_y = draw_creep(random)
    plots[UGV].heading_x, plots[UGV].heading_y = draw_direction(random)
    plots[UGV].error_x, plots[UGV].error_y = draw_direction(random)
    plots[UAV].losing = ALIVE
    trouble.dark, trouble.seen = 0, 1
    trouble.silent, trouble.late, trouble.away = 0, 0, 0
    ring[:] = 0.0


@compiled
def _switch_command(
    conditions: Conditions,
    bounds: SafetyBounds,
    discs: RecordArray,
    plots: RecordArray,
    tick: int,
    here: Motion,
    z_x: float,
    z_y: float,
) -> tuple[float, float]:
    """The command of a law that switches, beyond its radius [m/s²]; z is p_a - p_g of the newest detection [m]."""
    if conditions.law >= GUARDS.switch_tracking:
        return clip_norm(plots[UAV].output_x, plots[UAV].output_y, bounds.u_a)
    if conditions.law == GUARDS.switch_best:
        least = math.inf
        for k in range(KEPT):
            if discs[k].tick == NEVER:
                continue
            r = bound_of(bounds, discs, k, tick, here.p_x, here.p_y)
            if r < least:
                least = r
                z_x, z_y = here.p_x - discs[k].x, here.p_y - discs[k].y
    e_x, e_y = direction(z_x, z_y)
    return clip_norm(
        (-bounds.v_a * e_x - here.v_x) / bounds.dt,
        (-bounds.v_a * e_y - here.v_y) / bounds.dt,
        bounds.u_a,
    )


@compiled
def _delay_command(conditions: Conditions, room: Room, random: Words, tick: int, dt: float) -> int:
    """Return the tick whose command sets out in this one; -1: none does."""
    trouble = room.trouble[0]
    if conditions.disturbance == DISTURBANCES.single_losses and next_share(random) < 0.02:
        return -1
    if conditions.disturbance == DISTURBANCES.silences:
        if trouble.silent == 0 and next_share(random) < 0.02:
            trouble.silent = 1 + int(next_share(random) * max(1, round(conditions.silence / dt)))
        if trouble.silent > 0:
            trouble.silent -= 1
            return -1
    if conditions.disturbance == DISTURBANCES.late:
        if next_share(random) < 0.01:
            trouble.late = int(next_share(random) * 6)
        return int(max(-1, tick - trouble.late))
    return tick


@compiled
def _darken(
    conditions: Conditions, bounds: SafetyBounds, room: Room, random: Words, tick: int
) -> None:
    """Begin a blackout now and then, with a detection at least since the last one."""
    trouble, now, longest = room.trouble[0], room.now, round(conditions.blackout_time / bounds.dt)
    if trouble.dark > 0 or trouble.seen == 0 or tick <= 20 or longest == 0:
        return
    if conditions.blackout == BLACKOUTS.periodic:
        trouble.dark = longest
    elif conditions.blackout == BLACKOUTS.random and next_share(random) < 0.02:
        trouble.dark = 1 + int(next_share(random) * longest)
    elif conditions.blackout == BLACKOUTS.when_far:
        x, y = now[UAV].p_x - now[UGV].p_x, now[UAV].p_y - now[UGV].p_y
        if norm(x, y) > 0.6 * conditions.r_v and next_share(random) < 0.2:
            trouble.dark = longest


@released
def fly_one(
    tables: BatchTables,
    state: BatchState,
    memory: FilterMemory,
    room: Room,
    bounds: SafetyBounds,
    conditions: Conditions,
    random: Words,
    ticks: int,
    results: RecordArray,
) -> None:
    """One run of an attack, in world 0 of a batch that is as it was at the start, with its keys.

    Args:
        tables, state: The world. UAV 0 is vehicle 0, the UGV vehicle 1.
        memory: Of the filter.
        room: Of all else.
        bounds: Bounds of the filter.
        conditions: Who guards and who attacks.
        random: State of the adversary's draws. (1,)
        ticks: Length of the run.
        results: Filled: `AttackResult`. (1,)
    """
    uav_row, ugv_row, result = state.vehicles[0, UAV], state.vehicles[0, UGV], results[0]
    plots, trouble, before, now = room.plots, room.trouble[0], room.before, room.now
    counts = room.counts[0]
    dt, u_a, d_ticks = bounds.dt, bounds.u_a, bounds.delay_ticks
    u_g = conditions.u_g if math.isfinite(conditions.u_g) else 2.0 * bounds.v_g / dt
    inner = choose(random, conditions.inner, len(INNERS))
    ugv = choose(random, conditions.ugv, len(UGVS))
    error = choose(random, conditions.error, len(ERRORS))
    _begin_plots(room, random, u_a, u_g)
    rate = 0.05 + 1.5 * next_share(random)  # of the phase [rad/s]
    xc_x, xc_y = 0.0, 0.0
    _place(conditions, tables, state, random)
    if conditions.area == AREAS.wall and next_share(random) < 0.8:  # along the wall
        plots[UGV].heading_x = plots[UGV].side
        plots[UGV].heading_y = 1e-6 * next_share(random) if next_share(random) < 0.5 else 0.0
    for k in range(2):
        vehicle = state.vehicles[0, k]
        for i in range(2):
            vehicle.reference_position[i] = vehicle.position[i]
            vehicle.reference_velocity[i] = vehicle.velocity[i]
    disturbed, blows = tables.disturbances.shape[0] > 0, 0
    if disturbed:
        plots[UGV].wind = 2.0 * math.pi * next_share(random)
        blows = choose(random, conditions.blows, len(WINDS))
    reset_memory(memory)
    begin_world(tables, state, None, 0)
    filtering, first_seen, seen_ticks = True, -1, 0
    total, intervened, uncertified = 0.0, 0, 0
    reset_counters(counts)
    result.max_distance, result.max_excess, result.max_age = 0.0, -math.inf, 0.0
    result.certified_lost, result.broken, result.max_certified = 0.0, 0.0, 0.0
    _keep_states(state, now)
    losses = choose(random, conditions.losses, len(LOSSES))
    allowed = int(conditions.outage / dt + DUST)
    for tick in range(ticks + 1):
        there, moving = uav_row.reference_position, uav_row.reference_velocity
        here = Motion(there[0], there[1], moving[0], moving[1])
        w_x, w_y = now[UGV].v_x, now[UGV].v_y
        x, y = now[UAV].p_x - now[UGV].p_x, now[UAV].p_y - now[UGV].p_y
        d = norm(x, y)
        # what has reached the UAV's computer
        if trouble.away == 0:
            add_position(memory, tick, here.p_x, here.p_y)
            for n in range(state.links[0, 0].arrived):
                packet = state.packets[0, 0, ARRIVED, n]
                taken, (d_x, d_y) = int(packet.stamp), packet.vector
                record_arrival(bounds, counts, taken, packet.error)
                add_measurement(bounds, memory, taken, (d_x, d_y), tick, here)
        discs = memory.discs
        new = newest_disc(discs)
        bound = certified_distance(bounds, discs, tick, here.p_x, here.p_y)
        age = tick - discs[new].tick  # if there is any
        result.max_distance = max(result.max_distance, d)
        if new >= 0:
            result.max_excess = max(result.max_excess, d - bound)
            result.max_age = max(result.max_age, age * dt)
            first_seen = tick if first_seen < 0 else first_seen
        total += d
        # the adversary in the UAV
        if next_share(random) < 0.01:
            redraw(random, plots, UAV, u_a)
            if conditions.inner == ANY and next_share(random) < 0.3:
                inner = choose(random, conditions.inner, len(INNERS))
        z_x, z_y = 0.0, 0.0
        if new >= 0:
            z_x, z_y = here.p_x - discs[new].x, here.p_y - discs[new].y
        if inner == INNERS.tracking or conditions.law >= GUARDS.switch_tracking:
            o_x, o_y = tracking_output(xc_x, xc_y, z_x, z_y, _C_C, _D_C)
            plots[UAV].output_x, plots[UAV].output_y = o_x, o_y
            xc_x, xc_y = tracking_step(xc_x, xc_y, z_x, z_y, _A_C, _B_C, dt)
        u_x, u_y = inner_command(inner, x, y, here, z_x, z_y, rate * (tick * dt), plots, u_a)
        u_x, u_y = clip_norm(u_x, u_y, u_a)
        certified = carrying = reported = False
        if conditions.law == GUARDS.filter:
            if conditions.disturbance == DISTURBANCES.law_changes and next_share(random) < 0.01:
                filtering = not filtering
                if filtering:
                    reset_memory(memory)
                    reset_filter(counts)
                    add_position(memory, tick, here.p_x, here.p_y)
            leaves = conditions.disturbance == DISTURBANCES.rejoins and trouble.away == 0
            if leaves and next_share(random) < 0.005:
                trouble.away = 1 + int(next_share(random) * 20)
            if trouble.away > 0:
                trouble.away -= 1
                if trouble.away == 0:
                    invalidate_plans(memory)
            elif filtering:
                begun = state.flown[0, UAV, 0].begins
                decide(bounds, memory, tick, here, u_x, u_y, begun)
                decision = memory.decision[0]
                u_x, u_y = decision.acceleration[0], decision.acceleration[1]
                carrying = not conditions.bare
                certified = decision.reason == CERTIFIED
                overridden = decision.source != NOMINAL
                intervened += overridden
                said = Claim(certified, overridden, d >= conditions.r_v, True)
                record_decision(bounds, counts, tick, said)
                reported = True
        elif (
            new >= 0
            and (norm(z_x, z_y) if conditions.law == GUARDS.paper else bound) >= conditions.radius
        ):
            intervened += 1
            u_x, u_y = _switch_command(conditions, bounds, discs, plots, tick, here, z_x, z_y)
        counts.certified_before = counts.certified_before and reported
        if first_seen >= 0:
            seen_ticks += 1
            uncertified += not certified
        if certified:
            result.max_certified = max(result.max_certified, d)
        if tick == ticks:
            break
        # what becomes of the command
        sent = room.ring[tick % _RING]
        sent[0], sent[1], sent[2] = u_x, u_y, 1.0 if carrying else 0.0
        then = -1 if trouble.away > 0 else _delay_command(conditions, room, random, tick, dt)
        if carrying:
            held, under = memory.plan[0], memory.pending.sent
            left = held.turn + held.cruise + held.brake
            pending = Pending(tick, d_ticks, allowed, d / conditions.r_v, left)
            lost, plots[UAV].losing = loses(losses, random, plots[UAV].losing, pending)
            keep_motion(state.motions[0, UAV], under[(tick + d_ticks) % under.shape[0]], tick)
            then = -1 if lost else then
        sent, uav_row.outgoing_tick = room.ring[then % _RING], then
        uav_row.outgoing[0], uav_row.outgoing[1] = sent[0], sent[1]
        uav_row.outgoing_motion = then + d_ticks if sent[2] > 0.0 else -1
        uav_row.outgoing_motions = 1 if sent[2] > 0.0 else 0
        # the UGV
        if next_share(random) < 0.01:
            redraw(random, plots, UGV, u_g)
            if conditions.ugv == ANY and next_share(random) < 0.2:
                ugv = choose(random, conditions.ugv, len(UGVS))
        ugv_row.outgoing_tick = tick
        ugv_row.outgoing[0], ugv_row.outgoing[1] = ugv_command(
            ugv, x, y, here, w_x, w_y, plots, u_g
        )
        # the motion, as the world steps it, but that the adversary chooses which detections are made, and with
        # which error
        _keep_states(state, before)
        receive_commands(tables, state, 0)
        if disturbed:
            blows = disturb(conditions, state, random, blows, trouble.dark, x, y, plots)
        move(tables, state, None, 0)
        if conditions.jumps > 0.0:
            jump(conditions, state)
        _keep_states(state, now)
        x, y = now[UAV].p_x - now[UGV].p_x, now[UAV].p_y - now[UGV].p_y
        _darken(conditions, bounds, room, random, tick)
        n_x, n_y = detection_error(
            error, random, tick, bounds.max_measurement_error * conditions.error_share, x, y, plots
        )
        trouble.seen = 1 if trouble.dark == 0 else 0
        if trouble.dark > 0:
            trouble.dark -= 1
            n_x = math.nan
        found = uav_row.detection
        if not math.isnan(found[0]):
            found[0], found[1] = x - n_x, y - n_y
        deliver_detections(tables, state, 0)
        flown = state.flown[0, UAV, 0]
        bare = uav_row.command_tick if flown.plain == 1 else NEVER_SEEN
        record_interval(bounds, counts, tick, flown.begins, bare)
        if counts.interval_kept and certified:
            most = largest_between(before, now, dt)
            result.max_certified = max(result.max_certified, most)
            result.certified_lost += most >= conditions.r_v
    record_end(counts, d >= conditions.r_v)
    result.certified_lost += counts.certified_while_lost
    result.broken = counts.broken
    result.intervened, result.mean_distance = intervened / (ticks + 1), total / (ticks + 1)
    result.uncertified = uncertified / seen_ticks if seen_ticks else 1.0


def attack(
    bounds: SafetyBounds, conditions: Conditions, seed: int, first: int, runs: int, duration: float
) -> RecordArray:
    """Runs of an attack from `first` on.

    Args:
        bounds: Bounds of the filter.
        conditions: Who guards, who attacks, over which network.
        seed: Of all draws.
        first: Number of the first run.
        runs: How many.
        duration: Of each [s].

    Returns:
        `AttackResult` of each. Shape (runs,).
    """
    batch = Batch(scenario_of(bounds, conditions), 1, threads=1)
    late = batch.links.longest(LinkKind.DETECTIONS) + 1
    memory, rest = filter_memory(bounds.delay_ticks, max(1, late)), empty_room()
    results, random = np.zeros(runs, record_type(AttackResult)), np.empty(1, np.uint64)
    world, ticks = (batch.tables, batch.state), round(duration / bounds.dt)
    for k in range(runs):
        random[0] = draw(
            (np.uint64(seed), np.uint64(_ATTACK) << np.uint64(32)), FIRST, first + k, 0
        )[0]
        batch.restore([int(random[0] >> np.uint64(11))], [0])
        fly_one(*world, memory, rest, bounds, conditions, random, ticks, results[k : k + 1])
    batch.workers.close()
    return results
