r"""Kinematics of UGVs that steer, as a restriction of the double integrator (1). SI units, headings in radians.

A `point` accelerates in any direction. A vehicle with a `differential` drive or with `ackermann` steering moves along
its heading only, forwards or backwards. Its command is an acceleration as for a point, $w = clip(v + u\,dt)$; it turns
its heading towards w as far as it can in a tick, and drives on with the component of w along the new heading:

$$ \theta^+ = \theta + clip_{\Delta}(\angle(\pm w) - \theta), \quad v^+ = (w \cdot e(\theta^+))\,e(\theta^+) $$

- `differential`: both wheels keep v_max, so $\Delta = 2 (v_{max} - |v|)\,dt / b$ with the track b; it turns in place.
- `ackermann`: $\Delta = \kappa\,|v|\,dt$ with the largest curvature κ, and the smaller of the speeds before and after.

To reverse, it first stops. At rest, a command turns a differential drive even if it is too small to move it. The new
velocity differs from v by at most $u\,dt$ and is no longer than w (tests/test_kinematics.py): every motion is one of
the double integrator with the same bounds, so all that is proved for such UGVs holds.
"""

import math
from typing import NamedTuple, Protocol

from bus.registry import KINEMATICS
from sim.compiling.compile import compiled
from sim.models.vehicles import clip_norm, norm, step_vehicle, within_walls

POINT, DIFFERENTIAL, ACKERMANN = range(len(KINEMATICS))
"""Values of `Kinematics.kind`: indices of `bus.registry.KINEMATICS`."""
REST = 1e-9
"""Speed below which a vehicle that steers is at rest [m/s]."""
_NOTHING = 1e-12
"""Speed below which a wanted velocity is rounding alone and has no direction [m/s]."""


class Kinematics(NamedTuple):
    """Constants of a UGV's kinematics."""

    kind: int = POINT
    """`POINT`, `DIFFERENTIAL` or `ACKERMANN`."""
    track: float = math.inf
    """Distance between the wheels of a differential drive [m]."""
    max_curvature: float = 0.0
    """Largest curvature of an Ackermann vehicle's path [1/m]."""


class HasKinematics(Protocol):
    """Kinematics as a scenario or a briefing describes them."""

    @property
    def kinematics(self) -> str:
        """Name, one of `bus.registry.KINEMATICS`."""

    @property
    def track(self) -> float | None:
        """Distance between the wheels of a differential drive [m]."""

    @property
    def max_curvature(self) -> float | None:
        """Largest curvature of an Ackermann vehicle's path [1/m]."""


def kinematics_of(ugv: HasKinematics) -> Kinematics:
    """Return the kinematics of a UGV, from its row of the scenario or its briefing."""
    return Kinematics(
        kind=KINEMATICS.index(ugv.kinematics),
        track=math.inf if ugv.track is None else float(ugv.track),
        max_curvature=0.0 if ugv.max_curvature is None else float(ugv.max_curvature),
    )


class UgvState(NamedTuple):
    """Position, velocity and heading of a UGV."""

    p_x: float
    p_y: float
    """Position [m]."""
    v_x: float
    v_y: float
    """Velocity [m/s]."""
    heading: float
    """Heading [rad], from east to north; 0 for a point."""


@compiled
def wrapped(angle: float) -> float:
    """Return an angle between -2π and 2π as one between -π and π [rad]."""
    if angle > math.pi:
        return angle - 2.0 * math.pi
    return angle + 2.0 * math.pi if angle < -math.pi else angle


@compiled
def largest_turn(
    kinematics: Kinematics, before: float, after: float, v_max: float, dt: float
) -> float:
    """Return the largest change of the heading in a tick [rad].

    Args:
        kinematics: Kinematics of a vehicle that steers.
        before, after: Speed at the start of the tick, and at its end if the vehicle went straight on [m/s].
        v_max: Maximum speed [m/s].
        dt: Duration of the tick [s].
    """
    if kinematics.kind == DIFFERENTIAL:
        return max(2.0 * (v_max - before), 0.0) * dt / kinematics.track
    return kinematics.max_curvature * min(before, after) * dt


def largest_turn_rate(kinematics: Kinematics, v_max: float) -> float:
    """Return the largest turn rate of a vehicle that steers [rad/s]: in place, or of a car at its maximum speed.

    Args:
        kinematics: Its kinematics.
        v_max: Maximum speed [m/s].
    """
    before = 0.0 if kinematics.kind == DIFFERENTIAL else v_max
    rate: float = largest_turn(kinematics, before, v_max, v_max, 1.0)
    return rate


