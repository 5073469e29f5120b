"""Records of an attack: results, memory of the adversaries, and their view of a tick."""

from typing import NamedTuple

import numpy as np

from agents.safety.memory import FilterMemory
from outrider_falsify.conditions import Conditions
from outrider_falsify.heights import Heights
from outrider_falsify.opponents import UAV, UGV, AdversaryState
from outrider_falsify.rng import RngState
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, record_type
from sim.engine.monitor import certificate_counters
from sim.engine.world_state import BatchState, BatchTables
from sim.models.safety import SafetyBounds
from sim.models.vehicles import State, norm

RING = 8
"""Number of stored commands: the largest delay that the adversary imposes [ticks]."""


class AttackResult(NamedTuple):
    """Columns of the results, one row per run."""

    max_distance: float
    """Largest distance [m]."""
    max_excess: float
    """Largest d - d_cert [m]."""
    overridden: float
    """Share of ticks at which the guard overrides the nominal control."""
    uncertified: float
    """Share of uncertified ticks since the first detection arrived."""
    mean_distance: float
    """[m]"""
    max_age: float
    """Largest age of the newest detection [s]."""
    certified_lost: float
    """Certified ticks with a distance of r_v or more at the tick or, if A5' holds, before the next."""
    lost: float
    """Ticks out of sight."""
    broken: float
    """Ticks at which the certificate is lost although its assumptions hold, as the simulator counts them."""
    max_certified: float
    """Largest distance while certified [m]."""


class Trouble(NamedTuple):
    """Current network trouble, in ticks; a row of an array of one."""

    blackout: int
    """Remaining ticks of the detections' blackout."""
    seen: int
    """1 if there was a detection in the last tick."""
    silent: int
    """Remaining ticks without a command."""
    late: int
    """Additional delay of the commands sent."""
    away: int
    """Remaining ticks for which the UAV's process is disconnected."""


class Roles(NamedTuple):
    """Codes of the active adversaries and the controller state of the UAV's; a row of an array of one."""

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
    climb: float
    """Vertical acceleration that the adversary in the UAV wants [m/s²]."""
    radius: float
    """Radius within which the UGV was visible at the last tick [m]."""
    rate: float
    """Angular rate of periodic controls [rad/s]."""
    controller_x: float
    controller_y: float
    """State of the controller (15)."""
    filtering: bool
    """False while a law other than the filter flies."""


class TickSums(NamedTuple):
    """Sums over the ticks of a run, from which shares are computed; a row of an array of one."""

    distance: float
    """[m]"""
    overridden: int
    seen: int
    """Ticks since the first detection arrived."""
    uncertified: int
    """Uncertified ticks among them."""


class Scratch(NamedTuple):
    """Working memory of a run besides the world's and the filter's; arrays that change in place."""

    adversaries: RecordArray
    """`AdversaryState`. Shape (2,)."""
    trouble: RecordArray
    """`Trouble`. Shape (1,)."""
    roles: RecordArray
    """`Roles`. Shape (1,)."""
    sums: RecordArray
    """`TickSums`. Shape (1,)."""
    before: RecordArray
    now: RecordArray
    """True `State` of UAV and UGV at the last tick and now. Shape (2,)."""
    ring: FloatArray
    """Last commands [m/s²]: horizontal; 1 for one that carries a trajectory; vertical. Shape (RING, 4)."""
    counts: RecordArray
    """`CertificateCounters`. Shape (1,)."""


class Run(NamedTuple):
    """One run of an attack, in world 0 of a batch."""

    tables: BatchTables
    state: BatchState
    """State of the world: UAV 0 is vehicle 0, the UGV is vehicle 1."""
    memory: FilterMemory
    """Memory of the safety filter."""
    scratch: Scratch
    """Working memory of everything else."""
    bounds: SafetyBounds
    """Declared bounds; switching laws use the vehicle limits only."""
    conditions: Conditions
    """Guard, adversaries and network."""
    random: RngState
    """State of the adversary's random number generator. Shape (1,)."""
    results: RecordArray
    """`AttackResult`, written by the run. Shape (1,)."""
    heights: Heights | None
    """Altitude of the UAV; None: it flies in the plane, and nothing is compiled for an altitude."""


class View(NamedTuple):
    """The adversary's view of a tick."""

    tick: int
    uav: State
    """Reference state of the UAV."""
    x: float
    y: float
    """True relative position p_a - p_g [m]."""
    distance: float
    """Norm of the relative position [m]."""


def empty_scratch() -> Scratch:
    """Allocate working memory, reused by consecutive runs."""
    return Scratch(
        adversaries=np.zeros(2, record_type(AdversaryState)),
        trouble=np.zeros(1, record_type(Trouble)),
        roles=np.zeros(1, record_type(Roles)),
        sums=np.zeros(1, record_type(TickSums)),
        before=np.zeros(2, record_type(State)),
        now=np.zeros(2, record_type(State)),
        ring=np.zeros((RING, 4)),
        counts=certificate_counters(1),
    )


@compiled
def keep_states(state: BatchState, states: RecordArray) -> None:
    """Copy the true states of the vehicles into an array of `State`."""
    for k in range(states.shape[0]):
        row, vehicle = states[k], state.vehicles[0, k]
        row.p_x, row.p_y = vehicle.position[0], vehicle.position[1]
        row.v_x, row.v_y = vehicle.velocity[0], vehicle.velocity[1]


@compiled
def apart(now: RecordArray) -> tuple[float, float, float]:
    """Return the relative position p_a - p_g of two states and its norm [m]."""
    x, y = now[UAV].p_x - now[UGV].p_x, now[UAV].p_y - now[UGV].p_y
    return x, y, norm(x, y)


@compiled
def view_of(run: Run, tick: int) -> View:
    """Return the adversary's view at the start of a tick."""
    uav = run.state.vehicles[0, UAV]
    there, moving = uav.reference_position, uav.reference_velocity
    x, y, d = apart(run.scratch.now)
    return View(tick, State(there[0], there[1], moving[0], moving[1]), x, y, d)
