"""Teams in many worlds: their messages, stored numbers and charge in a tick, and the counters that check them.

A pilot on the bus gets the same from `sim.server.team_radio`, and `sim.server.team_watch` counts the same. A part
that is None is not compiled.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from agents.safety.decision import NOMINAL
from agents.team.messages import is_due, write_message
from agents.team.records import AWAY, GUARD, TeamMemory
from agents.team.roles import asked_role
from agents.team.row import entries, write_team_row
from agents.uav_inputs import TeamInputs, TeamPacket
from bus.messages.decision import NotCertified
from bus.messages.links import LinkKind
from bus.ticks import team_ticks
from sim.channel.link import begin_tick, receive, send
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.dispatch import unless_none
from sim.compiling.records import RecordArray, code, record_type, row_of
from sim.engine.batch import Batch
from sim.engine.team_monitor import TeamReport, are_too_near, record_team, team_counters
from sim.engine.world_state import BatchState, BatchTables
from sim.models.endurance import next_charge
from sim.models.vehicles import State
from sim.scenario.team import endurance_of, mates_of, teams_of
from sim.scenario.vehicle_types import Uav

_ROUNDING = 1.0
"""Flight time that a UAV may have left beyond the flight to its base when it leaves exhausted [s]."""


_ROLE = code(NotCertified.ROLE)


class TeamTables(NamedTuple):
    """Constants of the teams."""

    mates: IntArray
    """Row among all UAVs of each UAV of a UAV's team, itself included, in name order; -1: none. Shape (UAVs, most)."""
    team: IntArray
    """Row of each UAV's team. Shape (UAVs,)."""
    sizes: IntArray
    """UAVs of each team. Shape (teams,)."""
    guards: int
    """g: number of guards of a team."""
    first_link: int
    """Row of the first UAV's link to its team."""
    flying: IntArray
    """Rows among all vehicles of the UAVs that have an altitude. Shape (flying UAVs,)."""
    separation: float
    """Smallest distance that their bands keep [m]."""


class TeamState(NamedTuple):
    """State of the teams in all worlds. All arrays have an axis for worlds in front."""

    numbers: IntArray
    """Stored number of each UAV. Shape (worlds, UAVs)."""
    charges: FloatArray
    """Flight time that each UAV has left [s]; infinite: unlimited. Shape (worlds, UAVs)."""
    requests: IntArray
    """Request of an action to each UAV, see `TeamInputs`. Shape (worlds, UAVs)."""
    messages: RecordArray
    """`TeamPacket`: messages in transit, message k of a UAV in row k % depth. Shape (worlds, UAVs, depth)."""
    written: IntArray
    """Messages written by each UAV. Shape (worlds, UAVs)."""
    waiting: IntArray
    """Row in `messages` of the message that a UAV sends in the next tick; -1: none. Shape (worlds, UAVs)."""
    inbox: RecordArray
    """`TeamPacket`: messages received by one UAV in this tick. Shape (worlds, room)."""
    arrived: IntArray
    """Number of valid rows of `inbox`. Shape (worlds,)."""
    watched: IntArray
    """1 for each UAV whose commands passed its filter in the last tick. Shape (worlds, UAVs)."""
    reports: RecordArray
    """`TeamReport` of each UAV, by team. Shape (worlds, teams, most)."""
    counts: RecordArray
    """`TeamCounters`. Shape (worlds, teams)."""
    near: IntArray
    """Ticks in which two UAVs with altitudes were nearer than the separation. Shape (worlds,)."""
    points: FloatArray
    """Work array: positions of the UAVs with an altitude [m]. Shape (worlds, flying UAVs, 3)."""
    rows: FloatArray
    """Team entries of each UAV's observation row. Shape (worlds, UAVs, entries)."""


def team_tables(batch: Batch, uavs: Sequence[str]) -> TeamTables | None:
    """Return the constants of a batch's teams; None: there are none.

    Args:
        batch: The worlds, with links of the kind `LinkKind.TEAM`.
        uavs: Names of the UAVs, in the order of the tables.
    """
    scenario = batch.scenario
    if scenario.team is None or not uavs:
        return None
    teams = teams_of(scenario)
    mates = np.full((len(uavs), max(map(len, teams))), -1, np.int64)
    for row, name in enumerate(uavs):
        own = mates_of(scenario, name)
        mates[row, : len(own)] = [uavs.index(mate) for mate in own]
    flying = [
        row
        for row, vehicle in enumerate(scenario.vehicles)
        if isinstance(vehicle, Uav) and vehicle.initial_altitude is not None
    ]
    return TeamTables(
        mates=mates,
        team=np.array([teams.index(mates_of(scenario, name)) for name in uavs], dtype=np.int64),
        sizes=np.array([len(team) for team in teams], dtype=np.int64),
        guards=scenario.team.guards,
        first_link=batch.links.row(LinkKind.TEAM, uavs[0]),
        flying=np.array(flying, dtype=np.int64),
        separation=float(scenario.team.separation),
    )


