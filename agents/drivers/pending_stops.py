"""Pending commands of the driver `navigate`, and the certificate of the stops that follow them.

Nothing is certified while other commands may be in effect: after a change of driver, the receiver continues the last
command of the previous driver until it begins a trajectory of this one. The proof is in docs/explanation/ground.md.
"""

from agents.drivers.cautious import is_safe, known_open
from agents.drivers.navigate_parameters import NavigateParameters
from agents.drivers.tile_map import OccupancyGrid
from bus.messages.vehicle import MOST_CARRIED
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.models.ground import CERTIFIED, NO_CLAIM, NO_STOP, NOT_OWN, PATH_UNKNOWN
from sim.models.kinematics import UgvState, step_ugv, ugv_within_walls, wrapped
from sim.models.trajectories import NO_TRAJECTORY, follow_on, keep_trajectory, trajectory_command
from sim.models.vehicles import brake, norm

PLAIN = -2
"""Replaces the committed trajectory if the receiver executes none: commands take effect as they arrive."""

_AS_PREDICTED = 1e-9
"""Largest deviation from the predicted state that counts as none [m, m/s, rad]."""


@compiled
def _step(parameters: NavigateParameters, state: UgvState, u_x: float, u_y: float) -> UgvState:
    """Return the state after a tick with a command [m/s²]."""
    speed, acceleration = parameters.max_speed, parameters.max_acceleration
    return step_ugv(
        parameters.kinematics, state, u_x, u_y, (speed, acceleration), speed, parameters.dt
    )


@compiled
def _is_as_predicted(
    parameters: NavigateParameters, memory: OccupancyGrid, tick: int, own: UgvState, committed: int
) -> bool:
    """Return whether the UGV has moved in the previous tick as the reported trajectory implies.

    Rough ground may have slowed it: its velocity may be any share of the predicted one.
    """
    flags, sent = memory.flags[0], memory.sent
    before = UgvState(flags.p_x, flags.p_y, flags.v_x, flags.v_y, flags.heading)
    u_x, u_y = brake(before.v_x, before.v_y, parameters.max_acceleration, parameters.dt)
    if committed == tick - 1:
        started = sent[committed % sent.shape[0]]
        if started.begins != committed:
            return False
        u_x, u_y = started.acceleration[0], started.acceleration[1]
    due = _step(parameters, before, u_x, u_y)
    square = due.v_x * due.v_x + due.v_y * due.v_y
    share = 1.0
    if square > 0.0:
        share = min(max((due.v_x * own.v_x + due.v_y * own.v_y) / square, 0.0), 1.0)
    v_x, v_y = share * due.v_x, share * due.v_y
    p_x = before.p_x + 0.5 * (before.v_x + v_x) * parameters.dt
    p_y = before.p_y + 0.5 * (before.v_y + v_y) * parameters.dt
    off = max(norm(own.p_x - p_x, own.p_y - p_y), norm(own.v_x - v_x, own.v_y - v_y))
    turned = abs(wrapped(own.heading - due.heading))
    return bool(max(off, turned) <= _AS_PREDICTED)


@compiled
def _check_control(
    parameters: NavigateParameters, memory: OccupancyGrid, tick: int, own: UgvState, committed: int
) -> tuple[bool, bool]:
    """Check that the UGV executes the commands of this driver only. Arguments as in `state_ahead`.

    It does from the start of the run, and otherwise once it has started a trajectory of this driver: all commands sent
    before are then void.

    Returns:
        True if so; and True unless the UGV has left the predicted state, which only other commands explain.
    """
    flags, first, predicted = memory.flags[0], tick + memory.sent.shape[0] - 2, True
    if tick == 0:
        flags.since = NO_TRAJECTORY
    elif flags.answered != tick - 1:
        flags.since = first
    else:
        predicted = _is_as_predicted(parameters, memory, tick, own, committed)
    if committed >= 0:
        flags.since = max(flags.since, 0)
    exclusive = committed >= flags.since
    if exclusive and not predicted:
        flags.since = first
    flags.answered = tick
    flags.p_x, flags.p_y, flags.v_x, flags.v_y = own.p_x, own.p_y, own.v_x, own.v_y
    flags.heading = own.heading
    return exclusive, predicted


