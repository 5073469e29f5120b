"""Shared parts of the laws: memories, and the two terms of (17)."""

import math
from typing import Any

import numpy as np

from agents.control.coverage import (
    border_distance,
    coverage_control,
    is_zero_gradient,
    keep_off_border,
    single_integrator_command,
    symmetry_breaker,
    velocity_error,
)
from agents.control.nearest_point import is_uncovered, nearest_uncovered
from agents.control.tracking import tracking_output, tracking_step
from agents.control.weighting import combine
from agents.laws.inputs import LawInputs
from agents.uav_parameters import Target, UavParameters
from bus.messages.base import Vector
from bus.messages.laws import CoverageParameters, TrackingParameters
from sim.compiling.compile import FloatArray, compiled
from sim.models.field import coverage_gradient
from sim.models.randomness import FIRST, START_DIRECTION, uniform
from sim.models.vehicles import State, norm

_ON_THE_SPOT = 1e-9
"""Distance below which a point gives no direction [m]."""


class TrackingMemory:
    """Memory of the tracking law."""

    x_c: Vector
    """State of (15) [m]."""


class CoverageMemory(TrackingMemory):
    """Memory of a law with a coverage term."""

    key_0: np.uint64
    key_1: np.uint64
    """Random number key of the UAV."""
    has_goal: bool
    """True while a point of (7) is kept."""
    goal: Vector
    """Kept point of (7) [m], if `has_goal` is true."""


@compiled
def tracking_term(
    law: TrackingParameters, memory: TrackingMemory, dt: float, x: float, y: float
) -> tuple[float, float]:
    """Return u_a,tr of (15) [m/s²] and advance the controller's state by one tick.

    Args:
        law: Gains.
        memory: Changed in place.
        dt: Length of the tick [s].
        x, y: Position error to be controlled [m].
    """
    state: Any = memory.x_c
    x_c, y_c = state[0], state[1]
    state[0], state[1] = tracking_step(x_c, y_c, x, y, law.a_c, law.b_c, dt)
    return tracking_output(x_c, y_c, x, y, law.c_c, law.d_c)


@compiled
def direction_to_uncovered(
    uav: UavParameters,
    memory: CoverageMemory,
    coverage: FloatArray,
    tick: int,
    own: State,
    target: Target,
) -> tuple[bool, float, float]:
    """Return the direction of the symmetry breaker (7); keep its point until it is covered or out of the support.

    Returns:
        True if there is an uncovered point, and the direction to it.
    """
    goal: Any = memory.goal
    r_o, desired, cell = uav.density_radius, uav.desired_coverage, uav.cell
    kept = memory.has_goal and is_uncovered(
        coverage, goal[0], goal[1], target.p_x, target.p_y, r_o, desired, cell
    )
    key = memory.key_0, memory.key_1
    if not kept:
        kept, goal[0], goal[1] = nearest_uncovered(
            coverage, own.p_x, own.p_y, target.p_x, target.p_y, r_o, desired, cell, key, tick
        )
        memory.has_goal = kept
    if not kept:
        return False, 0.0, 0.0
    u_x, u_y = symmetry_breaker(goal[0], goal[1], own.p_x, own.p_y, 1.0)
    if norm(u_x, u_y) < _ON_THE_SPOT:
        # Deviation: (10) would divide by zero directly above the point. Draw a random direction instead.
        angle = 2.0 * math.pi * uniform(key, START_DIRECTION, tick, FIRST)
        u_x, u_y = math.cos(angle), math.sin(angle)
    return True, u_x, u_y


@compiled
def coverage_velocity_error(
    uav: UavParameters,
    law: CoverageParameters,
    memory: CoverageMemory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return e_vel of (10) [m/s]: along (6), or along (7) if (6) is zero."""
    coverage, tick, own, target = inputs.coverage, inputs.tick, inputs.own, inputs.target
    occlusion = inputs.occlusion
    u_cov_x, u_cov_y, size = coverage_gradient(
        coverage,
        own.p_x,
        own.p_y,
        target.p_x,
        target.p_y,
        uav.density_radius,
        uav.desired_coverage,
        uav.sensor,
        uav.cell,
        occlusion,
    )
    uncovered, other_x, other_y = True, 0.0, 0.0
    if is_zero_gradient(u_cov_x, u_cov_y, size):
        uncovered, other_x, other_y = direction_to_uncovered(
            uav, memory, coverage, tick, own, target
        )
    u_si_x, u_si_y = single_integrator_command(u_cov_x, u_cov_y, size, other_x, other_y)
    v_ref = min(law.reference_speed, uav.max_speed)
    return velocity_error(u_si_x, u_si_y, v_ref, own.v_x, own.v_y, uncovered)


@compiled
def border_margin(uav: UavParameters, v_ref: float) -> float:
    """Return the safety distance to the border of Q [m]; v_ref [m/s] replaces a missing maximum speed."""
    fastest = uav.max_speed if uav.max_speed < math.inf else v_ref
    return border_distance(fastest, uav.max_acceleration, uav.dt)


@compiled
def coverage_term(
    uav: UavParameters,
    law: CoverageParameters,
    memory: CoverageMemory,
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return u_a,cov [m/s²] of (6) to (11), kept inside Q."""
    e_x, e_y = coverage_velocity_error(uav, law, memory, inputs)
    u_x, u_y = coverage_control(e_x, e_y, law.speed_gain)
    margin = border_margin(uav, law.reference_speed)
    return keep_off_border(
        u_x, u_y, inputs.own, law.speed_gain, uav.width, uav.height, margin, uav.dt
    )


@compiled
def weighted_command(
    uav: UavParameters,
    law: CoverageParameters,
    memory: CoverageMemory,
    inputs: LawInputs,
    weights: tuple[float, float],
) -> tuple[float, float]:
    """Return the combined command (17) [m/s²] with the weights alpha, beta."""
    own, target = inputs.own, inputs.target
    x, y = own.p_x - target.p_x, own.p_y - target.p_y
    u_tr_x, u_tr_y = tracking_term(law, memory, uav.dt, x, y)
    u_cov_x, u_cov_y = coverage_term(uav, law, memory, inputs)
    return combine(weights[0], weights[1], u_tr_x, u_tr_y, u_cov_x, u_cov_y)


@compiled
def distance_to(target: Target, own: State) -> float:
    """Return the distance from the UAV to the UGV's estimated position [m]."""
    return norm(own.p_x - target.p_x, own.p_y - target.p_y)
