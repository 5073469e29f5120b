"""An attack on the certificate.

The project's own world and links, the UAV's filter, and adversaries in everything else.

The adversary knows the truth and the code. It is the inner control, the UGV, the errors of the detections, which of
them are made at all, and what becomes of commands. Everything is drawn from the seed and the run's number, so any run
can be flown again alone.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from agents.control.certificate import CERTIFIED, INNER, NO_DETECTION
from agents.control.discs import KEPT, NEVER, bound_of, certified_distance, newest_detection
from agents.control.guard import (
    GuardState,
    begin_guard,
    forget_commands,
    guard,
    guard_state,
    note_detection,
    note_position,
)
from agents.control.handover import DUST, certificate
from agents.control.promise import Declared, Promise
from agents.control.tracking import tracking_output, tracking_step
from agents.control.visibility import raw_switching_radius
from bus.messages import Area, LinkKind, LinkSettings, Sensor
from outrider.experiments.falsify.draws import next_share
from outrider.experiments.falsify.lost_motions import ALIVE, LOSSES, Pending, loses
from sim.engine.batch import Batch
from sim.engine.world_state import (
    ANSWERED,
    CARRIED,
    LAST,
    LOOK_X,
    LOOK_Y,
    TAKEN,
    U_X,
    U_Y,
    BatchState,
    BatchTables,
)
from sim.engine.world_tick import (
    begin_world,
    deliver_detections,
    move,
    put_off,
    receive_commands,
    truth_of,
)
from sim.kernels.compile import FloatArray, IntArray, borrowing, compiled, released
from sim.models.inner_loop import InnerLoop, needed_reserve, tracking_error
from sim.models.motion import keep_motion, waited
from sim.models.randomness import draw
from sim.models.vehicles import Motion, brake, clip_norm, norm
from sim.scenario.types import (
    Certificate,
    Coverage,
    Detections,
    LinkTable,
    Scenario,
    Tracking,
    Uav,
    Ugv,
    VehicleLinks,
    Visibility,
    Wind,
)

FILTER, SWITCH_SERVO, SWITCH_BEST, SWITCH_TRACKING, PAPER = range(5)
LAWS = {
    "filter": FILTER,
    "switch_servo": SWITCH_SERVO,
    "switch_best": SWITCH_BEST,
    "switch_tracking": SWITCH_TRACKING,
    "paper": PAPER,
}
"""The laws that guard the promise: the filter.

Beyond a radius of d_cert full speed to the newest detection, full speed to the one with
the least bound, or tracking (15); beyond (18) of the newest detection's distance tracking (15)."""

INNERS = (
    "outward",
    "random",
    "tangential",
    "outward_then_tangential",
    "sinusoidal",
    "tracking",
    "still",
    "away_from_detection",
)
UGVS = ("flees", "straight", "random", "turns", "dodges", "ambush", "still")
ERRORS = ("ball", "sphere", "alternating", "constant", "hides", "none")
BLACKOUTS = ("none", "periodic", "random", "when_far")
AREAS = ("open", "corner", "small")
"""The area in which it is flown: so large that nobody meets a wall; from a corner of that.

In a room of 9 m by 7 m, at the paper's radius.
"""
WINDS = ("outward", "constant", "random", "pumping", "turns", "flips")
"""The way in which wind and own position drive the UAV: away from the UGV; one way; another now and then; the way it is
going, off its reference; the way that it accelerates; towards the UGV while that is detected, and then away.
"""
DISTURBANCES = ("none", "single_losses", "silences", "late", "law_changes", "rejoins")
"""The disturbances that break A5 now and then: a command that is lost; none for up to `silence`.

All later than declared for a while; the
filter switched off for a while and begun anew; a process that is away for a while and joins again."""

ANY = -1
"""In place of an adversary's number: another one for each run.

Of an inner control or a UGV also now and then within the run.
"""

(
    MAX_DISTANCE,
    MAX_EXCESS,
    INTERVENED,
    UNCERTIFIED,
    MEAN_DISTANCE,
    MAX_AGE,
    CERTIFIED_LOST,
    BROKEN,
    MAX_CERTIFIED,
) = range(9)
RESULTS = 9

_ATTACK = 1001  # purpose of the draws
_RING = 256
"""Commands that are remembered, to see whether they act when they should."""
_A_C, _B_C, _C_C, _D_C = -3.0, -3.0, -8.0 / 3.0, -3.0  # (15) with the paper's closed loop (s + 1)^3