@compiled
def state_ahead(
    parameters: NavigateParameters, memory: OccupancyGrid, tick: int, own: UgvState, committed: int
) -> tuple[UgvState, int]:
    """Predict the UGV's state when this tick's command takes effect, and the trajectory committed then.

    The function records in `memory.flags` whether the predicted trajectory, and the stop after the loss of any command,
    stays on tiles known to be drivable. Call it once per tick.

    Args:
        parameters: Parameters of the driver.
        memory: Occupancy grid with the commands sent so far.
        tick: Current tick.
        own: Current state of the UGV.
        committed: First tick of the trajectory executed in the previous tick; NO_TRAJECTORY: none; PLAIN: the receiver
            executes none, and all commands take effect.

    Returns:
        The state, and the first tick of the committed trajectory.
    """
    sent, ahead, rows = memory.sent, memory.committed, memory.sent.shape[0]
    plain = committed == PLAIN
    known, late = known_open(), rows > 2
    stop_x, stop_y = brake(own.v_x, own.v_y, parameters.max_acceleration, parameters.dt)
    exclusive, safe = _check_control(parameters, memory, tick, own, committed)
    safe = safe and is_safe(parameters, late, memory.tiles, known, own, stop_x, stop_y)
    row = committed % rows
    if committed >= 0 and sent[row].begins == committed:
        ahead[0] = sent[row]
        ahead[0].age = tick - committed
    else:
        ahead[0].begins, ahead[0].age = (NO_TRAJECTORY if plain else committed), 1
        ahead[0].turn, ahead[0].cruise, ahead[0].brake = 0, 0, 0
    for k in range(rows - 2):
        due = sent[(tick + k) % rows]
        if plain:
            u_x, u_y = 0.0, 0.0
            if due.begins == tick + k:
                u_x, u_y = due.acceleration[0], due.acceleration[1]
        else:
            follow_on(sent, ahead, tick + k)
            u_x, u_y = trajectory_command(
                ahead[0], own.v_x, own.v_y, parameters.max_acceleration, parameters.dt
            )
            ahead[0].age += 1
        safe = safe and is_safe(parameters, late, memory.tiles, known, own, u_x, u_y)
        own = _step(parameters, own, u_x, u_y)
        own = ugv_within_walls(parameters.kinematics, own, parameters.width, parameters.height)
    claim = CERTIFIED if safe else PATH_UNKNOWN
    memory.flags[0].claim = NO_STOP if plain else claim if exclusive else NOT_OWN
    return own, int(ahead[0].begins)


@compiled
def update_claim(
    parameters: NavigateParameters, memory: OccupancyGrid, ahead: UgvState, u_x: float, u_y: float
) -> None:
    """Update the claim of `state_ahead` for the command of this tick [m/s²].

    Args:
        parameters: Parameters of the driver; a bold one claims nothing.
        memory: Changed in place.
        ahead: State of the UGV when the command takes effect.
        u_x, u_y: Command [m/s²].
    """
    flags, late = memory.flags[0], memory.sent.shape[0] > 2
    if parameters.bold != 0:
        flags.claim = NO_CLAIM
    elif flags.claim == CERTIFIED and not is_safe(
        parameters, late, memory.tiles, known_open(), ahead, u_x, u_y
    ):
        flags.claim = PATH_UNKNOWN


@compiled
def store_command(memory: OccupancyGrid, tick: int, parent: int, u_x: float, u_y: float) -> None:
    """Store the command of this tick [m/s²], which continues the trajectory `parent`, until it takes effect."""
    rows = memory.sent.shape[0]
    begins = tick + rows - 2
    row = memory.sent[begins % rows]
    row.begins, row.parent = begins, parent
    row.acceleration[0], row.acceleration[1] = u_x, u_y


@compiled
def add_stops(memory: OccupancyGrid, tick: int, outgoing: RecordArray) -> tuple[int, int]:
    """Add the trajectories of this tick's command to the outgoing ones.

    Returns:
        First tick of the last of them (-1: none), and their number.
    """
    rows = memory.sent.shape[0]
    last, count = tick + rows - 2, 0
    for begins in range(max(tick, last - MOST_CARRIED + 1), last + 1):
        if memory.sent[begins % rows].begins == begins:
            keep_trajectory(outgoing, memory.sent[begins % rows], tick)
            count += 1
    return (last if count else -1), count
