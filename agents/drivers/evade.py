"""The adversary at the wheel: tries to shake the UAV off, within the UGV's limits and by what a UGV may know."""

import math

from agents.drivers.steering import Steering
from agents.drivers.wander import WanderDriver
from bus.messages import RelativeInformation, UgvBriefing, UgvObservation
from sim.randomness import WANDER, uniform
from sim.vehicles import norm

_SMOOTHING = 1.0  # time constant of the UAV's estimated velocity [s]: a difference of two estimates is mostly noise
_FORGOTTEN = 5.0  # after so long without a message [s] the last one says nothing any more
_LEAD = 1.0, 10.0  # least and largest lead [s], for a UGV that turns at once or hardly at all
_SLOT = 5.0  # one sharp turn in so many leads
_DASH = 4.0  # out of a corner it drives along a wall for so many leads
_BEGIN, _SIDE, _ANGLE, _WALL, _SPOT = range(2, 7)  # indices of the draws of a slot; 0 and 1 are the wanderer's


class _Pursuer:
    """The UAV as its radio messages show it: place and smoothed velocity. Of several UAVs, the one that was heard last."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._place = (0.0, 0.0)  # [m], at the time _at
        self._velocity = (0.0, 0.0)
        self._at = 0.0  # [s]
        self._heard = -math.inf  # when the newest message came [s]

    def known(self, time: float) -> bool:
        """Whether there has been a message, and not too long ago."""
        return time - self._heard <= _FORGOTTEN

    def listen(self, observation: UgvObservation) -> None:
        """Take in what has come at this tick."""
        for message in observation.radio:
            self._take(message, observation)

    def _take(self, message: RelativeInformation, observation: UgvObservation) -> None:
        (p_x, p_y), (v_x, v_y), (d_x, d_y) = observation.position, observation.velocity, message.relative_position
        age = min(max(observation.time - message.time, 0.0), _FORGOTTEN)
        x, y, at = p_x - age * v_x + d_x, p_y - age * v_y + d_y, observation.time - age  # the UGV has driven on since
        gap = at - self._at
        if not self.known(observation.time):
            self._velocity = (0.0, 0.0)
        elif gap > 0.5 * self._dt:  # of two messages of one time the difference says nothing
            share = gap / (_SMOOTHING + gap)
            (w_x, w_y), (q_x, q_y) = self._velocity, self._place
            self._velocity = w_x + share * ((x - q_x) / gap - w_x), w_y + share * ((y - q_y) / gap - w_y)
        self._place, self._at, self._heard = (x, y), at, observation.time

    def ahead(self, time: float) -> tuple[float, float]:
        """Where it will be at a time [m] if it flies on as it does."""
        (x, y), (w_x, w_y), gap = self._place, self._velocity, time - self._at
        return x + gap * w_x, y + gap * w_y


class EvadeDriver:
    """Drives at full speed away from where the UAV will be by the time the UGV has turned round.

    A UAV that flies off is left behind; one that comes up fast will have flown past by then, so the UGV reverses and drives at
    it: either way the two velocities point apart when the UAV has most to brake. The lead is 2 v/u, the UGV's own time to
    reverse: it knows no bound of the UAV. In each slot of five leads it turns off sharply once, for one lead, by 60° to 120° to
    one side; when and where to is drawn from its key. It knows its own state and what the UAV radios, p_a - p_g up to 0.2 s and
    a tick ago, and neither the visibility radius nor the law.

    Within the wanderer's margin of the border it drops what points outward and slides along at full speed, braking first where
    a wall is too near; in a corner it picks one of the two walls at random and drives out along it for four leads. Before the
    first message, and five seconds after the last one, it wanders.

    It is a heuristic, not the worst case: it looks one manoeuvre ahead and solves no game.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._briefing = briefing
        self._steering = Steering(briefing)
        self._wander = WanderDriver(briefing)
        self._speed, self._margin = self._wander.speed, self._wander.margin
        self._lead = min(max(2.0 * self._speed / self._steering.u_max, _LEAD[0]), _LEAD[1])
        self._pursuer = _Pursuer(self._steering.dt)
        self._dash = (0.0, 0.0)  # direction out of a corner
        self._dash_end = -math.inf  # [s]

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""
        self._pursuer.listen(observation)
        if not self._pursuer.known(observation.time):
            return self._wander.drive(observation)
        x, y = self._direction(observation)
        wanted = self._off_walls(observation, (x * self._speed, y * self._speed))
        return self._steering.to_velocity(observation, wanted)

    def _direction(self, observation: UgvObservation) -> tuple[float, float]:
        """Where to, as a unit vector."""
        dashing = observation.time < self._dash_end
        x, y = self._dash if dashing else self._turned(self._away(observation), observation.time)
        out_x, out_y = self._outward(observation)
        free_x, free_y = (0.0 if out_x * x > 0.0 else x), (0.0 if out_y * y > 0.0 else y)
        length = norm(free_x, free_y)
        if length > 0.0:
            return free_x / length, free_y / length
        return self._leave(out_x, out_y, observation.time)

    def _away(self, observation: UgvObservation) -> tuple[float, float]:
        """Away from where the UAV will be."""
        (p_x, p_y), (a_x, a_y) = observation.position, self._pursuer.ahead(observation.time + self._lead)
        x, y = p_x - a_x, p_y - a_y
        length = norm(x, y)
        if length > 0.0:
            return x / length, y / length
        angle = math.tau * self._draw(observation.time, _SPOT)  # right below it: any direction is as good
        return math.cos(angle), math.sin(angle)

    def _turned(self, direction: tuple[float, float], time: float) -> tuple[float, float]:
        """The direction, turned off sharply for one lead of each slot."""
        period = _SLOT * self._lead
        begin = (_SLOT - 1.0) * self._lead * self._draw(time, _BEGIN)
        if not begin <= time % period < begin + self._lead:
            return direction
        angle = math.radians(60.0 + 60.0 * self._draw(time, _ANGLE))
        if self._draw(time, _SIDE) < 0.5:
            angle = -angle
        cos, sin = math.cos(angle), math.sin(angle)
        return direction[0] * cos - direction[1] * sin, direction[0] * sin + direction[1] * cos

    def _outward(self, observation: UgvObservation) -> tuple[float, float]:
        """On each axis the sign of the side that is nearer than the margin, or 0."""
        area, margin, (p_x, p_y) = self._briefing.area, self._margin, observation.position
        return (
            float(p_x > area.width - margin) - float(p_x < margin),
            float(p_y > area.height - margin) - float(p_y < margin),
        )

    def _off_walls(self, observation: UgvObservation, wanted: tuple[float, float]) -> tuple[float, float]:
        """The wanted velocity [m/s], but where a wall would be hit else: to brake towards it first, and turn only then."""
        (p_x, p_y), (v_x, v_y), area = observation.position, observation.velocity, self._briefing.area
        halting = 0.5 * norm(v_x, v_y) / self._steering.u_max + 2.0 * self._steering.dt  # way to a stop over speed [s]
        stop_x = abs(v_x) * halting > (area.width - p_x if v_x > 0.0 else p_x)
        stop_y = abs(v_y) * halting > (area.height - p_y if v_y > 0.0 else p_y)
        if stop_x or stop_y:
            return (0.0 if stop_x else v_x), (0.0 if stop_y else v_y)
        return wanted

    def _leave(self, out_x: float, out_y: float, time: float) -> tuple[float, float]:
        """Off a wall that it stands square to, or out of a corner: along a wall, and it stays with that for a while."""
        side = 1.0 if self._draw(time, _WALL) < 0.5 else -1.0
        if out_x and out_y:
            self._dash = (-out_x, 0.0) if side > 0.0 else (0.0, -out_y)
        else:
            self._dash = (side * out_y, side * out_x)
        self._dash_end = time + _DASH * self._lead
        return self._dash

    def _draw(self, time: float, index: int) -> float:
        """A number in [0, 1) for the slot of this time."""
        return uniform(self._briefing.key, WANDER, 0, int(time / (_SLOT * self._lead)), index)
