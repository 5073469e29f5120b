"""Conditions of an attack: guard, adversaries, network and area.

Each kind of adversary is a named tuple whose fields are the names and whose values are the codes. Compiled functions
hold the codes as constants, so the compile cache depends on this file's text.
"""

import math
from typing import NamedTuple

from agents.safety.handover import certificate
from bus.messages.links import LinkSettings
from bus.messages.scenario import Area, SafetyParameters, Sensor
from outrider_falsify.lost_trajectories import LOSSES
from sim.models.inner_loop import InnerLoop, needed_reserve, tracking_error
from sim.models.safety import SafetyBounds, safety_bounds
from sim.models.vehicles import raw_switching_radius
from sim.scenario.types import (
    Certificate,
    Coverage,
    Detections,
    LinkTable,
    Scenario,
    VehicleLinks,
    Visibility,
    Wind,
)
from sim.scenario.vehicle_types import Uav, Ugv

ANY = -1
"""Placeholder for an adversary's code: draw one for each run.

The inner control and the UGV are also redrawn occasionally within a run.
"""


class Guards(NamedTuple):
    """Laws that guard visibility; those after `switch_best` fly by tracking (15)."""

    filter: int = 0
    """Safety filter."""
    switch_servo: int = 1
    """Full speed towards the newest detection beyond a radius of d_cert."""
    switch_best: int = 2
    """Full speed towards the detection with the smallest bound beyond a radius of d_cert."""
    switch_tracking: int = 3
    """Tracking (15) beyond a radius of d_cert."""
    paper: int = 4
    """Tracking (15) beyond the radius (18) of the newest detection's distance."""


class Inners(NamedTuple):
    """Inner controls of the UAV, named by their direction."""

    outward: int = 0
    random: int = 1
    tangential: int = 2
    outward_then_tangential: int = 3
    sinusoidal: int = 4
    tracking: int = 5
    """Tracking (15)."""
    still: int = 6
    away_from_detection: int = 7
    creeps: int = 8
    """Creep at velocities of the order of rounding errors."""


class Ugvs(NamedTuple):
    """Controllers of the UGV."""

    flees: int = 0
    straight: int = 1
    random: int = 2
    turns: int = 3
    dodges: int = 4
    """Drive against the UAV's velocity."""
    ambush: int = 5
    """Drive away from a receding UAV and towards an approaching one."""
    still: int = 6


class Errors(NamedTuple):
    """Distributions of the detection error."""

    ball: int = 0
    sphere: int = 1
    """Uniform direction, largest norm."""
    alternating: int = 2
    constant: int = 3
    hides: int = 4
    """Detect the UGV nearer than it is."""
    none: int = 5


class Blackouts(NamedTuple):
    """Schedules of the detections' blackouts."""

    none: int = 0
    periodic: int = 1
    random: int = 2
    when_far: int = 3


class Areas(NamedTuple):
    """Areas of operation."""

    open: int = 0
    """Area too large to reach a wall."""
    corner: int = 1
    """Corner of the open area."""
    small: int = 2
    """Room of 9 m by 7 m, at the paper's radius."""
    wall: int = 3
    """Wall of the large area: both vehicles start within micrometres of it."""


class Winds(NamedTuple):
    """Directions of wind and position error."""

    outward: int = 0
    """Away from the UGV."""
    constant: int = 1
    random: int = 2
    """Direction redrawn occasionally."""
    pumping: int = 3
    """Direction of the velocity relative to the reference."""
    turns: int = 4
    """Direction of the acceleration."""
    flips: int = 5
    """Towards the UGV while it is detected, then away from it."""


class Disturbances(NamedTuple):
    """Disturbances that occasionally break A5'."""

    none: int = 0
    single_losses: int = 1
    """Loss of one command."""
    silences: int = 2
    """No command for up to `silence`."""
    late: int = 3
    """Delayed commands for a while, whose trajectories arrive after their start."""
    law_changes: int = 4
    """Safety filter switched off for a while, then reset."""
    rejoins: int = 5
    """Process disconnected for a while."""


