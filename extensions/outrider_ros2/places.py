"""Positions in three dimensions."""

from bus.messages.telemetry import VehicleTruth

Vector3 = tuple[float, float, float]
"""x, y and z."""


def place_of(vehicle: VehicleTruth) -> Vector3:
    """Return the position of a vehicle [m]; a UAV without an altitude is on the ground."""
    return *vehicle.position, vehicle.altitude or 0.0
