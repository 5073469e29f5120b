"""Compiled attack on the safety filter and its certificate.

World, links, counters and safety filter are the product's own; adversaries control everything else. They know the true
state and the code. They choose the nominal control, the UGV's motion, detection errors, missed detections and the fate
of commands. Every draw depends on the seed and the run's number, so each run can be repeated alone.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.safety.altitude import Acceleration
from agents.safety.decision import CERTIFIED, NOMINAL
from agents.safety.discs import certified_distance, newest_disc
from agents.safety.memory import (
    add_measurement,
    add_position,
    filter_memory,
    invalidate_plans,
    reset_memory,
)
from bus.messages.links import LinkKind
from outrider_falsify.attack_records import (
    AttackResult,
    Run,
    View,
    apart,
    empty_scratch,
    keep_states,
    view_of,
)
from outrider_falsify.beginning import begin, ugv_bound
from outrider_falsify.conditions import (
    ANY,
    DISTURBANCES,
    GUARDS,
    UGVS,
    Conditions,
    scenario_of,
)
from outrider_falsify.heights import Heights, filter_nominal, nominal_climb, sight_radius
from outrider_falsify.network_troubles import send_command, start_blackout
from outrider_falsify.nominal import Known, nominal_command, switch_command
from outrider_falsify.opponents import (
    UAV,
    UGV,
    choose,
    detection_error,
    disturb,
    jump,
    redraw,
    ugv_command,
)
from outrider_falsify.rng import next_share
from outrider_falsify.tick_distance import largest_between
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import compiled, released
from sim.compiling.records import RecordArray, record_type
from sim.engine.batch import Batch
from sim.engine.monitor import NEVER as NEVER_SEEN
from sim.engine.monitor import (
    Claim,
    record_arrival,
    record_decision,
    record_end,
    record_interval,
    reset_filter,
)
from sim.engine.world_tick import deliver_detections, move, receive_commands
from sim.models.randomness import FIRST, draw
from sim.models.safety import SafetyBounds
from sim.models.vehicles import norm
from sim.scenario.types import Scenario

_ATTACK = 1001  # purpose of the draws


class Order(NamedTuple):
    """Command of the UAV at one tick, with the filter's statement about it."""

    u_x: float
    u_y: float
    u_z: float
    """Horizontal and vertical acceleration [m/s²]."""
    acted: bool
    """True if the guard overrides the nominal control."""
    certified: bool
    carries_trajectory: bool
    """True if the command carries a trajectory."""
    reported: bool
    """True if the filter was evaluated."""


@compiled
def _receive(run: Run, view: View) -> Known:
    """Deliver arrived detections to the UAV and compare the certified distance with the true one."""
    bounds, memory, uav, tick = run.bounds, run.memory, view.uav, view.tick
    result = run.results[0]
    if run.scratch.trouble[0].away == 0:
        add_position(memory, tick, uav.p_x, uav.p_y)
        for n in range(run.state.links[0, 0].arrived):
            packet = run.state.packets[0, 0, ARRIVED, n]
            taken, (d_x, d_y) = int(packet.stamp), packet.vector
            record_arrival(bounds, run.scratch.counts[0], taken, packet.error)
            add_measurement(bounds, memory, taken, (d_x, d_y), tick, uav)
    discs = memory.discs
    new = newest_disc(discs)
    bound = certified_distance(bounds, discs, tick, uav.p_x, uav.p_y)
    result.max_distance = max(result.max_distance, view.distance)
    z_x, z_y = 0.0, 0.0
    if new >= 0:
        result.max_excess = max(result.max_excess, view.distance - bound)
        result.max_age = max(result.max_age, (tick - discs[new].tick) * bounds.dt)
        z_x, z_y = uav.p_x - discs[new].x, uav.p_y - discs[new].y
    return Known(new, bound, z_x, z_y)