class Conditions(NamedTuple):
    """The conditions of one attack: who guards, who attacks, and over which network. Times in s, lengths in m."""

    law: int = FILTER
    inner: int = ANY
    ugv: int = ANY
    error: int = ANY
    blackout: int = 0
    blackout_time: float = 0.0
    """Longest time without a detection; at least one lies between two blackouts."""
    latency: float = 0.0
    """From a detection to its arrival, at most."""
    scattered: bool = False
    """Each detection has a latency of its own, so they overtake each other."""
    delay: float = 0.0
    """From a command to the tick in which it acts."""
    jitter: bool = False
    """Commands may be earlier than that, each by a time of its own."""
    duplicates: float = 0.0
    """Share of commands that come twice."""
    disturbance: int = 0
    """The disturbance that breaks A5 now and then, an index of `DISTURBANCES`."""
    silence: float = 0.5
    """Longest time without a command, where that is the disturbance."""
    hold: float = 2.0
    """For how long the vehicle goes on with its last command."""
    u_g: float = 0.1
    """Largest acceleration of the UGV [m/s²]; infinite: it turns on the spot, which the theorem allows."""
    error_share: float = 1.0
    """The errors' norm as a share of eps; above 1 breaks an assumption."""
    outage: float = 0.0
    """Longest time from the beginning of a motion to that of the next, B; 0: commands carry no motions."""
    losses: int = 0
    """The motions that are lost, an index of `LOSSES`; never more than B allows."""
    wind: float = 0.0
    """Largest acceleration of the wind, W [m/s²]."""
    own_error: float = 0.0
    """Largest error of the own position, eps_a [m]."""
    gains: tuple[float, float] = (1.0, 2.0)
    """Of the inner loop, k_p [1/s²] and k_d [1/s]; its reserve is just what it needs."""
    jumps: float = 0.0
    """The UAV's distance from what it is told, anywhere at any tick, without an inner loop [m]; 0: with one."""
    blows: int = ANY
    """The direction of wind, own position and jumps, an index of `WINDS`."""
    radius: float = 0.0
    """Of the laws that switch [m]."""
    r_v: float = 4.75
    """Visibility radius [m]."""
    area: int = 0
    """The area, an index of `AREAS`."""


@compiled
def _choose(state: npt.NDArray[np.uint64], wanted: int, count: int) -> int:
    return wanted if wanted >= 0 else int(next_share(state) * count)


@compiled
def _direction(x: float, y: float) -> tuple[float, float]:
    length = norm(x, y)
    if length == 0.0:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def _inner(
    kind: int,
    x: float,
    y: float,
    v_x: float,
    v_y: float,
    zx: float,
    zy: float,
    phase: float,
    held: FloatArray,
    u: float,
) -> tuple[float, float]:
    """The command that the inner control wants.

    (x, y) is the true p_a - p_g, (zx, zy) that of the newest detection, `held` its memory.
    """
    e_x, e_y = _direction(x, y)
    side = held[2]
    if kind == 0:
        return u * e_x, u * e_y
    if kind == 1:
        return held[0], held[1]
    if kind == 2:
        return -side * u * e_y, side * u * e_x
    if kind == 3:
        return (u * e_x, u * e_y) if math.sin(phase) > 0.0 else (-side * u * e_y, side * u * e_x)
    if kind == 4:
        s, c = math.sin(phase), math.cos(phase)
        return u * (c * e_x - side * s * e_y), u * (c * e_y + side * s * e_x)
    if kind == 5:
        return held[3], held[4]
    if kind == 6:
        return -v_x / 0.05, -v_y / 0.05
    e_x, e_y = _direction(zx, zy)
    return u * e_x, u * e_y


@compiled
def _ugv(
    kind: int,
    x: float,
    y: float,
    v_x: float,
    v_y: float,
    w_x: float,
    w_y: float,
    held: FloatArray,
    u: float,
) -> tuple[float, float]:
    """The UGV's command; (x, y) is p_a - p_g, v the UAV's velocity, w its own."""
    e_x, e_y = _direction(x, y)
    side = held[2]
    if kind == 0:
        return -u * e_x, -u * e_y
    if kind == 1:
        return u * held[3], u * held[4]
    if kind == 2:
        return held[0], held[1]
    if kind == 3:
        d_x, d_y = _direction(w_x, w_y)
        return u * (d_x - side * d_y) * 0.7, u * (d_y + side * d_x) * 0.7
    if kind == 4:
        d_x, d_y = _direction(v_x, v_y)
        return -u * d_x, -u * d_y
    if kind == 5:
        outward = v_x * e_x + v_y * e_y
        return (-u * e_x, -u * e_y) if outward > 0.0 else (u * e_x, u * e_y)
    return brake(w_x, w_y, u, 0.05)


@compiled
def _error(
    kind: int,
    random: npt.NDArray[np.uint64],
    tick: int,
    size: float,
    x: float,
    y: float,
    held: FloatArray,
) -> tuple[float, float]:
    """The error of one detected position, of norm `size` at most."""
    if kind == 5:
        return 0.0, 0.0
    if kind <= 1:
        angle = 2.0 * math.pi * next_share(random)
        radius = size * (math.sqrt(next_share(random)) if kind == 0 else 1.0)
        return radius * math.cos(angle), radius * math.sin(angle)
    e_x, e_y = _direction(x, y)
    if kind == 2:
        sign = size if tick % 2 else -size
        return sign * e_x, sign * e_y
    if kind == 3:
        return size * held[5], size * held[6]
    return size * e_x, size * e_y  # the UGV seems nearer than it is


