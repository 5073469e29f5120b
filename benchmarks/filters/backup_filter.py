"""Discrete-time backup barrier filter with the information of our own filter: the peer in `compare.py`.

Gurriet, Mote, Singletary, Nilsson, Feron and Ames (IEEE Access 2020) and Chen, Jankovic, Santillo and Ames (CDC 2021)
call a state safe if a known backup policy leads from it through safe states into a backup set. With the flow x(s) of
this policy

    h_I(x) = min( min over s of h(x(s)),  h_b(x(T)) )

is a barrier, positive where the backup is safe. The filter selects the input nearest to the nominal one that satisfies
the discrete-time condition (Agrawal and Sreenath, RSS 2017)

    h_I(x+) >= (1 - gamma) h_I(x).

Here h is r_v minus the largest possible distance of the UGV, which grows along the flow (van Wijk, Coogan, Molnar,
Majji and Hobbs 2024 also keep a tube around the flow). The backup policy flies to the newest detection and stops there,
as fast as the bounds allow. The backup set is ours: at rest, with the UGV within R_h and the newest detection's bound
within E; docs/explanation/proof.md proves that the next detection is reachable from there. Pending commands are
applied first.

The policy has no memory: each detection changes the flow. If h_I < 0 no input is known to be safe, and the backup
policy acts; such ticks count as infeasible.
"""

import math

from agents.safety.discs import (
    Disc,
    KnownDiscs,
    add_disc,
    disc_in,
    drift,
    lens_distance,
    nearest,
    newest_disc,
    no_discs,
    radius_at,
)
from agents.safety.levels import bounds_of
from bus.messages.base import Vector
from bus.messages.decision import FilterDecision, NotCertified, Source
from bus.messages.vehicle import UavBriefing, UavObservation
from bus.ticks import tick_of
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.models.safety import SafetyBounds
from sim.models.vehicles import (
    State,
    clip_norm,
    norm,
    speed_to_stop_within,
    step_vehicle,
    within_walls,
)

_REST = 0.02
"""Speed below which the backup policy has arrived [m/s], if it is also within `_NEAR` [m] of its goal."""
_NEAR = 0.05
_LONGEST = 25.0
"""Longest duration of a flow [s]; longer flows count as infeasible."""
_TRACK = 60.0
"""Time for which own positions are stored [s]."""
_DIRECTIONS = 16
"""Number of directions in the search for a nearer input."""
_HALVINGS = 8
_WALL = 1e-6
"""Tolerance of a flow at the walls [m]."""


@compiled
def backup_policy(
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    z_x: float,
    z_y: float,
    v_a: float,
    u_a: float,
    dt: float,
) -> tuple[float, float]:
    """Return the acceleration [m/s²] towards the newest detection z [m], at a speed that allows a stop there."""
    x, y = z_x - p_x, z_y - p_y
    distance = norm(x, y)
    speed = min(v_a, speed_to_stop_within(distance, u_a, dt), distance / dt) / max(distance, 1e-12)
    return clip_norm((x * speed - v_x) / dt, (y * speed - v_y) / dt, u_a)


@compiled
def worst_distance(bounds: SafetyBounds, known: KnownDiscs, tick: int, x: float, y: float) -> float:
    """Return the largest distance of the UGV from (x, y) [m], by the newest disc and the disc with the least bound."""
    a, b = known.newest, known.nearest
    a_r, b_r = radius_at(bounds, a, tick), radius_at(bounds, b, tick)
    if known.single:
        return norm(x - a.x, y - a.y) + a_r
    lens: float = lens_distance(x, y, a.x, a.y, a_r, b.x, b.y, b_r)
    return lens