def team_state(batch: Batch, tables: TeamTables | None, uavs: Sequence[str]) -> TeamState | None:
    """Return the initial state of the teams in all worlds; None: there are none."""
    if tables is None:
        return None
    scenario, worlds, count = batch.scenario, batch.worlds, len(uavs)
    depth = batch.links.longest(LinkKind.TEAM) // team_ticks(scenario.dt) + 2
    most, teams = tables.mates.shape[1], len(tables.sizes)
    endurances = {uav.name: endurance_of(uav) for uav in scenario.uav}
    charges = [np.inf if (one := endurances[name]) is None else one.endurance for name in uavs]
    packets, reports = record_type(TeamPacket), record_type(TeamReport)
    return TeamState(
        numbers=np.zeros((worlds, count), np.int64),
        charges=np.repeat(np.array(charges, np.float64)[None], worlds, axis=0),
        requests=np.zeros((worlds, count), np.int64),
        messages=np.zeros((worlds, count, depth), packets),
        written=np.zeros((worlds, count), np.int64),
        waiting=np.full((worlds, count), -1, np.int64),
        inbox=np.zeros((worlds, 2 * depth * most), packets),  # a link may duplicate messages
        arrived=np.zeros(worlds, np.int64),
        watched=np.zeros((worlds, count), np.int64),
        reports=np.zeros((worlds, teams, most), reports),
        counts=np.repeat(team_counters(teams)[None], worlds, axis=0),
        near=np.zeros(worlds, np.int64),
        points=np.zeros((worlds, len(tables.flying), 3)),
        rows=np.zeros((worlds, count, entries(most))),
    )


@compiled
def begin_teams(
    tables: TeamTables | None,
    state: TeamState | None,
    parameters: RecordArray | None,
    bt: BatchTables,
    batch: BatchState,
    world: int,
) -> None:
    """Charge the UAVs, and carry the messages of the last tick on their links.

    Args:
        tables, state: Teams of all worlds; the state is changed.
        parameters: `TeamParameters`. Shape (1 or worlds, UAVs).
        bt, batch: Constants and state of all worlds.
        world: The world.
    """
    if tables is None or state is None or parameters is None:
        return
    tick, packets, traces = batch.ticks[world], batch.packets, bt.traces
    for u in range(tables.team.shape[0]):
        link = batch.links[world, tables.first_link + u]
        begin_tick(link, packets, world, traces, tick)
        slot = state.waiting[world, u]
        if slot >= 0:
            packet = packets[world, link.number, ARRIVED, 0]
            packet.stamp, packet.block = tick - 1, slot
            send(link, packets, world, traces, packet)
            state.waiting[world, u] = -1
        receive(link, packets, world)
        charge = state.charges[world, u]
        if tick > 0 and charge < np.inf:
            one = parameters[row_of(parameters.shape[0], world), u].endurance
            vehicle = batch.vehicles[world, bt.escorts[u, 0]]
            position, velocity = vehicle.reference_position, vehicle.reference_velocity
            own = State(position[0], position[1], velocity[0], velocity[1])
            state.charges[world, u] = next_charge(one, charge, own, bt.world[0].dt)


@compiled
def collect_messages(
    tables: TeamTables | None, state: TeamState | None, batch: BatchState, world: int, uav: int
) -> None:
    """Copy the messages that reach a UAV in this tick into the inbox of its world."""
    if tables is None or state is None:
        return
    count = 0
    for k in range(tables.mates.shape[1]):
        mate = tables.mates[uav, k]
        if mate < 0 or mate == uav:
            continue
        link = batch.links[world, tables.first_link + mate]
        for n in range(min(link.arrived, state.inbox.shape[1] - count)):
            slot = batch.packets[world, link.number, ARRIVED, n].block
            state.inbox[world, count] = state.messages[world, mate, slot]
            count += 1
    state.arrived[world] = count


@unless_none
@compiled
def team_inputs_of(state: TeamState, world: int, uav: int) -> TeamInputs:
    """Return the number, the charge and the collected messages of a UAV; None: there are no teams."""
    return TeamInputs(
        state.numbers[world, uav],
        state.charges[world, uav],
        state.inbox[world, : state.arrived[world]],
        state.requests[world, uav],
    )


@unless_none
@compiled
def team_memory_of(memory: TeamMemory, world: int, uav: int) -> TeamMemory:
    """Return the memory of a UAV in its team: views, no copies; None: there are no teams."""
    one = slice(uav, uav + 1)
    return TeamMemory(
        memory.own[world, one],
        memory.mates[world, uav],
        memory.track[world, uav],
        memory.heard[world, uav],
        memory.sent[world, uav],
        memory.sent_tick[world, uav],
        memory.repeats[world, uav],
        memory.coverage[world, uav],
    )


