"""The conditions of an attack on the certificate: who guards, who attacks, over which network and where.

Of each kind of adversary there is a named tuple: its fields are the names, their values the codes. What is `@compiled`
holds these as constants, so this file's text belongs to the compile cache's name.
"""

import math
from typing import NamedTuple

from agents.safety.handover import certificate
from bus.messages.links import LinkSettings
from bus.messages.scenario import Area, SafetyParameters, Sensor
from outrider_falsify.lost_motions import LOSSES
from sim.models.inner_loop import InnerLoop, needed_reserve, tracking_error
from sim.models.safety import SafetyBounds, safety_bounds
from sim.models.vehicles import raw_switching_radius
from sim.scenario.types import (
    Certificate,
    Coverage,
    Detections,
    LinkTable,
    Scenario,
    Uav,
    Ugv,
    VehicleLinks,
    Visibility,
    Wind,
)

ANY = -1
"""In place of an adversary's code: another one for each run.

Of an inner control or a UGV also now and then within the run.
"""


class Guards(NamedTuple):
    """The laws that guard the promise; those after `switch_best` fly by tracking (15)."""

    filter: int = 0
    """The safety filter."""
    switch_servo: int = 1
    """Beyond a radius of d_cert full speed to the newest detection."""
    switch_best: int = 2
    """Beyond a radius of d_cert full speed to the detection with the least bound."""
    switch_tracking: int = 3
    """Beyond a radius of d_cert tracking (15)."""
    paper: int = 4
    """Beyond (18) of the newest detection's distance tracking (15)."""


class Inners(NamedTuple):
    """The inner controls in the UAV, by where they want to go."""

    outward: int = 0
    random: int = 1
    tangential: int = 2
    outward_then_tangential: int = 3
    sinusoidal: int = 4
    tracking: int = 5
    """By (15)."""
    still: int = 6
    away_from_detection: int = 7
    creeps: int = 8
    """At the residual velocities that rounding leaves."""


class Ugvs(NamedTuple):
    """The drivers of the UGV."""

    flees: int = 0
    straight: int = 1
    random: int = 2
    turns: int = 3
    dodges: int = 4
    """Drives against the UAV's velocity."""
    ambush: int = 5
    """Drives away from a UAV that flies off, and towards one that comes."""
    still: int = 6


class Errors(NamedTuple):
    """The errors of detections."""

    ball: int = 0
    sphere: int = 1
    """Anywhere, of the largest norm."""
    alternating: int = 2
    constant: int = 3
    hides: int = 4
    """The UGV seems nearer than it is."""
    none: int = 5


class Blackouts(NamedTuple):
    """The times at which nothing is detected."""

    none: int = 0
    periodic: int = 1
    random: int = 2
    when_far: int = 3


class Areas(NamedTuple):
    """The areas in which it is flown."""

    open: int = 0
    """So large that nobody meets a wall."""
    corner: int = 1
    """From a corner of that."""
    small: int = 2
    """A room of 9 m by 7 m, at the paper's radius."""
    wall: int = 3
    """Along a wall of the large area: both vehicles start within micrometres of it."""


class Winds(NamedTuple):
    """The ways in which wind and own position drive the UAV."""

    outward: int = 0
    """Away from the UGV."""
    constant: int = 1
    random: int = 2
    """Another way now and then."""
    pumping: int = 3
    """The way that it is going, off its reference."""
    turns: int = 4
    """The way that it accelerates."""
    flips: int = 5
    """Towards the UGV while that is detected, and then away."""


class Disturbances(NamedTuple):
    """The disturbances that break A5' now and then."""

    none: int = 0
    single_losses: int = 1
    """A command is lost."""
    silences: int = 2
    """None comes for up to `silence`."""
    late: int = 3
    """All set out later than they should for a while, so that their motions arrive too late to begin."""
    law_changes: int = 4
    """The filter is switched off for a while and begun anew."""
    rejoins: int = 5
    """A process is away for a while and joins again."""