@compiled
def _push(
    kind: int,
    dark: int,
    x: float,
    y: float,
    off: FloatArray,
    held: FloatArray,
    acting: FloatArray,
) -> tuple[float, float]:
    """The way in which wind and own position drive the UAV, a unit vector.

    Args:
        kind: An index of `WINDS`.
        dark: Ticks for which nothing is detected yet.
        x, y: The true p_a - p_g [m].
        off: The velocity at which it leaves its reference [m/s].
        held: The adversary's memory.
        acting: The UAV's last command [m/s²].
    """
    e_x, e_y = _direction(x, y)
    if kind == 0:
        return e_x, e_y
    if kind <= 2:
        return math.cos(held[7]), math.sin(held[7])
    if kind == 3:
        return _direction(off[0], off[1]) if norm(off[0], off[1]) > 0.0 else (e_x, e_y)
    if kind == 4:
        return _direction(acting[0], acting[1])
    return (e_x, e_y) if dark > 0 else (-e_x, -e_y)


@borrowing
def _disturb(
    c: Conditions,
    s: BatchState,
    random: npt.NDArray[np.uint64],
    kind: int,
    dark: int,
    x: float,
    y: float,
    held: FloatArray,
    off: FloatArray,
) -> int:
    """Set what acts on the UAV beside its commands in the coming tick; how the next one is directed.

    Arguments as in `_push`; `off` is room for a vector.
    """
    if next_share(random) < 0.02:
        held[7] = 2.0 * math.pi * next_share(random) if kind == 2 else held[7]
        if c.blows < 0 and next_share(random) < 0.1:
            kind = _choose(random, c.blows, len(WINDS))
    row = s.tracking[0, 0]
    off[0], off[1] = row.v_x, row.v_y
    w_x, w_y = _push(kind, dark, x, y, off, held, s.truth.commands[0, 0])
    strength = 1.0 if c.jumps > 0.0 else c.wind
    row.wind_x, row.wind_y = strength * w_x, strength * w_y
    row.own_x, row.own_y = -c.own_error * w_x, -c.own_error * w_y
    return kind


@borrowing
def _jump(c: Conditions, s: BatchState, escorts: IntArray) -> None:
    """Put the UAV off what it is told, the way that its wind blows."""
    row = s.tracking[0, 0]
    row.x, row.y, row.v_x, row.v_y = c.jumps * row.wind_x, c.jumps * row.wind_y, 0.0, 0.0
    put_off(
        s.truth.position[0],
        s.truth.velocity[0],
        s.told.position[0],
        s.told.velocity[0],
        escorts,
        s.tracking[0],
    )


@compiled
def _redraw(random: npt.NDArray[np.uint64], held: FloatArray, u: float) -> None:
    angle, strength = 2.0 * math.pi * next_share(random), u * min(1.0, 2.0 * next_share(random))
    held[0], held[1] = strength * math.cos(angle), strength * math.sin(angle)
    held[2] = 1.0 if next_share(random) < 0.5 else -1.0


@compiled
def _guard(c: Conditions, x: float, y: float, d: float, r: float) -> bool:
    """True if a law that switches takes over: at a distance d certified, r to the newest detection."""
    return r >= c.radius if c.law == PAPER else d >= c.radius


@compiled
def largest_in_tick(
    r_x: float, r_y: float, v_x: float, v_y: float, w_x: float, w_y: float, dt: float
) -> float:
    """The largest distance within a tick of two vehicles with constant accelerations [m].

    The derivative of half its square is a cubic in the time; between its stationary points it has one root at most.

    Args:
        r_x, r_y: Relative position at the tick's start [m].
        v_x, v_y: Relative velocity then [m/s].
        w_x, w_y: And at its end [m/s].
        dt: Its length [s].
    """
    a_x, a_y = (w_x - v_x) / dt, (w_y - v_y) / dt
    c_0, c_1 = r_x * v_x + r_y * v_y, v_x * v_x + v_y * v_y + r_x * a_x + r_y * a_y
    c_2, c_3 = 1.5 * (v_x * a_x + v_y * a_y), 0.5 * (a_x * a_x + a_y * a_y)
    first = second = dt  # where the derivative turns
    root = c_2 * c_2 - 3.0 * c_3 * c_1
    if c_3 > 0.0 and root > 0.0:
        first = min(max((-c_2 - math.sqrt(root)) / (3.0 * c_3), 0.0), dt)
        second = min(max((-c_2 + math.sqrt(root)) / (3.0 * c_3), 0.0), dt)
    elif c_3 == 0.0 and c_2 != 0.0:
        first = min(max(-0.5 * c_1 / c_2, 0.0), dt)
    most = max(norm(r_x, r_y), norm(r_x + 0.5 * (v_x + w_x) * dt, r_y + 0.5 * (v_y + w_y) * dt))
    for k in range(3):
        low = 0.0 if k == 0 else (first if k == 1 else second)
        high = first if k == 0 else (second if k == 1 else dt)
        if (
            ((c_3 * low + c_2) * low + c_1) * low + c_0
            > 0.0
            > ((c_3 * high + c_2) * high + c_1) * high + c_0
        ):
            for _ in range(50):
                middle = 0.5 * (low + high)
                if ((c_3 * middle + c_2) * middle + c_1) * middle + c_0 > 0.0:
                    low = middle
                else:
                    high = middle
            most = max(
                most, norm(r_x + (v_x + 0.5 * a_x * low) * low, r_y + (v_y + 0.5 * a_y * low) * low)
            )
    return most