@compiled
def flow_value(
    bounds: SafetyBounds, known: KnownDiscs, tick: int, spent: int, start: State, enough: float
) -> float:
    """Return h_I [m] of the state of the UAV `spent` ticks from now.

    A finite `enough` asks only for a comparison. Uncertainty about the UGV grows by v_g. A tick is evaluated only if
    the worst distance may have come near, because it grows by at most v_a + v_g.

    Returns:
        h_I; with a finite `enough`, a number on the same side of it as h_I.
    """
    c = bounds
    p_x, p_y, v_x, v_y = start
    z_x, z_y = known.newest.x, known.newest.y
    value, wait = math.inf, 0.0
    for k in range(math.ceil(_LONGEST / c.dt)):
        driven = drift(c, spent + k)
        if not (-_WALL <= p_x <= c.width + _WALL and -_WALL <= p_y <= c.height + _WALL):
            return -math.inf
        arrived = norm(v_x, v_y) < _REST and norm(p_x - z_x, p_y - z_y) < _NEAR
        if wait <= 0.0 or arrived:
            room = c.radius - worst_distance(c, known, tick, p_x, p_y) - driven
            value = min(value, room)
            if value < enough:
                return value
            # until it can be the minimum, or too small
            wait = room - (value if enough == -math.inf else enough)
        if arrived:
            end = worst_distance(c, known, tick, p_x, p_y) + driven + _NEAR
            bound = norm(p_x - z_x, p_y - z_y) + radius_at(c, known.newest, tick) + driven + _NEAR
            return min(value, c.handover_radius - end, c.handover_bound - bound)
        u_x, u_y = backup_policy(p_x, p_y, v_x, v_y, z_x, z_y, c.v_a, c.u_a, c.dt)
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, u_x, u_y, c.v_a, c.u_a, c.dt)
        wait -= (c.v_a + c.v_g) * c.dt
    return -math.inf


@compiled
def value_after(
    bounds: SafetyBounds,
    known: KnownDiscs,
    tick: int,
    start: State,
    u_x: float,
    u_y: float,
    enough: float,
) -> float:
    """Return h_I [m] one tick later, under the input u [m/s²].

    Other arguments as in `flow_value`, from the tick at which a command takes effect.
    """
    c, (p_x, p_y, v_x, v_y) = bounds, start
    x, y, w_x, w_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, u_x, u_y, c.v_a, c.u_a, c.dt)
    return flow_value(c, known, tick, c.delay_ticks + 1, State(x, y, w_x, w_y), enough)


@compiled
def filtered(
    bounds: SafetyBounds,
    discs: RecordArray,
    tick: int,
    start: State,
    u_x: float,
    u_y: float,
    gamma: float,
) -> tuple[float, float, bool, bool]:
    """Return the input nearest to u that satisfies the barrier condition.

    Bisection between u and the backup's input, which always satisfies it, comes first; then a search in `_DIRECTIONS`
    directions around u.

    Args:
        bounds: Declared bounds.
        discs: Stored detections. Shape (KEPT,).
        tick: Current tick.
        start: State at which the input takes effect.
        u_x, u_y: Nominal input [m/s²].
        gamma: Share of h_I that one tick may use up, 0 to 1.

    Returns:
        The input [m/s²], true if it differs from the nominal one, and true if h_I >= 0 before.
    """
    c = bounds
    p_x, p_y, v_x, v_y = start
    new = newest_disc(discs)
    near = nearest(c, discs, tick, p_x, p_y)
    known = KnownDiscs(
        disc_in(discs, new), disc_in(discs, near), Disc(0.0, 0.0, math.inf, 0), new == near
    )
    z = known.newest
    b_x, b_y = backup_policy(p_x, p_y, v_x, v_y, z.x, z.y, c.v_a, c.u_a, c.dt)
    before = flow_value(c, known, tick, c.delay_ticks, start, 0.0)
    if not before >= 0.0:
        return b_x, b_y, True, False
    if gamma < 1.0:
        before = flow_value(c, known, tick, c.delay_ticks, start, -math.inf)
    least = (1.0 - gamma) * before
    u_x, u_y = clip_norm(u_x, u_y, c.u_a)
    if value_after(c, known, tick, start, u_x, u_y, least) >= least:
        return u_x, u_y, False, True
    low, high = 0.0, 1.0  # share of the distance from u to the backup's input
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        x, y = u_x + share * (b_x - u_x), u_y + share * (b_y - u_y)
        if value_after(c, known, tick, start, x, y, least) >= least:
            high = share
        else:
            low = share
    best_x, best_y = u_x + high * (b_x - u_x), u_y + high * (b_y - u_y)
    best = high * norm(b_x - u_x, b_y - u_y)
    for k in range(_DIRECTIONS):
        angle = 2.0 * math.pi * k / _DIRECTIONS
        e_x, e_y = math.cos(angle), math.sin(angle)
        near_by, far = 0.0, 0.98 * best
        x, y = u_x + far * e_x, u_y + far * e_y
        if norm(x, y) > c.u_a or not value_after(c, known, tick, start, x, y, least) >= least:
            continue
        for _ in range(_HALVINGS):
            middle = 0.5 * (near_by + far)
            x, y = u_x + middle * e_x, u_y + middle * e_y
            if norm(x, y) <= c.u_a and value_after(c, known, tick, start, x, y, least) >= least:
                far = middle
            else:
                near_by = middle
        best, best_x, best_y = far, u_x + far * e_x, u_y + far * e_y
    return best_x, best_y, True, True


