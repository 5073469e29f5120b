"""Steering shared by the drivers: to a velocity, to a goal or to rest, within the UGV's bounds."""

from agents.asking import LARGEST
from bus.messages.vehicle import UgvBriefing, UgvObservation
from sim.compiling.compile import compiled
from sim.models.vehicles import State, brake, clip_norm, norm, speed_to_stop_within


@compiled
def velocity_control(
    v_x: float, v_y: float, w_x: float, w_y: float, v_max: float, u_max: float, dt: float
) -> tuple[float, float]:
    r"""Return the acceleration [m/s²] straight towards a desired velocity.

    $$ u = clip_{u_{max}}\left(\frac{clip_{v_{max}}(w) - v}{dt}\right) $$

    The next velocity lies between v and a vector within v_max: if v keeps the bound, so does the next velocity.

    Args:
        v_x, v_y: Velocity [m/s].
        w_x, w_y: Desired velocity [m/s], of any finite length.
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    w_x, w_y = clip_norm(w_x, w_y, v_max)
    return clip_norm((w_x - v_x) / dt, (w_y - v_y) / dt, u_max)


@compiled
def goal_control(
    own: State, goal_x: float, goal_y: float, v_max: float, u_max: float, dt: float
) -> tuple[float, float]:
    """Return the stabilizing control f(p_g, goal) [m/s²]: straight, as fast as the bounds allow, braking in time.

    Args:
        own: State of the UGV.
        goal_x, goal_y: Goal [m].
        v_max, u_max: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    d_x, d_y = goal_x - own.p_x, goal_y - own.p_y
    distance = norm(d_x, d_y)
    w_x, w_y = 0.0, 0.0
    if distance > 0.0:
        e_x, e_y = d_x / distance, d_y / distance
        # half of the next tick is driven at the old speed
        rest = distance - 0.5 * dt * max(own.v_x * e_x + own.v_y * e_y, 0.0)
        speed = min(v_max, speed_to_stop_within(rest, u_max, dt))
        w_x, w_y = e_x * speed, e_y * speed
    return clip_norm((w_x - own.v_x) / dt, (w_y - own.v_y) / dt, u_max)


class Steering:
    """Stateless conversion of a driver's request into an acceleration within both bounds.

    Args:
        briefing: Briefing of the UGV.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        v_max, u_max = briefing.limits.numbers
        self.v_max = min(v_max, LARGEST)
        """Maximum speed [m/s]."""
        self.u_max = min(u_max, LARGEST)
        """Maximum acceleration [m/s²]."""
        self.dt = float(briefing.dt)
        """Length of a tick [s]."""

    def to_velocity(
        self, observation: UgvObservation, wanted: tuple[float, float]
    ) -> tuple[float, float]:
        """Return the acceleration [m/s²] towards a desired velocity [m/s], which is shortened to v_max."""
        (v_x, v_y), (w_x, w_y) = observation.velocity, wanted
        return velocity_control(v_x, v_y, float(w_x), float(w_y), self.v_max, self.u_max, self.dt)

    def to_goal(
        self, observation: UgvObservation, goal: tuple[float, float]
    ) -> tuple[float, float]:
        """Return the acceleration [m/s²] towards a goal [m], as in the paper's driver."""
        own = State(*observation.position, *observation.velocity)
        x, y = float(goal[0]), float(goal[1])
        return goal_control(own, x, y, self.v_max, self.u_max, self.dt)

    def to_rest(self, observation: UgvObservation) -> tuple[float, float]:
        """Return the acceleration [m/s²] that stops the UGV as soon as possible."""
        v_x, v_y = observation.velocity
        return brake(v_x, v_y, self.u_max, self.dt)

    def within(
        self, observation: UgvObservation, wanted: tuple[float, float]
    ) -> tuple[float, float]:
        """Return a finite acceleration [m/s²], shortened to u_max and turned where it would exceed v_max."""
        u_x, u_y = wanted
        size = max(abs(u_x), abs(u_y))
        if size > LARGEST:  # its square might overflow
            u_x, u_y = u_x / size * LARGEST, u_y / size * LARGEST
        u_x, u_y = clip_norm(u_x, u_y, self.u_max)
        v_x, v_y = observation.velocity
        w_x, w_y = v_x + u_x * self.dt, v_y + u_y * self.dt
        return (
            self.to_velocity(observation, (w_x, w_y)) if norm(w_x, w_y) > self.v_max else (u_x, u_y)
        )
