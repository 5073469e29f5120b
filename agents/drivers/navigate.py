"""The driver that plans: from goal to goal over the ground as it knows it, cautious or bold.

In a tick it plans anew if it must, or goes on with that; it looks along the cheapest way for the farthest point to
which the straight way costs no more a metre, and drives there as `goal_control` does, slower before rough ground. Last
comes the filter: a command that could not be followed by a stop on open tiles gives way to a slower one, and that to
braking.
"""

import math

from agents.drivers.cautious import (
    Open,
    is_safe,
    known_open,
    nearest_open,
    open_from,
    open_way,
    way_is_open,
)
from agents.drivers.parameters import DriverParameters
from agents.drivers.planning import (
    BESIDE_PRICE,
    UNSEEN_PRICE,
    begin_search,
    has_way,
    is_settled,
    next_tile,
    price_of,
    search_on,
    take_plan,
)
from agents.drivers.tile_map import GroundMemory
from agents.drivers.waypoints import goal_control
from bus.messages import MOST_CARRIED
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray
from sim.models.ground import (
    BLOCK,
    CERTIFIED,
    NO_CLAIM,
    NO_STOP,
    TOUCH,
    WAY_UNKNOWN,
    tile_index,
)
from sim.models.motion import NO_MOTION, follow_on, keep_motion, motion_command
from sim.models.vehicles import (
    Motion,
    brake,
    next_goal,
    norm,
    speed_to_stop_within,
    step_vehicle,
    stopping_distance,
    within_walls,
)

PLAIN = -2
"""In the place of the motion that is flown: the receiver flies none, and commands act as they come."""
_STEPS = 64
"""So many tiles of the cheapest way it looks along."""
_SHARES = (1.0, 0.5, 0.2, 0.05)
"""Of the open way ahead: within which of them it tries to stop."""
_ROUNDING = 1e-9
"""By this share a straight way may cost more a metre than the cheapest, and rough ground is driven on slower."""


@compiled
def _tile_of(parameters: DriverParameters, memory: GroundMemory, x: float, y: float) -> int:
    rows, columns = memory.tiles.shape
    return int(
        tile_index(y, parameters.tile, rows) * columns + tile_index(x, parameters.tile, columns)
    )


