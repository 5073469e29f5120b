"""Observation rows, metrics and rewards of the vehicles in arrays: the same compiled functions for one world or many.

A tick of the rows, once the world's is done and measured: `advance_rows`, then `observe_rows` where somebody looks.
"""

from typing import NamedTuple

import numpy as np

from bus.observations import GRADIENT, UAV, UGV, record_type
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, IntArray, compiled, inlined
from sim.compiling.records import RecordArray, columns, records
from sim.engine.ground_state import GroundState
from sim.engine.mission import goals_of
from sim.engine.world_state import BatchState, BatchTables
from sim.env.rewards import RewardWeights, UavTerms, full_error, uav_terms, ugv_terms
from sim.env.settings import Settings
from sim.models.vehicles import next_goal, norm
from sim.scenario.types import Scenario, Uav


class UavMetrics(NamedTuple):
    """A UAV's true standing: the columns of `RowState.uavs`."""

    newest: float
    """Tick of the newest detection that has reached it; -1: none."""
    was_lost: float
    lost: float
    """True if the distance was and is r_v or more."""
    distance: float
    max_distance: float
    """Now and at most [m]."""
    violations: float
    """Ticks out of sight."""
    error: float
    """e(t) [m²]; 0 where it is not computed."""
    error_sum: float
    """Over the ticks so far, the first included [m²]."""


class UgvMetrics(NamedTuple):
    """A UGV's true standing: the columns of `RowState.ugvs`."""

    reached: float
    """Goals."""
    arrivals: float
    """Goals reached at this tick."""
    nearer: float
    """The way by which it came nearer to its goal [m]."""
    to_go: float
    """Way to the next goal [m]; 0 where none is left."""
    told: float
    hits: float
    still: float
    """Tiles that have come by radio, hazards that it has run into, ticks in which it stood still; 0 without hazards."""
    new_told: float
    new_hits: float
    new_still: float
    """Of them those of this tick."""


UAV_METRICS, UGV_METRICS = columns(UavMetrics), columns(UgvMetrics)
"""Columns of `RowState.uavs` and `RowState.ugvs`."""


class EpisodeParameters(NamedTuple):
    """Time at which an episode ends, and what its rewards are measured against."""

    ticks: int
    """Of an episode."""
    full: float
    """`full_error` [m²]."""
    end_on_sight_lost: bool
    end_on_goals: bool
    error: bool
    """True if e(t) is computed at every tick."""


class RowTables(NamedTuple):
    """The constants of all worlds."""

    episode: RecordArray
    """`EpisodeParameters`. Shape (1,)."""
    weights: RecordArray
    """`RewardWeights`. Shape (1,)."""
    place: IntArray
    """For each vehicle its row among the UAVs, or -1 - its row among the UGVs. Shape (vehicles,)."""


class RowState(NamedTuple):
    """The rows of each world. All arrays have an axis for worlds in front."""

    uavs: FloatArray
    """`UavMetrics`; further columns are the caller's. Shape (worlds, UAVs, 8 or more)."""
    ugvs: FloatArray
    """`UgvMetrics`. Shape (worlds, UGVs, 10)."""
    uav_rows: RecordArray
    """`bus.observations.UAV`, and `GRADIENT`, which is the caller's. Shape (worlds, UAVs)."""
    ugv_rows: RecordArray
    """`bus.observations.UGV`. Shape (worlds, UGVs)."""
    terms: FloatArray
    """Of the last reward: `UavTerms` or `UgvTerms`. Shape (worlds, vehicles, 6)."""
    rewards: FloatArray
    """Of the last tick. Shape (worlds, vehicles)."""
    terminated: IntArray
    truncated: IntArray
    """Shape (worlds,)."""


