r"""A law that looks ahead: it goes on with the motion after which least ground lacks coverage. Beyond Klodt 2015.

Every half second it compares motions of the next seconds on a coarse copy of the UAV's own map, around where its filter
expects the UGV; the equations are in docs/explanation/lookahead.md. It knows what every law knows: its own position and
velocity, its own map, and what its filter believes of the UGV. It is flown inside the safety filter.

Positions in the world's frame [m], velocities [m/s], times [s] but for ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.control.laws import LawParameters
from sim.kernels.compile import FloatArray, IntArray, compiled
from sim.kernels.records import RecordArray, record_type
from sim.models.field import density, sensor_quality
from sim.models.randomness import LOOKAHEAD_MOTION, draw, to_uniform
from sim.models.vehicles import Motion, clip_norm, norm, stopping_distance

PERIOD = 0.5
"""Time between two decisions [s]."""
STEPS = 15
"""A motion is looked at in so many steps at most, none shorter than `PERIOD`."""
LEGS = 8
"""A motion is so many velocities one after the other, each kept for a leg of at least `PERIOD`."""
_SLOTS = LEGS + 1  # of a motion in memory: a decision may be taken amid its first leg

_TAIL = 5.0
"""For so long after the horizon what was seen still counts [s]; not for a single step."""
_RATE = 0.06
"""Rate at which what is expected later counts less [1/s]."""
_DOUBT = 2.0
"""Number of variances of the velocity that are held against its square."""
_STRAY_COST = 10.0
"""Cost of a metre beyond what the safety filter lets through, for a second [m²]."""
_SLACK = 0.1
"""The cost begins so much beyond [m]: the filter, which looks closer, lets a little more through."""

_CELLS = 3.5
"""Coarse cells in the sensor's range, at most; and so at most `_WINDOW` in a line across its disc."""
_WINDOW = 8

# What a UGV does is learnt from two velocities so many decisions apart, the older the less.
_LAG = 10
_FORGET = 0.98
_FIRST_PERSISTENCE, _FIRST_WEIGHT = 20.0, 5.0  # [s], and worth how many pairs
_LEAST_ALIKE, _MOST_ALIKE = 0.05, 0.92  # 1.7 s and 60 s


class LookaheadState(NamedTuple):
    """The numbers that the law remembers, a row of an array of one; all 0 at first."""

    due: int
    """The tick of the next decision."""
    first: int
    """The leg that the first velocity of the motion is for."""
    noted: int
    """Number of velocities of the UGV that have been kept."""
    products: float
    squares: float
    """Sums of their products and squares [m²/s²]."""


class LookaheadMemory(NamedTuple):
    """The memory of the law; its arrays change in place."""

    state: RecordArray
    """`LookaheadState`. (1,)"""
    velocities: FloatArray
    """The motion that is flown, leg by leg [m/s]. (LEGS + 1, 2)"""
    kept: FloatArray
    """The last velocities of the UGV [m/s], the n-th in row n % rows. (10, 2)"""


def lookahead_memory() -> LookaheadMemory:
    """The memory of a law that has not flown yet."""
    state = np.zeros(1, record_type(LookaheadState))
    return LookaheadMemory(state, np.zeros((_SLOTS, 2)), np.zeros((_LAG, 2)))


class Target(NamedTuple):
    """The belief of a UAV's filter about the UGV."""

    known: bool
    """False before the first detection; then the rest means nothing."""
    p_x: float
    p_y: float
    """[m]"""
    v_x: float
    v_y: float
    """[m/s]"""
    p_variance: float
    """Per axis [m²]."""
    v_variance: float
    """Per axis [m²/s²]."""


class Ahead(NamedTuple):
    """The next seconds as all motions of a decision find them; from `look_ahead`."""

    step: float
    """[s]"""
    cell: float
    """Width of a coarse cell [m]."""
    x: float
    y: float
    """Lower left corner of the coarse map [m]."""
    legs: IntArray
    """In which leg of a motion each step is. Shape (steps,)."""
    track: FloatArray
    """Expected places of the UGV at the end of each step [m]. Shape (steps, 2)."""
    lack: FloatArray
    """C* - C now where positive, a mean over each coarse cell. Shape (rows, columns)."""
    weight: FloatArray
    """The density (9) that is expected from the end of each step on, summed up [s]. Shape (steps, rows, columns)."""