@compiled
def steer(
    kinematics: Kinematics,
    heading: float,
    v: tuple[float, float],
    w: tuple[float, float],
    v_max: float,
    dt: float,
) -> tuple[float, float, float]:
    """Return the velocity [m/s] and the heading [rad] at the end of a tick of a vehicle that steers.

    Args:
        kinematics: Its kinematics.
        heading: Its heading at the start [rad].
        v: Its velocity at the start [m/s], along its heading.
        w: Velocity that a point would reach [m/s], within v_max.
        v_max: Maximum speed [m/s].
        dt: Duration of the tick [s].
    """
    e_x, e_y = math.cos(heading), math.sin(heading)
    speed, ahead = v[0] * e_x + v[1] * e_y, w[0] * e_x + w[1] * e_y
    if abs(speed) <= REST:
        speed = 0.0
    sign = 1.0 if (ahead if speed == 0.0 else speed) >= 0.0 else -1.0
    speed, ahead = sign * speed, sign * ahead
    if norm(w[0], w[1]) <= _NOTHING:
        return 0.0, 0.0, heading
    if ahead < 0.0:  # it stops and reverses within the tick, straight on
        return sign * ahead * e_x, sign * ahead * e_y, heading
    aside = sign * (w[1] * e_x - w[0] * e_y)
    limit = largest_turn(kinematics, speed, ahead, v_max, dt)
    turn = max(-limit, min(math.atan2(aside, ahead), limit))
    heading = wrapped(heading + turn)
    e_x, e_y = math.cos(heading), math.sin(heading)
    after = max(sign * (w[0] * e_x + w[1] * e_y), 0.0)
    if kinematics.kind == DIFFERENTIAL and abs(turn) > 0.0:
        after = min(after, max(speed, v_max - 0.5 * kinematics.track * abs(turn) / dt))
    if speed == 0.0 and after <= REST:
        after = 0.0
    return sign * after * e_x, sign * after * e_y, heading


@compiled
def step_ugv(
    kinematics: Kinematics,
    state: UgvState,
    u_x: float,
    u_y: float,
    bounds: tuple[float, float],
    ground_speed: float,
    dt: float,
) -> UgvState:
    """Move a UGV by one tick without walls, (1) with its kinematics.

    Ground that limits its speed shortens the velocity at the end of the tick. It does not change the heading, so that
    the direction of the path is known whatever the ground is; a vehicle that is stuck does not turn.

    Args:
        kinematics: Its kinematics.
        state: Its state.
        u_x, u_y: Command [m/s²].
        bounds: Its maximum speed [m/s] and acceleration [m/s²]; may be infinite.
        ground_speed: Largest speed on the ground where it is [m/s]: the maximum speed on even ground, 0 if it is stuck.
        dt: Duration of the tick [s].
    """
    v_max, u_max = bounds
    speed = ground_speed if kinematics.kind == POINT else v_max
    p_x, p_y, w_x, w_y, _, _ = step_vehicle(
        state.p_x, state.p_y, state.v_x, state.v_y, u_x, u_y, speed, u_max, dt
    )
    if kinematics.kind == POINT:
        return UgvState(p_x, p_y, w_x, w_y, state.heading)
    before = state.v_x, state.v_y
    w_x, w_y, heading = steer(kinematics, state.heading, before, (w_x, w_y), v_max, dt)
    if ground_speed < v_max:
        w_x, w_y = clip_norm(w_x, w_y, ground_speed)
    if ground_speed == 0.0:
        heading = state.heading
    p_x, p_y = state.p_x + 0.5 * (state.v_x + w_x) * dt, state.p_y + 0.5 * (state.v_y + w_y) * dt
    return UgvState(p_x, p_y, w_x, w_y, heading)


@compiled
def ugv_within_walls(
    kinematics: Kinematics, state: UgvState, width: float, height: float
) -> UgvState:
    """Return the state after a check for walls, see `within_walls`; a vehicle that steers stops there altogether."""
    p_x, v_x = within_walls(state.p_x, state.v_x, width)
    p_y, v_y = within_walls(state.p_y, state.v_y, height)
    if kinematics.kind != POINT and (v_x != state.v_x or v_y != state.v_y):
        v_x, v_y = 0.0, 0.0
    return UgvState(p_x, p_y, v_x, v_y, state.heading)


@compiled
def signed_speed(state: UgvState) -> float:
    """Return the speed of a vehicle that steers [m/s], negative if it reverses."""
    ahead = state.v_x * math.cos(state.heading) + state.v_y * math.sin(state.heading)
    speed = norm(state.v_x, state.v_y)
    return speed if ahead >= 0.0 else -speed
