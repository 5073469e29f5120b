"""An attack on the certificate: the closed loop without a coverage grid, against adversaries in it.

The adversary knows the truth. Everything is drawn from the seed and the run's number, so any run can be flown again alone.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from agents.control.certificate import INNER, no_plan, safe_control, state_ahead, uncertified_reason
from agents.control.discs import KEPT, certified_distance, keep_detection, newest_detection, no_detections
from agents.control.handover import Promise, certificate
from agents.control.tracking import tracking_output, tracking_step
from agents.control.visibility import raw_switching_radius
from sim.compile import FloatArray, compiled
from sim.randomness import draw
from sim.vehicles import brake, clip_norm, norm, step_vehicle

FILTER, SWITCH_SERVO, SWITCH_BEST, SWITCH_TRACKING, PAPER = range(5)
LAWS = {
    "filter": FILTER,
    "switch_servo": SWITCH_SERVO,
    "switch_best": SWITCH_BEST,
    "switch_tracking": SWITCH_TRACKING,
    "paper": PAPER,
}
"""Who guards the promise: the filter; beyond a radius of d_cert full speed to the newest detection, full speed to the one with
the least bound, or tracking (15); beyond (18) of the newest detection's distance tracking (15)."""

INNERS = ("outward", "random", "tangential", "outward_then_tangential", "sinusoidal", "tracking", "still", "away_from_detection")
UGVS = ("flees", "straight", "random", "turns", "dodges", "ambush", "still")
ERRORS = ("ball", "sphere", "alternating", "constant", "hides", "none")
BLACKOUTS = ("none", "periodic", "random", "when_far")

ANY = -1
"""In place of an adversary's number: another one for each run; of an inner control or a UGV also now and then within the run."""

MAX_DISTANCE, MAX_EXCESS, INTERVENED, UNCERTIFIED, MEAN_DISTANCE, MAX_AGE = range(6)
RESULTS = 6

_ATTACK = 1001  # purpose of the draws
_GOLDEN, _MIX_1, _MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_MOST_DELAY = 64
_MOST_LATENCY = 64
_A_C, _B_C, _C_C, _D_C = -3.0, -3.0, -8.0 / 3.0, -3.0  # (15) with the paper's closed loop (s + 1)^3


class Conditions(NamedTuple):
    """What one attack flies: who guards, who attacks, and over which network. Times in s, lengths in m."""

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
    loss: float = 0.0
    """Longest time without a command getting through; the vehicle holds the last one for `hold`, then brakes."""
    hold: float = 0.5
    u_g: float = 0.1
    """Largest acceleration of the UGV [m/s²]; infinite: it turns on the spot, which the theorem allows."""
    error_share: float = 1.0
    """The errors' norm as a share of eps; above 1 breaks an assumption."""
    radius: float = 0.0
    """Of the laws that switch [m]."""


@compiled
def _next(state: npt.NDArray[np.uint64]) -> float:
    """A number in [0, 1) by splitmix64 (Steele, Lea, Flood 2014); a draw of Philox for each would take most of the time."""
    state[0] += _GOLDEN
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def _choose(state: npt.NDArray[np.uint64], wanted: int, count: int) -> int:
    return wanted if wanted >= 0 else int(_next(state) * count)


@compiled
def _direction(x: float, y: float) -> tuple[float, float]:
    length = norm(x, y)
    if length == 0.0:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def _inner(
    kind: int, x: float, y: float, v_x: float, v_y: float, zx: float, zy: float, phase: float, held: FloatArray, u: float
) -> tuple[float, float]:
    """What the inner control wants; (x, y) is the true p_a - p_g, (zx, zy) that of the newest detection, `held` its memory."""
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
    kind: int, x: float, y: float, v_x: float, v_y: float, w_x: float, w_y: float, held: FloatArray, u: float
) -> tuple[float, float]:
    """What the UGV does; (x, y) is p_a - p_g, v the UAV's velocity, w its own."""
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
    kind: int, random: npt.NDArray[np.uint64], tick: int, size: float, x: float, y: float, held: FloatArray
) -> tuple[float, float]:
    """The error of one detected position, of norm `size` at most."""
    if kind == 5:
        return 0.0, 0.0
    if kind <= 1:
        angle = 2.0 * math.pi * _next(random)
        radius = size * (math.sqrt(_next(random)) if kind == 0 else 1.0)
        return radius * math.cos(angle), radius * math.sin(angle)
    e_x, e_y = _direction(x, y)
    if kind == 2:
        sign = size if tick % 2 else -size
        return sign * e_x, sign * e_y
    if kind == 3:
        return size * held[5], size * held[6]
    return size * e_x, size * e_y  # the UGV seems nearer than it is


