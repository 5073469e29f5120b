"""Rows of observations as the messages that pilots read over the bus."""

from bus.messages.vehicle import Detection, UavObservation, UgvObservation
from bus.observations import UAV, UGV, Row, names


def uav_observation(row: Row, *, dt: float) -> UavObservation:
    """Return a UAV's row as the message that its pilot reads over the bus.

    Args:
        row: The entries of `UAV`.
        dt: Length of a tick [s].
    """
    own = dict(zip(names(UAV), row.tolist(), strict=True))
    tick = round(own["time"] / dt)
    taken = tick - round(own["age"] / dt)
    relative = own["relative_x"], own["relative_y"]
    return UavObservation(
        tick=tick,
        time=tick * dt,
        position=(own["x"], own["y"]),
        velocity=(own["vx"], own["vy"]),
        detections=(Detection(time=taken * dt, relative_position=relative),)
        if own["detected"]
        else (),
    )


def ugv_observation(row: Row, *, dt: float) -> UgvObservation:
    """Return a UGV's row as the message that its pilot reads over the bus; arguments as for `uav_observation`."""
    own = dict(zip(names(UGV), row.tolist(), strict=True))
    tick = round(own["time"] / dt)
    return UgvObservation(
        tick=tick,
        time=tick * dt,
        position=(own["x"], own["y"]),
        velocity=(own["vx"], own["vy"]),
    )
