"""Planning driver: from goal to goal over the known ground, cautious or bold.

In each tick it starts or continues a search if needed. Along the cheapest path it selects the farthest point that a
straight segment reaches at no higher cost per metre, and drives there with `goal_control`, slower before rough
ground. Finally the safety filter replaces a command that cannot be followed by a stop on open tiles, first by a slower
one, then by braking.
"""

import math

from agents.drivers.cautious import (
    Open,
    is_safe,
    nearest_open,
    open_from,
    open_share,
    segment_is_open,
)
from agents.drivers.manoeuvres import angle_to, turn_towards
from agents.drivers.navigate_parameters import NavigateParameters, navigate_parameters
from agents.drivers.parameters import DriverInputs, UgvParameters
from agents.drivers.pending_stops import state_ahead, store_command, update_claim
from agents.drivers.planning import (
    BESIDE_PRICE,
    UNSEEN_PRICE,
    adopt_plan,
    continue_search,
    has_path,
    is_settled,
    next_tile,
    price_of,
    start_search,
)
from agents.drivers.steering import goal_control
from agents.drivers.tile_map import OccupancyGrid
from agents.drivers.waypoints import Memory, waypoint_command
from sim.compiling.compile import FloatArray, compiled
from sim.models.ground import tile_index
from sim.models.hazards import BLOCK, TOUCH
from sim.models.kinematics import ACKERMANN, REST, UgvState, signed_speed
from sim.models.vehicles import (
    brake,
    next_goal,
    norm,
    speed_to_stop_within,
    stopping_distance,
)

_STEPS = 64
"""Number of tiles considered along the cheapest path."""
_SHARES = (1.0, 0.5, 0.2, 0.05)
"""Shares of the free path ahead within which the UGV tries to stop."""
_FACING = 0.1
"""Angle to its next point below which a car faces it [rad]."""
_ROOM = 0.3
"""Room that a car at rest needs ahead of it to turn [tiles]."""
_ROUNDING = 1e-9
"""Relative tolerance of the cost per metre of a straight segment, and of the speed on rough ground."""


@compiled
def _tile_of(parameters: NavigateParameters, memory: OccupancyGrid, x: float, y: float) -> int:
    rows, columns = memory.tiles.shape
    return int(
        tile_index(y, parameters.tile, rows) * columns + tile_index(x, parameters.tile, columns)
    )