GUARDS, INNERS, UGVS, ERRORS = Guards(), Inners(), Ugvs(), Errors()
BLACKOUTS, AREAS, WINDS, DISTURBANCES = Blackouts(), Areas(), Winds(), Disturbances()


class Conditions(NamedTuple):
    """The conditions of one attack: who guards, who attacks, and over which network. Times in s, lengths in m."""

    law: int = GUARDS.filter
    inner: int = ANY
    ugv: int = ANY
    error: int = ANY
    blackout: int = BLACKOUTS.none
    blackout_time: float = 0.0
    """Longest time without a detection; at least one lies between two blackouts."""
    latency: float = 0.0
    """From a detection to its arrival, at most."""
    scattered: bool = False
    """Each detection has a latency of its own, so they overtake each other."""
    delay: float = 0.0
    """From a command to the tick in which it acts."""
    jitter: bool = False
    """Commands may be earlier than that, each by a time of its own."""
    duplicates: float = 0.0
    """Share of commands that come twice."""
    disturbance: int = DISTURBANCES.none
    """The disturbance that breaks A5' now and then, of `DISTURBANCES`."""
    silence: float = 0.5
    """Longest time without a command, where that is the disturbance."""
    command_timeout: float = 2.0
    """For how long the vehicle goes on with its last command."""
    u_g: float = 0.1
    """Largest acceleration of the UGV [m/s²]; infinite: it turns on the spot, which the theorem allows."""
    error_share: float = 1.0
    """The errors' norm as a share of eps; above 1 breaks an assumption."""
    outage: float = 0.0
    """Longest time from the start of a motion to the start of the next, B; a tick at least."""
    bare: bool = False
    """Commands carry no motions, as of a receiver that knows accelerations only."""
    start_speed: float = 0.0
    """Speed with which the UAV starts, as a share of its bound."""
    losses: int = LOSSES.none
    """The motions that are lost, of `LOSSES`; never more than B allows."""
    wind: float = 0.0
    """Largest acceleration of the wind, W [m/s²]."""
    position_error: float = 0.0
    """Largest error of the own position, eps_a [m]."""
    gains: tuple[float, float] = (1.0, 2.0)
    """Of the inner loop, k_p [1/s²] and k_d [1/s]; its reserve is just what it needs."""
    jumps: float = 0.0
    """The UAV's distance from what it is told, anywhere at any tick, without an inner loop [m]; 0: with one."""
    blows: int = ANY
    """The direction of wind, own position and jumps, of `WINDS`."""
    radius: float = 0.0
    """Of the laws that switch [m]."""
    r_v: float = 4.75
    """Visibility radius [m]."""
    area: int = AREAS.open
    """The area, of `AREAS`."""


_SIZES = {
    AREAS.open: (240.0, 240.0),
    AREAS.corner: (240.0, 240.0),
    AREAS.small: (9.0, 7.0),
    AREAS.wall: (240.0, 240.0),
}
"""Width and height [m] of each area, at the paper's visibility radius."""


def area_of(conditions: Conditions) -> tuple[float, float]:
    """Width and height of where it is flown [m]."""
    width, height = _SIZES[conditions.area]
    return width * conditions.r_v / 4.75, height * conditions.r_v / 4.75


def _strength(conditions: Conditions) -> float:
    """The wind [m/s²]; of jumps a unit, which the jumps scale."""
    return 1.0 if conditions.jumps else conditions.wind


def _inner_loop(conditions: Conditions, dt: float) -> InnerLoop:
    """The UAV's inner loop, with just the reserve that it needs."""
    k_p, k_d = conditions.gains
    loop = InnerLoop(position_gain=k_p, velocity_gain=k_d, reserve=math.inf)
    needed = needed_reserve(loop, _strength(conditions), conditions.position_error, dt)
    return InnerLoop(position_gain=k_p, velocity_gain=k_d, reserve=needed or 1.0)