@borrowing
def _within_tick(before: FloatArray, after: FloatArray, a: int, g: int, dt: float) -> float:
    """The largest distance within the last tick [m]; rows are position and velocity.

    At the ends only, where a wall was met.
    """
    r_x, r_y = before[a, 0] - before[g, 0], before[a, 1] - before[g, 1]
    most = max(norm(r_x, r_y), norm(after[a, 0] - after[g, 0], after[a, 1] - after[g, 1]))
    for k in (a, g):
        for i in range(2):
            if (
                abs(after[k, i] - before[k, i] - 0.5 * (before[k, 2 + i] + after[k, 2 + i]) * dt)
                > 1e-12
            ):
                return most
    v_x, v_y = before[a, 2] - before[g, 2], before[a, 3] - before[g, 3]
    return max(
        most,
        largest_in_tick(
            r_x, r_y, v_x, v_y, after[a, 2] - after[g, 2], after[a, 3] - after[g, 3], dt
        ),
    )


@borrowing
def _keep_states(s: BatchState, states: FloatArray) -> None:
    for k in range(states.shape[0]):
        states[k, 0], states[k, 1] = s.truth.position[0, k, 0], s.truth.position[0, k, 1]
        states[k, 2], states[k, 3] = s.truth.velocity[0, k, 0], s.truth.velocity[0, k, 1]


