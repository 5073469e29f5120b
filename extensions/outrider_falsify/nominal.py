"""Nominal control of an attack: laws that an adversary in the UAV flies, and switching laws that guard them."""

import math
from typing import NamedTuple

from agents.control.tracking import tracking_output, tracking_step
from agents.safety.discs import KEPT, NEVER, bound_of
from outrider_falsify.attack_records import Run, View
from outrider_falsify.conditions import ANY, GUARDS, INNERS, Conditions
from outrider_falsify.opponents import UAV, choose, direction, inner_command, redraw
from outrider_falsify.rng import next_share
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.models.safety import SafetyBounds
from sim.models.vehicles import State, clip_norm

_A_C, _B_C, _C_C, _D_C = -3.0, -3.0, -8.0 / 3.0, -3.0  # (15) with the paper's closed loop (s + 1)^3


class Known(NamedTuple):
    """Knowledge of the UAV at one tick."""

    new: int
    """Row of the newest detection; negative before the first."""
    bound: float
    """Certified distance [m]."""
    z_x: float
    z_y: float
    """Relative position p_a - p_g of the newest detection [m]."""


@compiled
def switch_command(
    conditions: Conditions,
    bounds: SafetyBounds,
    discs: RecordArray,
    adversaries: RecordArray,
    tick: int,
    own: State,
    z_x: float,
    z_y: float,
) -> tuple[float, float]:
    """Return the command [m/s²] of a switching law beyond its radius.

    z is p_a - p_g of the newest detection [m].
    """
    if conditions.law >= GUARDS.switch_tracking:
        return clip_norm(adversaries[UAV].output_x, adversaries[UAV].output_y, bounds.u_a)
    if conditions.law == GUARDS.switch_best:
        least = math.inf
        for k in range(KEPT):
            if discs[k].tick == NEVER:
                continue
            r = bound_of(bounds, discs, k, tick, own.p_x, own.p_y)
            if r < least:
                least = r
                z_x, z_y = own.p_x - discs[k].x, own.p_y - discs[k].y
    e_x, e_y = direction(z_x, z_y)
    return clip_norm(
        (-bounds.v_a * e_x - own.v_x) / bounds.dt,
        (-bounds.v_a * e_y - own.v_y) / bounds.dt,
        bounds.u_a,
    )


@compiled
def nominal_command(run: Run, view: View, known: Known) -> tuple[float, float]:
    """Return the nominal command chosen by the adversary in the UAV [m/s²]."""
    conditions, random, adversaries = run.conditions, run.random, run.scratch.adversaries
    dt, u_a, roles, (z_x, z_y) = run.bounds.dt, run.bounds.u_a, run.scratch.roles[0], known[2:]
    if next_share(random) < 0.01:
        redraw(random, adversaries, UAV, u_a)
        if conditions.inner == ANY and next_share(random) < 0.3:
            roles.inner = choose(random, conditions.inner, len(INNERS))
    if roles.inner == INNERS.tracking or conditions.law >= GUARDS.switch_tracking:
        c_x, c_y = roles.controller_x, roles.controller_y
        o_x, o_y = tracking_output(c_x, c_y, z_x, z_y, _C_C, _D_C)
        adversaries[UAV].output_x, adversaries[UAV].output_y = o_x, o_y
        c_x, c_y = tracking_step(c_x, c_y, z_x, z_y, _A_C, _B_C, dt)
        roles.controller_x, roles.controller_y = c_x, c_y
    phase = roles.rate * (view.tick * dt)
    u_x, u_y = inner_command(
        roles.inner, view.x, view.y, view.uav, z_x, z_y, phase, adversaries, u_a
    )
    return clip_norm(u_x, u_y, u_a)
