"""Steering shared by the drivers: to a velocity, to a goal or to rest, within the UGV's bounds and kinematics."""

from agents.asking import LARGEST
from agents.drivers.manoeuvres import move, turn_to_goal, turn_to_velocity
from agents.drivers.parameters import UgvParameters, ugv_parameters
from bus.messages.vehicle import UgvBriefing, UgvObservation
from sim.compiling.compile import compiled
from sim.compiling.records import records
from sim.models.kinematics import DIFFERENTIAL, POINT, UgvState
from sim.models.vehicles import brake, clip_norm, norm, speed_to_stop_within


@compiled
def velocity_control(
    ugv: UgvParameters, own: UgvState, w_x: float, w_y: float
) -> tuple[float, float]:
    r"""Return the acceleration [m/s²] towards a desired velocity.

    A point accelerates straight towards it:

    $$ u = clip_{u_{max}}\left(\frac{clip_{v_{max}}(w) - v}{dt}\right) $$

    The next velocity lies between v and a vector within v_max: if v keeps the bound, so does the next velocity.

    Args:
        ugv: Constants of the UGV.
        own: Its state.
        w_x, w_y: Desired velocity [m/s], of any finite length.
    """
    if ugv.kinematics.kind != POINT:
        return turn_to_velocity(ugv, own, w_x, w_y)
    w_x, w_y = clip_norm(w_x, w_y, ugv.max_speed)
    return clip_norm((w_x - own.v_x) / ugv.dt, (w_y - own.v_y) / ugv.dt, ugv.max_acceleration)


@compiled
def goal_control(
    ugv: UgvParameters, own: UgvState, goal_x: float, goal_y: float, speed: float
) -> tuple[float, float]:
    """Return the stabilizing control f(p_g, goal) [m/s²]: as fast as the bounds allow, braking in time.

    A point drives straight to the goal.

    Args:
        ugv: Constants of the UGV.
        own: Its state.
        goal_x, goal_y: Goal [m].
        speed: Maximum speed [m/s].
    """
    if ugv.kinematics.kind != POINT:
        return turn_to_goal(ugv, own, goal_x, goal_y, speed)
    d_x, d_y = goal_x - own.p_x, goal_y - own.p_y
    distance = norm(d_x, d_y)
    w_x, w_y = 0.0, 0.0
    if distance > 0.0:
        e_x, e_y = d_x / distance, d_y / distance
        # half of the next tick is driven at the old speed
        rest = distance - 0.5 * ugv.dt * max(own.v_x * e_x + own.v_y * e_y, 0.0)
        fastest = min(speed, speed_to_stop_within(rest, ugv.max_acceleration, ugv.dt))
        w_x, w_y = e_x * fastest, e_y * fastest
    return clip_norm((w_x - own.v_x) / ugv.dt, (w_y - own.v_y) / ugv.dt, ugv.max_acceleration)


def own_state(observation: UgvObservation) -> UgvState:
    """Return the state of a UGV in an observation."""
    heading = observation.heading
    return UgvState(
        *observation.position, *observation.velocity, 0.0 if heading is None else heading
    )


class Steering:
    """Stateless conversion of a driver's request into an acceleration within the UGV's bounds.

    Args:
        briefing: Briefing of the UGV.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        own = ugv_parameters(briefing, unbounded=False)
        self.v_max = own.max_speed
        """Maximum speed [m/s]."""
        self.u_max = own.max_acceleration
        """Maximum acceleration [m/s²]."""
        self.dt = own.dt
        """Length of a tick [s]."""
        self._kinematics = own.kinematics
        self.turns = own.kinematics.kind != POINT
        """True if the UGV has a heading and cannot move sideways."""
        self._ugv = records(UgvParameters, [own])[0]

    def to_velocity(
        self, observation: UgvObservation, wanted: tuple[float, float]
    ) -> tuple[float, float]:
        """Return the acceleration [m/s²] towards a desired velocity [m/s], which is shortened to v_max."""
        w_x, w_y = wanted
        return velocity_control(self._ugv, own_state(observation), float(w_x), float(w_y))

    def to_twist(
        self, observation: UgvObservation, speed: float, turn_rate: float
    ) -> tuple[float, float]:
        """Return the acceleration [m/s²] towards a speed along the heading and a turn rate, of a UGV that steers.

        A differential drive whose wheels are too slow for both drives the same curve more slowly.

        Args:
            observation: Observation of the UGV.
            speed: Speed [m/s]; negative: in reverse.
            turn_rate: Change of the heading per second [rad/s]; positive: to the left.
        """
        speed, turn_rate = max(-self.v_max, min(float(speed), self.v_max)), float(turn_rate)
        if self._kinematics.kind == DIFFERENTIAL:
            wheel = abs(speed) + 0.5 * self._kinematics.track * abs(turn_rate)
            share = min(1.0, self.v_max / wheel) if wheel > 0.0 else 1.0
            speed, turn_rate = share * speed, share * turn_rate
        return move(self._ugv, own_state(observation), speed, turn_rate * self.dt, 1.0)

    def to_goal(
        self, observation: UgvObservation, goal: tuple[float, float]
    ) -> tuple[float, float]:
        """Return the acceleration [m/s²] towards a goal [m], as in the paper's driver."""
        x, y = float(goal[0]), float(goal[1])
        return goal_control(self._ugv, own_state(observation), x, y, self.v_max)

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