@released
def fly_one(
    tables: BatchTables,
    s: BatchState,
    memory: GuardState,
    promise: Promise,
    conditions: Conditions,
    work: FloatArray,
    random: npt.NDArray[np.uint64],
    ticks: int,
    result: FloatArray,
) -> None:
    """One run of an attack, in world 0 of a batch that is as it was at the start, with its keys.

    Args:
        tables, s: The world. UAV 0 is vehicle 0, the UGV vehicle 1.
        memory: Of the filter.
        promise: The declared numbers; the laws that switch use its bounds only.
        conditions: Who guards and who attacks.
        work: Room for what the adversaries remember, for two states and the commands of the last ticks. (6 + _RING, 10)
        random: State of the adversary's draws. (1,)
        ticks: Length of the run.
        result: Filled: largest distance [m]; largest d - d_cert [m]; share of ticks with an intervention, and of those
            since the first detection arrived the share uncertified; mean distance [m]; largest age of the newest
            detection [s]; ticks certified with a distance of r_v or more at them or, if the right command acted, until
            the next; ticks at which the certificate is lost although its assumptions hold; largest distance while
            certified [m]. Shape (RESULTS,).
    """
    c, p, w, sent = conditions, promise, tables.world[0], s.sent[0]
    dt, u_a, v_a, v_g = p.dt, p.u_a, p.v_a, p.v_g
    d_ticks = p.delay_ticks
    b_ticks, silence_ticks = round(c.blackout_time / dt), max(1, round(c.silence / dt))
    u_g = c.u_g if math.isfinite(c.u_g) else 2.0 * v_g / dt
    inner, ugv, error = (
        _choose(random, c.inner, len(INNERS)),
        _choose(random, c.ugv, len(UGVS)),
        _choose(random, c.error, len(ERRORS)),
    )
    a, g, before, now, ring = work[0], work[1], work[2:4], work[4:6], work[6:]
    work[:] = 0.0
    _redraw(random, a, u_a)
    _redraw(random, g, u_g)
    angle = 2.0 * math.pi * next_share(random)
    g[3], g[4] = math.cos(angle), math.sin(angle)
    angle = 2.0 * math.pi * next_share(random)
    g[5], g[6] = math.cos(angle), math.sin(angle)
    rate = 0.05 + 1.5 * next_share(random)  # of the phase [rad/s]
    xc_x, xc_y = 0.0, 0.0
    position = s.truth.position[0]
    if c.area == 0:
        position[1, 0], position[1, 1] = 0.5 * w.width, 0.5 * w.height
    elif c.area == 1:
        position[1, 0], position[1, 1] = c.r_v * next_share(random), c.r_v * next_share(random)
    else:
        position[1, 0], position[1, 1] = w.width * next_share(random), w.height * next_share(random)
    angle, far = (
        2.0 * math.pi * next_share(random),
        c.r_v * (0.1 if next_share(random) < 0.5 else 0.5),
    )
    for i, away in ((0, far * math.cos(angle)), (1, far * math.sin(angle))):
        position[0, i] = min(max(position[1, i] + away, 0.0), w.width if i == 0 else w.height)
    disturbed, blows = s.tracking.shape[1] > 0, 0
    if disturbed:
        for k in range(2):
            for i in range(2):
                s.told.position[0, k, i] = position[k, i]
        g[7], blows = 2.0 * math.pi * next_share(random), _choose(random, c.blows, len(WINDS))
    begin_guard(memory)
    begin_world(tables, s, 0)
    dark, since_seen, last_break, certified_before, first_seen, seen_ticks = (
        0,
        1,
        -1_000_000,
        False,
        -1,
        0,
    )
    silent, late, away_ticks, filtering, suspected, since = 0, 0, 0, True, 0, 0
    total, intervened, uncertified = 0.0, 0, 0
    acts, code = INNER, NO_DETECTION
    result[:] = 0.0
    result[MAX_EXCESS] = -math.inf
    _keep_states(s, now)
    losses, allowed = _choose(random, c.losses, len(LOSSES)), int(c.outage / dt + DUST)
    a[7] = ALIVE
    for tick in range(ticks + 1):
        t = tick * dt
        p_x, p_y = s.told.position[0, 0, 0], s.told.position[0, 0, 1]
        v_x, v_y = s.told.velocity[0, 0, 0], s.told.velocity[0, 0, 1]
        q_x, q_y, w_x, w_y = now[1, 0], now[1, 1], now[1, 2], now[1, 3]
        x, y = now[0, 0] - q_x, now[0, 1] - q_y
        d = norm(x, y)
        # what has reached the UAV's computer
        if away_ticks == 0:
            note_position(memory, tick, p_x, p_y)
            for n in range(s.arrived[0, 0]):
                look = s.received[0, 0, n]
                note_detection(
                    p, memory, int(look[TAKEN]), tick, look[LOOK_X], look[LOOK_Y], p_x, p_y
                )
        detections = memory.detections
        new = newest_detection(detections)
        bound = certified_distance(p, detections, tick, p_x, p_y)
        age = tick - detections[new].taken  # if there is any
        result[MAX_DISTANCE] = max(result[MAX_DISTANCE], d)
        if new >= 0:
            result[MAX_EXCESS] = max(result[MAX_EXCESS], d - bound)
            result[MAX_AGE] = max(result[MAX_AGE], age * dt)
            first_seen = tick if first_seen < 0 else first_seen
        total += d
        # the adversary in the UAV
        if next_share(random) < 0.01:
            _redraw(random, a, u_a)
            if c.inner < 0 and next_share(random) < 0.3:
                inner = _choose(random, c.inner, len(INNERS))
        z_x, z_y = (p_x - detections[new].x, p_y - detections[new].y) if new >= 0 else (0.0, 0.0)
        if inner == 5 or c.law >= SWITCH_TRACKING:
            a[3], a[4] = tracking_output(xc_x, xc_y, z_x, z_y, _C_C, _D_C)
            xc_x, xc_y = tracking_step(xc_x, xc_y, z_x, z_y, _A_C, _B_C, dt)
        u_x, u_y = _inner(inner, x, y, v_x, v_y, z_x, z_y, rate * t, a, u_a)
        u_x, u_y = clip_norm(u_x, u_y, u_a)
        certified = carrying = False
        if c.law == FILTER:
            if c.disturbance == 4 and next_share(random) < 0.01:
                filtering = not filtering
                if filtering:
                    begin_guard(memory)
                    note_position(memory, tick, p_x, p_y)
                last_break = tick
            if c.disturbance == 5 and away_ticks == 0 and next_share(random) < 0.005:
                away_ticks = 1 + int(next_share(random) * 20)
            if away_ticks > 0:
                away_ticks -= 1
                u_x, u_y, last_break = math.nan, math.nan, tick
                if away_ticks == 0:
                    forget_commands(memory)
            elif filtering:
                flown = s.flown[0, 0, 0].begins
                here = Motion(p_x, p_y, v_x, v_y)
                u_x, u_y, acts, code, _ = guard(p, memory, tick, here, u_x, u_y, flown)
                carrying = p.carries
                certified = code == CERTIFIED
                intervened += acts != INNER
        elif new >= 0 and _guard(c, x, y, bound, norm(z_x, z_y)):
            intervened += 1
            if c.law >= SWITCH_TRACKING:
                u_x, u_y = clip_norm(a[3], a[4], u_a)
            else:
                if c.law == SWITCH_BEST:
                    least = math.inf
                    for k in range(KEPT):
                        if detections[k].taken == NEVER:
                            continue
                        r = bound_of(p, detections, k, tick, p_x, p_y)
                        if r < least:
                            least, z_x, z_y = r, p_x - detections[k].x, p_y - detections[k].y
                e_x, e_y = _direction(z_x, z_y)
                u_x, u_y = clip_norm((-v_a * e_x - v_x) / dt, (-v_a * e_y - v_y) / dt, u_a)
        if first_seen >= 0:
            seen_ticks += 1
            uncertified += not certified
        if certified:
            result[MAX_CERTIFIED] = max(result[MAX_CERTIFIED], d)
            result[CERTIFIED_LOST] += d >= c.r_v
        elif (
            certified_before and tick - last_break > d_ticks + 1 and new >= 0 and age <= p.age_ticks
        ):
            suspected, since = suspected + 1, tick
        if last_break >= tick - 1:
            suspected = 0
        # an outage is known as soon as nothing that is under way can end it in time
        if not p.carries or tick > since + d_ticks - 1:
            result[BROKEN] += suspected
            suspected = 0
        certified_before = certified
        if tick == ticks:
            break
        # what becomes of the command
        place = tick % _RING
        ring[place, 0], ring[place, 1] = u_x, u_y
        if c.disturbance == 1 and next_share(random) < 0.02:
            u_x = math.nan
        if c.disturbance == 2:
            if silent == 0 and next_share(random) < 0.02:
                silent = 1 + int(next_share(random) * silence_ticks)
            if silent > 0:
                silent -= 1
                u_x = math.nan
        if c.disturbance == 3:
            if next_share(random) < 0.01:
                late = int(next_share(random) * 6)
            if late > 0 and carrying:
                u_x = math.nan
            elif late > 0 and tick >= late:
                u_x, u_y = ring[(tick - late) % _RING, 0], ring[(tick - late) % _RING, 1]
        if (math.isnan(u_x) or late > 0) and not p.carries:
            last_break = tick + d_ticks
        sent[0, LAST], sent[0, CARRIED] = -1.0, 0.0
        if carrying:
            held, under = memory.plan[0], memory.underway.sent
            left = held.turn + held.cruise + held.brake
            pending = Pending(tick, d_ticks, allowed, d / c.r_v, left)
            lost, a[7] = loses(losses, random, a[7], pending)
            keep_motion(s.motions[0, 0], under[(tick + d_ticks) % under.shape[0]], tick)
            sent[0, LAST], sent[0, CARRIED] = tick + d_ticks, 1.0
            if lost:
                u_x = math.nan
        sent[0, ANSWERED] = -1.0 if math.isnan(u_x) else tick
        sent[0, U_X], sent[0, U_Y] = u_x, u_y
        # the UGV
        if next_share(random) < 0.01:
            _redraw(random, g, u_g)
            if c.ugv < 0 and next_share(random) < 0.2:
                ugv = _choose(random, c.ugv, len(UGVS))
        sent[1, ANSWERED] = tick
        sent[1, U_X], sent[1, U_Y] = _ugv(ugv, x, y, v_x, v_y, w_x, w_y, g, u_g)
        # the motion, as the world steps it, but that the adversary chooses which detections are made, and with
        # which error
        for k in range(2):
            for i in range(4):
                before[k, i] = now[k, i]
        receive_commands(tables, s, 0)
        if disturbed:
            blows = _disturb(c, s, random, blows, dark, x, y, g, a[8:])
        move(tables, s, 0)
        if c.jumps > 0.0:
            _jump(c, s, tables.escorts)
        truth = truth_of(s.truth, 0)
        _keep_states(s, now)
        x, y = now[0, 0] - now[1, 0], now[0, 1] - now[1, 1]
        if dark == 0 and since_seen > 0 and tick > 20 and b_ticks > 0:
            if c.blackout == 1:
                dark = b_ticks
            elif c.blackout == 2 and next_share(random) < 0.02:
                dark = 1 + int(next_share(random) * b_ticks)
            elif c.blackout == 3 and norm(x, y) > 0.6 * c.r_v and next_share(random) < 0.2:
                dark = b_ticks
        n_x, n_y = _error(error, random, tick, p.error * c.error_share, x, y, g)
        since_seen = 1
        if dark > 0:
            dark -= 1
            since_seen = 0
            n_x = math.nan
        if not math.isnan(truth.detections[0, 0]):
            truth.detections[0, 0], truth.detections[0, 1] = x - n_x, y - n_y
        deliver_detections(tables, s, 0)
        # whether the command acted that should have
        should = (tick - d_ticks) % _RING
        expected_x, expected_y = (
            (ring[should, 0], ring[should, 1]) if tick >= d_ticks else (0.0, 0.0)
        )
        acted = truth.commands[0, 0] == expected_x and truth.commands[0, 1] == expected_y
        if p.carries:
            acted = waited(tick, s.flown[0, 0, 0].begins, d_ticks) < p.outage_ticks
            last_break = last_break if acted else tick
        elif not acted:
            last_break = max(last_break, tick + d_ticks)
        if certified and acted:
            most = _within_tick(before, now, 0, 1, dt)
            result[MAX_CERTIFIED] = max(result[MAX_CERTIFIED], most)
            result[CERTIFIED_LOST] += most >= c.r_v
    result[INTERVENED], result[MEAN_DISTANCE] = intervened / (ticks + 1), total / (ticks + 1)
    result[UNCERTIFIED] = uncertified / seen_ticks if seen_ticks else 1.0