GUARDS, INNERS, UGVS, ERRORS = Guards(), Inners(), Ugvs(), Errors()
BLACKOUTS, AREAS, WINDS, DISTURBANCES = Blackouts(), Areas(), Winds(), Disturbances()


class Conditions(NamedTuple):
    """Conditions of one attack: guard, adversaries and network. Times in s, lengths in m."""

    law: int = GUARDS.filter
    inner: int = ANY
    ugv: int = ANY
    error: int = ANY
    blackout: int = BLACKOUTS.none
    blackout_time: float = 0.0
    """Longest time without a detection; blackouts are separated by at least one detection."""
    latency: float = 0.0
    """Largest delay of a detection."""
    scattered: bool = False
    """Individual latency for each detection, so that detections overtake each other."""
    delay: float = 0.0
    """Time from a command to the tick at which it takes effect."""
    jitter: bool = False
    """True if commands may arrive earlier, each by its own time."""
    duplicates: float = 0.0
    """Share of commands that arrive twice."""
    disturbance: int = DISTURBANCES.none
    """Code of `DISTURBANCES`."""
    silence: float = 0.5
    """Longest time without a command, for the disturbance `silences`."""
    command_timeout: float = 2.0
    """Time for which the last command stays in effect."""
    u_g: float = 0.1
    """Largest acceleration of the UGV [m/s²]; infinite allows instantaneous turns, as the theorem does."""
    error_share: float = 1.0
    """Norm of the detection errors as a share of eps; above 1 it breaks an assumption."""
    max_command_interval: float = 0.0
    """Longest time from the start of a trajectory to the start of the next, B; at least one tick."""
    bare: bool = False
    """True if commands carry no trajectories, for receivers that accept accelerations only."""
    start_speed: float = 0.0
    """Initial speed of the UAV as a share of its limit."""
    losses: int = LOSSES.none
    """Losses of trajectories, a code of `LOSSES`; never more than B allows."""
    wind: float = 0.0
    """Largest wind acceleration, W [m/s²]."""
    position_error: float = 0.0
    """Largest position error of the UAV, eps_a [m]."""
    gains: tuple[float, float] = (1.0, 2.0)
    """Gains of the inner loop, k_p [1/s²] and k_d [1/s]; its reserve is exactly the required one."""
    jumps: float = 0.0
    """Tracking error without an inner loop, redirected at any tick [m]; 0 simulates the inner loop."""
    blows: int = ANY
    """Direction of wind, position error and jumps, a code of `WINDS`."""
    radius: float = 0.0
    """Radius of the switching laws [m]."""
    r_v: float = 4.75
    """Visibility radius [m]."""
    area: int = AREAS.open
    """Code of `AREAS`."""


_SIZES = {
    AREAS.open: (240.0, 240.0),
    AREAS.corner: (240.0, 240.0),
    AREAS.small: (9.0, 7.0),
    AREAS.wall: (240.0, 240.0),
}
"""Width and height [m] of each area, at the paper's visibility radius."""


def area_of(conditions: Conditions) -> tuple[float, float]:
    """Return width and height of the area [m]."""
    width, height = _SIZES[conditions.area]
    return width * conditions.r_v / 4.75, height * conditions.r_v / 4.75


def _strength(conditions: Conditions) -> float:
    """Return the wind's magnitude [m/s²]; 1 for jumps, which scale it."""
    return 1.0 if conditions.jumps else conditions.wind


def _inner_loop(conditions: Conditions, dt: float) -> InnerLoop:
    """Return the UAV's inner loop with exactly the required reserve."""
    k_p, k_d = conditions.gains
    loop = InnerLoop(position_gain=k_p, velocity_gain=k_d, reserve=math.inf)
    needed = needed_reserve(loop, _strength(conditions), conditions.position_error, dt)
    return InnerLoop(position_gain=k_p, velocity_gain=k_d, reserve=needed or 1.0)


