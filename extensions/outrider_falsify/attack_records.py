"""Records of an attack: what a run finds, what its adversaries remember, and what they see at a tick."""

from typing import NamedTuple

import numpy as np

from agents.safety.memory import FilterMemory
from outrider_falsify.conditions import Conditions
from outrider_falsify.draws import Words
from outrider_falsify.opponents import UAV, UGV, Plot
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, record_type
from sim.engine.monitor import certificate_counters
from sim.engine.world_state import BatchState, BatchTables
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion, norm

RING = 8
"""Commands that are remembered: so many ticks at most are they late."""


class AttackResult(NamedTuple):
    """The columns of what is found, a row each run."""

    max_distance: float
    """Largest distance [m]."""
    max_excess: float
    """Largest d - d_cert [m]."""
    overridden: float
    """Share of ticks with an intervention."""
    uncertified: float
    """Share of the ticks since the first detection arrived that are not certified."""
    mean_distance: float
    """[m]"""
    max_age: float
    """Largest age of the newest detection [s]."""
    certified_lost: float
    """Ticks certified with a distance of r_v or more at them or, if A5' holds, until the next."""
    broken: float
    """Ticks at which the certificate is lost although its assumptions hold, as the simulator counts them."""
    max_certified: float
    """Largest distance while certified [m]."""


class Trouble(NamedTuple):
    """The trouble that the adversary makes now, in ticks; a row of an array of one."""

    dark: int
    """For so long nothing is detected yet."""
    seen: int
    """1 if there was a detection in the last tick."""
    silent: int
    """For so long no command comes yet."""
    late: int
    """Commands set out so much later than they should."""
    away: int
    """For so long the UAV's process is away yet."""


class Roles(NamedTuple):
    """The adversaries that play now, by their codes, and the state of the UAV's; a row of an array of one."""

    inner: int
    """A code of `INNERS`."""
    ugv: int
    """A code of `UGVS`."""
    error: int
    """A code of `ERRORS`."""
    blows: int
    """A code of `WINDS`."""
    losses: int
    """A code of `LOSSES`."""
    rate: float
    """Of the phase of what swings [rad/s]."""
    controller_x: float
    controller_y: float
    """State of the controller (15)."""
    filtering: bool
    """False while another law flies than the filter's."""


class TickSums(NamedTuple):
    """Sums over the ticks of a run, of which its shares are made; a row of an array of one."""

    distance: float
    """[m]"""
    overridden: int
    seen: int
    """Ticks since the first detection arrived."""
    uncertified: int
    """Those of them that are not certified."""


class Room(NamedTuple):
    """The memory of a run, beside the world's and the filter's; arrays that change in place."""

    plots: RecordArray
    """`Plot`. (2,)"""
    trouble: RecordArray
    """`Trouble`. (1,)"""
    roles: RecordArray
    """`Roles`. (1,)"""
    sums: RecordArray
    """`TickSums`. (1,)"""
    before: RecordArray
    now: RecordArray
    """`Motion` of UAV and UGV as they truly are, at the last tick and now. (2,)"""
    ring: FloatArray
    """The commands of the last ticks [m/s²], and 1 for each that carries a motion. (RING, 3)"""
    counts: RecordArray
    """`CertificateCounters`. (1,)"""


class Run(NamedTuple):
    """One run of an attack, in world 0 of a batch."""

    tables: BatchTables
    state: BatchState
    """The world. UAV 0 is vehicle 0, the UGV vehicle 1."""
    memory: FilterMemory
    """Of the filter."""
    room: Room
    """Of all else."""
    bounds: SafetyBounds
    """The declared numbers; the laws that switch use its bounds only."""
    conditions: Conditions
    """Who guards and who attacks."""
    random: Words
    """State of the adversary's draws. (1,)"""
    results: RecordArray
    """Filled: `AttackResult`. (1,)"""


class View(NamedTuple):
    """The adversary's view of a tick."""

    tick: int
    here: Motion
    """The UAV, as it is told that it moves."""
    x: float
    y: float
    """The true p_a - p_g [m]."""
    distance: float
    """Its norm [m]."""


def empty_room() -> Room:
    """Room for runs, one after the other."""
    return Room(
        plots=np.zeros(2, record_type(Plot)),
        trouble=np.zeros(1, record_type(Trouble)),
        roles=np.zeros(1, record_type(Roles)),
        sums=np.zeros(1, record_type(TickSums)),
        before=np.zeros(2, record_type(Motion)),
        now=np.zeros(2, record_type(Motion)),
        ring=np.zeros((RING, 3)),
        counts=certificate_counters(1),
    )


@compiled
def keep_states(state: BatchState, states: RecordArray) -> None:
    """Copy how the vehicles truly move into an array of `Motion`."""
    for k in range(states.shape[0]):
        row, vehicle = states[k], state.vehicles[0, k]
        row.p_x, row.p_y = vehicle.position[0], vehicle.position[1]
        row.v_x, row.v_y = vehicle.velocity[0], vehicle.velocity[1]


@compiled
def apart(now: RecordArray) -> tuple[float, float, float]:
    """Return p_a - p_g of two motions and its norm [m]."""
    x, y = now[UAV].p_x - now[UGV].p_x, now[UAV].p_y - now[UGV].p_y
    return x, y, norm(x, y)


@compiled
def view_of(run: Run, tick: int) -> View:
    """Return what the adversary sees at the beginning of a tick."""
    uav = run.state.vehicles[0, UAV]
    there, moving = uav.reference_position, uav.reference_velocity
    x, y, d = apart(run.room.now)
    return View(tick, Motion(there[0], there[1], moving[0], moving[1]), x, y, d)
