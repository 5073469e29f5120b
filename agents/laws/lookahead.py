r"""Law `lookahead`: flies the candidate trajectory after which least ground lacks coverage. Beyond Klodt 2015.

Every half second the law compares candidates for the next seconds on a coarse copy of the UAV's own map, around the
expected positions of the UGV; docs/explanation/lookahead.md has the equations. Like every law, it knows its own
position and velocity, its own map, and the estimate of the UGV. It is flown inside the safety filter.

Positions in the world's frame [m], velocities [m/s], times [s] except for ticks.
"""

import math
from typing import Annotated, Any

import numpy as np

from agents.laws.candidates import worth
from agents.laws.hidden_ground import empty_views
from agents.laws.horizon import LEGS, PERIOD, WINDOW, Ahead, copy, leg_ticks, look_ahead
from agents.laws.inputs import LawInputs
from agents.uav_parameters import Target, UavParameters
from bus.messages.laws import LookaheadParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.randomness import LOOKAHEAD_CANDIDATE, Key, draw, to_uniform
from sim.models.vehicles import State, clip_norm, norm

_SLOTS = LEGS + 1  # legs in memory: a decision may be due within the first leg

# The UGV's persistence is learnt from pairs of velocities this many decisions apart, with exponential forgetting.
_LAG = 10
_FORGET = 0.98
_FIRST_PERSISTENCE, _FIRST_WEIGHT = 20.0, 5.0  # prior [s], and its weight in pairs
_LEAST_ALIKE, _MOST_ALIKE = 0.05, 0.92  # correlations of 1.7 s and 60 s


class Memory:
    """Memory of the law."""

    key_0: np.uint64
    key_1: np.uint64
    """Random number key of the UAV."""
    due: int
    """Tick of the next decision."""
    first: int
    """Leg of the first velocity in `velocities`."""
    noted: int
    """Number of UGV velocities recorded."""
    products: float
    squares: float
    """Discounted sums of products and squares of paired velocities [m²/s²]."""
    velocities: Annotated[FloatArray, (_SLOTS, 2)]
    """Chosen trajectory, leg by leg [m/s]."""
    kept: Annotated[FloatArray, (_LAG, 2)]
    """Last velocities of the UGV [m/s], the n-th in row n % rows."""


@compiled
def learn_persistence(memory: Memory, target: Target) -> float:
    """Return the time for which the UGV keeps a velocity, learnt from its estimated velocities [s].

    The time follows from the correlation of velocities a few seconds apart. Call it once per decision.
    """
    kept_velocities: Any = memory.kept
    v_x, v_y = target.v_x, target.v_y
    squared, kept = v_x * v_x + v_y * v_y, kept_velocities[memory.noted % _LAG]
    if memory.noted >= _LAG:
        u_x, u_y = kept[0], kept[1]
        power = 0.5 * (u_x * u_x + u_y * u_y + squared) - 2.0 * target.v_variance
        memory.products = _FORGET * memory.products + u_x * v_x + u_y * v_y
        memory.squares = _FORGET * memory.squares + power
    kept[0], kept[1] = v_x, v_y
    memory.noted += 1
    lag, first = _LAG * PERIOD, _FIRST_WEIGHT * (squared + target.v_variance)
    if first == 0.0:
        return _FIRST_PERSISTENCE
    alike = memory.products + first * math.exp(-lag / _FIRST_PERSISTENCE)
    alike /= first + max(0.0, memory.squares)
    return -lag / math.log(min(max(alike, _LEAST_ALIKE), _MOST_ALIKE))


@compiled
def aim(
    ahead: Ahead,
    own: State,
    velocities: FloatArray,
    first: int,
    near: tuple[float, float],
    far: tuple[float, float],
) -> None:
    """Let a candidate, from leg `first` on, lead to one point beside the UGV and then to another.

    Args:
        ahead: Data from `look_ahead`.
        own: State of the UAV.
        velocities: Changed in place. Shape (any, 2).
        first: First leg to change.
        near, far: First and second point relative to the UGV [m].
    """
    steps = ahead.legs.size
    leg = ahead.leg
    p_x, p_y, arrived = own.p_x, own.p_y, False
    for n in range(velocities.shape[0]):
        if n >= first:
            k = min(int((n + 0.5) * leg / ahead.step), steps - 1)
            a_x, a_y = far if arrived else near
            w_x = (ahead.track[k, 0] + a_x - p_x) / leg
            w_y = (ahead.track[k, 1] + a_y - p_y) / leg
            arrived = arrived or norm(w_x, w_y) < ahead.v_ref
            velocities[n, 0], velocities[n, 1] = clip_norm(w_x, w_y, ahead.v_ref)
        p_x += velocities[n, 0] * leg
        p_y += velocities[n, 1] * leg