_SIZES = {"open": (240.0, 240.0), "corner": (240.0, 240.0), "small": (9.0, 7.0)}
"""Width and height [m] of each area, at the paper's visibility radius."""


def area_of(conditions: Conditions) -> tuple[float, float]:
    """Width and height of where it is flown [m]."""
    width, height = _SIZES[AREAS[conditions.area]]
    return width * conditions.r_v / 4.75, height * conditions.r_v / 4.75


def _strength(conditions: Conditions) -> float:
    """The wind [m/s²]; of jumps a unit, which the jumps scale."""
    return 1.0 if conditions.jumps else conditions.wind


def _inner_loop(conditions: Conditions, dt: float) -> Tracking:
    """The UAV's inner loop, with just the reserve that it needs."""
    c, (k_p, k_d) = conditions, conditions.gains
    needed = needed_reserve(InnerLoop(k_p, k_d, math.inf), _strength(c), c.own_error, dt)
    return Tracking(position_gain=k_p, velocity_gain=k_d, reserve=needed or 1.0)


def farthest_off(conditions: Conditions, dt: float) -> float:
    """The UAV's largest distance from what it is told, w [m]; at a tick of dt [s]."""
    c = conditions
    if c.jumps:
        return c.jumps
    return tracking_error(_inner_loop(c, dt).loop, c.wind, c.own_error, dt)


