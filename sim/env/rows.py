"""Observation rows, metrics and rewards of the vehicles in arrays, for one world or many; compiled.

In each tick, after the world's own tick and measurement, call `advance_rows`; call `observe_rows` if rows are needed.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from bus.observations import ALTITUDE, GRADIENT, HEADING, UAV, UGV, record_type
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, IntArray, compiled, inlined
from sim.compiling.records import RecordArray, fresh, records
from sim.engine.ground_state import GroundState
from sim.engine.mission import goals_of
from sim.engine.world_state import BatchState, BatchTables
from sim.env.rewards import UAV_TERMS, RewardWeights, full_error, uav_terms, ugv_terms
from sim.env.settings import Settings
from sim.models.vehicles import next_goal, norm
from sim.scenario.team import observer_rows
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav


class Standing:
    """True state of a vehicle in its episode, and its reward."""

    newest: float = -1.0
    """Tick of the newest detection that has reached a UAV; -1: none."""
    lost: bool
    """True if the UGV is out of a UAV's sight."""
    was_unseen: bool
    unseen: bool
    """True if no UAV of a UAV's team saw, or sees, the UGV; without a team, if it is out of the UAV's sight."""
    sight_radius: float
    """Distance within which the UGV is visible [m], 0 while a building hides it."""
    distance: float
    max_distance: float
    """Present and largest distance [m]."""
    violations: int
    """Ticks out of sight."""
    error: float
    """Coverage error e(t) [m²]; 0 if it is not computed."""
    error_sum: float
    """Sum of e(t) over the ticks so far, including the first [m²]."""
    reached: int
    """Goals reached by a UGV."""
    arrivals: int
    """Goals reached at this tick."""
    nearer: float
    """Progress towards its goal [m]."""
    to_go: float
    """Distance to the next goal [m]; 0 if none is left."""
    received_tiles: int
    hits: int
    still: int
    """Tiles received by radio, hazards hit, and ticks at standstill; 0 without hazards."""
    new_tiles: int
    new_hits: int
    new_still: int
    """Increase of these in this tick."""
    terms: Annotated[FloatArray, (len(UAV_TERMS),)]
    """Terms of the last reward: `UAV_TERMS` or `UGV_TERMS`."""
    reward: float
    """Reward of the last tick."""


class EpisodeParameters(NamedTuple):
    """End of an episode, and scale of its rewards."""

    ticks: int
    """Ticks of an episode."""
    full: float
    """`full_error` [m²]."""
    end_on_sight_lost: bool
    end_on_goals: bool
    error: bool
    """True if e(t) is computed at every tick."""


class RowTables(NamedTuple):
    """Constants of all worlds."""

    episode: RecordArray
    """`EpisodeParameters`. Shape (1,)."""
    weights: RecordArray
    """`RewardWeights`. Shape (1,)."""
    kind_row: IntArray
    """Row of each vehicle among the UAVs, or -1 - its row among the UGVs. Shape (vehicles,)."""
    observer: IntArray
    """Row of each UAV's team; each UAV without one has a row of its own. Shape (UAVs,)."""


class RowState(NamedTuple):
    """Rows of each world. All arrays have a leading axis for worlds."""

    standings: RecordArray
    """`Standing`. Shape (worlds, vehicles)."""
    uav_rows: RecordArray
    """`bus.observations.UAV`, `ALTITUDE`, and `GRADIENT`, which the caller fills. Shape (worlds, UAVs)."""
    ugv_rows: RecordArray
    """`bus.observations.UGV`, and `HEADING`, which is east for a point. Shape (worlds, UGVs)."""
    terminated: IntArray
    truncated: IntArray
    """1 if the episode has ended so. Shape (worlds,)."""


def row_tables(scenario: Scenario, settings: Settings, *, error: bool) -> RowTables:
    """Return the tables of a scenario.

    Args:
        scenario: The scenario.
        settings: Reward weights, and conditions that end an episode.
        error: True to compute e(t) at every tick; it is also computed if `uncovered` has a weight.
    """
    flies = np.array([isinstance(vehicle, Uav) for vehicle in scenario.vehicles])
    episode = EpisodeParameters(
        ticks=scenario.ticks,
        full=full_error(
            scenario.visibility.radius + scenario.sensor.range, scenario.coverage.desired
        ),
        end_on_sight_lost=settings.end_on_sight_lost,
        end_on_goals=settings.end_on_goals_reached,
        error=error or settings.rewards.uncovered > 0.0,
    )
    groups = observer_rows(scenario)
    observer = np.zeros(int(flies.sum()), np.int64)
    for number, group in enumerate(groups):
        observer[group] = number
    return RowTables(
        episode=records(EpisodeParameters, [episode]),
        weights=records(RewardWeights, [settings.rewards]),
        kind_row=np.where(flies, np.cumsum(flies) - 1, -np.cumsum(~flies)).astype(np.int64),
        observer=observer,
    )


