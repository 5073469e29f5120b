"""Tracking control, section IV of the paper: (13) to (16). A vector is two floats, x before y."""

import math

from sim.compiling.compile import compiled


@compiled
def relative_acceleration(
    u_ax: float, u_ay: float, u_gx: float, u_gy: float
) -> tuple[float, float]:
    r"""Return the acceleration of the position error [m/s²], Klodt 2015, eq. (13).

    $$ \ddot p_\Delta = \ddot p_a - \ddot p_g = u_a - u_g $$
    """
    return u_ax - u_gx, u_ay - u_gy


@compiled
def state_feedback(
    p_delta_x: float, p_delta_y: float, v_delta_x: float, v_delta_y: float, k_0: float, k_1: float
) -> tuple[float, float]:
    r"""Return the ideal tracking law, which needs the UGV's velocity [m/s²], Klodt 2015, eq. (14).

    $$ u_{a,tr} = -k_0 p_\Delta - k_1 \dot p_\Delta $$

    No pilot uses it, because the relative velocity is not available. It serves as a reference for (15).

    Args:
        p_delta_x, p_delta_y: p_a - p_g [m].
        v_delta_x, v_delta_y: Relative velocity [m/s].
        k_0: Gain [1/s²].
        k_1: Gain [1/s].
    """
    return -k_0 * p_delta_x - k_1 * v_delta_x, -k_0 * p_delta_y - k_1 * v_delta_y


@compiled
def tracking_output(
    x_c_x: float, x_c_y: float, p_delta_x: float, p_delta_y: float, c_c: float, d_c: float
) -> tuple[float, float]:
    r"""Return the output of the dynamic tracking controller [m/s²], Klodt 2015, eq. (15b).

    $$ u_{a,tr} = C_c x_c + D_c p_\Delta $$

    Args:
        x_c_x, x_c_y: State of the controller, one per axis [m].
        p_delta_x, p_delta_y: p_a - p_g [m].
        c_c, d_c: Gains, the same for both axes [1/s²].
    """
    return c_c * x_c_x + d_c * p_delta_x, c_c * x_c_y + d_c * p_delta_y


@compiled
def tracking_step(
    x_c_x: float,
    x_c_y: float,
    p_delta_x: float,
    p_delta_y: float,
    a_c: float,
    b_c: float,
    dt: float,
) -> tuple[float, float]:
    r"""Return the state of the dynamic tracking controller one tick later, Klodt 2015, eq. (15a).

    $$ \dot x_c = A_c x_c + B_c p_\Delta \quad\Rightarrow\quad x_c^+ = e^{A_c dt} x_c + \frac{e^{A_c dt} - 1}{A_c}
    B_c p_\Delta $$

    This is exact for an input that is constant over the tick. Call it at every tick, even if the tracking term has
    zero weight: a stale state makes the distance overshoot.

    Args:
        x_c_x, x_c_y: State of the controller, one per axis [m].
        p_delta_x, p_delta_y: p_a - p_g [m].
        a_c, b_c: Gains, the same for both axes [1/s].
        dt: Length of the tick [s].
    """
    grown = math.expm1(a_c * dt)
    gain = b_c * (grown / a_c if a_c != 0.0 else dt)
    return (grown + 1.0) * x_c_x + gain * p_delta_x, (grown + 1.0) * x_c_y + gain * p_delta_y


@compiled
def relative_motion(
    p_delta_x: float,
    p_delta_y: float,
    v_delta_x: float,
    v_delta_y: float,
    u_ax: float,
    u_ay: float,
    t: float,
) -> tuple[float, float, float, float]:
    r"""Return the relative state after the time t, for a UGV at constant velocity, Klodt 2015, eq. (16).

    $$ \ddot p_\Delta = u_a \quad\Rightarrow\quad p_\Delta(t) = p_\Delta + \dot p_\Delta t + \tfrac12 u_a t^2 $$

    Returns:
        p_delta [m] and its rate of change [m/s] for a constant command u_a [m/s²] over t [s].
    """
    return (
        p_delta_x + v_delta_x * t + 0.5 * u_ax * t * t,
        p_delta_y + v_delta_y * t + 0.5 * u_ay * t * t,
        v_delta_x + u_ax * t,
        v_delta_y + u_ay * t,
    )