@compiled
def _filter(run: Run, view: View, u_x: float, u_y: float, u_z: float) -> Order:
    """Evaluate the filter unless it is off or disconnected; count its statement as the simulator does."""
    conditions, memory, random, uav = run.conditions, run.memory, run.random, view.uav
    roles, trouble, counts = run.scratch.roles[0], run.scratch.trouble[0], run.scratch.counts[0]
    if conditions.disturbance == DISTURBANCES.law_changes and next_share(random) < 0.01:
        roles.filtering = not roles.filtering
        if roles.filtering:
            reset_memory(memory)
            reset_filter(counts)
            add_position(memory, view.tick, uav.p_x, uav.p_y)
    leaves = conditions.disturbance == DISTURBANCES.rejoins and trouble.away == 0
    if leaves and next_share(random) < 0.005:
        trouble.away = 1 + int(next_share(random) * 20)
    if trouble.away > 0:
        trouble.away -= 1
        if trouble.away == 0:
            invalidate_plans(memory)
    elif roles.filtering:
        begins = run.state.flown[0, UAV, 0].begins
        vertical, nominal = run.state.vehicles[0, UAV].vertical, Acceleration(u_x, u_y, u_z)
        filter_nominal(run.heights, run.bounds, memory, (view.tick, begins), uav, vertical, nominal)
        decision = memory.decision[0]
        u_x, u_y = decision.acceleration[0], decision.acceleration[1]
        u_z = decision.vertical_acceleration
        certified, acted = decision.reason == CERTIFIED, decision.source != NOMINAL
        lost = view.distance >= sight_radius(run.heights, run.state, conditions.r_v)
        said = Claim(certified, acted, lost, True, True)
        record_decision(run.bounds, counts, view.tick, said)
        return Order(u_x, u_y, u_z, acted, certified, not conditions.bare, True)
    return Order(u_x, u_y, u_z, False, False, False, False)


@compiled
def _decide(run: Run, view: View, known: Known) -> Order:
    """Return the UAV's command: the adversary's nominal control, possibly overridden by the guard."""
    conditions = run.conditions
    u_x, u_y = nominal_command(run, view, known)
    if conditions.law == GUARDS.filter:
        vertical = run.state.vehicles[0, UAV].vertical
        u_z = nominal_climb(run.heights, run.scratch.roles, run.random, vertical)
        return _filter(run, view, u_x, u_y, u_z)
    z_x, z_y = known.z_x, known.z_y
    far = norm(z_x, z_y) if conditions.law == GUARDS.paper else known.bound
    acted = known.new >= 0 and far >= conditions.radius
    if acted:
        discs, adversaries = run.memory.discs, run.scratch.adversaries
        u_x, u_y = switch_command(
            conditions, run.bounds, discs, adversaries, view.tick, view.uav, z_x, z_y
        )
    return Order(u_x, u_y, 0.0, acted, False, False, False)


@compiled
def _count(run: Run, view: View, known: Known, order: Order) -> None:
    """Add one tick to the run's sums."""
    sums, counts, result = run.scratch.sums[0], run.scratch.counts[0], run.results[0]
    sums.distance += view.distance
    sums.overridden += order.acted
    result.lost += view.distance >= sight_radius(run.heights, run.state, run.conditions.r_v)
    counts.certified_before = counts.certified_before and order.reported
    if known.new >= 0 or sums.seen > 0:
        sums.seen += 1
        sums.uncertified += not order.certified
    if order.certified:
        result.max_certified = max(result.max_certified, view.distance)


@compiled
def _drive(run: Run, view: View) -> None:
    """Send the command of the adversary in the UGV."""
    conditions, random, adversaries, roles = (
        run.conditions,
        run.random,
        run.scratch.adversaries,
        run.scratch.roles[0],
    )
    u_g, moving, ugv = (
        ugv_bound(run.bounds, conditions),
        run.scratch.now[UGV],
        run.state.vehicles[0, UGV],
    )
    if next_share(random) < 0.01:
        redraw(random, adversaries, UGV, u_g)
        if conditions.ugv == ANY and next_share(random) < 0.2:
            roles.ugv = choose(random, conditions.ugv, len(UGVS))
    ugv.outgoing_tick = view.tick
    ugv.outgoing[0], ugv.outgoing[1] = ugv_command(
        roles.ugv, view.x, view.y, view.uav, moving.v_x, moving.v_y, adversaries, u_g
    )


@compiled
def _step(run: Run, view: View) -> None:
    """Step the world; the adversary sets the wind."""
    conditions, state, scratch = run.conditions, run.state, run.scratch
    roles = scratch.roles[0]
    keep_states(state, scratch.before)
    receive_commands(run.tables, state, 0)
    if run.tables.disturbances.shape[1] > 0:
        blackout = scratch.trouble[0].blackout
        roles.blows = disturb(
            conditions,
            state,
            run.random,
            roles.blows,
            blackout,
            view.x,
            view.y,
            scratch.adversaries,
        )
    move(run.tables, state, None, 0)
    if conditions.jumps > 0.0:
        jump(conditions, state)
    keep_states(state, scratch.now)


