"""One tick of the closed loop, compiled: world, links, filters, laws, drivers and rewards in one pass.

The tick calls the functions of the pilots, so a vehicle gets the same commands as from its pilot over the bus. Each
world is processed in one pass, so that its grid stays in the cache until the tick is complete.
"""

from agents.estimation.batch_filter import estimate
from outrider.envs.closed_loop_state import LoopParameters, LoopState, LoopTables
from outrider.envs.command_tick import apply_actions, command
from outrider.envs.height_tick import occlusion_at
from outrider.envs.perception_tick import perceive
from outrider.envs.vehicle_parts import coverage_of
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, IntArray, inlined, released
from sim.engine.ground_state import GroundState
from sim.engine.monitor import (
    NEVER,
    record_arrival,
    record_end,
    record_interval,
    record_tracking_error,
)
from sim.engine.world_tick import begin_world, measure, world_tick
from sim.env.rows import advance_rows, observe_rows
from sim.models.field import coverage_gradient, sample
from sim.models.vehicles import norm


@inlined
def _add_cues(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int, uav: int
) -> None:
    """Write the estimate and the gradient into a UAV's row, if they are required and known."""
    world_parameters, row = tables.batch.world[0], state.rows.uav_rows[world, uav]
    escorts = tables.batch.escorts
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
        own, vehicle = state.uavs[world, uav], state.batch.vehicles[world, escorts[uav, 0]]
        u_x, u_y, size = coverage_gradient(
            coverage_of(parameters, state, world, uav),
            x,
            y,
            g_x,
            g_y,
            world_parameters.r_o,
            world_parameters.desired,
            own.sensor,
            world_parameters.cell,
            occlusion_at(tables.heights, own, uav, vehicle),
        )
        if size > 0.0:
            row.gradient_x, row.gradient_y = u_x / size, u_y / size


@inlined
def _add_pictures(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int
) -> None:
    """Write the UAVs' estimates and gradients into their rows, and draw their coverage patches."""
    world_parameters = tables.batch.world[0]
    escorts = tables.batch.escorts
    if parameters.estimate or parameters.gradient:
        for u in range(escorts.shape[0]):
            _add_cues(parameters, tables, state, world, u)
    for u in range(state.patches.shape[1]):
        place = state.batch.vehicles[world, escorts[u, 0]].reference_position
        x, y = place[0], place[1]
        sample(
            coverage_of(parameters, state, world, u),
            x,
            y,
            world_parameters.desired,
            world_parameters.cell,
            parameters.meters_per_pixel,
            state.patches[world, u],
        )


@inlined
def _count_action(tables: LoopTables, state: LoopState, world: int, uav: int, tick: int) -> None:
    """Count the action of a UAV that has just been executed in this tick."""
    v, bounds = tables.batch.escorts[uav, 0], tables.monitored[uav]
    committed = state.batch.flown[world, v, 0]
    bare = state.batch.vehicles[world, v].command_tick if committed.plain == 1 else NEVER
    record_interval(bounds, state.certificates[world, uav], tick, committed.begins, bare)


@inlined
def _record_errors(tables: LoopTables, state: LoopState, world: int, uav: int) -> None:
    """Record the errors of the detections received by a UAV in this tick, and its tracking error."""
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


@inlined
def _count_actions(tables: LoopTables, state: LoopState, world: int, tick: int) -> None:
    """Count the actions of the UAVs with an active safety filter."""
    for u in range(tables.batch.escorts.shape[0]):
        if tables.filtered[u]:
            _count_action(tables, state, world, u, tick)


@inlined
def _count_certificates(tables: LoopTables, state: LoopState, world: int, over: bool) -> None:
    """Update the certificate counters of the UAVs for this tick."""
    for u in range(tables.batch.escorts.shape[0]):
        if over:
            standing = state.rows.standings[world, tables.batch.escorts[u, 0]]
            record_end(state.certificates[world, u], standing.lost)
        elif tables.filtered[u]:
            _record_errors(tables, state, world, u)


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
    """Fly each of these worlds for a number of ticks or to the end of its episode; 0 ticks: begin the episode.

    World by world, so that a grid stays in the cache for the whole flight. Without parameters all actions are external,
    tables and state are `CommandedTables` and `CommandedState`, and no code for pilots, estimates and patches is
    compiled.
    """
    batch, beginning = state.batch, ticks == 0
    for n in range(begin, end):
        k = worlds[n]
        if beginning:
            begin_world(tables.batch, batch, ground, k)
        for tick in range(1 if beginning else ticks):
            if tick > 0 and (state.rows.terminated[k] or state.rows.truncated[k]):
                break
            started = batch.ticks[k]
            if not beginning:
                if parameters is None:
                    apply_actions(batch.vehicles, tables.action_row, k, started, actions[k])
                else:
                    command(parameters, tables, state, ground, k, actions[k])
                world_tick(tables.batch, batch, ground, k, True)
            if parameters is not None:
                if not beginning:
                    _count_actions(tables, state, k, started)
                perceive(parameters, tables, state, ground, k)
            error = tables.rows.episode[0].error
            measure(tables.batch, batch, k, error)
            advance_rows(tables.batch, batch, ground, tables.rows, state.rows, k, beginning)
            over = state.rows.terminated[k] or state.rows.truncated[k]
            if parameters is not None:
                _count_certificates(tables, state, k, over)
            if tick == ticks - 1 or over or beginning:
                observe_rows(tables.batch, batch, tables.rows, state.rows, k)
                if parameters is not None:
                    _add_pictures(parameters, tables, state, k)