@compiled
def leg_ticks(horizon: float, dt: float) -> int:
    """Ticks for which a motion of this horizon keeps a velocity."""
    return max(1, math.ceil(max(PERIOD, horizon / LEGS) / dt - 1e-9))


@compiled
def kept_time(persistence: float, time: float) -> float:
    """For how much of a time to come the UGV is expected to keep its velocity [s]."""
    return persistence * (1.0 - math.exp(-time / persistence))


@compiled
def expected_spread(target: Target, persistence: float, time: float) -> float:
    """Standard deviation per axis of where the UGV will be after this time [m].

    What is lost of the velocity leads anywhere, half of its square along each axis.
    """
    kept = kept_time(persistence, time)
    lost = norm(target.v_x, target.v_y) * (time - kept)
    return math.sqrt(target.p_variance + target.v_variance * kept * kept + 0.5 * lost * lost)


@compiled
def expected_velocity(target: Target) -> tuple[float, float]:
    """The filter's velocity of the UGV, the shorter the less sure it is."""
    squared = target.v_x * target.v_x + target.v_y * target.v_y
    if squared == 0.0:
        return 0.0, 0.0
    share = squared / (squared + _DOUBT * target.v_variance)
    return share * target.v_x, share * target.v_y


@compiled
def _copy(source: FloatArray, to: FloatArray) -> None:
    """Copy an array of the same shape; by `to[:] = source` numba would compile how its error is put into words."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            to[i, j] = source[i, j]


@compiled
def add_density(
    weight: FloatArray, x: float, y: float, cell: float, spread: float, r_o: float, share: float
) -> None:
    """Add the density (9) around a UGV of which it is not sure where it is.

    The mean over four places that have the variance: half of them off along each axis.

    Args:
        weight: Changed in place. Shape (rows, columns).
        x, y: Centre of the first cell, from where the UGV is expected [m].
        cell: Width of a cell [m].
        spread: Standard deviation per axis [m].
        r_o: Of the density [m].
        share: By which it counts.
    """
    rows, columns = weight.shape
    off, quarter = math.sqrt(2.0) * spread, 0.25 * share
    for j in range(rows):
        b = y + j * cell
        low, same, high = (b - off) * (b - off), b * b, (b + off) * (b + off)
        line = weight[j]
        for i in range(columns):
            a = x + i * cell
            left, right = (a - off) * (a - off), (a + off) * (a + off)
            line[i] += quarter * (
                (density(left + same, r_o) + density(right + same, r_o))
                + (density(a * a + low, r_o) + density(a * a + high, r_o))
            )


@compiled
def add_lack(
    lack: FloatArray, coverage: FloatArray, desired: float, column: int, row: int, ratio: int
) -> None:
    """Add C* - C where it is positive, as a mean over squares of `ratio` cells each way.

    Nothing is lacking outside the area.

    Args:
        lack: Changed in place. Shape (rows, columns).
        coverage: C on the grid.
        desired: C*.
        column, row: Of the first square, counted from the grid's corner.
        ratio: Cells to a square each way.
    """
    rows, columns = coverage.shape
    share = 1.0 / (ratio * ratio)
    for b in range(lack.shape[0]):
        for j in range(max(0, (row + b) * ratio), min(rows, (row + b + 1) * ratio)):
            for a in range(lack.shape[1]):
                first, end = max(0, (column + a) * ratio), min(columns, (column + a + 1) * ratio)
                total = 0.0
                for i in range(first, end):
                    total += max(0.0, desired - coverage[j, i])
                lack[b, a] += total * share


@compiled
def look_ahead(
    law: LawParameters,
    coverage: FloatArray,
    tick: int,
    target: Target,
    persistence: float,
) -> Ahead:
    """All that the motions of a decision have in common.

    Args:
        law: Its parameters.
        coverage: The UAV's own map.
        tick: Now.
        target: What is believed of the UGV.
        persistence: How long it keeps a velocity [s].
    """
    steps = max(1, min(STEPS, math.ceil(law.horizon / PERIOD - 1e-9)))
    step = law.horizon / steps
    tail = math.ceil(_TAIL / step - 1e-9) if steps > 1 else 0
    v_x, v_y = expected_velocity(target)
    kept = kept_time(persistence, law.horizon)
    way_x, way_y = clip_norm(kept * v_x, kept * v_y, 2.0 * law.r_o)
    ratio = max(1, math.ceil(law.reach / (_CELLS * law.cell) - 1e-9))
    cell = ratio * law.cell
    size = math.ceil((2.0 * law.r_o + max(abs(way_x), abs(way_y))) / cell) + 2
    size = max(size, _WINDOW)
    column = math.floor((target.p_x + 0.5 * way_x) / cell - 0.5 * size)
    row = math.floor((target.p_y + 0.5 * way_y) / cell - 0.5 * size)
    lack, total = np.zeros((size, size)), np.zeros((size, size))
    add_lack(lack, coverage, law.desired, column, row, ratio)
    weight, track = np.empty((steps, size, size)), np.empty((steps, 2))
    legs, leg = np.empty(steps, dtype=np.int64), leg_ticks(law.horizon, law.dt)
    for k in range(steps + tail - 1, -1, -1):
        time = (k + 1) * step
        kept, spread = kept_time(persistence, time), expected_spread(target, persistence, time)
        g_x = min(max(target.p_x + kept * v_x, 0.0), law.width)
        g_y = min(max(target.p_y + kept * v_y, 0.0), law.height)
        x, y = (column + 0.5) * cell - g_x, (row + 0.5) * cell - g_y
        add_density(total, x, y, cell, spread, law.r_o, step * math.exp(-_RATE * time))
        if k < steps:
            _copy(total, weight[k])
            track[k, 0], track[k, 1] = g_x, g_y
            legs[k] = int((tick + (k + 0.5) * step / law.dt) / leg) - tick // leg
    return Ahead(step, cell, column * cell, row * cell, legs, track, lack, weight)


@compiled
def fly_step(
    here: Motion, w_x: float, w_y: float, u_max: float, step: float
) -> tuple[Motion, float, float]:
    """A step towards a velocity, at the largest acceleration until it is reached: (1).

    Returns:
        Where the UAV is then, and the middle of the way [m].
    """
    d_x, d_y = clip_norm(w_x - here.v_x, w_y - here.v_y, u_max * step)
    turning = norm(d_x, d_y) / u_max
    w_x, w_y = here.v_x + d_x, here.v_y + d_y
    x = here.p_x + w_x * step - 0.5 * d_x * turning
    y = here.p_y + w_y * step - 0.5 * d_y * turning
    return Motion(x, y, w_x, w_y), 0.5 * (here.p_x + x), 0.5 * (here.p_y + y)


@compiled
def strayed(law: LawParameters, here: Motion, g_x: float, g_y: float) -> float:
    """Distance of a state beyond what the safety filter lets through, and beyond the border's safety distance [m].

    The filter must be able to stop before the UGV, whatever it does, is out of sight: as in (18), with the UAV's own
    velocity away from the UGV in place of its largest.
    """
    x, y = here.p_x - g_x, here.p_y - g_y
    distance = norm(x, y)
    outward = max(0.0, (x * here.v_x + y * here.v_y) / distance) if distance > 0.0 else 0.0
    over = max(0.0, distance + stopping_distance(outward + law.v_g, law.u_max) - law.room - _SLACK)
    inside = min(here.p_x, law.width - here.p_x, here.p_y, law.height - here.p_y)
    return over + max(0.0, law.margin - inside)


@compiled
def worth(
    law: LawParameters,
    ahead: Ahead,
    here: Motion,
    motion: FloatArray,
    lack: FloatArray,
    gains: FloatArray,
) -> float:
    r"""By how much the expected e(t) adds up to less with a motion than without a look, less its cost [m² s].

    Each look counts at once with all that it saves from then on, so a step touches the sensor's disc only:

    $$ \sum_k \int \left[ h(C^* - C_{k-1}) - h(C^* - C_k) \right] \Phi_k\, dq $$

    with $\Phi_k$ the density that is still to come after step k, `Ahead.weight`.

    Args:
        law: Its parameters.
        ahead: From `look_ahead`.
        here: Where the UAV is.
        motion: The velocity of each leg [m/s]. Shape (any, 2).
        lack: Room for numbers of the shape of `ahead.lack`.
        gains: Room for numbers. Shape (8,).
    """
    step, cell = ahead.step, ahead.cell
    size, width = lack.shape[0], gains.size  # not a constant: numba would take the cells one by one
    for j in range(size):
        row, now = lack[j], ahead.lack[j]
        for i in range(size):
            row[i] = now[i]
    for n in range(width):
        gains[n] = 0.0
    cost = 0.0
    for k in range(ahead.legs.size):
        leg = ahead.legs[k]
        here, x, y = fly_step(here, motion[leg, 0], motion[leg, 1], law.u_max, step)
        cost += step * _STRAY_COST * strayed(law, here, ahead.track[k, 0], ahead.track[k, 1])
        i = min(max(math.floor((x - law.reach - ahead.x) / cell), 0), size - width)
        first = max(math.floor((y - law.reach - ahead.y) / cell), 0)
        end = min(math.floor((y + law.reach - ahead.y) / cell) + 1, size)
        left = ahead.x + (i + 0.5) * cell - x
        for j in range(first, end):
            up = ahead.y + (j + 0.5) * cell - y
            row, weight = lack[j, i : i + width], ahead.weight[k, j, i : i + width]
            for n in range(width):
                off = left + n * cell
                quality = (
                    sensor_quality(law.sensor, off * off + up * up, law.peak, law.reach) * step
                )
                before = row[n]
                seen = quality if quality < before else before
                row[n] = before - seen
                gains[n] += weight[n] * seen * (before + before - seen)
    total = 0.0
    for n in range(width):
        total += gains[n]
    return total * cell * cell - cost


@compiled
def aim(
    law: LawParameters,
    ahead: Ahead,
    here: Motion,
    motion: FloatArray,
    first: int,
    places: tuple[float, float, float, float],
) -> None:
    """Let a motion from its leg `first` on lead to a place beside the UGV, and from there to another.

    Args:
        law: Its parameters.
        ahead: From `look_ahead`.
        here: Where the UAV is.
        motion: Changed in place. Shape (any, 2).
        first: The leg.
        places: From the UGV [m]: x and y of the one and of the other.
    """
    steps = ahead.legs.size
    leg = leg_ticks(law.horizon, law.dt) * law.dt
    p_x, p_y, arrived = here.p_x, here.p_y, False
    for n in range(motion.shape[0]):
        if n >= first:
            k = min(int((n + 0.5) * leg / ahead.step), steps - 1)
            a_x, a_y = (places[2], places[3]) if arrived else (places[0], places[1])
            w_x = (ahead.track[k, 0] + a_x - p_x) / leg
            w_y = (ahead.track[k, 1] + a_y - p_y) / leg
            arrived = arrived or norm(w_x, w_y) < law.v_ref
            motion[n, 0], motion[n, 1] = clip_norm(w_x, w_y, law.v_ref)
        p_x += motion[n, 0] * leg
        p_y += motion[n, 1] * leg


@compiled
def draw_motion(
    law: LawParameters,
    ahead: Ahead,
    here: Motion,
    motion: FloatArray,
    tick: int,
    n: int,
) -> None:
    """Make another motion of one, the n-th of this tick.

    By turns: it leads to two places beside the UGV; it keeps another velocity in one leg; its velocities in one or two
    legs are a little different; from some leg on it leads to two places.
    """
    words = draw((law.key_0, law.key_1), LOOKAHEAD_MOTION, tick, n)
    a, b = to_uniform(words[0]), to_uniform(words[1])
    d, e = to_uniform(words[2]), to_uniform(words[3])
    used = ahead.legs[ahead.legs.size - 1] + 1
    leg, turn = int(b * used), 2.0 * math.pi * a
    if n % 4 == 0 or n % 4 == 3:
        near, far = max(0.0, law.room) * math.sqrt(d), max(0.0, law.room) * e
        other = 2.0 * math.pi * (16.0 * b - math.floor(16.0 * b))
        places = (
            near * math.cos(turn),
            near * math.sin(turn),
            far * math.cos(other),
            far * math.sin(other),
        )
        aim(law, ahead, here, motion, 0 if n % 4 == 0 else leg, places)
    elif n % 4 == 1:
        speed = law.v_ref * min(1.0, 1.5 * d)
        motion[leg, 0], motion[leg, 1] = speed * math.cos(turn), speed * math.sin(turn)
    else:
        d_x, d_y = law.v_ref * (a - 0.5), law.v_ref * (e - 0.5)
        for m in range(leg, min(leg + 1 + int(2.0 * d), used)):
            motion[m, 0], motion[m, 1] = clip_norm(
                motion[m, 0] + d_x, motion[m, 1] + d_y, law.v_ref
            )


@compiled
def learn_persistence(memory: LookaheadMemory, target: Target) -> float:
    """For how long the UGV keeps a velocity, by what the filter has believed of it so far [s].

    From how alike velocities were that lie some seconds apart; called once a decision.
    """
    state, v_x, v_y = memory.state[0], target.v_x, target.v_y
    squared, kept = v_x * v_x + v_y * v_y, memory.kept[state.noted % _LAG]
    if state.noted >= _LAG:
        u_x, u_y = kept[0], kept[1]
        power = 0.5 * (u_x * u_x + u_y * u_y + squared) - 2.0 * target.v_variance
        state.products = _FORGET * state.products + u_x * v_x + u_y * v_y
        state.squares = _FORGET * state.squares + power
    kept[0], kept[1] = v_x, v_y
    state.noted += 1
    lag, first = _LAG * PERIOD, _FIRST_WEIGHT * (squared + target.v_variance)
    if first == 0.0:
        return _FIRST_PERSISTENCE
    alike = state.products + first * math.exp(-lag / _FIRST_PERSISTENCE)
    alike /= first + max(0.0, state.squares)
    return -lag / math.log(min(max(alike, _LEAST_ALIKE), _MOST_ALIKE))


@compiled
def recall(memory: LookaheadMemory, now: int, motion: FloatArray) -> None:
    """The motion that is flown, from the leg of now on; after its last one it keeps the velocity."""
    passed = max(0, now - memory.state[0].first)
    for n in range(motion.shape[0]):
        velocity = memory.velocities[min(n + passed, _SLOTS - 1)]
        motion[n, 0], motion[n, 1] = velocity[0], velocity[1]


@compiled
def decide(
    law: LawParameters,
    coverage: FloatArray,
    memory: LookaheadMemory,
    tick: int,
    here: Motion,
    target: Target,
) -> None:
    """Put the motion to go on with into the memory: the one that is flown, or the best of those made of it.

    Where there is but one candidate nothing is compared: it is flown to its end, and then one is drawn.
    """
    state = memory.state[0]
    ahead = look_ahead(law, coverage, tick, target, learn_persistence(memory, target))
    now = tick // leg_ticks(law.horizon, law.dt)
    best, tried = np.empty((_SLOTS, 2)), np.empty((_SLOTS, 2))
    recall(memory, now, best)
    if law.candidates > 1:
        lack, gains = np.empty_like(ahead.lack), np.empty(_WINDOW)
        most = worth(law, ahead, here, best, lack, gains)
        for n in range(1, law.candidates):
            _copy(best, tried)
            draw_motion(law, ahead, here, tried, tick, n)
            value = worth(law, ahead, here, tried, lack, gains)
            if value > most:
                most = value
                _copy(tried, best)
    elif state.noted == 1 or now - state.first >= LEGS:
        draw_motion(law, ahead, here, best, tick, 0)
    else:
        return
    state.first = now
    _copy(best, memory.velocities)


@compiled
def lookahead_control(
    law: LawParameters,
    coverage: FloatArray,
    memory: LookaheadMemory,
    tick: int,
    here: Motion,
    target: Target,
) -> tuple[float, float]:
    """The UAV's command, within the bound of (1) [m/s²].

    Args:
        law: Its parameters.
        coverage: The UAV's own map, up to now.
        memory: Of the law, changed in place.
        tick: Now.
        here: Where the UAV is.
        target: What its filter believes of the UGV, which is known.
    """
    state = memory.state[0]
    if tick >= state.due:
        decide(law, coverage, memory, tick, here, target)
        period = max(1, round(PERIOD / law.dt))
        state.due = (tick // period + 1) * period
    leg = tick // leg_ticks(law.horizon, law.dt) - state.first
    velocity = memory.velocities[min(max(leg, 0), _SLOTS - 1)]
    return clip_norm(
        (velocity[0] - here.v_x) / law.dt, (velocity[1] - here.v_y) / law.dt, law.u_max
    )
