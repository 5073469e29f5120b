"""Start of an attack's run: positions of the vehicles and choice of the adversaries."""

import math

from agents.safety.memory import reset_memory
from outrider_falsify.attack_records import Run, Scratch, keep_states
from outrider_falsify.conditions import AREAS, ERRORS, INNERS, UGVS, WINDS, Conditions
from outrider_falsify.lost_trajectories import ALIVE, LOSSES
from outrider_falsify.opponents import UAV, UGV, choose, draw_creep, draw_direction, redraw
from outrider_falsify.rng import RngState, next_share
from sim.compiling.compile import compiled
from sim.engine.monitor import reset_counters
from sim.engine.world_state import BatchState, BatchTables
from sim.engine.world_tick import begin_world
from sim.models.safety import SafetyBounds


@compiled
def _place(
    conditions: Conditions, tables: BatchTables, state: BatchState, random: RngState
) -> None:
    """Place UGV and UAV, and set the UAV's initial velocity where the conditions specify a speed."""
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
def _place_at_wall(
    conditions: Conditions, width: float, state: BatchState, random: RngState
) -> None:
    """Place UGV and UAV at the wall y = 0, in its corner, or 1e-12 m to 1e-5 m from it.

    Half of the UAVs start with a velocity of the order of rounding errors.
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
def _reset_adversaries(scratch: Scratch, random: RngState, u_a: float, u_g: float) -> None:
    """Initialize the adversaries with their acceleration limits u_a and u_g [m/s²]."""
    adversaries, trouble, ring = scratch.adversaries, scratch.trouble[0], scratch.ring
    redraw(random, adversaries, UAV, u_a)
    redraw(random, adversaries, UGV, u_g)
    for k in (UAV, UGV):
        adversaries[k].output_x, adversaries[k].output_y = 0.0, 0.0
        adversaries[k].heading_x, adversaries[k].heading_y = 0.0, 0.0
        adversaries[k].error_x, adversaries[k].error_y, adversaries[k].wind = 0.0, 0.0, 0.0
    adversaries[UAV].heading_x, adversaries[UAV].heading_y = draw_creep(random)
    adversaries[UGV].heading_x, adversaries[UGV].heading_y = draw_direction(random)
    adversaries[UGV].error_x, adversaries[UGV].error_y = draw_direction(random)
    adversaries[UAV].losing = ALIVE
    trouble.blackout, trouble.seen = 0, 1
    trouble.silent, trouble.late, trouble.away = 0, 0, 0
    ring[:] = 0.0


@compiled
def ugv_bound(bounds: SafetyBounds, conditions: Conditions) -> float:
    """Return the UGV's acceleration limit [m/s²]; if unlimited, one that reverses it within a tick."""
    u_g: float = conditions.u_g
    return u_g if math.isfinite(u_g) else 2.0 * bounds.v_g / bounds.dt


@compiled
def _begin_states(state: BatchState) -> None:
    """Set the reference states to the true states."""
    for k in range(2):
        vehicle = state.vehicles[0, k]
        for i in range(2):
            vehicle.reference_position[i] = vehicle.position[i]
            vehicle.reference_velocity[i] = vehicle.velocity[i]


@compiled
def _reset_result(run: Run) -> None:
    """Reset results and counters."""
    result, sums = run.results[0], run.scratch.sums[0]
    result.max_distance, result.max_excess, result.max_age = 0.0, -math.inf, 0.0
    result.certified_lost, result.broken, result.max_certified = 0.0, 0.0, 0.0
    sums.distance, sums.overridden, sums.seen, sums.uncertified = 0.0, 0, 0, 0
    reset_counters(run.scratch.counts[0])


@compiled
def begin(run: Run) -> None:
    """Start a run in a world that has just been reset and has its rng keys."""
    conditions, random, adversaries = run.conditions, run.random, run.scratch.adversaries
    roles = run.scratch.roles[0]
    roles.inner = choose(random, conditions.inner, len(INNERS))
    roles.ugv = choose(random, conditions.ugv, len(UGVS))
    roles.error = choose(random, conditions.error, len(ERRORS))
    _reset_adversaries(run.scratch, random, run.bounds.u_a, ugv_bound(run.bounds, conditions))
    roles.climb = 0.0
    roles.rate = 0.05 + 1.5 * next_share(random)
    roles.controller_x, roles.controller_y = 0.0, 0.0
    _place(conditions, run.tables, run.state, random)
    if conditions.area == AREAS.wall and next_share(random) < 0.8:  # along the wall
        adversaries[UGV].heading_x = adversaries[UGV].side
        adversaries[UGV].heading_y = 1e-6 * next_share(random) if next_share(random) < 0.5 else 0.0
    _begin_states(run.state)
    roles.blows = 0
    if run.tables.disturbances.shape[1] > 0:
        adversaries[UGV].wind = 2.0 * math.pi * next_share(random)
        roles.blows = choose(random, conditions.blows, len(WINDS))
    reset_memory(run.memory)
    begin_world(run.tables, run.state, None, 0)
    roles.filtering = True
    _reset_result(run)
    keep_states(run.state, run.scratch.now)
    roles.losses = choose(random, conditions.losses, len(LOSSES))