def team_metrics(tables: TeamTables, state: TeamState, uav: int) -> dict[str, FloatArray]:
    """Return the metrics of a UAV's team so far in each world, as in `TeamStatus`; arrays of shape (worlds,)."""
    counts = state.counts[:, tables.team[uav]]
    ticks = np.maximum(counts["ticks"], 1.0)
    return {
        "team_certified_share": counts["certified"] / ticks,
        "team_out_of_sight": counts["lost"].astype(np.float64),
        "team_certified_while_lost": counts["certified_while_lost"].astype(np.float64),
        "team_certificate_broken": counts["broken"].astype(np.float64),
        "handovers": counts["handovers"].astype(np.float64),
        "extra_guard_share": counts["extra"] / ticks,
        "left_without_relief": counts["left"].astype(np.float64),
        "separation_violations": state.near.astype(np.float64),
    }


class Command(NamedTuple):
    """Facts of a UAV's command."""

    tick: int
    own: State
    """Its reference state."""
    certified: bool
    """True if its filter certifies sight, and the UGV keeps the distance that it assumes."""
    lost: bool
    """True if the UGV is out of its sight."""


@compiled
def end_command(
    tables: TeamTables | None,
    state: TeamState | None,
    parameters: RecordArray | None,
    memory: TeamMemory | None,
    uav: Any,  # noqa: ANN401 - record of `UavParameters`
    coverage: FloatArray,
    place: tuple[int, int],
    command: Command,
) -> None:
    """Write a UAV's message, store its number, and record its report.

    Args:
        tables, state: Teams of all worlds; the state is changed.
        parameters: `TeamParameters` of the UAV. Shape (1,).
        memory: Its memory, changed in place.
        uav: Its constants.
        coverage: Its own map. Shape (rows, columns).
        place: World, and row among all UAVs.
        command: Its command.
    """
    if tables is None or state is None or parameters is None or memory is None:
        return
    (world, u), one, own = place, parameters[0], memory.own[0]
    report = state.reports[world, tables.team[u], one.row]
    report.number, report.current = state.numbers[world, u], True
    report.guards = own.role == GUARD
    report.exhausted = own.role == AWAY and own.spare <= _ROUNDING
    report.certified, report.lost = command.certified, command.lost
    if is_due(one, command.tick):
        slot = state.written[world, u] % state.messages.shape[2]
        message, desired = state.messages[world, u, slot], uav.desired_coverage
        write_message(one, memory, coverage, desired, command.own, command.tick, message)
        state.written[world, u] += 1
        state.waiting[world, u] = slot
    state.numbers[world, u] = max(state.numbers[world, u], own.number)


@compiled
def take_request(state: TeamState | None, world: int, uav: int, request: float) -> None:
    """Record the request in an action, which reaches the UAV in the next tick; `request`: see `asked_role`."""
    if state is not None:
        state.requests[world, uav] = asked_role(request)


@compiled
def clear_decision(memory: TeamMemory | None, decision: Any) -> None:  # noqa: ANN401 - a record
    """Record that the role of a UAV has no filter in this tick."""
    if memory is not None:
        decision.source, decision.reason, decision.certified_distance = NOMINAL, _ROLE, np.inf


@compiled
def end_commands(
    tables: TeamTables | None, state: TeamState | None, vehicles: RecordArray, world: int
) -> None:
    """Compare the reports of a world's teams with the guarantee, after all commands of a tick.

    Args:
        tables, state: Teams of all worlds; the state is changed.
        vehicles: `Vehicle`. Shape (worlds, vehicles).
        world: The world.
    """
    if tables is None or state is None:
        return
    points = state.points[world]
    for n in range(points.shape[0]):
        one = vehicles[world, tables.flying[n]]
        points[n, 0], points[n, 1] = one.position[0], one.position[1]
        points[n, 2] = one.vertical.altitude
    if are_too_near(points, tables.separation):
        state.near[world] += 1
    for t in range(tables.sizes.shape[0]):
        reports = state.reports[world, t, : tables.sizes[t]]
        record_team(state.counts[world, t], reports, tables.guards)


@compiled
def observe_team(
    state: TeamState | None,
    parameters: RecordArray | None,
    memory: TeamMemory | None,
    place: tuple[int, int],
    own: State,
    tick: int,
    dt: float,
    never: float,
) -> None:
    """Write the team entries of a UAV's observation row; arguments as in `end_command` and `write_team_row`."""
    if state is None or parameters is None or memory is None:
        return
    row = state.rows[place[0], place[1]]
    write_team_row(parameters[0], memory, own, tick, dt, never, row)


@compiled
def is_filtered(memory: TeamMemory | None, otherwise: int, world: int, uav: int) -> bool:
    """Return whether a UAV's commands pass its filter in this tick; `otherwise`: result without a team, 0 or 1."""
    return otherwise != 0 if memory is None else memory.own[world, uav].filtered


@compiled
def begins_to_filter(state: TeamState | None, filtered: bool, world: int, uav: int) -> bool:
    """Record whether a UAV's filter is in use; return whether it has begun in this tick, after a role without."""
    if state is None:
        return False
    before = state.watched[world, uav] != 0
    state.watched[world, uav] = 1 if filtered else 0
    return filtered and not before
