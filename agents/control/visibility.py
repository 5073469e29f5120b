"""Visibility constraint (5) and switching radius (18) of the paper."""

from bus.errors import ScenarioError
from bus.numbers import exact
from sim.compiling.compile import compiled
from sim.models.vehicles import norm, raw_switching_radius


@compiled
def is_visible(p_ax: float, p_ay: float, p_gx: float, p_gy: float, r_v: float) -> bool:
    r"""Return whether the UGV is visible, Klodt 2015, eq. (5): $\|p_a - p_g\| < r_v$. Positions and r_v in [m]."""
    return norm(p_ax - p_gx, p_ay - p_gy) < r_v


def switching_radius(r_v: float, v_a: float, v_g: float, u_a: float) -> float:
    r"""Return the switching radius r_s [m], from which only tracking acts, Klodt 2015, eq. (18).

    $$ r_s = r_v - \frac{(v_a + v_g)^2}{2 u_a} $$

    The paper prints the same value as two phases, braking and closing in:
    $r_v - \frac{1}{u_a}\left(v_g (v_a + v_g) + \frac12 (v_a^2 - v_g^2)\right)$.

    Args:
        r_v: Visibility radius [m].
        v_a: Maximum speed of the UAV [m/s].
        v_g: Maximum speed of the UGV [m/s].
        u_a: Maximum acceleration of the UAV [m/s²]; if infinite, the UAV stops instantly.

    Raises:
        ScenarioError: If r_s is not positive: the UAV is too weak for this radius.
    """
    r_s: float = raw_switching_radius(r_v, v_a, v_g, u_a)
    if not r_s > 0.0:
        raise ScenarioError(
            f"r_s = {r_s:.6g} m: the UAV (v_a = {exact(v_a)} m/s, u_a = {exact(u_a)} m/s²) is too weak to keep a UGV "
            f"of {exact(v_g)} m/s within r_v = {exact(r_v)} m; r_s must be positive"
        )
    return r_s