@compiled
def _redraw(random: npt.NDArray[np.uint64], held: FloatArray, u: float) -> None:
    angle, strength = 2.0 * math.pi * _next(random), u * min(1.0, 2.0 * _next(random))
    held[0], held[1] = strength * math.cos(angle), strength * math.sin(angle)
    held[2] = 1.0 if _next(random) < 0.5 else -1.0


@compiled
def _guard(c: Conditions, x: float, y: float, d: float, r: float) -> bool:
    """Whether a law that switches takes over: at a distance d certified, r to the newest detection."""
    return r >= c.radius if c.law == PAPER else d >= c.radius


@compiled
def fly_one(promise: Promise, conditions: Conditions, seed: int, run: int, ticks: int, result: FloatArray) -> None:
    """One run of an attack.

    Args:
        promise: The declared numbers; the laws that switch use its bounds only.
        conditions: Who guards and who attacks.
        seed, run: Of the draws.
        ticks: Length of the run.
        result: Filled: largest distance [m], largest d - d_cert [m], shares of ticks with an intervention and uncertified, mean
            distance [m], largest age of the newest detection [s]. Shape (RESULTS,).
    """
    c, p = conditions, promise
    dt, u_a, v_a, v_g = p.dt, p.u_a, p.v_a, p.v_g
    random = np.empty(1, np.uint64)
    random[0] = draw((np.uint64(seed), np.uint64(_ATTACK) << np.uint64(32)), 0, run, 0)[0]
    detections, plan = no_detections(), no_plan()
    d_ticks, l_ticks = round(c.delay / dt), round(c.latency / dt)
    b_ticks, loss_ticks, hold_ticks = round(c.blackout_time / dt), round(c.loss / dt), round(c.hold / dt)
    u_g = c.u_g if math.isfinite(c.u_g) else 2.0 * v_g / dt
    inner, ugv, error = (
        _choose(random, c.inner, len(INNERS)),
        _choose(random, c.ugv, len(UGVS)),
        _choose(random, c.error, len(ERRORS)),
    )
    a, g = np.zeros(7), np.zeros(7)  # memory of the inner control and of the UGV
    _redraw(random, a, u_a)
    _redraw(random, g, u_g)
    angle = 2.0 * math.pi * _next(random)
    g[3], g[4] = math.cos(angle), math.sin(angle)
    angle = 2.0 * math.pi * _next(random)
    g[5], g[6] = math.cos(angle), math.sin(angle)
    rate = 0.05 + 1.5 * _next(random)  # of the phase [rad/s]
    xc_x, xc_y = 0.0, 0.0
    angle = 2.0 * math.pi * _next(random)
    p_x, p_y, v_x, v_y = 0.5 * math.cos(angle), 0.5 * math.sin(angle), 0.0, 0.0
    q_x, q_y, w_x, w_y = 0.0, 0.0, 0.0, 0.0
    seen = np.zeros((_MOST_LATENCY, 3))  # detections on their way: position, and the tick of arrival
    seen[:, 2] = -1.0
    taken = np.zeros(_MOST_LATENCY)
    sent = np.zeros((_MOST_DELAY, 2))  # commands of the last ticks, by tick modulo its length
    arrival = np.zeros(_MOST_DELAY)
    pending = np.zeros((d_ticks, 2))
    newest_sent, acting_x, acting_y = -1, 0.0, 0.0
    silent, dark, since_seen = 0, 0, 0
    contradicted = False
    total, intervened, uncertified = 0.0, 0, 0
    result[:] = 0.0
    result[MAX_EXCESS] = -math.inf
    for tick in range(ticks + 1):
        t = tick * dt
        x, y = p_x - q_x, p_y - q_y
        d = norm(x, y)
        # the network of the detections
        if dark == 0 and since_seen > 0 and tick > 20 and b_ticks > 0:
            if c.blackout == 1:
                dark = b_ticks
            elif c.blackout == 2 and _next(random) < 0.02:
                dark = 1 + int(_next(random) * b_ticks)
            elif c.blackout == 3 and d > 0.6 * p.r_v and _next(random) < 0.2:
                dark = b_ticks
        place = tick % _MOST_LATENCY
        if dark > 0:
            dark -= 1
            since_seen = 0
            seen[place, 2] = -1.0
        else:
            since_seen = 1
            n_x, n_y = _error(error, random, tick, p.eps * c.error_share, x, y, g)
            late = int(_next(random) * (l_ticks + 1)) if c.scattered else l_ticks
            seen[place, 0], seen[place, 1], seen[place, 2], taken[place] = q_x + n_x, q_y + n_y, tick + late, t
            if tick == 0:
                seen[place, 2] = 0.0
        for k in range(l_ticks + 1):
            place = (tick - k) % _MOST_LATENCY
            if tick >= k and seen[place, 2] == tick:
                z_x, z_y = seen[place, 0], seen[place, 1]
                contradicted |= not keep_detection(detections, z_x, z_y, taken[place], t, p_x, p_y, p.eps, v_g)
        new = newest_detection(detections)
        bound = certified_distance(p_x, p_y, t, detections, p.eps, v_g)
        result[MAX_DISTANCE] = max(result[MAX_DISTANCE], d)
        result[MAX_EXCESS] = max(result[MAX_EXCESS], d - bound)
        result[MAX_AGE] = max(result[MAX_AGE], t - detections[new, 2])
        total += d
        # the adversary in the UAV
        if _next(random) < 0.01:
            _redraw(random, a, u_a)
            if c.inner < 0 and _next(random) < 0.3:
                inner = _choose(random, c.inner, len(INNERS))
        z_x, z_y = p_x - detections[new, 0], p_y - detections[new, 1]
        if inner == 5 or c.law >= SWITCH_TRACKING:
            a[3], a[4] = tracking_output(xc_x, xc_y, z_x, z_y, _C_C, _D_C)
            xc_x, xc_y = tracking_step(xc_x, xc_y, z_x, z_y, _A_C, _B_C, dt)
        for k in range(d_ticks):
            pending[k, 0], pending[k, 1] = sent[(tick - d_ticks + k) % _MOST_DELAY]
        u_x, u_y = _inner(inner, x, y, v_x, v_y, z_x, z_y, rate * t, a, u_a)
        if c.law == FILTER:
            f_x, f_y, s_x, s_y = state_ahead(pending, p_x, p_y, v_x, v_y, v_a, u_a, dt)
            u_x, u_y, acts = safe_control(p, detections, plan, t + d_ticks * dt, f_x, f_y, s_x, s_y, u_x, u_y)
            intervened += acts != INNER
            uncertified += uncertified_reason(p, detections, plan, t, contradicted, acts) != 0
        elif _guard(c, x, y, bound, norm(z_x, z_y)):
            intervened += 1
            if c.law >= SWITCH_TRACKING:
                u_x, u_y = clip_norm(a[3], a[4], u_a)
            else:
                if c.law == SWITCH_BEST:
                    least = math.inf
                    for k in range(KEPT):
                        r = norm(p_x - detections[k, 0], p_y - detections[k, 1]) + v_g * (t - detections[k, 2])
                        if r < least:
                            least, z_x, z_y = r, p_x - detections[k, 0], p_y - detections[k, 1]
                e_x, e_y = _direction(z_x, z_y)
                u_x, u_y = clip_norm((-v_a * e_x - v_x) / dt, (-v_a * e_y - v_y) / dt, u_a)
        else:
            u_x, u_y = clip_norm(u_x, u_y, u_a)
        # the network of the commands
        if silent == 0 and loss_ticks > 0 and _next(random) < 0.02:
            silent = 1 + int(_next(random) * loss_ticks)
        place = tick % _MOST_DELAY
        sent[place, 0], sent[place, 1] = u_x, u_y
        arrival[place] = tick + (int(_next(random) * (d_ticks + 1)) if c.jitter else d_ticks)
        if silent > 0:
            silent -= 1
            arrival[place] = -1.0
        for k in range(d_ticks + 1):
            j = tick - d_ticks + k
            if j > newest_sent and arrival[j % _MOST_DELAY] >= 0.0 and arrival[j % _MOST_DELAY] <= tick:
                newest_sent, acting_x, acting_y = j, sent[j % _MOST_DELAY, 0], sent[j % _MOST_DELAY, 1]
        if tick - newest_sent > d_ticks + hold_ticks and tick > d_ticks:
            acting_x, acting_y = brake(v_x, v_y, u_a, dt)
        # the UGV, and the motion
        if _next(random) < 0.01:
            _redraw(random, g, u_g)
            if c.ugv < 0 and _next(random) < 0.2:
                ugv = _choose(random, c.ugv, len(UGVS))
        b_x, b_y = _ugv(ugv, x, y, v_x, v_y, w_x, w_y, g, u_g)
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, acting_x, acting_y, v_a, u_a, dt)
        q_x, q_y, w_x, w_y, _, _ = step_vehicle(q_x, q_y, w_x, w_y, b_x, b_y, v_g, u_g, dt)
    count = ticks + 1
    result[INTERVENED], result[UNCERTIFIED], result[MEAN_DISTANCE] = intervened / count, uncertified / count, total / count


