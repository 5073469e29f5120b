"""The equations that the world and a vehicle on board share."""