@compiled
def _centre(n: int, columns: int, tile: float) -> tuple[float, float]:
    return (n % columns + 0.5) * tile, (n // columns + 0.5) * tile


@compiled
def _rough_price(parameters: NavigateParameters) -> float:
    """Return the cost of a metre on rough ground, in proportion to the time it takes."""
    return 1.0 / parameters.rough_share


@compiled
def _segment_costs_at_most(
    parameters: NavigateParameters,
    memory: OccupancyGrid,
    a: tuple[float, float],
    b: tuple[float, float],
    price: float,
) -> bool:
    """Return whether a straight segment avoids blocked tiles and ground with a higher cost per metre."""
    unseen = 1 if price >= UNSEEN_PRICE else 0
    rough = 1 if price >= _rough_price(parameters) else 0
    beside = 1 if price >= 1.0 + BESIDE_PRICE else 0
    return segment_is_open(
        memory.tiles, parameters.tile, Open(unseen, rough, beside, 0, 0, 0, 0, TOUCH), a, b
    )


@compiled
def look_ahead(
    parameters: NavigateParameters,
    memory: OccupancyGrid,
    x: float,
    y: float,
    goal_x: float,
    goal_y: float,
) -> tuple[float, float]:
    """Return the farthest point of the cheapest path that a straight segment reaches as cheaply; the goal if possible.

    Args:
        parameters: Parameters of the driver.
        memory: Occupancy grid whose plan leads from here to this goal.
        x, y: Position of the UGV [m].
        goal_x, goal_y: Goal [m].

    Returns:
        The point [m].
    """
    columns = memory.tiles.shape[1]
    n, goal = _tile_of(parameters, memory, x, y), _tile_of(parameters, memory, goal_x, goal_y)
    if n == goal:
        return goal_x, goal_y
    best_x, best_y = _centre(n, columns, parameters.tile)
    farthest = (
        stopping_distance(parameters.max_speed, parameters.max_acceleration)
        + parameters.max_speed * parameters.dt
        + 4.0 * parameters.tile
    )
    rough, path = _rough_price(parameters), memory.path
    highest = price_of(rough, path[n])
    for step in range(_STEPS):
        m = next_tile(path, columns, n)
        if m == n:
            break
        n, highest = m, max(highest, price_of(rough, path[m]))
        to_x, to_y = _centre(n, columns, parameters.tile)
        if n == goal:
            to_x, to_y = goal_x, goal_y
        limit = math.inf if step == 0 else (1.0 + _ROUNDING) * highest
        if not _segment_costs_at_most(parameters, memory, (x, y), (to_x, to_y), limit):
            break
        best_x, best_y = to_x, to_y
        if n == goal or norm(to_x - x, to_y - y) > farthest:
            break
    return best_x, best_y


@compiled
def _slow(parameters: NavigateParameters) -> float:
    """Return the speed on rough ground [m/s]."""
    return (1.0 - _ROUNDING) * parameters.rough_share * parameters.max_speed


@compiled
def _rough_speed(
    parameters: NavigateParameters, memory: OccupancyGrid, own: UgvState, to_x: float, to_y: float
) -> float:
    """Return the largest speed [m/s] that still allows the UGV to slow down before the first rough ground ahead."""
    slow = _slow(parameters)
    even = Open(1, 0, 1, 0, 0, 0, 0, TOUCH)
    a, b = (own.p_x, own.p_y), (to_x, to_y)
    share = open_share(memory.tiles, parameters.tile, even, a, b)
    if share == 1.0:
        return parameters.max_speed
    path = share * norm(b[0] - a[0], b[1] - a[1])
    room = (
        path
        - 0.5 * parameters.dt * norm(own.v_x, own.v_y)
        + stopping_distance(slow, parameters.max_acceleration)
    )
    return min(
        max(speed_to_stop_within(room, parameters.max_acceleration, parameters.dt), slow),
        parameters.max_speed,
    )


@compiled
def _faces_closed_ground(
    parameters: NavigateParameters,
    memory: OccupancyGrid,
    ground: Open,
    own: UgvState,
    to_x: float,
    to_y: float,
) -> bool:
    """Return whether a car at rest has no room ahead and does not face its next point: it would only creep on."""
    if parameters.kinematics.kind != ACKERMANN or abs(signed_speed(own)) > REST:
        return False
    if abs(angle_to(own, to_x, to_y)) <= _FACING:
        return False
    room = _ROOM * parameters.tile
    ahead = own.p_x + room * math.cos(own.heading), own.p_y + room * math.sin(own.heading)
    return not segment_is_open(memory.tiles, parameters.tile, ground, (own.p_x, own.p_y), ahead)


@compiled
def drive_towards(
    parameters: NavigateParameters,
    memory: OccupancyGrid,
    own: UgvState,
    to_x: float,
    to_y: float,
) -> tuple[float, float]:
    """Return the command to a point [m/s²], or else the fastest safe one found on this heading, or else braking.

    Args:
        parameters: Parameters of the driver.
        memory: Occupancy grid of the UGV.
        own: State of the UGV when the command takes effect.
        to_x, to_y: Point [m].
    """
    late = memory.sent.shape[0] > 2
    ground = open_from(memory, parameters.tile, parameters.bold, own.p_x, own.p_y)
    if memory.flags[0].gear != 0:
        angle = angle_to(own, to_x, to_y)
        if abs(angle) > _FACING:
            return _turn_about(parameters, memory, ground, own, angle)
        memory.flags[0].gear = 0
    elif _faces_closed_ground(parameters, memory, ground, own, to_x, to_y):
        return _turn_about(parameters, memory, ground, own, angle_to(own, to_x, to_y))
    speed = _rough_speed(parameters, memory, own, to_x, to_y)
    d_x, d_y = to_x - own.p_x, to_y - own.p_y
    u_x, u_y = goal_control(parameters, own, to_x, to_y, speed)
    if is_safe(parameters, late, memory.tiles, ground, own, u_x, u_y):
        return u_x, u_y
    a = own.p_x, own.p_y
    free = open_share(memory.tiles, parameters.tile, ground, a, (to_x, to_y))
    if free > 0.0:
        for limit in (speed, min(speed, _slow(parameters))):
            for share in _SHARES:
                on_x, on_y = own.p_x + share * free * d_x, own.p_y + share * free * d_y
                u_x, u_y = goal_control(parameters, own, on_x, on_y, limit)
                if is_safe(parameters, late, memory.tiles, ground, own, u_x, u_y):
                    return u_x, u_y
    if parameters.kinematics.kind == ACKERMANN:
        return _turn_about(parameters, memory, ground, own, angle_to(own, to_x, to_y))
    return brake(own.v_x, own.v_y, parameters.max_acceleration, parameters.dt)


@compiled
def _turn_about(
    parameters: NavigateParameters,
    memory: OccupancyGrid,
    ground: Open,
    own: UgvState,
    angle: float,
) -> tuple[float, float]:
    """Return the command [m/s²] of a car that cannot drive to its next point directly: it turns in several moves.

    It turns in one direction until it faces the point or the way is closed, then in the other. `angle`: from its
    heading to the point [rad]; the other arguments are as in `drive_towards`.
    """
    flags, late = memory.flags[0], memory.sent.shape[0] > 2
    if flags.gear != 0:
        u_x, u_y = turn_towards(parameters, own, angle, flags.gear)
        if is_safe(parameters, late, memory.tiles, ground, own, u_x, u_y):
            return u_x, u_y
    if abs(signed_speed(own)) <= REST:
        if flags.gear == 0:
            flags.gear = 1 if abs(angle) > 0.5 * math.pi else -1  # the other one was closed
        else:
            flags.gear = -flags.gear
    return brake(own.v_x, own.v_y, parameters.max_acceleration, parameters.dt)


@compiled
def _plan_if_due(
    parameters: NavigateParameters, memory: OccupancyGrid, tick: int, target: int, tile: int
) -> None:
    """Start a search if one is due, continue it for a tick, and adopt its plan when it ends.

    New tiles do not stop a search: it ends on the tiles as they were, then the next one starts. A new goal stops it.
    """
    flags = memory.flags[0]
    if flags.searching == 0 or flags.aim != target:
        due = flags.planned < 0 or tick - flags.planned >= parameters.plan_ticks
        kept = flags.target == target and (flags.stale == 0 or not due)
        if flags.searching == 0 and kept and is_settled(memory, tile):
            return
        if flags.stale == 0 and flags.aim == target:
            flags.searching = 1  # the tiles have not changed: resume the last search
        else:
            start_search(memory, target)
        flags.planned, flags.stale = tick, 0
    if continue_search(
        _rough_price(parameters), parameters.tile, memory, tile, parameters.plan_tiles
    ):
        adopt_plan(memory)


@compiled
def navigate_control(
    parameters: NavigateParameters,
    memory: OccupancyGrid,
    goals: FloatArray,
    tick: int,
    own: UgvState,
    committed: int,
) -> tuple[float, float]:
    """Return the command [m/s²] to one goal after the other over the known ground; stop at the last one.

    A goal is reached when it is nearer than the tolerance. Without a path or a goal the UGV brakes. While it searches
    for a path to the next goal, it continues to the previous one.

    Args:
        parameters: Parameters of the driver.
        memory: Occupancy grid with all reports so far; changed in place.
        goals: Goals [m]. Shape (goals, 2).
        tick: Current tick.
        own: State of the UGV.
        committed: As in `state_ahead`.
    """
    flags, count = memory.flags[0], goals.shape[0]
    ahead, parent = state_ahead(parameters, memory, tick, own, committed)
    u_x, u_y = brake(ahead.v_x, ahead.v_y, parameters.max_acceleration, parameters.dt)
    if count > 0 and memory.tiles.size > 0:
        reached, _ = next_goal(goals, flags.goal, parameters.goal_tolerance, own.p_x, own.p_y)
        flags.goal = min(reached, count - 1)
        goal_x, goal_y = goals[flags.goal, 0], goals[flags.goal, 1]
        tile = _tile_of(parameters, memory, ahead.p_x, ahead.p_y)
        columns = memory.tiles.shape[1]
        if memory.tiles[tile // columns, tile % columns] == BLOCK:
            i, j = nearest_open(memory, parameters.tile, parameters.bold, ahead.p_x, ahead.p_y)
            to_x, to_y = _centre(i * columns + j, columns, parameters.tile)
            u_x, u_y = drive_towards(parameters, memory, ahead, to_x, to_y)
        else:
            target = _tile_of(parameters, memory, goal_x, goal_y)
            _plan_if_due(parameters, memory, tick, target, tile)
            if has_path(memory.path, tile):
                to_x, to_y = look_ahead(parameters, memory, ahead.p_x, ahead.p_y, goal_x, goal_y)
                u_x, u_y = drive_towards(parameters, memory, ahead, to_x, to_y)
    store_command(memory, tick, parent, u_x, u_y)
    update_claim(parameters, memory, ahead, u_x, u_y)
    return u_x, u_y


Parameters = NavigateParameters
parameters = navigate_parameters


@compiled
def _command(
    driver: Parameters,
    memory: Memory,
    inputs: DriverInputs,
    ground: OccupancyGrid | None,
) -> tuple[float, float]:
    """Return the command [m/s²]; without ground, no code to avoid hazards is compiled."""
    own, goals = inputs.own, inputs.goals
    if ground is None:
        return waypoint_command(driver, memory, goals, own)
    return navigate_control(driver, ground, goals, inputs.tick, own, inputs.committed)


@compiled
def command(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    inputs: DriverInputs,
) -> tuple[float, float]:
    """Return the acceleration that drives from goal to goal around known hazards [m/s²]."""
    return _command(driver, memory, inputs, inputs.ground)