@compiled
def attack(promise: Promise, conditions: Conditions, seed: int, first: int, runs: int, duration: float) -> FloatArray:
    """Runs of an attack from `first` on, each of `duration` [s]; arguments and columns as in `fly_one`. Shape (runs, RESULTS)."""
    results = np.empty((runs, RESULTS))
    for k in range(runs):
        fly_one(promise, conditions, seed, first + k, round(duration / promise.dt), results[k])
    return results


def spec_radius(promise: Promise, *, with_latency: bool = True) -> float:
    """The radius of the specification without its angle, r_v - (v_a + v_g)(dt + tau_c) - (v_a + v_g)²/(2 u_a) [m]."""
    c = promise
    late = (c.v_a + c.v_g) * (c.dt + c.delay) if with_latency else 0.0
    radius: float = raw_switching_radius(c.r_v, c.v_a, c.v_g, c.u_a) - late
    return radius


PAPER_BOUNDS = {"r_v": 4.75, "v_a": 0.6, "u_a": 0.3, "v_g": 0.2, "dt": 0.05}
"""The paper's vehicles: r_v [m], speeds [m/s], acceleration [m/s²]; and our tick [s]."""


def declared(conditions: Conditions, eps: float, *, margin: float = 0.0, **bounds: float) -> Promise:
    """The certificate that just covers these conditions; eps and margin [m], bounds other than the paper's by name."""
    c = conditions
    numbers = {**PAPER_BOUNDS, **bounds}
    age = c.latency + c.blackout_time + numbers["dt"]
    return certificate(**numbers, eps=eps, age=age, delay=c.delay, margin=margin)