def scenario_of(promise: Promise, conditions: Conditions) -> Scenario:
    """The world that is flown: no noise and no dropouts, as the adversary makes them.

    A coarse grid, as nobody looks at it.
    """
    c, p = conditions, promise
    width, height = area_of(c)
    looks = LinkSettings(delay=c.latency)
    if c.scattered:
        looks = LinkSettings(delay=0.5 * c.latency, jitter=0.5 * c.latency)
    delay = p.delay_ticks * p.dt
    commands = LinkSettings(delay=delay, duplicates=c.duplicates)
    if c.jitter:
        commands = LinkSettings(delay=0.5 * delay, jitter=0.5 * delay, duplicates=c.duplicates)
    return Scenario(
        dt=p.dt,
        hold=c.hold,
        certificate=Certificate(delay=delay, outage=c.outage or None),
        area=Area(width=width, height=height, cell=0.5 * min(width, height)),
        visibility=Visibility(radius=c.r_v),
        sensor=Sensor(range=1.2 * c.r_v),
        coverage=Coverage(),
        detections=Detections(rate=1.0 / p.dt),
        links=LinkTable(only=(VehicleLinks(vehicle="uav_0", detections=looks, commands=commands),)),
        wind=Wind(mean=(_strength(c), 0.0)),
        uav=(
            Uav(
                position=(0.0, 0.0),
                max_speed=p.v_a,
                max_acceleration=p.u_a,
                own_error=c.own_error,
                tracking=_inner_loop(c, p.dt),
            ),
        ),
        ugv=(
            Ugv(
                position=(0.0, 0.0),
                max_speed=p.v_g,
                max_acceleration=c.u_g if math.isfinite(c.u_g) else math.inf,
            ),
        ),
    )


def attack(
    promise: Promise, conditions: Conditions, seed: int, first: int, runs: int, duration: float
) -> FloatArray:
    """Runs of an attack from `first` on.

    Args:
        promise: The declared numbers.
        conditions: Who guards, who attacks, over which network.
        seed: Of all draws.
        first: Number of the first run.
        runs: How many.
        duration: Of each [s].

    Returns:
        What `fly_one` finds of each. Shape (runs, RESULTS).
    """
    batch = Batch(scenario_of(promise, conditions), 1, threads=1)
    late = batch.longest_delay(LinkKind.DETECTIONS) + 1
    memory = guard_state(promise.delay_ticks, max(1, late))
    results, work, random = (
        np.empty((runs, RESULTS)),
        np.zeros((6 + _RING, 10)),
        np.empty(1, np.uint64),
    )
    for k in range(runs):
        random[0] = draw((np.uint64(seed), np.uint64(_ATTACK) << np.uint64(32)), 0, first + k, 0)[0]
        batch.restore([int(random[0] >> np.uint64(11))], [0])
        fly_one(
            batch.tables,
            batch.state,
            memory,
            promise,
            conditions,
            work,
            random,
            round(duration / promise.dt),
            results[k],
        )
    batch.workers.close()
    return results


def spec_radius(promise: Promise, *, with_latency: bool = True) -> float:
    """The radius of the specification without its angle, r_v - (v_a + v_g)(dt + tau_c) - (v_a + v_g)²/(2 u_a) [m]."""
    c = promise
    late = (c.v_a + c.v_g) * (1 + c.delay_ticks) * c.dt if with_latency else 0.0
    radius: float = raw_switching_radius(c.r_v, c.v_a, c.v_g, c.u_a) - late
    return radius


PAPER_BOUNDS = {"r_v": 4.75, "v_a": 0.6, "u_a": 0.3, "v_g": 0.2, "dt": 0.05}
"""The paper's vehicles: r_v [m], speeds [m/s], acceleration [m/s²]; and our tick [s]."""


def declared(
    conditions: Conditions, eps: float, *, margin: float = 0.0, **bounds: float
) -> Promise:
    """The certificate that just covers these conditions; eps and margin [m], bounds other than the paper's by name."""
    c = conditions
    numbers = {**PAPER_BOUNDS, "r_v": c.r_v, **bounds}
    age = c.latency + c.blackout_time + numbers["dt"]
    width, height = area_of(c)
    return certificate(
        Declared(
            **numbers,
            eps=eps,
            age=age,
            delay=c.delay,
            margin=margin,
            width=width,
            height=height,
            hold=c.hold,
            outage=c.outage or None,
            tracking=farthest_off(c, numbers["dt"]),
        )
    )


EPS = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)
"""Largest errors of a detection in the grid [m]."""

_OTHER_BOUNDS = (
    {"dt": 0.02},
    {"dt": 0.2},
    {"v_g": 0.3},
    {"v_g": 0.48, "r_v": 10.0},
    {"v_g": 0.57, "r_v": 40.0},
    {"v_g": 0.594, "u_a": 4.0, "r_v": 30.0},
    {"v_a": 3.0, "u_a": 4.0, "v_g": 1.0, "dt": 0.1},
    {"v_a": 1.5, "u_a": 0.5, "v_g": 0.5, "dt": 0.02},
)
"""Vehicles and ticks unlike the paper's: short and long ticks.

A UGV up to 0.99 as fast as the UAV, which only a large radius can certify; fast vehicles."""


