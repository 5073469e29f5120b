"""State of a robot that flies a UAV, with the limits of its reports."""

from bus.messages.base import Coordinate, Message, NonNegative, Vector

MAX_STATE_AGE = 1.0
"""Age beyond which a robot's state is unknown [s]."""
MAX_OVERSPEED = 5.0
"""Speed by which a robot may exceed its UAV's bound, as in a gust [m/s]; a faster one is a fault."""


class RobotState(Message, frozen=True, kw_only=True):
    """True state of the robot that flies a UAV, as its process reports it to the simulator; no vehicle receives it."""

    position: Vector
    """Position [m]."""
    altitude: Coordinate | None = None
    """Altitude above the ground [m], of a UAV in the plane relative to its initial one; None: unknown."""
    velocity: Vector
    """Velocity [m/s]."""
    age: NonNegative = 0.0
    """Age of this state at the next tick [s]; 0: it is the state at that tick. The velocity bridges the age."""
