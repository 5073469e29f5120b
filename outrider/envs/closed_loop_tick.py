"""One tick of the closed loop, compiled: world, links, filters, laws, drivers and rewards in one pass.

The tick calls the functions of the pilots, so a vehicle gets the same commands as from its pilot over the bus. Each
world is processed in one pass, so that its grid stays in the cache until the tick is complete.
"""

from typing import Any

from agents.estimation.batch_filter import estimate
from agents.uav_parameters import Target, UavParameters
from agents.uav_tick import occlusion_of
from outrider.envs.closed_loop_state import LoopParameters, LoopState, LoopTables
from outrider.envs.command_tick import apply_actions, command
from outrider.envs.perception_tick import perceive
from outrider.envs.vehicle_parts import inputs_of, map_of
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
)
from sim.engine.world_state import Vehicle, WorldParameters
from sim.engine.world_tick import begin_world, measure, world_tick
from sim.env.rows import advance_rows, observe_rows
from sim.models.field import coverage_gradient, sample
from sim.models.motion import CheckedTrajectory
from sim.models.safety import SafetyBounds
from sim.models.shadows import Occlusion
from sim.models.vehicles import norm


@compiled
def _add_cues(
    parameters: LoopParameters,
    numbers: WorldParameters,
    row: Any,  # noqa: ANN401 - record of `RowState.uav_rows`
    target: Target,
    age: int,
    own: UavParameters,
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
            own.sensor,
            numbers.cell,
            occlusion,
        )
        if size > 0.0:
            row.gradient_x, row.gradient_y = u_x / size, u_y / size


@inlined
def _add_pictures(
    parameters: LoopParameters, tables: LoopTables, state: LoopState, world: int
) -> None:
    """Write the UAVs' estimates and gradients into their rows, and draw their coverage patches."""
    numbers = tables.batch.world[row_of(tables.batch.world.shape[0], world)]
    vehicles = state.batch.vehicles
    maps, patches, escorts = state.maps, state.patches, tables.batch.escorts
    if parameters.estimate or parameters.gradient:
        kalman, rows, uavs = state.kalman, state.rows.uav_rows, state.uavs
        for u in range(escorts.shape[0]):
            own = uavs[world, u]
            _add_cues(
                parameters,
                numbers,
                rows[world, u],
                estimate(kalman, world, u),
                kalman[world, u, 0].age,
                own,
                map_of(maps, world, u),
                occlusion_of(inputs_of(tables, state, world, u, 0)),
            )
    for u in range(patches.shape[1]):
        place = vehicles[world, escorts[u, 0]].reference_position
        x, y = place[0], place[1]
        sample(
            map_of(maps, world, u),
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
def _count_actions(tables: LoopTables, state: LoopState, world: int, tick: int) -> None:
    """Count the actions of the UAVs with an active safety filter."""
    escorts, filtered = tables.batch.escorts, tables.filtered
    row, monitored = row_of(tables.monitored.shape[0], world), tables.monitored
    batch, counts = state.batch, state.certificates
    vehicles, flown = batch.vehicles, batch.flown
    for u in range(escorts.shape[0]):
        if filtered[u]:
            v = escorts[u, 0]
            committed = flown[world, v, 0]
            _count_action(monitored[row, u], counts[world, u], vehicles[world, v], committed, tick)


@inlined
def _count_certificates(
    tables: LoopTables, state: LoopState, ground: GroundState | None, world: int, over: bool
) -> None:
    """Update the certificate counters of the UAVs for this tick."""
    escorts, filtered = tables.batch.escorts, tables.filtered
    row, monitored = row_of(tables.monitored.shape[0], world), tables.monitored
    disturbed = tables.batch.disturbances.shape[1] > 0
    batch, counts, standings = state.batch, state.certificates, state.rows.standings
    vehicles, links, packets = batch.vehicles, batch.links, batch.packets
    for u in range(escorts.shape[0]):
        v = escorts[u, 0]
        if over:
            clear, ugv = True, tables.receivers[u]
            if ground is not None:
                clear = keeps_clearance(ground.clearances, ground.missions[world], ugv)
            record_end(counts[world, u], standings[world, v].lost, clear)
        elif filtered[u]:
            come, arrived = packets[world, u, ARRIVED], links[world, u].arrived
            one = vehicles[world, v]
            _record_errors(monitored[row], counts[world], come, arrived, u, one, disturbed)


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
                _count_certificates(tables, state, ground, k, over)
            if tick == ticks - 1 or over or beginning:
                observe_rows(tables.batch, batch, tables.rows, state.rows, k)
                if parameters is not None:
                    _add_pictures(parameters, tables, state, k)