def _networks() -> Iterator[Conditions]:
    """Every network that keeps the assumptions."""
    times = (0.0, 2.0, 5.0, 10.0, 15.0)
    networks = itertools.product(
        times,
        (1, 2, 3),
        ((0.0, False), (1.0, False), (3.0, True)),
        (0.0, 0.3, 1.0),
        (0.1, math.inf),
    )
    for dark, kind, (latency, scattered), delay, u_g in networks:
        if dark > 0.0 or kind == 1:
            yield Conditions(
                blackout=kind if dark else 0,
                blackout_time=dark,
                latency=latency,
                scattered=scattered,
                delay=delay,
                u_g=u_g,
            )


def _places() -> Iterator[Conditions]:
    """Walls and corners."""
    for conditions in _networks():
        if conditions.blackout in (0, 3) and conditions.blackout_time in (0.0, 5.0, 10.0):
            yield from (conditions._replace(area=area) for area in (1, 2))


def _disturbed() -> Iterator[Conditions]:
    """Commands and processes that now and then break A5."""
    for delay, area, dark, kind in itertools.product(
        (0.0, 0.3, 1.0), range(len(AREAS)), (0.0, 5.0), range(len(DISTURBANCES))
    ):
        conditions = Conditions(
            blackout=3 if dark else 0, blackout_time=dark, delay=delay, area=area, disturbance=kind
        )
        if kind:
            yield conditions
        elif delay:
            yield conditions._replace(jitter=True)
            yield conditions._replace(jitter=True, duplicates=0.5)
            yield conditions._replace(duplicates=0.5)
            yield conditions._replace(disturbance=2, silence=2.0, hold=5.0)


def _lossy() -> Iterator[Conditions]:
    """Networks that lose motions, as often and for as long as B allows."""
    for outage, delay, kind, dark, area in itertools.product(
        (0.3, 1.0, 2.0, 5.0, 8.0),
        (0.0, 0.3, 1.0),
        range(1, len(LOSSES)),
        (0.0, 5.0),
        range(len(AREAS)),
    ):
        conditions = Conditions(
            outage=outage,
            delay=delay,
            losses=kind,
            blackout=3 if dark else 0,
            blackout_time=dark,
            area=area,
            u_g=math.inf if kind % 2 else 0.1,
        )
        yield conditions
        if delay and area == 0:
            yield conditions._replace(jitter=True, duplicates=0.5)
            yield conditions._replace(latency=1.0, scattered=True)
    for outage, kind in itertools.product((1.0, 5.0), range(1, len(DISTURBANCES))):
        for delay in (0.0, 0.4):
            yield Conditions(outage=outage, delay=delay, losses=ANY, disturbance=kind, silence=2.0)


def _windy() -> Iterator[Conditions]:
    """Wind, a wrong own position and jumps, with darkness, walls, delays and lost motions."""
    pushes = [
        Conditions(wind=wind, own_error=own, gains=gains)
        for (wind, own), gains in itertools.product(
            ((0.05, 0.0), (0.3, 0.0), (0.1, 0.2), (0.0, 0.4)), ((1.0, 2.0), (1.0, 0.4), (4.0, 3.0))
        )
    ]
    pushes += [Conditions(jumps=jumps) for jumps in (0.1, 0.5)]
    places = itertools.product(range(len(AREAS)), ((0.0, 0), (5.0, 3)), (0.0, 0.3), (0.0, 2.0))
    for push, (area, (dark, blackout), delay, outage) in itertools.product(pushes, places):
        yield push._replace(
            area=area,
            blackout=blackout,
            blackout_time=dark,
            delay=delay,
            outage=outage,
            losses=ANY if outage else 0,
            u_g=math.inf if area else 0.1,
        )


def grid() -> Iterator[tuple[Promise, Conditions]]:
    """All combinations of network, place, error, vehicles and broken assumptions for which there is a certificate."""
    for conditions in itertools.chain(_networks(), _places(), _disturbed(), _lossy(), _windy()):
        pushed = conditions.wind or conditions.own_error or conditions.jumps
        plain = not (conditions.area or conditions.disturbance or conditions.outage or pushed)
        for eps in EPS if plain else EPS[::2]:
            promise = declared(conditions, eps)
            if not math.isnan(promise.handover):
                yield promise, conditions
    sphere = ERRORS.index("sphere")
    for bounds, area, delay, dark in itertools.product(
        _OTHER_BOUNDS, range(len(AREAS)), (0.0, 0.4), (0.0, 4.0)
    ):
        conditions = Conditions(
            blackout=1 if dark else 0,
            blackout_time=dark,
            delay=delay,
            area=area,
            error=sphere,
            u_g=math.inf,
            r_v=bounds.get("r_v", PAPER_BOUNDS["r_v"]),
        )
        for eps in (0.0, 0.3):
            promise = declared(conditions, eps, **bounds)
            if not math.isnan(promise.handover):
                yield promise, conditions
