"""Hand-over from one plan to the next, and checks of the declared parameters, when a scenario is loaded.

The proof is in docs/explanation/proof.md. SI units.
"""

import functools
import math
from collections.abc import Callable

from agents.safety.discs import AS_EXPECTED, MARGIN, MOST_KEPT, lens_distance
from bus.numbers import above, at_most, below, exact
from bus.ticks import ticks_within
from sim.compiling.compile import compiled
from sim.models.safety import SafetyBounds

ROUNDING = 1e-12
"""Excess of a quotient over a whole number that counts as rounding [ticks]."""

REST = 1e-9
"""Largest initial speed for which `rest_to_rest` keeps the acceleration bound [m/s]."""

_LEAST_STEP = 1000.0 * AS_EXPECTED
"""Least change of speed in a tick at u_a [m/s], so that a lost command can be detected."""

_GRID, _STEPS = 0.005, 950
"""Step of the distances [m] for which the hand-over is checked, which is also its margin; and number of steps to r_v.

The number is limited, or a large radius would take minutes.
"""

_MOST_TIMES, _MOST_SHAPES = 5000, 16
"""Numbers up to which every tick of a trajectory is checked, and every number of ticks of its turn and of its cruise.

Beyond them, several are checked at once, by bounds that are slightly larger, or a short tick would take minutes.
"""


@compiled
def rest_to_rest(distance: float, v_a: float, u_a: float, dt: float) -> tuple[int, int, float]:
    r"""Return the fastest trajectory of whole ticks over `distance` [m] along a line, from rest to rest.

    It takes at most $distance / v_a + v_a / u_a + 2 dt$, up to terms of the order of REST. The acceleration bound
    leaves room to remove an initial velocity of up to REST while the vehicle accelerates.

    Returns:
        Ticks of acceleration (and of braking), ticks at constant speed, and this speed [m/s].
    """
    if distance <= 0.0:
        return 0, 0, 0.0
    full = max(1, math.ceil(v_a / (u_a * dt) - ROUNDING))
    moving = math.ceil(distance / (max(v_a - REST, 0.5 * v_a) * dt) - ROUNDING)
    if moving >= full:
        return full, moving - full, distance / (moving * dt)
    fastest = 0.5 * (REST / u_a + math.sqrt(REST * REST / (u_a * u_a) + 4.0 * distance / u_a))
    half = max(1, math.ceil(fastest / dt - ROUNDING))
    return half, 0, distance / (half * dt)


@compiled
def flown_distance(distance: float, turn: int, cruise: int, tick: int) -> float:
    """Return the distance flown after a number of ticks of a trajectory from `rest_to_rest` [m].

    At every tick, it falls with longer turns and with a longer cruise.

    Args:
        distance: Distance to fly [m].
        turn, cruise: Ticks of the trajectory; one tick of `turn` or more.
        tick: Ticks since the start.
    """
    speed, left = distance / (turn + cruise), 2 * turn + cruise - tick  # metres in a tick
    if left <= 0:
        return distance
    if tick <= turn:
        return 0.5 * speed * tick * tick / turn
    if left <= turn:
        return distance - 0.5 * speed * left * left / turn
    return speed * (tick - 0.5 * turn)