def farthest_off(conditions: Conditions, dt: float) -> float:
    """The UAV's largest distance from what it is told, w [m]; at a tick of dt [s]."""
    if conditions.jumps:
        return conditions.jumps
    return tracking_error(
        _inner_loop(conditions, dt), conditions.wind, conditions.position_error, dt
    )


def scenario_of(promise: SafetyBounds, conditions: Conditions) -> Scenario:
    """The world that is flown: no noise and no dropouts, as the adversary makes them.

    A coarse grid, as nobody looks at it.
    """
    width, height = area_of(conditions)
    looks = LinkSettings(delay=conditions.latency)
    if conditions.scattered:
        looks = LinkSettings(delay=0.5 * conditions.latency, jitter=0.5 * conditions.latency)
    delay = promise.delay_ticks * promise.dt
    commands = LinkSettings(delay=delay, duplicates=conditions.duplicates)
    if conditions.jitter:
        commands = LinkSettings(
            delay=0.5 * delay, jitter=0.5 * delay, duplicates=conditions.duplicates
        )
    return Scenario(
        dt=promise.dt,
        command_timeout=conditions.command_timeout,
        certificate=Certificate(
            max_command_delay=delay, max_command_interval=conditions.outage or None
        ),
        area=Area(width=width, height=height, cell=0.5 * min(width, height)),
        visibility=Visibility(radius=conditions.r_v),
        sensor=Sensor(range=1.2 * conditions.r_v),
        coverage=Coverage(),
        detections=Detections(rate=1.0 / promise.dt),
        links=LinkTable(only=(VehicleLinks(vehicle="uav_0", detections=looks, commands=commands),)),
        wind=Wind(mean=(_strength(conditions), 0.0)),
        uav=(
            Uav(
                position=(0.0, 0.0),
                max_speed=promise.v_a,
                max_acceleration=promise.u_a,
                position_error=conditions.position_error,
                tracking=_inner_loop(conditions, promise.dt),
            ),
        ),
        ugv=(
            Ugv(
                position=(0.0, 0.0),
                max_speed=promise.v_g,
                max_acceleration=conditions.u_g,
            ),
        ),
    )


def spec_radius(promise: SafetyBounds, *, with_latency: bool = True) -> float:
    """The radius of the specification without its angle, r_v - (v_a + v_g)(dt + tau_c) - (v_a + v_g)²/(2 u_a) [m]."""
    late = (
        (promise.v_a + promise.v_g) * (1 + promise.delay_ticks) * promise.dt
        if with_latency
        else 0.0
    )
    radius: float = (
        raw_switching_radius(promise.radius, promise.v_a, promise.v_g, promise.u_a) - late
    )
    return radius


PAPER_BOUNDS = {"r_v": 4.75, "v_a": 0.6, "u_a": 0.3, "v_g": 0.2, "dt": 0.05}
"""The paper's vehicles: r_v [m], speeds [m/s], acceleration [m/s²]; and our tick [s]."""


def declared(
    conditions: Conditions, eps: float, *, margin: float = 0.0, **bounds: float
) -> SafetyBounds:
    """The certificate that just covers these conditions; eps and margin [m], bounds other than the paper's by name."""
    numbers = {**PAPER_BOUNDS, "r_v": conditions.r_v, **bounds}
    width, height = area_of(conditions)
    safety = SafetyParameters(
        max_measurement_error=eps,
        max_measurement_age=conditions.latency + conditions.blackout_time + numbers["dt"],
        max_command_delay=conditions.delay,
        max_command_interval=conditions.outage,
        max_tracking_error=farthest_off(conditions, numbers["dt"]),
        margin=margin,
    )
    radius = numbers.pop("r_v")
    return certificate(
        safety_bounds(safety, visibility_radius=radius, **numbers, width=width, height=height)
    )