@compiled
def _centre(n: int, columns: int, tile: float) -> tuple[float, float]:
    return (n % columns + 0.5) * tile, (n // columns + 0.5) * tile


@compiled
def state_ahead(
    parameters: DriverParameters, memory: GroundMemory, tick: int, here: Motion, flown: int
) -> tuple[Motion, int]:
    """Return the state of the UGV when the command of this tick acts, and the motion that it then goes on from.

    It notes in `memory.flags` whether the way until then, and the one to a stop wherever commands are lost on it, lies
    on tiles that are known to be drivable.

    Args:
        parameters: Of the driver.
        memory: With the commands that were sent.
        tick: Now.
        here: Where it is now.
        flown: The motion that it flew in the tick before; NO_MOTION: none; PLAIN: its receiver flies none, and all
            commands act.
    """
    sent, ahead, rows = memory.sent, memory.flown, memory.sent.shape[0]
    plain = flown == PLAIN
    known, late = known_open(), rows > 2
    stop_x, stop_y = brake(here.v_x, here.v_y, parameters.u_max, parameters.dt)
    safe = is_safe(parameters, late, memory.tiles, known, here, stop_x, stop_y)
    own = flown % rows
    if flown >= 0 and sent[own].begins == flown:
        ahead[0] = sent[own]
        ahead[0].age = tick - flown
    else:
        ahead[0].begins, ahead[0].age = (NO_MOTION if plain else flown), 1
        ahead[0].turn, ahead[0].cruise, ahead[0].brake = 0, 0, 0
    for k in range(rows - 2):
        due = sent[(tick + k) % rows]
        if plain:
            u_x, u_y = 0.0, 0.0
            if due.begins == tick + k:
                u_x, u_y = due.first_x, due.first_y
        else:
            follow_on(sent, ahead, tick + k)
            u_x, u_y = motion_command(ahead[0], here.v_x, here.v_y, parameters.u_max, parameters.dt)
            ahead[0].age += 1
        safe = safe and is_safe(parameters, late, memory.tiles, known, here, u_x, u_y)
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(
            here.p_x,
            here.p_y,
            here.v_x,
            here.v_y,
            u_x,
            u_y,
            parameters.v_max,
            parameters.u_max,
            parameters.dt,
        )
        p_x, v_x = within_walls(p_x, v_x, parameters.width)
        p_y, v_y = within_walls(p_y, v_y, parameters.height)
        here = Motion(p_x, p_y, v_x, v_y)
    memory.flags[0].claim = NO_STOP if plain else CERTIFIED if safe else WAY_UNKNOWN
    return here, int(ahead[0].begins)


@compiled
def note_claim(
    parameters: DriverParameters, memory: GroundMemory, ahead: Motion, u_x: float, u_y: float
) -> None:
    """Claim, after `state_ahead`, what the command of this tick [m/s²] leaves to be claimed.

    Args:
        parameters: Of the driver; a bold one claims nothing.
        memory: Its flags are changed.
        ahead: Where the UGV is when the command acts.
        u_x, u_y: The command.
    """
    flags, late = memory.flags[0], memory.sent.shape[0] > 2
    if parameters.bold != 0:
        flags.claim = NO_CLAIM
    elif flags.claim == CERTIFIED and not is_safe(
        parameters, late, memory.tiles, known_open(), ahead, u_x, u_y
    ):
        flags.claim = WAY_UNKNOWN


@compiled
def note_sent(memory: GroundMemory, tick: int, parent: int, u_x: float, u_y: float) -> None:
    """Keep the command of this tick [m/s²], which goes on from the motion `parent`, until it acts."""
    rows = memory.sent.shape[0]
    begins = tick + rows - 2
    row = memory.sent[begins % rows]
    row.begins, row.parent, row.first_x, row.first_y = begins, parent, u_x, u_y


@compiled
def hand_over_stops(memory: GroundMemory, tick: int, motions: RecordArray) -> tuple[int, int]:
    """Put the motions that the command of this tick carries among those that set out.

    Returns:
        The tick in which the last of them begins (-1: none), and how many they are.
    """
    rows = memory.sent.shape[0]
    last, count = tick + rows - 2, 0
    for begins in range(max(tick, last - MOST_CARRIED + 1), last + 1):
        if memory.sent[begins % rows].begins == begins:
            keep_motion(motions, memory.sent[begins % rows], tick)
            count += 1
    return (last if count else -1), count


@compiled
def _rough_price(parameters: DriverParameters) -> float:
    """Cost of a metre on rough ground: so much longer it takes there."""
    return 1.0 / parameters.share


@compiled
def _way_costs_at_most(
    parameters: DriverParameters,
    memory: GroundMemory,
    a: tuple[float, float],
    b: tuple[float, float],
    price: float,
) -> bool:
    """True if the straight way touches neither a blocked tile nor ground that costs more a metre."""
    unseen = 1 if price >= UNSEEN_PRICE else 0
    rough = 1 if price >= _rough_price(parameters) else 0
    beside = 1 if price >= 1.0 + BESIDE_PRICE else 0
    return way_is_open(
        memory.tiles, parameters.tile, Open(unseen, rough, beside, 0, 0, 0, 0, TOUCH), a, b
    )


@compiled
def look_ahead(
    parameters: DriverParameters,
    memory: GroundMemory,
    x: float,
    y: float,
    goal_x: float,
    goal_y: float,
) -> tuple[float, float]:
    """The farthest point along the cheapest way to which a straight way is as good; the goal, if it is one.

    Args:
        parameters: Of the driver.
        memory: With a plan to this goal, that knows a way from here.
        x, y: Where the UGV is [m].
        goal_x, goal_y: The goal [m].

    Returns:
        The point [m].
    """
    columns = memory.tiles.shape[1]
    n, goal = _tile_of(parameters, memory, x, y), _tile_of(parameters, memory, goal_x, goal_y)
    if n == goal:
        return goal_x, goal_y
    best_x, best_y = _centre(n, columns, parameters.tile)
    reach = (
        stopping_distance(parameters.v_max, parameters.u_max)
        + parameters.v_max * parameters.dt
        + 4.0 * parameters.tile
    )
    rough, way = _rough_price(parameters), memory.way
    highest = price_of(rough, way[n])
    for step in range(_STEPS):
        m = next_tile(way, columns, n)
        if m == n:
            break
        n, highest = m, max(highest, price_of(rough, way[m]))
        to_x, to_y = _centre(n, columns, parameters.tile)
        if n == goal:
            to_x, to_y = goal_x, goal_y
        limit = math.inf if step == 0 else (1.0 + _ROUNDING) * highest
        if not _way_costs_at_most(parameters, memory, (x, y), (to_x, to_y), limit):
            break
        best_x, best_y = to_x, to_y
        if n == goal or norm(to_x - x, to_y - y) > reach:
            break
    return best_x, best_y


@compiled
def _slow(parameters: DriverParameters) -> float:
    """As fast as it drives on rough ground [m/s]."""
    return (1.0 - _ROUNDING) * parameters.share * parameters.v_max


@compiled
def _rough_speed(
    parameters: DriverParameters, memory: GroundMemory, here: Motion, to_x: float, to_y: float
) -> float:
    """Largest speed with which it is, at the first rough ground on its way, as slow as that makes it [m/s]."""
    slow = _slow(parameters)
    even = Open(1, 0, 1, 0, 0, 0, 0, TOUCH)
    a, b = (here.p_x, here.p_y), (to_x, to_y)
    share = open_way(memory.tiles, parameters.tile, even, a, b)
    if share == 1.0:
        return parameters.v_max
    way = share * norm(b[0] - a[0], b[1] - a[1])
    room = (
        way
        - 0.5 * parameters.dt * norm(here.v_x, here.v_y)
        + stopping_distance(slow, parameters.u_max)
    )
    return min(
        max(speed_to_stop_within(room, parameters.u_max, parameters.dt), slow), parameters.v_max
    )


@compiled
def drive_towards(
    parameters: DriverParameters,
    memory: GroundMemory,
    here: Motion,
    to_x: float,
    to_y: float,
) -> tuple[float, float]:
    """The command [m/s²] to a point, or the fastest found that is safe on this heading; none is: the one that brakes.

    Args:
        parameters: Of the driver.
        memory: What the UGV knows.
        here: Where it is when the command acts.
        to_x, to_y: The point [m].
    """
    late = memory.sent.shape[0] > 2
    ground = open_from(memory.tiles, parameters.tile, parameters.bold, here.p_x, here.p_y)
    speed = _rough_speed(parameters, memory, here, to_x, to_y)
    d_x, d_y = to_x - here.p_x, to_y - here.p_y
    u_x, u_y = goal_control(here, to_x, to_y, speed, parameters.u_max, parameters.dt)
    if is_safe(parameters, late, memory.tiles, ground, here, u_x, u_y):
        return u_x, u_y
    a = here.p_x, here.p_y
    free = open_way(memory.tiles, parameters.tile, ground, a, (to_x, to_y))
    if free > 0.0:
        for limit in (speed, min(speed, _slow(parameters))):
            for share in _SHARES:
                on_x, on_y = here.p_x + share * free * d_x, here.p_y + share * free * d_y
                u_x, u_y = goal_control(here, on_x, on_y, limit, parameters.u_max, parameters.dt)
                if is_safe(parameters, late, memory.tiles, ground, here, u_x, u_y):
                    return u_x, u_y
    return brake(here.v_x, here.v_y, parameters.u_max, parameters.dt)


@compiled
def _plan_if_due(
    parameters: DriverParameters, memory: GroundMemory, tick: int, target: int, own: int
) -> None:
    """Begin a search if one is due, and go on with it for a tick; the plan that is followed changes where it ends.

    News does not stop a search: it ends on the tiles as they were, and the next one begins then. Another goal does.
    """
    flags = memory.flags[0]
    if flags.searching == 0 or flags.aim != target:
        due = flags.planned < 0 or tick - flags.planned >= parameters.plan_ticks
        kept = flags.target == target and (flags.stale == 0 or not due)
        if flags.searching == 0 and kept and is_settled(memory, own):
            return
        if flags.stale == 0 and flags.aim == target:
            flags.searching = 1  # the tiles are the same: the last one goes on
        else:
            begin_search(memory, target)
        flags.planned, flags.stale = tick, 0
    if search_on(_rough_price(parameters), parameters.tile, memory, own, parameters.plan_tiles):
        take_plan(memory)


@compiled
def navigate_control(
    parameters: DriverParameters,
    memory: GroundMemory,
    goals: FloatArray,
    tick: int,
    here: Motion,
    flown: int,
) -> tuple[float, float]:
    """The command [m/s²] to one goal after the other over the ground as it is known; at the last one the UGV stops.

    A goal is kept until it is nearer than the tolerance. Where there is no way, or no goal, the UGV brakes. While it
    searches for a way to the next goal it goes on to the one before.

    Args:
        parameters: Of the driver.
        memory: With the tiles that have been told until now; changed in place.
        goals: [m], shape (goals, 2).
        tick: Now.
        here: Where the UGV is.
        flown: As in `state_ahead`.
    """
    flags, count, now = memory.flags[0], goals.shape[0], here
    here, parent = state_ahead(parameters, memory, tick, here, flown)
    u_x, u_y = brake(here.v_x, here.v_y, parameters.u_max, parameters.dt)
    if count > 0 and memory.tiles.size > 0:
        reached, _ = next_goal(goals, flags.goal, parameters.tolerance, now.p_x, now.p_y)
        flags.goal = min(reached, count - 1)
        goal_x, goal_y = goals[flags.goal, 0], goals[flags.goal, 1]
        own = _tile_of(parameters, memory, here.p_x, here.p_y)
        columns = memory.tiles.shape[1]
        if memory.tiles[own // columns, own % columns] == BLOCK:
            i, j = nearest_open(memory.tiles, parameters.tile, parameters.bold, here.p_x, here.p_y)
            to_x, to_y = _centre(i * columns + j, columns, parameters.tile)
            u_x, u_y = drive_towards(parameters, memory, here, to_x, to_y)
        else:
            target = _tile_of(parameters, memory, goal_x, goal_y)
            _plan_if_due(parameters, memory, tick, target, own)
            if has_way(memory.way, own):
                to_x, to_y = look_ahead(parameters, memory, here.p_x, here.p_y, goal_x, goal_y)
                u_x, u_y = drive_towards(parameters, memory, here, to_x, to_y)
    note_sent(memory, tick, parent, u_x, u_y)
    note_claim(parameters, memory, here, u_x, u_y)
    return u_x, u_y
