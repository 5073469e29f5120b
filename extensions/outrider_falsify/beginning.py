"""The beginning of a run of an attack: places, and the adversaries that are chosen."""

import math

from agents.safety.memory import reset_memory
from outrider_falsify.attack_records import Room, Run, keep_states
from outrider_falsify.conditions import AREAS, ERRORS, INNERS, UGVS, WINDS, Conditions
from outrider_falsify.draws import Words, next_share
from outrider_falsify.lost_motions import ALIVE, LOSSES
from outrider_falsify.opponents import UAV, UGV, choose, draw_creep, draw_direction, redraw
from sim.compiling.compile import compiled
from sim.engine.monitor import reset_counters
from sim.engine.world_state import BatchState, BatchTables
from sim.engine.world_tick import begin_world
from sim.models.safety import SafetyBounds


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
def ugv_bound(bounds: SafetyBounds, conditions: Conditions) -> float:
    """Return the UGV's largest acceleration [m/s²]; where it has none, what turns it back within a tick."""
    u_g: float = conditions.u_g
    return u_g if math.isfinite(u_g) else 2.0 * bounds.v_g / bounds.dt


@compiled
def _begin_states(state: BatchState) -> None:
    """Let the vehicles be where they are told that they are."""
    for k in range(2):
        vehicle = state.vehicles[0, k]
        for i in range(2):
            vehicle.reference_position[i] = vehicle.position[i]
            vehicle.reference_velocity[i] = vehicle.velocity[i]


@compiled
def _reset_result(run: Run) -> None:
    """Nothing has been found or counted."""
    result, sums = run.results[0], run.room.sums[0]
    result.max_distance, result.max_excess, result.max_age = 0.0, -math.inf, 0.0
    result.certified_lost, result.broken, result.max_certified = 0.0, 0.0, 0.0
    sums.distance, sums.overridden, sums.seen, sums.uncertified = 0.0, 0, 0, 0
    reset_counters(run.room.counts[0])


@compiled
def begin(run: Run) -> None:
    """Let a run begin, in a world that is as it was at the start, with its keys."""
    conditions, random, plots = run.conditions, run.random, run.room.plots
    roles = run.room.roles[0]
    roles.inner = choose(random, conditions.inner, len(INNERS))
    roles.ugv = choose(random, conditions.ugv, len(UGVS))
    roles.error = choose(random, conditions.error, len(ERRORS))
    _begin_plots(run.room, random, run.bounds.u_a, ugv_bound(run.bounds, conditions))
    roles.rate = 0.05 + 1.5 * next_share(random)
    roles.controller_x, roles.controller_y = 0.0, 0.0
    _place(conditions, run.tables, run.state, random)
    if conditions.area == AREAS.wall and next_share(random) < 0.8:  # along the wall
        plots[UGV].heading_x = plots[UGV].side
        plots[UGV].heading_y = 1e-6 * next_share(random) if next_share(random) < 0.5 else 0.0
    _begin_states(run.state)
    roles.blows = 0
    if run.tables.disturbances.shape[0] > 0:
        plots[UGV].wind = 2.0 * math.pi * next_share(random)
        roles.blows = choose(random, conditions.blows, len(WINDS))
    reset_memory(run.memory)
    begin_world(run.tables, run.state, None, 0)
    roles.filtering = True
    _reset_result(run)
    keep_states(run.state, run.room.now)
    roles.losses = choose(random, conditions.losses, len(LOSSES))
