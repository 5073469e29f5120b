"""One tick of the closed loop, compiled: world, links, filters, laws, drivers and rewards in one pass.

The tick calls the functions of the pilots, so a vehicle gets the same commands as from its pilot over the bus. Each
world is processed in one pass, so that its grid stays in the cache until the tick is complete.
"""

from typing import Any

from agents.estimation.batch_filter import estimate
from agents.team.tick import law_coverage
from agents.uav_parameters import Target, UavParameters
from agents.uav_tick import occlusion_of
from outrider.closed_loop.arrays import (
    LoopState,
    LoopTables,
    PilotParameters,
    Pilots,
    constants_of,
    inputs_of,
    map_of,
    memory_of,
    reference_of,
)
from outrider.closed_loop.commands import apply_actions, command
from outrider.closed_loop.perception import perceive
from outrider.closed_loop.teams import begins_to_filter, is_filtered, observe_team
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, IntArray, compiled, inlined, released
from sim.compiling.records import RecordArray, row_of
from sim.engine.ground_state import GroundState
from sim.engine.mission import keeps_clearance
from sim.engine.monitor import (
    NEVER,
    CertificateCounters,
    record_arrival,
    record_end,
    record_interval,
    record_tracking_error,
    reset_filter,
)
from sim.engine.world_state import Vehicle, WorldParameters
from sim.engine.world_tick import BEGIN, END, begin_world, begin_world_tick, end_world_tick, measure
from sim.env.rows import advance_rows, observe_rows
from sim.models.field import coverage_gradient, sample
from sim.models.safety import SafetyBounds
from sim.models.shadows import Occlusion
from sim.models.trajectories import CheckedTrajectory
from sim.models.vehicles import norm


@compiled
def _add_cues(
    parameters: PilotParameters,
    numbers: WorldParameters,
    row: Any,  # noqa: ANN401 - record of `RowState.uav_rows`
    target: Target,
    age: int,
    uav: UavParameters,
    coverage: FloatArray,
    occlusion: Occlusion | None,
) -> None:
    """Write the estimate, of this age [ticks], and the gradient into a UAV's row, if they are required and known."""
    row.gradient_x, row.gradient_y = 0.0, 0.0
    if not target.known:
        return
    x, y, g_x, g_y = row.x, row.y, target.p_x, target.p_y
    if parameters.estimate:
        row.detected, row.relative_x, row.relative_y = 1.0, x - g_x, y - g_y
        row.age = age * numbers.dt
    if parameters.gradient:
        u_x, u_y, size = coverage_gradient(
            coverage,
            x,
            y,
            g_x,
            g_y,
            numbers.r_o,
            numbers.desired,
            uav.sensor,
            numbers.cell,
            occlusion,
        )
        if size > 0.0:
            row.gradient_x, row.gradient_y = u_x / size, u_y / size


@inlined
def _complete_rows(tables: LoopTables, state: LoopState, pilots: Pilots, world: int) -> None:
    """Write the UAVs' estimates, gradients and teams into their rows, and draw their coverage patches."""
    numbers = tables.batch.world[row_of(tables.batch.world.shape[0], world)]
    vehicles, parameters = state.batch.vehicles, pilots.tables.parameters
    uavs, patches, escorts = pilots.state.uavs, pilots.state.patches, tables.batch.escorts
    episode = tables.rows.episode[0]
    for u in range(escorts.shape[0]):
        observe_team(
            pilots.state.teams,
            constants_of(pilots.tables, world, u).team,
            memory_of(pilots, world, u).team,
            (world, u),
            reference_of(vehicles[world, escorts[u, 0]]),
            state.batch.ticks[world],
            numbers.dt,
            episode.ticks * numbers.dt,
        )
    if parameters.estimate or parameters.gradient:
        kalman, rows = pilots.state.kalman, state.rows.uav_rows
        for u in range(escorts.shape[0]):
            _add_cues(
                parameters,
                numbers,
                rows[world, u],
                estimate(kalman, world, u),
                kalman[world, u, 0].age,
                uavs.uav[world, u],
                law_coverage(memory_of(pilots, world, u).team, map_of(uavs.coverage, world, u)),
                occlusion_of(inputs_of(tables, state, pilots, world, u, 0)),
            )
    for u in range(patches.shape[1]):
        position = vehicles[world, escorts[u, 0]].reference_position
        x, y = position[0], position[1]
        sample(
            law_coverage(memory_of(pilots, world, u).team, map_of(uavs.coverage, world, u)),
            x,
            y,
            numbers.desired,
            numbers.cell,
            parameters.meters_per_pixel,
            patches[world, u],
        )


@compiled
def _count_action(
    bounds: SafetyBounds,
    counts: CertificateCounters,
    vehicle: Vehicle,
    committed: CheckedTrajectory,
    tick: int,
) -> None:
    """Count the action of a UAV that has just been executed in this tick."""
    bare = vehicle.command_tick if committed.plain == 1 else NEVER
    record_interval(bounds, counts, tick, committed.begins, bare)


@compiled
def _record_errors(
    monitored: RecordArray,
    counts: RecordArray,
    packets: RecordArray,
    arrived: int,
    uav: int,
    vehicle: Vehicle,
    disturbed: bool,
) -> None:
    """Record the errors of the detections received by a UAV in this tick, and its tracking error.

    Args:
        monitored, counts: `SafetyBounds` and `CertificateCounters` of all UAVs; the counters are changed.
        packets: `Packet` of each arrived detection.
        arrived: Their number.
        uav: Row of the UAV.
        vehicle: The UAV in the world.
        disturbed: True if wind or position errors displace it.
    """
    for n in range(arrived):
        packet = packets[n]
        record_arrival(monitored[uav], counts[uav], int(packet.stamp), packet.error)
    if disturbed:
        true, reference = vehicle.position, vehicle.reference_position
        off = norm(true[0] - reference[0], true[1] - reference[1])
        record_tracking_error(monitored, counts, uav, off)