@compiled
def _detect(run: Run, tick: int) -> None:
    """Detect the UGV; the adversary chooses missed detections and errors."""
    conditions, random, scratch, bounds = run.conditions, run.random, run.scratch, run.bounds
    trouble, found = scratch.trouble[0], run.state.vehicles[0, UAV].detection
    x, y, _ = apart(scratch.now)
    start_blackout(conditions, bounds, scratch, random, tick)
    size = bounds.max_measurement_error * conditions.error_share
    n_x, n_y = detection_error(
        scratch.roles[0].error, random, tick, size, x, y, scratch.adversaries
    )
    trouble.seen = 1 if trouble.blackout == 0 else 0
    if trouble.blackout > 0:
        trouble.blackout -= 1
        n_x = math.nan
    if not math.isnan(found[0]):
        found[0], found[1] = x - n_x, y - n_y
    deliver_detections(run.tables, run.state, 0)


@compiled
def _judge(run: Run, tick: int, certified: bool) -> None:
    """Check the interval up to the next tick for loss of sight and broken assumptions."""
    counts, result, scratch = run.scratch.counts[0], run.results[0], run.scratch
    flown = run.state.flown[0, UAV, 0]
    bare = run.state.vehicles[0, UAV].command_tick if flown.plain == 1 else NEVER_SEEN
    record_interval(run.bounds, counts, tick, flown.begins, bare)
    if counts.interval_kept and certified:
        most = largest_between(scratch.before, scratch.now, run.bounds.dt)
        result.max_certified = max(result.max_certified, most)
        radius = sight_radius(run.heights, run.state, run.conditions.r_v)
        result.certified_lost += most >= min(radius, scratch.roles[0].radius)


@compiled
def _finish(run: Run, ticks: int) -> None:
    """Write the result of a run with this number of ticks."""
    counts, result, sums = run.scratch.counts[0], run.results[0], run.scratch.sums[0]
    radius = sight_radius(run.heights, run.state, run.conditions.r_v)
    record_end(counts, apart(run.scratch.now)[2] >= radius, True)
    result.certified_lost += counts.certified_while_lost
    result.broken = counts.broken
    result.overridden = sums.overridden / (ticks + 1)
    result.mean_distance = sums.distance / (ticks + 1)
    result.uncertified = sums.uncertified / sums.seen if sums.seen else 1.0


@released
def fly_one(run: Run, ticks: int) -> None:
    """Simulate one run in a world that has just been reset and has its rng keys."""
    begin(run)
    for tick in range(ticks + 1):
        view = view_of(run, tick)
        known = _receive(run, view)
        order = _decide(run, view, known)
        _count(run, view, known, order)
        if tick == ticks:
            break
        run.scratch.roles[0].radius = sight_radius(run.heights, run.state, run.conditions.r_v)
        send_command(run, view, order.u_x, order.u_y, order.u_z, order.carries_trajectory)
        _drive(run, view)
        _step(run, view)
        _detect(run, tick)
        _judge(run, tick, order.certified)
    _finish(run, ticks)


def attack(
    bounds: SafetyBounds,
    conditions: Conditions,
    seed: int,
    first: int,
    runs: int,
    duration: float,
    flight: tuple[Scenario, Heights] | None = None,
) -> RecordArray:
    """Simulate consecutive runs of an attack.

    Args:
        bounds: Declared bounds.
        conditions: Guard, adversaries and network.
        seed: Seed of all draws.
        first: Number of the first run.
        runs: Number of runs.
        duration: Duration of each run [s].
        flight: UAV with an altitude, from `outrider_falsify.heights.over_town`; None: it flies in the plane.

    Returns:
        `AttackResult` of each run. Shape (runs,).
    """
    scenario, heights = flight or (scenario_of(bounds, conditions), None)
    batch = Batch(scenario, 1, threads=1)
    late = batch.links.longest(LinkKind.DETECTIONS) + 1
    results, random = np.zeros(runs, record_type(AttackResult)), np.empty(1, np.uint64)
    run = Run(
        tables=batch.tables,
        state=batch.state,
        memory=filter_memory(bounds.delay_ticks, max(1, late)),
        scratch=empty_scratch(),
        bounds=bounds,
        conditions=conditions,
        random=random,
        results=results,
        heights=heights,
    )
    for k in range(runs):
        random[0] = draw(
            (np.uint64(seed), np.uint64(_ATTACK) << np.uint64(32)), FIRST, first + k, 0
        )[0]
        batch.restore([int(random[0] >> np.uint64(11))], [0])
        fly_one(run._replace(results=results[k : k + 1]), round(duration / bounds.dt))
    batch.workers.close()
    return results
