"""A UAV pilot in its own process: it hovers over its UGV.

Start `outrider simulator` and `outrider ugv` in two terminals, and this file in a third.
"""

from agents.process import fly
from bus.keys import Party, Role
from bus.messages.vehicle import UavCommand


class Hover:
    def __init__(self, briefing):
        pass

    def act(self, observation):
        (detection, *_) = observation.detections or [None]
        x, y = detection.relative_position if detection else (0.0, 0.0)
        v_x, v_y = observation.velocity
        return UavCommand(tick=observation.tick, acceleration=(-0.2 * x - v_x, -0.2 * y - v_y))


fly(Party(role=Role.UAV, name="uav_0"), Hover, connect="tcp/127.0.0.1:17447", run="flight")