def row_tables(scenario: Scenario, settings: Settings, *, error: bool) -> RowTables:
    """The tables of a scenario.

    Args:
        scenario: The scenario.
        settings: What is paid, and what ends an episode.
        error: Whether e(t) is computed at every tick; if `uncovered` is paid, it is in any case.
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
    return RowTables(
        episode=records(EpisodeParameters, [episode]),
        weights=records(RewardWeights, [settings.rewards]),
        place=np.where(flies, np.cumsum(flies) - 1, -np.cumsum(~flies)).astype(np.int64),
    )


def row_state(tables: RowTables, worlds: int, *, uav_metrics: int = 0) -> RowState:
    """The state before the first look.

    Args:
        tables: The tables.
        worlds: How many.
        uav_metrics: Further columns of `uavs`.
    """
    vehicles, ugvs = len(tables.place), int((tables.place < 0).sum())
    state = RowState(
        uavs=np.zeros((worlds, vehicles - ugvs, len(UAV_METRICS) + uav_metrics)),
        ugvs=np.zeros((worlds, ugvs, len(UGV_METRICS))),
        uav_rows=np.zeros((worlds, vehicles - ugvs), dtype=record_type(UAV + GRADIENT)),
        ugv_rows=np.zeros((worlds, ugvs), dtype=record_type(UGV)),
        terms=np.zeros((worlds, vehicles, len(UavTerms._fields))),
        rewards=np.zeros((worlds, vehicles)),
        terminated=np.zeros(worlds, dtype=np.int64),
        truncated=np.zeros(worlds, dtype=np.int64),
    )
    state.uavs[:, :, UAV_METRICS.newest] = -1.0
    return state


@inlined
def _measure_uav(bt: BatchTables, bs: BatchState, state: RowState, world: int, uav: int) -> None:
    """Notes a UAV's true standing at this tick, and the newest detection that has reached it."""
    row = state.uavs[world, uav]
    vehicle = bs.vehicles[world, bt.escorts[uav, 0]]
    distance, error = vehicle.distance, vehicle.coverage_error
    row[UAV_METRICS.was_lost] = row[UAV_METRICS.lost]
    row[UAV_METRICS.lost] = 1.0 if distance >= bt.world[0].r_v else 0.0
    row[UAV_METRICS.distance] = distance
    row[UAV_METRICS.max_distance] = max(row[UAV_METRICS.max_distance], distance)
    row[UAV_METRICS.violations] += row[UAV_METRICS.lost]
    row[UAV_METRICS.error] = error
    row[UAV_METRICS.error_sum] += error
    for n in range(bs.links[world, uav].arrived):
        stamp = bs.packets[world, uav, ARRIVED, n].stamp
        row[UAV_METRICS.newest] = max(row[UAV_METRICS.newest], stamp)


@inlined
def _measure_mission(ground: GroundState, state: RowState, world: int, ugv: int) -> None:
    """Earnings of a UGV in this tick on ground with hazards."""
    row, mission, hits = state.ugvs[world, ugv], ground.missions[world, ugv], 0
    for n in range(ground.hits.shape[2]):
        hits += ground.hits[world, ugv, n]
    row[UGV_METRICS.new_told] = mission.told - row[UGV_METRICS.told]
    row[UGV_METRICS.new_hits] = hits - row[UGV_METRICS.hits]
    row[UGV_METRICS.new_still] = mission.still - row[UGV_METRICS.still]
    row[UGV_METRICS.told], row[UGV_METRICS.hits] = mission.told, hits
    row[UGV_METRICS.still] = mission.still


@inlined
def _measure_ugv(
    bt: BatchTables, bs: BatchState, state: RowState, world: int, ugv: int, beginning: bool
) -> None:
    """A UGV turns to the next goal where it has reached one."""
    row, position = state.ugvs[world, ugv], bs.vehicles[world, bt.ugvs[ugv]].position
    x, y, reached = position[0], position[1], int(row[UGV_METRICS.reached])
    goals = goals_of(bt.goals, bt.goal_rows, ugv)
    row[UGV_METRICS.nearer], row[UGV_METRICS.arrivals] = 0.0, 0.0
    if reached < goals.shape[0]:
        if not beginning:
            way = norm(x - goals[reached, 0], y - goals[reached, 1])
            row[UGV_METRICS.nearer] = row[UGV_METRICS.to_go] - way
        now, row[UGV_METRICS.to_go] = next_goal(goals, reached, bt.tolerances[ugv], x, y)
        row[UGV_METRICS.arrivals], row[UGV_METRICS.reached] = now - reached, now