class BackupFilter:
    """Filter of one UAV, with the methods of `agents.safety.safety_filter.SafetyFilter`.

    Args:
        briefing: Briefing of the UAV.
        gamma: Share of the barrier's value that one tick may use up; 1 only requires a positive value.
    """

    def __init__(self, briefing: UavBriefing, *, gamma: float = 1.0) -> None:
        self.bounds = bounds_of(briefing)
        self.gamma = gamma
        self._discs = no_discs()
        self._track: dict[int, Vector] = {}
        self._pending: list[Vector] = [(0.0, 0.0)] * self.bounds.delay_ticks

    def see(self, observation: UavObservation) -> None:
        """Record the UAV's position and the received detections."""
        c, tick, (p_x, p_y) = self.bounds, observation.tick, observation.position
        self._track[observation.tick] = observation.position
        self._track.pop(tick - math.ceil(_TRACK / c.dt), None)
        for found in observation.detections:
            taken = tick_of(found.time, c.dt)
            was = self._track.get(taken)
            if was is not None:
                z_x = min(max(was[0] - found.relative_position[0], 0.0), c.width)
                z_y = min(max(was[1] - found.relative_position[1], 0.0), c.height)
                add_disc(c, self._discs, Disc(z_x, z_y, c.placed_error, taken), tick, p_x, p_y)

    def filter(self, observation: UavObservation, acceleration: Vector) -> FilterDecision:
        """Return the nearest input [m/s²] that satisfies the barrier condition.

        `certified` is true if an input is known to be safe.
        """
        c, tick = self.bounds, observation.tick
        (p_x, p_y), (v_x, v_y) = observation.position, observation.velocity
        for x, y in self._pending:
            p_x, p_y, v_x, v_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, x, y, c.v_a, c.u_a, c.dt)
            p_x, v_x = within_walls(p_x, v_x, c.width)
            p_y, v_y = within_walls(p_y, v_y, c.height)
        new = newest_disc(self._discs)
        if new < 0:
            u_x, u_y = clip_norm(-v_x / c.dt, -v_y / c.dt, c.u_a)
            acts, feasible, fresh = True, False, False
        else:
            fresh = tick - int(self._discs[new]["tick"]) <= c.max_age_ticks
            wanted = (float(acceleration[0]), float(acceleration[1]))
            u_x, u_y, acts, feasible = filtered(
                c, self._discs, tick, State(p_x, p_y, v_x, v_y), *wanted, self.gamma
            )
        if self._pending:
            self._pending = [*self._pending[1:], (u_x, u_y)]
        known = bool(feasible and fresh)
        return FilterDecision(
            acceleration=(u_x, u_y),
            source=Source.BACKUP if acts else Source.NOMINAL,
            reason=None if known else NotCertified.NO_PLAN,
            certified_distance=None,
        )