@compiled
def trajectory_stays_within(
    limit: float,
    radius: float,
    rho: float,
    distance: float,
    fastest: tuple[int, int],
    slowest: tuple[int, int],
    drift: float,
) -> bool:
    """Return whether the UGV stays within a distance while the UAV flies from rest to a new detection.

    Two discs contain the UGV at the start. Spans of ticks are checked at once, by bounds of all positions in them:
    longer ones while they pass, shorter ones otherwise, down to single ticks of a trajectory of `_MOST_TIMES` ticks or
    fewer. The work is thus bounded, however short a tick is.

    Args:
        limit: Distance [m].
        radius: Radius of the disc around the resting UAV [m].
        rho: Radius of the disc around the new detection [m].
        distance: Distance to the new detection [m].
        fastest, slowest: Ticks of turn and cruise of the trajectories, from `rest_to_rest`; all between are checked.
        drift: Largest distance of the UGV in a tick, v_g dt [m].
    """
    if radius > limit:
        return False
    ticks = 2 * slowest[0] + slowest[1]
    if 0.5 * (radius + distance + rho) <= limit - drift * ticks:
        # The smaller of two bounds is at most their mean, which is constant along the path.
        return True
    least = 1 + (ticks - 1) // _MOST_TIMES
    first, span = 1, least
    while first <= ticks:
        last = min(first + span - 1, ticks)
        near = flown_distance(distance, slowest[0], slowest[1], first)
        far = flown_distance(distance, fastest[0], fastest[1], last)
        room, middle = limit - drift * last, 0.5 * (near + far)
        if (  # one disc alone usually suffices, and the lens is expensive
            far + radius <= room
            or distance - near + rho <= room
            or lens_distance(middle, 0.0, 0.0, 0.0, radius, distance, 0.0, rho) + (far - middle)
            <= room
        ):
            first, span = last + 1, 2 * span
        elif span > least:
            span = max(least, span // 2)
        else:
            return False
    return True


@compiled
def largest_disc(bounds: SafetyBounds) -> float:
    """Return rho_A = eps + v_g (A + tau_c) [m], the largest radius of the newest measurement's disc."""
    b = bounds
    return b.placed_error + b.v_g * (b.max_measurement_age + b.delay_ticks * b.dt)


@compiled
def handover_bound(bounds: SafetyBounds, radius: float) -> float:
    r"""Return E [m]: within this bound of the newest measurement, a plan to any later one ends within `radius`, R_h.

    $$ E = \frac{v_a}{v_g}\left(R_h - \rho_A (1 - v_g/v_a) - v_g (v_a/u_a + 2 dt + B - dt)\right) - 2 \epsilon $$

    R_h is reduced by `MARGIN` here: a return ends off the walls, and starts with a residual velocity.
    """
    b, v_a, v_g = bounds, bounds.v_a, bounds.v_g
    if v_g == 0.0:
        return math.inf
    rest = radius - MARGIN - largest_disc(b) * (1.0 - v_g / v_a)
    return (
        v_a / v_g * (rest - v_g * (v_a / b.u_a + 2.0 * b.dt + (b.interval_ticks - 1) * b.dt))
        - 2.0 * b.placed_error
    )


@compiled
def _distance_fits(bounds: SafetyBounds, k: int, radius: float) -> bool:
    """Return whether all trajectories over k steps stay within r_v, or no detection is as far; see `unfit_distance`."""
    b, step = bounds, max(_GRID, bounds.radius / _STEPS)
    distance, bound = k * step, handover_bound(bounds, radius)
    rest = min(largest_disc(b), bound + 2.0 * b.placed_error - distance + step)
    if rest < 0.0 or radius + rest < distance - step:
        return True
    last_turn, last_cruise, _ = rest_to_rest((k - 1) * step, b.v_a, b.u_a, b.dt)
    turn, cruise, _ = rest_to_rest(distance, b.v_a, b.u_a, b.dt)
    last_turn = max(1, last_turn)
    limit, rho, drift = b.radius - step, rest + step, b.v_g * b.dt
    if trajectory_stays_within(
        limit, radius, rho, distance, (last_turn, last_cruise), (turn, cruise), drift
    ):
        return True
    turns, cruises = (
        1 + (turn - last_turn) // _MOST_SHAPES,
        1 + (cruise - last_cruise) // _MOST_SHAPES,
    )
    for i in range(last_turn, turn + 1, turns):
        for j in range(last_cruise, cruise + 1, cruises):
            slowest = min(i + turns - 1, turn), min(j + cruises - 1, cruise)
            if not trajectory_stays_within(limit, radius, rho, distance, (i, j), slowest, drift):
                return False
    return True


@compiled
def unfit_distance(bounds: SafetyBounds, likely: int, radius: float) -> int:
    """Return a distance to a newer measurement, in steps, over which a trajectory from rest leaves r_v.

    The UGV is within `radius` at the start. All distances are checked in steps of half a centimetre, or more if r_v is
    large. Between two of them, the trajectory with the same ticks scales with the distance, so no point of it and no
    disc moves by more than a step. The farther a detection, the newer it is: distance + rho <= E + 2 eps.

    Args:
        bounds: Bounds of the hand-over.
        likely: Distance to try first, in steps; 0: none.
        radius: R_h [m].

    Returns:
        The distance in steps; 0 if there is none.
    """
    if likely > 0 and not _distance_fits(bounds, likely, radius):
        return likely
    for k in range(
        1, int((radius + largest_disc(bounds)) / max(_GRID, bounds.radius / _STEPS)) + 2
    ):
        if not _distance_fits(bounds, k, radius):
            return k
    return 0


@compiled
def handover_radius(bounds: SafetyBounds) -> float:
    """Return R_h [m]: from rest, with the UGV within R_h, every plan to a newer detection stays within r_v.

    NaN if there is no such radius.

    The search descends in the same steps, as long as R_h <= E: the plan to a later detection must end where the next
    may begin. E falls faster than R_h, so once this fails, no smaller radius helps.
    """
    radius, step, unfit = bounds.radius, max(_GRID, bounds.radius / _STEPS), 0
    while radius > largest_disc(bounds):
        radius -= step
        if not handover_bound(bounds, radius) >= radius:
            return math.nan
        unfit = unfit_distance(bounds, unfit, radius)
        if unfit == 0:
            return radius
    return math.nan


@functools.lru_cache(maxsize=1024)
def certificate(bounds: SafetyBounds) -> SafetyBounds:
    """Add R_h, E and `valid` to declared bounds; R_h and E are NaN without a hand-over."""
    b, radius, bound = bounds, math.nan, math.nan
    finite = all(
        math.isfinite(x) for x in (b.radius, b.v_a, b.v_g, b.placed_error, b.max_measurement_age)
    )
    if finite and 0.0 <= b.v_g < b.v_a and b.u_a > 0.0:
        radius = float(handover_radius(b))
        bound = float(handover_bound(b, radius))
    valid = not math.isnan(radius) and not _declared_faults(b)
    return b._replace(
        radius=b.radius - MARGIN, handover_radius=radius, handover_bound=bound, valid=valid
    )


def certified_radius(bounds: SafetyBounds) -> float:
    r"""Return r_cert [m]: while d_cert is smaller, every nominal control is applied, at any velocity.

    $$ r_{cert} = R_h + w - \frac{v_a^2}{2 u_a} - \frac{v_a v_g}{u_a}
       - (\tfrac32 v_a + 2 v_g) dt - (v_a + v_g) \tau_c - v_g (B - dt) $$

    With $R_h \to r_v - v_g^2 / (2 u_a)$ this approaches (18) as dt and tau_c go to 0. w is part of d_cert, but not of
    R_h. Beyond r_cert the filter's decision depends on the UAV's velocity: r_cert serves display, tuning and tests.
    """
    b = bounds
    stop = 0.5 * b.v_a * b.v_a / b.u_a + b.v_a * b.v_g / b.u_a
    late = (b.v_a + b.v_g) * b.delay_ticks * b.dt + b.v_g * (b.interval_ticks - 1) * b.dt
    return (
        b.handover_radius - stop - (1.5 * b.v_a + 2.0 * b.v_g) * b.dt - late + b.max_tracking_error
    )


def _largest(bounds: SafetyBounds, fits: Callable[[float], bool]) -> float:
    """Return the largest feasible time [s], to a hundredth; NaN if there is none."""
    low, high = 0.0, bounds.radius / max(bounds.v_g, 1e-9)
    if not fits(low):
        return math.nan
    while high - low > 0.01:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _hands_over(bounds: SafetyBounds, age: float, interval_ticks: int) -> bool:
    """Return whether the hand-over holds with this A [s] and B, and all other parameters unchanged."""
    tried = bounds._replace(
        radius=bounds.radius + MARGIN, max_measurement_age=age, interval_ticks=interval_ticks
    )
    return not math.isnan(handover_radius(tried))


def largest_age(bounds: SafetyBounds) -> float:
    """Return the largest A [s] for which the hand-over holds, to a hundredth; NaN if there is none."""
    return _largest(bounds, lambda age: _hands_over(bounds, age, bounds.interval_ticks))


def largest_interval(bounds: SafetyBounds) -> float:
    """Return the largest B [s] for which the hand-over holds, in whole ticks; NaN if there is none."""

    def fits(time: float) -> bool:
        return _hands_over(bounds, bounds.max_measurement_age, 1 + ticks_within(time, bounds.dt))

    return (
        bounds.dt * (1 + ticks_within(_largest(bounds, fits), bounds.dt)) if fits(0.0) else math.nan
    )


def _error_fault(bounds: SafetyBounds) -> str:
    """Return the fault of the declared tracking and measurement errors; empty if there is none."""
    tracking, placed = bounds.max_tracking_error, bounds.placed_error
    if not math.isfinite(tracking):
        return f"max_tracking_error = {tracking:g} m: unbounded; allowed: a finite error"
    if not math.isfinite(placed):
        return (
            f"max_measurement_error = {placed:g} m: unbounded, since the detector noise is not truncated; "
            "allowed: a finite detections.truncation"
        )
    return ""


def _speed_fault(bounds: SafetyBounds) -> str:
    """Return the fault of the speeds; empty if there is none."""
    v_a, v_g = bounds.v_a, bounds.v_g
    if not math.isfinite(v_a) or not math.isfinite(v_g):
        return f"max_speed = {exact(v_a)} m/s (UAV), {exact(v_g)} m/s (UGV): unbounded; allowed: finite speeds"
    if not v_g < v_a:
        return f"uav.max_speed = {exact(v_a)} m/s: too slow; allowed: more than the UGV's, {exact(v_g)} m/s"
    return ""


def _acceleration_fault(bounds: SafetyBounds) -> str:
    """Return the fault of the UAV's acceleration; empty if there is none."""
    u_a, change = bounds.u_a, bounds.u_a * bounds.dt
    if not u_a > 0.0:
        return f"uav.max_acceleration = {exact(u_a)} m/s²: not positive; allowed: more than 0"
    if change < _LEAST_STEP:
        return (
            f"uav.max_acceleration = {exact(u_a)} m/s²: changes the speed by {below(change, _LEAST_STEP)} m/s in a "
            f"tick, too little to detect a lost command; allowed: at least {_LEAST_STEP:g} m/s"
        )
    return ""


def _age_fault(bounds: SafetyBounds) -> str:
    """Return the fault of the measurement age; empty if there is none."""
    b, age = bounds, bounds.max_measurement_age
    if not math.isfinite(age):
        return f"max_measurement_age = {exact(age)} s: unbounded; allowed: a finite age"
    if b.max_age_ticks >= MOST_KEPT:
        ticks = f"{b.max_age_ticks:,} ticks; allowed: less than {MOST_KEPT:,} ticks"
        return f"max_measurement_age = {exact(age)} s: {ticks}"
    largest = max(size if math.isfinite(size) else 0.0 for size in (b.width, b.height))
    strayed = 0.5 * math.ulp(largest) * (b.max_age_ticks + b.delay_ticks)
    if strayed > 0.5 * MARGIN:
        return (
            f"area = {b.width:g} m x {b.height:g} m: at this size rounding alone moves the UGV by up to "
            f"{strayed:.2g} m in max_measurement_age = {exact(age)} s, more than the margin covers"
        )
    return ""


def _declared_faults(bounds: SafetyBounds) -> tuple[str, ...]:
    """Return the faults of the declared parameters, one line each."""
    checks = _error_fault, _age_fault, _speed_fault, _acceleration_fault
    return tuple(fault for check in checks if (fault := check(bounds)))


def _handover_fault(bounds: SafetyBounds) -> str:
    """Return the error for bounds without a hand-over, with the limits up to which it holds."""
    b, age, delay = bounds, bounds.max_measurement_age, bounds.delay_ticks * bounds.dt
    rho, most = b.placed_error + b.v_g * (age + delay), largest_age(b)
    causes = f"max_measurement_error = {exact(b.max_measurement_error)} m"
    if b.max_tracking_error > 0.0:
        causes += f" and max_tracking_error = {b.max_tracking_error:.6g} m"
    driven = f"max_measurement_age = {exact(age)} s"
    if delay > 0.0:
        driven += f" and max_command_delay = {delay:g} s"
    limits = {"max_measurement_age": ""}
    if not math.isnan(most):
        limits["max_measurement_age"] = f"{math.floor(100.0 * most) / 100.0:.2f} s"
    if b.interval_ticks > 1:
        most, declared = largest_interval(b), b.interval_ticks * b.dt
        shown = "" if math.isnan(most) else f"{at_most(most, 4)} s, not {above(declared, most)} s"
        limits["max_command_interval"] = shown
    return (
        f"the UGV's position is uncertain by up to {rho:.4g} m ({causes}, plus {exact(b.v_g)} m/s for {driven}): "
        f"too much for visibility within {b.radius:.4g} m; {_remaining(limits)}"
    )


def _remaining(limits: dict[str, str]) -> str:
    """Return up to which value each field allows a certificate, one at a time; empty: at no value."""
    usable = [f"for {field} up to {limit}" for field, limit in limits.items() if limit]
    if usable:
        return f"with the other values unchanged, sight can be certified {', or '.join(usable)}"
    return f"no {' and no '.join(limits)} makes it certifiable with the other values unchanged"


def check_assumptions(bounds: SafetyBounds) -> tuple[str, ...]:
    """Return the violated assumptions, one line each with its numbers.

    Empty if all assumptions hold that are known when a run is loaded.
    """
    faults = _declared_faults(bounds)
    if not faults and math.isnan(bounds.handover_radius):
        return (_handover_fault(bounds),)
    return faults