def row_state(tables: RowTables, worlds: int) -> RowState:
    """Return the state of all worlds before the first sensor update."""
    vehicles, ugvs = len(tables.kind_row), int((tables.kind_row < 0).sum())
    return RowState(
        standings=fresh(Standing, (worlds, vehicles)),
        uav_rows=np.zeros((worlds, vehicles - ugvs), dtype=record_type(UAV + ALTITUDE + GRADIENT)),
        ugv_rows=np.zeros((worlds, ugvs), dtype=record_type(UGV + HEADING)),
        terminated=np.zeros(worlds, dtype=np.int64),
        truncated=np.zeros(worlds, dtype=np.int64),
    )


@inlined
def _measure_uav(bt: BatchTables, bs: BatchState, state: RowState, world: int, uav: int) -> None:
    """Update a UAV's true state at this tick, and the newest detection that has reached it."""
    v = bt.escorts[uav, 0]
    row, vehicle = state.standings[world, v], bs.vehicles[world, v]
    distance, error = vehicle.distance, vehicle.coverage_error
    row.sight_radius = vehicle.sight_radius
    row.lost = distance >= row.sight_radius
    row.distance = distance
    row.max_distance = max(row.max_distance, distance)
    row.violations += 1 if row.lost else 0
    row.error = error
    row.error_sum += error
    for n in range(bs.links[world, uav].arrived):
        stamp = bs.packets[world, uav, ARRIVED, n].stamp
        row.newest = max(row.newest, stamp)


@inlined
def _measure_teams(bt: BatchTables, tables: RowTables, state: RowState, world: int) -> None:
    """Determine whether any UAV of each UAV's team sees the UGV."""
    observer = tables.observer
    for u in range(observer.shape[0]):
        row, unseen = state.standings[world, bt.escorts[u, 0]], True
        for mate in range(observer.shape[0]):
            if observer[mate] == observer[u]:
                unseen = unseen and state.standings[world, bt.escorts[mate, 0]].lost
        row.was_unseen, row.unseen = row.unseen, unseen


@inlined
def _measure_mission(
    bt: BatchTables, ground: GroundState, state: RowState, world: int, ugv: int
) -> None:
    """Update the counts of a UGV on ground with hazards."""
    row, mission, hits = state.standings[world, bt.ugvs[ugv]], ground.missions[world, ugv], 0
    for n in range(ground.hits.shape[2]):
        hits += ground.hits[world, ugv, n]
    row.new_tiles = mission.received_tiles - row.received_tiles
    row.new_hits = hits - row.hits
    row.new_still = mission.still - row.still
    row.received_tiles, row.hits = mission.received_tiles, hits
    row.still = mission.still


@inlined
def _measure_ugv(
    bt: BatchTables, bs: BatchState, state: RowState, world: int, ugv: int, beginning: bool
) -> None:
    """Update a UGV's progress and goals."""
    row, position = state.standings[world, bt.ugvs[ugv]], bs.vehicles[world, bt.ugvs[ugv]].position
    x, y, reached = position[0], position[1], row.reached
    goals = goals_of(bt.goals, bt.goal_rows, ugv)
    row.nearer, row.arrivals = 0.0, 0
    if reached < goals.shape[0]:
        if not beginning:
            to_go = norm(x - goals[reached, 0], y - goals[reached, 1])
            row.nearer = row.to_go - to_go
        now, row.to_go = next_goal(goals, reached, bt.tolerances[ugv], x, y)
        row.arrivals, row.reached = now - reached, now


@inlined
def _end(bt: BatchTables, tables: RowTables, state: RowState, world: int, left: int) -> int:
    """Determine whether the episode is over; return the ticks charged to a UAV out of sight."""
    lost, goals = False, bt.goals.shape[0]
    for v in range(state.standings.shape[1]):
        lost = lost or state.standings[world, v].unseen
        goals -= state.standings[world, v].reached
    lost = tables.episode[0].end_on_sight_lost and lost
    arrived = tables.episode[0].end_on_goals and bt.goals.shape[0] > 0 and goals == 0
    state.terminated[world] = 1 if lost or arrived else 0
    state.truncated[world] = 1 if left <= 0 else 0
    return 1 + left if lost else 1


@inlined
def _pay(
    bt: BatchTables,
    bs: BatchState,
    ground: GroundState | None,
    tables: RowTables,
    state: RowState,
    world: int,
    ticks_lost: int,
) -> None:
    """Compute each vehicle's reward of this tick: the sum of its terms, in order."""
    episode, weights, dt = tables.episode[0], tables.weights[0], bt.world[0].dt
    for v in range(tables.kind_row.shape[0]):
        vehicle = bs.vehicles[world, v]
        acceleration = vehicle.acceleration[0], vehicle.acceleration[1]
        row = state.standings[world, v]
        terms = row.terms
        if tables.kind_row[v] >= 0:
            area = 0.0
            if ground is not None:
                tile, ugv = ground.parameters[0].tile, bt.escorts[tables.kind_row[v], 1]
                area = tile * tile * state.standings[world, ugv].new_tiles
            terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = uav_terms(
                weights,
                row.error,
                vehicle.gain,
                episode.full,
                row.unseen,
                row.was_unseen,
                ticks_lost,
                acceleration,
                dt,
                area,
            )
        else:
            terms[0], terms[1], terms[2], terms[3], terms[4] = ugv_terms(
                weights, row.nearer, row.arrivals, acceleration, dt, row.new_hits, row.new_still
            )
        row.reward = 0.0
        for n in range(terms.shape[0]):
            row.reward += terms[n]


