"""Commands of a tick of the closed loop, from pilots or external actions, and the radio messages of the UAVs."""

from typing import NamedTuple

from agents.drivers.dispatch import drive
from agents.drivers.parameters import DriverInputs
from agents.drivers.pending_stops import PLAIN, add_stops
from agents.estimation.batch_filter import estimate
from agents.estimation.map_updates import (
    MapUpdateMemory,
    encode_block,
    map_updates_of,
    next_block,
)
from agents.safety.altitude import Acceleration
from agents.safety.control import bare_control, filter_control
from agents.safety.decision import CERTIFIED, NOMINAL
from agents.safety.pending import add_plans
from agents.team.tick import role_accepts, role_carries_plans, role_control, role_filters
from agents.uav_inputs import UavInputs
from agents.uav_parameters import Target
from agents.uav_tick import nominal_control
from outrider.closed_loop.arrays import (
    LoopState,
    LoopTables,
    PilotParameters,
    Pilots,
    constants_of,
    driver_of,
    grid_of,
    inputs_of,
    law_of,
    memory_of,
)
from outrider.closed_loop.teams import (
    Command,
    clear_decision,
    end_command,
    end_commands,
    take_request,
)
from sim.compiling.compile import FloatArray, IntArray, compiled, inlined
from sim.compiling.records import RecordArray, row_of
from sim.engine.ground_state import GroundState
from sim.engine.mission import goals_of, keeps_clearance, record_claim
from sim.engine.monitor import Claim, record_decision
from sim.engine.motion import ugv_state
from sim.env.actions import REQUEST
from sim.models.vehicles import State

_RELATIVE, _GROUND = range(2)
"""Messages in `LoopState.outbox`."""


class _VehicleRow(NamedTuple):
    """Rows of one vehicle in the arrays of the closed loop."""

    world: int
    vehicle: int
    """Row among all vehicles."""
    row: int
    """Row among the UAVs, or among the UGVs."""


@inlined
def _filter(
    state: LoopState,
    pilots: Pilots,
    ground: GroundState | None,
    at: _VehicleRow,
    inputs: UavInputs,
    nominal: Acceleration,
    reports: bool,
) -> tuple[float, float, float, bool]:
    """Pass a UAV's nominal acceleration through its safety filter, and write its plans.

    Args:
        state, pilots, ground, at: As in `_fly`.
        inputs: State and messages of the UAV.
        nominal: Nominal acceleration [m/s²].
        reports: True if the UAV sends a report.

    Returns:
        Acceleration, x, y and z [m/s²]; whether the filter certifies sight, whether or not the UGV keeps clear.
    """
    world, vehicle, uav = at
    constants, memory = constants_of(pilots.tables, world, uav), memory_of(pilots, world, uav)
    u_x, u_y, u_z = filter_control(
        constants.safety, constants.levels, memory.filter, inputs, nominal
    )
    decision, tick = memory.filter.decision[0], inputs.tick
    certified, overridden = decision.reason == CERTIFIED, decision.source != NOMINAL
    lost = state.rows.standings[world, vehicle].lost
    clear = _keeps_clear(pilots, ground, world, uav)
    claim = Claim(certified, reports and overridden, lost, True, clear)
    monitored = pilots.tables.monitored
    bounds = monitored[row_of(monitored.shape[0], world), uav]
    record_decision(bounds, state.certificates[world, uav], tick, claim)
    _write_plans(state, pilots, at, tick)
    return u_x, u_y, u_z, certified


@inlined
def _keeps_clear(pilots: Pilots, ground: GroundState | None, world: int, uav: int) -> bool:
    """Return whether the UAV's UGV keeps the distance from buildings that the filter assumes."""
    clear = True
    if ground is not None:
        ugv = pilots.tables.receivers[uav]
        clear = keeps_clearance(ground.clearances, ground.missions[world], ugv)
    return clear


@inlined
def _write_plans(state: LoopState, pilots: Pilots, at: _VehicleRow, tick: int) -> None:
    """Write the plans of a UAV's command."""
    world, vehicle, uav = at
    one = state.batch.vehicles[world, vehicle]
    constants, memory = constants_of(pilots.tables, world, uav), memory_of(pilots, world, uav)
    one.outgoing_trajectory, one.outgoing_trajectories = add_plans(
        constants.safety[0], memory.filter.pending, tick, state.batch.trajectories[world, vehicle]
    )


