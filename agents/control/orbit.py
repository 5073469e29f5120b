"""Virtual point tracking, section V.B of the paper: (20) to (25).

The circle is built in; a user may supply any path with two derivatives.
"""

import math
from collections.abc import Callable

from bus.errors import ScenarioError
from bus.numbers import above, at_most, exact
from sim.compiling.compile import compiled

_SAMPLES = 2000
"""Number of times at which a user's path is checked."""

Path = Callable[[float], tuple[tuple[float, float], tuple[float, float]]]
"""User's path: maps time [s] to p_v relative to the UGV [m] and its second derivative [m/s²]."""


@compiled
def desired_position(p_gx: float, p_gy: float, p_vx: float, p_vy: float) -> tuple[float, float]:
    r"""Return the desired position of the UAV [m], Klodt 2015, eq. (20): $p_d(t) = p_g(t) + p_v(t)$."""
    return p_gx + p_vx, p_gy + p_vy


@compiled
def path_error_acceleration(
    u_ax: float, u_ay: float, a_dx: float, a_dy: float
) -> tuple[float, float]:
    r"""Return the acceleration of the path error $p_{\Delta,d} = p_a - p_d$ [m/s²], Klodt 2015, eq. (21).

    $$ \ddot p_{\Delta,d} = u_a - \ddot p_d $$
    """
    return u_ax - a_dx, u_ay - a_dy


@compiled
def virtual_error_acceleration(
    u_ax: float, u_ay: float, a_vx: float, a_vy: float
) -> tuple[float, float]:
    r"""Return the same for a UGV at constant velocity, so that $\ddot p_d = \ddot p_v$, Klodt 2015, eq. (22).

    $$ \ddot p_{\Delta,d} = u_a - \ddot p_v $$
    """
    return path_error_acceleration(u_ax, u_ay, a_vx, a_vy)


@compiled
def orbit_error_acceleration(
    u_tr_x: float, u_tr_y: float, a_vx: float, a_vy: float
) -> tuple[float, float]:
    r"""Return the acceleration of the path error under the law (24) [m/s²], Klodt 2015, eq. (23).

    The path error is a double integrator that only the tracking law drives.

    $$ \ddot p_{\Delta,d} = u_{a,tr} $$
    """
    u_ax, u_ay = orbit_control(u_tr_x, u_tr_y, a_vx, a_vy)
    return virtual_error_acceleration(u_ax, u_ay, a_vx, a_vy)


@compiled
def orbit_control(u_tr_x: float, u_tr_y: float, a_vx: float, a_vy: float) -> tuple[float, float]:
    r"""Return the tracking law of the virtual point [m/s²], Klodt 2015, eq. (24).

    $$ u_a = \ddot p_v + u_{a,tr}(p_\Delta - p_v) $$
    """
    return a_vx + u_tr_x, a_vy + u_tr_y


@compiled
def circle(t: float, r_pv: float, omega: float) -> tuple[float, float, float, float]:
    r"""Return a virtual point on a circle, Klodt 2015, eq. (25): $p_v = r_{pv}(\cos\omega t, \sin\omega t)$.

    Args:
        t: Time [s].
        r_pv: Radius [m].
        omega: Angular rate [rad/s].

    Returns:
        p_v [m] and its second derivative [m/s²], x before y.
    """
    x, y = r_pv * math.cos(omega * t), r_pv * math.sin(omega * t)
    return x, y, -omega * omega * x, -omega * omega * y


def check_path(
    path: Path, duration: float, r_v: float, v_a: float, v_g: float, u_a: float
) -> tuple[str, ...]:
    """Check a user's path against (5), (20) to (24) and the limits of the vehicles.

    Args:
        path: Path to check.
        duration: Time over which it is sampled [s].
        r_v: Visibility radius [m].
        v_a, v_g: Maximum speeds of UAV and UGV [m/s].
        u_a: Maximum acceleration of the UAV [m/s²].

    Returns:
        Warnings, one line each, if the UAV cannot follow the path; each names the time and the bound.

    Raises:
        ScenarioError: If the function does not return two finite vectors, leaves r_v, or returns a wrong second
            derivative.
    """
    step = min(1e-3, duration / _SAMPLES)
    fastest, hardest = (0.0, 0.0), (0.0, 0.0)
    for index in range(_SAMPLES + 1):
        t = step + index * (duration - 2.0 * step) / _SAMPLES
        try:
            (before, _), (now, acceleration), (after, _) = map(path, (t - step, t, t + step))
            pairs = before, now, after, acceleration
            values = [float(value) for pair in pairs for value in pair]
        except (TypeError, ValueError, ArithmeticError) as error:
            raise ScenarioError(
                f"path at t = {t:.6g} s: {error}; it must return ((x, y), (x'', y''))"
            ) from error
        if len(values) != 8 or not all(math.isfinite(value) for value in values):
            raise ScenarioError(
                f"path at t = {t:.6g} s: returned {values}; it must return ((x, y), (x'', y'')), all finite"
            )
        b_x, b_y, x, y, c_x, c_y, a_x, a_y = values
        if (far := math.hypot(x, y)) >= r_v:
            wrong = f"lies {above(far, r_v, 6)} m from the UGV"
            allowed = f"less than r_v = {exact(r_v)} m"
            raise ScenarioError(f"path at t = {t:.6g} s: {wrong}; allowed: {allowed}")
        found = math.hypot(
            (c_x - 2.0 * x + b_x) / step**2 - a_x, (c_y - 2.0 * y + b_y) / step**2 - a_y
        )
        if found > 1e-2 * (1.0 + math.hypot(a_x, a_y)):
            raise ScenarioError(
                f"path at t = {t:.6g} s: the second derivative is off by {found:.3g} m/s²; it must match the position"
            )
        fastest = max(fastest, (math.hypot(c_x - b_x, c_y - b_y) / (2.0 * step), t))
        hardest = max(hardest, (math.hypot(a_x, a_y), t))
    warnings, spare = [], v_a - v_g
    if fastest[0] + v_g > v_a * (1.0 + 1e-6):
        warnings.append(
            f"path: cannot be flown: needs {above(fastest[0], spare)} m/s at t = {fastest[1]:.4g} s; "
            f"allowed: up to v_a - v_g = {at_most(spare, 4)} m/s"
        )
    if hardest[0] > u_a * (1.0 + 1e-6):
        needed = f"{above(hardest[0], u_a)} m/s² at t = {hardest[1]:.4g} s"
        allowed = f"up to u_a = {exact(u_a)} m/s²"
        warnings.append(f"path: cannot be flown: needs {needed}; allowed: {allowed}")
    return tuple(warnings)