@inlined
def _share(bt: BatchTables, tables: RowTables, state: RowState, world: int) -> None:
    """Give each UAV the mean reward of its team."""
    observer, standings = tables.observer, state.standings
    for first in range(observer.shape[0]):
        count, total = 0, 0.0
        for u in range(observer.shape[0]):
            if observer[u] == observer[first]:
                if u < first:
                    break  # the team has shared already
                total += standings[world, bt.escorts[u, 0]].reward
                count += 1
        for u in range(first, observer.shape[0]):
            if count > 0 and observer[u] == observer[first]:
                standings[world, bt.escorts[u, 0]].reward = total / count


@compiled
def advance_rows(
    bt: BatchTables,
    bs: BatchState,
    ground: GroundState | None,
    tables: RowTables,
    state: RowState,
    world: int,
    beginning: bool,
) -> None:
    """Update the vehicles' true states and rewards after a tick of a world.

    Args:
        bt, bs, ground: State of the worlds.
        tables: Constants of all worlds.
        state: State of the rows; changed.
        world: Index of the world.
        beginning: True at the start of an episode, which has no rewards.
    """
    for u in range(state.uav_rows.shape[1]):
        _measure_uav(bt, bs, state, world, u)
    _measure_teams(bt, tables, state, world)
    for g in range(state.ugv_rows.shape[1]):
        _measure_ugv(bt, bs, state, world, g, beginning)
        if ground is not None:
            _measure_mission(bt, ground, state, world, g)
    if not beginning:
        ticks_lost = _end(bt, tables, state, world, tables.episode[0].ticks - bs.ticks[world])
        _pay(bt, bs, ground, tables, state, world, ticks_lost)
        if tables.weights[0].team:
            _share(bt, tables, state, world)


@inlined
def _observe_uav(
    bt: BatchTables, bs: BatchState, tables: RowTables, state: RowState, world: int, uav: int
) -> None:
    """Write the row of a UAV. It holds only the newest of several detections, whereas pilots on the bus receive all."""
    row, dt = state.uav_rows[world, uav], bt.world[0].dt
    vehicle = bs.vehicles[world, bt.escorts[uav, 0]]
    position, velocity = vehicle.reference_position, vehicle.reference_velocity
    time, newest = bs.ticks[world] * dt, state.standings[world, bt.escorts[uav, 0]].newest
    row.time, row.x, row.y = time, position[0], position[1]
    row.vx, row.vy = velocity[0], velocity[1]
    row.altitude, row.climb_rate = vehicle.vertical.altitude, vehicle.vertical.rate
    row.detected, row.relative_x, row.relative_y = 0.0, 0.0, 0.0
    row.age = tables.episode[0].ticks * dt if newest < 0.0 else time - newest * dt
    best = bs.packets[world, uav, ARRIVED, 0]
    for n in range(1, bs.links[world, uav].arrived):
        if bs.packets[world, uav, ARRIVED, n].stamp > best.stamp:
            best = bs.packets[world, uav, ARRIVED, n]
    if bs.links[world, uav].arrived > 0:
        row.detected = 1.0
        row.relative_x, row.relative_y = best.vector[0], best.vector[1]
        row.age = time - best.stamp * dt


@inlined
def _observe_ugv(bt: BatchTables, bs: BatchState, state: RowState, world: int, ugv: int) -> None:
    """Write the row of a UGV."""
    row, vehicle = state.ugv_rows[world, ugv], bs.vehicles[world, bt.ugvs[ugv]]
    goals = goals_of(bt.goals, bt.goal_rows, ugv)
    goal = state.standings[world, bt.ugvs[ugv]].reached
    row.time = bs.ticks[world] * bt.world[0].dt
    row.x, row.y = vehicle.position[0], vehicle.position[1]
    row.vx, row.vy = vehicle.velocity[0], vehicle.velocity[1]
    row.heading_x, row.heading_y = math.cos(vehicle.heading), math.sin(vehicle.heading)
    count = goals.shape[0]
    row.underway, row.goal_x, row.goal_y = 1.0 if goal < count else 0.0, 0.0, 0.0
    if count > 0:
        goal = min(goal, count - 1)
        row.goal_x, row.goal_y = goals[goal, 0], goals[goal, 1]


@compiled
def observe_rows(
    bt: BatchTables, bs: BatchState, tables: RowTables, state: RowState, world: int
) -> None:
    """Write all rows of a world; arguments as in `advance_rows`."""
    for u in range(state.uav_rows.shape[1]):
        _observe_uav(bt, bs, tables, state, world, u)
    for g in range(state.ugv_rows.shape[1]):
        _observe_ugv(bt, bs, state, world, g)