@compiled
def draw_candidate(
    uav: UavParameters,
    ahead: Ahead,
    own: State,
    velocities: FloatArray,
    key: Key,
    tick: int,
    n: int,
) -> None:
    """Change a candidate into the n-th variant of this tick.

    The variants alternate: two points beside the UGV; a new velocity in one leg; small changes to the velocities of one
    or two legs; two points from some leg on.
    """
    words = draw(key, LOOKAHEAD_CANDIDATE, tick, n)
    a, b = to_uniform(words[0]), to_uniform(words[1])
    d, e = to_uniform(words[2]), to_uniform(words[3])
    used = ahead.legs[ahead.legs.size - 1] + 1
    leg, turn = int(b * used), 2.0 * math.pi * a
    if n % 4 == 0 or n % 4 == 3:
        r_near, r_far = max(0.0, uav.max_distance) * math.sqrt(d), max(0.0, uav.max_distance) * e
        other = 2.0 * math.pi * (16.0 * b - math.floor(16.0 * b))
        near = r_near * math.cos(turn), r_near * math.sin(turn)
        far = r_far * math.cos(other), r_far * math.sin(other)
        aim(ahead, own, velocities, 0 if n % 4 == 0 else leg, near, far)
    elif n % 4 == 1:
        speed = ahead.v_ref * min(1.0, 1.5 * d)
        velocities[leg, 0], velocities[leg, 1] = speed * math.cos(turn), speed * math.sin(turn)
    else:
        d_x, d_y = ahead.v_ref * (a - 0.5), ahead.v_ref * (e - 0.5)
        for m in range(leg, min(leg + 1 + int(2.0 * d), used)):
            velocities[m, 0], velocities[m, 1] = clip_norm(
                velocities[m, 0] + d_x, velocities[m, 1] + d_y, ahead.v_ref
            )


@compiled
def recall(memory: Memory, now: int, velocities: FloatArray) -> None:
    """Write the chosen trajectory, from the current leg on, into `velocities`; its last velocity continues."""
    stored: Any = memory.velocities
    passed = max(0, now - memory.first)
    for n in range(velocities.shape[0]):
        velocity = stored[min(n + passed, _SLOTS - 1)]
        velocities[n, 0], velocities[n, 1] = velocity[0], velocity[1]


@compiled
def decide(
    uav: UavParameters,
    law: LookaheadParameters,
    memory: Memory,
    inputs: LawInputs,
) -> None:
    """Choose the trajectory to fly, the current one or its best variant, and store it in the memory.

    A single candidate is not compared: it is flown to its end, then the next is drawn.
    """
    coverage, tick, own, target = inputs.coverage, inputs.tick, inputs.own, inputs.target
    occlusion = inputs.occlusion
    v_ref, persistence = min(law.reference_speed, uav.max_speed), learn_persistence(memory, target)
    ahead = look_ahead(uav, law.horizon, v_ref, coverage, tick, target, persistence)
    key = memory.key_0, memory.key_1
    now = tick // leg_ticks(law.horizon, uav.dt)
    best, tried = np.empty((_SLOTS, 2)), np.empty((_SLOTS, 2))
    recall(memory, now, best)
    if law.candidates > 1:
        lack, gains = np.empty_like(ahead.lack), np.empty(WINDOW)
        views = empty_views(occlusion, ahead)
        most = worth(uav, ahead, own, best, lack, gains, views)
        for n in range(1, law.candidates):
            copy(best, tried)
            draw_candidate(uav, ahead, own, tried, key, tick, n)
            value = worth(uav, ahead, own, tried, lack, gains, views)
            if value > most:
                most = value
                copy(tried, best)
    elif memory.noted == 1 or now - memory.first >= LEGS:
        draw_candidate(uav, ahead, own, best, key, tick, 0)
    else:
        return
    memory.first = now
    copy(best, memory.velocities)


@compiled
def command(
    uav: UavParameters,
    law: LookaheadParameters,
    memory: Memory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return the acceleration that reaches the velocity of the chosen trajectory in a tick [m/s²]."""
    tick, own = inputs.tick, inputs.own
    if tick >= memory.due:
        decide(uav, law, memory, inputs)
        period = max(1, round(PERIOD / uav.dt))
        memory.due = (tick // period + 1) * period
    velocities: Any = memory.velocities
    leg = tick // leg_ticks(law.horizon, uav.dt) - memory.first
    velocity = velocities[min(max(leg, 0), _SLOTS - 1)]
    return (velocity[0] - own.v_x) / uav.dt, (velocity[1] - own.v_y) / uav.dt