def largest_tracking_error(conditions: Conditions, dt: float) -> float:
    """Return the UAV's largest tracking error w [m] at a tick of dt [s]."""
    if conditions.jumps:
        return conditions.jumps
    return tracking_error(
        _inner_loop(conditions, dt), conditions.wind, conditions.position_error, dt
    )


def scenario_of(bounds: SafetyBounds, conditions: Conditions) -> Scenario:
    """Return the scenario without noise and dropouts, which the adversary creates.

    The coverage grid is coarse because nothing reads it.
    """
    width, height = area_of(conditions)
    detections = LinkSettings(delay=conditions.latency)
    if conditions.scattered:
        detections = LinkSettings(delay=0.5 * conditions.latency, jitter=0.5 * conditions.latency)
    delay = bounds.delay_ticks * bounds.dt
    commands = LinkSettings(delay=delay, duplicates=conditions.duplicates)
    if conditions.jitter:
        commands = LinkSettings(
            delay=0.5 * delay, jitter=0.5 * delay, duplicates=conditions.duplicates
        )
    return Scenario(
        dt=bounds.dt,
        command_timeout=conditions.command_timeout,
        certificate=Certificate(
            max_command_delay=delay, max_command_interval=conditions.max_command_interval or None
        ),
        area=Area(width=width, height=height, cell=0.5 * min(width, height)),
        visibility=Visibility(radius=conditions.r_v),
        sensor=Sensor(range=1.2 * conditions.r_v),
        coverage=Coverage(),
        detections=Detections(rate=1.0 / bounds.dt),
        links=LinkTable(
            only=(VehicleLinks(vehicle="uav_0", detections=detections, commands=commands),)
        ),
        wind=Wind(mean=(_strength(conditions), 0.0)),
        uav=(
            Uav(
                position=(0.0, 0.0),
                max_speed=bounds.v_a,
                max_acceleration=bounds.u_a,
                position_error=conditions.position_error,
                tracking=_inner_loop(conditions, bounds.dt),
            ),
        ),
        ugv=(
            Ugv(
                position=(0.0, 0.0),
                max_speed=bounds.v_g,
                max_acceleration=conditions.u_g,
            ),
        ),
    )


def spec_radius(bounds: SafetyBounds, *, with_latency: bool = True) -> float:
    """Return r_v - (v_a + v_g)(dt + tau_c) - (v_a + v_g)²/(2 u_a) [m].

    This is the specification's radius without its angle.
    """
    late = (bounds.v_a + bounds.v_g) * (1 + bounds.delay_ticks) * bounds.dt if with_latency else 0.0
    radius: float = raw_switching_radius(bounds.radius, bounds.v_a, bounds.v_g, bounds.u_a) - late
    return radius


PAPER_BOUNDS = {"r_v": 4.75, "v_a": 0.6, "u_a": 0.3, "v_g": 0.2, "dt": 0.05}
"""Limits of the paper's vehicles: r_v [m], speeds [m/s], acceleration [m/s²]; and our tick [s]."""


def declared(
    conditions: Conditions, eps: float, *, margin: float = 0.0, **bounds: float
) -> SafetyBounds:
    """Return the tightest bounds that cover these conditions.

    Args:
        conditions: Conditions to cover.
        eps: Largest detection error [m].
        margin: Safety margin [m].
        **bounds: Limits that differ from the paper's, by name.
    """
    numbers = {**PAPER_BOUNDS, "r_v": conditions.r_v, **bounds}
    width, height = area_of(conditions)
    safety = SafetyParameters(
        max_measurement_error=eps,
        max_measurement_age=conditions.latency + conditions.blackout_time + numbers["dt"],
        max_command_delay=conditions.delay,
        max_command_interval=conditions.max_command_interval,
        max_tracking_error=largest_tracking_error(conditions, numbers["dt"]),
        margin=margin,
    )
    radius = numbers.pop("r_v")
    return certificate(
        safety_bounds(safety, visibility_radius=radius, **numbers, width=width, height=height)
    )