@inlined
def _fly(
    tables: LoopTables,
    state: LoopState,
    pilots: Pilots,
    ground: GroundState | None,
    at: _VehicleRow,
    actions: FloatArray,
) -> None:
    """Write the command of a UAV, and its radio messages."""
    world, vehicle, uav = at
    batch, action_row = state.batch, tables.action_row[vehicle]
    tick, standing = batch.ticks[world], state.rows.standings[world, vehicle]
    one = batch.vehicles[world, vehicle]
    target = estimate(pilots.state.kalman, world, uav)
    constants, memory = constants_of(pilots.tables, world, uav), memory_of(pilots, world, uav)
    inputs = inputs_of(tables, state, pilots, world, uav, 0)
    if action_row < 0:
        law = law_of(pilots, world, uav)
        u_x, u_y, u_z = nominal_control(law, constants, memory, inputs, target)
    else:
        action = actions[action_row]
        u_x, u_y, u_z = action[0], action[1], action[2]
        take_request(pilots.state.teams, world, uav, action[REQUEST])
    u_x, u_y = role_control(constants.team, memory.team, inputs.own, constants.safety, (u_x, u_y))
    certified, nominal = False, Acceleration(u_x, u_y, u_z)
    if role_filters(memory.team, pilots.tables.filtered[uav] != 0):
        # a pilot without a detection sends no report
        reports = target.known or action_row >= 0
        u_x, u_y, u_z, certified = _filter(state, pilots, ground, at, inputs, nominal, reports)
    else:
        if role_carries_plans(memory.team, constants.levels, inputs.vertical):
            u_x, u_y, u_z = bare_control(constants.levels, memory.filter, inputs, nominal)
            _write_plans(state, pilots, at, tick)
        clear_decision(memory.team, memory.filter.decision[0])
    role_accepts(constants.team, memory.team, certified)
    end_command(
        pilots.tables.teams,
        pilots.state.teams,
        constants.team,
        memory.team,
        memory.uav[0],
        memory.coverage,
        (world, uav),
        Command(
            tick, inputs.own, certified and _keeps_clear(pilots, ground, world, uav), standing.lost
        ),
    )
    one.outgoing_tick, one.outgoing[0], one.outgoing[1] = tick, u_x, u_y
    one.vertical.outgoing = u_z
    parameters = pilots.tables.parameters
    if parameters.radio:
        updates = map_updates_of(pilots.state.map_updates, world, uav)
        _write_radio(parameters, pilots.state.outbox[world, uav], updates, tick, inputs.own, target)


@compiled
def _write_radio(
    parameters: PilotParameters,
    outbox: RecordArray,
    memory: MapUpdateMemory,
    tick: int,
    own: State,
    target: Target,
) -> None:
    """Write the radio messages of a UAV in this tick into its outbox."""
    known, g_x, g_y = target.known, target.p_x, target.p_y
    relative, ground = outbox[_RELATIVE], outbox[_GROUND]
    relative.stamp = tick if known and tick % parameters.radio_ticks == 0 else -1.0
    relative.block = -1
    relative.vector[0], relative.vector[1] = own.p_x - g_x, own.p_y - g_y
    ground.stamp = -1.0
    if parameters.map_update_ticks > 0 and known and tick % parameters.map_update_ticks == 0:
        row, column = next_block(memory, parameters.tile, tick, g_x, g_y)
        if row >= 0:
            ground.stamp = tick
            ground.block = row * memory.repeats.shape[1] + column
            encode_block(memory.tiles, row, column, ground.tiles)


@inlined
def _drive(
    tables: LoopTables,
    state: LoopState,
    pilots: Pilots,
    ground: GroundState | None,
    at: _VehicleRow,
    actions: FloatArray,
) -> None:
    """Write the command of a UGV."""
    world, vehicle, ugv = at
    batch, action_row = state.batch, tables.action_row[vehicle]
    fixed, changing = pilots.tables, pilots.state
    tick, one = batch.ticks[world], batch.vehicles[world, vehicle]
    one.outgoing_tick = tick
    if action_row >= 0:
        one.outgoing[0], one.outgoing[1] = actions[action_row, 0], actions[action_row, 1]
        return
    script = fixed.scripts[fixed.script_rows[ugv] : fixed.script_rows[ugv + 1]]
    goals = goals_of(tables.batch.goals, tables.batch.goal_rows, ugv)
    radio, arrived = changing.inboxes[world, ugv], changing.arrived[world, ugv]
    committed = batch.flown[world, vehicle, 0].begins if one.follows_trajectories else PLAIN
    grid = grid_of(changing.grids, fixed.late, world, ugv)
    inputs = DriverInputs(tick, ugv_state(one), goals, script, radio, arrived, grid, committed)
    one.outgoing[0], one.outgoing[1] = drive(driver_of(pilots, world, ugv), inputs)
    if ground is not None:
        record_claim(ground.missions[world], ugv, grid.flags[0].claim)
        if one.follows_trajectories:
            trajectories = batch.trajectories[world, vehicle]
            one.outgoing_trajectory, one.outgoing_trajectories = add_stops(grid, tick, trajectories)


@inlined
def command(
    tables: LoopTables,
    state: LoopState,
    pilots: Pilots,
    ground: GroundState | None,
    world: int,
    actions: FloatArray,
) -> None:
    """Write the commands of all vehicles, from pilots or external actions."""
    for v in range(tables.rows.kind_row.shape[0]):
        row = tables.rows.kind_row[v]
        if row >= 0:
            _fly(tables, state, pilots, ground, _VehicleRow(world, v, row), actions)
        else:
            _drive(tables, state, pilots, ground, _VehicleRow(world, v, -1 - row), actions)
    end_commands(pilots.tables.teams, pilots.state.teams, state.batch.vehicles, world)


@compiled
def apply_actions(
    vehicles: RecordArray, action_row: IntArray, world: int, tick: int, actions: FloatArray
) -> None:
    """Write external actions as the commands of all vehicles; their backup trajectories are already stored."""
    for v in range(action_row.shape[0]):
        one = vehicles[world, v]
        one.outgoing_tick = tick
        one.outgoing[0], one.outgoing[1] = actions[action_row[v], 0], actions[action_row[v], 1]
        one.vertical.outgoing = actions[action_row[v], 2]
