"""`outrider hover`: your own pilot as a command."""

from bus.messages.vehicle import UavCommand
from outrider.cli import options
from outrider.cli.joining import joining


class Hover:
    """UAV pilot that accelerates towards the newest detection of its UGV."""

    def __init__(self, briefing):
        pass

    def act(self, observation):
        x, y = observation.detections[0].relative_position if observation.detections else (0.0, 0.0)
        v_x, v_y = observation.velocity
        return UavCommand(tick=observation.tick, acceleration=(-0.2 * x - v_x, -0.2 * y - v_y))


def command(
    name: str = "uav_0",
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    join_timeout: options.JoinTimeout = 30.0,
) -> None:
    """Fly a UAV that hovers over its UGV.

    Example: outrider hover --name uav_0
    """
    joining("uav", name, connect, run, credentials, join_timeout).fly(Hover)