@inlined
def _end(bt: BatchTables, tables: RowTables, state: RowState, world: int, left: int) -> int:
    """Tells if the episode is over, and for how many ticks a UAV out of sight pays."""
    lost, goals = False, bt.goals.shape[0]
    for u in range(state.uavs.shape[1]):
        lost = lost or state.uavs[world, u, UAV_METRICS.lost] != 0.0
    for g in range(state.ugvs.shape[1]):
        goals -= int(state.ugvs[world, g, UGV_METRICS.reached])
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
    """Everybody's reward of this tick: the sum of its terms, in their order."""
    episode, weights, dt = tables.episode[0], tables.weights[0], bt.world[0].dt
    for v in range(tables.place.shape[0]):
        vehicle = bs.vehicles[world, v]
        acceleration = vehicle.acceleration[0], vehicle.acceleration[1]
        terms = state.terms[world, v]
        if tables.place[v] >= 0:
            row, told = state.uavs[world, tables.place[v]], 0.0
            if ground is not None:
                tile, ugv = ground.parameters[0].tile, bt.escorts[tables.place[v], 1]
                told = tile * tile * state.ugvs[world, -1 - tables.place[ugv], UGV_METRICS.new_told]
            terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = uav_terms(
                weights,
                row[UAV_METRICS.error],
                vehicle.gain,
                episode.full,
                row[UAV_METRICS.lost] != 0.0,
                row[UAV_METRICS.was_lost] != 0.0,
                ticks_lost,
                acceleration,
                dt,
                told,
            )
        else:
            row = state.ugvs[world, -1 - tables.place[v]]
            nearer, arrivals = row[UGV_METRICS.nearer], int(row[UGV_METRICS.arrivals])
            hits, still = int(row[UGV_METRICS.new_hits]), int(row[UGV_METRICS.new_still])
            terms[0], terms[1], terms[2], terms[3], terms[4] = ugv_terms(
                weights, nearer, arrivals, acceleration, dt, hits, still
            )
        reward = 0.0
        for n in range(terms.shape[0]):
            reward += terms[n]
        state.rewards[world, v] = reward


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
    """Take in the tick that a world is at, whose measures are there: how everybody stands and is paid.

    Args:
        bt, bs, ground: The worlds.
        tables: What all worlds share.
        state: Is changed.
        world: The world.
        beginning: Whether an episode begins: nobody is paid then.
    """
    for u in range(state.uavs.shape[1]):
        _measure_uav(bt, bs, state, world, u)
    for g in range(state.ugvs.shape[1]):
        _measure_ugv(bt, bs, state, world, g, beginning)
        if ground is not None:
            _measure_mission(ground, state, world, g)
    if not beginning:
        ticks_lost = _end(bt, tables, state, world, tables.episode[0].ticks - bs.ticks[world])
        _pay(bt, bs, ground, tables, state, world, ticks_lost)


@inlined
def _observe_uav(
    bt: BatchTables, bs: BatchState, tables: RowTables, state: RowState, world: int, uav: int
) -> None:
    """Write the row of a UAV: of several detections the newest, the pilots over the bus use them all."""
    row, dt = state.uav_rows[world, uav], bt.world[0].dt
    vehicle = bs.vehicles[world, bt.escorts[uav, 0]]
    position, velocity = vehicle.reference_position, vehicle.reference_velocity
    time, newest = bs.ticks[world] * dt, state.uavs[world, uav, UAV_METRICS.newest]
    row.time, row.x, row.y = time, position[0], position[1]
    row.vx, row.vy = velocity[0], velocity[1]
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
    goal = int(state.ugvs[world, ugv, UGV_METRICS.reached])
    row.time = bs.ticks[world] * bt.world[0].dt
    row.x, row.y = vehicle.position[0], vehicle.position[1]
    row.vx, row.vy = vehicle.velocity[0], vehicle.velocity[1]
    count = goals.shape[0]
    row.underway, row.goal_x, row.goal_y = 1.0 if goal < count else 0.0, 0.0, 0.0
    if count > 0:
        goal = min(goal, count - 1)
        row.goal_x, row.goal_y = goals[goal, 0], goals[goal, 1]


@compiled
def observe_rows(
    bt: BatchTables, bs: BatchState, tables: RowTables, state: RowState, world: int
) -> None:
    """Write what everybody in a world observes; arguments as in `advance_rows`."""
    for u in range(state.uavs.shape[1]):
        _observe_uav(bt, bs, tables, state, world, u)
    for g in range(state.ugvs.shape[1]):
        _observe_ugv(bt, bs, state, world, g)
