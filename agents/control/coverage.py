"""Dynamic coverage for a double integrator, section III of the paper: (7), (8), (10) to (12); border of Q."""

from sim.compiling.compile import compiled
from sim.models.vehicles import State, norm, stopping_distance

ZERO_GRADIENT = 1e-9
"""Share of its integrand's size below which u_cov counts as zero: on a grid, a symmetric sum is never exactly zero."""


@compiled
def symmetry_breaker(
    q_x: float, q_y: float, p_ax: float, p_ay: float, k: float
) -> tuple[float, float]:
    r"""Return the symmetry-breaking direction to the nearest uncovered point, Klodt 2015, eq. (7).

    $$ \tilde u_{cov} = k(\tilde q - p_a) $$
    """
    return k * (q_x - p_ax), k * (q_y - p_ay)


@compiled
def is_zero_gradient(u_cov_x: float, u_cov_y: float, size: float) -> bool:
    """Return whether u_cov = 0 in the sense of (8), relative to the size of its integrand."""
    return norm(u_cov_x, u_cov_y) <= ZERO_GRADIENT * size


@compiled
def single_integrator_command(
    u_cov_x: float, u_cov_y: float, size: float, other_x: float, other_y: float
) -> tuple[float, float]:
    r"""Return the command of a single integrator, Klodt 2015, eq. (8).

    $$ u_{si} = u_{cov}, \quad \tilde u_{cov} \text{ where } u_{cov} = 0 $$

    Args:
        u_cov_x, u_cov_y: u_cov of (6).
        size: Size of its integrand, from the same sum.
        other_x, other_y: The symmetry breaker of (7).
    """
    if is_zero_gradient(u_cov_x, u_cov_y, size):
        return other_x, other_y
    return u_cov_x, u_cov_y


@compiled
def desired_velocity(u_si_x: float, u_si_y: float, v_ref: float) -> tuple[float, float]:
    """Return the first term of (10): v_ref along u_si [m/s]; zero if u_si is zero and has no direction."""
    length = norm(u_si_x, u_si_y)
    if length == 0.0:
        return 0.0, 0.0
    return u_si_x / length * v_ref, u_si_y / length * v_ref


@compiled
def velocity_error(
    u_si_x: float, u_si_y: float, v_ref: float, v_ax: float, v_ay: float, uncovered: bool
) -> tuple[float, float]:
    r"""Return the velocity error [m/s], Klodt 2015, eq. (10).

    $$ e_{vel} = \frac{u_{si}}{\|u_{si}\|} v_{ref} - \dot p_a \text{ where } e(t) \ne 0,
    \quad -\dot p_a \text{ where } e(t) = 0 $$

    Args:
        u_si_x, u_si_y: u_si of (8).
        v_ref: Nominal speed [m/s].
        v_ax, v_ay: Velocity of the UAV [m/s].
        uncovered: True if e(t) is not 0.
    """
    if not uncovered:
        return -v_ax, -v_ay
    w_x, w_y = desired_velocity(u_si_x, u_si_y, v_ref)
    return w_x - v_ax, w_y - v_ay


@compiled
def coverage_control(e_vel_x: float, e_vel_y: float, k_v: float) -> tuple[float, float]:
    r"""Return the coverage law [m/s²], Klodt 2015, eq. (11): $u_{a,cov} = k_v e_{vel}$."""
    return k_v * e_vel_x, k_v * e_vel_y


@compiled
def approach_control(
    q_x: float,
    q_y: float,
    p_ax: float,
    p_ay: float,
    v_ax: float,
    v_ay: float,
    k_v: float,
    v_ref: float,
) -> tuple[float, float]:
    r"""Return the coverage law towards an uncovered point [m/s²], Klodt 2015, eq. (12).

    $$ u_{a,cov} = \frac{k_v v_{ref}}{\|\tilde q - p_a\|}(\tilde q - p_a) - k_v \dot p_a $$

    The function evaluates (11) with (7), (8) and (10) inserted.
    """
    u_x, u_y = symmetry_breaker(q_x, q_y, p_ax, p_ay, 1.0)
    e_x, e_y = velocity_error(u_x, u_y, v_ref, v_ax, v_ay, True)
    return coverage_control(e_x, e_y, k_v)


@compiled
def border_distance(v_max: float, u_max: float, dt: float) -> float:
    r"""Return the safety distance to the border of Q [m].

    $v_a^2/(2u_a)$ (after Proposition 1 of the paper), plus the distance of 1.5 ticks.

    The UAV detects the border one tick late, and a sampled stop travels up to half a tick farther than the formula.
    """
    return stopping_distance(v_max, u_max) + 1.5 * v_max * dt


@compiled
def _outward(p: float, size: float, margin: float) -> float:
    """Return the outward direction on one axis: -1 or 1 within the margin of the border, else 0."""
    if p < margin and p <= 0.5 * size:
        return -1.0
    if size - p < margin:
        return 1.0
    return 0.0


@compiled
def keep_off_border(
    u_x: float,
    u_y: float,
    own: State,
    k_v: float,
    width: float,
    height: float,
    margin: float,
    dt: float,
) -> tuple[float, float]:
    """Limit the coverage law so that it stays inside Q: within the margin, nothing points outward.

    An outward velocity is first braked at full acceleration; only then may the UAV turn along the border. The limit
    applies to the coverage term alone. The tracking term points inward, since Q is convex.

    Args:
        u_x, u_y: u_a,cov of (11) [m/s²].
        own: State of the UAV.
        k_v: Gain of (11) [1/s]; u + k_v v is k_v times the desired velocity, whose outward part is dropped.
        width, height: Size of Q [m].
        margin: `border_distance` [m].
        dt: Length of a tick [s].
    """
    p_ax, p_ay, v_ax, v_ay = own
    out_x, out_y = _outward(p_ax, width, margin), _outward(p_ay, height, margin)
    fast_x, fast_y = out_x * v_ax > 0.0, out_y * v_ay > 0.0
    if fast_x or fast_y:
        return (-v_ax / dt if fast_x else 0.0), (-v_ay / dt if fast_y else 0.0)
    if out_x * (u_x + k_v * v_ax) > 0.0:
        u_x = -k_v * v_ax
    if out_y * (u_y + k_v * v_ay) > 0.0:
        u_y = -k_v * v_ay
    return u_x, u_y