@inlined
def _count_actions(
    tables: LoopTables, state: LoopState, pilots: Pilots, world: int, tick: int
) -> None:
    """Count the actions of the UAVs with an active safety filter."""
    escorts, batch, counts = tables.batch.escorts, state.batch, state.certificates
    row, monitored = row_of(pilots.tables.monitored.shape[0], world), pilots.tables.monitored
    for u in range(escorts.shape[0]):
        if is_filtered(pilots.state.uavs.team, pilots.tables.filtered[u], world, u):
            v, committed = escorts[u, 0], batch.flown[world, escorts[u, 0], 0]
            _count_action(
                monitored[row, u], counts[world, u], batch.vehicles[world, v], committed, tick
            )


@inlined
def _count_certificates(
    tables: LoopTables,
    state: LoopState,
    pilots: Pilots,
    ground: GroundState | None,
    world: int,
    over: bool,
) -> None:
    """Update the certificate counters of the UAVs for this tick."""
    escorts, standings = tables.batch.escorts, state.rows.standings
    disturbed = tables.batch.disturbances.shape[1] > 0
    batch, counts = state.batch, state.certificates
    for u in range(escorts.shape[0]):
        v = escorts[u, 0]
        if over:
            clear, ugv = True, pilots.tables.receivers[u]
            if ground is not None:
                clear = keeps_clearance(ground.clearances, ground.missions[world], ugv)
            record_end(counts[world, u], standings[world, v].lost, clear)
            continue
        filtered = is_filtered(pilots.state.uavs.team, pilots.tables.filtered[u], world, u)
        if begins_to_filter(pilots.state.teams, filtered, world, u):
            reset_filter(counts[world, u])
        if filtered:
            come, arrived = batch.packets[world, u, ARRIVED], batch.links[world, u].arrived
            one, bounds = batch.vehicles[world, v], pilots.tables.monitored
            row = row_of(bounds.shape[0], world)
            _record_errors(bounds[row], counts[world], come, arrived, u, one, disturbed)
        else:
            counts[world, u].certified_before = False


@inlined
def _command(
    tables: LoopTables,
    state: LoopState,
    pilots: Pilots | None,
    ground: GroundState | None,
    world: int,
    actions: FloatArray,
) -> None:
    """Write the commands of a world's vehicles."""
    if pilots is None:
        tick = state.batch.ticks[world]
        apply_actions(state.batch.vehicles, tables.action_row, world, tick, actions)
    else:
        command(tables, state, pilots, ground, world, actions)


@inlined
def _evaluate(
    tables: LoopTables,
    state: LoopState,
    pilots: Pilots | None,
    ground: GroundState | None,
    world: int,
    begins: bool,
    last: bool,
) -> bool:
    """Evaluate a world after a tick, or at the start of its episode; return whether the episode has ended.

    Args:
        tables, state, pilots, ground, world: As in `run_worlds`.
        begins: True at the start of the episode.
        last: True if the observation rows are needed.
    """
    batch, rows = state.batch, state.rows
    if pilots is not None:
        if not begins:
            _count_actions(tables, state, pilots, world, batch.ticks[world] - 1)
        perceive(tables, state, pilots, ground, world)
    measure(tables.batch, batch, world, tables.rows.episode[0].error)
    advance_rows(tables.batch, batch, ground, tables.rows, rows, world, begins)
    over = bool(rows.terminated[world] or rows.truncated[world])
    if pilots is not None:
        _count_certificates(tables, state, pilots, ground, world, over)
    if last or over:
        observe_rows(tables.batch, batch, tables.rows, rows, world)
        if pilots is not None:
            _complete_rows(tables, state, pilots, world)
    return over


@released
def run_worlds(
    tables: LoopTables,
    state: LoopState,
    pilots: Pilots | None,
    ground: GroundState | None,
    worlds: IntArray,
    actions: FloatArray,
    ticks: int,
    part: int,
    begin: int,
    end: int,
) -> None:
    """Advance each of these worlds by a number of ticks, or to the end of its episode.

    The first one after a reset begins the episode at tick 0. World by world, so that a grid stays in the cache for the
    whole flight. Without pilots all actions are external, and no code for pilots, estimates and patches is compiled.

    Args:
        tables, state, pilots, ground: Arrays of all worlds; they are changed.
        worlds: Worlds to advance.
        actions: External actions of all worlds. Shape (worlds, external vehicles, ACTION_COLUMNS).
        ticks: Number of ticks; 1 for a part of a tick.
        part: `sim.engine.world_tick.WHOLE`, or a part: BEGIN does nothing before the episode begins.
        begin, end: Rows of `worlds` that this thread advances.
    """
    batch = state.batch
    for n in range(begin, end):
        k = worlds[n]
        for tick in range(ticks):
            begins = state.started[k] == 0
            if part != END and not begins:
                _command(tables, state, pilots, ground, k, actions[k])
                begin_world_tick(tables.batch, batch, ground, k, True)
            if part == BEGIN:
                continue
            if begins:
                state.started[k] = 1
                begin_world(tables.batch, batch, ground, k)
            else:
                end_world_tick(tables.batch, batch, ground, k)
            if _evaluate(tables, state, pilots, ground, k, begins, tick == ticks - 1):
                break