def grid() -> Iterator[tuple[Promise, Conditions]]:
    """All combinations of network and error whose assumptions hold, with the paper's UGV and one that turns on the spot."""
    errors, times = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5), (0.0, 2.0, 5.0, 10.0, 15.0)
    networks = itertools.product(times, (1, 2, 3), ((0.0, False), (1.0, False), (3.0, True)), (0.0, 0.3, 1.0), (0.1, math.inf))
    for dark, kind, (latency, scattered), delay, u_g in networks:
        if dark == 0.0 and kind > 1:
            continue
        conditions = Conditions(
            blackout=kind if dark else 0, blackout_time=dark, latency=latency, scattered=scattered, delay=delay, u_g=u_g
        )
        for eps in errors:
            promise = declared(conditions, eps)
            if not math.isnan(promise.handover):
                yield promise, conditions


class Outcome(NamedTuple):
    """What came out of one combination of the grid."""

    promise: Promise
    conditions: Conditions
    runs: int
    violations: int
    """Runs with a distance of r_v or more at a tick."""
    max_distance: float
    max_excess: float
    intervened: float
    uncertified: float
    mean_distance: float


def outcome(promise: Promise, conditions: Conditions, seed: int, first: int, runs: int, duration: float, r_v: float) -> Outcome:
    """Fly one combination and sum it up; arguments as in `attack`, r_v [m] is what counts as a violation."""
    rows = attack(promise, conditions, seed, first, runs, duration)
    return Outcome(
        promise,
        conditions,
        runs,
        int(np.sum(rows[:, MAX_DISTANCE] >= r_v)),
        float(rows[:, MAX_DISTANCE].max()),
        float(rows[:, MAX_EXCESS].max()),
        float(rows[:, INTERVENED].mean()),
        float(rows[:, UNCERTIFIED].mean()),
        float(rows[:, MEAN_DISTANCE].mean()),
    )


def campaign(runs: int, *, seed: int = 1, first: int = 0, duration: float = 200.0) -> Iterator[Outcome]:
    """The whole grid, `runs` runs of `duration` [s] for each combination."""
    for promise, conditions in grid():
        yield outcome(promise, conditions, seed, first, runs, duration, PAPER_BOUNDS["r_v"])
